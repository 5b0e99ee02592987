"""The authors' published fits, reproduced from their measurements."""

import numpy as np
import pytest
import scipy.io
import torch

from ssmr_torch.data.matlab_reader import read_koopman_struct, read_ssmlearn_cells
from ssmr_torch.data.windows import Segment, delay_windows
from ssmr_torch.fitting.dimension import captured_variance, dimension_by_gap, window_singular_values
from ssmr_torch.fitting.koopman_least_squares import KoopmanLeastSquares
from ssmr_torch.fitting.ssmr_least_squares import SSMRLeastSquares
from ssmr_torch.fitting.streamed_least_squares import StreamedRegression
from ssmr_torch.models.koopman import Koopman
from ssmr_torch.models.monomials import graded
from ssmr_torch.models.ssmr import SSMR
from ssmr_torch.paper.models import read_ssmr_model
from ssmr_torch.trajectory import Trajectory

TEST = (4, 14, 20, 31, 37)
TRAIN = tuple(i for i in range(39) if i not in TEST)


def uniform(time, observation, inputs, delays, kind, timestep=None):
    """The authors' clock: the run's first two samples that windows and differences leave give its timestep."""
    timestep = time[delays + 4] - time[delays + 3] if timestep is None else timestep
    return Trajectory(timestep * np.arange(len(time)), observation, inputs, kind)


@pytest.fixture
def decays(measurements):
    cells = read_ssmlearn_cells(measurements("diamond_hardware/decays.mat"))
    return lambda delays, timestep=None: [
        uniform(time, 1e-3 * y[:, 12:15], np.zeros((len(time), 4)), delays, "decay", timestep) for time, y in cells]


@pytest.fixture
def cubic(decays, solve_stages):
    runs = decays(4)
    model = SSMR(6, 4, 3, 4, parametrization_degree=3, dynamics_degree=3, control_degree=0, substeps=4)
    procedure = SSMRLeastSquares(model, calibration="frozen", parametrization_fit="full")
    solve_stages(procedure, runs, stages=["tangent_space"])
    solve_stages(procedure, [runs[i] for i in TRAIN], stages=["manifold"])
    return model, runs


def parametrization_error(model, runs):
    shares = []
    for run in runs:
        window = delay_windows(torch.from_numpy(run.observation.copy()), model.delays)
        error = (model.reduced.decode_window(model.encode(window)) - window).flatten(1)
        shares.append(float(error.norm(dim=1).mean() / window.flatten(1).norm(dim=1).max()))
    return 100 * np.mean(shares)


@torch.no_grad()
def test_the_cubic_manifold_of_the_real_diamond_has_the_published_errors_and_rates(cubic):
    model, runs = cubic
    assert parametrization_error(model, [runs[i] for i in TRAIN]) == pytest.approx(0.7927, abs=5e-5)
    assert parametrization_error(model, [runs[i] for i in TEST]) == pytest.approx(0.7303, abs=5e-5)
    eigenvalues = torch.linalg.eigvals(model.drift_table[:, :6]).numpy()
    upper = sorted(eigenvalues[eigenvalues.imag > 0], key=lambda value: value.imag)
    expected = [-0.8583 + 25.8497j, -1.1318 + 26.2102j, -0.9418 + 26.6781j]
    np.testing.assert_allclose(upper, expected, atol=6e-5)


@torch.no_grad()
@pytest.mark.parametrize(("degree", "published"), [
    (3, 8.5), pytest.param(2, 10.5, marks=pytest.mark.slow), pytest.param(1, 12.7, marks=pytest.mark.slow)])
def test_held_out_decays_of_the_real_diamond_are_predicted_as_published(decays, solve_stages, degree, published):
    runs = decays(4, timestep=0.01)
    model = SSMR(6, 4, 3, 4, parametrization_degree=degree, dynamics_degree=degree, control_degree=0, substeps=2)
    procedure = SSMRLeastSquares(model, calibration="frozen", parametrization_fit="full")
    solve_stages(procedure, runs, stages=["tangent_space"])
    solve_stages(procedure, [runs[i] for i in TRAIN], stages=["manifold"])
    shares = []
    for i in TEST:
        window = delay_windows(torch.from_numpy(runs[i].observation.copy()), 4)
        inputs = torch.zeros(len(window) - 1, 4, dtype=torch.float64)
        states = model.rollout(model.encode(window[0]), inputs).states
        error = (model.reduced.decode_window(states) - window).flatten(1).norm(dim=1).mean()
        shares.append(100 * float(error / window.flatten(1).norm(dim=1).max()))
    assert np.median(shares) == pytest.approx(published, abs=0.05)


def test_six_modes_capture_the_published_variance(decays):
    for delays, published in ((4, 99.80), (9, 99.47)):
        values = window_singular_values(decays(delays), delays)
        assert 100 * captured_variance(values)[5] == pytest.approx(published, abs=5e-3)
        assert dimension_by_gap(values) == 6


def test_the_published_reference_model_is_reproduced_by_reparametrization(decays, solve_stages, measurements):
    runs = decays(9)
    irregular = read_koopman_struct(measurements("diamond_hardware/calibration_irregular.mat"))
    rest = np.ravel(irregular["y_eq"])[12:15]
    controlled = uniform(irregular["t"], 1e-3 * (irregular["y"][:, 12:15] - rest), irregular["u"], 1, "controlled")
    model = SSMR(6, 4, 3, 1, parametrization_degree=3, dynamics_degree=3, control_degree=0, chart_degree=3)
    procedure = SSMRLeastSquares(model, calibration="frozen", parametrization_fit="tangent",
                                 input_alignment="sample", detection_delays=9)
    solve_stages(procedure, runs, stages=["tangent_space"])
    solve_stages(procedure, [runs[i] for i in TRAIN], stages=["reparametrization", "manifold"])
    solve_stages(procedure, [controlled], stages=["control"])
    fitted, published = model.reduced.numpy(), read_ssmr_model(measurements("diamond_hardware/reference_model.mat"))
    signs = np.sign((fitted.chart[:, :6] * published.chart[:, :6]).sum(1))
    flipped = np.prod(signs ** graded(6, 1, 3).exponents, axis=1)
    for ours, theirs in ((fitted.parametrization * flipped, published.parametrization),
                         (signs[:, None] * fitted.chart, published.chart),
                         (signs[:, None] * fitted.dynamics[:, :83] * flipped, published.dynamics[:, :83]),
                         (signs[:, None] * fitted.dynamics[:, 83:], published.dynamics[:, 83:])):
        assert np.linalg.norm(ours - theirs) < 1e-8 * np.linalg.norm(theirs)
    stored = scipy.io.loadmat(measurements("diamond_hardware/reference_model.mat"))["py_data"][0, 0]["model"][0, 0]
    np.testing.assert_allclose(1e3 * signs[0] * fitted.dynamics[0, 83:], stored["B"][0], rtol=1e-7)
    np.testing.assert_allclose(stored["B"][0], [-8.6632, -27.1401, 0.7256, 67.6812], atol=5e-5)


def test_the_published_pregain_of_the_trunk_is_twice_the_ridge_solution_over_its_set_points(measurements):
    """Theirs minimizes Σ ‖v - G y'‖² + ‖G‖² in scaled coordinates without a constant; the factor 2 is their slip. They
    take each observation a sample before the last one of its input, and leave out the last set point.
    """
    static = read_koopman_struct(measurements("trunk_simulated/static.mat"))
    model = scipy.io.loadmat(measurements("trunk_simulated/reference_dmd_pregain.mat"), simplify_cells=True)["py_data"]
    scale = model["params"]["scale"]
    y, u = ((static[name] - scale[f"{name}_offset"]) / scale[f"{name}_factor"] for name in ("y", "u"))
    procedure = KoopmanLeastSquares(Koopman(8, 3, input_delays=0, constant=False, pregain=True))

    def pregain(y, u):
        segment = Segment(torch.from_numpy(y), torch.from_numpy(u), 0.01, (0, len(y) - 1), "static", 0, 0)
        points, levels = procedure.regressions(segment, "pregain")["pregain"]
        regression = StreamedRegression()
        regression.accumulate(points[:, 1:], levels)
        regression.accumulate(torch.eye(3, dtype=torch.float64), torch.zeros(3, 8, dtype=torch.float64))
        return regression.solve(0.0)

    theirs = pregain(y[:-1], u[1:])
    assert theirs.rows == 100 + 3
    np.testing.assert_allclose(2 * theirs.coefficients, model["model"]["G"], rtol=0, atol=1e-10)
    np.testing.assert_allclose(2 * pregain(y, u).coefficients, model["model"]["G"], rtol=0, atol=1e-3)
