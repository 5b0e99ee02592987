"""How the code of a folder is read: what each file imports, which files it touches, and the picture of the rooms.

`python tests/architecture.py` prints the picture of the package, and writes it into CONTRIBUTING.md.
"""

import ast
import os
import sys
from fnmatch import fnmatch
from functools import cache
from pathlib import Path
from typing import NamedTuple

NAMELESS = {"utils", "util", "helpers", "helper", "common", "misc", "manager"}

FILE_METHODS = {"open", "read_text", "write_text", "read_bytes", "write_bytes", "unlink", "rename", "mkdir", "rmdir",
                "touch", "symlink_to", "hardlink_to", "tofile", "savefig"}
FILE_MODULES = {"shutil", "tempfile", "zipfile", "tarfile", "gzip", "bz2", "lzma", "sqlite3", "pickle", "h5py",
                "safetensors"}
FILE_CALLS = {"open", "io.open", "json.load", "json.dump", "yaml.safe_load", "torch.load", "torch.save",
              "scipy.io.loadmat", "scipy.io.savemat", "meshio.read", "meshio.write",
              "ssmr_torch.result_files.written_aside", "ssmr_torch.result_files.save_bytes",
              *(f"os.{name}" for name in ("open", "remove", "unlink", "rename", "replace", "makedirs", "rmdir")),
              *(f"numpy.{name}" for name in ("load", "save", "savez", "savez_compressed", "loadtxt", "savetxt",
                                             "genfromtxt", "fromfile", "memmap"))}
WRITES = {".write_text", ".write_bytes", ".tofile", ".savefig", "json.dump", "torch.save", "scipy.io.savemat",
          "meshio.write", "safetensors.numpy.save_file", "numpy.save", "numpy.savez", "numpy.savez_compressed",
          "numpy.savetxt"}
RENAMES = {"os.replace", "os.rename", ".rename", ".replace", "ssmr_torch.result_files.written_aside",
           "ssmr_torch.result_files.save_bytes"}


class Source(NamedTuple):
    """What the rules look at in one Python file; room: its path below the folder.

    imports: every module, at any depth of the code, by a statement or by its name as a text. files: what it calls that
    touches files. functions: names and lines of all, nested ones as well. relative: lines of relative imports.
    """

    room: str
    imports: set[str]
    files: set[str]
    functions: list[tuple[str, int]]
    relative: list[int]
    lines: int


class Code:
    """A parsed file, without what only a type checker reads."""

    def __init__(self, text: str):
        tree = ast.parse(text)
        unread = {inner for node in ast.walk(tree)
                  if isinstance(node, ast.If) and ast.unparse(node.test).endswith("TYPE_CHECKING")
                  for each in node.body for inner in ast.walk(each)}
        nodes = [node for node in ast.walk(tree) if node not in unread]
        self.statements = [node for node in nodes if isinstance(node, ast.Import)]
        self.froms = [node for node in nodes if isinstance(node, ast.ImportFrom)]
        self.functions = [node for node in nodes if isinstance(node, (ast.FunctionDef, ast.AsyncFunctionDef))]
        aliases = [(alias, alias.name if alias.asname else alias.name.split(".")[0])
                   for node in self.statements for alias in node.names]
        aliases += [(alias, f"{node.module}.{alias.name}") for node in self.froms for alias in node.names]
        # np is numpy
        self.bound = {alias.asname or alias.name.split(".")[0]: meant for alias, meant in aliases}
        self.calls = [(self._called(node), node) for node in nodes if isinstance(node, ast.Call)]

    def _called(self, call: ast.Call) -> str:
        """Dotted name of what is called, by where it was imported from; .name of a method of something else."""
        first, parts = call.func, []
        while isinstance(first, ast.Attribute):
            parts.insert(0, first.attr)
            first = first.value
        if isinstance(first, ast.Name) and (first.id in self.bound or not parts):
            return ".".join([self.bound.get(first.id, first.id), *parts])
        return f".{parts[-1]}" if parts else ""

    def imports(self) -> set[str]:
        names = {alias.name for node in self.statements for alias in node.names}
        for node in (node for node in self.froms if not node.level):
            names |= {node.module} | {f"{node.module}.{alias.name}" for alias in node.names}
        names |= {beginning(call.args[0]) for name, call in self.calls
                  if name.rpartition(".")[2] in ("import_module", "__import__") and call.args}
        return names - {""}

    def files(self) -> set[str]:
        found = set()
        for name, call in self.calls:
            owner, _, last = name.rpartition(".")
            of_object = "." in name and owner not in sys.stdlib_module_names
            replaces = last == "replace" and len(call.args) == 1 and not call.keywords  # of a path, not of a text
            if name in FILE_CALLS or name.split(".")[0] in FILE_MODULES:
                found |= {name, f"{name} to write"} if opens_to_write(name, call) else {name}
            elif of_object and (last in FILE_METHODS or replaces):
                found |= {f".{last}", f".{last} to write"} if opens_to_write(f".{last}", call) else {f".{last}"}
        return found


def beginning(node: ast.AST) -> str:
    """The text of a constant, or of an f-string up to its first value."""
    if isinstance(node, ast.JoinedStr) and node.values:
        return beginning(node.values[0]).rstrip(".")
    return node.value if isinstance(node, ast.Constant) and isinstance(node.value, str) else ""


def opens_to_write(name: str, call: ast.Call) -> bool:
    """Whether something is opened with a mode that writes: open(path, "w"), path.open("w"), File(path, "w")."""
    if name.rpartition(".")[2] not in ("open", "File", "ZipFile", "memmap"):
        return False
    given = call.args[:1] if name.startswith(".") else call.args[1:2]
    modes = [beginning(each) for each in (*given, *(each.value for each in call.keywords if each.arg == "mode"))]
    return any(set(mode) & set("wax+") for mode in modes)


@cache
def sources(folder: Path) -> tuple[Source, ...]:
    found = []
    for path in sorted(folder.rglob("*.py")):
        text = path.read_text()
        code = Code(text)
        found.append(Source(path.relative_to(folder).as_posix(), code.imports(), code.files(),
                            [(node.name, node.end_lineno - node.lineno) for node in code.functions],
                            [node.lineno for node in code.froms if node.level], len(text.splitlines())))
    return tuple(found)


def relative_imports(folder: Path) -> list[str]:
    return [f"{source.room} line {line} imports relatively" for source in sources(folder) for line in source.relative]


def importers(folder: Path) -> dict[str, set[str]]:
    """Rooms that import a library, by a statement or by its name, for each that is none of Python's or the folder's."""
    found: dict[str, set[str]] = {}
    for source in sources(folder):
        for library in {name.split(".")[0] for name in source.imports} - {*sys.stdlib_module_names, folder.name}:
            found.setdefault(library, set()).add(source.room)
    return found


def strays(folder: Path, homes: dict[str, list[str]]) -> list[str]:
    """Libraries imported outside of their homes, homes that no importer lives in, and libraries without any."""
    met = importers(folder)
    found = [f"{library} has no home" for library in sorted(set(met) - set(homes))]
    for library, patterns in homes.items():
        rooms = met.get(library, set())
        found += [f"{room} imports {library}" for room in sorted(rooms)
                  if not any(fnmatch(room, pattern) for pattern in patterns)]
        found += [f"nothing in {pattern} imports {library}" for pattern in patterns
                  if not any(fnmatch(room, pattern) for room in rooms)]
    return found


def trespasses(folder: Path, never: dict[str, list[str]], allowed: dict[str, list[str]] = {}) -> list[str]:  # noqa: B006
    """Rooms that import a room which they never may."""
    found = []
    for source in sources(folder):
        own = source.room.split("/")[0].removesuffix(".py")
        barred = [f"{folder.name}.{other}" for room in ("*", own) for other in never.get(room, ())
                  if other != own and other not in allowed.get(source.room, ())]
        found += [f"{source.room} imports {name}" for name in sorted(source.imports)
                  if any(f"{name}.".startswith(f"{other}.") for other in barred)]
    return found


def circles(folder: Path) -> list[str]:
    """Circles of imports, at any depth of the code."""
    modules = {".".join([folder.name, *Path(source.room).with_suffix("").parts]).removesuffix(".__init__"): source
               for source in sources(folder)}
    graph = {module: sorted(source.imports & set(modules) - {module}) for module, source in modules.items()}
    done, found = set(), []

    def visit(module: str, before: tuple[str, ...]) -> None:
        if module in before:
            found.append(" → ".join([*before[before.index(module):], module]))
        elif module not in done:
            for target in graph[module]:
                visit(target, (*before, module))
            done.add(module)

    for module in graph:
        visit(module, ())
    return found


def files_touched(folder: Path, allowed: list[str]) -> list[str]:
    """Rooms that touch files and may not, rooms that may and do not, and what is written under its own name at once."""
    rooms = {source.room: source.files for source in sources(folder) if source.files}
    found = [f"{room} touches files: {', '.join(sorted(calls))}" for room, calls in rooms.items()
             if not any(fnmatch(room, pattern) for pattern in allowed)]
    found += [f"nothing in {pattern} touches files" for pattern in allowed
              if not any(fnmatch(room, pattern) for room in rooms)]
    for room, calls in rooms.items():
        written = {call for call in calls if call in WRITES or call.endswith(" to write")}
        if written and not calls & {*RENAMES, "tempfile.TemporaryDirectory"}:
            found.append(f"{room} writes by {', '.join(sorted(written))} and renames nothing into place")
    return found


def oversized(folder: Path, lines: int, function: int) -> list[str]:
    """Files and functions, nested ones as well, that are too long, and files that are named after nothing."""
    found = []
    for source in sources(folder):
        found += [f"{source.room} has {source.lines} lines"] * (source.lines > lines)
        found += [f"{source.room} is named after nothing"] * (Path(source.room).stem in NAMELESS)
        found += [f"{source.room}: {name} has {own} lines" for name, own in source.functions if own > function]
    return found


def arrows(folder: Path) -> dict[tuple[str, str], list[str]]:
    """(room, room that it imports) → the files that do so. A room is a folder, or a single file beside them."""
    names = {room_of(source.room) for source in sources(folder)} - {"__init__.py"}
    by_module = {name.removesuffix("/").removesuffix(".py"): name for name in names}
    found: dict[tuple[str, str], list[str]] = {}
    for source in sources(folder):
        own = room_of(source.room)
        for name in source.imports:
            package, _, rest = name.partition(".")
            other = by_module.get(rest.partition(".")[0])
            if package == folder.name and other not in (None, own) and own in names:
                files = found.setdefault((own, other), [])
                files += [source.room] * (source.room not in files)
    return found


def room_of(path: str) -> str:
    """"control/mpc.py" is in the room "control/", "status.py" is a room of its own."""
    return path.split("/")[0] + "/" if "/" in path else path


def upward(found: dict[tuple[str, str], list[str]]) -> list[tuple[str, str]]:
    """The arrows that close a circle of rooms: of each circle those that the fewest files make."""
    kept, up = set(found), []
    for arrow in sorted(found, key=lambda arrow: (len(found[arrow]), arrow)):
        if arrow[0] in _reached(arrow[1], kept):
            kept.remove(arrow)
            up.append(arrow)
    return sorted(up)


def _reached(room: str, kept: set[tuple[str, str]]) -> set[str]:
    """The room, and all that it imports, directly or not."""
    reached, ahead = set(), [room]
    while ahead:
        now = ahead.pop()
        if now not in reached:
            reached.add(now)
            ahead += [other for one, other in kept if one == now]
    return reached


def picture(folder: Path) -> str:
    """The rooms by floor, each above all that it imports, then the arrows of every folder down, and those that run up.

    Left out is an arrow that follows from others: what a room reaches through a room that it imports.
    """
    found = arrows(folder)
    up, floors = upward(found), {}
    kept = set(found) - set(up)
    rooms = {room_of(source.room) for source in sources(folder)} - {"__init__.py"}
    while len(floors) < len(rooms):
        for room in sorted(rooms - set(floors)):
            below = [other for one, other in kept if one == room]
            if set(below) <= set(floors):
                floors[room] = 1 + max((floors[other] for other in below), default=0)
    lines = []
    for floor in range(max(floors.values(), default=0), 0, -1):
        here = sorted((room for room in rooms if floors[room] == floor), key=lambda room: (room.endswith(".py"), room))
        lines.append(f"floor {floor}   {'  '.join(here)}")
    lines.append("")
    for room in sorted(rooms, key=lambda room: (-floors[room], room)):
        below = {other for one, other in kept if one == room and other.endswith("/")}
        direct = sorted(other for other in below if not any(other in _reached(each, kept) for each in below - {other}))
        lines += [f"{room:<20} → {'  '.join(direct)}"] * (room.endswith("/") and bool(direct))
    lines += [f"UPWARDS: {one} → {other}, by {', '.join(found[one, other])}" for one, other in up]
    return "\n".join(lines)


def scripts_too_long(folder: Path, lines: int) -> list[str]:
    """Python files of more than so many lines, their docstring counted."""
    return [f"{source.room} has {source.lines} lines" for source in sources(folder) if source.lines > lines]


BEGIN, END = "<!-- the picture: python tests/architecture.py -->\n```text\n", "\n```\n<!-- end -->"


def drawn_in(text: str) -> str:
    """The picture that a page has between its marks."""
    return text.partition(BEGIN)[2].partition(END)[0]


if __name__ == "__main__":
    root = Path(__file__).resolve().parents[1]
    page, now = root / "CONTRIBUTING.md", picture(root / "ssmr_torch")
    print(now)
    before, _, rest = page.read_text(encoding="utf-8").partition(BEGIN)
    aside = page.with_suffix(".part")
    aside.write_text(before + BEGIN + now + END + rest.partition(END)[2], encoding="utf-8")
    os.replace(aside, page)
