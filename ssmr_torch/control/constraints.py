"""Constraints on the outputs along the horizon, also between its steps: a box, half-planes, and the nearest circles."""

from __future__ import annotations

import numpy as np

# Number of circles that a stage takes into account.
NEAREST = 3
# Number of points of the predicted path per control step; the last one is its end.
PARTS = 2
# The linear penalty of a hard constraint is multiplied by these, one after the other, until no slack is needed.
HEAVIER = (1e2, 1e4)


class OutputConstraints:
    """lower ≤ y ≤ upper, normalᵀ y ≤ offset, ‖y − c(t)‖ ≥ radius along the predicted path, each as far as possible:

        penalty = Σ over points and constraints of  linear · s + quadratic · s²,   s = max(0, violation) in m.

    The penalty is exact where `linear` is larger than what tracking gains by a violation. The path starts at y_0 with
    the velocity there, which no input can change, and goes through y_1 … y_N. Each stage has `PARTS` points
    (`path_weights`). The straight piece of length l between two points stays out of a circle if both points keep
    √(radius² + l²/4) from its center; this distance is required, with the longer of the two pieces at a point.
    In the quadratic program a circle is the half-plane that touches it at the place next to the present prediction, at
    the time of the point. A point outside this half-plane is outside the circle. Each stage has only its `NEAREST`
    circles; the penalty counts all circles.

    columns: the tracked outputs, in which the obstacles lie.   obstacles: with `clearance(time, outputs)`; circles with
    `centers(time)`, `center` (callable where it moves) and `radius`; half-planes with `normal` and `offset`, such as
    those of `tasks.obstacles`.
    output_bounds: (2, p) m, ±inf where there is no bound, or None. margins: (N,) m, by which all constraints of a
    stage are tightened. hard: a violation only where no input can avoid it, whatever tracking gains by it; the linear
    part is then multiplied by `HEAVIER`.
    Raises ValueError for crossed bounds or sizes that disagree.
    """

    def __init__(self, output_dim: int, horizon: int, columns=(), obstacles=(), output_bounds=None, margins=None, *,
                 linear: float, quadratic: float, hard: bool = False):
        self.columns, self.output_dim, self.horizon = list(columns), int(output_dim), int(horizon)
        self.circles = [o for o in obstacles if hasattr(o, "radius")]
        self.walls = [o for o in obstacles if not hasattr(o, "radius")]
        self.radii = np.array([circle.radius for circle in self.circles])
        self._moving = [i for i, circle in enumerate(self.circles) if callable(circle.center)]
        self.points = self.horizon * PARTS + 1
        self._centers = np.empty((len(self.circles), self.points, 2))
        for i, circle in enumerate(self.circles):
            self._centers[i] = circle.centers(np.zeros(self.points))
        self.tighten(np.zeros(horizon) if margins is None else margins)
        self.linear, self.quadratic, self.hard = float(linear), float(quadratic), bool(hard)
        # The cost of a violation when iterates are compared, 1/m.
        self.price = self.linear * (HEAVIER[-1] if self.hard else 1.0)
        if not (self.linear > 0 and self.quadratic > 0):
            raise ValueError(f"linear is {linear} and quadratic {quadratic}; expected positive weights of a violation")
        self.weights = path_weights(self.horizon, PARTS)
        self._constant_rows(self._checked(output_bounds))
        self.nearest = min(NEAREST, len(self.circles))
        self.rows_per_stage = PARTS * (len(self.offsets) + self.nearest)

    def tighten(self, margins) -> None:
        """Set other margins, (N,) m. Raises ValueError for a wrong number of them, or a negative one."""
        found = np.array(margins, dtype=np.float64)
        if found.shape != (self.horizon,) or not (np.isfinite(found) & (found >= 0)).all():
            raise ValueError(f"margins are {found.tolist()}; expected {self.horizon} lengths in m, one for each step "
                             "of the horizon, none negative")
        self.margins = found

    def _checked(self, bounds) -> np.ndarray:
        free = np.tile([[-np.inf], [np.inf]], self.output_dim)
        bounds = free if bounds is None else np.array(bounds, dtype=np.float64)
        if bounds.shape != free.shape or not (bounds[0] < bounds[1]).all():
            raise ValueError(f"output_bounds are {bounds.tolist()}; expected (2, {self.output_dim}): lowest and "
                             "highest output, m, lowest below highest, infinite where there is no bound")
        return bounds

    def _constant_rows(self, bounds: np.ndarray) -> None:
        """Box and half-planes as normalᵀ y ≥ offset."""
        identity, normals, offsets = np.eye(self.output_dim), [], []
        for side, sign in ((0, 1.0), (1, -1.0)):
            for column in np.flatnonzero(np.isfinite(bounds[side])):
                normals.append(sign * identity[column])
                offsets.append(sign * bounds[side, column])
        for wall in self.walls:
            normal = np.zeros(self.output_dim)
            normal[self.columns[:len(wall.normal)]] = -wall.normal
            normals.append(normal)
            offsets.append(-wall.offset)
        self.normals = np.array(normals).reshape(-1, self.output_dim)
        self.offsets = np.array(offsets)

    def centers(self, times: np.ndarray) -> np.ndarray:
        """(circles, N PARTS + 1, 2) m at the times of the path's points."""
        if not self._moving:
            return self._centers
        centers = self._centers.copy()
        for i in self._moving:
            centers[i] = self.circles[i].centers(times)
        return centers

    def ahead(self, time: float, period: float, start: np.ndarray) -> ConstraintsAhead:
        """The constraints from time `time` s on, a control step every `period` s; start (2, p) m: y_0, period · dy/dt.
        """
        return ConstraintsAhead(self, time + period / PARTS * np.arange(self.points), start)


class ConstraintsAhead:
    """`OutputConstraints` from one time and place on, as functions of the outputs y_1 … y_N (N, p) m alone.

    times: of the path's points, (N PARTS + 1,) s; start (2, p) m: y_0 and its change in a period at the velocity there.
    """

    def __init__(self, constraints: OutputConstraints, times: np.ndarray, start: np.ndarray):
        self.constraints, self._centers = constraints, constraints.centers(times)
        self._given = constraints.weights[:, :2] @ start

    def path(self, outputs: np.ndarray) -> np.ndarray:
        """The points of the path, (N PARTS + 1, p) m."""
        return self._given + self.constraints.weights[:, 2:] @ outputs

    def rows(self, outputs: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """normals (N, r, p), weights (N, r, N) and lacking (N, r) m of the rows

            normalᵀ Σ_j weights_j (y_j − outputs_j) ≥ lacking,

        lacking: the margin minus the clearance of these outputs. The rows of a stage's first point come first.
        """
        own, path = self.constraints, self.path(outputs)
        each, fixed, p = own.rows_per_stage // PARTS, len(own.offsets), own.output_dim
        normals, lacking = np.zeros((own.points - 1, each, p)), np.empty((own.points - 1, each))
        normals[:, :fixed], lacking[:, :fixed] = own.normals, own.offsets - path[1:] @ own.normals.T
        if own.nearest:
            clearance, away, distance = self._of_circles(path)
            chosen = self._chosen(clearance)
            point = np.arange(own.points - 1)
            away, distance = away[chosen, point], distance[chosen, point]
            inside = distance < 1e-9  # at the center no direction is better than another: take the first axis
            direction = np.where(inside[..., None], [1.0, 0.0], away / np.maximum(distance, 1e-9)[..., None])
            normals[:, fixed:, own.columns[:2]] = direction.swapaxes(0, 1)
            lacking[:, fixed:] = -clearance[chosen, point].T
        lacking += np.repeat(own.margins, PARTS)[:, None]
        weights = np.repeat(own.weights[1:, 2:], each, axis=0).reshape(own.horizon, -1, own.horizon)
        return normals.reshape(own.horizon, -1, p), weights, lacking.reshape(own.horizon, -1)

    def _chosen(self, clearance: np.ndarray) -> np.ndarray:
        """(nearest, points): the circles nearest to the path at each point's stage."""
        own = self.constraints
        if own.nearest == len(own.circles):
            return np.broadcast_to(np.arange(own.nearest)[:, None], (own.nearest, own.points - 1))
        closest = clearance.reshape(len(own.circles), own.horizon, PARTS).min(axis=-1)
        # In a fixed order, so that a solver that starts from its last solution finds every row in its place.
        chosen = np.sort(np.argpartition(closest, own.nearest - 1, axis=0)[:own.nearest], axis=0)
        return np.repeat(chosen, PARTS, axis=1)

    def _of_circles(self, path: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """For every circle at each point but the start, (circles, N PARTS): the clearance, minus the depth to which
        the straight pieces enter; the vector from the center to the point, (·, ·, 2), and its length.
        """
        own = self.constraints
        seen = path[:, own.columns[:2]] - self._centers
        lengths = np.square(np.diff(seen, axis=1)).sum(axis=-1)
        longer = lengths.copy()
        longer[:, :-1] = np.maximum(lengths[:, :-1], lengths[:, 1:])
        away = seen[:, 1:]
        distance = np.sqrt(np.square(away).sum(axis=-1))
        return distance - np.sqrt(np.square(own.radii)[:, None] + 0.25 * longer), away, distance

    def clearances(self, outputs: np.ndarray) -> np.ndarray:
        """Clearance minus margin of every constraint at every point, (N PARTS, ·) m; negative where it is violated."""
        own, path = self.constraints, self.path(outputs)
        found = [path[1:] @ own.normals.T - own.offsets] if len(own.offsets) else []
        if own.circles:
            found.append(self._of_circles(path)[0].T)
        return np.concatenate(found, axis=1) - np.repeat(own.margins, PARTS)[:, None]

    def violation(self, outputs: np.ndarray) -> float:
        """The largest violation, m; 0 where every constraint is kept."""
        return max(-float(self.clearances(outputs).min()), 0.0)

    def penalty(self, outputs: np.ndarray) -> float:
        """The penalty of y_1 … y_N."""
        own, violation = self.constraints, np.maximum(-self.clearances(outputs), 0.0)
        return float(own.price * violation.sum() + own.quadratic * np.square(violation).sum())


def path_weights(steps: int, parts: int) -> np.ndarray:
    """(steps · parts + 1, steps + 2): points of the path as weighted sums of y_0, T dy_0/dt, y_1 … y_steps.

    The times are t/T = 0, 1/parts, … steps. In the first step it is the parabola from y_0 with its velocity to y_1,
    exact where the acceleration is constant while an input is held. Later it is the polynomial through the four outputs
    next to t, two on each side where possible (Lagrange), exact for paths of degree three.

    >>> path_weights(3, 2)[[1, 3]]
    array([[ 0.75  ,  0.25  ,  0.25  ,  0.    ,  0.    ],
           [-0.0625,  0.    ,  0.5625,  0.5625, -0.0625]])
    """
    times, count = np.arange(steps * parts + 1) / parts, min(4, steps + 1)
    weights = np.zeros((len(times), steps + 1))
    for row, time in zip(weights, times):
        first = int(np.clip(np.floor(time) - 1, 0, steps + 1 - count))
        nodes = np.arange(first, first + count)
        for node in nodes:
            others = nodes[nodes != node]
            row[node] = np.prod((time - others) / (node - others))
    weights = np.insert(weights, 1, 0.0, axis=1)
    share = times[:parts]
    weights[:parts] = 0.0
    weights[:parts, :3] = np.stack([1.0 - share**2, share - share**2, share**2], axis=1)
    return weights


def constraints_of(task, columns, output_dim: int, settings, *, linear: float,
                   quadratic: float) -> OutputConstraints | None:
    """The constraints of a task and of the controller's settings; None where there are none."""
    obstacles, bounds = getattr(task, "obstacles", ()), settings.output_bounds
    bounded = bounds is not None and np.isfinite(np.asarray(bounds, dtype=np.float64)).any()
    if not obstacles and not bounded:
        return None
    return OutputConstraints(output_dim, settings.horizon, columns, obstacles, bounds, settings.margins, linear=linear,
                             quadratic=quadratic, hard=settings.hard_constraints)
