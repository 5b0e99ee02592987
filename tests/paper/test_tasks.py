"""Claims about the paper's tasks."""

import json

import numpy as np
import pytest

import ssmr_torch
from ssmr_torch.paper.tasks import pacman
from ssmr_torch.targets import build, written


def length(points):
    return np.linalg.norm(np.diff(points, axis=0), axis=1).sum()


def speed(task, time, h=1e-6):
    return np.linalg.norm(task.reference(time + h) - task.reference(time - h), axis=1) / (2 * h)


@pytest.mark.parametrize(("radius", "mouth"), [(0.02, np.pi / 3), (0.01, 0.1), (0.03, 5.0)])
def test_pacman_is_an_arc_and_two_radii_long(radius, mouth):
    task = pacman(radius, mouth)
    points = task.reference(np.linspace(0, 10.0, 100001))
    expected = radius * (2 + 2 * np.pi - mouth)
    assert length(points) == pytest.approx(expected, rel=1e-4)
    assert np.median(speed(task, np.linspace(1.1, 8.9, 501))) == pytest.approx(expected / 9.0, rel=1e-5)
    away = np.linalg.norm(points, axis=1)
    assert away.max() == pytest.approx(radius, rel=1e-9)
    on_arc = points[away > radius * (1 - 1e-5)]
    assert np.abs(np.arctan2(on_arc[:, 1], on_arc[:, 0])).min() == pytest.approx(mouth / 2, abs=1e-3)


def test_pacman_starts_and_ends_at_rest_standing_still():
    task = pacman()
    assert task.name == "pacman"
    np.testing.assert_array_equal(task.reference([0.0, task.duration, task.duration + 1.0]), 0.0)
    for end, side in ((0.0, 1), (task.duration, -1)):
        assert np.abs(task.reference(end + side * 1e-3)).max() < 1e-9


def test_pacman_survives_a_file_to_the_last_bit():
    task, times = pacman(), np.linspace(-1.0, 30.0, 997)
    again = build(json.loads(json.dumps(written(task), allow_nan=False)))
    np.testing.assert_array_equal(again.reference(times), task.reference(times))


@pytest.mark.parametrize(("build", "message"), [
    (lambda: pacman(radius=-0.02), "radius is -0.02 m"),
    (lambda: pacman(mouth=0.0), "mouth is 0.0 rad"),
    (lambda: pacman(mouth=60.0), "mouth is 60.0 rad; expected a number from 0 to 6.28"),
    (lambda: pacman(tracked=("tip_x",)), "tracks 1 outputs"),
    (lambda: pacman(tracked=("tip_x", "tip_x")), "each output only once"),
])
def test_a_pacman_without_meaning_is_refused(build, message):
    with pytest.raises(ValueError, match=message):
        build()


def test_where_pacman_was_before_an_error_says_where_it_is():
    with pytest.raises(AttributeError, match="ssmr_torch.tasks.pacman is now ssmr_torch.paper.tasks.pacman"):
        ssmr_torch.tasks.pacman  # noqa: B018
