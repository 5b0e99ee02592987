"""The rest position, against the ends of the decays."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from ssmr_torch.recording_faults.recording import Recording

FAR, ASTRAY = 0.1, 0.2  # of a decay's extent: ends farther from rest are said, or refused
SETTLED = 0.1       # of its extent, by which a decay may still move in its last fifth
MOVING = 0.15       # of it, from which a decay gives no rest position
STILL = 4.0         # times their last motion, that settled decays must end away from rest to be judged
ELSEWHERE = 6.0     # times the usual scatter of the ends, from which one decay counts as ending elsewhere
APART = 0.1         # of the extent, that it must be away as well
ENDS = 10           # last samples whose median is the end, or the last fifth of a short decay


class Ends(NamedTuple):
    """Ends of the decays from rest (N, p), m; extents (N,), m; moves (N,), m, in the last fifth; speeds (N,), m/s."""

    at: np.ndarray
    extents: np.ndarray
    moves: np.ndarray
    speeds: np.ndarray


def ends_of(decays: Sequence[Recording], rest: np.ndarray) -> Ends:
    """Where and how the decays end."""
    moved = [each.observation[np.isfinite(each.observation).all(axis=1)] - (0.0 if each.centred else rest)
             for each in decays]
    at = np.array([np.median(y[-min(ENDS, max(2, len(y) // 5)):], axis=0) for y in moved])
    extents = np.array([np.linalg.norm(np.ptp(y, axis=0)) for y in moved])
    fifths = [y[-max(4, len(y) // 5):] for y in moved]
    moves = np.array([_motion(y) for y in fifths])
    spans = np.array([len(y) * np.median(np.diff(each.time)) for y, each in zip(fifths, decays)])
    return Ends(at, extents, moves, moves / spans)


def _motion(y: np.ndarray) -> float:
    """m, how far the means of four quarters lie apart; noise hardly shows in it."""
    quarters = np.array([part.mean(axis=0) for part in np.array_split(y, 4)])
    return float(np.linalg.norm(np.ptp(quarters, axis=0)))


def refuse_wrong_rest(recordings: Sequence[Recording], rest: np.ndarray, rule: str, scale: float = 1e-3,
                      unit: str = "mm", found: bool = False) -> list[Recording]:
    """The recordings, with notes on decays that end far from rest, or elsewhere than the others.

    found: whether the rest position was taken from the decays, which must then have come to rest. scale, unit: of the
    source, for the remedy. Decays that still move at their end are not judged.
    Raises ValueError, unless the rule is "keep", when the decays end far from rest, or one of them elsewhere, or when
    none of those that give the rest position rests.
    """
    decays = [each for each in recordings if each.kind == "decay" and len(each.time) >= 8]
    if not decays:
        return list(recordings)
    ends = ends_of(decays, rest)
    said: dict[str, str] = {}
    if found:
        said |= _moving(decays, ends, rule)
    settled = np.flatnonzero(ends.moves <= SETTLED * np.maximum(ends.extents, 1e-12))
    if 2 * len(settled) < len(decays):
        settled = settled[:0]  # those that seem to rest are at a turning point
    for centred in (False, True):
        group = settled[[decays[place].centred == centred for place in settled]] if len(settled) else settled
        if len(group):
            said |= _away([decays[place] for place in group], Ends(*(each[group] for each in ends)), rest, rule, scale,
                          unit)
    if not len(settled):
        said |= _unsettled([each for each in decays if each.centred], ends.at[[each.centred for each in decays]])
    return [each.noted("rest_position", said[each.name], "kept") if each.name in said else each for each in recordings]


def _moving(decays: list[Recording], ends: Ends, rule: str) -> dict[str, str]:
    """Notes on decays that still move, although they give the rest position."""
    share = ends.moves / np.maximum(ends.extents, 1e-12)
    worst = int(share.argmax())
    spread = 1e3 * float(np.ptp(ends.at, axis=0).max())
    within = f", and their ends lie {spread:.3g} mm apart" if len(decays) > 1 else ""
    sentence = (f"still moves at its end, with {1e3 * ends.speeds[worst]:.3g} mm/s over its last fifth{within}, so it "
                "gives no rest position; record until the robot rests, or give rest as a vector")
    if np.median(share) > MOVING and rule != "keep":
        raise ValueError(f"{decays[worst].name}: {sentence}")
    return {each.name: f"still moves at its end, with {1e3 * speed:.3g} mm/s over its last fifth, so it gives a poor "
                       "rest position; record longer, or give rest as a vector"
            for each, part, speed in zip(decays, share, ends.speeds) if part > SETTLED}


def _unsettled(decays: list[Recording], at: np.ndarray) -> dict[str, str]:
    """A note on the first of the decays that were centred before they came to rest, if they end away from zero."""
    if not decays:
        return {}
    away = float(np.linalg.norm(np.median(at, axis=0)))
    extent = max(float(np.linalg.norm(np.ptp(each.observation, axis=0))) for each in decays)
    if away <= FAR * extent:
        return {}
    return {decays[0].name: f"it and the other decays still move at their end, {1e3 * away:.3g} mm from zero in the "
                            "median, and y is the displacement from rest: record them longer, or subtract where the "
                            "robot rests"}


def _away(decays: list[Recording], ends: Ends, rest: np.ndarray, rule: str, scale: float, unit: str) -> dict[str, str]:
    """Notes on, or refusal of, decays that rest far from the rest position."""
    middle = np.median(ends.at, axis=0)
    away, extent = np.linalg.norm(middle), float(np.median(ends.extents))
    apart = np.linalg.norm(ends.at - middle, axis=1)
    usual = float(np.median(apart)) if len(decays) > 1 else 0.0
    said: dict[str, str] = {}
    if away > max(FAR * extent, 3 * usual, STILL * float(np.median(ends.moves))):
        text = _far(decays[0], middle, extent, rest, scale, unit)
        if away > ASTRAY * extent and rule != "keep":
            raise ValueError(f"the decays{text}; correct it, or set faults.rest_position: keep")
        said |= {each.name: f"it and the other decays{text}" for each in decays[:1]}
    for each, distance, end in zip(decays, apart, ends.at):
        if len(decays) > 2 and distance > max(ELSEWHERE * usual, APART * extent):
            text = (f"it ends {_parts(each, end - middle)} from where the other decays end; check this run, or leave "
                    "it out")
            if rule != "keep" and (apart > ELSEWHERE * usual).sum() <= max(1, len(decays) // 4) and (
                    distance > ASTRAY * extent):
                raise ValueError(f"{each.name}: {text}, or set faults.rest_position: keep")
            said[each.name] = text
    return said


def _far(decay: Recording, middle: np.ndarray, extent: float, rest: np.ndarray, scale: float, unit: str) -> str:
    where = ((middle if decay.centred else middle + rest) / scale).round(5).tolist()
    if decay.centred:
        return (f" end {1e3 * np.linalg.norm(middle):.3g} mm from zero, in the median at "
                f"{np.round(1e3 * middle, 2).tolist()} mm, and move by {1e3 * extent:.3g} mm; y is the displacement "
                f"from rest: subtract the rest position, {where} {unit} where the decays end at rest, or do not call "
                "them centred")
    return (f" end {_parts(decay, middle)} from the rest position and move by {1e3 * extent:.3g} mm; rest should be "
            f"{where} {unit}, where they end")


def _parts(recording: Recording, away: np.ndarray) -> str:
    """A distance by columns, as "15 mm in z", without small ones."""
    names = recording.output_names or [f"y{number}" for number in range(1, len(away) + 1)]
    large = np.flatnonzero(np.abs(away) > 0.3 * np.abs(away).max())
    return " and ".join(f"{_millimetres(abs(away[place]))} in {names[place]}" for place in large)


def _millimetres(size: float) -> str:
    return f"{1e3 * size:.0f} mm" if size >= 0.0095 else f"{1e3 * size:.2g} mm"
