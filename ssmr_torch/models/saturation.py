"""Saturation s(z) of the nonlinear terms outside the training range, where a polynomial would grow without limit.

s_i(z) = z_i for |z_i| ≤ e_i, and e_i sign(z_i) (1 + ½ tanh 2(|z_i| / e_i - 1)) beyond; s is twice continuously
differentiable. The nonlinear terms of the dynamics take s(z) instead of z. Within the range this is the polynomial
itself. With a stable linear part and bounded inputs, every rollout stays bounded.
"""

from __future__ import annotations

from collections.abc import Callable


def saturated(z, edge, tanh: Callable):
    """s(z) and its slopes ds_i/dz_i, both (..., n), for NumPy arrays or Torch tensors.

    edge: e (n,), positive; infinite for an entry that does not saturate. tanh: the function of the array's library.
    """
    over = abs(z) / edge - 1.0
    over = 0.5 * (over + abs(over))
    bend = tanh(2.0 * over)
    return z * (1.0 + 0.5 * bend) / (1.0 + over), 1.0 - bend * bend
