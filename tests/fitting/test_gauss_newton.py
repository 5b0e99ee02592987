"""Gauss-Newton steps on the rollout error."""

import lightning
import numpy as np
import pytest
import torch
from scipy.optimize import least_squares

from ssmr_torch.data.datamodule import TrajectoryDataModule
from ssmr_torch.fitting.gauss_newton import COLUMNS, GaussNewtonFit, LevenbergMarquardt
from ssmr_torch.fitting.rollout_sensitivities import GROUPS
from ssmr_torch.fitting.stability import StabilityGuard
from ssmr_torch.models.control_augmented import ControlAugmentedSSMR
from ssmr_torch.models.ssmr import SSMR


def rosenbrock(x):
    return torch.stack([10 * (x[1] - x[0] ** 2), 1 - x[0]])


def test_levenberg_marquardt_finds_the_minimum_that_scipy_finds():
    x = torch.tensor([-1.2, 1.0], dtype=torch.float64)
    optimizer = LevenbergMarquardt([torch.nn.Parameter(torch.zeros(1))], [x], damping=1e-2)
    costs = []
    for _ in range(60):
        optimizer.accumulate(torch.func.jacrev(rosenbrock)(x), -rosenbrock(x))
        costs.append(optimizer.step(lambda: float(rosenbrock(x).square().sum())))
    expected = least_squares(lambda v: rosenbrock(torch.from_numpy(v)).numpy(), [-1.2, 1.0], method="lm").x
    np.testing.assert_allclose(x.numpy(), expected, atol=1e-7)
    assert all(later <= earlier for earlier, later in zip(costs, costs[1:]))


@pytest.mark.parametrize("columns", [2, COLUMNS], ids=["one block of columns", "several"])
def test_on_a_linear_problem_one_undamped_step_is_least_squares(columns):
    rng = np.random.default_rng(0)
    rows, size = 10 * columns, 2 * columns + 2
    A, b = (torch.from_numpy(rng.normal(size=shape)) for shape in ((rows, size), (rows,)))
    tables = [torch.zeros(2, columns, dtype=torch.float64), torch.zeros(2, dtype=torch.float64)]
    optimizer = LevenbergMarquardt([torch.nn.Parameter(torch.zeros(1))], tables, damping=1e-12)
    for half in (slice(0, rows // 3), slice(rows // 3, rows)):
        optimizer.accumulate(A[half], b[half])
    optimizer.step(lambda: float((A @ torch.cat([t.flatten() for t in tables]) - b).square().sum()))
    found = torch.cat([t.flatten() for t in tables])
    torch.testing.assert_close(found, torch.linalg.lstsq(A, b).solution, rtol=1e-8, atol=1e-10)


def test_a_step_that_lowers_no_cost_is_undone():
    x = torch.ones(3, dtype=torch.float64)
    optimizer = LevenbergMarquardt([torch.nn.Parameter(torch.zeros(1))], [x], 1e-2)
    optimizer.accumulate(torch.eye(3, dtype=torch.float64), x)  # the wrong sign: uphill
    assert optimizer.step(lambda: float(x.square().sum())) == 3.0 and optimizer.gain == 0.0
    assert (x == 1).all()


def fitted(model, dataset, tmp_path, **options):
    module = TrajectoryDataModule(dataset, transient=0.0, validation_share=0.2, validation_horizon=0.3)
    fit = GaussNewtonFit(model, **{"epochs": 8, "starts": 60, "horizon": 0.3, "trained": GROUPS} | options)
    trainer = lightning.Trainer(max_epochs=fit.epochs, accelerator="cpu", logger=False, enable_progress_bar=False,
                                enable_checkpointing=False, enable_model_summary=False, num_sanity_val_steps=0,
                                default_root_dir=tmp_path)
    module.prepare(fit)
    errors = [trainer.validate(fit, module, verbose=False)[0]["validation/rmse"]]
    trainer.fit(fit, module)
    errors.append(trainer.validate(fit, module, verbose=False)[0]["validation/rmse"])
    return fit, errors, trainer


def started(known, kind):
    """A linear model near the known robot's: its slow linear dynamics, nothing nonlinear."""
    options = {"substeps": 1} if kind is SSMR else {"input_degree": 3, "saturated": False}
    model = kind(2, 2, 4, 0, dynamics_degree=3, parametrization_degree=2, timestep=0.01, **options)
    drift = model.drift_table if kind is SSMR else model.dynamics_table
    with torch.no_grad():
        V = torch.from_numpy(known.V)
        model.chart.copy_(V.T)
        model.parametrization[:, :2] = V
        drift[:, :2] = torch.from_numpy(known.A)
        control = model.control_table[:, :2] if kind is SSMR else model.dynamics_table[:, 2:4]
        control.copy_(torch.from_numpy(known.B))
        model.state_scale.fill_(0.02)
    return model


@pytest.mark.filterwarnings("ignore:.*does not have many workers")
@pytest.mark.filterwarnings("ignore:.*smaller than the logging interval")
@pytest.mark.parametrize("kind", [pytest.param(SSMR, marks=pytest.mark.slow), ControlAugmentedSSMR])
def test_nonlinear_terms_are_found_and_the_result_passes_the_guard(known, tmp_path, kind):
    model = started(known, kind)
    dataset = known.dataset()
    fit, (before, after), trainer = fitted(model, dataset, tmp_path)
    assert after < 0.05 * before
    assert fit.guard.holds(model) and fit.repairs == {}
    assert trainer.current_epoch <= fit.epochs


@pytest.mark.filterwarnings("ignore:.*does not have many workers")
@pytest.mark.filterwarnings("ignore:.*smaller than the logging interval")
def test_an_unstable_first_model_is_repaired_before_the_fit(known, tmp_path):
    model = started(known, SSMR)
    with torch.no_grad():
        model.drift_table[:, :2] += 2 * torch.eye(2)
    fit, (before, after), _ = fitted(model, known.dataset(), tmp_path, epochs=2)
    assert fit.repairs["eigenvalues moved"] == 2 and after < before
    assert StabilityGuard(known.decays(0.01)).holds(model)


@pytest.mark.filterwarnings("ignore:.*does not have many workers")
@pytest.mark.filterwarnings("ignore:.*smaller than the logging interval")
@pytest.mark.parametrize(("kind", "share"), [
    pytest.param(SSMR, 0.08, marks=pytest.mark.slow), (ControlAugmentedSSMR, 0.03)])
def test_a_model_that_diverges_under_larger_inputs_is_corrected(known, tmp_path, kind, share):
    model, dataset = started(known, kind), known.dataset()
    table = model.drift_table if kind is SSMR else model.dynamics_table
    exponents = torch.from_numpy(model.structure.dynamics.exponents[:table.shape[1]])
    with torch.no_grad():
        for row, powers in [(0, [3, 0]), (0, [1, 2]), (1, [2, 1]), (1, [0, 3])]:  # + |z|² z, which the robot has with −
            at = torch.tensor(powers + [0] * (exponents.shape[1] - 2))
            table[row, (exponents == at).all(1)] = share * known.gamma
    guard = StabilityGuard(dataset.select("train"), overdrive=1.5)
    lost = guard.diverging(model)
    fit, (before, after), _ = fitted(model, dataset, tmp_path, overdrive=1.5)
    assert lost > 0 and fit.repairs == {}
    assert guard.holds(model) and after < 0.05 * before


@pytest.mark.parametrize(("options", "message"), [
    ({"epochs": -1}, "epochs is -1; expected"), ({"horizon": 0.0}, "horizon is 0.0 s; expected"),
    ({"trained": ["everything"]}, "expected one or more of")])
def test_impossible_settings_are_refused(options, message):
    with pytest.raises(ValueError, match=message):
        GaussNewtonFit(SSMR(2, 1, 2), **options)


def test_more_coefficients_than_a_step_can_take_are_refused():
    with pytest.raises(ValueError, match="can train at most 6000"):
        GaussNewtonFit(ControlAugmentedSSMR(12, 8, 9, 1, dynamics_degree=3))
