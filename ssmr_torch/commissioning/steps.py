"""Small steps in each input, one input at a time: which output moves, how far, with which delay and settling time."""

from __future__ import annotations

from dataclasses import asdict, dataclass

import numpy as np

from ssmr_torch.commissioning.safety_guard import GuardedPlant

FIRST, LAST = 1 / 32, 1 / 2      # of the way to the farther bound: the smallest and the largest step
SEEN, LOUD = 6.0, 30.0           # times the noise: an answer is seen; an answer is large enough to measure times
NEAR = 0.5                       # of the displacement limit: beyond it no step is doubled
BEFORE, HOLD = 0.5, 2.0          # s at rest before a step; s that the step, and then the way back, is held
LEFT = 4.0                       # times the noise: beyond it an answer has begun
SETTLED = 0.05                   # of the final value
FLOOR = 1e-6                     # m: noise below this is taken as this


@dataclass(frozen=True)
class StepAnswer:
    """The motion of the outputs after the largest step of one input.

    size: of the step, input unit, with its sign.   moved_m: (p,), final displacement.   loudness: of the output that
    moved most, in standard deviations of its noise.   output: name of that output; None: nothing moved.
    delay_s: time from the command until the answer is larger than the noise, without the one timestep that every sample
    needs; the true delay is not longer.   settling_s: time until the answer stays within 5 % of its end; None: it takes
    longer than the step is held.
    time_s (K,), trace_m (K, p): the answer since the command, relative to its start.
    """

    input: str
    size: float
    moved_m: list
    loudness: float
    output: str | None
    delay_s: float | None
    settling_s: float | None
    time_s: list
    trace_m: list

    @property
    def gain(self) -> np.ndarray:
        """(p,) m per input unit."""
        return np.array(self.moved_m) / self.size

    def as_dict(self) -> dict:
        return asdict(self)


def measure_steps(plant: GuardedPlant, noise_std: np.ndarray, seed: int = 0,
                  report=lambda answer: None) -> list[StepAnswer]:
    """One `StepAnswer` for each input. Each starts from rest, with steps that are doubled until the answer is large.

    noise_std: (p,) m.   report: called with each answer as soon as it is known.
    """
    answers = []
    for place in range(len(plant.input_names)):
        answers.append(_answer(plant, place, np.maximum(noise_std, FLOOR), seed))
        report(answers[-1])
    return answers


def _answer(plant: GuardedPlant, place: int, noise: np.ndarray, seed: int) -> StepAnswer:
    neutral, (lower, upper) = plant.neutral_input, plant.input_bounds
    up, down = upper[place] - neutral[place], neutral[place] - lower[place]
    room = up if up >= down else -down
    plant.reset(seed)
    _hold(plant, neutral, BEFORE)
    share, largest = FIRST, 0.0
    while True:
        u = neutral.copy()
        u[place] += share * room
        base = _middle(_hold(plant, neutral, BEFORE))
        trace = _hold(plant, u, HOLD) - base
        _hold(plant, neutral, HOLD)
        moved = _middle(trace[3 * len(trace) // 4:])
        loudness = float((np.abs(moved) / noise).max())
        largest = max(largest, float(np.nanmax(np.abs(trace + base))))
        if loudness >= LOUD or 2 * share > LAST or 2 * largest > NEAR * plant.card.displacement_limit:
            return _judged(plant, place, share * room, trace, moved, noise)
        share *= 2


def _judged(plant: GuardedPlant, place: int, size: float, trace: np.ndarray, moved: np.ndarray,
            noise: np.ndarray) -> StepAnswer:
    loudness = float((np.abs(moved) / noise).max())
    column = int(np.argmax(np.abs(moved)))
    alive = loudness >= SEEN
    return StepAnswer(plant.input_names[place], float(size), moved.tolist(), loudness,
                      plant.output_names[column] if alive else None,
                      _delay(trace, moved, noise, plant.timestep) if alive else None,
                      _settling(trace[:, column], moved[column], noise[column], plant.timestep) if alive else None,
                      (plant.timestep * np.arange(1, len(trace) + 1)).tolist(), np.nan_to_num(trace).tolist())


def _delay(trace: np.ndarray, moved: np.ndarray, noise: np.ndarray, timestep: float) -> float | None:
    """Time in s until two samples in a row are beyond the noise; row 0 is the first sample that the step can change.

    The motion towards the end of the answer is judged, all outputs together, each relative to its noise.
    """
    towards = trace @ (moved / noise ** 2) / np.linalg.norm(moved / noise)  # its noise has standard deviation 1
    out = np.abs(towards) > max(LEFT, 0.01 * np.linalg.norm(moved / noise))
    both = out[:-1] & out[1:]
    return float(timestep * np.argmax(both)) if both.any() else None


def _settling(trace: np.ndarray, end: float, noise: float, timestep: float) -> float | None:
    off = np.flatnonzero(np.abs(trace - end) > max(SETTLED * abs(end), 4 * noise))
    if not len(off):
        return 0.0
    return float(timestep * (off[-1] + 1)) if off[-1] < 0.75 * len(trace) else None


def _hold(plant: GuardedPlant, u: np.ndarray, duration: float) -> np.ndarray:
    return np.array([plant.step(u) for _ in range(max(4, round(duration / plant.timestep)))])


def _middle(rows: np.ndarray) -> np.ndarray:
    if not np.isfinite(rows).all(axis=1).any():
        raise ValueError(f"none of {len(rows)} measurements arrived; expected most of them: check the sensors and the "
                         "connection")
    return np.nanmean(rows, axis=0)
