"""Adam on scaled coefficients, so that one learning rate fits coefficients of very different size."""

from __future__ import annotations

import torch
from torch import Tensor

from ssmr_torch.models.torch_model import TorchModel


class ScaledAdam(torch.optim.Adam):
    """Adam on θ / s, for every group that has a `scale` s with the shape of its one parameter.

    With lengths in metres, a cubic coefficient of the dynamics is a million times larger than a linear one, but a step
    of Adam has the same size for all.
    """

    def __init__(self, groups: list[dict], lr: float, weight_decay: float = 0.0):
        groups = [{**group, "scale": torch.ones_like(group["params"][0]) if group["scale"] is None else group["scale"]}
                  for group in groups]
        super().__init__(groups, lr=lr, weight_decay=weight_decay)

    def _scaled(self) -> list[tuple[Tensor, Tensor]]:
        return [(parameter, group["scale"]) for group in self.param_groups for parameter in group["params"]]

    @torch.no_grad()
    def clip(self, largest: float) -> None:
        """Limit the norm of the gradient with respect to θ / s. A gradient that is not finite becomes zero."""
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


def table_scales(model: TorchModel) -> dict[str, Tensor]:
    """The scales of a model's tables by name, see `TorchModel.scales`; empty for a model that was not fitted."""
    return {} if model.state_scale.isinf().any() else model.scales()
