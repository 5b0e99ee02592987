"""Monomials and their Jacobians in Torch."""

from __future__ import annotations

import torch
from torch import Tensor, nn

from ssmr_torch.models.monomials import Monomials, count_monomials


class MonomialFeatures(nn.Module):
    """z^{lowest:highest}, or the selected ones of them, and its Jacobian, on the index tables of `Monomials`."""

    def __init__(self, monomials: Monomials):
        super().__init__()
        self.monomials = monomials
        for level, (parent, variable) in enumerate(monomials.levels):
            self.register_buffer(f"parent_{level}", torch.from_numpy(parent), persistent=False)
            self.register_buffer(f"variable_{level}", torch.from_numpy(variable), persistent=False)
        below = count_monomials(monomials.variables, 0, monomials.lowest - 1)
        rows = torch.arange(count_monomials(monomials.variables, monomials.lowest, monomials.highest))
        chosen = rows if monomials.chosen is None else torch.from_numpy(monomials.chosen)
        self.register_buffer("chosen", below + chosen, persistent=False)
        self.register_buffer("exponents", torch.from_numpy(monomials.exponents).double(), persistent=False)
        self.register_buffer("derivative_index", torch.from_numpy(monomials.derivative_index), persistent=False)

    def __len__(self) -> int:
        return len(self.monomials)

    def all_degrees(self, z: Tensor) -> Tensor:
        """z^{0:highest}, (..., 1 + n + …)."""
        parts = [torch.ones_like(z[..., :1])]
        if self.monomials.highest >= 1:
            parts.append(z)
        for level in range(len(self.monomials.levels)):
            parts.append(parts[-1][..., getattr(self, f"parent_{level}")] * z[..., getattr(self, f"variable_{level}")])
        return torch.cat(parts, dim=-1)

    def forward(self, z: Tensor) -> Tensor:
        """(..., n) → (..., q)."""
        return self.all_degrees(z)[..., self.chosen]

    def jacobian(self, z: Tensor) -> Tensor:
        """(..., n) → (..., q, n)."""
        return self.exponents * self.all_degrees(z)[..., self.derivative_index]
