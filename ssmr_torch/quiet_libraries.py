"""What others say that nobody asked for."""

from __future__ import annotations

import logging
import warnings

LIGHTNING = "lightning.pytorch.utilities.rank_zero"


def quiet() -> None:
    """Silence what Lightning says about absent hardware and its services, and deprecations inside it."""
    logging.getLogger(LIGHTNING).setLevel(logging.WARNING)
    for message in (".*LeafSpec", ".*torch.jit.script", ".*does not have many workers", ".*Checkpoint directory"):
        warnings.filterwarnings("ignore", message)
