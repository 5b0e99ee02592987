"""What a robot may say of itself: sizes and ranges, which are checked before anything is built from them."""

from __future__ import annotations

import json

import numpy as np

# Bytes after the header of a message. No robot or description needs as many.
LARGEST_BODY = 65536
MOST_OUTPUTS, MOST_INPUTS = 1024, 256
LONGEST_NAME = 100  # characters
# s. A controller in Python answers 1000 measurements per second at most; a shorter timestep only fills its memory.
SHORTEST_TIMESTEP, LONGEST_TIMESTEP = 1e-4, 60.0
LARGEST_NUMBER = 1e9  # of a rest in m, and of a bound in the input unit
DEEPEST = 3  # lists in a list in an object, such as input_bounds

_DEEP = "the text of {} is nested too deeply; expected an object of numbers, names and lists of them"


def json_object(text: str, what: str) -> dict:
    """The JSON object in a text from the other end; what: such as "a HELLO". Raises ValueError for any other text."""
    try:
        content = json.loads(text, object_pairs_hook=_without_repetition)
    except RecursionError as error:
        raise ValueError(_DEEP.format(what)) from error
    except ValueError as error:
        raise ValueError(f"the text of {what} is not JSON: {error}") from error
    if not isinstance(content, dict):
        raise ValueError(f"the text of {what} is a JSON {type(content).__name__}; expected a JSON object")
    level = [content]
    for _ in range(DEEPEST):
        level = [part for each in level if isinstance(each, (dict, list))
                 for part in (each.values() if isinstance(each, dict) else each)]
    if any(isinstance(each, (dict, list)) for each in level):
        raise ValueError(_DEEP.format(what))
    return content


def names(what: str, given, most: int) -> tuple[str, ...]:
    """Different names of outputs or inputs. Raises ValueError where there are too many, or where one cannot be read."""
    if isinstance(given, (str, bytes)) or not hasattr(given, "__len__"):
        raise ValueError(f"the robot's {what} are {legible(repr(given))}; expected a list of names")
    if len(given) > most:
        raise ValueError(f"the robot has {len(given)} {what}; expected {most} at most")
    found = tuple(name(f"a name in the robot's {what}", each) for each in given)
    if len(set(found)) != len(found):
        twice = next(each for each in found if found.count(each) > 1)
        raise ValueError(f"the robot's {what} have {twice!r} twice; expected different names")
    return found


def name(what: str, given) -> str:
    """A text that can be shown. Raises ValueError for any other value."""
    if not isinstance(given, str) or not 0 < len(given) <= LONGEST_NAME or not given.isprintable():
        raise ValueError(f"{what} is {legible(repr(given))}; expected a text of 1 to {LONGEST_NAME} printable "
                         "characters")
    return str(given)


def numbers(what: str, given) -> np.ndarray:
    """An array of numbers. Raises ValueError where they are not finite, or larger than any robot's."""
    try:
        found = np.array(given, dtype=np.float64)
    except (TypeError, OverflowError) as error:
        raise ValueError(f"the robot's {what} cannot be read as numbers: {error}") from error
    if not (np.abs(found) <= LARGEST_NUMBER).all():
        raise ValueError(f"the robot's {what} is {legible(str(found.tolist()))}; expected finite numbers of "
                         f"{LARGEST_NUMBER:g} at most")
    return found


def timestep(given) -> float:
    """A timestep, s. Raises ValueError outside the range of those that a controller can serve."""
    usable = isinstance(given, (int, float, np.floating)) and not isinstance(given, bool)
    if not (usable and SHORTEST_TIMESTEP <= given <= LONGEST_TIMESTEP):
        raise ValueError(f"the robot's timestep is {legible(repr(given))}; expected a positive number of s, from "
                         f"{SHORTEST_TIMESTEP:g} to {LONGEST_TIMESTEP:g}")
    return float(given)


def legible(text: str, longest: int = 200) -> str:
    """A text of the other end, or one made of it, for a log or a message: short, in one line, only what can be shown.
    """
    shown = "".join(character if character.isprintable() else "?" for character in text[:longest])
    return shown if len(text) <= longest else f"{shown}… ({len(text)} characters)"


def _without_repetition(pairs: list[tuple[str, object]]) -> dict:
    content = dict(pairs)
    if len(content) != len(pairs):
        raise ValueError("a key is there twice; expected every key once")
    return content
