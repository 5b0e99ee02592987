"""Closed-form fits of SSMR, SSSR and the control-augmented SSMR for all folds: a chart, then one regression.

The chart and the parametrization are computed from decays, which no fold holds out. For the control-augmented model
they are computed from all rows. The folds therefore differ only in the dynamics.
"""

from __future__ import annotations

from functools import cached_property

import numpy as np

from ssmr_torch.data.derivatives import central_difference, savitzky_golay
from ssmr_torch.models.named_structures import control_augmented_structure, ssm_structure
from ssmr_torch.models.polynomial import PolynomialModel
from ssmr_torch.selection.baseline import Baseline
from ssmr_torch.selection.charts import future_inputs, leading_directions
from ssmr_torch.selection.folds_and_starts import FOLDS, Samples
from ssmr_torch.selection.least_squares import Moments, by_fold

DEGREES = {"ssmr": 2, "sssr": 1}
FUTURE = 10           # number of samples that the control-augmented chart must predict
MANIFOLD_RIDGE = 1e-9


class ManifoldForm:
    """Base class of both kinds: scaled windows of the samples, and models for any ridge and fold.

    Raises ValueError if the window holds fewer values than states.
    """

    ahead = 1

    def __init__(self, samples: Samples, baseline: Baseline):
        self.samples, self.baseline = samples, baseline
        self.chi = samples.coordinates[baseline.coordinates]
        self.latent = samples.latent(baseline.coordinates)
        self.seen = (baseline.delays + 1) * self.latent.shape[1] + baseline.input_delays * samples.input_dim
        if self.seen < baseline.states:
            raise ValueError(f"{baseline.states} states, but a window has only {self.seen} values")
        self.rows = samples.rows(self.ahead, baseline.decays)

    def windows(self, at: np.ndarray) -> np.ndarray:
        """Scaled windows that end at samples `at`, flattened oldest first, (R, (d + 1) p')."""
        return self.latent[at[:, None] + np.arange(-self.baseline.delays, 1)].reshape(len(at), -1)

    def model(self, ridge: float, fold: int = FOLDS) -> PolynomialModel:
        """The model, in SI units, fitted to the rows that the fold does not hold out; by default to all rows."""
        moments, largest = self.moments
        baseline, samples = self.baseline, self.samples
        return PolynomialModel(
            structure=self.structure, chart=self.chart, parametrization=samples.scale * self.parametrization,
            dynamics=moments[fold].solution(ridge), window_scale=self.window_scale, state_scale=largest,
            coordinates=self.chi, input_dim=samples.input_dim, output_dim=samples.output_dim, delays=baseline.delays,
            timestep=samples.timestep, window_timestep=samples.timestep, **self.further)


class SubmanifoldForm(ManifoldForm):
    """z = Vᵀ ŷ,  ŷ = V z + W z^{2:n_w},  dz/dt = R z^{1:n_r} + (B + z ⊗ B_r) u;  V: leading directions of the decays.

    The rates are central differences or derivatives of a local polynomial. The input is its mean over their samples.
    """

    further = {"substeps": 2}

    def __init__(self, samples: Samples, baseline: Baseline):
        self.stencil = savitzky_golay() if baseline.smoothed else central_difference(6)
        self.ahead = self.stencil.half_width
        super().__init__(samples, baseline)
        degree, n = DEGREES[baseline.kind], baseline.states
        self.structure = ssm_structure(n, samples.input_dim, self.seen, parametrization_degree=degree,
                                       dynamics_degree=degree, control_degree=1, chart_degree=1)
        self.window_scale = np.full(self.seen, samples.scale)
        rows = samples.rows(0, True)
        decays = rows[samples.is_decay[rows]]
        self._shown = self.windows(decays if len(decays) else rows)

    @cached_property
    def chart(self) -> np.ndarray:
        return leading_directions(self._shown.T @ self._shown, self.baseline.states)

    @cached_property
    def parametrization(self) -> np.ndarray:
        z = self._shown @ self.chart.T
        table = np.zeros((self.seen, len(self.structure.parametrization)))
        table[:, :self.baseline.states] = self.chart.T
        if table.shape[1] > self.baseline.states and self.seen > self.baseline.states:
            rest = self._shown - z @ self.chart
            table += Moments.of(self.structure.parametrization(z), rest).solution(MANIFOLD_RIDGE)
        return table

    @cached_property
    def moments(self) -> tuple[list[Moments], np.ndarray]:
        """Moments of the monomials and the rates, for each fold and for all rows; and the largest |z|."""
        samples, width = self.samples, self.stencil.half_width
        around = range(-width, width + 1)
        z = np.stack([self.windows(self.rows + shift) @ self.chart.T for shift in around])
        felt = self.stencil.held_input(np.stack([samples.u[self.rows + shift] for shift in around]))[0]
        X = self.structure.dynamics(np.concatenate([z[width], felt], axis=1))
        rates = self.stencil(z, samples.timestep)[0]
        return list(by_fold(X, rates, samples.touching(self.rows, self.ahead))), np.abs(z[width]).max(0)


class ControlAugmentedForm(ManifoldForm):
    """z = V [ŷ, û],  y = W z,  z⁺ = z + h R (z, u)^{1:2}, at most linear in u.

    V: the directions of the past that explain most of the next samples, a projection along the inputs between them.
    """

    further: dict = {}

    def __init__(self, samples: Samples, baseline: Baseline):
        super().__init__(samples, baseline)
        held = baseline.delays * samples.input_dim
        self.structure = control_augmented_structure(
            baseline.states, samples.input_dim, self.seen - held, held, parametrization_degree=1, dynamics_degree=2,
            input_degree=1, state_degree=None, saturated=True)
        self.window_scale = np.concatenate([np.full(self.seen - held, samples.scale),
                                            np.tile(samples.input_scale, baseline.delays)])

    def _past(self, at: np.ndarray) -> np.ndarray:
        held = self.samples.u[at[:, None] + np.arange(-self.baseline.delays, 0)] / self.samples.input_scale
        return np.concatenate([self.windows(at), held.reshape(len(at), -1)], axis=1)

    @cached_property
    def chart(self) -> np.ndarray:
        samples = self.samples
        rows = samples.rows(FUTURE, self.baseline.decays)
        past = self._past(rows)
        told = self.latent[rows[:, None] + np.arange(FUTURE + 1)].reshape(len(rows), -1)
        X = np.concatenate([past, future_inputs(samples, FUTURE, rows), np.ones((len(rows), 1))], axis=1)
        explained = Moments.of(X, told).solution(MANIFOLD_RIDGE)[:, :past.shape[1]]
        spread = past.T @ past / len(past)
        V = leading_directions(explained @ spread @ explained.T, self.baseline.states) @ explained
        return V / np.sqrt(np.einsum("ij,jk,ik->i", V, spread, V))[:, None]

    @cached_property
    def parametrization(self) -> np.ndarray:
        return Moments.of(self._past(self.rows) @ self.chart.T, self.latent[self.rows]).solution(MANIFOLD_RIDGE)

    @cached_property
    def moments(self) -> tuple[list[Moments], np.ndarray]:
        """Moments of the monomials and the steps, for each fold and for all rows; and the largest |z|."""
        samples = self.samples
        here, ahead = (self._past(self.rows + shift) @ self.chart.T for shift in (0, 1))
        X = self.structure.dynamics(np.concatenate([here, samples.u[self.rows]], axis=1))
        rates = (ahead - here) / samples.timestep
        return list(by_fold(X, rates, samples.touching(self.rows, 1))), np.abs(here).max(0)
