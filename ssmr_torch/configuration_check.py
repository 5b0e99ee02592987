"""A configuration against the declared ranges, before anything is built: each refusal names the key and what fits it.

What stands below a `_target_` is checked by what that class or function declares (`ranges.checked`), what stands at the
top by `command_ranges`. So a command and Python refuse the same.
"""

from __future__ import annotations

import inspect
from collections.abc import Iterable, Iterator, Mapping
from difflib import get_close_matches
from functools import cache
from importlib import import_module
from pkgutil import resolve_name

from ssmr_torch.checked_arguments import ranges_of
from ssmr_torch.command_ranges import OF_ANY, OF_COMMANDS, OF_LIBRARIES
from ssmr_torch.quantities import TRUTH
from ssmr_torch.ranges import OneOf, Range, shown

NOT_GIVEN = "???"  # Hydra's mark of a key without a value; what needs it says so
OF_HYDRA: dict[str, Range] = {"_partial_": TRUTH, "_recursive_": TRUTH,
                              "_convert_": OneOf("none", "partial", "object", "all")}
OBJECTS = "a mapping with a _target_, or a list of them"


def check_values(command: str, values: Mapping, extra: Mapping[str, Range] | None = None) -> None:
    """Raises ValueError for the first value that no setting of its name can have, with its dotted key.

    command: such as serve_controller; values: its configuration as plain values. extra: ranges of further keys.
    """
    ranges = OF_ANY | OF_COMMANDS.get(command, {}) | (extra or {})
    for key, value in values.items():
        _check(str(key), value, ranges)


def _check(key: str, value, ranges: Mapping[str, Range]) -> None:
    if is_left_open(value) or key in ("hydra", "found"):
        return
    if key in ranges:
        ranges[key](key, value)
    elif isinstance(value, Mapping) and "_target_" in value:
        _check_target(key, value)
    elif isinstance(value, Mapping):
        for name, each in value.items():
            _check(f"{key}.{name}", each, ranges)
    elif isinstance(value, list):
        for place, each in enumerate(value):
            if isinstance(each, (Mapping, list)):
                _check(f"{key}[{place}]", each, ranges)


def _check_target(key: str, node: Mapping) -> None:
    """Check the arguments of what a `_target_` names."""
    target = node["_target_"]
    if not isinstance(target, str) or "." not in target or not exists(target):
        raise ValueError(f"{key}._target_ is {shown(target)}; expected the dotted name of a class or function")
    ranges, defaults = declared(target)
    for name, value in node.items():
        where = f"{key}.{name}"
        if name in OF_HYDRA:
            OF_HYDRA[name](where, value)
        elif name.startswith("_") or value == NOT_GIVEN:
            continue
        elif defaults is not None and name not in defaults:
            raise ValueError(f"{where} is no setting of {target.rpartition('.')[2]}{_near(name, defaults)}")
        elif is_left_open(value):
            if name in ranges:
                raise ValueError(f"{where} is {shown(value)}, which names nothing; expected {ranges[name].said}")
        else:
            _check_argument(where, value, ranges.get(name), defaults and defaults[name])


def _check_argument(where: str, value, range_: Range | None, default) -> None:
    """default: of an argument without a range, which takes an object; None where anything may be given."""
    nested = list(_targets(where, value))
    for place, node in nested:
        _check_target(place, node)
    if nested:
        return
    if range_ is not None:
        range_(where, value)
    elif default is not None and (isinstance(value, (str, int, float)) or isinstance(value, list) and value
                                  or value is None and default.default is not None):
        raise ValueError(f"{where} is {shown(value)}; expected {OBJECTS}")


def is_left_open(value) -> bool:
    """Whether a value is not given, or an interpolation that nothing resolves: whoever needs it says so."""
    return isinstance(value, str) and (value == NOT_GIVEN or value.startswith("${"))


def _targets(where: str, value) -> Iterator[tuple[str, Mapping]]:
    """Mappings with a `_target_`: the value, or those in it where it is a list or a mapping."""
    if isinstance(value, Mapping) and "_target_" in value:
        yield where, value
    elif isinstance(value, Mapping):
        for name, each in value.items():
            yield from _targets(f"{where}.{name}", each)
    elif isinstance(value, list):
        for place, each in enumerate(value):
            yield from _targets(f"{where}[{place}]", each)


@cache
def exists(target: str) -> bool:
    """Whether a dotted name names something; True for what only a missing library keeps from being imported."""
    if target in OF_LIBRARIES:
        return True
    try:
        resolve_name(target)
    except (ImportError, AttributeError, ValueError):
        return _lacks_a_library(target)
    return True


def _lacks_a_library(target: str) -> bool:
    """Whether a module on the way to a name exists and imports what is not installed; `resolve_name` does not say."""
    parts = target.split(".")
    for count in range(len(parts) - 1, 0, -1):
        try:
            import_module(".".join(parts[:count]))
            return False
        except ModuleNotFoundError as error:
            if error.name and not f"{target}.".startswith(f"{error.name}."):
                return True
        except ImportError:
            return True
        except ValueError:
            return False
    return False


@cache
def declared(target: str) -> tuple[dict[str, Range], Mapping[str, inspect.Parameter] | None]:
    """Ranges that a class or function declares, and its arguments by name; None where it declares no ranges or takes
    any name. Both are empty for what cannot be imported: building it says why.
    """
    if target in OF_LIBRARIES:
        return OF_LIBRARIES[target], None
    try:
        thing = resolve_name(target)
        parameters = inspect.signature(thing).parameters
    except (ImportError, AttributeError, ValueError, TypeError):
        return {}, None
    ranges = ranges_of(thing)
    anything = any(each.kind is each.VAR_KEYWORD for each in parameters.values())
    return ranges, None if anything or not ranges else parameters


def _near(name: str, names: Iterable[str]) -> str:
    near = get_close_matches(name, names, n=1)
    return f"; did you mean {near[0]}?" if near else f"; expected one of {', '.join(names)}"
