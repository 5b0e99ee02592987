"""Lazy imports: a name of a package is imported only when it is used, so that importing the package is fast."""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping
from importlib import import_module
from operator import attrgetter
from typing import Any

from ssmr_torch.extras import remedy
from ssmr_torch.renamed import NAMES


def found(home: str) -> Any:
    """The object named by "module:attribute" or "module:Class.attribute"; "module:" is the module itself.

    Raises ModuleNotFoundError if a package is missing, and names the extra that installs it.
    """
    module, _, attribute = home.partition(":")
    try:
        imported = import_module(module)
    except ModuleNotFoundError as error:
        if remedy(error) is None:
            raise
        raise ModuleNotFoundError(remedy(error), name=error.name) from error
    return attrgetter(attribute)(imported) if attribute else imported


def lazily(package: str, homes: Mapping[str, str]) -> tuple[Callable[[str], object], Callable[[], list[str]]]:
    """`__getattr__` and `__dir__` for a package whose names are defined in other modules.

    homes: the place of each name, in the form of `found`. Other names raise AttributeError, which lists the names that
    exist, or says the new name of one that has moved.
    """
    def get(name: str) -> object:
        if moved := NAMES.get(f"{package}.{name}"):
            raise AttributeError(f"{package}.{name} is now {moved}", name=name, obj=sys.modules[package])
        if name not in homes:
            raise AttributeError(f"{package} has no {name!r}; it has {', '.join(sorted(homes))}", name=name,
                                 obj=sys.modules[package])
        setattr(sys.modules[package], name, found(homes[name]))
        return vars(sys.modules[package])[name]

    return get, lambda: sorted(homes)
