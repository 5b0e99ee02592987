"""Checks whether each input moves the right output: sign and order of the channels, dead inputs, swapped pairs."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence

import numpy as np

from ssmr_torch.commissioning.steps import StepAnswer

SIGNED = re.compile(r"(?:.*[_ ])?([+-])([xyz])$")  # cable_+x moves tip_x up
LIKE = 0.5  # of the largest gain: an output with at least this gain counts as moved by the input


def expectations(expected: Mapping[str, str], inputs: Sequence[str], outputs: Sequence[str]) -> dict[str, str]:
    """Input → output, with the sign of the motion: from the card, else from the names where all follow the pattern;
    else empty.
    """
    if expected:
        return dict(expected)
    found = {}
    for name in inputs:
        sign = SIGNED.fullmatch(name)
        column = next((each for each in outputs if sign and each.endswith(f"_{sign.group(2)}")), None)
        if column is None:
            return {}
        found[name] = sign.group(1) + column
    return found


def channel_faults(answers: Sequence[StepAnswer], expected: Mapping[str, str], outputs: Sequence[str]) -> list[str]:
    """Dead inputs, inputs with the wrong sign, swapped pairs, and inputs that move another output. An input without an
    expectation is judged only for being dead.
    """
    faults = [f"{answer.input} is dead: a step of {answer.size:.3g} moved no output beyond the noise; check its cable, "
              "valve or amplifier" for answer in answers if answer.output is None]
    moved = {answer.input: _moved(answer, expected, outputs) for answer in answers
             if answer.output is not None and answer.input in expected}
    wrong = [name for name in moved if moved[name] != expected[name]]
    while wrong:
        name = wrong.pop(0)
        other = next((each for each in wrong if expected[each] == moved[name] and expected[name] == moved[each]), None)
        if other is not None:
            wrong.remove(other)
            faults.append(f"{name} and {other} are swapped: {name} moves {moved[name]}, {other} moves {moved[other]}; "
                          "exchange the two channels")
        elif moved[name][1:] == expected[name][1:]:
            faults.append(f"{name} is reversed: it moves {moved[name]}, expected {expected[name]}; change its sign")
        else:
            faults.append(f"{name} moves {moved[name]}, expected {expected[name]}; check the order of the channels")
    return faults


def _moved(answer: StepAnswer, expected: Mapping[str, str], outputs: Sequence[str]) -> str:
    """The output that this input moves most, with its sign; only outputs that some input is expected to move count."""
    columns = sorted({list(outputs).index(each[1:]) for each in expected.values()})
    gain = answer.gain[columns]
    most = int(np.argmax(np.abs(gain)))
    return f"{'+' if gain[most] > 0 else '-'}{outputs[columns[most]]}"


def channels_said(answers: Sequence[StepAnswer], expected: Mapping[str, str], outputs: Sequence[str], unit: str) -> str:
    """A table: the outputs that each input moves, the gain, the delay and the settling time."""
    per = f"mm/{unit}" if unit != "1" else "mm"
    rows = [f"| input | step | moves ({per}) | {'expected | ' if expected else ''}delay (ms) | settles (s) | × noise |",
            f"| --- | ---: | --- | {'--- | ' if expected else ''}---: | ---: | ---: |"]
    for answer in answers:
        gain = answer.gain
        shown = [column for column in np.argsort(-np.abs(gain)) if abs(gain[column]) >= LIKE * np.abs(gain).max()][:3]
        moves = ", ".join(f"{outputs[column]} {1e3 * gain[column]:+.3g}" for column in shown)
        moves = moves if answer.output else "nothing"
        delay = "–" if answer.delay_s is None else f"{1e3 * answer.delay_s:.3g}"
        settles = "> held" if answer.settling_s is None else f"{answer.settling_s:.2f}"
        settles = settles if answer.output else "–"
        asked = f"{expected.get(answer.input, '–')} | " if expected else ""
        rows.append(f"| {answer.input} | {answer.size:.3g} | {moves} | {asked}{delay} | {settles} | "
                    f"{answer.loudness:.3g} |")
    return "\n".join(rows)


def admissible_share(answers: Sequence[StepAnswer], room: np.ndarray, limit: float) -> float:
    """The share of the input range in which no single input, held, moves an output beyond 90 % of the limit.

    room: (m,), from the neutral input to the farther bound, input unit.   limit: m, displacement limit. At least 0.1.
    """
    reach = max(float(np.abs(answer.gain).max()) * span for answer, span in zip(answers, room))
    return float(np.clip(0.9 * limit / reach, 0.1, 1.0)) if reach > 0 else 1.0
