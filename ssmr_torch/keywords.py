"""Decorator that shows in a function's signature the keywords that it passes on to another class or function."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import fields
from inspect import Parameter, signature


def configurable(source=None, *, given: tuple[str, ...] = ()) -> Callable:
    """Decorate a callable whose `**rest` goes to `source`: its signature then shows the keywords of `source` with their
    defaults.

    source: a class or function with its own defaults, or an instance of a dataclass, whose values are the defaults.
    given: parameters that the program sets and no configuration does (`ssmr_torch.configuration` reads both).
    """
    def decorate(function):
        function.source = source  # `ranges_of` reads it
        if source is not None:
            own = signature(function)
            kept = [p for p in own.parameters.values() if p.kind is not Parameter.VAR_KEYWORD]
            passed = [p.replace(kind=Parameter.KEYWORD_ONLY) for p in _taken(source) if p.name not in own.parameters]
            function.__signature__ = own.replace(parameters=kept + passed)
        return function

    return decorate


def _taken(source) -> list[Parameter]:
    if callable(source):
        return [p for p in signature(source).parameters.values()
                if p.kind in (Parameter.KEYWORD_ONLY, Parameter.POSITIONAL_OR_KEYWORD) and p.default is not p.empty]
    return [Parameter(f.name, Parameter.KEYWORD_ONLY, default=getattr(source, f.name), annotation=f.type)
            for f in fields(source)]
