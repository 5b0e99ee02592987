"""Koopman models in closed form, against independent least squares."""

import numpy as np
import pytest
import torch
from sklearn.linear_model import Lasso, Ridge
from sklearn.preprocessing import PolynomialFeatures

from ssmr_torch.fitting.koopman_least_squares import KoopmanLeastSquares
from ssmr_torch.fitting.streamed_least_squares import StreamedRegression
from ssmr_torch.models.koopman import Koopman
from ssmr_torch.trajectory import Trajectory

RNG = np.random.default_rng(3)


def pendulum_runs(lengths=(120, 90, 150)):
    """Noisy-free, mildly nonlinear motion of two outputs under two inputs that change at every sample."""
    runs = []
    for number, length in enumerate(lengths):
        rng = np.random.default_rng(number)
        y, v = rng.uniform(-0.3, 0.3, 2), np.zeros(2)
        inputs, outputs = rng.uniform(0, 1, (length, 2)), []
        for u in inputs:
            outputs.append(y)
            v = v + 0.01 * (-60 * np.sin(y) - 3 * v + np.array([[8, -5], [2, 9]]) @ u * (1 + 0.4 * y[::-1]))
            y = y + 0.01 * v
        runs.append(Trajectory(0.01 * np.arange(length), np.array(outputs), inputs))
    return runs


def rows(runs, stride=1):
    """ζ = [y_k, y_{k-s}, u_{k-s}], u_k and y_{k+s} of all pairs that lie within one run, by explicit loops."""
    found = []
    for run in runs:
        y, u = np.asarray(run.observation), np.asarray(run.input)
        for k in range(stride, len(y) - stride):
            held, before = u[k:k + stride].mean(0), u[k - stride:k].mean(0)
            found.append((np.concatenate([y[k], y[k - stride], before]), held, y[k + stride]))
    return tuple(np.array(part) for part in zip(*found))


def one_step(model, zeta, u):
    """Newest outputs one step after observables ζ in physical units."""
    z = model.lifting(torch.from_numpy(zeta) / model.scale)
    return model.decode(model.reduced.advance(z, torch.from_numpy(u))).detach().numpy()


@pytest.mark.parametrize(("degree", "relift"), [(1, False), (2, False), (2, True)])
@pytest.mark.parametrize("stride", [1, 3])
def test_the_transition_is_that_of_an_independent_least_squares(solve_stages, degree, relift, stride):
    runs = pendulum_runs()
    procedure = KoopmanLeastSquares(Koopman(2, 2, degree=degree, relift=relift, timestep=0.01 * stride))
    procedure.sampled_every(0.01)
    model = solve_stages(procedure, runs, rows=64)
    zeta, u, following = rows(runs, stride)
    lifted = PolynomialFeatures(degree).fit_transform(zeta)
    coefficients = np.linalg.lstsq(np.hstack([lifted, u]), following, rcond=None)[0]
    expected = np.hstack([lifted, u]) @ coefficients
    np.testing.assert_allclose(one_step(model, zeta, u), expected, rtol=0, atol=1e-8 * np.abs(expected).max())


def test_dynamic_mode_decomposition_is_that_of_pydmd(solve_stages):
    pydmd = pytest.importorskip("pydmd")
    run = pendulum_runs((300,))[0]
    y, u = np.asarray(run.observation).T, np.asarray(run.input).T
    model = solve_stages(KoopmanLeastSquares(Koopman(2, 2, delays=0, input_delays=0, constant=False)), [run])
    theirs = pydmd.DMDc(svd_rank=-1, opt=False)
    theirs.fit(y, u[:, :-1])
    modes, dynamics, back = theirs.modes, np.diag(theirs.eigs), np.linalg.pinv(theirs.modes)
    A = (modes @ dynamics @ back).real
    scale = model.scale.numpy()
    np.testing.assert_allclose(model.A.detach().numpy() * scale[:, None] / scale, A, rtol=0, atol=1e-8)
    np.testing.assert_allclose(model.B.detach().numpy() * scale[:, None], theirs.B, rtol=0, atol=1e-8)


def test_a_quadratic_map_is_predicted_without_error_by_edmd_with_relifting(solve_stages):
    """y⁺ = y + 0.2 (u - y - y²): no monomials propagate linearly, but ψ of degree 2 gives the next y."""
    u, y, outputs = RNG.uniform(0, 1, (400, 1)), np.zeros(1), []
    for value in u:
        outputs.append(y)
        y = y + 0.2 * (value - y - y**2)
    run = Trajectory(0.01 * np.arange(400), np.array(outputs), u)
    errors = {}
    for relift in (True, False):
        model = solve_stages(KoopmanLeastSquares(Koopman(1, 1, 0, input_delays=0, degree=2, relift=relift)), [run])
        start, inputs = torch.from_numpy(np.array(run.observation[:1])), torch.from_numpy(u[:-1])
        states = model.rollout(model.encode(start, inputs[:0]), inputs).states
        errors[relift] = np.abs(model.decode(states).detach().numpy() - run.observation).max()
    assert errors[True] < 1e-11 and errors[False] > 1e-3


@pytest.mark.parametrize("constant", [False, True])
def test_a_bilinear_system_is_recovered(solve_stages, constant):
    rng = np.random.default_rng(0)
    A, B, N = 0.5 * rng.normal(size=(3, 3)) / 3**0.5, rng.normal(size=(3, 2)), 0.2 * rng.normal(size=(2, 3, 3))
    y, u, outputs = np.zeros(3), rng.uniform(-1, 1, (200, 2)), []
    for k in range(200):
        outputs.append(y)
        y = A @ y + B @ u[k] + np.einsum("m,mij,j->i", u[k], N, y)
    run = Trajectory(0.01 * np.arange(200), np.array(outputs), u)
    procedure = KoopmanLeastSquares(Koopman(2, 3, delays=0, input_delays=0, constant=constant, bilinear=True))
    model, first = solve_stages(procedure, [run]), int(constant)
    scale = model.scale.numpy()
    for found, true in ((model.A, A), *zip(model.N, N)):
        np.testing.assert_allclose(found.detach().numpy()[first:, first:] * scale[:, None] / scale, true, atol=1e-9)
    np.testing.assert_allclose(model.B.detach().numpy()[first:] * scale[:, None], B, atol=1e-9)
    assert not model.N[:, :, :first].any()


def test_ridge_and_lasso_are_those_of_scikit_learn_on_scaled_features(solve_stages):
    X, Y = RNG.normal(size=(200, 6)) * [1, 5, 0.1, 1, 2, 1], RNG.normal(size=(200, 2))
    X[:, 5] = X[:, 0] + 0.01 * X[:, 5]
    size, height = np.linalg.norm(X, axis=0), np.linalg.norm(Y, axis=0)
    regression = StreamedRegression()
    for part in np.array_split(np.arange(200), 3):
        regression.accumulate(torch.from_numpy(X[part]), torch.from_numpy(Y[part]))
    ridge = Ridge(alpha=0.03, fit_intercept=False).fit(X / size, Y).coef_ / size
    np.testing.assert_allclose(regression.solve(0.03).coefficients.numpy(), ridge, rtol=1e-9)
    theirs = Lasso(alpha=0.02 / 200, fit_intercept=False, tol=1e-12, max_iter=100000).fit(X / size, Y / height)
    ours = regression.solve(0.02, penalty="lasso").coefficients.numpy()
    np.testing.assert_allclose(ours, theirs.coef_ / size * height[:, None], rtol=1e-7, atol=1e-10)
    assert (regression.solve(1.0, penalty="lasso").coefficients == 0).all()


@pytest.mark.parametrize("penalty", [1e-9, 1e-6, 1e-3])
def test_the_lasso_is_optimal_for_features_that_are_nearly_alike(penalty):
    """Optimality: X_jᵀ(y - X w) = λ sign(w_j) where w_j ≠ 0, at most λ in size elsewhere, for columns of norm one."""
    X = RNG.normal(size=(300, 8))
    X[:, 4:] = X[:, :4] + 1e-3 * X[:, 4:]
    Y = X @ RNG.normal(size=(8, 2)) + 1e-5 * RNG.normal(size=(300, 2))
    X, Y = X / np.linalg.norm(X, axis=0), Y / np.linalg.norm(Y, axis=0)
    regression = StreamedRegression()
    regression.accumulate(torch.from_numpy(X), torch.from_numpy(Y))
    W = regression.solve(penalty, penalty="lasso").coefficients.numpy().T
    gradient = X.T @ (Y - X @ W)
    np.testing.assert_allclose(gradient[W != 0], penalty * np.sign(W[W != 0]), rtol=1e-4)
    assert np.abs(gradient).max() <= (1 + 1e-4) * penalty


@pytest.mark.parametrize("relift", [False, True])
def test_the_constant_and_the_delayed_copies_are_exact_whatever_the_ridge(solve_stages, relift):
    runs = pendulum_runs()
    procedure = KoopmanLeastSquares(Koopman(2, 2, delays=2, input_delays=2, degree=2, relift=relift))
    model = solve_stages(procedure, runs, ridge=0.1)
    run = runs[0]
    window = torch.from_numpy(np.array(run.observation[10:14]))
    inputs = torch.from_numpy(np.array(run.input[10:14]))
    following = model.reduced.advance(model.encode(window[:3], inputs[:2]), inputs[2])
    expected = model.encode(window[1:], inputs[1:3])
    known = [0, *range(1 + 2, 1 + 10)]  # the constant, then what is delayed among the linear monomials
    torch.testing.assert_close(following[known], expected[known], rtol=1e-12, atol=1e-12)


def set_points(gain, count=12, hold=15):
    rng = np.random.default_rng(1)
    levels = rng.uniform(0, 1, (count, 2))
    u = np.repeat(levels, hold, axis=0)
    y = np.zeros((count * hold, 2))
    for k in range(1, len(u)):
        y[k] = y[k - 1] + 0.5 * (u[k - 1] @ gain.T - y[k - 1])
    return Trajectory(0.01 * np.arange(len(u)), y, u, "static")


@pytest.mark.parametrize("rows_each", [7, 1024])
def test_the_pregain_is_the_ridge_solution_over_the_set_points(solve_stages, rows_each):
    run = set_points(np.array([[0.3, 0.1], [0.0, 0.2]]))
    model = Koopman(2, 2, input_delays=0, constant=False, pregain=True)
    solve_stages(KoopmanLeastSquares(model), [*pendulum_runs(), run], ridge={"pregain": 1e-3}, rows=rows_each)
    last = np.arange(14, 12 * 15, 15)
    y, u = np.asarray(run.observation)[last], np.asarray(run.input)[last]
    y = np.hstack([np.ones((12, 1)), y])
    size = np.diag((y**2).sum(0))
    expected = np.linalg.solve(y.T @ y + 1e-3 * size, y.T @ u).T
    np.testing.assert_allclose(model.pregain.numpy(), expected, rtol=1e-9)
    np.testing.assert_allclose((model.set_points.T @ model.set_points).numpy(), y.T @ y / 12, rtol=1e-9)


def test_rounding_of_the_recorded_inputs_makes_no_set_points(solve_stages):
    run = set_points(np.array([[0.3, 0.1], [0.0, 0.2]]))
    rounded = np.array(run.input) * (1 + 1e-15 * RNG.integers(-1, 2, run.input.shape))
    models = [solve_stages(KoopmanLeastSquares(Koopman(2, 2, input_delays=0, constant=False, pregain=True)),
                           [*pendulum_runs(), Trajectory(run.time, run.observation, inputs, "static")])
              for inputs in (run.input, rounded)]
    torch.testing.assert_close(models[0].pregain, models[1].pregain, rtol=1e-9, atol=0)


@pytest.mark.parametrize(("options", "message"), [
    ({"input_delays": 3}, "input_delays is 3; expected 0 to 1, the number of delays"), ({"degree": 0}, "degree is 0")])
def test_impossible_liftings_are_refused(options, message):
    with pytest.raises(ValueError, match=message):
        Koopman(2, 2, **options)


def test_missing_runs_and_odd_timesteps_are_refused(solve_stages):
    model = Koopman(2, 2, input_delays=0, constant=False, pregain=True)
    with pytest.raises(ValueError, match="pregain stage found no data: there are no static runs"):
        solve_stages(KoopmanLeastSquares(model), pendulum_runs())
    with pytest.raises(ValueError, match="0.025 s, which is 2.5 times the data's, 0.01 s"):
        KoopmanLeastSquares(Koopman(2, 2, timestep=0.025)).sampled_every(0.01)
    with pytest.raises(ValueError, match=r"kinds\[0\] is 'all'; expected"):
        KoopmanLeastSquares(Koopman(2, 2), kinds=("all",))
