"""Files and columns in another unit than the others, and columns that never move."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ssmr_torch.recording_estimates.response import filtered
from ssmr_torch.recording_faults.continuity import extent
from ssmr_torch.recording_faults.recording import Recording
from ssmr_torch.recording_faults.responses import Part, modes_of, parts
from ssmr_torch.recording_faults.rules import FEW

FACTOR = 4.0        # by which a run's response may differ from that of the others
AGREES = 0.6        # correlation with the response of the others, from which their sizes can be compared
ASTRAY = 3.0        # times the reach, by which the middle of a run may be away from that of the others
TINY = 1 / 300      # of the largest range of a column, below which another one may be in another unit
QUIET = 1 / 30      # of the median noise, that such a column's noise is below
WORDS = {10: "a tenth", 100: "a hundredth", 1000: "a thousandth"}


def dead_columns(recordings: Sequence[Recording], rule: str) -> list[Recording]:
    """The recordings, with a note on columns that never move in a run, or in any.

    Raises ValueError for them unless the rule is "keep". Runs of less than `rules.FEW` rows are not judged.
    """
    moving = {each.name: (np.max(each.observation, axis=0) > np.min(each.observation, axis=0)) for each in recordings}
    anywhere = np.any(list(moving.values()), axis=0)
    found = []
    for each in recordings:
        dead = anywhere & ~moving[each.name]
        if not dead.any() or not moving[each.name].any() or len(each.time) < FEW:
            found.append(each)
            continue
        text = f"{each.columns(dead)} never moves in this run, but in others; leave the run out"
        if rule != "keep":
            raise ValueError(f"{each.name}: {text}, or set faults.dead_columns: keep")
        found.append(each.noted("dead_columns", f"{text}; kept, as faults.dead_columns says", "kept"))
    if anywhere.any() and not anywhere.all() and max(len(each.time) for each in recordings) >= FEW:
        which = recordings[0].columns(~anywhere)
        text = (f"{which} never {'move' if ' and ' in which else 'moves'} in any run: a marker that was lost, or a "
                "direction that the robot does not have; leave it out of columns.observation")
        if rule != "keep":
            raise ValueError(f"{text}, or set faults.dead_columns: keep")
        found[0] = found[0].noted("dead_columns", text, "kept")
    return found


def wrong_units(recordings: Sequence[Recording], rest: np.ndarray, rule: str) -> list[Recording]:
    """The recordings, with a note on each run or column that must be in another unit; raises ValueError for them
    unless the rule is "keep".

    Three comparisons are made. The middle of a run is far from that of the others (a file of positions in another
    unit). The response of a controlled run to its inputs is several times as large, or as small, as that of the others
    (a file of displacements, or of inputs). A column moves 300 times less than the largest, and has 30 times less
    noise. All files in one wrong unit look alike: only their size can tell, see `data.units.Plausible`.
    """
    found = _astray(recordings, rest) or _scaled(recordings, rest)
    column = _tiny(recordings)
    if column:
        found.setdefault(recordings[0].name, column)
    if found and rule != "keep":
        name, text = next(iter(found.items()))
        owner = "" if text == column else f"{name}: "
        raise ValueError(f"{owner}{text}; correct it, or set faults.wrong_units: keep")
    return [each.noted("wrong_units", f"{found[each.name]}; kept, as faults.wrong_units says", "kept")
            if each.name in found else each for each in recordings]


def _astray(recordings: Sequence[Recording], rest: np.ndarray) -> dict[str, str]:
    """Runs whose middle is far from that of the others."""
    if len(recordings) < 3:
        return {}
    moved = [each.observation - (0.0 if each.centred else rest) for each in recordings]
    middles = np.array([np.median(y, axis=0) for y in moved])
    reach = float(np.median([extent(y) for y in moved]))
    common = np.median(middles, axis=0)
    away = np.linalg.norm(middles - common, axis=1)
    own = np.array([extent(y) for y in moved])
    return {each.name: f"it lies {1e3 * distance:.3g} mm from the others, which move by {1e3 * reach:.3g} mm: is the "
                       "file in another unit, or not measured from where the others are (rest, centred)?"
            for each, distance, size in zip(recordings, away, own)
            if distance > ASTRAY * max(reach, size) and reach > 0}


def _scaled(recordings: Sequence[Recording], rest: np.ndarray) -> dict[str, str]:
    """Controlled runs that respond several times as much, or as little, as the others do to the same inputs."""
    every = parts(recordings, rest)
    driven = [part for part in every if part.run.kind == "controlled" and np.ptp(part.run.input, axis=0).any()]
    modes = modes_of(every)
    if len({part.name for part in driven}) < 2 or modes.memory is None:
        return {}
    sizes = {part.name: (extent(part.run.observation), extent(part.run.input)) for part in driven}
    ratio = np.array([moved / max(driving, 1e-300) for moved, driving in sizes.values()])
    usual = float(np.median(ratio))
    found = {}
    for name, own in zip(sizes, ratio):
        if 1 / FACTOR < own / usual < FACTOR:
            continue
        factor = _factor([part for part in driven if part.name != name], [part for part in driven if part.name == name],
                         modes)
        if factor is not None and not 1 / FACTOR < factor < FACTOR:
            found[name] = _explained(name, factor, sizes)
    return found


def _factor(others: list[Part], own: list[Part], modes) -> float | None:
    """How many times as large the response is as that of the others; None if the two do not resemble each other."""
    def seen(part: Part) -> np.ndarray:
        return filtered(part.run.input, modes.rates, part.run.timestep)

    features = np.concatenate([seen(part) for part in others])
    targets = np.concatenate([part.run.observation - part.run.observation.mean(axis=0) for part in others])
    features = features - features.mean(axis=0)
    norms = np.linalg.norm(features, axis=0)
    norms[norms == 0] = 1.0
    weights = np.linalg.lstsq(features / norms, targets, rcond=1e-6)[0] / norms[:, None]
    expected = np.concatenate([seen(part) for part in own]) @ weights
    expected = expected - expected.mean(axis=0)
    actual = np.concatenate([part.run.observation for part in own])
    actual = actual - actual.mean(axis=0)
    agreement = np.sum(expected * actual) / max(np.linalg.norm(expected) * np.linalg.norm(actual), 1e-300)
    return float(np.linalg.norm(actual) / np.linalg.norm(expected)) if agreement > AGREES else None


def _explained(name: str, factor: float, sizes: dict[str, tuple[float, float]]) -> str:
    moved, driving = sizes[name]
    others = np.array([each for run, each in sizes.items() if run != name])
    by_motion = abs(np.log(moved / np.median(others[:, 0])))
    by_input = abs(np.log(driving / np.median(others[:, 1])))
    amount = f"{factor:.3g} times" if factor > 1 else next(
        (word for tens, word in WORDS.items() if abs(np.log(factor * tens)) < 0.3), f"{factor:.3g} times")
    what = "observations" if by_motion >= by_input else "inputs"
    size = (f"it moves by {1e3 * moved:.3g} mm" if what == "observations" else f"its inputs range over {driving:.3g}")
    return (f"its inputs move it {amount} as much as the other runs, and {size}: are its {what} in another unit than "
            "the card says?")


def _tiny(recordings: Sequence[Recording]) -> str:
    """A column that moves far less than the largest and has far less noise, in words; "" if there is none."""
    ranges = np.median([np.ptp(each.observation, axis=0) for each in recordings], axis=0)
    noise = np.median([np.median(np.abs(np.diff(each.observation, 4, axis=0)), axis=0) for each in recordings
                       if len(each.time) > 8] or [np.zeros(len(ranges))], axis=0)
    tiny = (ranges < TINY * ranges.max()) & (noise <= QUIET * np.median(noise[ranges >= TINY * ranges.max()]))
    if not tiny.any() or tiny.all() or not ranges[tiny].any():
        return ""
    part = ranges.max() / max(ranges[tiny].max(), 1e-300)
    return (f"{recordings[0].columns(tiny)} moves by {1e3 * ranges[tiny].max():.3g} mm, {part:.0f} times less than the "
            "largest column: is it in another unit?")
