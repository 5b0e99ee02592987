"""`Settings`: base class of all settings objects, and the checks of numbers that they share."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import fields, replace
from difflib import get_close_matches
from typing import Self

import numpy as np

from ssmr_torch.data_sheet import DataSheet
from ssmr_torch.ranges import is_number


class Settings(DataSheet):
    """Base class of frozen dataclasses of settings, which are checked in `__post_init__`."""

    def data_sheet(self) -> tuple[str, dict]:
        """Every setting with its value."""
        return type(self).__name__, {field.name: str(getattr(self, field.name)) for field in fields(self)}

    def changed(self, **changes) -> Self:
        """A copy with these settings changed. Raises TypeError for an unknown name and names the nearest one."""
        refuse_unknown(type(self).__name__, changes, [field.name for field in fields(self)])
        return replace(self, **changes)

    def _set(self, name: str, value) -> None:
        object.__setattr__(self, name, value)


def refuse_unknown(whose: str, given: Iterable[str], known: list[str]) -> None:
    """Raises TypeError for the first unknown name, and names the nearest known one."""
    for name in given:
        if name not in known:
            near = get_close_matches(name, known, n=1, cutoff=0.0)[0]
            raise TypeError(f"{whose} has no {name}; did you mean {near}? Possible names are {', '.join(known)}")


def whole(name: str, value, *, least: int) -> int:
    """Raises ValueError unless value is a whole number of at least `least`."""
    if not is_number(value) or value != value // 1 or value < least:
        raise ValueError(f"{name} is {value!r}; expected a whole number, {least} or more")
    return int(value)


def positive(name: str, value, unit: str = "") -> float:
    """Raises ValueError unless value is a positive and finite number."""
    if not (is_number(value) and 0 < value < np.inf):
        raise ValueError(f"{name} is {_shown(value, unit)}; expected a positive and finite number")
    return float(value)


def non_negative(name: str, value, unit: str = "") -> float:
    """Raises ValueError unless value is a finite number of 0 or more."""
    if not (is_number(value) and 0 <= value < np.inf):
        raise ValueError(f"{name} is {_shown(value, unit)}; expected a finite number, 0 or more")
    return float(value)


def at_least(name: str, value, least: float, unit: str = "") -> float:
    """Raises ValueError unless value is a number of `least` or more; it may be infinite."""
    if not (is_number(value) and value >= least):
        raise ValueError(f"{name} is {_shown(value, unit)}; expected {least} or more")
    return float(value)


def positive_or_none(name: str, value, unit: str = "") -> float | tuple[float, ...] | None:
    """One positive and finite number, a tuple of them (one per input), or None. Raises ValueError for other values."""
    if value is None or np.ndim(value) == 0:
        return None if value is None else positive(name, value if is_number(value) else np.asarray(value)[()], unit)
    return tuple(positive(f"{name}[{i}]", each, unit) for i, each in enumerate(np.asarray(value).tolist()))


def _shown(value, unit: str) -> str:
    return f"{value!r} {unit}".rstrip()
