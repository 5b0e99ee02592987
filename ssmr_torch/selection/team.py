"""Team of models: chooses the models that are averaged, and builds their average as one model."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ssmr_torch.models.monomials import Monomials
from ssmr_torch.models.output_coordinates import Identity, Mixture
from ssmr_torch.models.polynomial import PolynomialModel
from ssmr_torch.models.structure import Structure
from ssmr_torch.selection.folds_and_starts import FOLDS
from ssmr_torch.selection.specification import Specification
from ssmr_torch.selection.trial import Outcome, Trial

LARGEST, GAIN = 4, 0.01   # largest number of members; smallest decrease of the score for a further member


def choose_team(trial: Trial, pool: Sequence[Specification], largest: int = LARGEST) -> list[Specification]:
    """The best of a pool, and then, one by one, the member that lowers the score of the averaged prediction most."""
    team = list(pool[:1])
    while team and len(team) < min(largest, len(pool)):
        scores = {each: averaged(trial, [*team, each]).score for each in pool if each not in team}
        best = min(scores, key=lambda each: (scores[each], str(each)))
        if scores[best] > averaged(trial, team).score - GAIN:
            break
        team.append(best)
    return team


def averaged(trial: Trial, team: Sequence[Specification]) -> Outcome:
    """The outcome of the mean of the members' predictions."""
    members = [trial.outcomes[each].predictions for each in team]
    return trial.judged([np.mean([member[k] for member in members], axis=0) for k in range(2 * FOLDS)])


def merged(models: Sequence[PolynomialModel]) -> PolynomialModel:
    """One model with the states of all models, whose output is the mean of their outputs. Their output coordinates may
    differ.

    All models must be maps with the same sampling time, with saturated terms and the same reach.
    """
    if len(models) == 1:
        return models[0]
    joint = _Joint(models)
    state = np.concatenate([model.state_scale for model in models])
    return PolynomialModel(
        structure=Structure(joint.chart, joint.order, joint.outputs, joint.flow, "map", saturated=True),
        chart=joint.chart_table, parametrization=joint.output_table, dynamics=joint.flow_table,
        window_scale=joint.window_scale, state_scale=state, coordinates=joint.coordinates, reach=models[0].reach,
        input_dim=joint.m, output_dim=joint.p, delays=joint.delays, timestep=models[0].timestep,
        window_timestep=models[0].window_timestep, base_timestep=models[0].base_timestep)


class _Joint:
    """The tables of several models side by side."""

    def __init__(self, models: Sequence[PolynomialModel]):
        self.models, self.m, self.p = models, models[0].input_dim, models[0].output_dim
        self.delays = max(model.delays for model in models)
        self.first = np.concatenate([[0], np.cumsum([model.state_dim for model in models])])
        self.n = int(self.first[-1])
        self.kinds = list(dict.fromkeys(model.coordinates for model in models))
        self.widths = [self.p if kind is None else kind.latent(self.p) for kind in self.kinds]
        self.offsets = np.concatenate([[0], np.cumsum(self.widths)])
        self.count = [sum(model.coordinates == kind for model in models) for kind in self.kinds]
        self._flow()
        self._chart()
        self._outputs()

    @property
    def coordinates(self):
        if len(self.kinds) == 1:
            return self.kinds[0]
        parts = tuple(Identity(self.p) if kind is None else kind for kind in self.kinds)
        return Mixture(parts, tuple(count / len(self.models) for count in self.count), self.p)

    def _flow(self) -> None:
        """Dynamics over [x_1, x_2, …, u]."""
        entries: dict[tuple, list] = {}
        for model, first in zip(self.models, self.first):
            own = model.state_dim
            for column, factors in enumerate(model.structure.dynamics.factors):
                moved = tuple(first + f if f < own else self.n + f - own for f in factors)
                entries.setdefault(moved, []).append((int(first), model.dynamics[:, column]))
        self.flow, self.flow_table = _table(self.n + self.m, self.n, entries)

    def _chart(self) -> None:
        """Chart over the entries that any member uses, each divided by that member's scale."""
        width, latent = int(self.offsets[-1]), []
        for model in self.models:
            own = model.latent_dim
            of_kind = int(self.offsets[self.kinds.index(model.coordinates)])
            window = (model.delays + 1) * own
            for place in model.structure.window_order:
                if place < window:
                    sample, column = divmod(place, own)
                    latent.append((self.delays - model.delays + sample) * width + of_kind + column)
                else:
                    latent.append((self.delays + 1) * width + (self.delays - model.delays) * self.m + place - window)
        self.order, where = np.unique(latent, return_inverse=True)
        scales = np.concatenate([model.window_scale for model in self.models])
        self.window_scale = np.ones(len(self.order))
        self.order = tuple(self.order.tolist())
        self.chart = Monomials(len(self.order), [(), *((k,) for k in range(len(self.order)))])
        self.chart_table, first = np.zeros((self.n, 1 + len(self.order))), 0
        for model, row in zip(self.models, self.first):
            count = len(model.structure.window_order)
            rows = slice(row, row + model.state_dim)
            self.chart_table[rows, 0] = model.chart[:, 0]
            columns = 1 + where[first:first + count]
            self.chart_table[rows, columns] = model.chart[:, 1:] / scales[first:first + count]
            first += count

    def _outputs(self) -> None:
        entries: dict[tuple, list] = {}
        for model, first in zip(self.models, self.first):
            kind = self.kinds.index(model.coordinates)
            for column, factors in enumerate(model.structure.parametrization.factors):
                entries.setdefault(tuple(int(first) + f for f in factors), []).append(
                    (int(self.offsets[kind]), model.parametrization[:, column] / self.count[kind]))
        self.outputs, self.output_table = _table(self.n, int(self.offsets[-1]), entries)


def _table(variables: int, rows: int, entries: dict[tuple, list]) -> tuple[Monomials, np.ndarray]:
    table = np.zeros((rows, len(entries)))
    for column, parts in enumerate(entries.values()):
        for first, values in parts:
            table[first:first + len(values), column] += values
    return Monomials(variables, entries), table


def stable_pool(trial: Trial, ranked: Sequence[Specification], count: int) -> tuple[list, list]:
    """The first `count` ranked specifications whose model of all data stays bounded, and those that were refused."""
    kept, refused = [], []
    for each in ranked:
        if len(kept) == count:
            break
        (kept if trial.bounded(each) else refused).append(each)
    return kept, refused
