"""Silences lines of libraries that do not concern the user, and gives these libraries a place for their caches."""

from __future__ import annotations

import logging
import os
import sys
import warnings

from ssmr_torch.own_folder import has_home, own_folder

# Variables that name the folder of a library's cache, and the folder's name; each library looks below "~" without it.
CACHES = {"MPLCONFIGDIR": "matplotlib", "XDG_CACHE_HOME": "cache", "XDG_CONFIG_HOME": "config",
          "TORCHINDUCTOR_CACHE_DIR": "torch", "WANDB_CONFIG_DIR": "wandb", "WANDB_CACHE_DIR": "wandb"}
LIGHTNING = "lightning.pytorch.utilities.rank_zero"


def quiet() -> None:
    """Silence Lightning's log lines about missing accelerators and its services, and deprecation warnings inside it."""
    print_anything()
    if not has_home():
        settle()
    logging.getLogger(LIGHTNING).setLevel(logging.WARNING)
    for message in (".*LeafSpec", ".*torch.jit.script", ".*does not have many workers", ".*Checkpoint directory"):
        warnings.filterwarnings("ignore", message)


def print_anything() -> None:
    """Let a terminal that cannot show a character show a question mark; without this, printing it is an error. Files of
    the log are in UTF-8.
    """
    for stream in (sys.stdout, sys.stderr):
        if getattr(stream, "errors", None) in ("strict", "surrogateescape"):
            stream.reconfigure(errors="replace")
    for handler in logging.getLogger().handlers:
        if isinstance(handler, logging.FileHandler) and hasattr(handler.stream, "reconfigure"):
            handler.stream.reconfigure(encoding="utf-8", errors="replace")


def settle() -> None:
    """Let the caches of libraries lie in `own_folder`, where there is no home; what the user has set stays."""
    folder = own_folder()
    if folder is not None:
        for variable, name in CACHES.items():
            if variable not in os.environ:
                (folder / name).mkdir(exist_ok=True)
                os.environ[variable] = str(folder / name)
