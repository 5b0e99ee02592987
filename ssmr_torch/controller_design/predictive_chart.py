"""Predictive charts: the state is the tracked outputs, and the parts of the past that predict the future best.

All arrays here are scaled: outputs by the reach, inputs to −1 … 1 over their bounds. `Regression.model` is in SI.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import combinations_with_replacement

import numpy as np

from ssmr_torch.controller_design.recordings import Piece, Recordings
from ssmr_torch.models.monomials import Monomials
from ssmr_torch.models.polynomial import PolynomialModel
from ssmr_torch.models.structure import Structure
from ssmr_torch.selection.assembly import uncentred

ROWS = 8000          # rows of a regression while models are compared
CHART_RIDGE, OUTPUT_RIDGE = 1e-7, 1e-6
CURVED = 6           # number of leading coordinates whose products the other outputs are decoded from
FREE = 1.5           # times the recorded range: rollouts are clipped there while models are compared
REACH = 1.2          # of the recorded range: beyond it nonlinear terms of the model saturate


@dataclass(frozen=True)
class Form:
    """The settings of a predictive model. keep: outputs that are coordinates, decoded exactly; window: samples of the
    chart; states: n; degree: of the dynamics over (z, u); cubic: number of leading coordinates in cubic terms; ridge;
    past_inputs: whether the chart uses the inputs within the window.
    """

    keep: tuple[int, ...]
    window: int
    states: int
    degree: int
    cubic: int = 4
    ridge: float = 1e-6
    past_inputs: bool = True

    @property
    def words(self) -> str:
        seen = "with" if self.past_inputs else "without"
        return (f"{self.states} states from {self.window} samples {seen} past inputs, degree {self.degree}, "
                f"ridge {self.ridge:g}")


@dataclass(frozen=True, eq=False)
class Chart:
    """z = [w, 1] E for windows w: E (values + 1, n_max), kept outputs first; R (q, q): kept outputs = z[:q] R + rest.
    """

    E: np.ndarray
    R: np.ndarray


class Scaled:
    """Recordings as scaled arrays; every `stride`-th row is used for regressions."""

    def __init__(self, recordings: Recordings, future: int, most: int | None = ROWS):
        self.recordings, self.future = recordings, future
        self.middle, self.half = recordings.bounds.mean(0), 0.5 * recordings.input_range
        self.train = [self._scaled(piece) for piece in recordings.train]
        self.held = [self._scaled(piece) for piece in recordings.held]
        rows = sum(len(piece.input) for piece in self.train)
        self.stride = 1 if most is None else max(1, int(np.ceil(rows / most)))

    def _scaled(self, piece: Piece) -> Piece:
        return piece._replace(observation=piece.observation / self.recordings.reach,
                              input=(piece.input - self.middle) / self.half)


def windows(piece: Piece, length: int, past_inputs: bool) -> tuple[np.ndarray, np.ndarray]:
    """Windows (K, values), oldest sample first, then the past inputs; and the numbers k of their last samples."""
    y, u = piece.observation, piece.input
    k = np.arange(length - 1, len(y))
    parts = [y[k - j] for j in range(length - 1, -1, -1)]
    if past_inputs:
        parts += [u[k - j] for j in range(length - 1, 0, -1)]
    return np.hstack(parts), k


def ridge_solution(X: np.ndarray, Y: np.ndarray, ridge: float) -> np.ndarray:
    """argmin ‖X β − Y‖² + ridge rows ‖s β‖², where s is the root mean square of each column of X."""
    scale = np.sqrt((X**2).mean(0)) + 1e-12
    return _solved((X / scale).T @ (X / scale), (X / scale).T @ Y, ridge * len(X)) / scale[:, None]


def _solved(G: np.ndarray, B: np.ndarray, ridge: float) -> np.ndarray:
    return np.linalg.solve(G + ridge * np.eye(len(G)), B)


def chart(scaled: Scaled, keep: Sequence[int], length: int, past_inputs: bool) -> Chart:
    """A chart with the kept outputs, and with those directions of the window that reduced-rank regression of the next
    `future` outputs on window and future inputs finds.
    """
    W, V, Y = [], [], []
    for piece in scaled.train:
        w, k = windows(piece, length, past_inputs)
        chosen = np.flatnonzero(k < len(piece.input) - scaled.future)[::scaled.stride]
        w, k = w[chosen], k[chosen]
        W.append(w)
        V.append(np.hstack([piece.input[k + j] for j in range(scaled.future)]))
        Y.append(np.hstack([piece.observation[k + j] for j in range(1, scaled.future + 1)]))
    W, V, Y = np.vstack(W), np.vstack(V), np.vstack(Y)
    mean = W.mean(0)
    centred = W - mean
    theta = ridge_solution(np.hstack([centred, V, np.ones((len(W), 1))]), Y, CHART_RIDGE)[:W.shape[1]]
    C = centred.T @ centred / len(W)
    C[np.diag_indices(len(C))] += 1e-10 * np.trace(C) / len(C)
    L = np.linalg.cholesky(C)
    p = scaled.recordings.output_dim
    newest = [(length - 1) * p + column for column in keep]
    Q, R = np.linalg.qr(L.T[:, newest])
    M = L.T @ theta
    others = np.linalg.svd(M - Q @ (Q.T @ M), full_matrices=False)[0][:, :W.shape[1] - len(newest)]
    E = np.linalg.solve(L.T, np.hstack([Q, others]))
    return Chart(np.vstack([E, -mean @ E]), R)


def monomial_factors(n: int, m: int, degree: int, cubic: int) -> list[tuple[int, ...]]:
    """Factors of the monomials of (z, u) up to a degree, graded; cubic monomials have only the leading z and u."""
    found: list[tuple[int, ...]] = [(), *((k,) for k in range(n + m))]
    if degree >= 2:
        found += combinations_with_replacement(range(n + m), 2)
    if degree >= 3:
        found += combinations_with_replacement([*range(min(cubic, n)), *range(n, n + m)], 3)
    return found


class Regression:
    """Gram matrices for one chart and number of states. Every degree and ridge is solved from them."""

    def __init__(self, scaled: Scaled, found: Chart, form: Form):
        self.scaled, self.chart, self.form = scaled, found, form
        n, m = form.states, scaled.recordings.input_dim
        self.E = found.E[:, :n]
        self.factors = monomial_factors(n, m, 3, form.cubic)
        self.monomials = Monomials(n + m, self.factors)
        X, D, self.states, self.outputs = [], [], [], []
        for piece in scaled.train:
            w, k = windows(piece, form.window, form.past_inputs)
            z = w @ self.E[:-1] + self.E[-1]
            rows = np.arange(0, len(z) - 1, scaled.stride)
            X.append(np.hstack([z, piece.input[k]])[rows])
            D.append(z[rows + 1] - z[rows])
            self.states.append(z[::scaled.stride])
            self.outputs.append(piece.observation[k][::scaled.stride])
        self.states, self.outputs = np.vstack(self.states), np.vstack(self.outputs)
        self.limit = np.abs(self.states).max(0)
        phi = self.monomials.chosen_rows(self.monomials.rows(np.ascontiguousarray(np.vstack(X).T)))
        self.scale = np.sqrt((phi**2).mean(1)) + 1e-12
        phi /= self.scale[:, None]
        self.rows, self.gram, self.moment = phi.shape[1], phi @ phi.T, phi @ np.vstack(D)

    def dynamics(self, degree: int, ridge: float) -> np.ndarray:
        """(F, n): z⁺ − z over the monomials up to this degree; zero for monomials of a higher degree."""
        count = len(monomial_factors(self.form.states, self.scaled.recordings.input_dim, degree, self.form.cubic))
        table = np.zeros((len(self.factors), self.form.states))
        solution = _solved(self.gram[:count, :count], self.moment[:count], ridge * self.rows)
        table[:count] = solution / self.scale[:count, None]
        return table

    @cached_property
    def curved(self) -> Monomials:
        n = self.form.states
        few = [combo for degree in (2, 3) for combo in combinations_with_replacement(range(min(n, CURVED)), degree)]
        return Monomials(n, [(), *((k,) for k in range(n)), *few])

    @cached_property
    def decoder(self) -> np.ndarray:
        """(·, p): all outputs over the `curved` monomials; the kept outputs exactly."""
        phi = self.curved.chosen_rows(self.curved.rows(np.ascontiguousarray(self.states.T))).T
        table = ridge_solution(phi, self.outputs, OUTPUT_RIDGE)
        q = len(self.form.keep)
        keep = list(self.form.keep)
        table[:, keep] = 0.0
        table[1:1 + q, keep] = self.chart.R
        table[0, keep] = (self.outputs[:, keep] - self.states[:, :q] @ self.chart.R).mean(0)
        return table

    def errors(self, table: np.ndarray, steps: int, stride: int = 7) -> np.ndarray:
        """Prediction errors (starts, steps, p) on held-out runs, from encoded windows."""
        found = []
        for piece in self.scaled.held:
            w, k = windows(piece, self.form.window, self.form.past_inputs)
            start = np.arange(0, len(k) - steps, stride)
            z, errors = w[start] @ self.E[:-1] + self.E[-1], []
            for step in range(steps):
                joint = np.hstack([z, piece.input[k[start] + step]])
                z = z + self._values(self.monomials, joint) @ table
                z = np.clip(z, -FREE * self.limit, FREE * self.limit)
                errors.append(self._values(self.curved, z) @ self.decoder - piece.observation[k[start] + step + 1])
            found.append(np.swapaxes(errors, 0, 1))
        return np.concatenate(found)

    @staticmethod
    def _values(monomials: Monomials, points: np.ndarray) -> np.ndarray:
        return monomials.chosen_rows(monomials.rows(np.ascontiguousarray(points.T))).T

    def model(self, degree: int, ridge: float) -> PolynomialModel:
        """The model in SI units, a map over one sample. Its nonlinear terms saturate near the recorded range."""
        recordings, form = self.scaled.recordings, self.form
        n, p, m, length = form.states, recordings.output_dim, recordings.input_dim, form.window
        table = self.dynamics(degree, ridge)
        factors = monomial_factors(n, m, degree, form.cubic)
        table = table[:len(factors)].T.copy()
        table[:, 1:1 + n] += np.eye(n)
        middle, half = recordings.bounds.mean(0), 0.5 * recordings.input_range
        monomials, change = uncentred(Monomials(n + m, factors), n, (middle / half).tolist(), half.tolist())
        seen = length * p + ((length - 1) * m if form.past_inputs else 0)
        scale = np.concatenate([np.full(length * p, recordings.reach), np.tile(half, length - 1)])[:seen]
        encode = self.E.copy()
        if form.past_inputs:
            encode[-1] -= np.tile(middle / half, length - 1) @ encode[length * p:-1]
        linear = Monomials(seen, [(), *((k,) for k in range(seen))])
        return PolynomialModel(
            structure=Structure(linear, tuple(range(seen)), self.curved, monomials, "map", saturated=True),
            chart=np.vstack([encode[-1], encode[:-1]]).T, parametrization=recordings.reach * self.decoder.T,
            dynamics=table @ change, window_scale=scale, state_scale=self.limit, reach=REACH, input_dim=m, output_dim=p,
            delays=length - 1, timestep=recordings.timestep, window_timestep=recordings.timestep,
            base_timestep=recordings.timestep)


def held_error(errors: np.ndarray, columns: Sequence[int]) -> float:
    """Mean over five horizons of the root mean square error in the columns. The horizons are spaced logarithmically."""
    sizes = np.sqrt((errors[:, :, list(columns)]**2).sum(2).mean(0))
    at = np.unique(np.round(np.geomspace(1, len(sizes), 5)).astype(int)) - 1
    return float(np.mean(sizes[at])) if np.isfinite(sizes).all() else np.inf
