"""Polynomial models in closed form from their structure, on systems whose answer is known."""

import numpy as np
import pytest
import torch

from ssmr_torch.fitting.linear_start import LinearStart
from ssmr_torch.fitting.polynomial_least_squares import PolynomialLeastSquares
from ssmr_torch.fitting.rollout_sensitivities import coefficients
from ssmr_torch.fitting.ssmr_least_squares import SSMRLeastSquares
from ssmr_torch.models.control_augmented import ControlAugmentedSSMR
from ssmr_torch.models.monomials import Monomials, graded
from ssmr_torch.models.neural_ode import NeuralODE
from ssmr_torch.models.ssmr import SSMR
from ssmr_torch.models.structure import Structure
from ssmr_torch.models.torch_model import PolynomialTorchModel, table
from ssmr_torch.trajectory import Trajectory

H = 0.01
A = np.array([[-1.0, 9.0], [-9.0, -2.0]])
B = np.array([[0.4, -0.3], [0.2, 0.5]])


def joint_map(z, u):
    """z⁺ = z + h (A z + B u + terms in z₁², z₁ u₂ and u₁ u₂)."""
    bend = np.array([-3 * z[0] ** 2, 2 * z[0] * u[1]]) + np.array([0.2, -0.1]) * u[0] * u[1]
    return z + H * (A @ z + B @ u + bend)


def linear_map(z, u):
    return z + H * (A @ z + B @ u)


def runs(step, read_out, count=4, length=200, decays=2):
    found = []
    for number in range(count + decays):
        rng = np.random.default_rng(number)
        kind = "decay" if number < decays else "controlled"
        u = np.zeros((length, 2)) if kind == "decay" else rng.uniform(0, 1, (length, 2))
        z, states = rng.uniform(-0.3, 0.3, 2), []
        for k in range(length):
            states.append(z)
            z = step(z, u[k])
        found.append(Trajectory(H * np.arange(length), np.array(states) @ read_out.T, u, kind))
    return found


def one_step_error(model, trajectories):
    """Largest relative error of the next output from the window, over all samples."""
    worst = 0.0
    for run in trajectories:
        y, u, d = torch.from_numpy(np.array(run.observation)), torch.from_numpy(np.array(run.input)), model.delays
        for k in range(d, len(y) - 1, 7):
            z = model.encode(y[k - d:k + 1], u[k - d:k])
            predicted = model.decode(model.step(z, u[k]))
            worst = max(worst, float((predicted - y[k + 1]).detach().norm() / y.norm(dim=1).max()))
    return worst


def test_a_joint_polynomial_map_of_state_and_input_is_recovered(solve_stages):
    read_out = np.linalg.qr(np.random.default_rng(5).normal(size=(3, 2))).Q
    trajectories = runs(joint_map, read_out)
    model = ControlAugmentedSSMR(2, 2, 3, 0, dynamics_degree=2, input_degree=2, timestep=H)
    solve_stages(PolynomialLeastSquares(model), trajectories, rows=64)
    assert one_step_error(model, trajectories) < 1e-10


def test_without_products_of_inputs_the_same_map_is_not_recovered(solve_stages):
    trajectories = runs(joint_map, np.eye(2))
    model = ControlAugmentedSSMR(2, 2, 2, 0, dynamics_degree=2, input_degree=1, timestep=H)
    solve_stages(PolynomialLeastSquares(model), trajectories)
    assert one_step_error(model, trajectories) > 1e-5


@pytest.mark.parametrize("future", [1, 10])
def test_a_predictive_chart_finds_the_state_behind_one_delayed_output(solve_stages, future):
    """One output with two delays shows both states only through the inputs held meanwhile."""
    trajectories = runs(linear_map, np.array([[1.0, 0.3]]))
    errors = {}
    for chart in ("tangent_space", "predictive"):
        model = ControlAugmentedSSMR(2, 2, 1, 2, dynamics_degree=1, timestep=H)
        options = {"future": future} if chart == "predictive" else {}
        solve_stages(PolynomialLeastSquares(model, chart=chart, **options), trajectories, rows=64)
        errors[chart] = one_step_error(model, trajectories)
    assert errors["predictive"] < 1e-8 < 1e-4 < errors["tangent_space"]


def test_cutting_runs_into_segments_changes_nothing(solve_stages):
    trajectories = runs(joint_map, np.eye(2))
    tables = []
    for rows in (37, 1024):
        model = ControlAugmentedSSMR(2, 2, 2, 1, timestep=H)
        solve_stages(PolynomialLeastSquares(model, chart="predictive", future=5), trajectories, rows=rows)
        tables.append(model.dynamics_table.abs().detach())
    torch.testing.assert_close(*tables, rtol=1e-6, atol=1e-8)


def test_impossible_options_and_missing_runs_are_refused(solve_stages):
    model = ControlAugmentedSSMR(2, 2, 2, 1)
    for options, message in (({"chart": "best"}, "chart is 'best'"), ({"manifold_data": "some"}, "manifold_data is"),
                             ({"future": 0}, "future is 0; expected")):
        with pytest.raises(ValueError, match=message):
            PolynomialLeastSquares(model, **options)
    for options, message in (({"chart": "tangent_space"}, "2 values in the window, fewer than the 3"),
                             ({"chart": "predictive", "future": 1}, "2 values in this and 1 further sample")):
        with pytest.raises(ValueError, match=message):
            PolynomialLeastSquares(ControlAugmentedSSMR(3, 2, 1, 1), **options)
    with pytest.raises(ValueError, match="there are no decays"):
        solve_stages(PolynomialLeastSquares(model, chart="tangent_space"), runs(linear_map, np.eye(2), decays=0))


class LiftedMap(PolynomialTorchModel):
    """z = [y_k, y_{k-1}, u_{k-1}] without a chart, z⁺ = A z + B u + terms in z₁² and z₁ u₂; y, its first, is given."""

    tables = {"chart": ("chart",), "parametrization": ("parametrization",), "dynamics": ("A", "rest")}

    def __init__(self, input_dim, output_dim, timestep=H, *, relift=False):
        p, m = output_dim, input_dim
        n, delayed = 2 * p + m, [*range(p, 2 * p), *range(p), *range(2 * p, 2 * p + m)]
        super().__init__(n, m, p, 1, timestep, None)
        self.structure = Structure(graded(n, 1, 1), tuple(delayed), graded(n, 1, 1),
                                   Monomials(n + m, [*((i,) for i in range(n + m)), (0, 0), (0, n + 1)]), "map",
                                   relift=relift)
        self.chart, self.A, self.rest = table(0, n), table(n, n), table(n, m + 2)
        self.register_buffer("parametrization", torch.eye(p, n, dtype=torch.float64))


def shear_map(z, u):
    """z⁺ = (A z + B u) with terms in z₁² and z₁ u₂."""
    return z + H * (A @ z + B @ u + np.array([-3 * z[0] ** 2, 2 * z[0] * u[1]]))


@pytest.mark.parametrize("relift", [False, True])
def test_a_map_of_the_lifted_window_is_recovered_without_a_stage_for_its_chart(solve_stages, relift):
    trajectories, model = runs(shear_map, np.eye(2)), LiftedMap(2, 2, relift=relift)
    procedure = PolynomialLeastSquares(model)
    assert procedure.stages == ("dynamics",) and procedure.fitted == ["dynamics"]
    solve_stages(procedure, trajectories, rows=64)
    assert one_step_error(model, trajectories) < 1e-9
    np.testing.assert_array_equal(model.parametrization, np.eye(2, 6))  # it was given


def test_a_refinement_of_a_chart_that_has_no_coefficients_is_refused():
    assert [table.shape[1] for table in coefficients(LiftedMap(2, 2), ["dynamics"])] == [6, 4]
    with pytest.raises(ValueError, match="LiftedMap has no coefficients in its chart; remove chart from trained"):
        coefficients(LiftedMap(2, 2), ["dynamics", "chart"])


def test_a_flow_is_recovered_by_the_derivative_of_its_states(known, solve_stages):
    model = SSMR(2, 2, 4, 0, parametrization_degree=2, dynamics_degree=3, control_degree=1, timestep=1e-3)
    solve_stages(PolynomialLeastSquares(model, chart="tangent_space"), [*known.decays(1e-3), *known.held_runs(1e-3)])
    errors = known.errors(model)
    assert errors["drift"] < 1e-5 and errors["control"] < 1e-4 and errors["outputs"] < 1e-9


def test_a_map_is_fitted_only_at_the_sampling_time_of_the_data():
    procedure = PolynomialLeastSquares(ControlAugmentedSSMR(2, 2, 2, 1, timestep=0.02))
    procedure.sampled_every(0.02)
    with pytest.raises(ValueError, match="covers 0.02 s, but the data are sampled every 0.01 s"):
        procedure.sampled_every(0.01)


def test_closed_form_fits_refuse_models_of_another_kind():
    with pytest.raises(ValueError, match="NeuralODE is not a polynomial model"):
        PolynomialLeastSquares(NeuralODE(2, 2, 2, 1))
    with pytest.raises(ValueError, match="NeuralODE cannot start from a linear model"):
        LinearStart(NeuralODE(2, 2, 2, 1))
    with pytest.raises(ValueError, match="ControlAugmentedSSMR is not an SSMR"):
        SSMRLeastSquares(ControlAugmentedSSMR(2, 2, 2, 1))
