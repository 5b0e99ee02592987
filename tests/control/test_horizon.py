"""Claims about the problem over the horizon."""

from dataclasses import replace

import numpy as np
import pytest

from ssmr_torch.control.horizon import CompiledHorizon, LinearHorizon, LinearizedHorizon, horizon_for
from ssmr_torch.control.tracking_problem import TrackingProblem
from ssmr_torch.models.monomials import count_monomials, graded
from ssmr_torch.models.named_structures import control_augmented, control_augmented_structure, koopman
from ssmr_torch.models.output_coordinates import ConstantCurvature, Identity, Mixture


def problem_of(trial, horizon=6, **changes):
    settings = {"reference": lambda time: 0.01 * np.sin(3 * time[:, None] + np.arange(6)),
                "input_bounds": trial.BOUNDS, "output_weight": 1e8 * np.array([1, 2, 0, 0, 0.1, 0]),
                "terminal_weight": 3e7, "input_weight": np.array([3.6, 1.8, 7.2, 3.6]), "horizon": horizon}
    return TrackingProblem(**settings | changes)


def point_of(seed, horizon=6):
    rng = np.random.default_rng(seed)
    return 0.01 * rng.standard_normal(6), rng.uniform(0, 0.6, (horizon, 4))


@pytest.mark.parametrize("degrees", [(1, 0), (2, 1), (3, 1), (3, 2), (1, 2)])
@pytest.mark.parametrize("seed", range(3))
def test_the_compiled_kernel_equals_its_numpy_twin(trial, degrees, seed):
    model, problem = trial.oscillators(seed, *degrees), problem_of(trial)
    state, inputs = point_of(seed)
    reference = problem.reference_ahead(0.3)
    kernel, twin = horizon_for(model, problem), LinearizedHorizon(model.at_timestep(problem.period), problem)
    assert isinstance(kernel, LinearHorizon if degrees == (1, 0) else CompiledHorizon)
    # a linear model's condensed problem holds the first state alone
    for ours, theirs in zip((*kernel.rollout(state, inputs), *kernel.condense(state, inputs, reference)[1:]),
                            (*twin.rollout(state, inputs), *twin.condense(state, inputs, reference)[1:])):
        assert np.abs(ours - theirs).max() <= 1e-12 * np.abs(theirs).max()


def test_the_kernel_equals_its_twin_for_a_curved_output_with_substeps(trial):
    rng = np.random.default_rng(0)
    model = trial.oscillators(0, 2, 1)
    curved = np.hstack([np.eye(6), 3.0 * rng.standard_normal((6, 77))])
    model = replace(model, parametrization=curved, substeps=3,
                    structure=model.structure._replace(parametrization=graded(6, 1, 3)))
    problem = problem_of(trial)
    state, inputs = point_of(1)
    reference = problem.reference_ahead(0.0)
    kernel, twin = horizon_for(model, problem), LinearizedHorizon(model.at_timestep(problem.period), problem)
    for ours, theirs in zip(kernel.condense(state, inputs, reference),
                            twin.condense(state, inputs, reference)):
        assert np.abs(ours - theirs).max() <= 1e-12 * np.abs(theirs).max()


def joint(rng, degree, input_degree, repeats, curved, edge=None):
    """A stable control-augmented model with random coefficients."""
    structure = control_augmented_structure(6, 4, 6, 0, parametrization_degree=1, dynamics_degree=degree,
                                            input_degree=input_degree, state_degree=None, saturated=False)
    dynamics = 4.0 * rng.standard_normal((6, len(structure.dynamics)))
    dynamics[:, :6] = -8.0 * np.eye(6) + 3.0 * rng.standard_normal((6, 6))
    output = np.hstack([np.eye(6), 4.0 * rng.standard_normal((6, 21))]) if curved else np.eye(6)
    return control_augmented(
        chart=np.eye(6), parametrization=output, dynamics=dynamics, parametrization_degree=2 if curved else 1,
        dynamics_degree=degree, input_degree=input_degree, saturated=edge is not None,
        state_scale=np.full(6, edge or 1.0), input_dim=4, output_dim=6, delays=0,
        timestep=0.01 * repeats, window_timestep=0.01, base_timestep=0.01)


def lifted(rng, bilinear, relift, constant=True, repeats=2):
    """A stable Koopman model of degree two with random coefficients."""
    count = count_monomials(6, 0 if constant else 1, 2)
    rows = 6 if relift else count
    A, B = 0.03 * rng.standard_normal((rows, count)), 0.1 * rng.standard_normal((rows, 4))
    A[:, :rows] += 0.9 * np.eye(rows)
    N = 0.02 * rng.standard_normal((4, rows, count)) if bilinear else np.zeros((0, rows, count))
    return koopman(
        scale=np.full(6, 0.02), A=A, B=B, N=N, pregain=np.zeros((0, 7)), set_points=np.zeros((0, 7)), degree=2,
        input_delays=0, constant=constant, relift=relift, state_scale=np.ones(count), input_dim=4, output_dim=6,
        delays=0, timestep=0.01 * repeats, window_timestep=0.01, base_timestep=0.01)


@pytest.mark.parametrize(("kind", "make"), [
    (CompiledHorizon, lambda rng: joint(rng, 2, 2, 2, False)), (CompiledHorizon, lambda rng: joint(rng, 3, 1, 2, True)),
    (CompiledHorizon, lambda rng: joint(rng, 3, 2, 2, True, edge=0.02)),
    (LinearHorizon, lambda rng: joint(rng, 1, 1, 2, False)), (CompiledHorizon, lambda rng: lifted(rng, True, False)),
    (LinearHorizon, lambda rng: lifted(rng, False, False)),
    (LinearHorizon, lambda rng: lifted(rng, False, False, constant=False)),
    (LinearizedHorizon, lambda rng: lifted(rng, True, True, constant=False))])
def test_models_in_discrete_time_get_the_fastest_horizon_and_it_equals_the_batched_one(trial, kind, make):
    rng = np.random.default_rng(5)
    model, problem = make(rng), problem_of(trial)
    horizon, twin = horizon_for(model, problem), LinearizedHorizon(model.at_timestep(problem.period), problem)
    assert type(horizon) is kind
    state, inputs = 0.05 * rng.standard_normal(model.state_dim), rng.uniform(0, 0.6, (6, 4))
    reference = problem.reference_ahead(0.2)
    for offsets in ((None, None), (np.array([0.1, 0, 0.05, 0]), np.full(6, 1e-3))):
        for one in (horizon, twin):
            one.input_offset, one.output_offset = offsets
        for ours, theirs in zip((*horizon.rollout(state, inputs), *horizon.condense(state, inputs, reference)[1:]),
                                (*twin.rollout(state, inputs), *twin.condense(state, inputs, reference)[1:])):
            assert np.abs(ours - theirs).max() <= 1e-12 * np.abs(theirs).max()


ARCS = ConstantCurvature(((0.0, 0.0, 0.05), (0.01, 0.0, -0.04)))
PLANAR = ConstantCurvature(((0.05, 0.0), (0.0, 0.03), (0.02, 0.02)))


@pytest.mark.parametrize("coordinates", [
    ARCS, PLANAR, Identity(6), Mixture((PLANAR, Identity(6), ARCS), (0.5, 0.2, 0.3), 6),
    Mixture((Mixture((ARCS, Identity(6)), (0.5, 0.5), 6), PLANAR), (0.25, 0.75), 6)],
    ids=["arcs", "arcs in a plane", "identity", "mixture", "mixture within"])
def test_the_kernel_computes_output_coordinates_as_the_model_does(trial, coordinates):
    rng, sides = np.random.default_rng(3), coordinates.latent(6) // 6
    model = joint(rng, 2, 2, 2, True, edge=0.02)
    model = replace(model, coordinates=coordinates, reach=2.0, chart=np.tile(np.eye(6), (1, sides)) / sides,
                    structure=model.structure._replace(chart=graded(6 * sides, 1, 1),
                                                       window_order=tuple(range(6 * sides))),
                    parametrization=np.concatenate([model.parametrization + 0.5 * rng.standard_normal(
                        model.parametrization.shape) for _ in range(sides)]))
    problem = problem_of(trial)
    kernel, twin = horizon_for(model, problem), LinearizedHorizon(model.at_timestep(problem.period), problem)
    assert type(kernel) is CompiledHorizon
    for size in (0.0, 0.03, 0.1):
        state, inputs = size * rng.standard_normal(6), rng.uniform(0, 0.6, (6, 4))
        reference = problem.reference_ahead(0.2)
        for ours, theirs in zip((*kernel.rollout(state, inputs), *kernel.condense(state, inputs, reference)),
                                (*twin.rollout(state, inputs), *twin.condense(state, inputs, reference))):
            assert ours.shape == theirs.shape and np.abs(ours - theirs).max() <= 1e-12 * np.abs(theirs).max()


def test_a_linear_point_that_is_moved_is_the_point_condensed_there(trial):
    model, problem = trial.oscillators(3, 1, 0), problem_of(trial)
    for horizon in (horizon_for(model, problem), LinearizedHorizon(model.at_timestep(problem.period), problem)):
        (state, inputs), other = point_of(1), point_of(2)[0]
        reference, later = problem.reference_ahead(0.1), problem.reference_ahead(0.4)
        moved = horizon.moved(horizon.condense(state, inputs, reference), other, inputs, later)
        there = horizon.condense(other, inputs, later)
        np.testing.assert_allclose(moved.outputs, there.outputs, rtol=1e-12, atol=1e-15)
        np.testing.assert_allclose(moved.gradient, there.gradient, rtol=1e-9, atol=1e-9)


def test_the_gradient_is_that_of_the_cost_of_the_rollout(trial):
    model, problem = trial.oscillators(2), problem_of(trial)
    horizon, reference = horizon_for(model, problem), problem.reference_ahead(0.1)
    state, inputs = point_of(2)

    def cost(v):
        u = v.reshape(inputs.shape) * problem.input_scale
        return problem.cost(horizon.rollout(state, u)[1], u, reference) / problem.cost_scale

    v = (inputs / problem.input_scale).ravel()
    condensed = horizon.condense(state, inputs, reference)
    step = 1e-5 * np.eye(len(v))
    differences = np.array([cost(v - 2 * e) - 8 * cost(v - e) + 8 * cost(v + e) - cost(v + 2 * e)
                            for e in step])
    np.testing.assert_allclose(condensed.gradient, differences / 12e-5, rtol=1e-6,
                               atol=1e-8 * np.abs(condensed.gradient).max())
    np.testing.assert_allclose(condensed.linear, condensed.gradient - condensed.hessian @ v, rtol=1e-10,
                               atol=1e-12 * np.abs(condensed.gradient).max())


@pytest.mark.parametrize("degrees", [(1, 0), (3, 1)])
def test_the_feedback_phase_of_a_linear_model_is_the_program_itself(trial, degrees):
    """Moved to another state and reference, and back: what was condensed there."""
    model, problem = trial.oscillators(0, *degrees), problem_of(trial)
    horizon, (state, inputs) = horizon_for(model, problem), point_of(3)
    here, other = horizon.condense(state, inputs, problem.reference_ahead(0.1)), problem.reference_ahead(0.4)
    moved = horizon.moved(here, state + 1e-4, inputs, other)
    if degrees == (1, 0):
        there = horizon.condense(state + 1e-4, inputs, other)
        for name in ("outputs", "hessian", "gradient", "linear"):
            found, expected = getattr(moved, name), getattr(there, name)
            assert np.abs(found - expected).max() <= 1e-11 * np.abs(expected).max(), name
    back = horizon.moved(moved._replace(states=here.states + 1e-4), state, inputs, problem.reference_ahead(0.1))
    for name in ("outputs", "gradient", "linear"):
        found, expected = getattr(back, name), getattr(here, name)
        assert np.abs(found - expected).max() <= 1e-11 * np.abs(expected).max(), name


def test_the_hessian_is_that_of_the_cost_when_the_model_is_linear(trial):
    model, problem = trial.oscillators(3, 1, 0), problem_of(trial)
    horizon, reference = horizon_for(model, problem), problem.reference_ahead(0.1)
    state, inputs = point_of(3)
    other = np.random.default_rng(9).uniform(0, 0.6, inputs.shape)
    here, there = (horizon.condense(state, u, reference) for u in (inputs, other))
    np.testing.assert_allclose(here.hessian, there.hessian, rtol=1e-10)
    change = ((other - inputs) / problem.input_scale).ravel()
    np.testing.assert_allclose(there.gradient - here.gradient, here.hessian @ change, rtol=1e-8,
                               atol=1e-9 * np.abs(here.gradient).max())


@pytest.mark.parametrize("horizon", [1, 5, 20])
def test_the_hessian_is_symmetric_and_at_least_twice_the_identity(trial, horizon):
    model, problem = trial.oscillators(4), problem_of(trial, horizon)
    state, inputs = point_of(4, horizon)
    hessian = horizon_for(model, problem).condense(state, inputs, problem.reference_ahead(0.0)).hessian
    np.testing.assert_array_equal(hessian, hessian.T)
    assert np.linalg.eigvalsh(hessian)[0] >= 2.0 * (1 - 1e-9)


def test_a_diverging_rollout_is_not_hidden(trial):
    problem = problem_of(trial, 20)
    with np.errstate(all="ignore"):
        states, _ = horizon_for(trial.oscillators(0), problem).rollout(np.full(6, 1e3), np.zeros((20, 4)))
    assert not np.isfinite(states).all()


def test_a_model_of_other_sizes_is_refused(trial):
    problem = problem_of(trial, output_weight=np.ones(3), terminal_weight=0.0)
    with pytest.raises(ValueError, match="6 outputs; expected 4 and 3"):
        horizon_for(trial.oscillators(), problem)


@pytest.mark.parametrize("changes, message", [
    ({"input_bounds": [[0.0] * 4, [0.5, 0.5, 0.5, 0.0]]}, "lowest below highest"),
    ({"input_bounds": [0.0, 1.0]}, "expected \\(2, m\\)"),
    ({"input_weight": 0.0}, "not unique"),
    ({"output_weight": -np.ones(6)}, "none negative"),
    ({"input_rate": np.array([1.0, 2.0])}, "expected one number or \\(4,\\)"),
    ({"input_rate": 0.0}, "no limit"),
    ({"horizon": 0}, "positive number of control steps"),
    ({"period": 0.0}, "positive time"),
])
def test_an_impossible_problem_is_refused(trial, changes, message):
    with pytest.raises(ValueError, match=message):
        problem_of(trial, **changes)


def test_a_reference_of_another_shape_is_refused(trial):
    with pytest.raises(ValueError, match="one row per time"):
        problem_of(trial, reference=lambda time: np.zeros((len(time), 2))).reference_ahead(0.0)
