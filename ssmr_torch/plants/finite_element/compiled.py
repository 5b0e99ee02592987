"""How numba compiles the kernels of elements, cables and solvers."""

from __future__ import annotations

from numba import njit

# Fused multiply-adds are allowed. A division by zero gives infinity and no exception; the step then reports divergence.
kernel = njit(cache=True, error_model="numpy", fastmath={"contract"})
