"""Names that are imported when they are asked for, so that a package which offers them costs nothing to import."""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping
from importlib import import_module
from operator import attrgetter

from ssmr_torch.extras import remedy
from ssmr_torch.renamed import NAMES


def found(home: str):
    """What "module:attribute" names, or "module:Class.attribute"; "module:" is the module itself.

    Raises ModuleNotFoundError, with the extra that brings it, where a package is missing.
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
    """`__getattr__` and `__dir__` of a package whose names live elsewhere; homes: of each name, as in `found`.

    Raises AttributeError for others, with the names that exist, or with the new name of one that has moved.
    """
    def get(name: str):
        if moved := NAMES.get(f"{package}.{name}"):
            raise AttributeError(f"{package}.{name} is now {moved}", name=name, obj=sys.modules[package])
        if name not in homes:
            raise AttributeError(f"{package} has no {name!r}; it has {', '.join(sorted(homes))}", name=name,
                                 obj=sys.modules[package])
        setattr(sys.modules[package], name, found(homes[name]))
        return vars(sys.modules[package])[name]

    return get, lambda: sorted(homes)
