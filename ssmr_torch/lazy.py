"""Names of a package that are imported when they are asked for, so that importing the package itself costs nothing."""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping
from importlib import import_module


def lazily(package: str, homes: Mapping[str, str]) -> tuple[Callable[[str], object], Callable[[], list[str]]]:
    """`__getattr__` and `__dir__` of a package that offers names which live elsewhere.

    homes: "module:attribute" of each name, "module:" where the name is that module. Raises AttributeError, with the
    names that exist, for others.
    """
    def get(name: str):
        if name not in homes:
            raise AttributeError(f"{package} has no {name!r}; it has {', '.join(sorted(homes))}", name=name,
                                 obj=sys.modules[package])
        module, _, attribute = homes[name].partition(":")
        found = import_module(module)
        found = getattr(found, attribute) if attribute else found
        setattr(sys.modules[package], name, found)
        return found

    return get, lambda: sorted(homes)
