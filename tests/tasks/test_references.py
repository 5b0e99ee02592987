"""Claims about tasks and reference paths."""

import numpy as np
import pytest
from scipy.integrate import quad

from ssmr_torch.tasks.references import Task, circle, figure_eight, ramped_phase, rose

EXAMPLES = {"slow figure eight": figure_eight(angular_speed=0.2, laps=1.0),
            "fast figure eight": figure_eight(), "fast circle": circle(),
            "part of a lap": figure_eight(laps=1.7), "long ramp": circle(ramp=3.0), "rose": rose()}


def speed(task, time, h=1e-5):
    return (task.reference(time + h) - task.reference(time - h)) / (2 * h)


@pytest.mark.parametrize("task", EXAMPLES.values(), ids=EXAMPLES)
def test_the_path_starts_and_ends_at_rest(task):
    np.testing.assert_array_equal(task.reference(0.0), 0.0)
    for end, side in ((0.0, 1), (task.duration, -1)):
        near = task.reference(end + side * np.array([0.0, 1e-3]))
        assert np.abs(np.diff(near, axis=0)).max() < 1e-9


@pytest.mark.parametrize("task", EXAMPLES.values(), ids=EXAMPLES)
def test_position_velocity_and_acceleration_never_jump(task):
    """On a grid twice as fine the largest change between neighbours halves; a jump would stay."""
    for derivative in (0, 1, 2):
        changes = []
        for samples in (20001, 40001):
            path = task.reference(np.linspace(-0.1, task.duration + 0.1, samples))
            path = np.diff(path, derivative, axis=0) * (samples - 1.0) ** derivative
            changes.append(np.abs(np.diff(path, axis=0)).max())
        assert changes[1] < 0.6 * changes[0]


def test_the_figure_eight_has_the_published_length_and_speed():
    task = figure_eight(amplitude=0.015, angular_speed=4.0, laps=1.0, ramp=0.0)
    length = quad(lambda time: np.linalg.norm(speed(task, time)), 1e-4, task.duration - 1e-4, limit=200)[0]
    assert length / 0.015 == pytest.approx(9.4294, rel=1e-3)
    assert length / task.duration == pytest.approx(0.0894, rel=1e-2)


def test_between_the_ramps_the_figure_eight_is_its_formula():
    task = figure_eight(amplitude=0.01, angular_speed=4.0, laps=3.0, ramp=1.0)
    time = np.linspace(1.0, task.duration - 1.0, 50)
    theta = 4.0 * (time - 0.5)
    expected = 0.01 * np.stack([-np.sin(theta), np.sin(2 * theta)], axis=1)
    np.testing.assert_allclose(task.reference(time), expected, rtol=0, atol=1e-15)


def test_the_circle_is_round_and_passes_through_rest():
    task = circle(amplitude=0.01)
    path = task.reference(np.linspace(0, task.duration, 500))
    np.testing.assert_allclose(np.hypot(path[:, 0], path[:, 1] - 0.01), 0.01, rtol=1e-12)


def test_the_rose_reaches_its_amplitude_in_the_middle_of_every_petal_and_passes_through_rest_between_them():
    """Three petals lie 120° apart; half a turn of θ draws them once, so that the ramps end where they began."""
    task = rose(amplitude=0.012, petals=3, laps=1.0, ramp=0.0)
    theta = np.arange(1, 12) * np.pi / 6
    path = task.reference(theta / 2.0)
    np.testing.assert_allclose(np.hypot(*path.T), np.tile([0.012, 0.0], 6)[:11], rtol=0, atol=1e-15)
    angles = np.degrees(np.arctan2(path[::2, 1], path[::2, 0]))
    np.testing.assert_allclose(angles, [30, -90, 150, 30, -90, 150], rtol=0, atol=1e-9)


@pytest.mark.parametrize("petals", [0, 2])
def test_a_rose_without_an_odd_number_of_petals_is_refused(petals):
    with pytest.raises(ValueError, match=f"petals is {petals}; expected"):
        rose(petals=petals)


def test_the_phase_covers_its_total_without_turning_back():
    phase, duration = ramped_phase(20.0, 4.0, 1.5)
    values = phase(np.linspace(0, duration, 1000))
    assert duration == 6.5 and values[0] == 0 and values[-1] == pytest.approx(20.0, abs=1e-12)
    assert (np.diff(values) > 0).all() and np.gradient(values, duration / 999).max() <= 4.0 + 1e-9


def test_the_reference_stands_still_before_and_after():
    task = figure_eight(laps=1.3)
    np.testing.assert_array_equal(task.reference([-1.0, 0.0]), np.zeros((2, 2)))
    np.testing.assert_array_equal(*np.split(task.reference([task.duration, task.duration + 5.0]), 2))


def test_tracked_outputs_are_found_by_name_or_index():
    names = ("mid_x", "mid_y", "tip_x", "tip_y")
    assert figure_eight(tracked=("tip_x", "tip_y")).columns(names) == (2, 3)
    assert figure_eight(tracked=(0, 3)).columns() == (0, 3)
    for tracked in (("tip_z", "tip_x"), (0, 4), (-1, 0)):
        with pytest.raises(ValueError, match=r"the outputs are|tracked\[0\] is -1; expected"):
            figure_eight(tracked=tracked).columns(names)


def test_a_task_with_wrong_duration_outputs_path_or_ramp_is_refused():
    with pytest.raises(ValueError, match="positive time"):
        Task("none", 0.0, (0,), np.zeros_like)
    with pytest.raises(ValueError, match="each output only once"):
        Task("twice", 1.0, (0, 0), np.zeros_like)
    with pytest.raises(ValueError, match="one row per time"):
        Task("flat", 1.0, (0, 1), np.zeros_like).reference([0.0, 1.0])
    with pytest.raises(ValueError, match="shorten the ramp"):
        figure_eight(laps=0.1, ramp=5.0)
