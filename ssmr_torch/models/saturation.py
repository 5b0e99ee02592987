"""Nonlinear terms that stay what they are at the edge of the training range, where a polynomial would run away.

s_i(z) = z_i for |z_i| ≤ e_i, and e_i sign(z_i) (1 + ½ tanh 2(|z_i| / e_i - 1)) beyond, twice continuously
differentiable. Dynamics whose nonlinear terms see s(z) instead of z are the polynomial itself within the range, and
with a stable linear part and bounded inputs no rollout of theirs grows without bound.
"""

from __future__ import annotations

from collections.abc import Callable


def saturated(z, edge, tanh: Callable):
    """s(z) and its slopes ds_i/dz_i, both (..., n), of NumPy arrays or Torch tensors with their own `tanh`.

    edge: e (n,), positive; infinite where nothing saturates.
    """
    over = abs(z) / edge - 1.0
    over = 0.5 * (over + abs(over))
    bend = tanh(2.0 * over)
    return z * (1.0 + 0.5 * bend) / (1.0 + over), 1.0 - bend * bend
