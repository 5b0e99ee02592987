"""Closed-form fit of a specification: charts, regressors and their moments by fold, and models for any ridge."""

from __future__ import annotations

from functools import cached_property

import numpy as np

from ssmr_torch.models.polynomial import PolynomialModel
from ssmr_torch.selection.assembly import Assembly
from ssmr_torch.selection.charts import (
    Chart,
    delay_chart,
    future_inputs,
    past_of,
    predictive_chart,
    predictive_targets,
    tangent_chart,
)
from ssmr_torch.selection.features import flow_monomials
from ssmr_torch.selection.folds_and_starts import FOLDS, Samples
from ssmr_torch.selection.least_squares import Moments, by_fold
from ssmr_torch.selection.specification import Specification

LINEAR_RIDGE = 1e-9
ALL = FOLDS  # index of the model that is fitted to all folds


class ClosedForm:
    """The common parts of specifications that differ only in ridge; `model(ridge, fold)` gives a model.

    samples: the runs; noise: standard deviation of the measurement noise, m.
    Raises ValueError for a specification that the data cannot determine.
    """

    def __init__(self, samples: Samples, specification: Specification, noise: float = 0.0):
        self.samples, self.specification, self.noise = samples, specification, noise
        self.latent_dim = samples.latent(specification.coordinates).shape[1]
        self.rows = samples.rows(1, specification.decays)
        self.touching = samples.touching(self.rows, 1)
        if len(self.rows) < 50:
            raise ValueError(f"only {len(self.rows)} samples have {samples.past} samples before them in their run; "
                             "record longer runs")

    @cached_property
    def charts(self) -> list[Chart]:
        """One chart per fold, then one for all rows. They are the same object if the chart does not depend on the rows.
        """
        chosen, samples = self.specification, self.samples
        d, p, m = chosen.delays, self.latent_dim, samples.input_dim
        if chosen.chart == "delay":
            newest = samples.latent(chosen.coordinates)[self.rows]
            directions = np.linalg.eigh(newest.T @ newest)[1][:, ::-1].T
            return [delay_chart(d, directions, m)] * (FOLDS + 1)
        window, newest = slice(1, 1 + (d + 1) * p), slice(1 + d * p, 1 + (d + 1) * p)
        if chosen.states > (d + 1) * p:
            raise ValueError(f"{chosen.states} states, but a window has only {(d + 1) * p} values")
        if chosen.chart == "tangent_space":
            of_decays = self.rows[samples.is_decay[self.rows]]
            if not len(of_decays):
                raise ValueError("the chart tangent_space needs decays, but there are none")
            decays, past = past_of(samples, chosen.coordinates, d, of_decays), self.pasts[0]
            chart = tangent_chart(decays.T @ decays / len(decays), past.T @ past / len(past), window, newest,
                                  chosen.states)
            return [chart] * (FOLDS + 1)
        rows = samples.rows(chosen.future, chosen.decays)
        past = past_of(samples, chosen.coordinates, d, rows)
        X = np.concatenate([past, future_inputs(samples, chosen.future, rows)], axis=1)
        T = predictive_targets(samples, chosen, rows, self.noise)
        if chosen.states > min(T.shape[1], past.shape[1]):
            raise ValueError(f"{chosen.states} states, but the chart has only {T.shape[1]} values to predict")
        return [predictive_chart(moments, past.shape[1], newest, chosen.states)
                for moments in by_fold(X, T, samples.touching(rows, chosen.future))]

    @cached_property
    def assembly(self) -> Assembly:
        chosen, chart = self.specification, self.charts[ALL]
        leading = min(chosen.leading or chart.leading, chart.leading)
        follows = (chart.leading - leading) + chart.follows if chosen.chart != "delay" else self.latent_dim
        n, m = len(chart.V), self.samples.input_dim
        memory = m if chosen.pole else m * int(chosen.memory[1])
        linear, beyond = flow_monomials(chosen.features, slow=n, leading=leading, follows=follows, memory=memory,
                                        inputs=m, pole=chosen.pole)
        return Assembly(self.samples, chosen, n, self.latent_dim, memory, linear, beyond)

    @cached_property
    def memory(self) -> np.ndarray:
        """s̃ of the rows, centred and scaled, (R, n_s)."""
        samples, chosen = self.samples, self.specification
        past = (samples.u[self.rows[:, None] + np.arange(-samples.past, 0)] - samples.input_mean) / samples.input_scale
        return np.einsum("rkm,jk->rjm", past, chosen.memory_weights(samples.past)).reshape(len(self.rows), -1)

    @cached_property
    def pasts(self) -> list[np.ndarray]:
        """[1, window, past inputs] for the rows, and for the samples one step later."""
        chosen = self.specification
        return [past_of(self.samples, chosen.coordinates, chosen.delays, self.rows + k) for k in (0, 1)]

    @cached_property
    def moments(self) -> list[tuple[Moments, Moments | None, np.ndarray]]:
        """Moments of the flow map and of the outputs, and the largest |z|: for each fold, then for all rows."""
        shared = self.charts[0] is self.charts[ALL]
        found = self._moments_of_one_chart() if shared else self._moments_of_each_chart()
        del self.pasts  # these are the largest arrays here, and they are no longer needed
        return found

    def _moments_of_one_chart(self) -> list[tuple[Moments, Moments | None, np.ndarray]]:
        X, T, psi, xi, largest = self._regressors(self.charts[ALL])
        outputs = [None] * (FOLDS + 1) if psi is None else by_fold(psi, xi, self.touching)
        return [(flow, output, largest) for flow, output in zip(by_fold(X, T, self.touching), outputs)]

    def _moments_of_each_chart(self) -> list[tuple[Moments, Moments | None, np.ndarray]]:
        found = []
        for fold, chart in enumerate(self.charts):
            keep = slice(None) if fold == ALL else ~self.touching[fold]
            X, T, psi, xi, largest = self._regressors(chart)
            found.append((Moments.of(X[keep], T[keep]), Moments.of(psi[keep], xi[keep]), largest))
        return found

    def _regressors(self, chart: Chart):
        samples, chosen, assembly = self.samples, self.specification, self.assembly
        here, ahead = (past @ chart.V.T for past in self.pasts)
        inputs = (samples.u[self.rows] - samples.input_mean) / samples.input_scale
        X = assembly.regressors(np.concatenate([here, self.memory, inputs], axis=1))
        T = (ahead - here @ chart.L.T) @ np.linalg.pinv(chart.E).T
        psi = xi = None
        if chart.exact is None:
            psi = assembly.outputs(np.concatenate([here, self.memory], axis=1))
            xi = samples.latent(chosen.coordinates)[self.rows]
        return X, T, psi, xi, np.abs(here).max(0)

    def model(self, ridge: float, fold: int = ALL) -> PolynomialModel:
        """The model, in SI units, fitted to all rows that the fold does not hold out."""
        chart, assembly = self.charts[fold], self.assembly
        flow, outputs, largest = self.moments[fold]
        penalty = np.full(len(assembly.linear) + len(assembly.beyond), ridge)
        penalty[:len(assembly.linear)] = LINEAR_RIDGE
        theta = flow.solution(penalty)
        psi = None if outputs is None else outputs.solution(LINEAR_RIDGE)
        return assembly.model(chart, theta, psi, largest)
