"""What the two JSON files of an artifact must hold; whatever else they say is refused by name before it is used."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np

from ssmr_torch import checksum
from ssmr_torch.models.base import Model

LONGEST_NAME = 1000  # characters
# The entries that every card must have, with their types.
CARD = {"format": str, "kind": str, "model": dict, "sha256": dict, "name": str, "units": dict, "output_names": list,
        "input_names": list, "rest": list, "input_range": list}
# The entries that controller.json must have, with their types.
DESIGNED = {"controller": dict, "tracked": list, "input_bounds": list, "timestep": float, "facts": dict}


def refuse_card(path: Path, card: object, model: Model | None = None) -> None:
    """Raises ValueError, with the names, for a card with missing entries; with a model, for entries that do not fit it.
    """
    missing = [name for name in CARD if not isinstance(card, dict) or not isinstance(card.get(name), CARD[name])]
    if missing:
        raise ValueError(f"{path} is not the card of an artifact: it has no {', '.join(missing)}; export the model "
                         "again")
    if model is None:
        return
    p, m = model.output_dim, model.input_dim
    fits: dict[str, Callable[[object], bool]] = {
        "name": _is_name, "units": lambda given: _is_name(given.get("input")),
        "output_names": lambda given: len(given) == p and all(map(_is_name, given)),
        "input_names": lambda given: len(given) == m and all(map(_is_name, given)),
        "rest": lambda given: _has_shape(given, (p,)),
        "input_range": lambda given: _has_shape(given, (2, m)) and all(np.less(*given)),
        "output_range": lambda given: given is None or _has_shape(given, (2, p)),
        "sampling_time": lambda given: given is None or _has_shape(given, ()) and given > 0,
        "scores": lambda given: given is None or isinstance(given, dict)
        and all(value is None or _has_shape(value, ()) for value in given.values()),
        "cost": lambda given: given is None or isinstance(given, dict)
        and all(_has_shape(value, ()) for value in given.values()),
        "provenance": lambda given: given is None or isinstance(given, dict)}
    wrong = [name for name, right in fits.items() if not right(card.get(name))]
    if wrong:
        raise ValueError(f"{path} has {wrong[0]}: {card.get(wrong[0])!r:.100}, which does not fit a model of {p} "
                         f"outputs and {m} inputs; export the model again")


def refuse_designed(path: Path, model: Model) -> dict:
    """The content of controller.json. Raises ValueError for missing entries, and for entries that do not fit the model.
    """
    designed = checksum.parsed(path)
    missing = [name for name, kind in DESIGNED.items() if not isinstance(designed, dict)
               or not isinstance(designed.get(name), kind)]
    if missing:
        raise ValueError(f"{path} is not a designed controller: it has no {', '.join(missing)}; design it again")
    right = {"input_bounds": _has_shape(designed["input_bounds"], (2, model.input_dim)),
             "timestep": 0 < designed["timestep"] < np.inf,
             "tracked": all(_is_name(each) or type(each) is int for each in designed["tracked"])}
    wrong = [name for name, fits in right.items() if not fits]
    if wrong:
        raise ValueError(f"{path} has {wrong[0]}: {designed[wrong[0]]!r:.100}, which does not fit a model of "
                         f"{model.input_dim} inputs; design it again")
    return designed


def _is_name(given: object) -> bool:
    return isinstance(given, str) and len(given) <= LONGEST_NAME


def _has_shape(given: object, shape: tuple[int, ...]) -> bool:
    """Whether plain values are finite numbers in lists of this shape."""
    if not shape:
        return isinstance(given, (int, float)) and not isinstance(given, bool) and abs(given) < 1e300
    return isinstance(given, list) and len(given) == shape[0] and all(_has_shape(each, shape[1:]) for each in given)
