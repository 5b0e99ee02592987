"""Objects as JSON and back: `_target_` names a class or function, the other keys are its arguments."""

from __future__ import annotations

import reprlib
from collections.abc import Mapping, Sequence
from dataclasses import fields, is_dataclass
from functools import partial
from importlib import import_module
from math import isfinite, isnan

import numpy as np

from ssmr_torch.renamed import current

ROOMS = ("ssmr_torch.control.", "ssmr_torch.tasks.")
IMPORTING = ("solver_named", "_foreign")  # functions there that import what their arguments name


def build(settings: dict, *arguments, packages: Sequence[str] = (), **more):
    """Call the class or function that `_target_` names, with the arguments in the settings and those given here.

    packages: further packages whose contents the settings may name, in addition to control and tasks. The limit exists
    because a file must not decide which code runs.
    Raises ValueError for a target or solver in another package, for one that does not exist, and for unknown arguments.
    """
    target = settings.get("_target_") if isinstance(settings, dict) else None
    _refuse_elsewhere("_target_", target, packages)
    solver = settings.get("qp")
    if isinstance(solver, str) and ":" in solver and not solver.startswith("qpsolvers:"):
        _refuse_elsewhere("qp", solver.replace(":", "."), packages)
    module, _, name = current(target).rpartition(".")
    try:
        function = getattr(import_module(module), name)
    except (ModuleNotFoundError, AttributeError) as error:
        raise ValueError(f"cannot load {target}: {error}") from error
    home = getattr(function, "__module__", None) or ""
    elsewhere = home != module and not home.startswith(_rooms(packages))
    if target.startswith(ROOMS) and (elsewhere or name in IMPORTING):
        # what a module has imported from elsewhere may import or run anything
        raise ValueError(f"the settings name {target!r}, which no settings may call; expected a class or function that "
                         f"is defined in {' or '.join(_rooms(packages))}")
    given = {key: _built(value, packages) for key, value in settings.items() if not key.startswith("_")}
    try:
        return function(*arguments, **given, **more)
    except (TypeError, AttributeError, LookupError, ArithmeticError, MemoryError, RecursionError) as error:
        raise ValueError(f"{target} does not accept the arguments {reprlib.repr(given)}: {error}") from error


def _refuse_elsewhere(what: str, target, packages: Sequence[str]) -> None:
    rooms = _rooms(packages)
    if not isinstance(target, str) or not target.startswith(rooms):
        raise ValueError(f"the settings name {target!r} as {what}; expected a class or function in "
                         f"{' or '.join(rooms)}, or in a package that --package names")


def _rooms(packages: Sequence[str]) -> tuple[str, ...]:
    return (*ROOMS, *(f"{package}." for package in packages))


def _built(value, packages: Sequence[str]):
    """Build nested settings: an observer, to which the controller adds arguments later, or obstacles."""
    if isinstance(value, list):
        return [_built(part, packages) for part in value]
    if not (isinstance(value, dict) and "_target_" in value):
        return value
    made = partial(build, value, packages=packages)
    return made if value.get("_partial_") else made()


def written(value, what: str = "the value"):
    """A value as JSON, from which `build` makes exactly the same value again. An infinite number becomes text.

    Dataclasses, partial objects and classes are named by `_target_`; arrays and tuples become lists.
    Raises ValueError, with the position in `what`, for NaN and for objects without a name: a lambda, a function defined
    inside another one, a class outside of `ROOMS`.
    """
    if isinstance(value, (np.ndarray, np.generic)):
        value = value.tolist()
    if value is None or isinstance(value, (bool, int, str)):
        return value
    if isinstance(value, float):
        if isnan(value):
            raise ValueError(f"{what} is NaN (not a number); expected a number")
        return value if isfinite(value) else str(value)
    if isinstance(value, (list, tuple)):
        return [written(part, f"{what}[{k}]") for k, part in enumerate(value)]
    if isinstance(value, Mapping):
        return {str(key): written(part, f"{what}.{key}") for key, part in value.items()}
    if isinstance(value, partial) and value.func is build and value.args:
        return value.args[0]  # the text from which it was built
    if isinstance(value, partial) and not value.args:
        return {"_target_": _named(value.func, what), "_partial_": True, **written(value.keywords, what)}
    if is_dataclass(value) and not isinstance(value, type):
        return {"_target_": _named(type(value), what),
                **{field.name: written(getattr(value, field.name), f"{what}.{field.name}") for field in fields(value)}}
    return {"_target_": _named(value, what), "_partial_": True}


def _named(thing, what: str) -> str:
    name = f"{getattr(thing, '__module__', None)}.{getattr(thing, '__qualname__', '<locals>')}"
    if "<" in name or not name.startswith(ROOMS):
        raise ValueError(f"{what} is {thing!r}, which cannot be written to a file; expected numbers, texts, or a class "
                         f"or function at the top level of a module in {' or '.join(ROOMS)}")
    return name
