"""A live view of a closed loop, by rerun (https://rerun.io). No other file imports rerun."""

from __future__ import annotations

import importlib
import logging
import os
import sys
from collections import deque
from contextlib import contextmanager
from pathlib import Path
from threading import Thread
from time import perf_counter

import numpy as np

from ssmr_torch.checked_arguments import checked
from ssmr_torch.keywords import configurable
from ssmr_torch.quantities import PATH, TEXT
from ssmr_torch.ranges import Number, OrNone
from ssmr_torch.tasks.obstacles import Circle, HalfPlane

LOGGER = logging.getLogger(__name__)
TIMELINE = "time"
GREEN, BLUE, ORANGE, GREY, RED = (80, 180, 90), (70, 130, 220), (240, 150, 40), (150, 150, 150), (210, 70, 60)
CIRCLE = np.stack([np.cos(np.linspace(0.0, 2 * np.pi, 49)), np.sin(np.linspace(0.0, 2 * np.pi, 49))], axis=1)
OPENING = 10.0          # s, how long a viewer may take to open
REACH = 0.1             # m, half the drawn length of a half-plane's edge
UNWATCHED = 5           # first samples, in which rerun starts up; `patience` does not apply to them


class RerunView:
    """Tip, reference, plan, obstacles, inputs, solve time and fallbacks of a closed loop, one set per control step.

    Give it as `watch` to `closed_loop.simulate`. It is a context manager; the end of the block completes a recording.
    task: tracked outputs and obstacles.   plant: output_names, input_names, input_unit.   recording: a .rrd file,
    relative to `directory`, in place of a viewer.   address: of a viewer that runs already, on this or another
    computer; None opens a viewer here.   trail: s, how long the tip's path stays drawn.   patience: s; when one sample
    takes longer, the view ends.

    An error in the viewer ends the view with one message in the log, but never the loop. Samples at which the input is
    held are not shown. Length is in m, time in s, as the names of all curves say.
    Raises ValueError when rerun is not installed, and where `task.columns` does.
    """

    @configurable(given=("directory",))
    @checked(recording=OrNone(PATH), address=OrNone(TEXT), trail=Number(0.0, 1e4, "s"),
             patience=Number(0.0, 1e3, "s"))
    def __init__(self, task, plant, directory: str | Path = ".", *, recording: str | Path | None = None,
                 address: str | None = None, trail: float = 2.0, patience: float = 0.1):
        try:
            self._rerun = importlib.import_module("rerun")
        except ImportError as error:
            raise ValueError("the live view needs rerun: pip install 'ssmr_torch[view]', or use view=none") from error
        self.task, self.patience, self.trail = task, float(patience), float(trail)
        self._columns = list(task.columns(plant.output_names))
        self._tracked = [plant.output_names[column] for column in self._columns]
        self._inputs, self._unit = plant.input_names, plant.input_unit
        self._path, self._samples, self._fallbacks = deque(), 0, 0
        self._standing = [shape for shape in task.obstacles if not _moves(shape)]
        self._moving = [shape for shape in task.obstacles if _moves(shape)]
        self._seen = np.zeros(len(self._columns))  # the last measurement that was not missing
        self._stream = None
        try:
            self._open(None if recording is None else Path(directory) / recording, address)
            self._label()
            self._stream.flush(timeout_sec=OPENING)
        except Exception as error:
            self._end(f"it could not start: {error}")

    def __enter__(self) -> RerunView:
        return self

    def __exit__(self, *_) -> None:
        self.close()

    def close(self) -> None:
        """Complete the recording; later samples are not shown. A second call does nothing. Never raises."""
        stream, self._stream = self._stream, None
        if stream is not None:
            _disconnect(stream)

    def __call__(self, time: float, reference: np.ndarray, observation: np.ndarray, measurement: np.ndarray, command,
                 solve_time: float) -> None:
        """Show one sample: time s, reference (q,) m, observation (p,) m, measurement (p,) m, Command, solve time s.

        Never raises.
        """
        if self._stream is None or command.held:
            return
        start = perf_counter()
        try:
            self._show(time, reference, observation[self._columns], measurement[self._columns], command, solve_time)
        except Exception as error:
            self._end(f"at {time:.3f} s: {error}")
            return
        self._samples += 1
        took = perf_counter() - start
        if took > self.patience and self._samples > UNWATCHED:
            self._end(f"at {time:.3f} s: one sample took {took:.3f} s, longer than the patience of {self.patience} s")

    def _end(self, why: str) -> None:
        LOGGER.warning("The live view ended: %s. The loop goes on.", why)
        stream, self._stream = self._stream, None
        if stream is not None:
            # rerun waits several seconds for a viewer that is gone. The loop must not wait.
            Thread(target=_disconnect, args=(stream,), daemon=True).start()

    def _open(self, recording: Path | None, address: str | None) -> None:
        self._stream = self._rerun.RecordingStream(f"ssmr_torch: {self.task.name}")
        blueprint = self._blueprint()
        if recording is not None:
            recording.parent.mkdir(parents=True, exist_ok=True)
            self._stream.save(recording, default_blueprint=blueprint)
        elif address is not None:
            self._stream.connect_grpc(address, default_blueprint=blueprint)
        else:
            with _own_programs():
                self._stream.spawn(default_blueprint=blueprint)

    def _blueprint(self):
        views = importlib.import_module("rerun.blueprint")
        curves = [views.TimeSeriesView(origin=name, name=title) for name, title in (
            ("outputs", "outputs, m"), ("error", "tracking error, m"), ("inputs", f"inputs, {self._unit}"),
            ("solve_time", "solve time, s"), ("fallbacks", "fallbacks so far"))]
        scene = views.Spatial3DView(origin="scene", name=f"{', '.join(self._tracked[:3])} in m")
        return views.Blueprint(views.Horizontal(views.Vertical(scene, views.TextLogView(origin="messages"),
                                                               row_shares=[5, 1]), views.Vertical(*curves)))

    def _label(self) -> None:
        """Send names, colours and everything that does not move once, so that it is not sent at every sample."""
        rr, kinds = self._rerun, ("", "measured ", "reference ")
        for name, curves in (
                ("outputs", [f"{kind}{name} [m]" for kind in kinds for name in self._tracked]),
                ("error", ["distance to the reference [m]"]),
                ("inputs", [f"{name} [{self._unit}]" for name in self._inputs]),
                ("solve_time", ["solve time [s]"]), ("fallbacks", ["fallbacks"])):
            self._log(name, rr.SeriesLines(names=curves), static=True)
        self._log("scene", rr.ViewCoordinates.RIGHT_HAND_Y_UP, static=True)
        self._log("scene/points", rr.Points3D.from_fields(
            colors=[BLUE, GREY, GREEN], radii=[0.0006, 0.0003, 0.0006], labels=["tip", "measured", "reference"],
            show_labels=False), static=True)
        self._log("scene/paths", rr.LineStrips3D.from_fields(colors=[BLUE, ORANGE, GREEN]), static=True)
        if self._standing:
            outlines = [_outline(shape, 0.0) for shape in self._standing]
            self._log("scene/obstacles", rr.LineStrips3D(outlines, colors=[RED] * len(outlines)), static=True)
        if self._moving:
            colors = rr.LineStrips3D.from_fields(colors=[RED] * len(self._moving))
            self._log("scene/moving_obstacles", colors, static=True)

    def _log(self, name: str, what, static: bool = False) -> None:
        self._stream.log(name, what, static=static, strict=True)

    def _show(self, time, reference, observation, measurement, command, solve_time) -> None:
        rr = self._rerun
        self._stream.set_time(TIMELINE, duration=time)
        tip = _in_space(observation)
        if np.isfinite(measurement).all():
            self._seen = measurement
        self._log("scene/points", rr.Points3D(_in_space(np.stack([observation, self._seen, reference]))))
        self._log("scene/paths", self._paths(time, tip, command.plan))
        if self._moving:
            self._log("scene/moving_obstacles", rr.LineStrips3D([_outline(shape, time) for shape in self._moving]))
        self._log("outputs", rr.Scalars(np.concatenate([observation, measurement, reference])))
        self._log("error", rr.Scalars(np.linalg.norm(observation - reference)))
        self._log("inputs", rr.Scalars(command.input))
        self._log("solve_time", rr.Scalars(solve_time))
        if command.fallback is not None:
            self._fallbacks += 1
            self._log("fallbacks", rr.Scalars(self._fallbacks))
            self._log("messages", rr.TextLog(f"{time:.3f} s: fell back, {command.fallback.name}", level="WARN"))

    def _paths(self, time: float, tip: np.ndarray, plan):
        """The tip's past path, and the predicted and the reference path over the horizon."""
        self._path.append((time, tip))
        while self._path[0][0] < time - self.trail:
            self._path.popleft()
        strips = [np.array([point for _, point in self._path])]
        if plan is not None and np.isfinite(plan.outputs).all():
            strips += [np.vstack([tip, _in_space(plan.outputs[:, self._columns])]),
                       _in_space(plan.reference[:, self._columns])]
        return self._rerun.LineStrips3D(strips)


def _disconnect(stream) -> None:
    try:
        stream.disconnect()
    except Exception as error:
        LOGGER.warning("The live view could not show its last samples: %s", error)


@contextmanager
def _own_programs():
    """The programs beside this Python come first: in an environment that is not activated, the viewer is there."""
    before = os.environ.get("PATH", "")
    os.environ["PATH"] = os.pathsep.join([str(Path(sys.executable).parent), before])
    try:
        yield
    finally:
        os.environ["PATH"] = before


def _moves(shape: Circle | HalfPlane) -> bool:
    return isinstance(shape, Circle) and callable(shape.center)


def _in_space(outputs: np.ndarray) -> np.ndarray:
    """The first three outputs (..., q) as points (..., 3). Missing coordinates are zero."""
    points = np.zeros(outputs.shape[:-1] + (3,))
    count = min(3, outputs.shape[-1])
    points[..., :count] = outputs[..., :count]
    return points


def _outline(shape: Circle | HalfPlane, time: float) -> np.ndarray:
    """The edge of an obstacle as a line (·, 3) m: a circle, or part of a half-plane's edge with its outward normal."""
    if isinstance(shape, Circle):
        return _in_space(shape.centers(np.array([time]))[0] + shape.radius * CIRCLE)
    normal = _in_space(shape.normal)
    # The edge is across the normal, in the plane of the first two outputs where that is possible.
    across = np.cross(normal, [0.0, 0.0, 1.0] if abs(normal[2]) < 0.9 else [0.0, 1.0, 0.0])
    across *= REACH / np.linalg.norm(across)
    foot = shape.offset * normal
    return np.stack([foot - across, foot, foot + 0.1 * REACH * normal, foot, foot + across])
