"""Constraints on the outputs over the horizon, between its steps too: a box, half-planes, and the nearest circles."""

from __future__ import annotations

import numpy as np

# circles that a stage looks at
NEAREST = 3
# straight pieces of the predicted path between two control steps
PARTS = 4


class OutputConstraints:
    """lower ≤ y ≤ upper, normalᵀ y ≤ offset, ‖y − c(t)‖ ≥ radius along the predicted path, each as far as possible:

        penalty = Σ over stages and constraints of  linear · s + quadratic · s²,   s = max(0, violation) in m,

    exact where `linear` exceeds what tracking gains by a violation. The path from y_0, which no input can change, to y_N
    is the cubic through the four predictions next to each point, in `PARTS` straight pieces a control step
    (`path_weights`); of stage k counts the largest violation on the way from y_{k−1} to y_k, but for the first piece of
    all, in which an input does next to nothing.
    Circles enter the quadratic program as the half-plane that touches them at the point next to the path, at the point
    and the time where it is next to them, and as the `NEAREST` ones of each stage only; the penalty counts all of them.

    columns: the tracked outputs, in which the obstacles lie; obstacles: with `clearance(time, outputs)`, circles with
    `centers(time)`, `center` (callable where it moves) and `radius`, half-planes with `normal` and `offset`, such as
    those of `tasks.obstacles`.
    output_bounds: (2, p) m, ±inf where there is no bound, or None. margins: (N,) m, by which every constraint is
    tightened at its stage. hard: no violation where the inputs can avoid it, whatever tracking gains by it.
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
        if not (self.linear > 0 and self.quadratic > 0):
            raise ValueError(f"linear is {linear} and quadratic {quadratic}; expected positive weights of a violation")
        self.weights = path_weights(self.horizon, PARTS)
        self._constant_rows(self._checked(output_bounds))
        self.nearest = min(NEAREST, len(self.circles))
        self.rows_per_stage = len(self.offsets) + self.nearest

    def tighten(self, margins) -> None:
        """Other margins, (N,) m. Raises ValueError for another number of them, or a negative one."""
        found = np.array(margins, dtype=np.float64)
        if found.shape != (self.horizon,) or not (np.isfinite(found) & (found >= 0)).all():
            raise ValueError(f"margins are {found.tolist()}; expected {self.horizon} lengths, one for each step of "
                             "the horizon, none negative")
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
        """Seen from `time` s with the robot at y_0 = start (p,) m, a control step every `period` s."""
        return ConstraintsAhead(self, time + period / PARTS * np.arange(self.points), start)


class ConstraintsAhead:
    """`OutputConstraints` from one time and place on: functions of the outputs y_1 … y_N (N, p) m alone.

    times: of the path's points, (N PARTS + 1,) s; start: y_0 (p,) m.
    """

    def __init__(self, constraints: OutputConstraints, times: np.ndarray, start: np.ndarray):
        self.constraints, self.start, self._centers = constraints, start, constraints.centers(times)

    def path(self, outputs: np.ndarray) -> np.ndarray:
        """The points of the path, (N PARTS + 1, p) m."""
        weights = self.constraints.weights
        return weights[:, 1:] @ outputs + weights[:, :1] * self.start

    def rows(self, outputs: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """normals (N, r, p), weights (N, r, N) and lacking (N, r) m of the rows

            normalᵀ Σ_j weights_j (y_j − outputs_j) ≥ lacking,

        lacking: the margin less the clearance of these outputs.
        """
        own, N = self.constraints, self.constraints.horizon
        fixed, shape = len(own.offsets), (N, own.rows_per_stage)
        normals, weights, lacking = np.empty((*shape, own.output_dim)), np.empty((*shape, N)), np.empty(shape)
        path, stages = self.path(outputs), np.arange(N)
        if fixed:
            clearance, place = self._of_walls(path)
            normals[:, :fixed], lacking[:, :fixed] = own.normals, -clearance
            weights[:, :fixed] = own.weights[place, 1:]
        if own.nearest:
            clearance, away, piece, share = self._of_circles(path)
            if own.nearest < len(own.circles):
                # in their own order: a solver that starts from its last solution finds every row where it was
                chosen = np.sort(np.argpartition(clearance, own.nearest - 1, axis=0)[:own.nearest], axis=0)
            else:
                chosen = np.broadcast_to(np.arange(own.nearest)[:, None], (own.nearest, N))
            distance = clearance[chosen, stages] + own.radii[chosen]
            inside = distance < 1e-9  # at the very center every direction is as good: the first axis
            direction = np.where(inside[..., None], [1.0, 0.0],
                                 away[chosen, stages] / np.maximum(distance, 1e-9)[..., None])
            normals[:, fixed:] = 0.0
            normals[:, fixed:, own.columns[:2]] = direction.swapaxes(0, 1)
            lacking[:, fixed:] = -clearance[chosen, stages].T
            piece, share = piece[chosen, stages].T, share[chosen, stages].T[..., None]
            weights[:, fixed:] = (1.0 - share) * own.weights[piece, 1:] + share * own.weights[piece + 1, 1:]
        return normals, weights, lacking + own.margins[:, None]

    def _of_walls(self, path: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Smallest clearance of each stage from box and half-planes, and the point of the path where, (N, ·)."""
        own = self.constraints
        clearance = (path[1:] @ own.normals.T - own.offsets).reshape(own.horizon, PARTS, -1)
        place = clearance.argmin(axis=1)
        return np.take_along_axis(clearance, place[:, None], axis=1)[:, 0], \
            place + 1 + PARTS * np.arange(own.horizon)[:, None]

    def _of_circles(self, path: np.ndarray) -> tuple[np.ndarray, ...]:
        """Of every circle at each stage, (circles, N): the clearance of the nearest point of the path; that point seen
        from the center (·, ·, 2); its piece of the path, and its share of the way along this piece.
        """
        own = self.constraints
        seen = path[:, own.columns[:2]] - self._centers
        first, along = seen[:, :-1], np.diff(seen, axis=1)
        length = np.maximum(np.square(along).sum(axis=-1), 1e-30)
        share = np.clip(-(first * along).sum(axis=-1) / length, 0.0, 1.0)
        share[:, 0] = 1.0  # the first piece counts by its end
        away = first + share[..., None] * along
        squared = np.square(away).sum(axis=-1).reshape(len(own.circles), own.horizon, PARTS)
        piece = squared.argmin(axis=-1) + PARTS * np.arange(own.horizon)
        circle = np.arange(len(own.circles))[:, None]
        clearance = np.sqrt(squared.min(axis=-1)) - own.radii[:, None]
        return clearance, away[circle, piece], piece, share[circle, piece]

    def violations(self, outputs: np.ndarray) -> np.ndarray:
        """max(0, violation) of every constraint, margins included, at every stage, (N, ·) m; circles exact."""
        own, path = self.constraints, self.path(outputs)
        found = [-self._of_walls(path)[0]] if len(own.offsets) else []
        if own.circles:
            found.append(-self._of_circles(path)[0].T)
        return np.maximum(np.concatenate(found, axis=1) + own.margins[:, None], 0.0)

    def penalty(self, outputs: np.ndarray) -> float:
        """The penalty of y_1 … y_N."""
        violation = self.violations(outputs)
        own = self.constraints
        return float(own.linear * violation.sum() + own.quadratic * np.square(violation).sum())


def path_weights(steps: int, parts: int) -> np.ndarray:
    """(steps · parts + 1, steps + 1): points of the path from y_0 to y_steps as weighted sums of y_0 … y_steps.

    At t = 0, 1/parts, … steps: the polynomial through the four whole numbers next to t, two on either side where there
    are (Lagrange), through all where there are fewer; exact for paths of degree three.

    >>> path_weights(3, 2)[3]
    array([-0.0625,  0.5625,  0.5625, -0.0625])
    """
    times, count = np.arange(steps * parts + 1) / parts, min(4, steps + 1)
    weights = np.zeros((len(times), steps + 1))
    for row, time in zip(weights, times):
        first = int(np.clip(np.floor(time) - 1, 0, steps + 1 - count))
        nodes = np.arange(first, first + count)
        for node in nodes:
            others = nodes[nodes != node]
            row[node] = np.prod((time - others) / (node - others))
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
