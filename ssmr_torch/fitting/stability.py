"""Fits that do not diverge: the linear part kept stable, and no rollout of the training set leaving the range."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from math import exp
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor
from torch.nn.utils.rnn import pad_sequence

from ssmr_torch.data.windows import RolloutBatch, RolloutDataset
from ssmr_torch.fitting.lightning_fit import ModelFit
from ssmr_torch.fitting.rollout_sensitivities import dynamics_tables
from ssmr_torch.models.batch_rollout import BatchRollout, batch_of
from ssmr_torch.models.integrators import DIVERGENCE_FACTOR
from ssmr_torch.models.torch_model import TorchModel

HALVINGS = 12


class Recorded(NamedTuple):
    """Rollouts of the training set: window (N, n_d + 1, p), held (N, n_d, m), padded inputs (N, H, m), lengths (N,)."""

    window: np.ndarray
    held: np.ndarray
    inputs: np.ndarray
    lengths: np.ndarray


class StabilityGuard:
    """Says whether a polynomial model is safe to roll out, and makes it so.

    A model holds when (1) the linear part R₁ of its reduced dynamics is stable, Re λ ≤ −margin for every eigenvalue,
    |1 + h λ| ≤ e^{−margin h} in discrete time, and (2) no rollout of the training set, under its recorded inputs,
    leaves `reach` times the range of the training states: neither one over the full length of a trajectory nor one of
    `horizon` s from any of `starts` seeded samples, which need not lie on the manifold. All are repeated with the
    recorded inputs multiplied by `overdrive`, for a controller asks for more than the training did.

    trajectories: those of the training. transient: s cut from the start of each decay. margin: 1/s. reach: smaller
    than the `DIVERGENCE_FACTOR` that a rollout is judged by later, so that unseen runs have room as well; of a
    saturated model, which cannot run away, that factor itself, and under the recorded inputs alone.
    Raises ValueError for a model without coefficient tables, or one that was not fitted yet.
    """

    def __init__(self, trajectories: Sequence, *, transient: float = 0.0, margin: float = 0.05, reach: float = 3.0,
                 overdrive: float = 1.25, horizon: float = 1.0, starts: int = 1000):
        if not (margin >= 0 and reach > 1 and overdrive >= 1):
            raise ValueError(f"margin {margin} 1/s, reach {reach} and overdrive {overdrive}; expected 0 or more, more "
                             "than 1, and 1 or more")
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
        """Share of the rollouts from the samples that leave the range, plus that of the full-length ones: only 0 means
        that none does.
        """
        return sum(self._leaving(model))

    def _leaving(self, model, at_most: int | None = None) -> Iterator[float]:
        """Share that leaves, of the rollouts from the samples, then of the full-length ones."""
        bounded, batch = model.structure.saturated, batch_of(model)
        bound = batch.model.divergence_bound
        bound = bound if bounded else bound * self.reach / DIVERGENCE_FACTOR
        if not np.isfinite(bound):
            raise ValueError("the range of the training states is not known; guard a model after its closed form")
        factors = (1.0,) if bounded or self.overdrive == 1 else (1.0, self.overdrive)
        for runs in self._of_delays(model.delays):
            yield (self._left(batch, runs, factors, float(bound), at_most)
                   / (len(factors) * sum(len(run.inputs) for run in runs)))

    @staticmethod
    def _left(batch: BatchRollout, runs: list[Recorded], factors: tuple[float, ...], bound: float,
              at_most: int | None) -> int:
        """How many rollouts leave the bound, with their inputs multiplied by each factor, counted up to `at_most`."""
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
        """Seeded starts of `horizon` s, and every trajectory from its first window to its end, longest first."""
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
        """Make the model hold with the smallest changes of these kinds; {what: how much}, empty where nothing was done.

        Eigenvalues beyond the margin are moved onto it, with their frequencies and eigenvectors kept. Then all terms
        beyond the linear ones are shrunk by the factor ½, ¼, …, 0, the largest for which no rollout diverges.
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
        """By how much Re λ of the linear part, in continuous time, exceeds −margin, (n,), 1/s."""
        return torch.as_tensor(model.reduced.rates.real) + self.margin

    @torch.no_grad()
    def stabilize(self, model: TorchModel) -> int:
        """Move eigenvalues of the linear part beyond the margin onto it; how many there were."""
        beyond = int((self._excess(model) > 1e-9).sum())
        if beyond:
            eigenvalues, vectors = torch.linalg.eig(model.reduced.linear_part)
            moved = self._moved(model, eigenvalues)
            _put_linear_part(model, torch.linalg.solve(vectors.mT, (vectors * moved).mT).mT.real)
        return beyond

    def _moved(self, model: TorchModel, eigenvalues: Tensor) -> Tensor:
        """Those beyond the margin on it, with their frequencies kept."""
        if model.reduced.flow:
            return torch.complex(torch.clamp(eigenvalues.real, max=-self.margin), eigenvalues.imag)
        offset, h = _of_steps(model)
        factors = offset + h * eigenvalues
        largest = exp(-self.margin * model.base_timestep)
        return (factors * torch.clamp(largest / factors.abs().clamp_min(1e-300), max=1.0) - offset) / h


class GuardFit(ModelFit):
    """Makes a fitted polynomial model hold by its `StabilityGuard`; `repairs` says what that took.

    One epoch without training; the validation that follows scores the repaired model.
    """

    epochs, starts = 1, 1

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
        self.optimizers().step()  # nothing has a gradient; a fit without a step would not be saved


def _recorded(runs: Sequence[RolloutBatch]) -> Recorded:
    """Single rollouts side by side."""
    window, held = (torch.stack([getattr(run, name) for run in runs]) for name in ("window", "window_inputs"))
    inputs = pad_sequence([run.inputs for run in runs], batch_first=True)
    return Recorded(window.numpy(), held.numpy(), inputs.numpy(), np.array([len(run.inputs) for run in runs]))


def _of_like_length(runs: Sequence[RolloutBatch]) -> list[list[RolloutBatch]]:
    """Rollouts of falling length in groups, in which none is padded to more than twice its own."""
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
    """offset and h, such that an eigenvalue λ of the linear part multiplies the state by offset + h λ in a step."""
    return (1.0, model.base_timestep) if model.structure.scheme == "euler" else (0.0, 1.0)


def _put_linear_part(model: TorchModel, linear: Tensor) -> None:
    """Put the columns of R₁ (n, n) in place, those that multiply one entry of z alone."""
    columns = torch.cat([table.T for table in dynamics_tables(model)]).T
    for k, factors in enumerate(model.structure.dynamics.factors):
        if len(factors) == 1 and factors[0] < model.state_dim:
            columns[:, k] = linear[:, factors[0]]
    tables = dynamics_tables(model)
    for table, part in zip(tables, columns.split([table.shape[1] for table in tables], dim=1)):
        table.copy_(part)


def _linear_columns(model: TorchModel) -> list[Tensor]:
    """For each dynamics table, which of its columns multiply z or u alone."""
    tables = dynamics_tables(model)
    linear = torch.tensor([len(factors) == 1 for factors in model.structure.dynamics.factors], device=tables[0].device)
    return list(linear.split([table.shape[1] for table in tables]))
