"""Exact derivatives of a rollout with respect to the coefficients of a polynomial model, by the adjoint method.

window ─chart→ z_0 ─steps→ z_k ─parametrization→ ŷ_k,   Λ_j = ∂ŷ_k/∂z_j = Λ_{j+1} A_j,   Λ_k = ∂w/∂z,
∂ŷ_k/∂θ = Σ_{j<k} Λ_{j+1} G_j ⊗ φ_j (dynamics),   Λ_0 ⊗ φ_0 (chart),   φ(z_k) (parametrization)
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import NamedTuple

import torch
from torch import Tensor

from ssmr_torch.data.windows import RolloutBatch
from ssmr_torch.models.polynomial import PolynomialModel
from ssmr_torch.models.torch_model import TorchModel

GROUPS = ("dynamics", "chart", "parametrization")


class OutputSensitivity(NamedTuple):
    """Of the sample k steps after the start: outputs (N, p), jacobian (N, p, P) with the columns of `coefficients`."""

    step: int
    outputs: Tensor
    jacobian: Tensor


class Steps(NamedTuple):
    """K integrator steps z⁺ = z + Σ_s G_s f_s, each of which evaluates the dynamics f_s = R φ_s at s stages.

    states (N, K + 1, n) with the initial ones; transitions ∂z⁺/∂z (N, K, n, n); gains G = ∂z⁺/∂f (N, K, n, s, n);
    regressors φ (N, K, s, q).
    """

    states: Tensor
    transitions: Tensor
    gains: Tensor
    regressors: Tensor


def coefficients(model: TorchModel, groups: Sequence[str] = GROUPS) -> list[Tensor]:
    """Views of the coefficient tables in which the rollout is differentiated, in the order of the columns.

    dynamics: all tables of the reduced dynamics, as one (n, q) where there are two; chart: (n, k); parametrization:
    the newest sample's rows (p, q_w), the only ones that a prediction uses.
    Raises ValueError for another group, or one in which the model has no coefficients.
    """
    _ = dynamics_tables(model)
    unknown = [group for group in groups if group not in GROUPS]
    if unknown or not groups:
        raise ValueError(f"trained is {list(groups)}; expected some of {GROUPS}")
    empty = [group for group in groups if not any(getattr(model, name).numel() for name in model.tables[group])]
    if empty:
        raise ValueError(f"trained is {list(groups)}, but {type(model).__name__} has no coefficients of its "
                         f"{empty[0]}; leave it out")
    rows = {"dynamics": slice(None), "chart": slice(None), "parametrization": slice(-model.output_dim, None)}
    return [getattr(model, name).data[rows[group]] for group in GROUPS if group in groups
            for name in model.tables[group]]


def dynamics_tables(model: TorchModel) -> list[Tensor]:
    """Views of the tables of the reduced dynamics, whose columns follow each other in `dynamics_regressors`.

    Raises ValueError for a model whose dynamics are no table times regressors.
    """
    if "dynamics" not in model.tables or model.structure.relift:
        raise ValueError(f"{type(model).__name__} has no coefficient tables; Gauss-Newton steps and the stability "
                         "guard take SSMR, SSSR, control-augmented and other models that name their tables; the rest "
                         "are refined with fit=rollout")
    return [getattr(model, name).data for name in model.tables["dynamics"]]


@torch.no_grad()
def rollout_sensitivities(model: TorchModel, batch: RolloutBatch, steps: Sequence[int],
                          groups: Sequence[str] = GROUPS) -> Iterator[OutputSensitivity]:
    """Outputs and their derivatives after each of `steps` (ascending, from 1), for all starts of a batch at once.

    The sensitivities are those of the discretized model: Runge-Kutta stages are differentiated one by one.
    """
    widths, model = [table.shape[1] for table in dynamics_tables(model)], model.reduced
    taken, within = _steps(model, batch, max(steps)), _within(model)
    features = model.chart_regressors(batch.window, batch.window_inputs)
    for step in steps:
        before = Steps(taken.states, *(part[:, :step * within] for part in taken[1:]))
        z = taken.states[:, step * within]
        first, after = _adjoints(model.linearize_output(z).C, before.transitions)
        parts = _of_dynamics(model, widths, after, before) if "dynamics" in groups else []
        if "chart" in groups:
            parts.append((first[..., None] * features[:, None, None]).flatten(-2))
        if "parametrization" in groups:
            parts.append(_of_parametrization(model, z))
        yield OutputSensitivity(step, model.decode(z), torch.cat(parts, dim=-1))


def _adjoints(C: Tensor, transitions: Tensor) -> tuple[Tensor, Tensor]:
    """Λ_0 (N, p, n), and Λ_1 … Λ_k (N, k, p, n), back from Λ_k = C through transitions (N, k, n, n)."""
    adjoints = [C]
    for A in reversed(transitions.unbind(1)):
        adjoints.append(adjoints[-1] @ A)
    return adjoints[-1], torch.stack(adjoints[-2::-1], dim=1)


def _within(model: PolynomialModel) -> int:
    """Integrator steps within a timestep."""
    return model.substeps if model.flow else model.repeats


def _steps(model: PolynomialModel, batch: RolloutBatch, count: int) -> Steps:
    """The integrator steps of a rollout over `count` timesteps."""
    within = _within(model)
    inputs = batch.inputs[:, :count].repeat_interleave(within, dim=1)
    single = replace(model, timestep=model.timestep / within, substeps=1)
    states = single.states(model.encode(batch.window, batch.window_inputs), inputs)
    return Steps(states, *(_runge_kutta_steps if model.flow else _map_steps)(single, states[:, :-1], inputs))


def _map_steps(model: PolynomialModel, z: Tensor, u: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    h = model.base_timestep if model.structure.scheme == "euler" else 1.0
    identity = torch.eye(model.state_dim, dtype=z.dtype, device=z.device)
    transition = h * model.state_jacobian(z, u)
    if model.structure.scheme == "euler":
        transition = identity + transition
    return transition, (h * identity)[:, None].expand(*z.shape, 1, -1), model.dynamics_regressors(z, u)[:, :, None]


def _runge_kutta_steps(model: PolynomialModel, z: Tensor, u: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    h, stages = model.timestep, [z]
    for ahead in (0.5 * h, 0.5 * h, h):
        stages.append(z + ahead * model.rate(stages[-1], u))
    identity = torch.eye(model.state_dim, dtype=z.dtype, device=z.device)
    transition, gains, through = identity, [], 0.0
    # from the last stage to the first: a rate acts on z⁺ by its own share and through the stage that it leads to
    for stage, share, ahead in zip(reversed(stages), (1.0, 2.0, 2.0, 1.0), (0.0, h, 0.5 * h, 0.5 * h)):
        gains.insert(0, share * h / 6.0 * identity + ahead * through)
        through = gains[0] @ model.state_jacobian(stage, u)
        transition = transition + through
    gains[-1] = gains[-1].expand_as(transition)
    regressors = [model.dynamics_regressors(stage, u) for stage in stages]
    return transition, torch.stack(gains, dim=3), torch.stack(regressors, dim=2)


def _of_dynamics(model: PolynomialModel, widths: list[int], after: Tensor, before: Steps) -> list[Tensor]:
    """For each dynamics table, Σ Λ G ⊗ φ over all stages of all steps, (N, p, n q): one product per start."""
    felt = (after @ before.gains.flatten(-2)).unflatten(-1, (-1, model.state_dim))
    felt = felt.permute(0, 2, 4, 1, 3).flatten(3).flatten(1, 2)
    return [(felt @ regressors).view(len(after), model.output_dim, -1)
            for regressors in torch.split(before.regressors.flatten(1, 2), widths, dim=-1)]


def _of_parametrization(model: PolynomialModel, z: Tensor) -> Tensor:
    features = model.structure.parametrization(z)
    J = z.new_zeros(len(z), model.output_dim, model.output_dim, features.shape[1])
    J.diagonal(dim1=1, dim2=2).add_(features[..., None])
    return J.flatten(-2)
