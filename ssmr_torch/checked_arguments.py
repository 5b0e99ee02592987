"""What the arguments of a function or class may be, declared once beside them, and checked before any work.

`checked(horizon=Whole(1, 500))` decorates a function, a constructor or a class; its arguments are then checked at each
call, and a command checks its configuration by the same declaration (`configuration_check`) before it builds anything.
"""

from __future__ import annotations

import functools
import inspect
from collections.abc import Callable, Mapping
from typing import TypeVar

from ssmr_torch.ranges import Range

F = TypeVar("F", bound=Callable)


def checked(**ranges: Range) -> Callable[[F], F]:
    """Decorate a function, constructor or class: at each call these arguments are checked, and whole numbers become
    integers. `ranges_of` reads the declaration. Raises TypeError for a name that is no argument.
    """
    def decorate(thing):
        if isinstance(thing, type):
            thing.__init__ = _checking(thing.__init__, ranges)
            return thing
        return _checking(thing, ranges)

    return decorate


def _checking(function, ranges: Mapping[str, Range]):
    names = list(inspect.signature(function).parameters)
    if unknown := set(ranges) - set(names):
        raise TypeError(f"{function.__qualname__} takes no {', '.join(sorted(unknown))}")
    positions = {name: place for place, name in enumerate(names)}

    @functools.wraps(function)
    def call(*given, **named):
        if any(name in named for name in ranges):
            named = {name: ranges[name](name, value) if name in ranges else value for name, value in named.items()}
        places = {positions[name]: name for name in ranges if positions[name] < len(given)}
        if places:
            given = tuple(ranges[places[place]](places[place], value) if place in places else value
                          for place, value in enumerate(given))
        return function(*given, **named)

    call.ranges = dict(getattr(function, "ranges", {})) | dict(ranges)
    return call


def ranges_of(thing) -> dict[str, Range]:
    """The ranges that a function or class declares, with those of its bases and of what it hands its keywords on to."""
    if isinstance(thing, type):
        found: dict[str, Range] = {}
        for each in reversed(thing.__mro__):
            found |= getattr(each.__dict__.get("__init__"), "ranges", {})
            found |= each.__dict__.get("ranges", {})
            source = getattr(each.__dict__.get("__init__"), "source", None)
            found = (ranges_of(source) if source is not None else {}) | found
        return found
    source = getattr(thing, "source", None)
    if callable(thing):
        return (ranges_of(source) if source is not None else {}) | getattr(thing, "ranges", {})
    return ranges_of(type(thing))
