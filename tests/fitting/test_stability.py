"""Guarded fits: stable linear parts, and no diverging rollout of the training set."""

import numpy as np
import pytest
import torch

from ssmr_torch.fitting.stability import StabilityGuard
from ssmr_torch.models.control_augmented import ControlAugmentedSSMR
from ssmr_torch.models.ssmr import SSMR
from ssmr_torch.trajectory import Trajectory


def run(samples=400, kind="controlled", amplitude=0.5):
    time = 0.01 * np.arange(samples)
    circle = amplitude * np.stack([np.cos(5 * time), np.sin(5 * time)], axis=1)
    return Trajectory(time, circle, np.ones((samples, 1)), kind)


def spiral(growth, cubic=0.0, kind=SSMR):
    """ż = growth z + 5 J z + cubic z₁³ e₁, or the same by Euler steps, seen directly."""
    options = {"parametrization_degree": 1, "substeps": 1} if kind is SSMR else {"input_degree": 3, "saturated": False}
    model = kind(2, 1, 2, 0, dynamics_degree=3, timestep=0.01, **options)
    table = model.drift_table if kind is SSMR else model.dynamics_table
    with torch.no_grad():
        model.chart.copy_(torch.eye(2))
        model.parametrization[:, :2] = torch.eye(2)
        table[:, :2] = torch.tensor([[growth, -5.0], [5.0, growth]])
        column = int(np.flatnonzero(model.structure.dynamics.exponents[:, 0] == 3)[0])
        table[0, column] = cubic
        model.state_scale.fill_(0.5)
    return model


GUARD = StabilityGuard([run(), run(300, "decay")], margin=0.1)


@pytest.mark.parametrize("kind", [SSMR, ControlAugmentedSSMR])
def test_a_stable_model_is_left_alone(kind):
    model = spiral(-1.0, kind=kind)
    before = {name: value.clone() for name, value in model.state_dict().items()}
    assert GUARD.holds(model) and GUARD.enforce(model) == {}
    assert all(torch.equal(value, before[name]) for name, value in model.state_dict().items())


def test_unstable_eigenvalues_are_moved_onto_the_margin_with_their_frequency():
    model = spiral(0.7)
    assert not GUARD.holds(model) and GUARD.enforce(model) == {"eigenvalues moved": 2.0}
    eigenvalues = torch.linalg.eigvals(model.drift_table[:, :2])
    torch.testing.assert_close(eigenvalues.real, torch.full((2,), -0.1, dtype=torch.float64))
    torch.testing.assert_close(eigenvalues.imag.abs(), torch.full((2,), 5.0, dtype=torch.float64))
    assert GUARD.holds(model)


def test_an_unstable_map_is_moved_onto_the_circle_that_the_margin_sets():
    model = spiral(0.7, kind=ControlAugmentedSSMR)
    GUARD.enforce(model)
    factors = 1 + 0.01 * torch.linalg.eigvals(model.dynamics_table[:, :2])
    torch.testing.assert_close(factors.abs(), torch.full((2,), np.exp(-0.001), dtype=torch.float64))
    torch.testing.assert_close(factors.angle().abs(), torch.full((2,), np.arctan2(0.05, 1.007), dtype=torch.float64))


@pytest.mark.parametrize("margin", [0.03, 0.05, 0.1, 0.7, 1.3])
def test_moved_eigenvalues_pass_the_guard_in_double_precision(margin):
    guard, model = StabilityGuard([run()], margin=margin), spiral(0.7, kind=ControlAugmentedSSMR)
    assert guard.stabilize(model) == 2 and guard.stabilize(model) == 0


@pytest.mark.parametrize("kind", [SSMR, ControlAugmentedSSMR])
def test_nonlinear_terms_that_diverge_are_shrunk_by_the_largest_factor_that_does_not(kind):
    model = spiral(-0.5, cubic=40.0, kind=kind)
    assert GUARD.diverges(model)
    factor = GUARD.enforce(model)["nonlinear terms multiplied by"]
    assert 0 < factor < 1 and not GUARD.diverges(model) and GUARD.holds(model)
    assert GUARD.diverges(spiral(-0.5, cubic=80.0 * factor, kind=kind))


def test_rollouts_of_the_guard_reach_the_end_of_a_run():
    slow = spiral(0.0, cubic=1.9)
    assert not StabilityGuard([run(60)]).diverges(slow)
    assert StabilityGuard([run(60), run(3000)]).diverges(slow)


def test_rollouts_of_the_guard_also_begin_within_a_run():
    from_rest = run(300)
    ahead = 1 - np.exp(-from_rest.time[:, None] / 0.2)
    growing = Trajectory(from_rest.time, ahead * from_rest.observation, 0 * from_rest.input)
    model = spiral(-0.5, cubic=40.0)
    assert StabilityGuard([growing]).diverges(model) and not StabilityGuard([growing], horizon=0.02).diverges(model)


def test_a_model_that_was_not_fitted_is_refused():
    model = spiral(-1.0)
    model.state_scale.fill_(torch.inf)
    with pytest.raises(ValueError, match="after the closed-form fit"):
        GUARD.diverges(model)


def test_impossible_settings_are_refused():
    with pytest.raises(ValueError, match="margin -1 1/s, reach 3.0 and overdrive 1.25"):
        StabilityGuard([], margin=-1)
    with pytest.raises(ValueError, match="overdrive 0.5"):
        StabilityGuard([], overdrive=0.5)


def test_inputs_beyond_those_recorded_are_tried_as_well():
    model = spiral(-1.0, cubic=2.0)
    with torch.no_grad():
        model.control_table[0, 0] = 2.5
    assert not StabilityGuard([run(300)], overdrive=1.0, starts=50).diverges(model)
    assert StabilityGuard([run(300)], overdrive=1.5, starts=50).diverges(model)
