"""The lag between the inputs and the outputs of a dataset: said where it is clear, removed on request."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ssmr_torch.recording_clocks.gaps import samples
from ssmr_torch.recording_clocks.held_inputs import mean_of_held
from ssmr_torch.recording_clocks.lag import Lag, lag_of
from ssmr_torch.recording_files.note import Note
from ssmr_torch.trajectory import Trajectory, TrajectoryDataset

logger = logging.getLogger(__name__)

SHORTEST = 10       # samples that must be left of a run
APART = 2           # samples by which the lag of a run must differ from that of most, beyond its own interval
DISTINCT = 1.5      # times its own error, at the lag of most
MOST = 40           # runs that are looked at one by one


def with_lag(dataset: TrajectoryDataset, rule: str | float = "keep", told: bool = True) -> TrajectoryDataset:
    """The dataset, its inputs shifted where the rule is "remove" or a number of s by which they stand late.

    "keep" changes nothing; a clear lag is said unless `told` is False. Shifted runs lose the samples without an input.
    Raises ValueError where a shift leaves too little of a run, and for "remove" where the recordings tell no lag.
    """
    step = dataset.timestep
    moving = [run for run in dataset if np.ptp(run.input, axis=0).max(initial=0.0) > 0]
    if rule == "keep" and not told:
        return dataset
    if rule not in ("keep", "remove"):
        lags = {run.name: float(rule) for run in moving}
        return _shifted(dataset, lags, [_note(moving, float(rule), None, step, "corrected")] if rule else [])
    others = _others(moving, step)
    odd = [run.name for run, _ in others]  # which would spoil what the rest has in common
    rest = [run for run in moving if run.name not in odd]
    found = _of([run for run in rest if run.split != "test"] or rest, step)
    if rule == "keep":
        notes = [_note(rest, found.samples * step, found, step, "kept")] if found.significant and rest else []
        notes += [_note([run], lag.samples * step, lag, step, "kept") for run, lag in others if lag.samples]
        return _noted(dataset, notes)
    if found.samples is None:
        raise ValueError("input_lag is remove, but these recordings do not tell a lag, since their inputs change too "
                         "slowly; give it in s, or record ten seconds of input steps")
    lags = {run.name: found.samples * step for run in rest if found.significant}
    lags |= {run.name: lag.samples * step for run, lag in others}
    notes = [_note(rest, found.samples * step, found, step, "corrected")] if lags and found.significant else []
    notes += [_note([run], lag.samples * step, lag, step, "corrected") for run, lag in others if lag.samples]
    return _shifted(dataset, lags, notes or [Note(_named(moving), "input lag", "input_lag is remove, but no lag is "
                                                  "clear; nothing was shifted", "kept", (), {"lag_s": 0.0})])


def shifted(run: Trajectory, lag: float) -> Trajectory:
    """The run with the inputs that stood `lag` s late (negative: early) where they act; samples without one are left
    out.

    input[k] becomes the mean of what was held from time[k] + lag to time[k+1] + lag.
    """
    step = run.timestep
    if abs(lag / step - round(lag / step)) < 1e-6:
        count = round(lag / step)
        first, last = max(0, -count), run.length - max(0, count)
        kept, inputs = np.arange(first, last), run.input[first + count:last + count]
    else:
        edges = np.r_[run.time, run.time[-1] + step] + lag
        kept = np.flatnonzero((edges[:-1] >= run.time[0] - 1e-9) & (edges[1:] <= run.time[-1] + step + 1e-9))
        inputs = mean_of_held(run.time, run.input, edges)[kept]
    if len(kept) < SHORTEST:
        raise ValueError(f"{run.name}: a lag of {lag:g} s leaves {len(kept)} of {run.length} samples; expected "
                         f"{SHORTEST} or more: correct input_lag, or leave the run out")
    return Trajectory(run.time[kept], run.observation[kept], inputs, run.kind, run.split, run.name)


def _of(runs: Sequence[Trajectory], step: float) -> Lag:
    return lag_of([(run.observation, run.input) for run in runs], step)


def _others(moving: Sequence[Trajectory], step: float) -> list[tuple[Trajectory, Lag]]:
    """Runs whose own lag is clearly another than that of most."""
    if not 2 <= len(moving) <= MOST:
        return []
    own = [(run, lag) for run, lag in ((run, _of([run], step)) for run in moving) if lag.samples is not None]
    usual = sorted((lag.samples for _, lag in own), key=abs)[(len(own) - 1) // 2] if own else 0
    return [(run, lag) for run, lag in own if abs(lag.samples - usual) >= APART and not
            lag.low - APART < usual < lag.high + APART
            and np.interp(usual, lag.lags, lag.error) > DISTINCT * lag.error.min()]


def _named(runs: Sequence[Trajectory]) -> str:
    names = [run.name for run in runs]
    return ", ".join(names) if len(names) <= 4 else f"{', '.join(names[:3])} and {len(names) - 3} more runs"


def _note(runs: Sequence[Trajectory], lag: float, found: Lag | None, step: float, done: str) -> Note:
    low, high = ((found.low - 1) * step, (found.high + 1) * step) if found is not None else (lag, lag)
    between = "" if found is None else (f" ({samples(abs(found.samples))}, between {1e3 * low:.3g} and "
                                        f"{1e3 * high:.3g} ms)")
    if done == "corrected":
        side = "late" if lag > 0 else "early"
        said = f"the inputs, {1e3 * abs(lag):.3g} ms {side}{between}, are shifted to where they act"
    elif lag > 0:
        said = (f"the inputs stand {1e3 * lag:.3g} ms{between} after the motion that they cause, as if logged late; "
                f"set input_lag: remove, or {lag:.4g}, to shift them")
    else:
        said = (f"the motion comes {-1e3 * lag:.3g} ms{between} after its inputs, by a delay of the robot or of the "
                f"log; set input_lag: remove, or {lag:.4g}, to shift them, or give the model delays")
    numbers = {"lag_s": lag} | ({} if found is None else {"low_s": low, "high_s": high})
    return Note(_named(runs), "input lag", said, done, (), numbers)


def _shifted(dataset: TrajectoryDataset, lags: dict[str, float], notes: list[Note]) -> TrajectoryDataset:
    runs = [shifted(run, lags[run.name]) if lags.get(run.name) else run for run in dataset]
    return _noted(replace(dataset, trajectories=tuple(runs)), notes)


def _noted(dataset: TrajectoryDataset, notes: list[Note]) -> TrajectoryDataset:
    if not notes:
        return dataset
    for note in notes:
        logger.warning("%s", note)
    said = [*dataset.provenance.get("notes", []), *(note.as_dict() for note in notes)]
    return replace(dataset, provenance=dataset.provenance | {"notes": said})
