"""The delay study on windows whose manifold is known."""

import numpy as np
import pytest

from ssmr_torch.paper.delay_study import format_reconstruction, reconstruction_study
from ssmr_torch.trajectory import Trajectory

H = 0.01
TIME = H * np.arange(300)


def decay(phase, rate=1.0):
    """Two outputs of one damped oscillation: windows of any length lie in a plane."""
    wave = np.exp((-rate + 6j) * TIME + 1j * phase)
    return Trajectory(TIME, np.stack([wave.real, wave.imag], axis=1), np.zeros((len(TIME), 1)), "decay")


def forced(frequency):
    """The same outputs driven along a circle at another frequency: windows leave that plane."""
    wave = np.exp(1j * frequency * TIME)
    return Trajectory(TIME, np.stack([wave.real, wave.imag], axis=1), np.ones((len(TIME), 1)))


def study(run, **options):
    settings = {"delays": (4, 20), "state_dim": 2, "degree": 1, "control_delays": 0} | options
    rows = reconstruction_study([decay(0.0), decay(2.0)], run, **settings)
    return {(row["delays"], row["reparametrized"]): row for row in rows}


def test_a_run_on_the_manifold_is_reconstructed_whatever_the_delays():
    for row in study(decay(1.0)).values():
        assert row["error"] < 1e-6 and row["ratio"] == pytest.approx(100)


def test_under_control_long_windows_distort_and_reparametrization_cures_it():
    rows = study(forced(20.0))
    assert rows[20, False]["error"] > 2 * rows[4, False]["error"] > 10
    assert rows[4, True]["error"] < 1e-6 and rows[20, True]["error"] < 1e-6


def test_the_ratio_of_norms_misses_an_error_that_keeps_the_size():
    rows = study(forced(9.0))
    assert rows[20, False]["error"] > 2 * abs(rows[20, False]["ratio"] - 100)


def test_the_table_states_both_and_missing_decays_are_refused():
    text = format_reconstruction(reconstruction_study([decay(0.0)], forced(3.0), delays=(4,), state_dim=2, degree=1,
                                                      control_delays=0))
    assert text.splitlines()[0].split() == ["delays", "reparametrized", "‖ŷ‖/‖y‖", "error"] and len(
        text.splitlines()) == 3
    with pytest.raises(ValueError, match="no decays"):
        reconstruction_study([], forced(3.0))
