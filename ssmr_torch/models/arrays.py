"""Arrays of NumPy and of Torch through one set of functions.

What both libraries call alike, with positional arguments alike: concatenate, stack, where, tanh, exp, ones_like,
zeros_like, isfinite; `@`, arithmetic, `sum(-1)`, `swapaxes`, `reshape`. NumPy arrays of objects, such as CasADi's
symbols, go the same way as numbers.
"""

from __future__ import annotations

from typing import Any

import numpy as np

Array = Any  # numpy.ndarray, or torch.Tensor on any device


def namespace(array: Array):
    """The library of an array: `numpy`, or `torch` for a tensor, which whoever has one has imported."""
    if isinstance(array, np.ndarray):
        return np
    import torch

    return torch


def like(array: Array, values: np.ndarray) -> Array:
    """These values as an array of the same library, on the same device: floats in its precision, integers as such."""
    xp = namespace(array)
    if xp is np:
        return values
    return xp.as_tensor(values, dtype=array.dtype if values.dtype.kind == "f" else None, device=array.device)


def identity(array: Array, size: int) -> Array:
    """The identity matrix (size, size) as an array of the same library."""
    xp = namespace(array)
    return np.eye(size) if xp is np else xp.eye(size, dtype=array.dtype, device=array.device)
