"""Silences log lines and warnings of libraries that do not concern the user."""

from __future__ import annotations

import logging
import warnings

LIGHTNING = "lightning.pytorch.utilities.rank_zero"


def quiet() -> None:
    """Silence Lightning's log lines about missing accelerators and its services, and deprecation warnings inside it."""
    logging.getLogger(LIGHTNING).setLevel(logging.WARNING)
    for message in (".*LeafSpec", ".*torch.jit.script", ".*does not have many workers", ".*Checkpoint directory"):
        warnings.filterwarnings("ignore", message)
