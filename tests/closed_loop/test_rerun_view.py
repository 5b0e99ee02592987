"""Claims about the live view: it shows what happened, in SI units, and never disturbs the loop."""

import logging
import os
import sys
from pathlib import Path

import numpy as np
import pytest

from ssmr_torch.closed_loop.rerun_view import RerunView
from ssmr_torch.closed_loop.simulation import simulate
from ssmr_torch.control.base import Command
from ssmr_torch.status import Status
from ssmr_torch.tasks.obstacles import Circle, HalfPlane, drifting
from ssmr_torch.tasks.references import Task


class Plant:
    """y⁺ = y + 0.01 u in three outputs."""

    name, timestep, input_unit = "integrator", 0.01, "N"
    output_names, input_names, rest = ("x", "y", "z"), ("left", "right", "up"), np.zeros(3)

    def reset(self, seed=None):
        self.displacement = np.zeros(3)
        return self.displacement

    def step(self, input):
        self.displacement = self.displacement + 0.01 * input
        return self.displacement


class Plan:
    def __init__(self, time):
        self.iterations, self.status = 1, Status.SOLVED
        self.outputs, self.reference = time + np.ones((5, 3)), np.zeros((5, 3))


class Controller:
    """Decides at every other sample, and falls back once."""

    period = 0.02

    def reset(self):
        self.calls = 0

    def __call__(self, time, observation):
        self.calls += 1
        held = self.calls % 2 == 0
        return Command(np.array([0.1, 0.2, 0.0]), None if held else Plan(time),
                       Status.OUT_OF_RANGE if self.calls == 7 else None, held)


TASK = Task("line", 0.5, ("y", "x"), lambda time: np.stack([time, 0 * time], axis=1), (
    Circle([0.1, 0.0], 0.01), Circle(drifting([0.2, 0.0], [0.01, 0.0]), 0.02), HalfPlane([0.0, 2.0], 0.4)))


def run(view, task=TASK):
    return simulate(Plant(), Controller(), task, watch=view)


def test_without_a_watch_and_with_one_the_record_is_the_same():
    seen = []
    record = simulate(Plant(), Controller(), TASK, noise_std=1e-3, watch=lambda *sample: seen.append(sample))
    alone = simulate(Plant(), Controller(), TASK, noise_std=1e-3)
    np.testing.assert_array_equal(record.measurement, alone.measurement)
    assert len(seen) == len(record.time) == 51
    time, reference, observation, measurement, command, solve_time = map(list, zip(*seen))
    np.testing.assert_array_equal(time, record.time)
    np.testing.assert_array_equal(reference, record.reference)
    np.testing.assert_array_equal(observation, record.observation)
    np.testing.assert_array_equal(measurement, record.measurement)
    np.testing.assert_array_equal([each.input for each in command], record.input)
    assert all(type(each) is float for each in time + solve_time)


def test_without_rerun_the_message_says_what_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, "rerun", None)
    with pytest.raises(ValueError, match=r"pip install 'ssmr_torch\[view\]'"):
        RerunView(TASK, Plant())


@pytest.fixture
def rerun():
    return pytest.importorskip("rerun", reason="rerun is not installed: pip install 'ssmr_torch[view]'")


@pytest.fixture
def logged(rerun, monkeypatch):
    """What reached rerun: {entity: [component batches as lists]}."""
    entities, log = {}, rerun.RecordingStream.log

    def spy(self, name, what, **settings):
        entities.setdefault(name, []).append(what)
        return log(self, name, what, **settings)

    monkeypatch.setattr(rerun.RecordingStream, "log", spy)
    return entities


def curves(logged, name):
    """Names of a plot's curves, and their values (samples, curves)."""
    names, *samples = logged[name]  # the names come first, once
    return names.names.as_arrow_array().to_pylist(), np.array([each.scalars.as_arrow_array().to_pylist()
                                                               for each in samples])


def test_a_recording_holds_every_control_step_with_units(logged, tmp_path):
    with RerunView(TASK, Plant(), tmp_path, recording="a/loop.rrd") as view:
        record = run(view)
    assert (tmp_path / "a" / "loop.rrd").stat().st_size > 1000
    decided = np.isfinite(record.solve_time)
    names, values = curves(logged, "outputs")
    assert names == ["y [m]", "x [m]", "measured y [m]", "measured x [m]", "reference y [m]", "reference x [m]"]
    np.testing.assert_allclose(values[:, :2], record.observation[decided][:, [1, 0]])
    np.testing.assert_allclose(values[:, 4:], record.reference[decided])
    names, values = curves(logged, "inputs")
    assert names == ["left [N]", "right [N]", "up [N]"]
    np.testing.assert_allclose(values, record.input[decided])
    names, values = curves(logged, "solve_time")
    assert names == ["solve time [s]"]
    np.testing.assert_allclose(values[:, 0], record.solve_time[decided])
    _, values = curves(logged, "error")
    np.testing.assert_allclose(values[:, 0], np.linalg.norm(record.error[decided], axis=1))


def test_fallbacks_are_counted_and_named(logged, tmp_path):
    with RerunView(TASK, Plant(), tmp_path, recording="loop.rrd") as view:
        run(view)
    assert curves(logged, "fallbacks")[1].tolist() == [[1.0]]
    message, = logged["messages"]
    assert message.text.as_arrow_array().to_pylist() == ["0.060 s: fell back, OUT_OF_RANGE"]


def strips(lines):
    return [np.array(strip) for strip in lines.strips.as_arrow_array().to_pylist()]


def test_the_scene_shows_the_plan_its_reference_and_the_past_path(logged, tmp_path):
    with RerunView(TASK, Plant(), tmp_path, recording="loop.rrd", trail=0.1) as view:
        run(view)
    past, plan, ahead = strips(logged["scene/paths"][-1])
    np.testing.assert_allclose(past[:, 0], 0.2 * np.arange(0.40, 0.51, 0.02), atol=1e-6)
    np.testing.assert_allclose(plan[0], [0.1, 0.05, 0.0], atol=1e-6)
    np.testing.assert_allclose(plan[1:], np.tile([1.5, 1.5, 0.0], (5, 1)), atol=1e-6)
    assert ahead.shape == (5, 3)


def test_obstacles_stand_or_move(logged, tmp_path):
    with RerunView(TASK, Plant(), tmp_path, recording="loop.rrd") as view:
        run(view)
    (standing,), (_, *moving) = logged["scene/obstacles"], logged["scene/moving_obstacles"]
    circle, edge = strips(standing)
    np.testing.assert_allclose(np.linalg.norm(circle - [0.1, 0.0, 0.0], axis=1), 0.01, rtol=1e-4)
    assert TASK.obstacles[2].clearance(0.0, edge).min() == pytest.approx(-0.01, abs=1e-6)
    np.testing.assert_allclose(edge[[0, 1, -1], 1], 0.2, rtol=1e-6)
    assert len(moving) == 26
    np.testing.assert_allclose(strips(moving[-1])[0].max(axis=0), [0.205 + 0.02, 0.02, 0.0], atol=1e-6)


@pytest.mark.parametrize("tracked", [("x",), ("x", "y", "z")])
def test_any_number_of_tracked_outputs_is_shown(logged, tmp_path, tracked):
    task = Task("still", 0.1, tracked, lambda time: np.zeros((len(time), len(tracked))), (HalfPlane([1.0], 0.1),))
    with RerunView(task, Plant(), tmp_path, recording="loop.rrd") as view:
        run(view, task)
    assert curves(logged, "outputs")[1].shape == (6, 3 * len(tracked))


def test_an_error_of_the_viewer_ends_the_view_with_one_message_and_not_the_loop(rerun, monkeypatch, tmp_path, caplog):
    view = RerunView(TASK, Plant(), tmp_path, recording="loop.rrd")
    calls = []

    def broken(*_, **__):
        calls.append(1)
        raise OSError("no space left")

    monkeypatch.setattr(rerun.RecordingStream, "log", broken)
    with caplog.at_level(logging.WARNING), view:
        record = run(view)
    message, = caplog.messages
    assert "no space left" in message and "The loop goes on" in message
    assert len(calls) == 1 and len(record.time) == 51


def test_a_viewer_that_does_not_open_or_is_slow_ends_the_view_too(rerun, monkeypatch, tmp_path, caplog):
    (tmp_path / "file").write_text("")
    with caplog.at_level(logging.WARNING), RerunView(TASK, Plant(), tmp_path, recording="file/loop.rrd") as view:
        assert len(run(view).time) == 51
    assert len(caplog.messages) == 1 and "could not start" in caplog.messages[0]
    caplog.clear()
    with caplog.at_level(logging.WARNING), RerunView(TASK, Plant(), tmp_path, recording="loop.rrd",
                                                     patience=1e-9) as view:
        assert len(run(view).time) == 51
    assert len(caplog.messages) == 1 and "patience" in caplog.messages[0]


def test_the_view_opens_a_viewer_or_connects_to_its_address(rerun, monkeypatch):
    """The viewer installed beside this Python is found, whether or not its environment is activated."""
    opened, path = [], os.environ["PATH"]
    monkeypatch.setattr(rerun.RecordingStream, "spawn",
                        lambda self, **_: opened.append(os.environ["PATH"].split(os.pathsep)[0]))
    monkeypatch.setattr(rerun.RecordingStream, "connect_grpc", lambda self, url, **_: opened.append(url))
    RerunView(TASK, Plant()).close()
    RerunView(TASK, Plant(), address="rerun+http://robot:9876/proxy").close()
    assert opened == [str(Path(sys.executable).parent), "rerun+http://robot:9876/proxy"]
    assert os.environ["PATH"] == path


def test_missing_measurements_and_diverged_plans_are_not_shown(logged, tmp_path, caplog):
    with caplog.at_level(logging.WARNING), RerunView(TASK, Plant(), tmp_path, recording="loop.rrd") as view:
        plan = Plan(np.nan)
        view(0.0, np.zeros(2), np.zeros(3), np.full(3, np.nan), Command(np.zeros(3), plan), 1e-3)
        view(0.02, np.zeros(2), np.zeros(3), np.zeros(3), Command(np.zeros(3)), 1e-3)
    assert not caplog.messages
    assert [len(strips(lines)) for lines in logged["scene/paths"][1:]] == [1, 1]
    positions = np.array(logged["scene/points"][1].positions.as_arrow_array().to_pylist())
    assert np.isfinite(positions).all() and len(positions) == 3


def test_a_recording_that_cannot_be_completed_does_not_lose_the_record(rerun, monkeypatch, tmp_path, caplog):
    def broken(self):
        raise RuntimeError("disk full")

    with caplog.at_level(logging.WARNING), RerunView(TASK, Plant(), tmp_path, recording="loop.rrd") as view:
        assert len(run(view).time) == 51
        monkeypatch.setattr(rerun.RecordingStream, "disconnect", broken)
    assert len(caplog.messages) == 1 and "disk full" in caplog.messages[0]
