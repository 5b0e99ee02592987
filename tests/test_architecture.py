"""The house's rules, read from its source. Each rule takes a folder and says what breaks it; a planted violation shows
that it can.
"""

import re
from pathlib import Path

import pytest
from architecture import (
    arrows,
    circles,
    drawn_in,
    files_touched,
    importers,
    oversized,
    picture,
    relative_imports,
    scripts_too_long,
    sources,
    strays,
    trespasses,
    upward,
)

ROOT = Path(__file__).resolve().parents[1]
PACKAGE = ROOT / "ssmr_torch"

# Who may import a library, at any depth of the code, by whatever way. A new dependency needs a line here.
HOMES = {
    "numpy": ["*"], "scipy": ["*"], "tqdm": ["*"],
    "torch": ["models/*", "fitting/*", "data/datamodule.py", "data/windows.py", "deployment/torch_program.py",
              "paper/delay_study.py", "benchmarks/*"],
    "lightning": ["data/datamodule.py", "fitting/*", "benchmarks/fit.py"],
    "sklearn": ["fitting/streamed_least_squares.py"],
    "numba": ["compiled_functions.py"],
    "mujoco": ["plants/tendon_chain.py"], "elastica": ["plants/cosserat_rod.py"],
    "soromox": ["plants/isupport.py", "plants/planar_hsa.py"],
    "jax": ["plants/isupport.py", "plants/planar_hsa.py", "plants/soromox_robot.py"],
    "proxsuite": ["control/solvers/proxqp.py"], "daqp": ["control/solvers/daqp.py"],
    "qpsolvers": ["control/qpsolvers_adapter.py"],
    "safetensors": ["deployment/tables.py"],
    "onnx": ["deployment/onnx_program.py"], "onnxruntime": ["deployment/onnx_program.py"],
    "casadi": ["deployment/casadi_program.py", "benchmarks/other_solvers.py"],
    "acados_template": ["benchmarks/other_solvers.py"], "ruptures": ["benchmarks/libraries.py"],
    "hydra": ["configuration.py", "entry_point.py", "short_refusals.py", "search/*"],
    "omegaconf": ["configuration.py", "entry_point.py", "found_settings.py", "option_tables.py", "short_refusals.py",
                  "search/best_row.py"],
    "optuna": ["search/space.py", "search/trials.py"],
    "h5py": ["hdf5_file.py", "trajectory_file.py", "closed_loop/record.py", "commissioning/directory.py",
             "recording_files/*", "collection/resumption.py", "paper/report_sections.py",
             "data/matlab_reader.py", "faults/container_trials.py"],
    "yaml": ["data/card_file.py", "data/card_text.py", "documents/stray_numbers.py", "faults/made_recordings.py",
             "faults/card_trials.py"],
    "pandas": ["recording_files/*", "recording_clocks/dates.py", "faults/container_trials.py"],
    "c3d": ["recording_files/c3d_reader.py"],
    "rosbags": ["recording_files/rosbag_reader.py"],
    "pydantic": ["data/card_file.py", "data/recording_card.py", "data/units.py", "commissioning/robot_card.py"],
    "pydantic_core": ["data/card_file.py"],
    "matplotlib": ["evaluation/*figures.py"],
    "jinja2": ["report/html_page.py"], "markupsafe": ["report/html_page.py"],
    "meshio": ["plants/finite_element/mesh_files.py"], "fontTools": ["tasks/symbols.py"],
    "zmq": ["wire/link.py"], "rerun": ["closed_loop/rerun_view.py"],
    "doit": ["paper/workflow.py"], "joblib": ["paper/executors/joblib_processes.py"],
    "ray": ["paper/executors/ray_tasks.py"], "submitit": ["paper/executors/submitit_jobs.py"],
}
# What a room never imports; * is every room, and a room may import itself. command.py is what starts the experiments.
NEVER = {
    "*": ["experiments", "paper", "conf", "benchmarks"],
    "models": ["plants", "control", "data", "fitting", "deployment", "evaluation", "wire", "tasks", "closed_loop"],
    "plants": ["models", "control", "data", "fitting", "deployment", "evaluation", "tasks", "closed_loop"],
    "control": ["plants", "data", "fitting", "deployment", "evaluation", "wire", "tasks", "closed_loop",
                "models.named_structures", "models.torch_model"],
    "wire": ["models", "plants", "control", "fitting", "deployment", "evaluation"],
    "deployment": ["plants", "data", "fitting", "evaluation"],
    "data": ["models", "plants", "collection", "control", "fitting", "evaluation", "closed_loop"],
}
# The command starts the experiments, the runner serves an artifact's controller, faults use what benchmarks steer with.
EXCEPT = {"command.py": ["experiments"], "wire/runner.py": ["deployment", "control"],
          "faults/garbage_control.py": ["benchmarks"], "faults/hostile_frames.py": ["benchmarks"]}
# Who touches files; all else takes and returns arrays.
TOUCHES_FILES = [
    "checksum.py", "own_folder.py", "quiet_libraries.py", "hdf5_file.py", "trajectory_file.py", "found_settings.py",
    "run_directory.py", "provenance.py", "result_files.py", "benchmarks/*", "deployment/artifact.py",
    "deployment/checkpoint_copy.py", "deployment/tables.py", "deployment/whole_directory.py",
    "closed_loop/record.py", "paper/models.py", "collection/*", "wire/runner.py", "wire/seal.py", "command.py",
    "commissioning/directory.py", "faults/*",
    "controller_design/report.py", "defaults_of_signatures.py", "data/*", "documents/*", "search/*",
    "recording_files/*",
    "deployment/exported_programs.py", "fitting/fit.py", "fitting/checkpoints.py", "fitting/resumption.py",
    "evaluation/*figures.py", "report/html_page.py",
    "paper/job_run.py", "paper/report_sections.py", "paper/reproduction.py",
    "plants/finite_element/mesh_files.py", "tasks/symbols.py", "closed_loop/rerun_view.py"]
# paper/ can be deleted; the rules of its rooms go with it.
if not (PACKAGE / "paper").is_dir():
    TOUCHES_FILES = [room for room in TOUCHES_FILES if not room.startswith("paper/")]
    HOMES = {library: rooms for library, named in HOMES.items()
             if (rooms := [room for room in named if not room.startswith("paper/")])}

RULES = {
    "imports are absolute": lambda folder: relative_imports(folder),
    "each library has its rooms": lambda folder: strays(folder, HOMES),
    "rooms keep apart": lambda folder: trespasses(folder, NEVER, EXCEPT),
    "no arrow between rooms runs up": lambda folder: [f"{one} imports {two}" for one, two in upward(arrows(folder))],
    "there are no import circles": lambda folder: circles(folder),
    "only the named rooms touch files, and write aside": lambda folder: files_touched(folder, TOUCHES_FILES),
    "rooms are small and named after what is in them": lambda folder: oversized(folder, 330, 55),
}


def kept(rule: str, folder: Path) -> None:
    """Fail with what breaks the rule, and the picture of the rooms and their arrows."""
    broken = RULES[rule](folder)
    assert not broken, "\n".join([f"{rule}: this is broken by", *broken, "", picture(folder)])


@pytest.mark.parametrize("rule", RULES)
def test_the_package_keeps_its_rules(rule):
    kept(rule, PACKAGE)


def test_no_file_of_the_entry_points_has_more_than_40_lines():
    assert scripts_too_long(ROOT / "experiments", 40) == []


def test_of_the_entry_points_only_those_of_the_paper_import_its_room():
    found = {source.room for source in sources(ROOT / "experiments")
             if any(f"{name}.".startswith("ssmr_torch.paper.") for name in source.imports)}
    assert found <= {"reproduce.py", "delay_study.py"}


@pytest.mark.skipif(not (PACKAGE / "paper").is_dir(), reason="the picture shows paper/, which was deleted")
def test_contributing_shows_the_rooms_and_arrows_as_they_are():
    assert drawn_in((ROOT / "CONTRIBUTING.md").read_text()) == picture(PACKAGE), "run python tests/architecture.py"


def test_contributing_names_files_that_exist():
    page = (ROOT / "CONTRIBUTING.md").read_text()
    named = re.findall(r"`((?:ssmr_torch|tests|tools|conf|docs|experiments|\.ci)/[\w/.]*)", page)
    assert len(named) > 15 and [each for each in named if "NAME" not in each and not (ROOT / each).exists()] == []


def planted(tmp_path: Path, **codes: str) -> Path:
    """A package with these files, a__b for a/b.py."""
    for name, code in codes.items():
        path = tmp_path / "ssmr_torch" / f"{name.replace('__', '/')}.py"
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(code)
    return tmp_path / "ssmr_torch"


def test_a_broken_rule_prints_the_rooms_by_floor_and_marks_the_arrow_that_runs_up(tmp_path):
    folder = planted(tmp_path, models__a="x = 1", models__b="from ssmr_torch.control import mpc", status="",
                     control__mpc="from ssmr_torch.models import a\nfrom ssmr_torch import status",
                     control__qp="import ssmr_torch.models.a")
    with pytest.raises(AssertionError) as failed:
        kept("rooms keep apart", folder)
    lines = [line.strip() for line in str(failed.value).splitlines()]
    assert "models/b.py imports ssmr_torch.control" in lines
    assert lines.index("floor 2   control/") < lines.index("floor 1   models/  status.py")
    assert "control/             → models/" in lines
    assert "UPWARDS: models/ → control/, by models/b.py" in lines
    assert RULES["no arrow between rooms runs up"](folder) == ["models/ imports control/"]


def test_an_arrow_that_follows_from_others_is_not_drawn(tmp_path):
    folder = planted(tmp_path, top__a="import ssmr_torch.middle.a\nimport ssmr_torch.low.a",
                     middle__a="import ssmr_torch.low.a", low__a="")
    assert set(arrows(folder)) == {("top/", "middle/"), ("top/", "low/"), ("middle/", "low/")}
    assert upward(arrows(folder)) == [] and "top/                 → middle/" in picture(folder).splitlines()


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
    ("each library has its rooms", "control/a.py", "import polars", "polars has no home"),
    ("each library has its rooms", "control/a.py", "x = 1", "nothing in wire/link.py imports zmq"),
    *[("rooms keep apart", room, code, f"{room} imports {name}") for room, code, name in (
        ("models/a.py", "from ssmr_torch.control import mpc", "ssmr_torch.control"),
        ("models/deep/a.py", "import ssmr_torch.plants.base", "ssmr_torch.plants.base"),
        ("plants/a.py", "from ssmr_torch.models.base import Model", "ssmr_torch.models.base"),
        ("control/a.py", "import ssmr_torch.plants", "ssmr_torch.plants"),
        ("control/a.py", "from ssmr_torch.models import named_structures", "ssmr_torch.models.named_structures"),
        ("wire/a.py", "from importlib import import_module\nimport_module('ssmr_torch.models.base')",
         "ssmr_torch.models.base"),
        ("wire/runner.py", "from ssmr_torch.experiments.train import main", "ssmr_torch.experiments.train"),
        ("data/a.py", "from ssmr_torch.plants.base import Plant", "ssmr_torch.plants.base"),
        ("data/a.py", "def f():\n    import ssmr_torch.collection.collect", "ssmr_torch.collection.collect"),
        ("control/a.py", "from ssmr_torch.benchmarks import table", "ssmr_torch.benchmarks"),
        ("evaluation/a.py", "from ssmr_torch.paper.models import read_ssmr_model", "ssmr_torch.paper.models"),
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
    ("only the named rooms touch files, and write aside", "trajectory_file.py",
     "def f(path):\n    path.write_text('x')",
     "trajectory_file.py writes by .write_text and renames nothing into place"),
    ("only the named rooms touch files, and write aside", "trajectory_file.py", "import h5py\nh5py.File('x', 'w')",
     "trajectory_file.py writes by h5py.File to write and renames nothing into place"),
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
