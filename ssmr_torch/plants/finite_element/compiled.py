"""How numba compiles the kernels of elements, cables and solvers."""

from __future__ import annotations

from ssmr_torch.compiled_functions import compiled

# Fused multiply-adds are allowed. A division by zero gives infinity and no exception; the step then reports divergence.
kernel = compiled(error_model="numpy", fastmath={"contract"})
