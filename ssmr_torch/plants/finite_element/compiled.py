"""How the element, cable and solver kernels are compiled."""

from __future__ import annotations

from numba import njit

# Fused multiply-adds; a division by zero gives infinity, which a step that diverges reports, not an exception.
kernel = njit(cache=True, error_model="numpy", fastmath={"contract"})
