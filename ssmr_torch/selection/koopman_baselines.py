"""Closed-form fits of Koopman models for all folds: one ridge regression of the new entries of the next window."""

from __future__ import annotations

from dataclasses import replace
from functools import cached_property
from typing import NamedTuple

import numpy as np

from ssmr_torch.models.named_structures import koopman_structure
from ssmr_torch.models.polynomial import PolynomialModel
from ssmr_torch.selection.baseline import Baseline
from ssmr_torch.selection.features import LARGEST
from ssmr_torch.selection.folds_and_starts import FOLDS, Samples
from ssmr_torch.selection.least_squares import Moments, by_fold


class Lifting(NamedTuple):
    """Options in which the kinds of Koopman models differ, see `models.koopman.Koopman`."""

    degree: int = 1
    bilinear: bool = False
    relift: bool = False
    constant: bool = True


LIFTINGS = {"dmd": Lifting(), "edmd": Lifting(2), "edmd_relift": Lifting(2, relift=True),
            "edmd_bilinear": Lifting(bilinear=True), "static_pregain": Lifting(constant=False)}


class KoopmanForm:
    """z = ψ(ζ / scale),  z⁺ = A z + B u + Σ_j u_j N_j z, for windows in output coordinates; see `model(ridge, fold)`.

    Known rows of z⁺ are set without regression: the constant, and the delayed samples and inputs in ζ.
    Raises ValueError if the lifting has too many monomials for a regression, or if the data have too few rows.
    """

    def __init__(self, samples: Samples, baseline: Baseline):
        self.samples, self.lifting = samples, LIFTINGS[baseline.kind]
        chi, m = samples.coordinates[baseline.coordinates], samples.input_dim
        latent = samples.output_dim if chi is None else chi.latent(samples.output_dim)
        degree, bilinear, relift, constant = self.lifting
        window = (baseline.delays + 1) * latent + baseline.input_delays * m
        size = 1 + window + (window * (window + 1) // 2 if degree > 1 else 0)
        if size * (1 + m * bilinear) > LARGEST:
            raise ValueError(f"{size * (1 + m * bilinear)} regressors for {baseline}; at most {LARGEST} are possible")
        structure = koopman_structure(m, latent, baseline.delays, input_delays=baseline.input_delays, degree=degree,
                                      constant=constant, bilinear=bilinear, relift=relift)
        n, self.first = len(structure.chart), int(constant)
        self.rows = samples.rows(1, baseline.decays)
        self.blank = PolynomialModel(
            structure=structure, chart=np.zeros((0, n)), parametrization=np.eye(latent),
            dynamics=np.zeros((structure.chart.variables if relift else n, len(structure.dynamics))),
            state_scale=np.ones(n), window_scale=np.ones(structure.chart.variables), coordinates=chi, input_dim=m,
            output_dim=samples.output_dim, delays=baseline.delays, timestep=samples.timestep,
            window_timestep=samples.timestep)

    def _observables(self, model: PolynomialModel, shift: int) -> np.ndarray:
        at, d = self.rows[:, None] + shift, model.delays
        return model.observables(self.samples.y[at + np.arange(-d, 1)], self.samples.u[at + np.arange(-d, 0)])

    @cached_property
    def scaled(self) -> PolynomialModel:
        """The model with the root mean square of each observable, by which ζ is divided."""
        rms = np.sqrt(np.mean(self._observables(self.blank, 0) ** 2, axis=0))
        scale = np.where(rms > 0, rms, 1.0)
        return replace(self.blank, window_scale=scale, parametrization=np.diag(scale[:self.blank.latent_dim]))

    @cached_property
    def moments(self) -> tuple[list[Moments], np.ndarray]:
        """Moments of the unknown rows of z⁺, for each fold and for all rows; and the largest |z|."""
        model, lift = self.scaled, self.blank.structure.chart
        here, ahead = lift(self._observables(model, 0)), self._observables(model, 1)
        X = model.dynamics_regressors(here, self.samples.u[self.rows])
        T = (ahead if self.lifting.relift else lift(ahead))[:, self.unknown]
        return list(by_fold(X, T, self.samples.touching(self.rows, 1))), np.abs(here).max(0)

    @cached_property
    def _shift(self) -> int:
        """Number of rows of the dynamics before the newest sample."""
        return 0 if self.lifting.relift else self.first

    @cached_property
    def unknown(self) -> np.ndarray:
        """Rows of the dynamics that are regressed: the newest sample, and monomials of higher degree."""
        rows, latent = np.arange(len(self.blank.dynamics)), self.blank.latent_dim
        newest = (rows >= self._shift) & (rows < self._shift + latent)
        return np.flatnonzero(newest | (rows >= self._shift + self.blank.structure.chart.variables))

    def model(self, ridge: float, fold: int = FOLDS) -> PolynomialModel:
        """The model, in SI units, fitted to the rows that the fold does not hold out; by default to all rows."""
        moments, largest = self.moments
        dynamics = self._known()
        dynamics[self.unknown] = moments[fold].solution(ridge)
        return replace(self.scaled, dynamics=dynamics, state_scale=largest)

    def _known(self) -> np.ndarray:
        """The table with the rows that need no data: 1⁺ = 1, and the delayed samples and inputs."""
        model = self.scaled
        latent, m, scale = model.latent_dim, model.input_dim, model.window_scale
        table, outputs = np.zeros(model.dynamics.shape), (model.delays + 1) * latent
        if self._shift:
            table[0, 0] = 1.0
        for row in range(latent, len(scale)):
            if outputs <= row < outputs + m:
                table[self._shift + row, model.state_dim + row - outputs] = 1.0 / scale[row]
            else:
                source = row - (latent if row < outputs else m)
                table[self._shift + row, self.first + source] = scale[source] / scale[row]
        return table
