"""Small steps in each input, one by one: what moves, in which direction, how far, when, and how long it takes."""

from __future__ import annotations

from dataclasses import asdict, dataclass

import numpy as np

from ssmr_torch.commissioning.safety_guard import GuardedPlant

FIRST, LAST = 1 / 32, 1 / 2      # of the way to the farther bound: the smallest and the largest step
SEEN, LOUD = 6.0, 30.0           # standard deviations of noise: an answer; one from which times can be told
NEAR = 0.5                       # of the displacement limit, beyond which no step is doubled
BEFORE, HOLD = 0.5, 2.0          # s of quiet before a step; s that it is held, and that the way back is
LEFT = 4.0                       # the same, from which an answer has left the noise
SETTLED = 0.05                   # of the final value
FLOOR = 1e-6                     # m, of noise that is too small to be measured


@dataclass(frozen=True)
class StepAnswer:
    """What the outputs did after the largest step of one input.

    size: of the step, input unit, with its sign.   moved_m (p,): final displacement.   loudness: of the largest one, in
    standard deviations of its noise.   output: name of that which moved most; None: nothing moved.
    delay_s: from the command until the answer left the noise, beyond the one timestep that every sample has; the true
    delay is at most that.
    settling_s: until the answer stays within 5 % of its end; None: longer than the step was held.
    time_s (K,), trace_m (K, p): the answer from the command on, from where it began.
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
    """One `StepAnswer` for each input; each begins from rest, and doubles its steps until the answer is loud.

    noise_std: (p,) m.   report: called with each answer as soon as it is there.
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
    """s until two samples in a row left the noise; row 0 is the first sample that can feel the step.

    What is watched is the motion towards the end of the answer, all outputs together, each by its noise.
    """
    towards = trace @ (moved / noise ** 2) / np.linalg.norm(moved / noise)  # of unit noise
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
        raise ValueError(f"none of {len(rows)} measurements arrived; expected most of them: see why the sensors are "
                         "silent")
    return np.nanmean(rows, axis=0)
