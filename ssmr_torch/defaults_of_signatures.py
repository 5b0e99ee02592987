"""Defaults of what a dotted path names, read from its source: nothing is imported, so that nothing heavy is."""

from __future__ import annotations

import ast
import operator
import sys
from dataclasses import dataclass
from functools import cache
from importlib.machinery import PathFinder
from importlib.metadata import PackageNotFoundError, requires
from importlib.util import find_spec
from pathlib import Path

OPERATIONS = {ast.Add: operator.add, ast.Sub: operator.sub, ast.Mult: operator.mul, ast.Div: operator.truediv,
              ast.Pow: operator.pow, ast.USub: operator.neg, ast.UAdd: operator.pos}
PLAIN = (int, float, bool, str, type(None))


class Unreadable(ValueError):
    """The source does not say it plainly: another language, a computed value, something that is not there."""


def keyword_defaults(target: str) -> dict:
    """Names and plain defaults of what may be given by keyword to the class or function `package.module.name`.

    Bases are followed to the first `__init__`, dataclasses field by field, constants to where they are assigned, and
    what `keywords.configurable` says of names that are handed on. Left out is what a program gives (`configurable`, or
    names in a class attribute `given`, also of a base), and what has no default, or one that is no number, text, truth
    value, None, list or mapping of these, or is no data by its annotation. Empty where there is no such source.
    """
    try:
        return dict(_taken(*_located(target)))
    except (Unreadable, SyntaxError, OSError):
        return {}


@dataclass(frozen=True)
class Module:
    """The top level of a source file: what each name is bound to there."""

    name: str
    path: Path
    bound: dict[str, ast.AST]


@cache
def module_named(name: str) -> Module:
    """Raises Unreadable where no Python source is found for it."""
    path = _source(name)
    bound = {}
    for node in ast.parse(path.read_text(encoding="utf-8")).body:
        if isinstance(node, (ast.ClassDef, ast.FunctionDef)):
            bound[node.name] = node
        elif isinstance(node, ast.Assign):
            bound |= {each.id: node.value for each in node.targets if isinstance(each, ast.Name)}
        elif isinstance(node, ast.AnnAssign) and isinstance(node.target, ast.Name) and node.value is not None:
            bound[node.target.id] = node.value
        elif isinstance(node, (ast.Import, ast.ImportFrom)):
            bound |= {(alias.asname or alias.name): node for alias in node.names}
    return Module(name, path, bound)


def is_library(name: str) -> bool:
    """Whether a top-level module came with Python, or by a distribution that does not require this one."""
    own = __name__.partition(".")[0]
    if name == own or name in sys.stdlib_module_names:
        return name != own
    spec = find_spec(name)
    places = list(spec.submodule_search_locations or [spec.origin]) if spec else []
    if not {"site-packages", "dist-packages"} & set(Path(places[0] or "").parts if places else ()):
        return False
    try:
        needed = requires(name) or []
    except PackageNotFoundError:
        return True
    return not any(each.replace("-", "_").startswith(own) for each in needed)


def _source(name: str) -> Path:
    """The file of a module; its parents are looked through, never imported."""
    top, *rest = name.split(".")
    try:
        spec = find_spec(top)
        for depth in range(1, len(rest) + 1):
            if spec is None or spec.submodule_search_locations is None:
                raise Unreadable(name)
            spec = PathFinder.find_spec(".".join([top, *rest[:depth]]), list(spec.submodule_search_locations))
    except (ImportError, ValueError) as error:
        raise Unreadable(name) from error
    if spec is None or not spec.origin or not spec.origin.endswith(".py"):
        raise Unreadable(name)
    return Path(spec.origin)


def _located(target: str) -> tuple[Module, ast.AST]:
    """The module that a target is defined in, and its definition."""
    module, _, name = target.rpartition(".")
    if not module:
        raise Unreadable(target)
    return _resolved(module_named(module), name)


def _resolved(module: Module, name: str) -> tuple[Module, ast.AST]:
    """Where a name of a module is defined, followed through imports."""
    node = module.bound.get(name)
    if node is None:
        raise Unreadable(f"{module.name}.{name}")
    if isinstance(node, ast.ImportFrom) and not node.level:
        if node.module == module.name:  # a package that imports its own modules, as torch does
            raise Unreadable(f"{module.name}.{name}")
        original = next(alias.name for alias in node.names if (alias.asname or alias.name) == name)
        return _resolved(module_named(node.module), original)
    if isinstance(node, ast.Name):
        return _resolved(module, node.id)
    return module, node


def _taken(module: Module, node: ast.AST) -> dict:
    """Keyword defaults of a definition; or of the instance of a dataclass that a constant is."""
    if isinstance(node, ast.FunctionDef):
        return _of_function(module, node)
    if isinstance(node, ast.ClassDef):
        return _of_class(module, node)
    if isinstance(node, ast.Call):
        made = _taken(*_named(module, node.func))
        return made | {given.arg: value(module, given.value) for given in node.keywords if given.arg}
    raise Unreadable(module.name)


def _named(module: Module, node: ast.AST) -> tuple[Module, ast.AST]:
    if isinstance(node, ast.Name):
        return _resolved(module, node.id)
    if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name):
        where, imported = _resolved(module, node.value.id)
        if isinstance(imported, ast.Import):
            return _resolved(module_named(imported.names[0].name), node.attr)
        return where, _member(where, imported, node.attr)
    raise Unreadable(module.name)


def _member(module: Module, node: ast.AST, name: str) -> ast.AST:
    """The value that a class gives one of its own names."""
    for each in getattr(node, "body", []):
        target = each.target if isinstance(each, ast.AnnAssign) else each.targets[0] if isinstance(each, ast.Assign) \
            else None
        if isinstance(target, ast.Name) and target.id == name and each.value is not None:
            return each.value
    raise Unreadable(f"{module.name}: {name}")


def _of_class(module: Module, node: ast.ClassDef) -> dict:
    given = _given(module, node)
    return {name: default for name, default in _constructor(module, node).items() if name not in given}


def _given(module: Module, node: ast.ClassDef) -> list[str]:
    """What the class attribute `given` names, of the class or the first base that has one."""
    try:
        return value(module, _member(module, node, "given"))
    except Unreadable:
        for base in node.bases:
            try:
                where, found = _named(module, base)
            except Unreadable:
                continue
            if isinstance(found, ast.ClassDef) and (names := _given(where, found)):
                return names
        return []


def _constructor(module: Module, node: ast.ClassDef) -> dict:
    for each in node.body:
        if isinstance(each, ast.FunctionDef) and each.name == "__init__":
            return _of_function(module, each)
    taken = {}
    for base in node.bases:
        try:
            taken |= _taken(*_named(module, base))
        except Unreadable:
            continue
    if any("dataclass" in ast.unparse(decorator) for decorator in node.decorator_list):
        for each in node.body:
            if isinstance(each, ast.AnnAssign) and isinstance(each.target, ast.Name) and each.value is not None:
                taken |= _readable(module, each.target.id, each.annotation, each.value)
    return taken


def _of_function(module: Module, node: ast.FunctionDef) -> dict:
    source, given = _decorated(node)
    arguments = node.args
    ordinary = [*arguments.posonlyargs, *arguments.args]
    paired = [*zip(ordinary[len(ordinary) - len(arguments.defaults):], arguments.defaults),
              *zip(arguments.kwonlyargs, arguments.kw_defaults)]
    taken = {}
    for argument, default in paired:
        if default is not None and argument not in arguments.posonlyargs:
            taken |= _readable(module, argument.arg, argument.annotation, default)
    if source is not None:
        own = {argument.arg for argument in [*ordinary, *arguments.kwonlyargs]}
        taken |= {name: default for name, default in _taken(*_named(module, source)).items() if name not in own}
    return {name: default for name, default in taken.items() if name not in given}


def _decorated(node: ast.FunctionDef) -> tuple[ast.AST | None, tuple[str, ...]]:
    """What `keywords.configurable` says: whose names the rest are, and the names that a program gives."""
    for decorator in node.decorator_list:
        if isinstance(decorator, ast.Call) and getattr(decorator.func, "id", None) == "configurable":
            given = next((ast.literal_eval(each.value) for each in decorator.keywords if each.arg == "given"), ())
            return (decorator.args[0] if decorator.args else None), tuple(given)
    return None, ()


def _readable(module: Module, name: str, annotation: ast.AST | None, default: ast.AST) -> dict:
    """{name: default} where both are data."""
    if annotation is not None and not _is_data(ast.unparse(annotation)):
        return {}
    try:
        return {name: value(module, default)}
    except Unreadable:
        return {}


def _is_data(annotation: str) -> bool:
    """Whether one of the annotation's alternatives is data: what YAML can write down."""
    data = ("int", "float", "str", "bool", "list", "tuple", "dict", "Sequence", "Mapping", "Iterable", "np.ndarray",
            "Any", "Literal")
    alternatives = [each.strip().strip("'\"").partition("[")[0] for each in annotation.split("|")]
    return any(each in data for each in alternatives)


def value(module: Module, node: ast.AST):
    """What a plain expression is worth; sequences are lists. Raises Unreadable for any other."""
    if isinstance(node, ast.Constant) and isinstance(node.value, PLAIN):
        return node.value
    if isinstance(node, (ast.Tuple, ast.List)):
        return [each for part in node.elts for each in (value(module, part.value) if isinstance(part, ast.Starred)
                                                        else [value(module, part)])]
    if isinstance(node, ast.Dict) and None not in node.keys:
        return {value(module, key): value(module, each) for key, each in zip(node.keys, node.values)}
    if isinstance(node, ast.UnaryOp) and type(node.op) in OPERATIONS:
        return OPERATIONS[type(node.op)](value(module, node.operand))
    if isinstance(node, ast.BinOp) and type(node.op) in OPERATIONS:
        return OPERATIONS[type(node.op)](value(module, node.left), value(module, node.right))
    if isinstance(node, ast.Call):
        return _called(module, node)
    if isinstance(node, (ast.Name, ast.Attribute)):
        return value(*_named(module, node))
    raise Unreadable(ast.dump(node))


def _called(module: Module, node: ast.Call):
    """MappingProxyType(…), a read-only dictionary; field(default=…) of a dataclass; float("inf")."""
    name, first = getattr(node.func, "id", None), node.args[0] if len(node.args) == 1 else None
    if name == "MappingProxyType" and first is not None:
        return value(module, first)
    if name == "field":
        for given in node.keywords:
            if given.arg == "default":
                return value(module, given.value)
    if name == "float" and isinstance(first, ast.Constant):
        return float(first.value)
    raise Unreadable(ast.dump(node))
