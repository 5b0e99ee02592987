"""Claims about observers, late and missing measurements, and what they cost."""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from scipy.linalg import solve_discrete_are

from ssmr_torch.closed_loop.simulation import simulate
from ssmr_torch.control.kalman_observers import KalmanObserver
from ssmr_torch.control.mpc import ModelPredictiveController
from ssmr_torch.status import Status
from ssmr_torch.tasks.references import Task, figure_eight

HOLD = Task("hold", 6.0, (0, 1), lambda time: np.tile([0.006, -0.004], (len(time), 1)))
NOISE = 3e-5


def seen_in_part(model):
    """Of the three coordinates and their rates the coordinates are measured: two samples make the state."""
    h = model.timestep
    newest = np.hstack([np.eye(3), np.zeros((3, 3))])
    omega = np.diag(model.dynamics[:3, 3:6])
    older = np.hstack([np.eye(3), -h * np.diag(omega)])
    window = np.vstack([older, newest])
    return replace(model, chart=np.linalg.inv(window), parametrization=window, output_dim=3, delays=1)


class LoadedPlant:
    """Oscillators with a wrong stiffness under a constant load, of which the coordinates are measured."""

    def __init__(self, trial, load=0.12, stiffness=1.05):
        model = trial.oscillators(degree=2)
        dynamics = model.dynamics.copy()
        dynamics[3:, :3] *= stiffness
        self.inner = trial.ModelPlant(replace(model, dynamics=dynamics), trial.BOUNDS + [[-1.0], [1.0]])
        self.load, self.timestep, self.input_bounds = load * np.array([1.0, 0.0, 0.0, 0.5]), 0.01, trial.BOUNDS
        self.name, self.input_unit = "loaded", "N"
        self.output_names, self.input_names, self.rest = ("x", "y", "z"), self.inner.input_names, np.zeros(3)

    @property
    def displacement(self):
        return self.inner.displacement[:3]

    def reset(self, seed=None):
        return self.inner.reset()[:3]

    def step(self, input):
        return self.inner.step(np.clip(input, *self.input_bounds) + self.load)[:3]


def held(trial, observer, **settings):
    model = seen_in_part(trial.oscillators(degree=2))
    controller = ModelPredictiveController(model, HOLD, trial.BOUNDS, observer=observer, first_iterations=3,
                                           input_weight=36.0, **settings)
    record = simulate(LoadedPlant(trial), controller, HOLD, noise_std=NOISE)
    return np.abs(record.error[-200:].mean(0)).max(), controller


@pytest.mark.parametrize("disturbance", ["output", "input"])
@pytest.mark.parametrize("extended", [False, True])
def test_a_load_and_a_wrong_stiffness_leave_no_steady_error_with_an_observer(trial, disturbance, extended):
    with_it, controller = held(trial, partial(KalmanObserver, disturbance=disturbance, extended=extended))
    without, _ = held(trial, None)
    assert without > 10 * NOISE and with_it < NOISE
    assert not controller.fallbacks


def test_the_stationary_gain_is_that_of_the_riccati_equation_and_the_filter_forgets_its_start(trial):
    model = seen_in_part(trial.oscillators(0, 1, 0))
    observer = KalmanObserver(model, np.full(4, 0.6), disturbance="none")
    A, B, _ = model.linearize(np.zeros(6), np.zeros(4))
    C, _ = model.linearize_output(np.zeros(6))
    P = solve_discrete_are(A.T, C.T, observer._process, observer._measurement)
    K = P @ C.T @ np.linalg.inv(C @ P @ C.T + observer._measurement)
    rng, z = np.random.default_rng(0), 0.01 * np.ones(6)
    ours = observer.model.encode(np.zeros((2, 3)), np.zeros((1, 4)))
    observer.measure(np.zeros(3), np.zeros(4))
    for _ in range(400):
        u = rng.uniform(0, 0.6, 4)
        z = A @ z + B @ u
        y = C @ z + 1e-5 * rng.standard_normal(3)
        observer.measure(y, u)
        ours = A @ ours + B @ u
        ours = ours + K @ (y - C @ ours)
    np.testing.assert_allclose(observer.state()[0], ours, rtol=1e-8, atol=1e-12)
    assert np.abs(ours - z).max() < 2e-4


def test_the_extended_filter_of_a_linear_model_tends_to_the_stationary_one(trial):
    model = seen_in_part(trial.oscillators(0, 1, 0))
    filters = [KalmanObserver(model, np.full(4, 0.6), extended=extended) for extended in (False, True)]
    rng, z = np.random.default_rng(1), np.zeros(6)
    for _ in range(3000):
        u = rng.uniform(0, 0.6, 4)
        for one in filters:
            one.measure(model.decode(z) + 1e-5 * np.sin(z[:3] * 1e4), u)
        z = model.step(z, u)
    np.testing.assert_allclose(filters[0].state()[0], filters[1].state()[0], rtol=1e-4, atol=1e-7)


def dropping(plant, share, seed=0):
    rng, step = np.random.default_rng(seed), plant.step
    plant.step = lambda input: np.where(rng.uniform() < share, np.nan, step(input))
    return plant


def test_a_fifth_of_the_measurements_missing_is_bridged_by_the_filter_and_by_the_plan(trial):
    model, task = trial.oscillators(), figure_eight(amplitude=0.008, laps=1.0)
    errors = {}
    for name, observer in (("chart", None), ("filter", partial(KalmanObserver, disturbance="none", extended=True))):
        controller = trial.predictive(model, task, trial.BOUNDS, observer=observer)
        record = simulate(dropping(trial.ModelPlant(trial.perturbed(model, 0.03)), 0.2), controller, task,
                          noise_std=NOISE)
        missing = np.isnan(record.measurement).any(1)
        assert 0.1 < missing.mean() < 0.3 and np.isfinite(record.input).all()
        assert (record.input >= trial.BOUNDS[0]).all() and (record.input <= trial.BOUNDS[1]).all()
        errors[name] = np.sqrt(np.mean(np.sum(record.error**2, axis=1)))
        if observer is None:
            assert controller.fallbacks[Status.NOT_FINITE] == missing[::2].sum()
        else:
            assert not controller.fallbacks and controller.estimator.missing == missing.sum()
    assert errors["filter"] < errors["chart"] < 0.008 / 4 and errors["filter"] < 0.008 / 15


class LatePlant:
    """A plant whose measurements come `late` samples too late."""

    def __init__(self, plant, late):
        self.plant, self.late = plant, late
        self.__dict__.update({name: getattr(plant, name) for name in (
            "timestep", "input_bounds", "output_names", "input_names", "rest", "name", "input_unit")})

    @property
    def displacement(self):
        return self.plant.displacement

    def reset(self, seed=None):
        self.queue = [self.plant.reset()] * (self.late + 1)
        return self.queue[0]

    def step(self, input):
        self.queue = [*self.queue[1:], self.plant.step(input)]
        return self.queue[0]


def test_measurements_that_are_known_to_be_late_are_brought_up_to_date_by_the_model(trial):
    model, task, errors = trial.oscillators(), figure_eight(amplitude=0.008, laps=1.0), []
    for delay in (0.0, 0.03):
        controller = trial.predictive(model, task, trial.BOUNDS, measurement_delay=delay)
        record = simulate(LatePlant(trial.ModelPlant(trial.perturbed(model, 0.03)), 3), controller, task)
        errors.append(np.sqrt(np.mean(np.sum(record.error**2, axis=1))))
    assert errors[1] < errors[0] / 4 and errors[1] < 0.008 / 15
    with pytest.raises(ValueError, match="measurement_delay is 0.015 s.*0.01 s"):
        ModelPredictiveController(model, task, trial.BOUNDS, measurement_delay=0.015)


def test_a_frozen_sensor_is_noticed_and_counted_until_it_recovers(trial):
    model, task = trial.oscillators(), figure_eight(laps=1.0)
    controller, plant = ModelPredictiveController(model, task, trial.BOUNDS), trial.ModelPlant(trial.oscillators())
    observation, commands, seen = plant.reset(), [], None
    for k in range(120):
        seen = seen if 60 <= k < 80 else observation
        commands.append(controller(0.01 * k, seen))
        observation = plant.step(commands[-1].input)
    found = [k for k, command in enumerate(commands) if command.fallback is Status.FROZEN_SENSOR]
    assert found == list(range(64, 80, 2)) and controller.fallbacks == {Status.FROZEN_SENSOR: 8}
    assert all(np.isfinite(c.input).all() and (c.input >= 0).all() and (c.input <= 0.6).all() for c in commands)


def test_a_robot_that_stands_still_is_not_a_frozen_sensor(trial):
    still = Task("still", 2.0, (0, 1), lambda time: np.zeros((len(time), 2)))
    controller = ModelPredictiveController(trial.oscillators(), still, trial.BOUNDS)
    for k in range(100):
        controller(0.01 * k, np.zeros(6))
    assert not controller.fallbacks


def test_a_prepared_step_costs_what_an_unprepared_one_does(trial):
    model, task, costs = trial.oscillators(), figure_eight(laps=2.0, ramp=0.5), []
    for prepare in (False, True):
        plant = trial.ModelPlant(trial.perturbed(model, 0.03))
        controller = ModelPredictiveController(model, task, trial.BOUNDS)
        rng, observation, cost, condensed = np.random.default_rng(0), plant.reset(), 0.0, []
        condense = controller.horizon.condense
        controller.horizon.condense = lambda *a, condense=condense, seen=condensed: seen.append(0) or condense(*a)
        for k in range(round(task.duration / 0.01)):
            before = len(condensed)
            command = controller(0.01 * k, observation + NOISE * rng.standard_normal(6))
            assert not (prepare and k > 2 and not command.held) or len(condensed) == before
            if prepare:
                controller.prepare()
            effort = controller.settings.input_weight * np.sum((command.input / 0.6)**2)
            cost += 1e8 * np.sum((observation[:2] - task.reference(0.01 * k)[0])**2) + effort
            observation = plant.step(command.input)
        assert not controller.fallbacks
        costs.append(cost)
    assert costs[1] == pytest.approx(costs[0], rel=0.02)


@pytest.mark.parametrize("extended", [False, True])
@pytest.mark.parametrize("spoilt", [1e3, 1e30])
def test_a_filter_that_has_diverged_restarts_from_the_chart(trial, extended, spoilt):
    model = trial.oscillators()
    observer, z = KalmanObserver(model, np.full(4, 0.6), extended=extended), np.zeros(6)
    for k in range(120):
        u = np.array([0.2, 0.0, 0.1, 0.0])
        with np.errstate(all="ignore"):
            observer.measure(np.full(6, spoilt) if 50 <= k < 56 else z, u)
        found, _, _ = observer.state()
        z = model.step(z, u)
    assert observer.restarts >= 1 and np.abs(found - model.encode(z[None], u[None][:0])).max() < 2e-3
    observer.reset()
    assert observer.restarts == 0


@pytest.mark.parametrize(("options", "message"), [
    ({"disturbance": "state"}, "expected one of"), ({"process_noise": 0.0}, "process_noise is 0.0")])
def test_impossible_settings_of_an_observer_are_refused(trial, options, message):
    with pytest.raises(ValueError, match=message):
        KalmanObserver(trial.oscillators(), np.full(4, 0.6), **options)
