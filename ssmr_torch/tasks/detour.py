"""A detour: a reference that runs into obstacles is led around them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ssmr_torch.tasks.references import Task

# Corners of the polygon around each circle, and samples of the reference per second.
CORNERS, RATE = 32, 500


def detour(task: Task, clearance: float = 0.0) -> Task:
    """The same task with its reference led around the circles that do not move, along the shortest way.

    Where the reference is nearer to a circle than `clearance` m, that part is replaced. The new part runs from the last
    point before it to the first point after it. It is the shortest way that keeps the clearance from all circles, along
    polygons of `CORNERS` corners around them. It takes the same time as the part that it replaces: at every instant the
    same share of the length has been covered. A controller that looks only some steps ahead then does not stop in front
    of an obstacle to wait for the reference. A reference that begins or ends inside a circle begins or ends at the
    nearest point outside.
    The controller itself must avoid moving circles and half-planes. Outputs after the first two keep their reference.
    Raises ValueError where no such way exists, with the time, and for a negative clearance.
    """
    circles = [o for o in task.obstacles if hasattr(o, "radius") and not callable(o.center)]
    if not (np.isfinite(clearance) and clearance >= 0):
        raise ValueError(f"clearance is {clearance} m; expected a length, zero or more")
    if not circles:
        return task
    time = np.linspace(0.0, task.duration, int(np.ceil(task.duration * RATE)) + 1)
    reference = task.reference(time)
    room = _Room(np.array([circle.center for circle in circles]),
                 np.array([circle.radius + clearance for circle in circles]))
    for first, last in _inside(room, reference[:, :2]):
        before, after = max(first - 1, 0), min(last + 1, len(time) - 1)
        ends = [room.outside(reference[k, :2]) for k in (before, after)]
        way = room.way(*ends)
        if way is None:
            raise ValueError(f"the reference of task {task.name!r} is inside an obstacle from {time[first]:.3g} to "
                             f"{time[last]:.3g} s, and no way around it keeps a clearance of {1e3 * clearance:g} mm; "
                             "reduce the clearance, or move the obstacles")
        reference[before:after + 1, :2] = _passed(way, reference[before:after + 1, :2])

    def path(at):
        return np.stack([np.interp(at, time, column) for column in reference.T], axis=-1)

    return replace(task, path=path)


def _inside(room: _Room, points: np.ndarray) -> list[tuple[int, int]]:
    """First and last index of each stretch of the points that lies in a circle."""
    blocked = np.concatenate([[False], room.clearance(points) < 0, [False]])
    changes = np.flatnonzero(blocked[1:] != blocked[:-1])
    return list(zip(changes[::2], changes[1::2] - 1))


def _passed(way: np.ndarray, own: np.ndarray) -> np.ndarray:
    """Points on the way (corners, 2). Each lies at the share of the way's length that it has in `own` (K, 2)."""
    done = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(own, axis=0), axis=1))])
    share = done / done[-1] if done[-1] > 0 else np.linspace(0.0, 1.0, len(own))
    along = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(way, axis=0), axis=1))])
    return np.stack([np.interp(share * along[-1], along, column) for column in way.T], axis=1)


class _Room:
    """The plane outside circles with centers (c, 2) and radii (c,) m. Ways run along polygons around the circles."""

    def __init__(self, centers: np.ndarray, radii: np.ndarray):
        self.centers, self.radii = centers, radii
        angle = 2 * np.pi * np.arange(CORNERS) / CORNERS
        around = np.stack([np.cos(angle), np.sin(angle)], axis=1)
        # The sides of the polygon touch the circle. The factor keeps rounding from putting them inside.
        corners = centers[:, None] + (1 + 1e-6) * radii[:, None, None] / np.cos(np.pi / CORNERS) * around
        corners = corners.reshape(-1, 2)
        self.corners = corners[self.clearance(corners) >= 0]
        self._lengths = np.array([self._free(corner, self.corners) for corner in self.corners]).reshape(
            len(self.corners), len(self.corners))

    def clearance(self, points: np.ndarray) -> np.ndarray:
        """Distance (K,) m from points (K, 2) to the nearest circle; negative inside."""
        return (np.linalg.norm(points[:, None] - self.centers, axis=2) - self.radii).min(axis=1)

    def outside(self, point: np.ndarray) -> np.ndarray:
        """The point itself, or the nearest corner where the point lies in a circle."""
        if self.clearance(point[None])[0] >= 0 or not len(self.corners):
            return point
        return self.corners[np.linalg.norm(self.corners - point, axis=1).argmin()]

    def _free(self, start: np.ndarray, ends: np.ndarray) -> np.ndarray:
        """Lengths (K,) m of the straight lines from start (2,) to ends (K, 2); infinite where one cuts a circle."""
        along = ends - start
        length = np.linalg.norm(along, axis=1)
        share = ((self.centers - start) @ along.T) / np.maximum(length, 1e-12)**2
        nearest = start + np.clip(share, 0.0, 1.0)[..., None] * along
        distance = np.linalg.norm(nearest - self.centers[:, None], axis=2)
        return np.where((distance >= self.radii[:, None] * (1 - 1e-9)).all(axis=0), length, np.inf)

    def way(self, start: np.ndarray, end: np.ndarray) -> np.ndarray | None:
        """Corners (·, 2) of the shortest way, with both ends; None where there is no way."""
        from scipy.sparse.csgraph import dijkstra  # only for planning: a robot needs no SciPy

        count = len(self.corners)
        lengths = np.full((count + 2, count + 2), np.inf)
        lengths[:count, :count] = self._lengths
        for place, point in ((count, start), (count + 1, end)):
            lengths[place, :count] = lengths[:count, place] = self._free(point, self.corners)
        lengths[count, count + 1] = self._free(start, end[None])[0]
        lengths[~np.isfinite(lengths)] = 0.0  # no edge
        total, previous = dijkstra(lengths, directed=False, indices=count, return_predecessors=True)
        if not np.isfinite(total[count + 1]):
            return None
        places = [count + 1]
        while places[-1] != count:
            places.append(previous[places[-1]])
        return np.concatenate([self.corners, [start, end]])[places[::-1]]
