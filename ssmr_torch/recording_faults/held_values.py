"""Held values: a marker that stands still in the file while the robot moves."""

from __future__ import annotations

import numpy as np

from ssmr_torch.recording_faults.continuity import STEPS, gaps, limits, pieces, smallest_step
from ssmr_torch.recording_faults.markers import markers
from ssmr_torch.recording_faults.recording import Recording
from ssmr_torch.recording_faults.treatment import treated

DEAD = 10           # rows at the end of a run, from which a marker that never moves again may be dead
ALONE = 20          # rows, from which one column that stands still while others move is dead
MOVES = 0.05        # of the range of an input, or of the reach, that counts as moving
CHANCE = 0.01       # repeats of all coordinates by chance, as a share of the rows, below which none is by chance
SLIGHT = 0.002      # of the reach, by which such a repeat must miss the motion to matter
REPEATS = 0.05      # share of repeated rows elsewhere, above which repeats are usual (rounded values, a robot at rest)


def held_values(recording: Recording, rule: str, reach: float) -> Recording:
    """The recording without rows that repeat the row before exactly while the robot moves on.

    Three kinds are found. Repeated rows of a marker that end in a jump; they begin without one. A marker that never
    moves again, although the inputs do and its values did not repeat before. One column that stands still while the
    others move. Values that repeat at rest or because they are rounded do not jump.
    """
    y = recording.observation
    bad = np.zeros(y.shape, dtype=bool)
    for piece in pieces(recording):
        bad[piece] = _held(recording.time[piece], y[piece], recording.input[piece], recording.output_names, reach)
    if not bad.any():
        return recording
    names = recording.columns(bad.any(axis=0))
    return treated(recording, bad, "held_values", rule,
                   f"{names or 'the position'} {'repeats' if ' and ' not in names else 'repeat'} a value exactly while "
                   "the robot moves,")


def _held(time, y, inputs, names, reach: float) -> np.ndarray:
    bad = np.zeros(y.shape, dtype=bool)
    found = gaps(time, y)
    repeated = np.vstack([np.zeros(y.shape[1], dtype=bool), np.diff(y, axis=0) == 0])
    for columns in markers(y.shape[1], names):
        same = repeated[:, columns].all(axis=1)
        beside = same | np.r_[same[1:], False] | np.r_[False, same[:-1]]
        jumped = np.abs(found) > limits(y, np.where(beside[:, None], 0.0, found), reach)
        slight = np.maximum(STEPS * smallest_step(y[:, columns]), SLIGHT * reach)
        sure = len(columns) > 1 and np.prod(repeated[~same][:, columns].mean(axis=0)) * len(y) < CHANCE
        least = 2 if len(columns) == 1 else 1
        for first, stop in blocks(same):
            begins = jumped[first - 1, columns].any() and not sure
            ends = stop < len(y) and (jumped[stop, columns].any() or (
                sure and (np.abs(found[stop, columns]) > slight).any()))
            if stop - first >= least and ends and not begins:
                bad[first:stop, columns] = True
            elif stop == len(y) and stop - first >= DEAD and _dead(y, inputs, same, first, columns, reach):
                bad[first:stop, columns] = True
    for column in range(y.shape[1]):
        for first, stop in blocks(repeated[:, column]):
            if stop - first >= ALONE and _alone(y, repeated[:, column], column, first, stop, reach):
                bad[first:stop, column] = True
    return bad


def _dead(y, inputs, same, first: int, columns, reach: float) -> bool:
    """Whether a marker that stands still from `first` to the end is dead: its values did not repeat before, and the
    inputs, or other markers, move on, or it stopped from full motion."""
    if same[:first].mean() > REPEATS:
        return False
    driven = (np.ptp(inputs[first:], axis=0) > MOVES * np.ptp(inputs, axis=0)).any() and np.ptp(inputs, axis=0).any()
    others = np.setdiff1d(np.arange(y.shape[1]), columns)
    seen = len(others) > 0 and np.ptp(y[first:, others], axis=0).max() > 4 * MOVES * reach
    before = y[max(0, first - 3):first, columns]
    stopped = len(before) == 3 and np.abs(before[2] - before[0]).max() / 2 > 2 * MOVES / 5 * reach
    return bool(driven or seen or stopped)


def _alone(y, repeated, column: int, first: int, stop: int, reach: float) -> bool:
    """Whether one column stands still over these rows, and nowhere else, while others move and its value is no step of
    rounding."""
    elsewhere = np.r_[repeated[:first], repeated[stop:]]
    if not len(elsewhere) or elsewhere.mean() > REPEATS:
        return False
    others = np.delete(y[first:stop], column, axis=1)
    own = np.ptp(np.r_[y[:first, column], y[stop:, column]])
    return bool(others.shape[1] and np.ptp(others, axis=0).max() > 4 * MOVES * reach
                and own > 20 * smallest_step(y)[column])


def blocks(true: np.ndarray) -> list[tuple[int, int]]:
    """(first, stop) of each stretch of true values."""
    edges = np.flatnonzero(np.diff(np.r_[False, true, False].astype(int)))
    return list(zip(edges[::2].tolist(), edges[1::2].tolist()))
