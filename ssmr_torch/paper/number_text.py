"""How the report of a reproduction writes names, counts and numbers."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path

from ssmr_torch.evaluation import figures
from ssmr_torch.paper import published_numbers as published
from ssmr_torch.paper.verdicts import Run

MM, MS, PERCENT = 1e3, 1e3, 100.0


def ordered(names: Iterable[str], there: Iterable[str]) -> list[str]:
    """In the order of the figures' methods: the paper's, then ours and further ones."""
    order = list(dict.fromkeys([*published.METHODS, *there]))
    return sorted(names, key=order.index)


def of_each(methods: Mapping[str, Sequence[Run]]) -> str:
    """As "10 runs of each method"."""
    return f"{counted_runs({len(own) for own in methods.values()})} of each method"


def counted_runs(counts: set[int]) -> str:
    """As "1 run", or "9 to 10 runs"."""
    return f"{span(sorted(counts))} run{'s' * (max(counts) > 1)}"


def span(values: Sequence[float]) -> str:
    """The first and the last of sorted values, or the only one."""
    return f"{values[0]:g}" if len(values) == 1 else f"{values[0]:g} to {values[-1]:g}"


def unless_nan(value: float) -> float | None:
    return None if math.isnan(value) else value


def scaled(factor: float, value: float | None, missing: float | None = None) -> float | None:
    return missing if value is None else factor * value


def saver(directory: Path) -> Callable[..., Path]:
    """Saves a drawing below directory/figures by its name, and gives the path."""
    return lambda figure, name: figures.save(figure, directory / "figures" / f"{name}.svg")
