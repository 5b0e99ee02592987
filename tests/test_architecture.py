"""The house's rules, read from its imports."""

import ast
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
PACKAGE = ROOT / "ssmr_torch"
FILES = sorted(PACKAGE.rglob("*.py"))


def imported(path: Path) -> set[str]:
    """Every module that a file imports, at any depth of its code."""
    names = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path} uses a relative import"
            names |= {node.module} | {f"{node.module}.{alias.name}" for alias in node.names}
    return names


def importers(*libraries: str) -> set[str]:
    return {path.relative_to(PACKAGE).as_posix() for path in FILES
            if any(name.split(".")[0] in libraries for name in imported(path))}


@pytest.mark.parametrize(("libraries", "rooms"), [
    (("lightning", "pytorch_lightning"), {"data/datamodule.py", "fitting/fit.py", "fitting/training.py"}),
    (("proxsuite",), {"control/solvers/proxqp.py"}),
    (("daqp",), {"control/solvers/daqp.py"}),
    (("qpsolvers",), {"control/any_qp.py"}),
    (("matplotlib",), {"evaluation/figures.py", "evaluation/robot_figures.py", "evaluation/study_figures.py"}),
    (("jinja2",), {"evaluation/report.py"}),
    (("meshio",), {"plants/finite_element/mesh_files.py"}),
    (("onnx", "onnxruntime", "onnxscript"), {"deployment/onnx_program.py"}),
    (("fontTools",), {"tasks/symbols.py"}),
    (("zmq",), {"wire/link.py"}),
    (("rerun",), {"view/rerun_view.py"}),
    (("gmsh", "skfem"), set()),
    (("hydra", "omegaconf"), {"configuration.py"}),
    (("wandb",), set()),
    (("pickle", "joblib", "dill"), set()),
])
def test_each_heavy_dependency_has_one_room(libraries, rooms):
    assert importers(*libraries) <= rooms


def test_models_plants_and_control_never_import_each_other():
    rooms = ("models", "plants", "control")
    for path in FILES:
        room = path.relative_to(PACKAGE).parts[0]
        if room in rooms:
            others = {f"ssmr_torch.{other}" for other in rooms if other != room}
            met = {name for name in imported(path) if any(name.startswith(other) for other in others)}
            assert not met, f"{path} imports {met}"


def test_the_wire_knows_no_model_plant_or_controller():
    for path in (PACKAGE / "wire").glob("*.py"):
        met = {name for name in imported(path)
               if name.startswith(("ssmr_torch.models", "ssmr_torch.plants", "ssmr_torch.control"))}
        assert not met, f"{path} imports {met}"


def test_nothing_imports_the_experiments():
    scripts = {path.stem for path in (ROOT / "experiments").glob("*.py")} | {"experiments"}
    for path in FILES:
        assert not {name.split(".")[0] for name in imported(path)} & scripts, path


def test_there_are_no_import_circles():
    graph = {}
    for path in FILES:
        module = ".".join(path.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__")
        graph[module] = {name for name in imported(path) if name.startswith("ssmr_torch")}
    graph = {module: {target for target in targets if target in graph and target != module}
             for module, targets in graph.items()}
    visiting, done = [], set()

    def visit(module):
        assert module not in visiting, " → ".join([*visiting, module])
        if module not in done:
            visiting.append(module)
            for target in graph[module]:
                visit(target)
            visiting.pop()
            done.add(module)

    for module in graph:
        visit(module)


def test_only_the_named_rooms_touch_files():
    allowed = {"trajectory.py", "artifact.py", "closed_loop.py", "provenance.py", "published_models.py",
               "evaluation/report.py", "evaluation/sections.py", "evaluation/figures.py",
               "evaluation/robot_figures.py", "fitting/training.py", "reproduction/sections.py", "runner.py",
               "deployment/deploy.py", "defaults.py", "command.py", "tasks/symbols.py"}
    for path in FILES:
        room = path.relative_to(PACKAGE).as_posix()
        if room in allowed or room.startswith("data/"):
            continue
        called = {node.func.id if isinstance(node.func, ast.Name) else getattr(node.func, "attr", "")
                  for node in ast.walk(ast.parse(path.read_text())) if isinstance(node, ast.Call)}
        assert not called & {"open", "read_text", "write_text", "read_bytes", "write_bytes", "File", "unlink"}, room


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.relative_to(PACKAGE).as_posix())
def test_rooms_are_small_and_named_after_what_is_in_them(path):
    assert len(path.read_text().splitlines()) <= 330
    assert path.stem not in {"utils", "util", "helpers", "helper", "common", "misc", "manager"}
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, (ast.FunctionDef, ast.AsyncFunctionDef)):
            assert node.end_lineno - node.lineno <= 55, f"{node.name} has {node.end_lineno - node.lineno} lines"


@pytest.mark.parametrize("path", sorted((ROOT / "experiments").glob("*.py")), ids=lambda path: path.name)
def test_entry_points_are_thin(path):
    longest = max((node.end_lineno - node.lineno for node in ast.walk(ast.parse(path.read_text()))
                   if isinstance(node, ast.FunctionDef)), default=0)
    assert longest <= 40


def failure_without(*blocked: str, code: str) -> str:
    """What a fresh interpreter complains of when these modules cannot be imported; empty where all is well."""
    prefix = f"import sys\nfor name in {blocked!r}: sys.modules[name] = None\n"
    done = subprocess.run([sys.executable, "-c", prefix + code], capture_output=True, text=True)
    return done.stderr if done.returncode else ""


def test_the_package_imports_without_any_heavy_dependency():
    assert not failure_without("torch", "lightning", "hydra", "wandb", "matplotlib", "proxsuite", "numba", "h5py",
                               code="import ssmr_torch")


def test_control_from_an_artifact_needs_neither_torch_nor_lightning_nor_hydra_nor_wandb_nor_matplotlib():
    assert not failure_without("torch", "lightning", "hydra", "omegaconf", "wandb", "matplotlib",
                               code="import ssmr_torch.artifact, ssmr_torch.control.mpc, ssmr_torch.closed_loop, "
                                    "ssmr_torch.plants.slow_manifold, ssmr_torch.plants.trunk, ssmr_torch.plants.rig, "
                                    "ssmr_torch.tasks.references")


def test_a_model_in_c_needs_neither_torch_nor_onnx():
    assert not failure_without("torch", "onnx", "onnxruntime", "onnxscript", "lightning", "hydra", "h5py", "numba",
                               code="import ssmr_torch.deployment.deploy")


def test_only_one_file_of_a_deployment_imports_torch():
    assert {name for name in importers("torch") if name.startswith("deployment/")} == {"deployment/torch_program.py"}


def test_the_runner_and_both_ends_of_the_wire_need_only_numpy_safetensors_and_zmq():
    assert not failure_without("torch", "lightning", "hydra", "omegaconf", "wandb", "matplotlib", "h5py", "tqdm",
                               "scipy", "qpsolvers", code="import ssmr_torch.runner, ssmr_torch.wire.serving, "
                                                 "ssmr_torch.wire.link, ssmr_torch.wire.robot_end")
