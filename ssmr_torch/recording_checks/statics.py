"""Checks of the static behaviour: drift, friction and neutral input, from motion that the slow modes do not explain."""

from __future__ import annotations

import numpy as np

from ssmr_torch.recording_checks.context import Recorded
from ssmr_torch.recording_checks.finding import GOOD, LOOK, UNTOLD, Finding, millimetres
from ssmr_torch.recording_estimates.response import response
from ssmr_torch.trajectory import Trajectory

CERTAIN = 4.0       # standard errors
MATTERS = 0.01      # share of the reach above which an effect matters
DOUBTFUL = 0.05     # largest uncertainty, as a share of the reach, of a number that is reported
TURNS = 0.05        # share of an input's range by which it must move back to count as turned
SLOW = 0.15         # share of an input's range that it may change in a period of the slowest mode
REVERSALS = 6
UNEXPLAINED = ("The slow modes and inputs explain too little of the motion. Record longer runs or slower inputs, or "
               "return to the same inputs more often.")


def _constants(run: Trajectory, number: int, count: int) -> dict:
    own = np.zeros((run.length, count))
    own[:, number] = 1.0
    slope = np.zeros((run.length, count))
    slope[:, number] = np.linspace(-0.5, 0.5, run.length)
    return {"constant": own, "slope": slope}


def drift(recorded: Recorded) -> Finding:
    """Trend of the position within each controlled run, and from run to run, that the inputs do not explain."""
    subject, runs = "drift", [run for run in recorded.of("train", "controlled")]
    found = response(runs, recorded.modes, _constants, recorded.delay.samples or 0) if runs else None
    if found is None:
        return Finding(subject, UNTOLD, "No controlled training run is long compared with the slow modes.",
                       "Record a run of half a minute that begins and ends at rest.", {"within_m": None})
    sizes, errors = found.coefficients["slope"], found.errors["slope"]
    within, sure = np.linalg.norm(sizes, axis=1), CERTAIN * np.linalg.norm(errors, axis=1)
    offsets, doubt = found.coefficients["constant"], np.linalg.norm(found.errors["constant"], axis=1)
    apart = np.linalg.norm(offsets - np.median(offsets, axis=0), axis=1)
    numbers = {"within_m": float(within.max()), "within_error_m": float(sure.max() / CERTAIN),
               "between_m": float(apart.max()), "between_error_m": float(doubt.max())}
    between = f" and by {millimetres(apart.max())} (± {millimetres(doubt[apart.argmax()])}) between runs"
    least_sure = millimetres(sure[within.argmax()] / CERTAIN)
    said = (f"The position drifts by {millimetres(within.max())} (± {least_sure}) within a "
            f"run{between if len(within) > 1 else ''}.")
    least, curves = MATTERS * recorded.reach, {"slopes": sizes, "errors": errors}
    if (within > np.maximum(sure, least)).any() or (apart > np.maximum(2 * CERTAIN * doubt, least)).any():
        return Finding(subject, LOOK, said, "Measure each run from the rest position at its start, and let the camera "
                                            "and "
                       "the robot warm up.", numbers, curves)
    if sure.max() > DOUBTFUL * recorded.reach:
        return Finding(subject, UNTOLD, said, UNEXPLAINED, numbers, curves)
    return Finding(subject, GOOD, said, "", numbers, curves)


def neutral(recorded: Recorded) -> Finding:
    """Whether the robot rests at zero for zero input: the displacement of the response at u = 0."""
    subject = "neutral input"
    runs = recorded.of("train", "controlled")
    u = np.concatenate([run.input for run in recorded.training or recorded.runs])
    signed = int(((u.min(axis=0) < 0) & (u.max(axis=0) > 0)).sum())
    resting = [np.abs(run.input).max() for run in recorded.of("train", "decay")]
    numbers = {"signed_inputs": signed, "decays_under_m": float(max(resting, default=0.0))}
    size = np.abs(u).max() or 1.0
    if resting and max(resting) > MATTERS * size:
        return Finding(subject, LOOK, f"The decays have inputs of up to {max(resting):.3g}, not zero.", "Subtract the "
                       "input at rest from all inputs, or measure from the rest position at zero input.", numbers)
    found = response(runs, recorded.modes, lambda run, *_: {"constant": np.ones((run.length, 1))},
                     recorded.delay.samples or 0) if runs else None
    if found is None:
        return Finding(subject, UNTOLD, f"No controlled run is long enough; {signed} of {u.shape[1]} inputs are "
                                        "signed.",
                       "Record a controlled run that begins at rest with zero input.", numbers)
    offset, error = found.coefficients["constant"][0], found.errors["constant"][0]
    away, doubt = float(np.linalg.norm(offset)), float(np.linalg.norm(error))
    shift = -np.linalg.lstsq(found.gain.T, offset, rcond=0.05)[0]
    numbers |= {"offset_m": away, "offset_error_m": doubt, "neutral_input": shift.tolist()}
    said = (f"Without input the robot rests {millimetres(away)} (± {millimetres(doubt)}) from zero; {signed} of "
            f"{u.shape[1]} inputs take both signs.")
    if away > max(CERTAIN * doubt, 3 * MATTERS * recorded.reach):
        return Finding(subject, LOOK, said, "State the position at zero input as rest, or subtract the input at which "
                       f"the robot rests, about {np.round(shift, 3).tolist()}.", numbers)
    if CERTAIN * doubt > DOUBTFUL * recorded.reach:
        return Finding(subject, UNTOLD, said, UNEXPLAINED, numbers)
    return Finding(subject, GOOD, said, "", numbers)


def turned(u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(T, m), last direction, −1 or 1, in which each input moved by more than `TURNS` of its range; and (T, m), whether
    it is certain. It is not certain while an input turns, and for the same time afterwards.
    """
    directions, clear = np.zeros_like(u), np.ones(u.shape, dtype=bool)
    for column in range(u.shape[1]):
        signal, step = u[:, column], TURNS * np.ptp(u[:, column])
        best, direction = 0, 0.0
        for k in range(len(signal) if step > 0 else 0):
            beyond = signal[k] - signal[best]
            if direction and beyond * direction >= 0:
                best = k
            elif abs(beyond) > step:
                direction = np.sign(beyond)
                clear[best:2 * k - best, column] = False
                best = k
            directions[k, column] = direction
    return directions, clear


def friction(recorded: Recorded) -> Finding:
    """Friction as the width of the hysteresis loop: the effect of the direction of the last motion on the position."""
    subject, runs = "friction", recorded.of("train", "controlled")
    if recorded.modes.memory is None or not runs:
        return Finding(subject, UNTOLD, "The runs show no slow mode, or there is no controlled run.",
                       "Record inputs that go slowly up and down again.", {"width": None})
    period = recorded.modes.memory
    slow = [run for run in runs if _slow_reversals(run, period) >= REVERSALS]
    lags = not _one_speed(slow)  # at one speed a lag looks like a loop

    def more(run: Trajectory, *_) -> dict:
        speed = {"speed": np.gradient(run.input, run.timestep, axis=0)} if lags else {}
        return {"constant": np.ones((run.length, 1)), "direction": turned(run.input)[0]} | speed

    found = response(slow, recorded.modes, more, recorded.delay.samples or 0,
                     where=lambda run: turned(run.input)[1].all(axis=1)) if slow else None
    if found is None:
        return Finding(subject, UNTOLD, f"No input moves in one direction for {period:.2g} s, and back, often "
                       "enough.",
                       "Record inputs that go slowly up and down again.", {"width": None})
    loops, errors = 2 * found.coefficients["direction"], 2 * found.errors["direction"]
    sizes, doubts = np.linalg.norm(loops, axis=1), np.linalg.norm(errors, axis=1)
    worst = int(np.argmax(sizes - CERTAIN * doubts))
    width, doubt = float(sizes[worst] / recorded.reach), float(doubts[worst] / recorded.reach)
    numbers = {"width": width, "width_error": doubt, "widths_m": sizes.tolist()}
    said = (f"The paths for rising and falling input are {millimetres(sizes[worst])} apart, {100 * width:.2g} % (± "
            f"{100 * doubt:.1g} %) of the reach{'' if lags else '; at one speed, part of it may be a lag'}.")
    if width > max(CERTAIN * doubt, 2 * MATTERS):
        return Finding(subject, LOOK, said, "No model of the inputs alone explains this: give the model delays, record "
                       "more runs that reach the same inputs from both sides, or reduce the friction.", numbers)
    if CERTAIN * doubt > DOUBTFUL:
        least = f"{100 * CERTAIN * doubt:.2g} %" if CERTAIN * doubt < 1 else "all"
        return Finding(subject, UNTOLD, f"A loop smaller than {least} of the reach would not be visible.", UNEXPLAINED,
                       numbers)
    return Finding(subject, GOOD, said, "", numbers)


def _one_speed(runs: list[Trajectory]) -> bool:
    """Whether inputs move up and down at one speed, so that their speed and their direction are the same signal."""
    if not runs:
        return False
    for column in range(runs[0].input.shape[1]):
        pairs = []
        for run in runs:
            directions, clear = turned(run.input)
            speed = np.gradient(run.input[:, column])
            pairs.append(np.column_stack([speed, directions[:, column]])[clear[:, column]])
        speed, direction = np.concatenate(pairs).T
        if np.std(speed) > 0 and np.std(direction) > 0 and abs(np.corrcoef(speed, direction)[0, 1]) > 0.97:
            return True
    return False


def _slow_reversals(run: Trajectory, period: float) -> int:
    """How often an input turns after it moved in one direction for `period` s; the smallest number of all inputs."""
    directions = turned(run.input)[0]
    counts = []
    for column in directions.T:
        turns = np.flatnonzero(np.diff(column)) + 1
        lasting = np.diff(np.concatenate([turns, [len(column)]])) * run.timestep
        counts.append(int((lasting > period).sum()))
    return max(counts, default=0)
