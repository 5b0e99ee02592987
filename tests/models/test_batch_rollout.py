"""Claims about rollouts from many starts at once: known answers, and refusals."""

import numpy as np
import pytest

from ssmr_torch.models.batch_rollout import BatchRollout, batch_of
from ssmr_torch.models.monomials import Monomials, graded
from ssmr_torch.models.polynomial import PolynomialModel
from ssmr_torch.models.structure import Structure


def polynomial(dynamics, factors, *, n, m=1, scheme="map", timestep=0.1, scale=1.0, read=None, **options):
    """Of a dynamics table over the monomials with these factors of (z, u); the outputs are the states."""
    structure = Structure(graded(n, 1, 1), tuple(range(n)), graded(n, 1, 1), Monomials(n + m, factors), scheme)
    return PolynomialModel(
        state_scale=np.full(n, scale), input_dim=m, output_dim=n, delays=0, timestep=timestep,
        window_timestep=timestep, structure=structure, chart=np.eye(n), parametrization=np.eye(n),
        dynamics=np.array(dynamics, dtype=float), **options)


def logistic(timestep, substeps=1):
    """dz/dt = z − z² + u."""
    return polynomial([[1.0, -1.0, 1.0]], [(0,), (0, 0), (1,)], n=1, scheme="runge_kutta", timestep=timestep,
                      substeps=substeps)


@pytest.mark.parametrize("count", [1, 7, 8, 63, 64, 65, 130])
def test_a_batch_of_any_size_is_of_order_four_on_the_logistic_equation(count):
    start = np.linspace(0.1, 1.5, count)[:, None]
    exact = 1 / (1 + (1 / start - 1) * np.exp(-1.0))
    errors = []
    for steps in (4, 8):
        outputs = batch_of(logistic(1.0 / steps)).outputs(start, np.zeros((count, steps, 1)))
        errors.append(np.abs(outputs[:, -1] - exact).max())
    assert 3.7 < np.log2(errors[0] / errors[1]) < 4.5


def test_a_shift_register_gives_the_inputs_of_before():
    n, delays = 5, np.eye(5, k=-1)
    model = polynomial(np.hstack([delays, np.eye(5, 1)]), [(k,) for k in range(n + 1)], n=n, scale=10.0)
    inputs = np.random.default_rng(0).normal(size=(70, 20, 1))
    states = batch_of(model).rollout(np.zeros((70, n)), inputs).states
    for k in range(n):
        np.testing.assert_array_equal(states[:, k + 1:, k], inputs[:, :20 - k, 0])


def test_a_map_that_doubles_diverges_at_the_expected_step_and_keeps_its_last_state():
    model = polynomial([[2.0]], [(0,)], n=1)  # the bound is 10
    start = np.array([[6.0], [0.7], [1e-3], [-4.0]])
    inputs = np.zeros((4, 8, 1))
    states, diverged_at = batch_of(model).rollout(start, inputs)
    np.testing.assert_array_equal(diverged_at, [1, 4, 9, 2])
    np.testing.assert_allclose(states[:, -1, 0], [6.0, 5.6, 0.256, -8.0], rtol=1e-15)
    outputs = batch_of(model).outputs(start, inputs)
    np.testing.assert_array_equal(np.isinf(outputs).sum(1)[:, 0], [8, 5, 0, 7])
    np.testing.assert_array_equal(batch_of(model).diverged(start, inputs, lengths=np.array([0, 3, 8, 2])),
                                  [False, False, False, True])
    np.testing.assert_array_equal(batch_of(model).diverged(start, inputs, bound=0.2), [True, True, True, True])


def test_overflow_and_nan_count_as_divergence():
    model = polynomial([[1.0, 1.0]], [(0, 0, 0), (1,)], n=1, scale=1e150)
    inputs = np.zeros((2, 9, 1))
    inputs[1, 3] = np.nan
    found = batch_of(model).rollout(np.array([[1e40], [0.5]]), inputs)
    np.testing.assert_array_equal(found.diverged_at, [2, 4])
    assert np.isfinite(found.states).all()


def test_no_starts_or_no_steps_give_empty_results():
    batch = batch_of(logistic(0.1))
    assert batch.outputs(np.zeros((0, 1)), np.zeros((0, 5, 1))).shape == (0, 5, 1)
    assert batch.rollout(np.ones((2, 1)), np.zeros((2, 0, 1))).states.shape == (2, 1, 1)


@pytest.mark.parametrize("kind", [BatchRollout, batch_of])
@pytest.mark.parametrize(("z", "inputs", "lengths", "message"), [
    ((3, 2), (3, 5, 1), None, r"\(3, 2\) and inputs of shape \(3, 5, 1\); expected \(N, 1\)"),
    ((3, 1), (2, 5, 1), None, "the same number of starts"), ((1,), (5, 1), None, "states of shape"),
    ((3, 1), (3, 5, 2), None, r"\(N, H, 1\)"), ((3, 1), (3, 5, 1), [5, 6, 1], "between 1 and 6; expected one"),
    ((3, 1), (3, 5, 1), [5, -1, 1], "between -1 and 5"), ((3, 1), (3, 5, 1), [5, 5], r"lengths of shape \(2,\)")])
def test_arrays_of_other_shapes_are_refused(kind, z, inputs, lengths, message):
    with pytest.raises(ValueError, match=message):
        kind(logistic(0.1)).rollout(np.zeros(z), np.zeros(inputs), lengths=lengths and np.array(lengths))
