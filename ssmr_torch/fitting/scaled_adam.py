"""Adam on coefficients measured in units of their own effect."""

from __future__ import annotations

import torch
from torch import Tensor

from ssmr_torch.models.base import ReducedModel
from ssmr_torch.models.neural_ode import NeuralODE
from ssmr_torch.models.ssmr import SSMR


class ScaledAdam(torch.optim.Adam):
    """Adam on θ / s for every group that gives a `scale` s of the shape of its one parameter.

    A cubic coefficient of dynamics in metres is a million times a linear one; a step of Adam has one size for all.
    """

    def __init__(self, groups: list[dict], lr: float, weight_decay: float = 0.0):
        groups = [{**group, "scale": torch.ones_like(group["params"][0]) if group["scale"] is None else group["scale"]}
                  for group in groups]
        super().__init__(groups, lr=lr, weight_decay=weight_decay)

    def _scaled(self) -> list[tuple[Tensor, Tensor]]:
        return [(parameter, group["scale"]) for group in self.param_groups for parameter in group["params"]]

    @torch.no_grad()
    def clip(self, largest: float) -> None:
        """Shrink the gradient with respect to θ / s to at most this norm; one that is not finite becomes zero."""
        pairs = [(p, s) for p, s in self._scaled() if p.grad is not None]
        norm = sum((p.grad * s).square().sum() for p, s in pairs) ** 0.5
        for parameter, _ in pairs:
            if torch.isfinite(norm):
                parameter.grad.mul_(torch.clamp(largest / (norm + 1e-300), max=1.0))
            else:
                parameter.grad.zero_()

    @torch.no_grad()
    def step(self, closure=None):
        loss = None
        if closure is not None:
            with torch.enable_grad():
                loss = closure()
        for parameter, scale in self._scaled():
            parameter.div_(scale)
            if parameter.grad is not None:
                parameter.grad.mul_(scale)
        super().step()
        for parameter, scale in self._scaled():
            parameter.mul_(scale)
        return loss


@torch.no_grad()
def table_scales(model: ReducedModel) -> dict[str, Tensor]:
    """The scales of a model's tables by their names, from the range of its training states.

    None of a model that was not fitted, of a network's weights, which are of order one, or of any other model.
    """
    if model.state_scale.isinf().any():
        return {}
    if isinstance(model, SSMR):
        return _polynomial_scales(model)
    return _linear_scales(model) if isinstance(model, NeuralODE) else {}


def _polynomial_scales(model: SSMR) -> dict[str, Tensor]:
    """s_ij = (size of row i) / (size of monomial j) at the edge of the training data.

    The size of row i is Σ_j |θ_ij| |monomial_j|, at least a thousandth of the largest row's, so a step of relative size
    ε changes the row by about ε of itself.
    """
    sizes = {"drift_table": model.drift_features(model.state_scale),
             "parametrization": model.parametrization_features(model.state_scale)}
    with_constant = torch.cat([model.state_scale.new_ones(1), model.control_features(model.state_scale)])
    sizes["control_table"] = with_constant.repeat_interleave(model.input_dim)
    scales = {}
    for name, monomials in sizes.items():
        table = getattr(model, name)
        row = (table.abs() * monomials).sum(1, keepdim=True)
        row = torch.maximum(row, 1e-3 * row.max()).clamp_min(1e-300)
        scales[name] = row / monomials.clamp_min(1e-300)
    return scales


def _linear_scales(model: NeuralODE) -> dict[str, Tensor]:
    """A step of relative size ε in all coefficients of a row moves a coordinate or an output by ε of its largest
    value; in one coefficient of a rate, by ε of the coordinate's largest value per s, as in the network beside it.
    """
    state = model.state_scale.clamp_min(1e-300)
    output = (model.parametrization.abs() @ state)
    output = torch.maximum(output, 1e-3 * output.max()).clamp_min(1e-300)
    with_constant = torch.cat([state.new_ones(1), state]).repeat_interleave(model.input_dim)
    return {"chart": state[:, None] / output.repeat(model.delays + 1) / model.window_dim,
            "parametrization": output[:, None] / state / model.state_dim,
            "linear": state[:, None] / state, "control": state[:, None] / with_constant}
