"""Machines unlike the one where this was written: no home, a package that nobody can write, other users, no locale."""

import json
import logging
import os
import shutil
import stat
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from ssmr_torch import compiled_functions, own_folder, quiet_libraries
from ssmr_torch.collection import parallel

ROOT = Path(__file__).resolve().parents[1]
FOREIGN = """
import json, logging, os, sys
import numpy as np
logging.basicConfig(level=logging.WARNING, format="%(message)s")
import warnings
warnings.filterwarnings("error", category=EncodingWarning, module="ssmr_torch")
from ssmr_torch.quiet_libraries import quiet
quiet()
from ssmr_torch.control.condensing import copy
from ssmr_torch.deployment import artifact
from ssmr_torch.trajectory import Trajectory, TrajectoryDataset
import ssmr_torch
copied = np.zeros(3)
copy(np.arange(3.0), copied)
data = TrajectoryDataset([Trajectory(0.01 * np.arange(5), np.ones((5, 2)), np.ones((5, 1)))], [0, 0], ["ä", "ö"], "u")
path = data.save("übung 1/daten ß.h5")
assert False, "python -O passes over this"
loaded = ssmr_torch.load(path)
print(loaded)
model = artifact.load(sys.argv[1])
saved = artifact.save("übung 1/modell ß", model.model, name="übung", **{
    name: model.card[name] for name in ("output_names", "input_names", "rest", "input_range")})
(saved / "card.json").write_bytes((saved / "card.json").read_bytes().replace(b'"delays": ', b'"delays": 1'))
try:
    artifact.load(saved)
    print("a damaged card was loaded")
except ValueError as error:
    print(f"refused: {error}")
print(json.dumps({"package": ssmr_torch.__file__, "copied": copied.tolist(), "cache": copy._cache.cache_path}))
"""


def without_privileges() -> list[str]:
    """What lets a command of the superuser heed the permissions of files; empty for another user."""
    if os.getuid():
        return []
    if shutil.which("setpriv") is None:
        pytest.skip("the superuser writes everything, and setpriv is not here to take that away")
    return ["setpriv", "--bounding-set", "-dac_override,-dac_read_search,-fowner"]


@pytest.fixture(scope="module")
def read_only(tmp_path_factory):
    """A copy of the package in a folder whose name has blanks and umlauts, which nobody may write."""
    folder = tmp_path_factory.mktemp("paket ü")
    shutil.copytree(ROOT / "ssmr_torch", folder / "ssmr_torch", ignore=shutil.ignore_patterns("__pycache__"))
    paths = [folder, *folder.rglob("*")]
    for path in paths:
        path.chmod(path.stat().st_mode & ~0o222)
    yield folder
    for path in paths:
        path.chmod(path.stat().st_mode | stat.S_IWUSR)


def run(code: str, at: Path, package: Path, *arguments: str, options=(), **environment) -> subprocess.CompletedProcess:
    given = {"PATH": os.environ["PATH"], "PYTHONPATH": str(package), "TMPDIR": str(at / "tmp"), "OMP_NUM_THREADS": "1"}
    (at / "tmp").mkdir(exist_ok=True)
    (at / "work").mkdir(exist_ok=True)
    (at / "program.py").write_text(code, encoding="utf-8")
    return subprocess.run([*without_privileges(), sys.executable, *options, "../program.py", *arguments],
                          cwd=at / "work", env=given | environment, capture_output=True, encoding="utf-8",
                          errors="replace", timeout=300)


@pytest.mark.parametrize("home", [pytest.param({}, marks=pytest.mark.slow, id="no HOME"),
                                  pytest.param({"HOME": "/proc/none"}, id="a HOME that is not there")])
def test_without_a_home_in_a_read_only_package_without_a_locale_and_without_asserts(tmp_path, read_only, home):
    """Also in folders with blanks and umlauts; no text is read or written in an encoding that nobody named."""
    done = run(FOREIGN, tmp_path, read_only, str(ROOT / "tests" / "written_by_0_7" / "SSMR" / "artifact"),
               options=["-O", "-X", "warn_default_encoding"], LC_ALL="C", PYTHONIOENCODING="ascii", **home)
    assert done.returncode == 0, done.stderr
    assert "TrajectoryDataset: 1 run" in done.stdout and "refused: " in done.stdout and "checksum" in done.stdout
    assert str(read_only) in done.stdout.splitlines()[-1].encode().decode("unicode_escape")
    assert not [path for path in (tmp_path / "work").iterdir() if "~" in path.name]
    kept = tmp_path / "tmp" / f"ssmr_torch-{os.getuid()}"
    if home or os.getuid():  # the superuser's home is found without HOME
        assert kept.stat().st_mode & 0o777 == 0o700 and any(kept.rglob("*.nbi"))


def test_with_no_place_at_all_functions_are_compiled_in_every_process_and_one_line_says_so(tmp_path, read_only):
    code = """
import logging, tempfile
import numpy as np
logging.basicConfig(format="%(message)s")
tempfile.gettempdir = lambda: "/proc/none"
from ssmr_torch.control.condensing import copy
copied = np.zeros(3)
copy(np.arange(3.0), copied)
print(copied.tolist())
"""
    done = run(code, tmp_path, read_only, HOME="/proc/none")
    assert done.returncode == 0 and done.stdout == "[0.0, 1.0, 2.0]\n", done.stderr
    assert done.stderr.count("compiled functions are kept in no file") == 1 and "NUMBA_CACHE_DIR" in done.stderr


def test_a_folder_of_temporary_files_belongs_to_one_user_and_another_one_is_not_used(tmp_path, monkeypatch):
    monkeypatch.setattr(own_folder.tempfile, "gettempdir", lambda: str(tmp_path))
    mine = own_folder.own_folder()
    assert mine == tmp_path / f"ssmr_torch-{os.getuid()}" and mine.stat().st_mode & 0o777 == 0o700
    mine.chmod(0o777)
    assert own_folder.own_folder() is None  # others could put what is run there
    shutil.rmtree(mine)
    (tmp_path / "theirs").mkdir(mode=0o700)
    mine.symlink_to(tmp_path / "theirs")
    assert own_folder.own_folder() is None
    mine.unlink()
    mine.write_text("a file")
    assert own_folder.own_folder() is None
    mine.unlink()
    real = os.getuid()
    monkeypatch.setattr(own_folder.os, "getuid", lambda: 54321)
    (tmp_path / "ssmr_torch-54321").mkdir(mode=0o700)
    assert real == 54321 or own_folder.own_folder() is None  # planted under this user's name by another one


def test_caches_of_libraries_have_a_place_where_there_is_no_home_and_what_the_user_set_stays(tmp_path, monkeypatch):
    monkeypatch.setattr(own_folder.tempfile, "gettempdir", lambda: str(tmp_path))
    monkeypatch.setenv("HOME", "/proc/none")
    monkeypatch.setenv("XDG_CACHE_HOME", "mine")
    for name in set(quiet_libraries.CACHES) - {"XDG_CACHE_HOME"}:
        monkeypatch.setenv(name, "to be restored")
        monkeypatch.delenv(name)
    assert not own_folder.has_home()
    quiet_libraries.settle()
    assert os.environ["MPLCONFIGDIR"] == str(tmp_path / f"ssmr_torch-{os.getuid()}" / "matplotlib")
    assert os.environ["XDG_CACHE_HOME"] == "mine"


def test_a_damaged_cache_or_a_full_disk_costs_a_compilation_and_nothing_else(tmp_path, monkeypatch, caplog):
    monkeypatch.setattr(compiled_functions, "_said", set())
    monkeypatch.setattr(compiled_functions.numba.config, "CACHE_DIR", str(tmp_path))

    def twice(x):
        return 2.0 * x

    assert compiled_functions.compiled()(twice)(1.5) == 3.0
    index = next(tmp_path.rglob("*.nbi"))
    index.write_bytes(b"\x80garbage")
    assert compiled_functions.compiled()(twice)(2.5) == 5.0
    assert "is compiled again" in caplog.records[0].getMessage()
    monkeypatch.setattr(compiled_functions.FunctionCache, "save_overload", lambda *_: (_ for _ in ()).throw(
        OSError(28, "No space left on device")))
    for path in tmp_path.rglob("*.nb*"):
        path.unlink()
    assert compiled_functions.compiled()(twice)(3.5) == 7.0
    assert "cannot be kept" in caplog.records[-1].getMessage()


def test_where_processes_cannot_share_memory_all_is_recorded_in_one(monkeypatch, caplog):
    def refused(method):
        raise OSError(38, "Function not implemented")  # as without /dev/shm

    assert parallel._can_start_workers()
    monkeypatch.setattr(parallel, "get_context", refused)
    with caplog.at_level(logging.WARNING):
        assert not parallel._can_start_workers()
    assert "all is recorded in this process" in caplog.records[0].getMessage()


@pytest.mark.slow
def test_the_plain_builds_for_old_processors_compute_the_same(tmp_path):
    """No AVX2: ProxQP's plain build, Numba without the processor's features, BLAS's oldest kernels."""
    code = """
import json, sys, types
if sys.argv[1] == "plain":
    sys.modules["proxsuite.instructionset"] = types.ModuleType("proxsuite.instructionset")
    sys.modules["proxsuite.instructionset"].has_AVX2 = sys.modules["proxsuite.instructionset"].has_AVX512F = \
        lambda: False
import numpy as np, proxsuite
from ssmr_torch.control.condensing import copy
from ssmr_torch.control.quadratic_program import QuadraticProgram
from ssmr_torch.control.solvers import solver_named
rng = np.random.default_rng(0)
root, solutions, copied = rng.normal(size=(20, 20)), [], np.zeros(3)
copy(np.arange(3.0), copied)
for _ in range(5):
    problem = QuadraticProgram(root @ root.T + np.eye(20), rng.normal(size=20), -0.05 * np.ones(20), np.ones(20))
    solutions.append(solver_named("proxqp", 20, 0).solve(problem).x.tolist())
print(proxsuite._submodule.__name__, json.dumps([*solutions, copied.tolist() * 5 + [0.0] * 5]))
"""
    environment = os.environ | {"OMP_NUM_THREADS": "1", "NUMBA_CACHE_DIR": str(tmp_path)}
    old = {"NUMBA_CPU_NAME": "x86-64", "NUMBA_CPU_FEATURES": "", "OPENBLAS_CORETYPE": "Nehalem"}
    found = []
    for arguments, more in ((["as it is"], {}), (["plain"], old)):
        done = subprocess.run([sys.executable, "-c", code, *arguments], env=environment | more, capture_output=True,
                              encoding="utf-8", timeout=300)
        assert done.returncode == 0, done.stderr
        name, _, solutions = done.stdout.strip().partition(" ")
        found.append((name, np.array(json.loads(solutions))))
    assert found[1][0] == "proxsuite.proxsuite_pywrap"
    np.testing.assert_allclose(found[1][1], found[0][1], rtol=1e-6, atol=1e-7)
