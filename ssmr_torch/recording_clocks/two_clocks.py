"""Outputs and inputs on two clocks: the offset and the drift between them, and inputs held on the outputs' times."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.optimize import minimize

from ssmr_torch.recording_clocks.clock_rules import Clock, typical_step
from ssmr_torch.recording_clocks.held_inputs import mean_of_held
from ssmr_torch.recording_clocks.lag import CLEAR, CLEAR_ONE, REACH, error_of, lag_of
from ssmr_torch.recording_files.note import Note, rows_said

OVERLAP = 0.2           # share of the shorter recording that both clocks must share
FARTHEST = 5.0          # s, of offsets that are looked for where the clocks tell nothing
WINDOWS, WINDOW = 8, 2.0    # stretches in which the offset is estimated, to see it drift, and s of the shortest
WITHIN = 0.3            # s, by which a drift may change the offset to either side
HELD = 2.0              # longest intervals between commands for which the last is held
SLOWEST = 0.5           # samples by which a drift must move the inputs to be said
AROUND = np.linspace(-1.5, 1.5, 13)     # samples around a first guess where the search begins


class Shift(NamedTuple):
    """offset: s, and drift: share, that are added to the inputs' time: t + offset + drift·(t − first). told: whether
    the recordings tell them. moved, drifted: whether each differs from 0 clearly.
    """

    offset: float = 0.0
    drift: float = 0.0
    told: bool = False
    moved: bool = False
    drifted: bool = False


def joined(name: str, outputs: Clock, observation: np.ndarray, commands: Clock, inputs: np.ndarray,
           offset: float | str = 0.0, drift: float | str = 0.0) -> tuple[Clock, np.ndarray, np.ndarray]:
    """Clock, observation (T, p) and input (T, m) of a run whose inputs (J, m) have a clock of their own.

    Each input is held until the next one's own stamp; a sample's input is the mean until the next sample, so the
    impulse stays. Samples before the first command or long after the last are cut. offset, drift: s and ppm that are
    added to the inputs' clock; "auto": those with which the inputs predict the outputs best. They are said where they
    are clear and not applied.
    Raises ValueError for clocks that share too little time, or that start again.
    """
    if any(note.kind == "clock restarts" for note in (*outputs.notes, *commands.notes)):
        raise ValueError(f"{name}: one of the two clocks starts again, which the other does not; cut both files there")
    time = np.interp(np.arange(len(outputs.time)), np.flatnonzero(np.isfinite(outputs.time)),
                     outputs.time[np.isfinite(outputs.time)])
    there = np.isfinite(commands.time)
    sent, held = commands.time[there] + 1e-9 * (commands.origin - outputs.origin), inputs[there]
    still = not np.ptp(held, axis=0).max(initial=0.0) > 0
    found = Shift()
    if not still:
        sent, base = _on_one_epoch(name, time, sent, offset)
        found = estimate(time, observation, sent, held)
        found = found._replace(offset=base + (found.offset if found.moved or found.drifted else 0.0))
        sent = sent - base
    given = 0.0 if "auto" in (offset, drift) and not found.told else found.drift
    used = Shift(found.offset if offset == "auto" else float(offset), given if drift == "auto" else 1e-6 * float(drift))
    notes = [] if still else _said(name, found, used, offset == "auto" or drift == "auto", typical_step(time))
    sent = sent + used.offset + used.drift * (sent - sent[0])
    kept = np.ones(len(time), dtype=bool) if still else _known(time, sent)
    if not kept.all():
        cut = outputs.rows[~kept]
        notes.append(Note(name, "no inputs", f"no inputs are known at {rows_said(cut)}, before the first command or "
                          "long after the last; cut", "cut", tuple(cut)))
        if kept.sum() < 2:
            raise ValueError(f"{name}: inputs from {sent[0]:.6g} to {sent[-1]:.6g} s are known at {int(kept.sum())} of "
                             f"the {len(time)} samples, from {time[0]:.6g} to {time[-1]:.6g} s; give clock_offset")
    clock = Clock(outputs.time[kept], outputs.rows[kept],
                  (*outputs.notes, *(note for note in commands.notes if note.kind != "gap"), *notes), outputs.origin)
    return clock, observation[kept], _held(time, sent, held)[kept]


def estimate(time: np.ndarray, observation: np.ndarray, sent: np.ndarray, inputs: np.ndarray) -> Shift:
    """Offset and drift of the inputs' stamps `sent` (J,) with which they predict the outputs best."""
    step = typical_step(time)
    grid = np.arange(max(time[0], sent[0]), min(time[-1], sent[-1]), step)
    if len(grid) < 50:
        return Shift()
    good = np.isfinite(observation).all(axis=1)
    y = np.stack([np.interp(grid, time[good], column) for column in observation[good].T], axis=1)

    def held(offset: float, drift: float) -> np.ndarray:
        moved = sent + offset + drift * (sent - sent[0])
        return mean_of_held(moved, inputs, np.r_[grid, grid[-1] + step])

    reach = min(FARTHEST, len(grid) * step / 4)
    first = lag_of([(y, held(0.0, 0.0))], step, min(REACH, reach))
    if first.samples is None or abs(first.samples) * step >= 0.9 * min(REACH, reach):
        first = lag_of([(y, held(0.0, 0.0))], step, reach)
    if first.samples is None:
        return Shift()
    near = -first.samples * step
    offset, drift = _over_time(y, held(near, 0.0), grid, sent[0], step)
    offset += near
    span = grid[-1] - sent[0]

    def error(of) -> float:
        return error_of((y, held(of[0] * step, of[1] * step / span)), step)

    starts = ([-first.samples, 0.0], [offset / step, drift * span / step])
    start = min(([each[0] + more, each[1]] for each in starts for more in AROUND), key=error)
    steps = np.array([start, [start[0] + 0.3, start[1]], [start[0], start[1] + 0.6]])
    best = minimize(error, start, method="Nelder-Mead", options={
        "initial_simplex": steps, "xatol": 0.01, "fatol": 1e-5 * error(start), "maxfev": 80})
    near = min((start[0] + start[1] / 2 + more for more in AROUND), key=lambda of: error([of, 0.0]))
    alone = minimize(lambda of: error([of[0], 0.0]), [near], method="Nelder-Mead", options={
        "initial_simplex": np.array([[near], [near + 0.15]]), "xatol": 0.01, "fatol": 1e-5 * best.fun, "maxfev": 40})
    drifted = bool(abs(best.x[1]) > SLOWEST and alone.fun > (1 + CLEAR) * best.fun)
    at = best.x if drifted else np.array([alone.x[0], 0.0])
    needed = CLEAR if abs(at[0]) > 1.5 or drifted else CLEAR_ONE
    moved = bool(abs(at[0]) > 0.5 and error([0.0, at[1]]) > (1 + needed) * error(at))
    return Shift(float(at[0] * step), float(at[1] * step / span), True, moved, drifted)


def _over_time(y: np.ndarray, u: np.ndarray, grid: np.ndarray, first: float, step: float) -> tuple[float, float]:
    """(offset, drift) of a line through the offsets in stretches of the run."""
    count = int(min(WINDOWS, (grid[-1] - grid[0]) // WINDOW))
    if count < 2:
        return 0.0, 0.0
    at, seen = [], []
    for piece in np.array_split(np.arange(len(grid)), count):
        lag = lag_of([(y[piece], u[piece])], step, WITHIN)
        if lag.samples is not None:
            at.append(grid[piece].mean() - first)
            seen.append(-lag.samples * step)
    if len(at) < 2:
        return 0.0, 0.0
    slope = float(np.median([(b - a) / (q - p) for p, a in zip(at, seen) for q, b in zip(at, seen) if q > p]))
    return float(np.median(np.array(seen) - slope * np.array(at))), slope


def _on_one_epoch(name: str, time: np.ndarray, sent: np.ndarray, offset: float | str) -> tuple[np.ndarray, float]:
    """The inputs' stamps moved onto the time of the outputs, and by how much: 0 where they share it already."""
    given = 0.0 if offset == "auto" else float(offset)
    shared = min(time[-1], sent[-1] + given) - max(time[0], sent[0] + given)
    if len(sent) < 2 or shared >= OVERLAP * min(time[-1] - time[0], sent[-1] - sent[0]):
        return sent + given, given
    if offset != "auto":
        raise ValueError(f"{name}: the outputs last from {time[0]:.10g} to {time[-1]:.10g} s, the inputs from "
                         f"{sent[0] + given:.10g} to {sent[-1] + given:.10g} s of another clock; give clock_offset: "
                         f"auto, or s that are added to the inputs' stamps, about {time[0] - sent[0] - given:.10g} if "
                         "both began together")
    return sent + (time[0] - sent[0]), float(time[0] - sent[0])


def _known(time: np.ndarray, sent: np.ndarray) -> np.ndarray:
    """Where the input is known; the first command is taken to hold one interval before, as if the log began late."""
    between = np.diff(sent)
    usual, longest = (np.median(between), between.max()) if len(between) else (0.0, np.inf)
    return (time >= sent[0] - usual) & (time <= sent[-1] + HELD * longest)


def _held(time: np.ndarray, sent: np.ndarray, inputs: np.ndarray) -> np.ndarray:
    """(T, m), means from each sample to the next, or over one interval before a gap."""
    step = typical_step(time)
    ends = np.minimum(np.r_[time[1:], time[-1] + step], time + 1.5 * step)
    edges, place = np.unique(np.r_[time, ends], return_inverse=True)
    impulse = np.r_[np.zeros((1, inputs.shape[1])),
                    np.cumsum(mean_of_held(sent, inputs, edges) * np.diff(edges)[:, None], axis=0)]
    return (impulse[place[len(time):]] - impulse[place[:len(time)]]) / (ends - time)[:, None]


def _duration(seconds: float) -> str:
    return f"{1e3 * seconds:.4g} ms" if abs(seconds) < 10 else f"{seconds:.10g} s"


def _said(name: str, found: Shift, used: Shift, asked: bool, step: float) -> list[Note]:
    numbers = {"clock_offset_s": found.offset, "clock_drift_ppm": 1e6 * found.drift}
    if asked:
        said = (f"{_duration(used.offset)} and {1e6 * used.drift:.4g} ppm are added to the inputs' clock" if found.told
                else f"the motion does not tell the offset between the clocks; {_duration(used.offset)} were added to "
                "the inputs' clock")
        return [Note(name, "two clocks", said, "corrected" if found.told else "kept", (), numbers)]
    off = found.offset - used.offset if found.moved else 0.0
    if not (found.told and (abs(off) > SLOWEST * step or (found.drifted and abs(found.drift - used.drift) > 1e-6))):
        return []
    drifts = f", and drifts by {1e6 * found.drift:.4g} ppm" if found.drifted else ""
    return [Note(name, "two clocks", f"the inputs' clock is {_duration(abs(found.offset))} "
                 f"{'behind' if found.offset > 0 else 'ahead of'} the outputs'{drifts}, or the robot answers late; set "
                 f"clock_offset: auto, or {found.offset:.4g}{' with clock_drift: auto' if found.drifted else ''}, to "
                 "remove it", "kept", (), numbers)]
