"""Derivatives of a rollout with respect to the coefficients of a polynomial model, carried along exactly.

window ─chart→ z_0 ─steps→ z_k ─parametrization→ ŷ_k,   S_k = ∂z_k/∂(dynamics, chart),   ∂ŷ_k/∂θ = C_k S_k, w(z_k)
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import torch
from torch import Tensor

from ssmr_torch.data.windows import RolloutBatch
from ssmr_torch.models.base import ReducedModel
from ssmr_torch.models.control_augmented import ControlAugmentedSSMR
from ssmr_torch.models.ssmr import SSMR

GROUPS = ("dynamics", "chart", "parametrization")


class OutputSensitivity(NamedTuple):
    """Of the sample k steps after the start: outputs (N, p), jacobian (N, p, P) with the columns of `coefficients`."""

    step: int
    outputs: Tensor
    jacobian: Tensor


def coefficients(model: ReducedModel, groups: Sequence[str] = GROUPS) -> list[Tensor]:
    """Views of the coefficient tables in which the rollout is differentiated, in the order of the columns.

    dynamics: all tables of the reduced dynamics, as one (n, q) where there are two; chart: (n, k); parametrization:
    the newest sample's rows (p, q_w), the only ones that a prediction uses.
    Raises ValueError for another group.
    """
    dynamics = dynamics_tables(model)
    unknown = [group for group in groups if group not in GROUPS]
    if unknown or not groups:
        raise ValueError(f"trained is {list(groups)}; expected some of {GROUPS}")
    tables = {"dynamics": dynamics, "chart": [model.chart.data],
              "parametrization": [model.parametrization.data[-model.output_dim:]]}
    return [table for group in GROUPS if group in groups for table in tables[group]]


def dynamics_tables(model: ReducedModel) -> list[Tensor]:
    """Tables of the reduced dynamics, whose columns follow each other in `dynamics_regressors`.

    Raises ValueError for a model whose dynamics are no table times regressors.
    """
    if isinstance(model, SSMR):
        return [model.drift_table.data, model.control_table.data]
    if isinstance(model, ControlAugmentedSSMR):
        return [model.dynamics_table.data]
    raise ValueError(f"{type(model).__name__} has no coefficient tables; Gauss-Newton steps and the stability guard "
                     "take SSMR, SSSR and control-augmented models, others are refined with fit=rollout")


@torch.no_grad()
def rollout_sensitivities(model: SSMR | ControlAugmentedSSMR, batch: RolloutBatch, steps: Sequence[int],
                          groups: Sequence[str] = GROUPS) -> Iterator[OutputSensitivity]:
    """Outputs and their derivatives after each of `steps` (ascending, from 1), for all starts of a batch at once.

    The sensitivities are those of the discretized model: Runge-Kutta stages are differentiated one by one.
    """
    n, features = model.state_dim, model.chart_regressors(batch.window, batch.window_inputs)
    z = model.encode(batch.window, batch.window_inputs)
    q = sum(table.shape[1] for table in dynamics_tables(model)) if "dynamics" in groups else 0
    k = features.shape[1] if "chart" in groups else 0
    S = z.new_zeros(len(z), n, n * (q + k))
    if k:
        _diagonal_blocks(S[..., n * q:], n, k).add_(features[..., None])
    for step in range(1, max(steps) + 1):
        z, S = _advance(model, z, S, batch.inputs[:, step - 1], q)
        if step in steps:
            C, _ = model.linearize_output(z)
            parts = [_split(model, C @ S, q)]
            if "parametrization" in groups:
                parts.append(_of_parametrization(model, z))
            yield OutputSensitivity(step, model.decode(z), torch.cat(parts, dim=-1))


def _advance(model, z: Tensor, S: Tensor, u: Tensor, q: int) -> tuple[Tensor, Tensor]:
    if isinstance(model, ControlAugmentedSSMR):
        for _ in range(model.repeats):
            A, _ = model.advance_jacobians(z, u)
            S = _driven(A @ S, model, model.base_timestep * model.dynamics_regressors(z, u), q)
            z = model.advance(z, u)
        return z, S
    h = model.timestep / model.substeps
    for _ in range(model.substeps):
        z_stage, S_stage, z_sum, S_sum = z, S, 0.0, 0.0
        for ahead, weight in ((0.5, 1.0), (0.5, 2.0), (1.0, 2.0), (None, 1.0)):
            z_rate = model.rate(z_stage, u)
            S_rate = _driven(model.rate_jacobian(z_stage, u) @ S_stage, model, model.dynamics_regressors(z_stage, u), q)
            z_sum, S_sum = z_sum + weight * z_rate, S_sum + weight * S_rate
            if ahead is not None:
                z_stage, S_stage = z + ahead * h * z_rate, S + ahead * h * S_rate
        z, S = z + h / 6.0 * z_sum, S + h / 6.0 * S_sum
    return z, S


def _driven(S: Tensor, model, regressors: Tensor, q: int) -> Tensor:
    """S + the direct effect of the dynamics' coefficients: row i of the table acts on coordinate i."""
    if q:
        _diagonal_blocks(S[..., :model.state_dim * q], model.state_dim, q).add_(regressors[..., None])
    return S


def _diagonal_blocks(S: Tensor, n: int, columns: int) -> Tensor:
    """View (N, columns, n) of the entries ∂z_i/∂θ_ij."""
    return S.unflatten(-1, (n, columns)).diagonal(dim1=1, dim2=2)


def _split(model, J: Tensor, q: int) -> Tensor:
    """Columns of the joint dynamics table (n, q) reordered to those of its parts, one after the other."""
    tables, n = dynamics_tables(model), model.state_dim
    if not q or len(tables) == 1:
        return J
    joint = J[..., :n * q].unflatten(-1, (n, q))
    parts = torch.split(joint, [table.shape[1] for table in tables], dim=-1)
    return torch.cat([*(part.flatten(-2) for part in parts), J[..., n * q:]], dim=-1)


def _of_parametrization(model, z: Tensor) -> Tensor:
    features = model.parametrization_features(z)
    J = z.new_zeros(len(z), model.output_dim, model.output_dim, features.shape[1])
    J.diagonal(dim1=1, dim2=2).add_(features[..., None])
    return J.flatten(-2)
