"""What a search varies: Hydra's ranges as distributions of Optuna, and values of Optuna as overrides of Hydra."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.core.override_parser.types import Override, Transformer
from optuna.distributions import BaseDistribution, CategoricalDistribution, FloatDistribution, IntDistribution


def space_of(arguments: Sequence[str]) -> tuple[dict[str, BaseDistribution], dict[str, str]]:
    """What is searched, key → distribution, and what holds for every trial, key → override as it was given.

    arguments: overrides of the command line; of two with one key the later one holds. choice(a, b) and a,b are
    categories, range(a, b) whole steps up to but without b, interval(a, b) all between, tag(log, …) on a logarithmic
    scale. Raises ValueError for an interval that is empty.
    """
    searched, fixed = {}, {}
    for override in OverridesParser.create().parse_overrides(list(arguments)):
        key = override.get_key_element()
        searched.pop(key, None), fixed.pop(key, None)
        if override.is_sweep_override():
            searched[key] = _distribution(override)
        else:
            fixed[key] = override.input_line
    return searched, fixed


def overrides_of(values: Mapping[str, object], fixed: Mapping[str, str]) -> list[str]:
    """The overrides of a trial with these values."""
    return [*fixed.values(), *(f"{key}={_written(value)}" for key, value in values.items())]


def _distribution(override: Override) -> BaseDistribution:
    swept = override.value()
    if override.is_interval_sweep():
        whole = isinstance(swept.start, int) and isinstance(swept.end, int)
        kind = IntDistribution if whole else FloatDistribution
        try:
            return kind(swept.start, swept.end, log="log" in swept.tags)
        except ValueError as error:
            raise ValueError(f"{override.input_line}: {error}") from error
    if override.is_range_sweep():
        steps = list(override.sweep_iterator())
        if steps and not swept.shuffle:
            kind = IntDistribution if all(isinstance(step, int) for step in steps) else FloatDistribution
            return kind(min(steps), max(steps), step=abs(swept.step))
    return CategoricalDistribution(list(override.sweep_iterator(transformer=Transformer.encode)))


def _written(value) -> str:
    if value is None:
        return "null"
    return str(value).lower() if isinstance(value, bool) else str(value)
