"""Koopman models in closed form, against independent least squares."""

import numpy as np
import pytest
import torch
from sklearn.linear_model import Lasso, Ridge
from sklearn.preprocessing import PolynomialFeatures

from ssmr_torch.fitting.koopman_least_squares import KoopmanLeastSquares
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
    return model.decode(model.advance(z, torch.from_numpy(u))).detach().numpy()


@pytest.mark.parametrize("degree", [1, 2])
@pytest.mark.parametrize("stride", [1, 3])
def test_the_transition_is_that_of_an_independent_least_squares(solve_stages, degree, stride):
    runs = pendulum_runs()
    procedure = KoopmanLeastSquares(Koopman(2, 2, degree=degree, timestep=0.01 * stride))
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


def test_a_bilinear_system_is_recovered(solve_stages):
    rng = np.random.default_rng(0)
    A, B, N = 0.5 * rng.normal(size=(3, 3)) / 3**0.5, rng.normal(size=(3, 2)), 0.2 * rng.normal(size=(2, 3, 3))
    y, u, outputs = np.zeros(3), rng.uniform(-1, 1, (200, 2)), []
    for k in range(200):
        outputs.append(y)
        y = A @ y + B @ u[k] + np.einsum("m,mij,j->i", u[k], N, y)
    run = Trajectory(0.01 * np.arange(200), np.array(outputs), u)
    model = solve_stages(KoopmanLeastSquares(Koopman(2, 3, delays=0, input_delays=0, constant=False, bilinear=True)),
                         [run])
    scale = model.scale.numpy()
    for found, true in ((model.A, A), *zip(model.N, N)):
        np.testing.assert_allclose(found.detach().numpy() * scale[:, None] / scale, true, atol=1e-9)
    np.testing.assert_allclose(model.B.detach().numpy() * scale[:, None], B, atol=1e-9)


def test_ridge_and_lasso_are_those_of_scikit_learn_on_scaled_features(solve_stages):
    from ssmr_torch.fitting.statistics import StreamedRegression

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
    np.testing.assert_allclose(ours, theirs.coef_ / size * height[:, None], rtol=1e-4, atol=1e-6)
    assert (regression.solve(1.0, penalty="lasso").coefficients == 0).all()


def test_the_constant_and_the_delayed_copies_are_exact_whatever_the_ridge(solve_stages):
    runs = pendulum_runs()
    model = solve_stages(KoopmanLeastSquares(Koopman(2, 2, delays=2, input_delays=2, degree=2)), runs, ridge=0.1)
    run = runs[0]
    window = torch.from_numpy(np.array(run.observation[10:14]))
    inputs = torch.from_numpy(np.array(run.input[10:14]))
    following = model.advance(model.encode(window[:3], inputs[:2]), inputs[2])
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


@pytest.mark.parametrize(("options", "message"), [
    ({"input_delays": 3}, "input_delays is 3; expected 0 to the 1 delays"), ({"degree": 0}, "degree is 0")])
def test_impossible_liftings_are_refused(options, message):
    with pytest.raises(ValueError, match=message):
        Koopman(2, 2, **options)


def test_missing_runs_and_odd_timesteps_are_refused(solve_stages):
    model = Koopman(2, 2, input_delays=0, constant=False, pregain=True)
    with pytest.raises(ValueError, match="pregain stage found no rows: the training data hold no static runs"):
        solve_stages(KoopmanLeastSquares(model), pendulum_runs())
    with pytest.raises(ValueError, match="0.025 s, 2.5 times the data's 0.01 s"):
        KoopmanLeastSquares(Koopman(2, 2, timestep=0.025)).sampled_every(0.01)
    with pytest.raises(ValueError, match="kinds is .*; expected some of"):
        KoopmanLeastSquares(Koopman(2, 2), kinds=("all",))
