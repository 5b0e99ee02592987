"""Claims about model predictive control in closed loop."""

from dataclasses import replace

import numpy as np
import pytest

from ssmr_torch.closed_loop.simulation import simulate
from ssmr_torch.control.qpsolvers_adapter import QPSolvers
from ssmr_torch.control.quadratic_program import QPSolution
from ssmr_torch.control.solvers.proxqp import ProxQP
from ssmr_torch.models.named_structures import koopman, ssm_structure
from ssmr_torch.models.torch_model import FixedModel
from ssmr_torch.status import Status
from ssmr_torch.tasks.references import Task, figure_eight


def controller_of(trial, task=None, model=None, **settings):
    return trial.predictive(model or trial.oscillators(), task or figure_eight(laps=2.0), trial.BOUNDS, **settings)


def run(controller, trial, samples, observe=lambda k, y: y):
    """Commands along the first samples of the task, with observations changed by `observe`."""
    plant, commands = trial.ModelPlant(trial.perturbed(trial.oscillators(), 0.03)), []
    observation = plant.reset()
    for k in range(samples):
        commands.append(controller(k * plant.timestep, observe(k, observation)))
        observation = plant.step(commands[-1].input)
    return commands


@pytest.mark.parametrize("horizon, share", [(5, 1.02), (10, 1.02)])
def test_one_program_per_step_costs_at_most_two_percent_more_than_convergence(trial, horizon, share):
    task, costs = figure_eight(laps=2.0, ramp=0.5), []
    plant = trial.ModelPlant(trial.perturbed(trial.oscillators(), 0.03))
    for settings in ({}, {"iterations": 30, "tolerance": 1e-10}):
        controller = controller_of(trial, task, horizon=horizon, **settings)
        record = simulate(plant, controller, task, noise_std=3e-5)
        assert not controller.fallbacks
        costs.append(1e8 * np.sum(record.error**2) + 3.6 * np.sum((record.input / 0.6)**2))
    assert costs[0] <= share * costs[1]


def test_the_plant_follows_the_figure_eight_within_a_twentieth_of_its_size(trial):
    task = figure_eight(amplitude=0.010, laps=2.0)
    plant = trial.ModelPlant(trial.perturbed(trial.oscillators(), 0.03))
    record = simulate(plant, controller_of(trial, task), task)
    assert np.sqrt(np.mean(np.sum(record.error**2, axis=1))) < 0.010 / 20


def test_a_plan_is_made_every_period_and_held_in_between(trial):
    commands = run(controller_of(trial, period=0.03), trial, 12)
    assert [command.held for command in commands] == [False, True, True] * 4
    for k, command in enumerate(commands):
        np.testing.assert_array_equal(command.input, commands[k - k % 3].input)


def test_the_first_step_may_solve_three_programs_and_the_others_one(trial):
    commands = [command for command in run(controller_of(trial), trial, 100) if not command.held]
    assert 1 <= commands[0].plan.iterations <= 3
    assert {command.plan.iterations for command in commands[1:]} == {1}


def test_a_jump_of_the_reference_is_met_with_more_than_one_program(trial):
    target = [0.0]
    task = Task("set point", 10.0, (0, 1), lambda time: np.full((len(time), 2), target[0]))
    controller = controller_of(trial, task)
    for k in range(10):
        controller(0.01 * k, np.full(6, 1e-9 * k))
    target[0] = 0.01
    assert controller(0.10, np.zeros(6)).plan.iterations > 1


@pytest.mark.parametrize("status", [status for status in Status if not status.success])
def test_a_failed_program_falls_back_to_the_shifted_plan_and_is_counted(trial, status):
    controller = controller_of(trial)
    before = [controller(0.01 * k, np.full(6, 1e-9 * k)) for k in range(20)][-2]
    controller.solver.solve = lambda problem: QPSolution.none(problem, status)
    command = controller(before.plan.time + 0.02, np.zeros(6))
    assert command.fallback is status and controller.fallbacks == {status: 1}
    np.testing.assert_array_equal(command.input, before.plan.inputs[1])


@pytest.mark.parametrize("observation, status", [
    (np.full(6, np.nan), Status.NOT_FINITE), (np.full(6, np.inf), Status.NOT_FINITE),
    (np.array([0, np.nan, 0, 0, 0, 0]), Status.NOT_FINITE), (np.full(6, 1.0), Status.OUT_OF_RANGE)])
def test_a_measurement_that_cannot_be_trusted_gives_a_finite_input_and_is_counted(trial, observation, status):
    controller = controller_of(trial)
    commands = run(controller, trial, 120, lambda k, y: observation if 40 <= k < 44 else y)
    inputs = np.stack([command.input for command in commands])
    assert (trial.BOUNDS[0] <= inputs).all() and (inputs <= trial.BOUNDS[1]).all()
    assert controller.fallbacks == {status: 2}
    assert [commands[k].fallback for k in (38, 40, 42, 44)] == [None, status, status, None]
    np.testing.assert_array_equal(commands[40].input, commands[38].plan.inputs[1])
    np.testing.assert_array_equal(commands[42].input, commands[38].plan.inputs[2])


def test_without_a_plan_the_input_becomes_the_safe_one(trial):
    safe = np.array([0.1, 0.2, 0.3, 0.0])
    command = controller_of(trial, safe_input=safe)(0.0, np.full(6, np.nan))
    assert command.fallback is Status.NOT_FINITE
    np.testing.assert_array_equal(command.input, safe)


def test_an_outage_longer_than_the_horizon_ends_at_the_safe_input_at_the_allowed_rate(trial):
    controller = controller_of(trial, input_rate=4.0)
    commands = run(controller, trial, 140, lambda k, y: y * np.nan if k >= 80 else y)
    inputs = np.stack([command.input for command in commands])
    np.testing.assert_array_equal(inputs[-1], 0.0)
    assert np.abs(np.diff(inputs[:80], axis=0)).max() > 0.5 * 4.0 * 0.02
    assert np.abs(np.diff(np.vstack([np.zeros(4), inputs]), axis=0)).max() <= 4.0 * 0.02 * (1 + 1e-9)


def test_an_iteration_limit_is_counted_and_the_input_stays_in_bounds(trial):
    controller = controller_of(trial, horizon=10, solver=ProxQP(40, tolerance=1e-14, max_iterations=1))
    commands = run(controller, trial, 20)
    assert controller.fallbacks == {Status.ITERATION_LIMIT: 10}
    assert all(np.isfinite(command.input).all() for command in commands)


def test_another_solver_steers_the_same_way(trial):
    ours = run(controller_of(trial), trial, 30)
    theirs = run(controller_of(trial, solver=QPSolvers("proxqp", eps_abs=1e-8)), trial, 30)
    np.testing.assert_allclose([c.input for c in ours], [c.input for c in theirs], atol=1e-4)


@pytest.mark.parametrize("degrees", [(1, 0), (2, 1)])
def test_a_torch_module_steers_as_its_model_does(trial, degrees):
    model = trial.oscillators(0, *degrees)
    ours, theirs = (run(controller_of(trial, model=each), trial, 6) for each in (FixedModel(model), model))
    np.testing.assert_array_equal([command.input for command in ours], [command.input for command in theirs])


class Recorder:
    """A model of delays that notes the windows that it is asked to encode."""

    def __init__(self, model):
        self.model, self.windows = model, []

    @property
    def reduced(self):
        return self

    def numpy(self):
        return self

    def __getattr__(self, name):
        return getattr(self.model, name)

    def encode(self, window, inputs):
        self.windows.append((window.copy(), inputs.copy()))
        return self.model.encode(window, inputs)


def test_the_window_holds_the_samples_and_inputs_at_the_spacing_of_the_model(trial):
    base = trial.oscillators(0, 1, 0)
    structure = ssm_structure(6, 4, 18, parametrization_degree=1, dynamics_degree=1, control_degree=0, chart_degree=1)
    model = replace(base, structure=structure, chart=np.hstack([np.zeros((6, 12)), np.eye(6)]), delays=2,
                    window_timestep=0.02, parametrization=np.vstack([np.eye(6)] * 3))
    recorder = Recorder(model)
    controller = controller_of(trial, model=recorder, timestep=0.01)
    recorder.windows.clear()
    commands = [controller(0.01 * k, np.full(6, 1e-4 * k)) for k in range(9)]
    window, inputs = recorder.windows[-1]
    np.testing.assert_allclose(window[:, 0], [4e-4, 6e-4, 8e-4])
    np.testing.assert_array_equal(inputs, [commands[4].input, commands[6].input])
    np.testing.assert_array_equal(recorder.windows[0][0], np.zeros((3, 6)))


def test_a_model_with_a_step_of_two_samples_can_be_controlled(trial):
    A, B, _ = trial.oscillators(0, 1, 0).at_timestep(0.02).linearize(np.zeros(6), np.zeros(4))
    model = koopman(scale=np.ones(6), A=A, B=B, N=np.zeros((0, 6, 6)), pregain=np.zeros((0, 7)),
                          set_points=np.zeros((0, 7)), degree=1, input_delays=0, constant=False,
                          state_scale=np.full(6, 0.04), input_dim=4, output_dim=6, delays=0, timestep=0.02,
                          window_timestep=0.01, base_timestep=0.02)
    task = figure_eight(amplitude=0.008, laps=1.0)
    record = simulate(trial.ModelPlant(trial.oscillators(0, 1, 0)), controller_of(trial, task, model), task)
    assert np.abs(record.error).max() < 0.001 and not record.fallback.any()
    with pytest.raises(ValueError, match="0.01 s, which is 0.5 times the timestep"):
        controller_of(trial, task, model, measurement_delay=0.01)


def test_periods_that_do_not_fit_are_refused_with_both_numbers(trial):
    with pytest.raises(ValueError, match="0.025 s.*0.01 s"):
        controller_of(trial, period=0.025)
    with pytest.raises(ValueError, match="window_timestep is 0.01 s.*0.004 s"):
        controller_of(trial, timestep=0.004, period=0.02)
    with pytest.raises(ValueError, match="safe_input"):
        controller_of(trial, safe_input=np.full(4, 2.0))
    with pytest.raises(ValueError, match="tracks output 7"):
        controller_of(trial, figure_eight(tracked=(0, 7)))
    with pytest.raises(ValueError, match="shape \\(3,\\)"):
        controller_of(trial)(0.0, np.zeros(3))
