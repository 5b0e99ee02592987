"""Identifies delay, lag, friction and rate limit of the actuators, by a cheap model's prediction errors."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import product

import numpy as np

from ssmr_torch.control.actuator import Actuator
from ssmr_torch.controller_design.predictive_chart import Form, Regression, Scaled, chart, held_error
from ssmr_torch.controller_design.recordings import Recordings

DELAYS = range(7)                                 # samples
LAGS = (0.0, 0.5, 1.0, 2.0, 3.0, 4.0, 6.0)        # samples
FRICTIONS = (("play", 0.02), ("play", 0.06), ("friction", 0.06), ("friction", 0.15))
FINE = {"play": (0.005, 0.01, 0.015, 0.02, 0.03, 0.04, 0.05, 0.06, 0.08, 0.1, 0.13),
        "friction": (0.02, 0.03, 0.04, 0.05, 0.06, 0.07, 0.08, 0.09, 0.1, 0.12, 0.15, 0.2, 0.25)}
RATES = (40.0, 20.0, 10.0, 5.0)                   # input ranges per s
GAIN = 0.97          # an actuator is accepted if its error is below this times the error without an actuator
STEPS = 20           # samples of the predictions whose errors are compared
MORE_STATES, WINDOW, FUTURE = 6, 4, 10
ROWS = 5000
ROUNDS = 10          # largest number of rounds in which delay and lag, or friction, move to a better neighbour


@dataclass(frozen=True, eq=False)
class Identification:
    """actuator.   error, plain: held-out errors with it and without an actuator, as a share of the reach.
    by_delay, by_lag, by_friction: errors over one setting, with the others as found: {value: error}; delay in samples,
    lag in s, friction as ("play", half) or ("friction", μθ).
    """

    actuator: Actuator
    error: float
    plain: float
    by_delay: dict[int, float]
    by_lag: dict[float, float]
    by_friction: dict[tuple[str, float], float]


class _Search:
    """Errors of a linear or bilinear model with few coordinates. Its chart has no past inputs, which would hide a lag.
    """

    def __init__(self, recordings: Recordings):
        self.recordings = recordings
        keep = tuple(recordings.tracked)
        most = WINDOW * recordings.output_dim
        self.form = Form(keep, WINDOW, min(len(keep) + MORE_STATES, most), 2, 0, 1e-6, past_inputs=False)
        self.columns = list(recordings.tracked)
        self.errors: dict[Actuator, float] = {}

    def error(self, actuator: Actuator) -> float:
        if actuator not in self.errors:
            acted = Scaled(self.recordings.under(actuator), FUTURE, ROWS)
            form = self.form
            regression = Regression(acted, chart(acted, form.keep, form.window, False), form)
            # A bilinear model may diverge where the linear one does not; then the linear one counts.
            self.errors[actuator] = min(held_error(regression.errors(regression.dynamics(degree, form.ridge), STEPS),
                                                   self.columns) for degree in (1, 2))
        return self.errors[actuator]

    def least(self, candidates) -> Actuator:
        return min(candidates, key=self.error)


def identify(recordings: Recordings, *, say: Callable[[str], None] = lambda line: None) -> Identification:
    """Search delay and lag on a grid, together with friction, which a lag would hide; then each setting alone.

    The actuator is accepted only if it makes the prediction error on held-out runs more than 3 % smaller than without
    an actuator. The same holds for each of its parts.
    """
    search = _Search(recordings)
    none = Actuator(recordings.timestep, tuple(recordings.input_range.tolist()))
    best = search.least(_over_delay_and_lag(none))
    if search.error(best) > GAIN * search.error(none):
        best = none
    rubbing = [replace(best, **{name: value}) for name, value in FRICTIONS
               if name == "play" or (recordings.bounds[0] >= 0).all()]
    for start in rubbing:
        near = search.least(_near(start))
        if search.error(near) < GAIN * search.error(best):
            best = near
    for _ in range(0 if best.trivial else ROUNDS):
        before, best = best, search.least([best, *_near(best), *_other_frictions(best)])
        if best == before:
            break
    best = _needed(search, best)
    limited = search.least([replace(best, rate=rate) for rate in RATES])
    if search.error(limited) < GAIN * search.error(best):
        best = limited
    found = Identification(best, search.error(best), search.error(none), *_profiles(search, best, recordings))
    say(f"actuator: {in_words(best)}; held-out error {100 * found.error:.3g} % of the reach, "
        f"{100 * found.plain:.3g} % without an actuator")
    return found


def _needed(search: _Search, best: Actuator) -> Actuator:
    """The actuator without the parts that hardly reduce the error; they are removed one by one."""
    for name, nothing in (("lag", 0.0), ("friction", 0.0), ("play", 0.0), ("delay", 0)):
        without = replace(best, **{name: nothing})
        if GAIN * search.error(without) <= search.error(best):
            best = without
    return best


def _over_delay_and_lag(actuator: Actuator) -> list[Actuator]:
    return [replace(actuator, delay=delay, lag=lag * actuator.timestep) for delay, lag in product(DELAYS, LAGS)]


def _near(actuator: Actuator) -> list[Actuator]:
    """Neighbours in delay and lag."""
    place = int(np.argmin([abs(lag * actuator.timestep - actuator.lag) for lag in LAGS]))
    lags = [LAGS[k] for k in range(max(0, place - 2), min(len(LAGS), place + 2))]
    delays = [actuator.delay + k for k in (-1, 0, 1) if actuator.delay + k >= 0]
    return [replace(actuator, delay=delay, lag=lag * actuator.timestep) for delay, lag in product(delays, lags)]


def _other_frictions(actuator: Actuator) -> list[Actuator]:
    return [replace(actuator, **{name: value}) for name, values in FINE.items() if getattr(actuator, name) > 0
            for value in values if 0.4 < value / getattr(actuator, name) < 2.5]


def _profiles(search: _Search, best: Actuator, recordings: Recordings):
    delays = {delay: search.error(replace(best, delay=delay)) for delay in range(max(DELAYS[-1], best.delay + 2) + 1)}
    lags = {lag * best.timestep: search.error(replace(best, lag=lag * best.timestep)) for lag in LAGS}
    plain = replace(best, play=0.0, friction=0.0)
    names = ["play", "friction"] if (recordings.bounds[0] >= 0).all() else ["play"]
    frictions = {(name, value): search.error(replace(plain, **{name: value} if value else {}))
                 for name in names for value in (0.0, *FINE[name][::3])}
    return delays, lags, frictions


def in_words(actuator: Actuator) -> str:
    """The parts of an actuator in words; "none" where commands act directly."""
    parts = [f"delay {1e3 * actuator.delay * actuator.timestep:g} ms"] if actuator.delay else []
    parts += [f"lag {1e3 * actuator.lag:.3g} ms"] if actuator.lag else []
    parts += [f"play ±{100 * actuator.play:.3g} % of the input range"] if actuator.play else []
    parts += [f"cable friction μθ = {actuator.friction:.3g}"] if actuator.friction else []
    parts += [f"at most {actuator.rate:g} input ranges per s"] if actuator.rate else []
    parts += [f"gains {', '.join(f'{g:.3g}' for g in actuator.gain)}"] if actuator.gain else []
    if actuator.offset:
        parts.append(f"offsets {', '.join(f'{100 * each:.2g}' for each in actuator.offset)} % of the range")
    return ", ".join(parts) or "none, commands act directly"
