"""Chooses observer and weights: margins along the recordings come first, then loops against the disturbed twin."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np

from ssmr_torch.control.actuator import Actuator
from ssmr_torch.control.mpc import ModelPredictiveController
from ssmr_torch.controller_design.linear_loop import Margins, Point, Weights
from ssmr_torch.controller_design.model_choice import ChosenModel, points_along
from ssmr_torch.controller_design.noises import Likelihood, Noises, Observer
from ssmr_torch.controller_design.recordings import Recordings
from ssmr_torch.controller_design.settings_from_design import settings_of
from ssmr_torch.controller_design.twin import CASES, LOST, WIDER, Case, Twin, recorded_motion, tracking_error
from ssmr_torch.tasks.references import Task

OF_STATES, OF_SENSOR = (1.0, 0.1, 0.01), (1.0, 4.0)
# Change of a disturbance per sample, as a share of the sensors' noise. The recordings do not show it, as they have no
# payload. Its inverse is about the number of samples in which the observer finds a payload.
OF_DISTURBANCE = (0.003, 0.01, 0.03, 0.1, 0.3)
# A change of 1.6 % of an input's range in a sample costs at least as much as a tracking error of the tolerance. With
# smaller weights loops look better against a twin, but lost the reference where the robot was not as recorded.
MOVES = (4e3, 1.3e4, 4e4, 1.3e5, 4e5)
TOLERANCE, HORIZON = 1e-3, 10
# The input weight is this share of the move weight, so that directions which tracking leaves free settle within ten
# samples. At most MOST: it then biases tracking by 4e-5 of the reach for an input that is off by its range.
OF_MOVE, MOST = 0.01, 40.0
POINTS = 4           # number of points along the recordings with margins
EXTRA_DELAY = 0.06   # s of extra delay that a loop must tolerate, but at most `SHARE_OF_LOOP` times its own
SHARE_OF_LOOP = 3.0  # times one sample and the actuator's delay and lag
PEAK = 2.0           # largest sensitivity
SCREENED_BY = (2, 3)  # cases of the twin for a first trial of the best design of every disturbance and move weight
LESS_FAR = (0.5, 0.25)  # factors of the recorded motion, where even the undisturbed loop is lost along it
TRIES = 8            # number of designs that are tried in all cases
FAR = 1.25           # times the smallest error out of reach: the largest error that a design may have there
DRIFT = 0.01         # of the sensors' noise: smallest change of a disturbance per sample in the predicted error


@dataclass(frozen=True, eq=False)
class Design:
    """One observer and its weights.   predicted: rms tracking error of the linear loop, as a share of the reach.
    against_twin: rms tracking error for each case, as a share of the reach; infinite for a lost loop.
    factors: of the noises found from the recordings: states and inputs; disturbance, of the sensor; sensor.
    """

    factors: tuple[float, float, float]
    weights: Weights
    observer: Observer
    margins: Margins
    predicted: float
    against_twin: dict[str, float]


@dataclass(frozen=True, eq=False)
class WeightSearch:
    """best: the chosen design.   stable, safe: number of stable designs, and of those with all margins.   count: of all
    designs.   extra: samples of extra delay that they had to tolerate.   judged_by: "twin", or "margins" where every
    loop against the twin was lost.   points: of the margins.
    """

    best: Design
    count: int
    stable: int
    safe: int
    extra: int
    judged_by: str
    points: list[Point]


class _Candidates:
    """All designs of the grid, with their margins."""

    def __init__(self, model, actuator: Actuator, acted: Recordings, likelihood: Likelihood, noises: Noises):
        z, u = points_along(model, acted, POINTS)
        self.points = [Point(model, actuator, z[k], u[k], likelihood.free, acted.reach, acted.input_range,
                             acted.tracked) for k in range(POINTS)]
        self.likelihood, self.noises = likelihood, noises
        self.truth = likelihood.observer(replace(noises, disturbance=max(noises.disturbance, DRIFT * noises.sensor)))
        own = 1 + actuator.delay + actuator.lag / actuator.timestep
        allowed = min(EXTRA_DELAY / actuator.timestep, SHARE_OF_LOOP * own)
        self.extra = max(1, int(allowed))

    def all(self, tell: Callable[[int], None]) -> list[Design]:
        """Every design of the grid with its margins; tell(1) is called after each."""
        found = []
        for states, disturbance, sensor in product(OF_STATES, OF_DISTURBANCE, OF_SENSOR):
            try:
                observer = self.likelihood.observer(replace(self.noises.times(states, states, 1.0, sensor),
                                                            disturbance=disturbance * self.noises.sensor))
            except (np.linalg.LinAlgError, ValueError):
                continue
            for move in MOVES:
                weights = Weights(HORIZON, TOLERANCE, min(OF_MOVE * move, MOST), move)
                margins = self._margins(observer, weights)
                found.append(Design((states, disturbance, sensor), weights, observer, margins, np.inf, {}))
                tell(1)
        return found

    def _margins(self, observer: Observer, weights: Weights) -> Margins:
        worst = Margins()
        for point in self.points:
            worst = worst.worse(point.margins(observer, weights, self.extra))
            if worst.nominal >= 1.0:
                break
        return worst

    def predicted(self, design: Design) -> float:
        variances = [point.predicted_variance(design.observer, self.truth, design.weights) for point in self.points[:2]]
        return float(np.sqrt(np.mean(variances)))


def choose_weights(chosen: ChosenModel, actuator: Actuator, acted: Recordings, likelihood: Likelihood, noises: Noises,
                   *, task: Task, tell: Callable[[int], None] = lambda steps: None,
                   say: Callable[[str], None] = lambda line: None) -> WeightSearch:
    """Among the designs with margins at every point, the one with the least error against the disturbed twin.

    The twin is run undisturbed and disturbed, along a recorded motion and along one that is out of reach, where a good
    design stays close and calm. Where no design has all margins, the most robust ones are tried. Where every loop
    against the twin is lost, the predicted error decides. The report says so in both cases.
    """
    candidates = _Candidates(chosen.model, actuator, acted, likelihood, noises)
    designs = candidates.all(tell)
    stable = [each for each in designs if each.margins.nominal < 1.0]
    if not stable:
            raise ValueError(f"none of {len(designs)} observers and weights makes a stable loop with this model at "
                             f"{len(candidates.points)} points of the recordings. The model's held-out error is "
                             f"{100 * chosen.error:.3g} % of the reach. Record longer or more slowly, or use another "
                             "model")
    safe = [each for each in stable if each.margins.shortfall(PEAK) < 1.0]
    say(f"designs: {len(stable)} of {len(designs)} stable, {len(safe)} with all margins "
        f"({1e3 * candidates.extra * actuator.timestep:g} ms more delay, half and twice the gain, sensitivity "
        f"{PEAK:g})")
    picked = _picked([replace(each, predicted=candidates.predicted(each)) for each in safe or stable], bool(safe))
    trial = _Trial(chosen, actuator, acted, likelihood, noises, task, tell)
    tried = trial.all(picked)
    kept = [each for each in tried if each.against_twin and np.isfinite(list(each.against_twin.values())).any()]
    best = min(kept, key=_score) if kept else picked[0]
    judged = "twin" if kept else "margins"
    say(f"weights: move {best.weights.move:g}, observer × {best.factors}; predicted error "
        f"{100 * best.predicted:.3g} % of the reach; against the twin "
        + ", ".join(f"{name} {100 * error:.3g} %" for name, error in best.against_twin.items()))
    return WeightSearch(best, len(designs), len(stable), len(safe), candidates.extra, judged,
                        candidates.points)


def _picked(designs: list[Design], safe: bool) -> list[Design]:
    """The best design for every change of the disturbance and move weight: by predicted error where all margins hold,
    else by the margins.
    """
    best: dict[tuple[float, float], Design] = {}
    for each in sorted(designs, key=lambda each: each.predicted if safe else each.margins.shortfall(PEAK)):
        best.setdefault((each.factors[1], each.weights.move), each)
    return list(best.values())


def _score(design: Design) -> float:
    """Mean logarithm of the errors; a lost loop counts as the whole reach."""
    return float(np.mean(np.log(np.minimum(list(design.against_twin.values()), 1.0))))


class _Trial:
    """Loops of designs against the disturbed twin, along a recorded motion and along one that is out of reach."""

    def __init__(self, chosen: ChosenModel, actuator: Actuator, acted: Recordings, likelihood: Likelihood,
                 noises: Noises, task: Task, tell: Callable[[int], None]):
        self.chosen, self.actuator, self.acted, self.likelihood = chosen, actuator, acted, likelihood
        self.noises, self.tell = noises, tell
        self.motion = recorded_motion(acted, task.tracked)
        self.names = task.tracked
        self.far = recorded_motion(acted, task.tracked, scale=WIDER)

    def errors(self, design: Design, path: Task, cases: Sequence[Case], lost: float = LOST) -> list[float]:
        """The errors of one controller along a path, in each of these cases."""
        acted, found = self.acted, []
        controller = ModelPredictiveController(
            self.chosen.model, path, acted.bounds, timestep=acted.timestep, output_names=acted.output_names,
            settings=settings_of(design.weights, design.observer, self.actuator, acted, self.likelihood))
        for case in cases:
            twin = Twin(self.chosen.twin, self.actuator, acted, self.noises, case)
            found.append(tracking_error(twin, controller, path, acted.tracked, lost=lost))
            self.tell(1)
        return found

    def disturbed(self, design: Design, cases: Sequence[Case] = CASES) -> Design:
        """The design with its errors against the twin in these cases. Known errors are not computed again."""
        known = design.against_twin
        new = [case for case in cases if case.name not in known]
        known = known | dict(zip((case.name for case in new), self.errors(design, self.motion, new)))
        return replace(design, against_twin={case.name: known[case.name] for case in cases})

    def _within_reach(self, design: Design) -> None:
        """Choose a smaller motion where the undisturbed loop is lost along the recorded one.

        A recorded motion may swing further than the robot can stay.
        """
        for scale in LESS_FAR:
            if np.isfinite(self.errors(design, self.motion, CASES[:1])[0]):
                return
            self.motion = recorded_motion(self.acted, self.names, scale=scale)

    def all(self, designs: list[Design]) -> list[Design]:
        """The best designs that stay close to a motion out of reach, with their errors."""
        self._within_reach(designs[0])
        screened = [self.disturbed(each, [CASES[k] for k in SCREENED_BY]) for each in designs]
        designs = sorted(screened, key=_score)[:TRIES]
        far = [self.errors(each, self.far, CASES[:1], np.inf)[0] for each in designs]
        # Where the twin itself diverges out of reach, it says nothing about the designs.
        allowed = FAR * min(far) if min(far) < 1.0 else np.inf
        return [self.disturbed(each) for each, error in zip(designs, far) if not error > allowed]
