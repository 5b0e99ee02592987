"""A task: the path that the robot shall trace, as displacement from rest over time, and the usual paths."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from copy import deepcopy
from dataclasses import dataclass, replace

import numpy as np

from ssmr_torch import data_sheet as sheet
from ssmr_torch.checked_arguments import checked
from ssmr_torch.data_sheet import DataSheet
from ssmr_torch.quantities import TEXT, TRACKED
from ssmr_torch.ranges import Number, Whole
from ssmr_torch.tasks.curves import CirclePath, EightPath, Polyline, RampedPhase, RosePath, refuse_nameless
from ssmr_torch.tasks.obstacles import Circle, HalfPlane


@dataclass(frozen=True, eq=False)
class Task(DataSheet):
    """A reference path for some outputs of a robot.

    path: times (K,) s in [0, duration] → (K, q) m relative to rest.   duration: s; the reference stands still before
    time 0 and after the duration.   tracked: the q outputs, by index or by name; names need a robot with output names.
    obstacles: `Circle`s and `HalfPlane`s that the tracked outputs must not enter.
    A task can be copied. It can be pickled unless its path is a lambda or a function made inside another function.
    Raises ValueError for a duration that is not positive, for tracked outputs that repeat, and for obstacles over more
    outputs than are tracked.

    >>> figure_eight(tracked=["tip_x", "tip_y"])
    Task 'figure eight': 10.4 s
    ├─ reference
    │  ├─ tip_x: -15 … 15 mm
    │  └─ tip_y: -15 … 15 mm
    ├─ speed: at most 134 mm/s
    └─ obstacles: none
    """

    name: str
    duration: float
    tracked: tuple[int | str, ...]
    path: Callable[[np.ndarray], np.ndarray]
    obstacles: tuple[Circle | HalfPlane, ...] = ()

    def __post_init__(self):
        object.__setattr__(self, "tracked", tuple(self.tracked))
        object.__setattr__(self, "obstacles", tuple(self.obstacles or ()))
        if not all(isinstance(each, Circle) or hasattr(each, "normal") for each in self.obstacles):
            raise ValueError(f"obstacles is {list(self.obstacles)!r}; expected a list of circles and half-planes")
        if not (np.isfinite(self.duration) and self.duration > 0):
            raise ValueError(f"task {self.name!r} lasts {self.duration} s; expected a positive time")
        if not self.tracked or len(set(self.tracked)) != len(self.tracked):
            raise ValueError(f"task {self.name!r} tracks {self.tracked}; "
                             "expected at least one output, and each output only once")
        for obstacle in self.obstacles:
            needed = 2 if isinstance(obstacle, Circle) else len(obstacle.normal)
            if needed > len(self.tracked):
                raise ValueError(f"an obstacle of task {self.name!r} needs {needed} tracked outputs; the task tracks "
                                 f"{len(self.tracked)}")

    def __getstate__(self) -> dict:
        refuse_nameless(self.path, f"the path of task {self.name!r}")
        return self.__dict__

    def __deepcopy__(self, memo) -> Task:
        return replace(self, path=deepcopy(self.path, memo), obstacles=deepcopy(self.obstacles, memo))

    def reference(self, time: np.ndarray) -> np.ndarray:
        """The path at times (K,) s, (K, q) m. Raises ValueError when the path returns another shape."""
        time = np.asarray(time, dtype=np.float64)
        time = np.minimum(np.maximum(time if time.ndim else time[None], 0.0), self.duration)
        reference = np.asarray(self.path(time), dtype=np.float64)
        if reference.shape != (len(time), len(self.tracked)):
            raise ValueError(f"the path of task {self.name!r} has shape {reference.shape}; expected "
                             f"{(len(time), len(self.tracked))}: one row per time, one column per output")
        return reference

    def data_sheet(self) -> tuple[str, dict]:
        time = np.linspace(0.0, self.duration, 2001)
        reference = self.reference(time)
        fastest = np.linalg.norm(np.diff(reference, axis=0), axis=1).max() / time[1]
        names = [output if isinstance(output, str) else f"output {output}" for output in self.tracked]
        return f"Task {self.name!r}: {sheet.number(self.duration)} s", {
            "reference": sheet.spans(names, reference.min(axis=0), reference.max(axis=0), "mm", 1e3),
            "speed": f"at most {sheet.number(1e3 * fastest)} mm/s",
            "obstacles": len(self.obstacles) or "none"}

    def columns(self, output_names: Sequence[str] | None = None) -> tuple[int, ...]:
        """Indices of the tracked outputs. Raises ValueError for an output that the robot does not have."""
        columns = []
        for output in self.tracked:
            if isinstance(output, str):
                if output_names is None or output not in output_names:
                    raise ValueError(f"task {self.name!r} tracks {output!r}; the outputs are {output_names}")
                output = list(output_names).index(output)
            if not 0 <= output < (np.inf if output_names is None else len(output_names)):
                raise ValueError(f"task {self.name!r} tracks output {output}; the outputs are {output_names}")
            columns.append(int(output))
        return tuple(columns)


@checked(amplitude=Number(1e-6, 100.0, "m"), angular_speed=Number(1e-4, 1e4, "rad/s"), laps=Number(1e-3, 1e5),
         ramp=Number(0.0, 1e4, "s"), tracked=TRACKED, name=TEXT)
def figure_eight(amplitude: float = 0.015, angular_speed: float = 4.0, laps: float = 6.0, ramp: float = 1.0,
                 tracked: Sequence[int | str] = (0, 1), name: str = "figure eight",
                 obstacles: Sequence | None = None) -> Task:
    """(−a sin θ, a sin 2θ), 9.4294 a long per lap; it starts and ends at rest. θ is the phase of `ramped_phase`.

    amplitude a in m; angular_speed in rad/s (the paper uses 0.2 and 4); ramp in s; laps may be a fraction; obstacles
    as in `Task`.
    """
    phase, duration = ramped_phase(2 * np.pi * laps, angular_speed, ramp)
    return Task(name, duration, tuple(tracked), EightPath(amplitude, phase), obstacles)


@checked(amplitude=Number(1e-6, 100.0, "m"), angular_speed=Number(1e-4, 1e4, "rad/s"), laps=Number(1e-3, 1e5),
         ramp=Number(0.0, 1e4, "s"), tracked=TRACKED, name=TEXT)
def circle(amplitude: float = 0.010, angular_speed: float = 4.0, laps: float = 6.0, ramp: float = 1.0,
           tracked: Sequence[int | str] = (1, 2), name: str = "circle",
           obstacles: Sequence | None = None) -> Task:
    """(a sin θ, a − a cos θ), a circle through the rest position, which starts and ends at rest. Arguments: see
    `figure_eight`.
    """
    phase, duration = ramped_phase(2 * np.pi * laps, angular_speed, ramp)
    return Task(name, duration, tuple(tracked), CirclePath(amplitude, phase), obstacles)


@checked(amplitude=Number(1e-6, 100.0, "m"), petals=Whole(1, 99), angular_speed=Number(1e-4, 1e4, "rad/s"),
         laps=Number(1e-3, 1e5), ramp=Number(0.0, 1e4, "s"), tracked=TRACKED, name=TEXT)
def rose(amplitude: float = 0.015, petals: int = 3, angular_speed: float = 2.0, laps: float = 2.0, ramp: float = 5.0,
         tracked: Sequence[int | str] = (0, 1), name: str = "rose",
         obstacles: Sequence | None = None) -> Task:
    """a sin(p θ) (cos θ, sin θ), a rose with p petals, which starts and ends at rest. Arguments: see `figure_eight`.

    p is odd; half a turn of θ draws all petals. The long ramps give slow and fast parts. The paper has no such task, so
    a controller can be tuned on it and then be tested on the paper's tasks.
    Raises ValueError for an even number of petals.
    """
    if petals % 2 != 1 or petals < 1:
        raise ValueError(f"petals is {petals}; expected an odd number")
    phase, duration = ramped_phase(2 * np.pi * laps, angular_speed, ramp)
    return Task(name, duration, tuple(tracked), RosePath(amplitude, petals, phase), obstacles)


def path(times, points, outputs: Sequence[int | str], *, name: str = "path", obstacles=()) -> Task:
    """A path through your own points, straight between them and held at the last one: y(t_i) = points[i].

    times: (T,) s, increasing, the first at zero or later.   points: (T, q) m, relative to rest, one column for each of
    the q `outputs`.   outputs: names or indices.   obstacles: as in `Task`.
    Raises ValueError for times that do not increase, sizes that disagree, or numbers that are not finite.

    >>> there = path([0.0, 1.0, 3.0], [[0.0, 0.0], [0.01, 0.0], [0.01, 0.02]], outputs=["tip_x", "tip_y"])
    >>> there.reference([0.5, 2.0, 9.0])
    array([[0.005, 0.   ],
           [0.01 , 0.01 ],
           [0.01 , 0.02 ]])
    """
    times, points = np.array(times, dtype=np.float64), np.array(points, dtype=np.float64)
    if times.ndim != 1 or points.shape != (len(times), len(outputs)):
        raise ValueError(f"a path has times of shape {times.shape} and points of shape {points.shape} for "
                         f"{len(outputs)} outputs {list(outputs)}; expected (T,) and (T, {len(outputs)})")
    if not (np.isfinite(times).all() and np.isfinite(points).all()):
        raise ValueError("a path has times or points that are not finite; expected finite numbers in s and m")
    if len(times) < 2 or times[0] < 0 or (np.diff(times) <= 0).any():
        raise ValueError(f"a path has {len(times)} times, from {times[:1].tolist()} to {times[-1:].tolist()} s; "
                         "expected two or more, increasing, the first at zero or later")
    return Task(name, float(times[-1]), tuple(outputs), Polyline(times, np.asfortranarray(points)),
                obstacles)


def ramped_phase(total: float, speed: float, ramp: float) -> tuple[RampedPhase, float]:
    """A phase θ(t) from 0 to `total`, three times continuously differentiable, and its duration in s.

    dθ/dt rises to `speed` over `ramp` s as 6 s⁵ − 15 s⁴ + 10 s³ with s = t / ramp, stays there, and falls the same way.
    Raises ValueError when the two ramps alone cover more than `total`.
    """
    if not (total > 0 and speed > 0 and ramp >= 0):
        raise ValueError(f"total is {total}, speed {speed} and ramp {ramp} s; "
                         "expected a positive total and speed, and a ramp of zero or more")
    if speed * ramp > total:
        raise ValueError(f"the two ramps of {ramp} s cover {speed * ramp:.4g}, "
                         f"more than the total of {total:.4g}; shorten the ramp or add laps")
    duration = total / speed + ramp
    return RampedPhase(total, speed, ramp, duration), duration
