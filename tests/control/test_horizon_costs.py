"""Claims about the program where an actuator follows the inputs, and moves, distances and a target cost something."""

import numpy as np
import pytest

from ssmr_torch.control.actuator import Actuator, lagged
from ssmr_torch.control.horizon import CompiledHorizon, LinearHorizon, LinearizedHorizon, horizon_for
from ssmr_torch.control.scp import solve_scp
from ssmr_torch.control.solvers.proxqp import ProxQP
from ssmr_torch.control.tracking_problem import TrackingProblem
from ssmr_torch.status import Status

N = 6
TRACKED = np.array([1.0, 1.0, 0, 0, 0, 0])
LAG = Actuator(0.02, (0.6,) * 4, lag=0.03, gain=(1.0, 0.8, 1.2, 1.1), offset=(0.0, 0.02, -0.01, 0.0))
COSTS = {"lag and gain": {}, "moves": {"move_weight": np.array([200.0, 500.0, 0.0, 100.0])}, "huber": {"huber": 0.013},
         "target": {"input_target": np.array([0.1, 0.2, 0.0, 0.05])},
         "all": {"move_weight": 300.0, "huber": 0.013, "input_target": np.array([0.1, 0.2, 0.0, 0.05])}}
HORIZONS = {"compiled": ((3, 1), CompiledHorizon), "linearized": ((3, 1), LinearizedHorizon),
            "linear": ((1, 0), LinearHorizon)}


def problem_of(trial, **changes):
    settings = {"reference": lambda time: 0.01 * np.sin(3 * time[:, None] + np.arange(6)),
                "input_bounds": trial.BOUNDS, "output_weight": 1e8 * TRACKED, "terminal_weight": 3e7 * TRACKED,
                "input_weight": np.array([3.6, 1.8, 7.2, 3.6]), "horizon": N}
    return TrackingProblem(**settings | changes)


def horizon_of(trial, kind, problem, actuator=LAG):
    degrees, expected = HORIZONS[kind]
    model = trial.oscillators(2, *degrees)
    horizon = LinearizedHorizon(model.at_timestep(problem.period), problem, actuator) if expected is LinearizedHorizon \
        else horizon_for(model, problem, actuator)
    assert type(horizon) is expected
    horizon.input_offset, horizon.output_offset = np.array([0.02, 0.0, 0.01, 0.0]), np.full(6, 2e-4)
    horizon.lagged_from = np.array([0.3, 0.1, 0.0, 0.5])
    horizon.last_input = np.array([0.25, 0.1, 0.05, 0.4])
    return horizon


def point_of(seed):
    rng = np.random.default_rng(seed)
    return 0.005 * rng.standard_normal(6), rng.uniform(0, 0.6, (N, 4))


def differences(function, v, step):
    """∂f/∂v by five points, (…, len(v))."""
    return np.stack([(function(v - 2 * e) - 8 * function(v - e) + 8 * function(v + e) - function(v + 2 * e))
                     / (12 * step) for e in step * np.eye(len(v))], axis=-1)


@pytest.mark.parametrize("kind", HORIZONS)
@pytest.mark.parametrize("costs", COSTS.values(), ids=COSTS)
@pytest.mark.parametrize("started", [True, False])
def test_the_gradient_is_that_of_the_cost_of_the_rollout(trial, kind, costs, started):
    problem = problem_of(trial, **costs)
    horizon, (state, inputs), reference = horizon_of(trial, kind, problem), point_of(2), problem.reference_ahead(0.1)
    if not started:
        horizon.last_input = None

    def cost(v):
        u = v.reshape(N, 4) * problem.input_scale
        outputs = horizon.rollout(state, u)[1]
        return problem.cost(outputs, u, reference, last_input=horizon.last_input) / problem.cost_scale

    v, found = (inputs / problem.input_scale).ravel(), horizon.condense(state, inputs, reference)
    if problem.huber is not None:  # some distances are below it, some above
        sizes = np.linalg.norm((found.outputs - reference)[:, :2], axis=1)
        assert (sizes > problem.huber).any() and (sizes < problem.huber).any()
    np.testing.assert_allclose(found.gradient, differences(cost, v, 1e-4), rtol=1e-6,
                               atol=1e-6 * np.abs(found.gradient).max())
    np.testing.assert_allclose(found.linear, found.gradient - found.hessian @ v, rtol=1e-10,
                               atol=1e-12 * np.abs(found.gradient).max())


@pytest.mark.parametrize("kind", HORIZONS)
@pytest.mark.parametrize("costs", COSTS.values(), ids=COSTS)
def test_the_hessian_is_that_of_gauss_and_newton_with_the_outputs_own_derivatives(trial, kind, costs):
    """2 (Σ Y_kᵀ ρ'_k Q_k Y_k + R + Dᵀ S D) / cost_scale, with ∂y/∂v by differences of the rollout."""
    problem = problem_of(trial, **costs)
    horizon, (state, inputs), reference = horizon_of(trial, kind, problem), point_of(3), problem.reference_ahead(0.1)
    found = horizon.condense(state, inputs, reference)

    def outputs(v):
        return horizon.rollout(state, v.reshape(N, 4) * problem.input_scale)[1]

    Y = differences(outputs, (inputs / problem.input_scale).ravel(), 1e-3)
    weight = problem.stage_weight.copy()
    if problem.huber is not None:
        size = np.linalg.norm((found.outputs - reference)[:, :2], axis=1)
        weight *= np.minimum(1.0, problem.huber / size)[:, None]
    D = np.eye(4 * N) - np.eye(4 * N, k=-4)
    expected = np.einsum("kpi,kp,kpj->ij", Y, weight, Y) + np.diag(np.tile(problem.input_weight, N)) \
        + D.T @ np.diag(np.tile(problem.move_weight, N)) @ D
    np.testing.assert_allclose(found.hessian, 2 * expected / problem.cost_scale, rtol=0,
                               atol=1e-6 * np.abs(found.hessian).max())
    np.testing.assert_allclose(found.hessian, found.hessian.T, rtol=0, atol=1e-14 * np.abs(found.hessian).max())
    assert np.linalg.eigvalsh(found.hessian)[0] >= 2.0 * (1 - 1e-9)


def test_the_hessian_is_that_of_the_cost_when_the_model_is_linear(trial):
    problem = problem_of(trial, **COSTS["moves"], input_target=np.full(4, 0.1))
    horizon, reference = horizon_of(trial, "linear", problem), problem.reference_ahead(0.1)
    state, inputs = point_of(3)
    other = np.random.default_rng(9).uniform(0, 0.6, inputs.shape)
    here, there = (horizon.condense(state, u, reference) for u in (inputs, other))
    change = ((other - inputs) / problem.input_scale).ravel()
    np.testing.assert_allclose(there.gradient - here.gradient, here.hessian @ change, rtol=1e-8,
                               atol=1e-9 * np.abs(here.gradient).max())


@pytest.mark.parametrize("costs", COSTS.values(), ids=COSTS)
def test_the_compiled_horizon_equals_its_numpy_twin(trial, costs):
    problem = problem_of(trial, **costs)
    (state, inputs), reference = point_of(4), problem.reference_ahead(0.3)
    ours, theirs = (horizon_of(trial, kind, problem) for kind in ("compiled", "linearized"))
    for mine, other in zip((*ours.rollout(state, inputs), *ours.condense(state, inputs, reference)),
                           (*theirs.rollout(state, inputs), *theirs.condense(state, inputs, reference))):
        assert np.abs(mine - other).max() <= 1e-11 * np.abs(other).max()


@pytest.mark.parametrize("kind", HORIZONS)
def test_a_horizon_with_an_actuator_equals_one_without_it_under_acting_inputs(trial, kind):
    problem, (state, inputs) = problem_of(trial), point_of(5)
    with_it, without = (horizon_of(trial, kind, problem, actuator) for actuator in (LAG, None))
    acting = lagged(inputs, with_it.lagged_from, LAG.share, LAG.factor, LAG.shift)
    for ours, theirs in zip(with_it.rollout(state, inputs), without.rollout(state, acting)):
        np.testing.assert_array_equal(ours, theirs)


def test_a_program_moved_to_another_state_is_the_one_condensed_there_of_a_linear_model(trial):
    problem = problem_of(trial, **COSTS["moves"], input_target=np.full(4, 0.1))
    horizon, (state, inputs), (other, _) = horizon_of(trial, "linear", problem), point_of(1), point_of(2)
    moved = horizon.moved(horizon.condense(state, inputs, problem.reference_ahead(0.1)), other, inputs,
                          problem.reference_ahead(0.4))
    there = horizon.condense(other, inputs, problem.reference_ahead(0.4))
    for name in ("outputs", "hessian", "gradient", "linear"):
        found, expected = getattr(moved, name), getattr(there, name)
        assert np.abs(found - expected).max() <= 1e-11 * np.abs(expected).max(), name


def test_moves_cost_and_inputs_tend_to_their_target_where_nothing_is_tracked(trial):
    """Tracking weighs next to nothing: the least Σ r (v − t)² + s (Δv)² is that of a tridiagonal system."""
    problem = problem_of(trial, output_weight=1e-6 * TRACKED, terminal_weight=0.0, input_weight=3.0, move_weight=50.0,
                         input_target=np.full(4, 0.3), input_bounds=[[-9.0] * 4, [9.0] * 4])
    horizon, last = horizon_for(trial.oscillators(2, 1, 0), problem), np.array([0.6, 0.0, 0.3, -0.6])
    plan = solve_scp(problem, horizon, np.zeros(6), np.zeros((N, 4)), ProxQP(4 * N, 0, tolerance=1e-12),
                     last_input=last)
    D = np.eye(N) - np.eye(N, k=-1)
    first = np.eye(N)[:, :1]
    expected = np.linalg.solve(3.0 * np.eye(N) + 50.0 * D.T @ D, 3.0 * np.full((N, 4), 0.3) + 50.0 * first * last)
    assert plan.status is Status.SOLVED
    np.testing.assert_allclose(plan.inputs, expected, rtol=0, atol=1e-7)


def test_huber_of_a_small_error_is_its_square_and_of_a_large_one_its_tangent(trial):
    plain, huber = problem_of(trial), problem_of(trial, huber=1e-3)
    reference, none = np.zeros((N, 6)), np.zeros((N, 4))
    for size, factor in ((5e-4, 1.0), (1e-3, 1.0), (3e-3, (2 * 3 - 1) / 9), (0.1, (2 * 100 - 1) / 1e4)):
        outputs = size * np.tile([0.6, -0.8, 5.0, 0, 0, 0], (N, 1))
        assert huber.cost(outputs, none, reference) == pytest.approx(factor * plain.cost(outputs, none, reference))


@pytest.mark.parametrize(("changes", "said"), [
    ({"huber": -1.0}, "huber is -1.0 m"), ({"move_weight": -1.0}, "none negative"),
    ({"huber": 1e-3, "output_weight": 1e8 * np.array([1, 2, 0, 0, 0, 0])}, "output_weight is .* the same number"),
    ({"huber": 1e-3, "terminal_weight": 1e7}, "terminal_weight is .* zero for the others"),
    ({"move_weight": [1.0, 2.0]}, r"move_weight has shape \(2,\); expected one number or \(4,\)"),
    ({"input_target": [0.1, 0.2]}, r"input_target has shape \(2,\); expected 4 finite numbers")])
def test_impossible_costs_are_refused(trial, changes, said):
    with pytest.raises(ValueError, match=said):
        problem_of(trial, **changes)
