"""Silences log lines and warnings of libraries that do not concern the user, and gives them a place for their caches."""

from __future__ import annotations

import logging
import os
import warnings

from ssmr_torch.own_folder import has_home, own_folder

# Variables that name the folder of a library's cache, and the folder's name; each library looks below "~" without it.
CACHES = {"MPLCONFIGDIR": "matplotlib", "XDG_CACHE_HOME": "cache", "XDG_CONFIG_HOME": "config",
          "TORCHINDUCTOR_CACHE_DIR": "torch", "WANDB_CONFIG_DIR": "wandb", "WANDB_CACHE_DIR": "wandb"}
LIGHTNING = "lightning.pytorch.utilities.rank_zero"


def quiet() -> None:
    """Silence Lightning's log lines about missing accelerators and its services, and deprecation warnings inside it."""
    if not has_home():
        settle()
    logging.getLogger(LIGHTNING).setLevel(logging.WARNING)
    for message in (".*LeafSpec", ".*torch.jit.script", ".*does not have many workers", ".*Checkpoint directory"):
        warnings.filterwarnings("ignore", message)


def settle() -> None:
    """Let the caches of libraries lie in `own_folder`, where there is no home; what the user has set stays."""
    folder = own_folder()
    if folder is not None:
        for variable, name in CACHES.items():
            if variable not in os.environ:
                (folder / name).mkdir(exist_ok=True)
                os.environ[variable] = str(folder / name)
