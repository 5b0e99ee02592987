"""What every worker process of this machine begins with."""

from __future__ import annotations

from ssmr_torch.interruption import belong_to

SINGLE = dict.fromkeys(("OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS", "NUMBA_NUM_THREADS"), "1")

begin = belong_to
