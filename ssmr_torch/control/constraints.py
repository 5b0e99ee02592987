"""Soft constraints on the outputs over the horizon: a box, half-planes, and the nearest circles."""

from __future__ import annotations

import numpy as np

# circles that a stage looks at
NEAREST = 3


class OutputConstraints:
    """lower ≤ y ≤ upper, normalᵀ y ≤ offset, ‖y − c(t)‖ ≥ radius for y_1 … y_N, each as far as possible:

        penalty = Σ over stages and constraints of  linear · s + quadratic · s²,   s = max(0, violation) in m,

    exact where `linear` exceeds what tracking gains by a violation. Circles enter the quadratic program as the
    half-plane that touches them at the point next to the present prediction, at the stage that they constrain, and as
    the `NEAREST` ones only; the penalty counts all of them.

    columns: the tracked outputs, in which the obstacles lie; obstacles: with `clearance(time, outputs)`, circles with
    `centers(time)`, `center` (callable where it moves) and `radius`, half-planes with `normal` and `offset`, such as
    those of `tasks.obstacles`.
    output_bounds: (2, p) m, ±inf where there is no bound, or None. margins: (N,) m, by which every constraint is
    tightened at its stage.
    Raises ValueError for crossed bounds or sizes that disagree.
    """

    def __init__(self, output_dim: int, horizon: int, columns=(), obstacles=(), output_bounds=None, margins=None, *,
                 linear: float, quadratic: float):
        self.columns, self.output_dim, self.horizon = list(columns), int(output_dim), int(horizon)
        self.circles = [o for o in obstacles if hasattr(o, "radius")]
        self.walls = [o for o in obstacles if not hasattr(o, "radius")]
        self.radii = np.array([circle.radius for circle in self.circles])
        self._moving = [i for i, circle in enumerate(self.circles) if callable(circle.center)]
        self._centers = np.empty((len(self.circles), horizon, 2))
        for i, circle in enumerate(self.circles):
            self._centers[i] = circle.centers(np.zeros(horizon))
        self.margins = np.zeros(horizon) if margins is None else np.array(margins, dtype=np.float64)
        if self.margins.shape != (horizon,) or not (np.isfinite(self.margins) & (self.margins >= 0)).all():
            raise ValueError(f"margins are {self.margins.tolist()}; expected {horizon} lengths, one for each step of "
                             "the horizon, none negative")
        self.linear, self.quadratic = float(linear), float(quadratic)
        if not (self.linear > 0 and self.quadratic > 0):
            raise ValueError(f"linear is {linear} and quadratic {quadratic}; expected positive weights of a violation")
        self._constant_rows(self._checked(output_bounds))
        self.nearest = min(NEAREST, len(self.circles))
        self.rows_per_stage = len(self._offsets) + self.nearest

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
        self._normals = np.array(normals).reshape(-1, self.output_dim)
        self._offsets = np.array(offsets)

    def centers(self, times: np.ndarray) -> np.ndarray:
        """(circles, N, 2) m."""
        if not self._moving:
            return self._centers
        centers = self._centers.copy()
        for i in self._moving:
            centers[i] = self.circles[i].centers(times)
        return centers

    def rows(self, times: np.ndarray, outputs: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """normals (N, r, p) and offsets (N, r) of normalᵀ y_k ≥ offset, around outputs (N, p) at times (N,) s."""
        N, fixed = self.horizon, len(self._offsets)
        normals = np.zeros((N, self.rows_per_stage, self.output_dim))
        offsets = np.empty((N, self.rows_per_stage))
        normals[:, :fixed], offsets[:, :fixed] = self._normals, self._offsets
        if self.nearest:
            plane = self.columns[:2]
            away = outputs[:, plane] - self.centers(times)
            distance = np.sqrt(np.square(away).sum(-1))
            clearance = distance - self.radii[:, None]
            if self.nearest < len(self.circles):
                # in their own order: a solver that starts from its last solution finds every row where it was
                chosen = np.sort(np.argpartition(clearance, self.nearest - 1, axis=0)[:self.nearest], axis=0)
            else:
                chosen = np.broadcast_to(np.arange(self.nearest)[:, None], (self.nearest, N))
            stages = np.arange(N)
            away, distance = away[chosen, stages], distance[chosen, stages]
            inside = distance < 1e-9  # at the very center every direction is as good: the first axis
            direction = np.where(inside[..., None], [1.0, 0.0], away / np.maximum(distance, 1e-9)[..., None])
            # normalᵀ y ≥ normalᵀ c + radius, and normalᵀ c = normalᵀ y − distance
            here = np.einsum("rkq,kq->rk", direction, outputs[:, plane])
            normals[:, fixed:, plane[0]], normals[:, fixed:, plane[1]] = direction[..., 0].T, direction[..., 1].T
            offsets[:, fixed:] = (here - distance + self.radii[chosen]).T
        return normals, offsets + self.margins[:, None]

    def violations(self, times: np.ndarray, outputs: np.ndarray) -> np.ndarray:
        """max(0, violation) of every constraint at every stage, (N, ·) m, circles exact."""
        found = [self._offsets - outputs @ self._normals.T] if len(self._offsets) else []
        if self.circles:
            away = outputs[:, self.columns[:2]] - self.centers(times)
            found.append((self.radii[:, None] - np.sqrt(np.square(away).sum(-1))).T)
        return np.maximum(np.concatenate(found, axis=1) + self.margins[:, None], 0.0)

    def penalty(self, times: np.ndarray, outputs: np.ndarray) -> float:
        """The penalty of y_1 … y_N (N, p) at times (N,) s."""
        violation = self.violations(times, outputs)
        return float(self.linear * violation.sum() + self.quadratic * np.square(violation).sum())


def constraints_of(task, columns, output_dim: int, horizon: int, *, output_bounds=None, margins=None, linear: float,
                   quadratic: float) -> OutputConstraints | None:
    """The constraints of a task and of the controller's settings; None where there are none."""
    obstacles = getattr(task, "obstacles", ())
    bounded = output_bounds is not None and np.isfinite(np.asarray(output_bounds, dtype=np.float64)).any()
    if not obstacles and not bounded:
        return None
    return OutputConstraints(output_dim, horizon, columns, obstacles, output_bounds, margins, linear=linear,
                             quadratic=quadratic)
