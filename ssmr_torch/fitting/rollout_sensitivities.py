"""Exact derivatives of a rollout with respect to the coefficients of a polynomial model, by the adjoint method.

window ─chart→ z_0 ─steps→ z_k ─parametrization→ ŷ_k,   Λ_j = ∂ŷ_k/∂z_j = Λ_{j+1} A_j,   Λ_k = ∂w/∂z,
∂ŷ_k/∂θ = Σ_{j<k} Λ_{j+1} G_j ⊗ φ_j (dynamics),   Λ_0 ⊗ φ_0 (chart),   φ(z_k) (parametrization)
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from ssmr_torch.data.windows import RolloutBatch
from ssmr_torch.models.batch_rollout import batch_of
from ssmr_torch.models.polynomial import PolynomialModel
from ssmr_torch.models.torch_model import TorchModel

GROUPS = ("dynamics", "chart", "parametrization")


class OutputSensitivity(NamedTuple):
    """At one step after the start: outputs (N, p), and jacobian (N, p, P) with the columns of `coefficients`."""

    step: int
    outputs: Tensor
    jacobian: Tensor


class Steps(NamedTuple):
    """K integrator steps z⁺ = z + Σ_s G_s f_s. Each evaluates the dynamics f_s = R φ_s at its stages s.

    states (N, K + 1, n), including the initial states; transitions ∂z⁺/∂z (N, K, n, n); gains G = ∂z⁺/∂f (N, K, n, s,
    n); regressors φ of each stage, (N, K, q).
    """

    states: Tensor
    transitions: Tensor
    gains: Tensor
    regressors: tuple[Tensor, ...]

    def until(self, count: int) -> Steps:
        """The first `count` steps."""
        return Steps(self.states, self.transitions[:, :count], self.gains[:, :count],
                     tuple(stage[:, :count] for stage in self.regressors))


def coefficients(model: TorchModel, groups: Sequence[str] = GROUPS) -> list[Tensor]:
    """Views of the coefficient tables by which the rollout is differentiated, in the order of the columns.

    dynamics: all tables of the reduced dynamics; two tables count as one table (n, q). chart: (n, k). parametrization:
    only the rows of the newest sample (p, q_w), because a prediction uses no others.
    Raises ValueError for another group, or for a group without coefficients.
    """
    _ = dynamics_tables(model)
    unknown = [group for group in groups if group not in GROUPS]
    if unknown or not groups:
        raise ValueError(f"trained is {list(groups)}; expected one or more of {GROUPS}")
    empty = [group for group in groups if not any(getattr(model, name).numel() for name in model.tables[group])]
    if empty:
        raise ValueError(f"trained is {list(groups)}, but {type(model).__name__} has no coefficients in its "
                         f"{empty[0]}; remove {empty[0]} from trained")
    rows = {"dynamics": slice(None), "chart": slice(None), "parametrization": slice(-model.output_dim, None)}
    return [getattr(model, name).data[rows[group]] for group in GROUPS if group in groups
            for name in model.tables[group]]


def dynamics_tables(model: TorchModel) -> list[Tensor]:
    """Views of the tables of the reduced dynamics. Their columns are in the order of `dynamics_regressors`.

    Raises ValueError for a model whose dynamics are not a table times regressors.
    """
    if "dynamics" not in model.tables or model.structure.relift:
        raise ValueError(f"{type(model).__name__} has no coefficient tables. Gauss-Newton fits and the stability guard "
                         "need a model with named tables, such as SSMR, SSSR or a control-augmented model; refine this "
                         "model with fit=rollout")
    return [getattr(model, name).data for name in model.tables["dynamics"]]


@torch.no_grad()
def rollout_sensitivities(model: TorchModel, batch: RolloutBatch, steps: Sequence[int],
                          groups: Sequence[str] = GROUPS) -> Iterator[OutputSensitivity]:
    """Outputs and their derivatives after each of `steps` (ascending, 1 or more), for all starts of a batch at once.

    The derivatives are those of the discretized model: each Runge-Kutta stage is differentiated.
    """
    widths, model = [table.shape[1] for table in dynamics_tables(model)], model.reduced
    taken, within = _steps(model, batch, max(steps)), _within(model)
    features = model.chart_regressors(batch.window, batch.window_inputs)
    for step in steps:
        before = taken.until(step * within)
        z = taken.states[:, step * within]
        first, after = _adjoints(model.linearize_output(z).C, before.transitions)
        parts = _of_dynamics(model, widths, after, before) if "dynamics" in groups else []
        if "chart" in groups:
            parts.append((first[..., None] * features[:, None, None]).flatten(-2))
        if "parametrization" in groups:
            parts.append(_of_parametrization(model, z))
        yield OutputSensitivity(step, model.decode(z), torch.cat(parts, dim=-1))


def _adjoints(C: Tensor, transitions: Tensor) -> tuple[Tensor, Tensor]:
    """Λ_0 (N, p, n) and Λ_1 … Λ_k (N, k, p, n), computed backwards from Λ_k = C through transitions (N, k, n, n)."""
    adjoints = [C]
    for A in reversed(transitions.unbind(1)):
        adjoints.append(adjoints[-1] @ A)
    return adjoints[-1], torch.stack(adjoints[-2::-1], dim=1)


def _within(model: PolynomialModel) -> int:
    """Number of integrator steps within a timestep."""
    return model.substeps if model.flow else model.repeats


def _steps(model: PolynomialModel, batch: RolloutBatch, count: int) -> Steps:
    """The integrator steps of a rollout over `count` timesteps."""
    within = _within(model)
    inputs = batch.inputs[:, :count].repeat_interleave(within, dim=1)
    single = replace(model, timestep=model.timestep / within, substeps=1)
    states = states_of(single, model.encode(batch.window, batch.window_inputs), inputs)
    return Steps(states, *(_runge_kutta_steps if model.flow else _map_steps)(single, states[:, :-1], inputs))


def states_of(model: PolynomialModel, z: Tensor, inputs: Tensor, bound: float = torch.inf) -> Tensor:
    """States (N, H + 1, n), by compiled code; NaN from the step at which ‖z‖ exceeds the bound."""
    states, diverged_at = batch_of(model).rollout(z.numpy(force=True), inputs.numpy(force=True), bound=bound)
    states[np.arange(states.shape[1]) >= diverged_at[:, None]] = np.nan
    return torch.from_numpy(states).to(z.device)


def _points(of_steps: Tensor) -> Tensor:
    """(N, K, n) as (n, N K)."""
    return of_steps.flatten(0, 1).T.contiguous()


def _map_steps(model: PolynomialModel, z: Tensor, u: Tensor) -> tuple[Tensor, Tensor, tuple[Tensor, ...]]:
    h = model.base_timestep if model.structure.scheme == "euler" else 1.0
    identity = torch.eye(model.state_dim, dtype=z.dtype, device=z.device)
    _, regressors, by_state = model.dynamics_rows(_points(z), _points(u))
    transition = h * by_state.unflatten(0, z.shape[:2])
    if model.structure.scheme == "euler":
        transition = identity + transition
    return transition, (h * identity)[:, None].expand(*z.shape, 1, -1), (_by_step(regressors, z),)


def _runge_kutta_steps(model: PolynomialModel, z: Tensor, u: Tensor) -> tuple[Tensor, Tensor, tuple[Tensor, ...]]:
    h, start, held = model.timestep, _points(z), _points(u)
    stage, regressors, jacobians = start, [], []
    for ahead in (0.5 * h, 0.5 * h, h, 0.0):
        rate, seen, by_state = model.dynamics_rows(stage, held)
        regressors.append(_by_step(seen, z))
        jacobians.append(by_state)
        stage = start + ahead * rate
    identity = torch.eye(model.state_dim, dtype=z.dtype, device=z.device)
    transition, gains, through = identity, [], 0.0
    # from the last stage to the first: a rate changes z⁺ directly by its weight, and through the stage after it
    for by_state, share, ahead in zip(reversed(jacobians), (1.0, 2.0, 2.0, 1.0), (0.0, h, 0.5 * h, 0.5 * h)):
        gains.insert(0, share * h / 6.0 * identity + ahead * through)
        through = gains[0] @ by_state
        transition = transition + through
    gains[-1] = gains[-1].expand_as(transition)
    return (transition.unflatten(0, z.shape[:2]), torch.stack(gains, dim=2).unflatten(0, z.shape[:2]),
            tuple(regressors))


def _by_step(rows: Tensor, z: Tensor) -> Tensor:
    """(q, N K) as (N, K, q), without a copy; K is the number of steps in z."""
    return rows.unflatten(1, z.shape[:2]).permute(1, 2, 0)


def _of_dynamics(model: PolynomialModel, widths: list[int], after: Tensor, before: Steps) -> list[Tensor]:
    """Σ Λ G ⊗ φ over all stages of all steps, for each dynamics table: (N, p, n q)."""
    felt = (after @ before.gains.flatten(-2)).unflatten(-1, (-1, model.state_dim))
    felt = felt.permute(3, 0, 2, 4, 1).flatten(2, 3).contiguous()
    total = felt[0] @ before.regressors[0]
    for of_stage, regressors in zip(felt[1:], before.regressors[1:]):
        total.baddbmm_(of_stage, regressors)
    return [part.reshape(len(after), model.output_dim, -1) for part in total.split(widths, dim=-1)]


def _of_parametrization(model: PolynomialModel, z: Tensor) -> Tensor:
    features = model.structure.parametrization(z)
    J = z.new_zeros(len(z), model.output_dim, model.output_dim, features.shape[1])
    J.diagonal(dim1=1, dim2=2).add_(features[..., None])
    return J.flatten(-2)
