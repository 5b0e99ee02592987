"""A robot, its recordings, and one design of it that is made once."""

import sys
from contextlib import contextmanager
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parent))

from oscillators import H, Oscillators, recordings  # noqa: E402

import ssmr_torch as ssmr  # noqa: E402
from ssmr_torch.control.actuator import Actuator  # noqa: E402
from ssmr_torch.control.mpc import ModelPredictiveController  # noqa: E402
from ssmr_torch.controller_design import model_choice, noises, twin, weights  # noqa: E402
from ssmr_torch.controller_design.linear_loop import Weights  # noqa: E402
from ssmr_torch.controller_design.noises import Likelihood, Noises  # noqa: E402
from ssmr_torch.controller_design.predictive_chart import Form, Regression, Scaled, chart  # noqa: E402
from ssmr_torch.controller_design.recordings import recordings_of  # noqa: E402
from ssmr_torch.controller_design.settings_from_design import settings_of  # noqa: E402

DELAY, LAG, OF_SENSOR, OF_INPUTS = 2, 0.04, 3e-5, 0.002
FEWER = ((weights, "TRIES", 1), (weights, "POINTS", 2), (weights, "OF_STATES", (1.0, 0.1)),
         (weights, "OF_DISTURBANCE", (0.01, 0.1)), (weights, "MOVES", (4.0, 40.0, 4e3)), (twin, "SECONDS", 2.0),
         (noises, "EVALUATIONS", 60), (noises, "PRECISE", 40), (model_choice, "STATES", (8, 12)),
         (model_choice, "WINDOWS", (2, 3)))


@contextmanager
def in_short():
    """Designs of fewer models, weights and loops, in seconds."""
    with pytest.MonkeyPatch.context() as patch:
        for module, name, value in FEWER:
            patch.setattr(module, name, value)
        yield


@pytest.fixture(scope="session")
def short_design():
    """`ssmr.design` of a robot and its data, in short."""
    def designed(robot, data, task, model="auto", **options):
        with in_short():
            return ssmr.design(model, data, task, robot.input_bounds, progress=False, **options)

    return designed


@pytest.fixture(scope="session")
def robot():
    return Oscillators(of_sensor=OF_SENSOR, of_inputs=OF_INPUTS, delay=DELAY, lag=LAG)


@pytest.fixture(scope="session")
def data(robot):
    return recordings(robot, runs=4, seconds=12.0)


@pytest.fixture(scope="session")
def task():
    return ssmr.tasks.circle(0.008, 3.0, laps=3, tracked=("x", "y"))


@pytest.fixture(scope="session")
def designed(short_design, robot, data, task):
    return short_design(robot, data, task)


@pytest.fixture(scope="session")
def exact():
    """Of a linear robot without noise: its recordings, the model that has its six states as outputs, likelihood,
    actuator, weights, observer, and `controller(task, …)` with these.
    """
    def made(robot, *, delay=0, lag=0.0, horizon=6, move=4.0):
        recorded = recordings_of(recordings(robot, runs=3, seconds=10.0, test=0), (0, 1), robot.input_bounds)
        model = linear_model(recorded)
        likelihood = Likelihood(model, recorded)
        actuator = Actuator(H, tuple(recorded.input_range.tolist()), delay=delay, lag=lag)
        chosen = Weights(horizon, 1e-3, 0.04, move)
        observer = likelihood.observer(Noises(2e-3, 3e-4, 3e-5, 1e-3))
        settings = settings_of(chosen, observer, actuator, recorded, likelihood)

        def controller(task, **changes):
            return ModelPredictiveController(model, task, robot.input_bounds, settings.changed(**changes), timestep=H,
                                             output_names=robot.output_names)

        return SimpleNamespace(recordings=recorded, model=model, likelihood=likelihood, actuator=actuator,
                               weights=chosen, observer=observer, controller=controller)

    return made


def linear_model(recorded):
    form = Form(tuple(range(recorded.output_dim)), 1, recorded.output_dim, 1, 0, 1e-13)
    scaled = Scaled(recorded, 10, None)
    return Regression(scaled, chart(scaled, form.keep, 1, True), form).model(1, form.ridge)


@pytest.fixture(scope="session")
def fitted():
    """The predictive model of a form."""
    def made(recorded, form, future=10):
        scaled = Scaled(recorded, future)
        regression = Regression(scaled, chart(scaled, form.keep, form.window, form.past_inputs), form)
        return regression, regression.model(form.degree, form.ridge)

    return made


@pytest.fixture
def rng():
    return np.random.default_rng(5)
