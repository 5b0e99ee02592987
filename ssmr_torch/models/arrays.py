"""One set of array functions for NumPy and Torch, so that each model is written once.

The models use only what both libraries call by the same name and with the same positional arguments: concatenate,
stack, where, tanh, exp, ones_like, zeros_like, isfinite; `@`, arithmetic, `sum(-1)`, `swapaxes`, `reshape`. NumPy
arrays of objects, such as symbols of CasADi, work as well.
"""

from __future__ import annotations

from typing import Any

import numpy as np

Array = Any  # numpy.ndarray, or torch.Tensor on any device


def namespace(array: Array):
    """The library of an array: the module `numpy`, or the module `torch` for a tensor. Torch is imported only then."""
    if isinstance(array, np.ndarray):
        return np
    import torch

    return torch


def like(array: Array, values: np.ndarray) -> Array:
    """The values as an array of the same library and on the same device as `array`.

    Floating-point values take the precision of `array`; integers stay integers.
    """
    xp = namespace(array)
    if xp is np:
        return values
    return xp.as_tensor(values, dtype=array.dtype if values.dtype.kind == "f" else None, device=array.device)


def identity(array: Array, size: int) -> Array:
    """The identity matrix (size, size) as an array of the same library."""
    xp = namespace(array)
    return np.eye(size) if xp is np else xp.eye(size, dtype=array.dtype, device=array.device)
