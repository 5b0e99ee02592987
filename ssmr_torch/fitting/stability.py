"""Stability guard: keeps the linear part of a model stable and its rollouts on the training set within the range."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from math import exp
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor
from torch.nn.utils.rnn import pad_sequence

from ssmr_torch.checked_arguments import checked
from ssmr_torch.data.windows import RolloutBatch, RolloutDataset
from ssmr_torch.fitting.lightning_fit import ModelFit
from ssmr_torch.fitting.rollout_sensitivities import dynamics_tables
from ssmr_torch.models.batch_rollout import BatchRollout, batch_of
from ssmr_torch.models.integrators import DIVERGENCE_FACTOR
from ssmr_torch.models.torch_model import TorchModel
from ssmr_torch.quantities import GUARD

HALVINGS = 12


class Recorded(NamedTuple):
    """Rollouts of the training set: window (N, n_d + 1, p), inputs held in it (N, n_d, m), padded inputs (N, H, m), and
    lengths (N,).
    """

    window: np.ndarray
    held: np.ndarray
    inputs: np.ndarray
    lengths: np.ndarray


class StabilityGuard:
    """Tests whether the rollouts of a polynomial model stay bounded, and repairs the model if they do not.

    A model passes ("holds") if two conditions are true. (1) The linear part R₁ of its reduced dynamics is stable:
    Re λ ≤ −margin for every eigenvalue, in discrete time |1 + h λ| ≤ e^{−margin h}. (2) No rollout of the training set
    under its recorded inputs leaves `reach` times the range of the training states: neither a rollout over the full
    length of a trajectory, nor one of `horizon` s from any of `starts` random samples, which need not be on the
    manifold. All rollouts are repeated with the recorded inputs multiplied by `overdrive`, because a controller may
    command more than the training inputs.

    trajectories: the training runs. transient: s cut from the start of each decay. margin: 1/s. reach: smaller than
    `DIVERGENCE_FACTOR`, by which rollouts are judged later, so that unseen runs have a margin. For a saturated model,
    whose rollouts cannot grow without limit, reach is that factor, and only the recorded inputs are used.
    Raises ValueError for a model without coefficient tables, or for one that was not fitted yet.
    """

    def __init__(self, trajectories: Sequence, *, transient: float = 0.0, margin: float = 0.05, reach: float = 3.0,
                 overdrive: float = 1.25, horizon: float = 1.0, starts: int = 1000):
        if not (margin >= 0 and reach > 1 and overdrive >= 1):
            raise ValueError(f"margin {margin} 1/s, reach {reach} and overdrive {overdrive}; expected margin ≥ 0, "
                             "reach > 1 and overdrive ≥ 1")
        self.trajectories = tuple(_settled(run, transient) for run in trajectories if run.kind != "static")
        self.margin, self.reach, self.overdrive = float(margin), float(reach), float(overdrive)
        self.horizon, self.starts = float(horizon), int(starts)
        self._recorded: dict[int, tuple[list[Recorded], list[Recorded]]] = {}

    def holds(self, model: TorchModel) -> bool:
        """Whether the linear part is stable and no training rollout diverges."""
        return bool((self._excess(model) <= 1e-9).all()) and not self.diverges(model)

    @torch.no_grad()
    def diverges(self, model: TorchModel) -> bool:
        """Whether any full-length rollout of a training trajectory leaves the range."""
        return any(left > 0 for left in self._leaving(model, at_most=1))

    @torch.no_grad()
    def diverging(self, model: TorchModel) -> float:
        """Share of the rollouts from samples that leave the range, plus that share of the full-length rollouts. It is 0
        only if no rollout leaves the range.
        """
        return sum(self._leaving(model))

    def _leaving(self, model, at_most: int | None = None) -> Iterator[float]:
        """Share of the rollouts from samples that leave the range, then that share of the full-length rollouts."""
        bounded, batch = model.structure.saturated, batch_of(model)
        bound = batch.model.divergence_bound
        bound = bound if bounded else bound * self.reach / DIVERGENCE_FACTOR
        if not np.isfinite(bound):
            raise ValueError("this model was not fitted yet, so the range of its training states is not known; use the "
                             "stability guard after the closed-form fit")
        factors = (1.0,) if bounded or self.overdrive == 1 else (1.0, self.overdrive)
        for runs in self._of_delays(model.delays):
            yield (self._left(batch, runs, factors, float(bound), at_most)
                   / (len(factors) * sum(len(run.inputs) for run in runs)))

    @staticmethod
    def _left(batch: BatchRollout, runs: list[Recorded], factors: tuple[float, ...], bound: float,
              at_most: int | None) -> int:
        """Number of rollouts that leave the bound, with inputs multiplied by each factor; counting stops at `at_most`.
        """
        left = 0
        for run in runs:
            states = batch.model.encode(run.window, run.held)
            driven = np.concatenate([factor * run.inputs for factor in factors])
            states, lengths = (np.concatenate([part] * len(factors)) for part in (states, run.lengths))
            left += int(batch.diverged(states, driven, lengths=lengths, bound=bound).sum())
            if at_most is not None and left >= at_most:
                break
        return left

    def _of_delays(self, delays: int) -> tuple[list[Recorded], list[Recorded]]:
        """Rollouts of `horizon` s from random starts, and of every trajectory from its first window to its end, longest
        first.
        """
        if delays not in self._recorded:
            whole = sorted((RolloutDataset([run], delays=delays, horizon=run.length - delays - 1)[0]
                            for run in self.trajectories if run.length > delays + 1), key=lambda run: -len(run.inputs))
            samples = max(round(self.horizon / self.trajectories[0].timestep), 1)
            drawn = RolloutDataset(self.trajectories, delays=delays, horizon=min(samples, len(whole[0].inputs)),
                                   starts=self.starts)
            self._recorded[delays] = ([_recorded([drawn[index] for index in range(len(drawn))])],
                                      [_recorded(group) for group in _of_like_length(whole)])
        return self._recorded[delays]

    @torch.no_grad()
    def enforce(self, model: TorchModel) -> dict[str, float]:
        """Repair the model with the smallest changes of two kinds. Returns {what: how much}, empty if nothing changed.

        Eigenvalues beyond the margin are moved onto it; their frequencies and eigenvectors stay. Then all nonlinear
        terms are multiplied by the largest factor of ½, ¼, …, 0 for which no rollout diverges.
        """
        moved = self.stabilize(model)
        found = {"eigenvalues moved": float(moved)} if moved else {}
        if not self.diverges(model):
            return found
        tables = dynamics_tables(model)
        whole = [table.clone() for table in tables]
        for factor in (*(0.5**k for k in range(1, HALVINGS)), 0.0):
            for table, before, linear in zip(tables, whole, _linear_columns(model)):
                table.copy_(torch.where(linear, before, factor * before))
            if not self.diverges(model):
                break
        return found | {"nonlinear terms multiplied by": factor}

    def _excess(self, model: TorchModel) -> Tensor:
        """(n,), 1/s, by how much Re λ of the linear part, in continuous time, exceeds −margin."""
        return torch.as_tensor(model.reduced.rates.real) + self.margin

    @torch.no_grad()
    def stabilize(self, model: TorchModel) -> int:
        """Move eigenvalues of the linear part beyond the margin onto it. Returns their number."""
        beyond = int((self._excess(model) > 1e-9).sum())
        if beyond:
            eigenvalues, vectors = torch.linalg.eig(model.reduced.linear_part)
            moved = self._moved(model, eigenvalues)
            _put_linear_part(model, torch.linalg.solve(vectors.mT, (vectors * moved).mT).mT.real)
        return beyond

    def _moved(self, model: TorchModel, eigenvalues: Tensor) -> Tensor:
        """The eigenvalues, with those beyond the margin moved onto it; their frequencies stay."""
        if model.reduced.flow:
            return torch.complex(torch.clamp(eigenvalues.real, max=-self.margin), eigenvalues.imag)
        offset, h = _of_steps(model)
        factors = offset + h * eigenvalues
        largest = exp(-self.margin * model.base_timestep)
        return (factors * torch.clamp(largest / factors.abs().clamp_min(1e-300), max=1.0) - offset) / h


class GuardFit(ModelFit):
    """Repairs a fitted polynomial model by its `StabilityGuard`; `repairs` names the changes.

    It takes one epoch without training. The validation after it scores the repaired model.
    """

    epochs, starts, kept = 1, 1, ("repairs",)

    @checked(**GUARD)
    def __init__(self, model: TorchModel, *, margin: float = 0.05, reach: float = 3.0,
                 overdrive: float = 1.25):
        super().__init__(model)
        dynamics_tables(model)
        self.settings = {"margin": margin, "reach": reach, "overdrive": overdrive}
        self.automatic_optimization = False
        self.repairs: dict[str, float] = {}

    def configure_optimizers(self) -> torch.optim.Optimizer:
        return torch.optim.SGD(self.model.parameters(), lr=0.0)

    def training_step(self, batch, index: int) -> None:
        module = self.trainer.datamodule
        guard = StabilityGuard(module.training, transient=module.transient, **self.settings)
        self.repairs = guard.enforce(self.model)
        self.optimizers().step()  # there are no gradients, but Lightning saves a fit only after a step


def _recorded(runs: Sequence[RolloutBatch]) -> Recorded:
    """Single rollouts, padded to the longest and stacked."""
    window, held = (torch.stack([getattr(run, name) for run in runs]) for name in ("window", "window_inputs"))
    inputs = pad_sequence([run.inputs for run in runs], batch_first=True)
    return Recorded(window.numpy(), held.numpy(), inputs.numpy(), np.array([len(run.inputs) for run in runs]))


def _of_like_length(runs: Sequence[RolloutBatch]) -> list[list[RolloutBatch]]:
    """Groups of rollouts, sorted from long to short, so that no rollout is padded to more than twice its length."""
    groups: list[list[RolloutBatch]] = []
    for run in runs:
        if not groups or 2 * len(run.inputs) < len(groups[-1][0].inputs):
            groups.append([])
        groups[-1].append(run)
    return groups


def _settled(run, transient: float):
    first = round(transient / run.timestep) if run.kind == "decay" else 0
    return run.part(first) if first else run


def _of_steps(model: TorchModel) -> tuple[float, float]:
    """offset and h, such that a mode with eigenvalue λ of the linear part is multiplied by offset + h λ in a step."""
    return (1.0, model.base_timestep) if model.structure.scheme == "euler" else (0.0, 1.0)


def _put_linear_part(model: TorchModel, linear: Tensor) -> None:
    """Write R₁ (n, n) into the columns that multiply single entries of z."""
    columns = torch.cat([table.T for table in dynamics_tables(model)]).T
    for k, factors in enumerate(model.structure.dynamics.factors):
        if len(factors) == 1 and factors[0] < model.state_dim:
            columns[:, k] = linear[:, factors[0]]
    tables = dynamics_tables(model)
    for table, part in zip(tables, columns.split([table.shape[1] for table in tables], dim=1)):
        table.copy_(part)


def _linear_columns(model: TorchModel) -> list[Tensor]:
    """For each dynamics table, whether each of its columns multiplies a single entry of z or u."""
    tables = dynamics_tables(model)
    linear = torch.tensor([len(factors) == 1 for factors in model.structure.dynamics.factors], device=tables[0].device)
    return list(linear.split([table.shape[1] for table in tables]))
