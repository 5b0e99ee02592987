"""The house's rules, read from its source. Each rule takes a folder and says what breaks it; a planted violation shows
that it can.
"""

import ast
import sys
from fnmatch import fnmatch
from functools import cache
from pathlib import Path
from typing import NamedTuple

import pytest

ROOT = Path(__file__).resolve().parents[1]
PACKAGE = ROOT / "ssmr_torch"

# Who may import a library, at any depth of the code, by whatever way. A new dependency needs a line here.
HOMES = {
    "numpy": ["*"], "scipy": ["*"], "tqdm": ["*"],
    "torch": ["models/*", "fitting/*", "data/datamodule.py", "data/windows.py", "deployment/torch_program.py",
              "paper/delay_study.py"],
    "lightning": ["data/datamodule.py", "fitting/*"],
    "sklearn": ["fitting/streamed_least_squares.py"],
    "numba": ["control/*", "models/batch_kernel.py", "plants/finite_element/compiled.py", "plants/pressure_arm.py",
              "plants/slow_manifold.py"],
    "mujoco": ["plants/tendon_chain.py"], "elastica": ["plants/cosserat_rod.py"],
    "soromox": ["plants/isupport.py", "plants/planar_hsa.py"],
    "jax": ["plants/isupport.py", "plants/planar_hsa.py", "plants/soromox_robot.py"],
    "proxsuite": ["control/solvers/proxqp.py"], "daqp": ["control/solvers/daqp.py"],
    "qpsolvers": ["control/solvers_of_qpsolvers.py"],
    "safetensors": ["deployment/artifact.py"],
    "onnx": ["deployment/onnx_program.py"], "onnxruntime": ["deployment/onnx_program.py"],
    "casadi": ["deployment/casadi_program.py"],
    "hydra": ["configuration.py"], "omegaconf": ["configuration.py"],
    "h5py": ["trajectory.py", "closed_loop/record.py", "commissioning/directory.py", "data/*",
             "collection/resumption.py", "paper/report_sections.py"],
    "yaml": ["data/recording_card.py", "commissioning/card.py", "documents/stray_numbers.py"],
    "matplotlib": ["evaluation/*figures.py"],
    "jinja2": ["report/html_page.py"], "markupsafe": ["report/html_page.py"],
    "meshio": ["plants/finite_element/mesh_files.py"], "fontTools": ["tasks/symbols.py"],
    "zmq": ["wire/link.py"], "rerun": ["closed_loop/rerun_view.py"],
}
# What a room never imports; * is every room, and a room may import itself. command.py is what starts the experiments.
NEVER = {
    "*": ["experiments", "paper", "conf"],
    "models": ["plants", "control", "data", "fitting", "deployment", "evaluation", "wire", "tasks", "closed_loop"],
    "plants": ["models", "control", "data", "fitting", "deployment", "evaluation", "tasks", "closed_loop"],
    "control": ["plants", "data", "fitting", "deployment", "evaluation", "wire", "tasks", "closed_loop",
                "models.named_structures", "models.torch_model"],
    "wire": ["models", "plants", "control", "fitting", "deployment", "evaluation"],
    "deployment": ["plants", "data", "fitting", "evaluation"],
    "data": ["models", "plants", "collection", "control", "fitting", "evaluation", "closed_loop"],
}
# The two that put everything together: the command starts the experiments, the runner serves an artifact's controller.
EXCEPT = {"command.py": ["experiments"], "wire/runner.py": ["deployment", "control"]}
# Who touches files; all else takes and returns arrays.
TOUCHES_FILES = [
    "trajectory.py", "deployment/artifact.py", "deployment/checkpoint_twin.py", "closed_loop/record.py",
    "provenance.py", "paper/models.py", "collection/*", "wire/runner.py", "command.py", "commissioning/directory.py",
    "controller_design/report.py", "defaults.py", "data/*", "documents/*",
    "deployment/deploy.py", "fitting/by_kind.py", "fitting/checkpoints.py", "evaluation/*figures.py",
    "report/html_page.py", "report/run_sections.py",
    "paper/report_sections.py",
    "plants/finite_element/mesh_files.py", "tasks/symbols.py", "closed_loop/rerun_view.py"]
NAMELESS = {"utils", "util", "helpers", "helper", "common", "misc", "manager"}

FILE_METHODS = {"open", "read_text", "write_text", "read_bytes", "write_bytes", "unlink", "rename", "mkdir", "rmdir",
                "touch", "symlink_to", "hardlink_to", "tofile", "savefig"}
FILE_MODULES = {"shutil", "tempfile", "zipfile", "tarfile", "gzip", "bz2", "lzma", "sqlite3", "pickle", "h5py",
                "safetensors"}
FILE_CALLS = {"open", "io.open", "json.load", "json.dump", "yaml.safe_load", "torch.load", "torch.save",
              "scipy.io.loadmat", "scipy.io.savemat", "meshio.read", "meshio.write",
              *(f"os.{name}" for name in ("open", "remove", "unlink", "rename", "replace", "makedirs", "rmdir")),
              *(f"numpy.{name}" for name in ("load", "save", "savez", "savez_compressed", "loadtxt", "savetxt",
                                             "genfromtxt", "fromfile", "memmap"))}
WRITES = {".write_text", ".write_bytes", ".tofile", ".savefig", "json.dump", "torch.save", "scipy.io.savemat",
          "meshio.write", "safetensors.numpy.save_file", "numpy.save", "numpy.savez", "numpy.savez_compressed",
          "numpy.savetxt"}
RENAMES = {"os.replace", "os.rename", ".rename", ".replace"}


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
        if written and not calls & RENAMES:
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


RULES = {
    "imports are absolute": lambda folder: relative_imports(folder),
    "each library has its rooms": lambda folder: strays(folder, HOMES),
    "rooms keep apart": lambda folder: trespasses(folder, NEVER, EXCEPT),
    "there are no import circles": lambda folder: circles(folder),
    "only the named rooms touch files, and write aside": lambda folder: files_touched(folder, TOUCHES_FILES),
    "rooms are small and named after what is in them": lambda folder: oversized(folder, 330, 55),
}


@pytest.mark.parametrize("rule", RULES)
def test_the_house_keeps_its_rules(rule):
    assert RULES[rule](PACKAGE) == []


def test_entry_points_are_thin():
    assert [found for found in oversized(ROOT / "experiments", 330, 40) if not found.startswith("benchmarks/")] == []


NESTED = "def outer():\n    class Inner:\n        def long(self):\n" + "            x = 1\n" * 60
PLANTED = [
    ("imports are absolute", "data/a.py", "from . import b", "data/a.py line 1 imports relatively"),
    *[("each library has its rooms", "control/a.py", code, "control/a.py imports torch") for code in (
        "import torch.nn as nn", "def f():\n    from torch import nn", "from importlib import import_module\n"
        "import_module('torch')", "import importlib\nimportlib.import_module('torch.func')", "__import__('torch')",
        "from importlib import import_module as load\nload('torch')",
        "from importlib import import_module\nimport_module(f'torch.{name}')")],
    ("each library has its rooms", "control/a.py", "import importlib\nimportlib.import_module('daqp')",
     "control/a.py imports daqp"),
    ("each library has its rooms", "control/a.py", "import pandas", "pandas has no home"),
    ("each library has its rooms", "control/a.py", "x = 1", "nothing in wire/link.py imports zmq"),
    *[("rooms keep apart", room, code, f"{room} imports {name}") for room, code, name in (
        ("models/a.py", "from ssmr_torch.control import mpc", "ssmr_torch.control"),
        ("models/deep/a.py", "import ssmr_torch.plants.base", "ssmr_torch.plants.base"),
        ("plants/a.py", "from ssmr_torch.models.base import Model", "ssmr_torch.models.base"),
        ("control/a.py", "import ssmr_torch.plants", "ssmr_torch.plants"),
        ("control/a.py", "from ssmr_torch.models import named_structures", "ssmr_torch.models.named_structures"),
        ("wire/a.py", "from importlib import import_module\nimport_module('ssmr_torch.models.base')",
         "ssmr_torch.models.base"),
        ("wire/runner.py", "from ssmr_torch.experiments.entry import entry_point", "ssmr_torch.experiments.entry"),
        ("fitting/a.py", "from ssmr_torch.paper import jobs", "ssmr_torch.paper"))],
    *[("only the named rooms touch files, and write aside", "control/a.py", code, f"control/a.py touches files: {what}")
      for code, what in (
        ("from pathlib import Path\nPath('x').open()", ".open"), ("open('x')", "open"),
        ("import numpy as np\nnp.load('x.npy')", "numpy.load"), ("from numpy import load\nload('x.npy')", "numpy.load"),
        ("import h5py\nh5py.File('x')", "h5py.File"), ("import json\njson.dump(1, open('x', 'w'))", "json.dump"),
        ("import os\nos.replace('x', 'y')", "os.replace"), ("import shutil\nshutil.copy('x', 'y')", "shutil.copy"),
        ("from shutil import rmtree\nrmtree('x')", "shutil.rmtree"),
        ("def f(path):\n    path.replace('y')", ".replace"),
        ("def f(aside):\n    aside.write_text('y')", ".write_text"),
        ("from tempfile import mkdtemp\nmkdtemp()", "tempfile.mkdtemp"),
        ("from ssmr_torch.data.recording_card import CARD\nCARD.read_text()", ".read_text"))],
    ("only the named rooms touch files, and write aside", "trajectory.py", "def f(path):\n    path.write_text('x')",
     "trajectory.py writes by .write_text and renames nothing into place"),
    ("only the named rooms touch files, and write aside", "trajectory.py", "import h5py\nh5py.File('x', 'w')",
     "trajectory.py writes by h5py.File to write and renames nothing into place"),
    ("only the named rooms touch files, and write aside", "control/a.py", "x = 1",
     "nothing in closed_loop/record.py touches files"),
    ("rooms are small and named after what is in them", "data/long.py", "x = 1\n" * 331, "data/long.py has 331 lines"),
    ("rooms are small and named after what is in them", "data/a.py", NESTED, "data/a.py: long has 60 lines"),
    ("rooms are small and named after what is in them", "data/utils.py", "", "data/utils.py is named after nothing"),
]


@pytest.mark.parametrize(("rule", "room", "code", "found"), PLANTED)
def test_a_planted_violation_is_caught(tmp_path, rule, room, code, found):
    planted = tmp_path / "ssmr_torch" / room
    planted.parent.mkdir(parents=True)
    planted.write_text(code)
    assert any(each.startswith(found) for each in RULES[rule](tmp_path / "ssmr_torch")), RULES[rule](planted.parent)


@pytest.mark.parametrize("second", ["import ssmr_torch.one", "def f():\n    from ssmr_torch import one",
                                    "from importlib import import_module\nimport_module('ssmr_torch.one')"])
def test_a_planted_circle_is_caught(tmp_path, second):
    for name, last in (("round", second), ("straight", "import ssmr_torch.four")):
        folder = tmp_path / name / "ssmr_torch"
        folder.mkdir(parents=True)
        for module, code in (("one", "import ssmr_torch.two"), ("two", "import ssmr_torch.three"), ("three", last)):
            (folder / f"{module}.py").write_text(code)
    assert circles(tmp_path / "round" / "ssmr_torch") == [
        "ssmr_torch.one → ssmr_torch.two → ssmr_torch.three → ssmr_torch.one"]
    assert circles(tmp_path / "straight" / "ssmr_torch") == []


@pytest.mark.parametrize("code", [
    "'a-b'.replace('-', '_')", "from dataclasses import replace\nreplace(x, y=1)", "import numpy as np\nnp.exp(1.0)",
    "import json\njson.loads('1')", "from typing import TYPE_CHECKING\nif TYPE_CHECKING:\n    import torch",
    "from importlib import import_module\nimport_module(target)"])
def test_what_only_looks_like_a_violation_is_none(tmp_path, code):
    folder = tmp_path / "ssmr_torch"
    folder.mkdir()
    (folder / "a.py").write_text(code)
    assert files_touched(folder, []) == [] and trespasses(folder, NEVER) == []
    assert "torch" not in importers(folder)
