"""Builds a `PolynomialModel` in SI units, with states [z, s], from tables over centred and scaled variables."""

from __future__ import annotations

from functools import cached_property
from itertools import combinations

import numpy as np

from ssmr_torch.models.monomials import Monomials
from ssmr_torch.models.polynomial import PolynomialModel
from ssmr_torch.models.structure import Structure
from ssmr_torch.selection.charts import Chart
from ssmr_torch.selection.folds_and_starts import Samples
from ssmr_torch.selection.specification import Specification

REACH = 2.0   # nonlinear terms saturate beyond this many times the training range, and stay below 1.5 times that
CURVED = 6    # number of leading coordinates whose products are regressors of the outputs


class Assembly:
    """The common parts of all models of a specification: structure, and the linear map from centred tables to SI units.

    n: slow coordinates; latent_dim: p'; memory: n_s states of past inputs; linear, beyond: monomials of the flow map
    over (z, s̃, ũ), with s̃, ũ centred and scaled.
    """

    def __init__(self, samples: Samples, specification: Specification, n: int, latent_dim: int, memory: int,
                 linear: list, beyond: list):
        self.samples, self.specification = samples, specification
        self.n, self.latent_dim, self.memory = n, latent_dim, memory
        self.linear, self.beyond = linear, beyond
        self.centre = samples.input_mean / samples.input_scale
        self.centred = Monomials(n + memory + samples.input_dim, [*linear, *beyond])
        self.curved = Monomials(n + memory, [(), *((k,) for k in range(n + memory)), *(
            (a, b) for a in range(min(n, CURVED)) for b in range(a, min(n, CURVED)))])

    def regressors(self, joint: np.ndarray) -> np.ndarray:
        """The monomials of (z, s̃, ũ), (R, n + n_s + m) → (R, F)."""
        return _values(self.centred, joint)

    def outputs(self, joint: np.ndarray) -> np.ndarray:
        """The monomials of (z, s̃) on which the outputs are regressed."""
        return _values(self.curved, joint)

    @property
    def delays(self) -> int:
        """Number of samples before the newest one in the model's window."""
        chosen = self.specification
        return max(chosen.delays, self.samples.past if chosen.pole else int(chosen.memory[1]))

    @cached_property
    def uncentred(self) -> tuple[Monomials, np.ndarray]:
        """Monomials over (z, s, u), and the matrix that converts a table over centred monomials to one over these."""
        return uncentred(self.centred, self.n, self._constants(self.samples.input_dim + self.memory),
                          [1.0] * self.memory + self.samples.input_scale.tolist())

    @cached_property
    def uncentred_outputs(self) -> tuple[Monomials, np.ndarray]:
        return uncentred(self.curved, self.n, self._constants(self.memory), [1.0] * self.memory)

    def _constants(self, count: int) -> list[float]:
        return np.tile(self.centre, count // len(self.centre)).tolist()

    @cached_property
    def memory_rows(self) -> np.ndarray:
        """Rows of the dynamics for s over the uncentred monomials, (n_s, ·): s⁺ = a s + (1 − a) u, or a shift."""
        monomials, m, n = self.uncentred[0], self.samples.input_dim, self.n
        place = {factors: k for k, factors in enumerate(monomials.factors)}
        rows = np.zeros((self.memory, len(monomials)))
        share = 1.0 - float(self.specification.memory[1]) if self.specification.pole else 1.0
        for j in range(self.memory):
            if j < m:
                rows[j, place[n + self.memory + j,]] = share / self.samples.input_scale[j]
            else:
                rows[j, place[n + j - m,]] = 1.0
            if self.specification.pole:
                rows[j, place[n + j,]] = 1.0 - share
        return rows

    @cached_property
    def structure(self) -> Structure:
        order = self._order()
        chart = Monomials(len(order), [(), *((k,) for k in range(len(order)))])
        return Structure(chart, order, self.uncentred_outputs[0] if self.regressed else self._exact_outputs,
                         self.uncentred[0], "map", saturated=True)

    @property
    def regressed(self) -> bool:
        """Whether the outputs are regressed on the states. Otherwise some of the states are the outputs."""
        return self.specification.chart != "delay"

    @cached_property
    def _exact_outputs(self) -> Monomials:
        return Monomials(self.n + self.memory, [(k,) for k in range(self.latent_dim)])

    def _order(self) -> tuple[int, ...]:
        """Entries of [window, past inputs] that the chart uses: the newest d + 1 samples, then the past inputs."""
        window, inputs = (self.delays + 1) * self.latent_dim, self.delays * self.samples.input_dim
        first = (self.delays - self.specification.delays) * self.latent_dim
        return (*range(first, window), *range(window, window + inputs))

    def chart_table(self, V: np.ndarray) -> np.ndarray:
        """The chart's table over [1, ξ / scale, u / input_scale], (n + n_s, 1 + number of these values)."""
        chosen, m = self.specification, self.samples.input_dim
        d, D, window = chosen.delays, self.delays, (chosen.delays + 1) * self.latent_dim
        table = np.zeros((self.n + self.memory, 1 + window + D * m))
        of_inputs = V[:, 1 + window:]
        table[:self.n, :1 + window] = V[:, :1 + window]
        table[:self.n, 0] -= of_inputs @ np.tile(self.centre, d)
        table[:self.n, 1 + window + (D - d) * m:] = of_inputs
        table[self.n:, 1 + window:] = np.kron(chosen.memory_weights(D), np.eye(m))
        return table

    def model(self, chart: Chart, theta: np.ndarray, psi: np.ndarray | None, largest: np.ndarray) -> PolynomialModel:
        """The model in SI units. theta (k, F), psi (p', ·): solutions over centred monomials; largest: the largest |z|
        of the training, (n,).
        """
        samples, m = self.samples, self.samples.input_dim
        monomials, change = self.uncentred
        slow = chart.E @ theta @ change
        place = {factors: k for k, factors in enumerate(monomials.factors)}
        slow[:, [place[k,] for k in range(self.n)]] += chart.L
        if self.regressed:
            parametrization = samples.scale * psi @ self.uncentred_outputs[1]
        else:
            parametrization = samples.scale * chart.exact[:, :self.latent_dim]
        D = self.delays
        seen = np.concatenate([np.full((self.specification.delays + 1) * self.latent_dim, samples.scale),
                               np.tile(samples.input_scale, D)])
        highest = np.abs(samples.u / samples.input_scale).max(0)
        return PolynomialModel(
            structure=self.structure, chart=self.chart_table(chart.V), parametrization=parametrization,
            dynamics=np.concatenate([slow, self.memory_rows]), window_scale=seen,
            state_scale=np.concatenate([largest, np.tile(highest, self.memory // m)]),
            coordinates=samples.coordinates[self.specification.coordinates], reach=REACH, input_dim=m,
            output_dim=samples.output_dim, delays=D, timestep=samples.timestep, window_timestep=samples.timestep,
            base_timestep=samples.timestep)


def _values(monomials: Monomials, joint: np.ndarray) -> np.ndarray:
    """Monomials (R, F) of points (R, variables). They are computed as rows, because rows multiply faster."""
    return monomials.chosen_rows(monomials.rows(np.ascontiguousarray(joint.T))).T


def uncentred(centred: Monomials, n: int, constants: list[float], scales: list[float]) -> tuple[Monomials, np.ndarray]:
    """For monomials in x̃_j = x_j / scale_j − constant_j (j ≥ n): the monomials in x, and the matrix between both."""
    columns: dict[tuple, int] = {}
    entries: list[tuple[int, int, float]] = []
    for row, factors in enumerate(centred.factors):
        moved = [k for k, factor in enumerate(factors) if factor >= n]
        for count in range(len(moved) + 1):
            for dropped in combinations(moved, count):
                value = 1.0
                for k in moved:
                    j = factors[k] - n
                    value *= -constants[j] if k in dropped else 1.0 / scales[j]
                kept = tuple(factor for k, factor in enumerate(factors) if k not in dropped)
                entries.append((row, columns.setdefault(kept, len(columns)), value))
    matrix = np.zeros((len(centred), len(columns)))
    for row, column, value in entries:
        matrix[row, column] += value
    return Monomials(centred.variables, columns), matrix
