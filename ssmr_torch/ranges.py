"""Ranges of settings: what each may be, in one sentence."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from math import inf
from numbers import Real

import numpy as np

LONGEST = 60  # characters of a wrong value that a message repeats


class Range:
    """What a setting may be: `said` in words. Called as range(name, value), it returns the value, whole numbers as
    integers, and raises ValueError for one outside of it.
    """

    said = "another value"

    def fits(self, value) -> bool:
        raise NotImplementedError

    def kept(self, value):
        """The value as a program takes it."""
        return value

    def __call__(self, name: str, value):
        value = plain(value)
        if not self.fits(value):
            self.refuse(name, value)
        return self.kept(value)

    def refuse(self, name: str, value, said: str = ""):
        raise ValueError(f"{name} is {shown(value)}; expected {said or self.said}")


class Number(Range):
    """A number from `least` to `most`, in `unit`; above: `least` itself is excluded; infinite: ±inf fits as well."""

    def __init__(self, least: float = -inf, most: float = inf, unit: str = "", *, above: bool = False,
                 infinite: bool = False):
        self.least, self.most, self.unit, self.above, self.infinite = least, most, unit, above, infinite
        self.said = f"a number {_span(least, most, above)}{f' {unit}' if unit else ''}{', or inf' * infinite}"

    def fits(self, value) -> bool:
        if self.infinite and value in ("inf", "-inf"):  # as a file has it
            value = float(value)
        if not is_number(value) or value != value:
            return False
        if abs(value) == inf:
            return self.infinite and (value > 0 or self.least < 0)
        return (self.least < value if self.above else self.least <= value) and value <= self.most

    def kept(self, value):
        return value if isinstance(value, int) else float(value)

    def refuse(self, name: str, value, said: str = ""):
        unit = f" {self.unit}" if self.unit and is_number(value) else ""
        raise ValueError(f"{name} is {shown(value)}{unit}; expected {said or self.said}")


class Whole(Range):
    """A whole number from `least` to `most`; 5.0 is one, 1.5 and true are none."""

    def __init__(self, least: int, most: int):
        self.least, self.most = least, most
        self.said = f"a whole number from {least} to {most}"

    def fits(self, value) -> bool:
        return is_number(value) and self.least <= value <= self.most and value == value // 1

    def kept(self, value):
        return int(value)


class Truth(Range):
    """true or false."""

    said = "true or false"

    def fits(self, value) -> bool:
        return isinstance(value, (bool, np.bool_))


class Text(Range):
    """A text that is not blank, of at most `most` characters."""

    def __init__(self, said: str = "a text", most: int = 4000):
        self.said, self.most = said, most

    def fits(self, value) -> bool:
        return isinstance(value, str) and bool(value.strip()) and len(value) <= self.most and "\0" not in value


class PathText(Text):
    """The path of a file or folder, as text or pathlib.Path."""

    def __init__(self, said: str = "the path of a file or folder"):
        super().__init__(said)

    def fits(self, value) -> bool:
        return super().fits(str(value) if hasattr(value, "__fspath__") else value)


class Address(Range):
    """An address of ZeroMQ, such as tcp://*:5555, whose port is from 1 to 65535, or * for one that the system chooses.
    """

    said = "an address such as tcp://192.168.0.2:5555, whose port is from 1 to 65535, or ipc://FILE"

    def fits(self, value) -> bool:
        if not isinstance(value, str) or "\0" in value:
            return False
        found = re.fullmatch(r"tcp://(\S+):(\*|[0-9]{1,5})", value)
        if found:
            return found[2] == "*" or 1 <= int(found[2]) <= 65535
        return re.fullmatch(r"(ipc|inproc)://\S+", value) is not None


class OneOf(Range):
    """One of some values, by name."""

    def __init__(self, *choices):
        self.choices = choices
        self.said = f"one of {', '.join(map(str, choices))}"

    def fits(self, value) -> bool:
        return any(type(value) is type(choice) and value == choice for choice in self.choices)


class OrNone(Range):
    """Another range, or None (null in a configuration)."""

    def __init__(self, inner: Range):
        self.inner, self.said = inner, f"{inner.said}, or null"

    def fits(self, value) -> bool:
        return value is None or self.inner.fits(value)

    def __call__(self, name: str, value):
        if value is None:
            return None
        value = plain(value)
        if not isinstance(self.inner, (Each, ByName, OneOrEach)) and not self.inner.fits(value):
            self.inner.refuse(name, value, self.said)
        return self.inner(name, value)


class Each(Range):
    """A list of `least` to `most` values that fit another range."""

    def __init__(self, inner: Range, least: int = 1, most: int = 100_000):
        self.inner, self.least, self.most = inner, least, most
        number = f"{least}" if least == most else f"{least} to {most}"
        self.said = f"a list of {number} values, each {inner.said}"

    def fits(self, value) -> bool:
        return is_list(value) and self.least <= len(value) <= self.most and all(self.inner.fits(plain(each))
                                                                                for each in value)

    def __call__(self, name: str, value):
        if not is_list(value) or not self.least <= len(value) <= self.most:
            count = f" of {len(value)} values" if is_list(value) else ""
            raise ValueError(f"{name} is {shown(value)}{count}; expected {self.said}")
        for place, each in enumerate(value):
            self.inner(f"{name}[{place}]", each)
        return value


class ByName(Range):
    """A mapping from names, any or these `names`, to values that fit another range."""

    def __init__(self, inner: Range, names: Sequence[str] = ()):
        self.inner, self.names = inner, tuple(names)
        self.said = f"a mapping of {', '.join(names) or 'names'} to {inner.said}"

    def fits(self, value) -> bool:
        return isinstance(value, Mapping) and (not self.names or set(value) <= set(self.names)) and all(
            isinstance(key, str) and self.inner.fits(plain(each)) for key, each in value.items())

    def __call__(self, name: str, value):
        if not isinstance(value, Mapping):
            raise ValueError(f"{name} is {shown(value)}; expected {self.said}")
        for key, each in value.items():
            if not isinstance(key, str):
                raise ValueError(f"{name} has the name {shown(key)}; expected {self.said}")
            if self.names and key not in self.names:
                raise ValueError(f"{name} has no {key}; expected {', '.join(self.names)}")
            self.inner(f"{name}.{key}", each)
        return value


class Either(Range):
    """What fits one of several ranges."""

    def __init__(self, *ranges: Range, said: str = ""):
        self.ranges, self.said = ranges, said or ", or ".join(each.said for each in ranges)

    def fits(self, value) -> bool:
        return any(each.fits(value) for each in self.ranges)

    def kept(self, value):
        return next(each for each in self.ranges if each.fits(value)).kept(value)


class OneOrEach(Either):
    """A value that fits, or a list with one for each input, attempt or the like."""

    def __init__(self, inner: Range, of_each: str):
        super().__init__(inner, Each(inner), said=f"{inner.said}, or a list with one for each {of_each}")

    def __call__(self, name: str, value):
        if is_list(value):
            return self.ranges[1](name, value)
        return self.ranges[0](name, value) if is_number(value) else super().__call__(name, value)


class Function(Range):
    """A function, or an object that is called like one."""

    said = "a function"

    def fits(self, value) -> bool:
        return callable(value)


class Made(Range):
    """An object, or in a configuration what one is made from."""

    said = "a mapping with a _target_"

    def fits(self, value) -> bool:
        return value is not None and not is_list(value) and not isinstance(value, (str, bytes, Real))


class Anything(Range):
    """What its taker checks by itself, in its own sentence."""

    def fits(self, value) -> bool:
        return True


def is_number(value) -> bool:
    """Whether a value is a real number; true and false are none."""
    return isinstance(value, Real) and not isinstance(value, (bool, np.bool_))


def is_list(value) -> bool:
    """Whether a value is a list, a tuple, an array or another sequence, and no text."""
    return isinstance(value, (Sequence, np.ndarray)) and not isinstance(value, (str, bytes)) and np.ndim(
        value if isinstance(value, np.ndarray) else [0]) > 0


def plain(value):
    """An array without axes as the number that it holds; anything else as it is."""
    return value.item() if isinstance(value, (np.ndarray, np.generic)) and np.ndim(value) == 0 else value


def shown(value) -> str:
    """A wrong value as a message repeats it, on one line and shortened."""
    try:
        text = " ".join(repr(value).split())
    except ValueError:  # an integer of more digits than Python prints
        text = "a number of thousands of digits"
    return text if len(text) <= LONGEST else f"{text[:LONGEST]}…"


def _span(least: float, most: float, above: bool) -> str:
    """The numbers of a range in words."""
    low, high = (f"{each:.15g}" if each != float(f"{each:g}") else f"{each:g}" for each in (least, most))
    if least == -inf and most == inf:
        return "that is finite"
    if most == inf:
        return f"above {low}" if above else f"of {low} or more"
    return f"above {low} and up to {high}" if above else f"from {low} to {high}"
