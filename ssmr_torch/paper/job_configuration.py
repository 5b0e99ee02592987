"""What the result of a step depends on: its configuration as it is composed, down to the last parent of each file."""

from __future__ import annotations

import json
import re
from collections.abc import Sequence
from functools import cache

from ssmr_torch.configuration import written

# These say how the work is done and shown, and change no result.
WITHOUT_EFFECT = frozenset({"progress", "enable_progress_bar", "workers", "num_workers"})
SEED = re.compile(r"[\w.]*\bseed=\d+")


def configuration(entry: str, overrides: Sequence[str]) -> str:
    """The composed configuration of an entry point as a text that changes where a result may.

    Interpolations stay as they are written: what they point at is in the text, or is a directory of the run. Composing
    takes about 0.1 s, so that is done once for all seeds. Raises Hydra's ConfigCompositionException for overrides that
    the configuration does not have.
    """
    seeds = [override for override in overrides if SEED.fullmatch(override)]
    return json.dumps([_text(entry, tuple(override for override in overrides if override not in seeds)), seeds])


@cache
def _text(entry: str, overrides: tuple[str, ...]) -> str:
    return json.dumps(_decisive(written(entry, overrides)), sort_keys=True)


def _decisive(node):
    if isinstance(node, dict):
        return {str(key): _decisive(value) for key, value in node.items() if key not in WITHOUT_EFFECT}
    return [_decisive(value) for value in node] if isinstance(node, list) else node
