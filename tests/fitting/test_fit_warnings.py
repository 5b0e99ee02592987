"""Warnings about a fit: counted divergence, and a warning for each doubtful result."""

from types import SimpleNamespace

import numpy as np
import pytest
import torch

from ssmr_torch.fitting.fit_warnings import STARTS_AT_ONCE, diagnose, training_divergence
from ssmr_torch.models.base import DIVERGENCE_FACTOR
from ssmr_torch.models.ssmr import SSMR
from ssmr_torch.trajectory import Trajectory

TIMESTEP = 0.1


def run(samples, start=0.5, kind="decay"):
    return Trajectory(TIMESTEP * np.arange(samples), np.full((samples, 1), start), np.zeros((samples, 1)), kind)


def scalar(rate, cubic=0.0, delays=0):
    """dz/dt = rate z + cubic z³, y = z with the newest sample as chart, trusted up to 1."""
    model = SSMR(1, 1, 1, delays, dynamics_degree=3, control_degree=0, timestep=TIMESTEP, substeps=4)
    with torch.no_grad():
        model.chart[0, -1] = model.parametrization[-1, 0] = 1.0
        model.drift_table[0] = torch.tensor([rate, 0.0, cubic])
        model.state_scale.fill_(1.0)
    return model


def growth_steps(rate, start=0.5):
    """Steps after which a start grows beyond the bound."""
    return int(np.ceil(np.log(DIVERGENCE_FACTOR / start) / rate / TIMESTEP))


@pytest.mark.parametrize("delays", [0, 2])
def test_a_decay_is_followed_over_its_full_length_and_no_further(delays):
    steps = growth_steps(1.0)
    model = scalar(1.0, delays=delays)
    reached, missed = run(delays + steps + 1), run(delays + steps)
    assert training_divergence(model, [reached]) == {"decay": 1.0}
    assert training_divergence(model, [missed]) == {"decay": 0.0}
    assert training_divergence(model, [reached, missed, missed, run(delays + 200)]) == {"decay": 0.5}


def test_a_controlled_run_is_cut_into_stretches_of_the_horizon():
    """From 0.5 the model of rate 1 needs 30 steps to diverge; from 5 it needs 7."""
    observation = np.r_[np.full(20, 0.5), np.full(21, 5.0)][:, None]
    mixed = Trajectory(TIMESTEP * np.arange(41), observation, np.zeros((41, 1)), "controlled")
    assert growth_steps(1.0, 5.0) == 7 < 10 < growth_steps(1.0)
    assert training_divergence(scalar(1.0), [mixed], horizon=1.0) == {"controlled": 0.5}
    assert training_divergence(scalar(1.0), [mixed], horizon=0.6) == {"controlled": 0.0}
    assert training_divergence(scalar(1.0), [mixed], horizon=100.0) == {"controlled": 1.0}


def test_starts_are_all_counted_when_they_are_more_than_fit_at_once():
    observation = np.where(np.arange(3 * STARTS_AT_ONCE + 1)[:, None] < STARTS_AT_ONCE + 7, 5.0, 0.0)
    long = Trajectory(TIMESTEP * np.arange(len(observation)), observation, 0 * observation, "controlled")
    assert growth_steps(5.0, 5.0) == 2 and growth_steps(10.0, 5.0) == 1
    assert training_divergence(scalar(5.0), [long], horizon=TIMESTEP) == {"controlled": 0.0}
    expected = (STARTS_AT_ONCE + 7) / (3 * STARTS_AT_ONCE)
    assert training_divergence(scalar(10.0), [long], horizon=TIMESTEP)["controlled"] == pytest.approx(expected)


def test_kinds_without_runs_long_enough_are_left_out():
    assert training_divergence(scalar(-1.0, delays=3), [run(4), run(50, kind="static")]) == {}


def planar(**changes):
    """Two reduced coordinates seen through four outputs: nothing is doubtful about it."""
    model = SSMR(**{"state_dim": 2, "input_dim": 1, "output_dim": 4, "delays": 0, "dynamics_degree": 2,
                    "timestep": TIMESTEP, "substeps": 10} | changes)
    with torch.no_grad():
        model.chart[:, :2] = model.parametrization[:2, :2] = torch.eye(2, dtype=torch.float64)
        model.drift_table[:, :2] = torch.tensor([[-1.0, 3.0], [-3.0, -1.0]])
        model.state_scale.fill_(1.0)
    return model


def planar_runs(decays=8):
    time = TIMESTEP * np.arange(30)
    return [Trajectory(time, np.full((30, 4), 0.1), np.zeros((30, 1)), kind)
            for kind in ["decay"] * decays + ["controlled"]]


def report_of(model, runs=None, condition=10.0, regression="drift", values=(1.0, 0.5, 1e-3, 1e-4)):
    fit = SimpleNamespace(model=model, solutions={regression: {"condition": condition}},
                          procedure=SimpleNamespace(singular_values=torch.tensor(values, dtype=torch.float64)))
    return diagnose(fit, planar_runs() if runs is None else runs)


def test_a_good_fit_has_no_warnings_and_its_report_holds_plain_values():
    report = report_of(planar())
    assert report["warnings"] == []
    np.testing.assert_allclose(sorted(report["eigenvalues"]), [[-1.0, -3.0], [-1.0, 3.0]], rtol=1e-12)
    assert report["captured_variance"] == pytest.approx(1.25 / (1.25 + 1e-6 + 1e-8), rel=1e-12)
    assert (report["window_dim"], report["state_dim"]) == (4, 2)
    assert report["trajectories"] == {"decay": 8, "controlled": 1}
    assert report["diverged"] == {"decay": 0.0, "controlled": 0.0}


def only_warning(report):
    (warning,) = report["warnings"]
    return warning


def test_a_window_with_as_many_values_as_coordinates_gives_a_warning():
    model = SSMR(4, 1, 4, 0, dynamics_degree=2, timestep=TIMESTEP)
    with torch.no_grad():
        model.drift_table[:, :4] = -torch.eye(4)
        model.state_scale.fill_(1.0)
    warning = only_warning(report_of(model))
    assert warning.startswith("The window holds p = 4 values and there are n = 4 reduced coordinates")


def test_unstable_eigenvalues_are_counted_with_the_largest():
    model = planar()
    with torch.no_grad():
        model.drift_table[:, :2] = torch.tensor([[0.02, 3.0], [-3.0, 0.02]])
    assert only_warning(report_of(model)).startswith("2 eigenvalues of the reduced dynamics are unstable (largest real "
                                                     "part 0.02 1/s)")


@pytest.mark.parametrize(("decays", "degree", "doubtful"), [(1, 2, True), (2, 2, False), (2, 3, True), (0, 1, False)])
def test_too_few_decays_for_the_degree_give_a_warning(decays, degree, doubtful):
    warnings = report_of(planar(dynamics_degree=degree), planar_runs(decays))["warnings"]
    needed = {1: 2, 2: 5, 3: 9}[degree]
    said = f"{decays} decays are too few for {needed} coefficients per row"
    assert doubtful == any(warning.startswith(said) for warning in warnings)
    joint = report_of(planar(dynamics_degree=degree), planar_runs(decays), regression="dynamics")["warnings"]
    assert not any("coefficients per row" in warning for warning in joint)


def test_missing_decays_give_a_warning():
    assert any(warning.startswith("No decays") for warning in report_of(planar(), planar_runs(0))["warnings"])


@pytest.mark.parametrize("condition", [1e9, float("inf")])
def test_an_ill_conditioned_regression_is_named(condition):
    assert only_warning(report_of(planar(), condition=condition)).startswith(
        f"The drift regression has condition number {condition:.2g}")


def test_little_captured_variance_gives_a_warning_with_the_share():
    assert only_warning(report_of(planar(), values=(1.0, 0.5, 0.5, 0.1))).startswith(
        "The 2 leading directions capture 82.8 % of the variance, less than 95 %")


def test_divergence_gives_a_warning_with_its_share():
    """dr/dt = -r + 30 r³ from r = 0.1 √2 shrinks, from twice that it explodes."""
    model = planar(dynamics_degree=3)
    with torch.no_grad():
        for row, monomials in enumerate(([0, 2], [1, 3])):
            model.drift_table[row, [5 + index for index in monomials]] = 30.0
    runs = planar_runs(6)
    runs += [Trajectory(run.time, 2 * run.observation, run.input, "decay") for run in runs[:2]]
    report = report_of(model, runs)
    assert report["diverged"] == {"decay": 0.25, "controlled": 0.0}
    assert only_warning(report).startswith("25 % of the decay training rollouts diverge")
