"""Classes that a file names: only a module that was written for this package is imported for them."""

from __future__ import annotations

import ast
import importlib.util
import sys

from ssmr_torch.lazy import found

PACKAGE = __name__.partition(".")[0]
OWN = f"{PACKAGE}.models."  # where the classes of this package are that a file may name


def class_named(home: str, base: type) -> type:
    """The class "module:Class" that a file names, a subclass of `base`.

    Importing a module runs it, and a stranger's file may name any. A module of this package is imported from `OWN`
    only; another one if it is imported already, or if its source imports this package and defines the class.
    Raises ImportError or AttributeError for a class that is not installed, ValueError for one that may not be imported,
    TypeError for one that is no subclass.
    """
    module, _, name = str(home).partition(":")
    if not (name and all(part.isidentifier() for part in f"{module}.{name}".split("."))):
        raise TypeError(f"{str(home)[:100]!r} is no name of a class")
    if not _may_be_imported(module, name):
        raise ValueError(f"{module} was not written for {PACKAGE}, so that no file may name it; import {module} first "
                         "if you trust the file")
    kind = found(home)
    if not (isinstance(kind, type) and issubclass(kind, base)):
        raise TypeError(f"{home} is no {base.__name__}")
    return kind


def _may_be_imported(module: str, name: str) -> bool:
    if module.startswith(f"{PACKAGE}."):
        return module.startswith(OWN)
    if module in sys.modules:
        return True
    tree = ast.parse(_source(module))
    named = {alias.name for node in ast.walk(tree) if isinstance(node, ast.Import) for alias in node.names}
    named |= {node.module or "" for node in ast.walk(tree) if isinstance(node, ast.ImportFrom) and not node.level}
    classes = {node.name for node in tree.body if isinstance(node, ast.ClassDef)}
    return name.partition(".")[0] in classes and any(each.partition(".")[0] == PACKAGE for each in named)


def _source(module: str) -> str:
    """The source of a module, without importing it or the packages around it. Raises ModuleNotFoundError."""
    parts, places, spec = module.split("."), None, None
    for count in range(1, len(parts) + 1):
        whole = ".".join(parts[:count])
        finders = [importlib.util.find_spec] if count == 1 else [finder.find_spec for finder in sys.meta_path]
        found = (find(whole) if count == 1 else find(whole, places) for find in finders)
        spec = next((each for each in found if each is not None), None)
        if spec is None or not hasattr(spec.loader, "get_source"):
            raise ModuleNotFoundError(f"No module named {whole!r}", name=whole)
        places = spec.submodule_search_locations or []
    return spec.loader.get_source(module) or ""
