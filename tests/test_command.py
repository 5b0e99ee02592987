"""The command: what it lists, refuses and completes, and that it is the script of the same name."""

import ast
import os
import re
import runpy
import shlex
import shutil
import subprocess
import sys
import tokenize
import tomllib
from importlib.metadata import packages_distributions
from pathlib import Path

import pytest
from hydra import compose, initialize_config_dir
from hydra.core.override_parser.overrides_parser import OverridesParser

from ssmr_torch import __version__, command, extras
from ssmr_torch.benchmarks.catalogue import NAMES, as_overrides, settings_of
from ssmr_torch.entry_point import offer

ROOT = Path(__file__).resolve().parents[1]
CONF, EXPERIMENTS = ROOT / "conf", ROOT / "experiments"
SSMR = Path(sys.executable).with_name("ssmr")
PAGES = [ROOT / "README.md", *filter(Path.is_file, [ROOT / "CONTRIBUTING.md"]), *sorted((ROOT / "docs").rglob("*.md")),
         ROOT / "docs/tutorials/your_own_data.py"]
SOURCES = [path for folder in ("ssmr_torch", "experiments", "conf") for path in sorted((ROOT / folder).rglob("*"))
           if path.suffix in (".py", ".yaml")]
NAMED = re.compile(rf"\bssmr ({'|'.join(command.COMMANDS)})\b((?: (?![|#])(?:\\\n)?[^`#\n;]*)?)")
# key=value, where the value may have quotes or brackets; a sentence may go on after it
OPTION = re.compile(r"""(?<!\S)(?:'[~+]*[\w@./]+=[^']*'|"[~+]*[\w@./]+=[^"]*"|[~+]*[\w@./]+=(?:'[^']*'|"[^"]*"|"""
                    r"""\[[^\]]*\]|[^\s'"\[][^\s'"]*[^\s'";:,.)]|[^\s'"\[;:,.)]))""")
# what stands for something of the reader's own
OF_THE_READER = re.compile(r"…|(^|/)[A-Z]+$|^(MODEL|ROBOT)")


def ssmr(*arguments, **environment):
    return subprocess.run([SSMR, *arguments], capture_output=True, text=True, env=os.environ | environment)


def said(capsys, monkeypatch, *arguments):
    """Exit status, standard output and standard error of the command in this process."""
    monkeypatch.setattr(sys, "argv", ["ssmr", *arguments])
    status = command.main()
    return status, *capsys.readouterr()


@pytest.mark.parametrize("ask", [[], ["--help"], ["-h"]])
def test_help_lists_every_command_with_a_sentence(ask, capsys, monkeypatch):
    status, text, _ = said(capsys, monkeypatch, *ask)
    assert status == 0
    for name in command.COMMANDS:
        assert re.search(rf"(?m)^  {name} +\S.{{30,}}\.$", text), name


def test_every_script_with_a_configuration_is_a_command():
    scripts = {path.stem for path in EXPERIMENTS.glob("*.py")} & {path.stem for path in CONF.glob("*.yaml")}
    assert {name.replace("-", "_") for name in command.COMMANDS} == scripts


def test_help_and_refusals_import_neither_torch_nor_hydra():
    code = ("import sys; from ssmr_torch.command import main; sys.argv = ['ssmr', '--help']; main(); "
            "sys.argv = ['ssmr', 'nothing']; main(); "
            "print(sorted({'torch', 'hydra', 'numpy'} & set(sys.modules)))")
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.splitlines()[-1] == "[]"


def test_every_folder_of_the_package_is_one_that_the_wheel_carries():
    listed = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["setuptools"]["packages"]
    folders = {path.parent.relative_to(ROOT).as_posix().replace("/", ".")
               for path in (ROOT / "ssmr_torch").rglob("*.py")}
    assert set(listed) == folders | {"ssmr_torch.conf", "ssmr_torch.experiments", "hydra_plugins"}


def test_the_version_is_the_packages(capsys, monkeypatch):
    assert said(capsys, monkeypatch, "--version")[:2] == (0, f"ssmr_torch {__version__}\n")
    assert tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["version"] == __version__


def test_an_unknown_command_is_refused_with_the_list_and_the_nearest_one(capsys, monkeypatch):
    status, _, complaint = said(capsys, monkeypatch, "trian", "model=ssmr")
    assert status == 2 and "no command 'trian'; did you mean train?" in complaint
    assert ", ".join(command.COMMANDS) in complaint
    assert "did you mean" not in said(capsys, monkeypatch, "nothing")[2]


@pytest.mark.parametrize(("arguments", "key"), [
    (["report"], "directory"), (["evaluate"], "artifact"), (["check"], "data.path")])
def test_a_key_that_must_be_given_is_named_in_one_sentence(arguments, key, tmp_path):
    done = ssmr(*arguments, f"hydra.run.dir={tmp_path}")
    assert done.returncode == 1
    assert done.stderr == f"{arguments[0]}: {key} is not given; it has no default: {key}=VALUE\n"


def test_help_of_a_command_is_hydras():
    text = ssmr("train", "--help").stdout
    assert "== Configuration groups ==" in text and "model: auto, dmd, edmd" in text


@pytest.mark.parametrize("name", command.COMMANDS)
def test_a_command_and_its_script_compose_the_same_configuration(name, capsys, monkeypatch, tmp_path):
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "robot.yaml").write_text("gripper: 3\n")
    options = ["--config-dir", str(tmp_path), "+mine=robot", "--cfg", "all"]
    status, composed, _ = said(capsys, monkeypatch, name, *options)
    script = EXPERIMENTS / f"{name.replace('-', '_')}.py"
    monkeypatch.setattr(sys, "argv", [str(script), *options])
    runpy.run_path(str(script), run_name="__main__")
    assert status == 0 and "gripper: 3" in composed and "callbacks" in composed
    assert capsys.readouterr().out == composed


def test_groups_of_ones_own_count_in_the_jobs_that_a_command_composes(tmp_path):
    """As `ssmr reproduce --config-dir DIR` composes its jobs."""
    (tmp_path / "conf" / "task").mkdir(parents=True)
    (tmp_path / "conf" / "task" / "mine.yaml").write_text("defaults: [circle]\nradius: 0.0123\n")
    (tmp_path / "program.py").write_text(
        "from ssmr_torch.configuration import composed, own_folders\n"
        "from ssmr_torch.entry_point import entry_point\n\n"
        "@entry_point('report')\ndef main(config, directory):\n"
        "    print(composed('control', ['task=mine']).task.radius, *own_folders())\n\nmain()\n")
    done = subprocess.run([sys.executable, "program.py", "--config-dir", "conf", "directory=."], cwd=tmp_path,
                          capture_output=True, text=True)
    assert done.stdout.split() == ["0.0123", str(tmp_path / "conf")], done.stderr


def test_composing_imports_neither_torch_nor_lightning_nor_matplotlib():
    code = ("import sys; from ssmr_torch.command import main\n"
            "for name in ('train', 'export', 'evaluate', 'control', 'collect'):\n"
            "    sys.argv = ['ssmr', name, '--cfg', 'job']; main()\n"
            "print(sorted({'torch', 'lightning', 'matplotlib', 'scipy', 'h5py', 'numba'} & set(sys.modules)))")
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.splitlines()[-1] == "[]"


def test_a_class_of_ones_own_is_found_in_the_working_directory_and_results_lie_there(tmp_path):
    (tmp_path / "conf" / "plant").mkdir(parents=True)
    (tmp_path / "conf" / "plant" / "mine.yaml").write_text("_target_: my_plants.refuse\n")
    (tmp_path / "my_plants.py").write_text("def refuse():\n    raise ValueError('a plant of my own')\n")
    done = subprocess.run([SSMR, "collect", "--config-dir", "conf", "plant=mine"], cwd=tmp_path, capture_output=True,
                          text=True)
    assert done.returncode == 1 and "collect: " in done.stderr and "a plant of my own" in done.stderr
    assert len(list((tmp_path / "outputs" / "collect").iterdir())) == 1


@pytest.mark.parametrize(("line", "expected", "unexpected"), [
    ("ssmr tr", {"train"}, set()), ("ssmr ", set(command.COMMANDS), set()),
    ("ssmr train model=ss", {"model=ssmr", "model=sssr", "model=ssmr_stability_guard"}, {"model=dmd"}),
    ("ssmr serve-plant plant=trunk_", {"plant=trunk_coarse"}, {"plant=diamond"}),
    ("ssmr nothing model=", set(), {"model=ssmr"})])
def test_the_shell_completes_commands_and_options(line, expected, unexpected):
    script = ('eval "$(ssmr -sc install=bash)"; COMP_LINE=$1; COMP_POINT=${#1}; COMP_WORDS=($1); '
              'COMP_CWORD=$(( ${#COMP_WORDS[@]} - 1 )); [[ $1 == *" " ]] && COMP_CWORD=${#COMP_WORDS[@]}; '
              'hydra_bash_completion; printf "%s\\n" "${COMPREPLY[@]}"')
    done = subprocess.run(["bash", "-c", script, "bash", line], capture_output=True, text=True, check=True,
                          env=os.environ | {"PATH": f"{SSMR.parent}:{os.environ['PATH']}"})
    offered = set(done.stdout.split())
    assert expected <= offered and not unexpected & offered
    if line == "ssmr tr":
        assert offered == {"train"}


def test_without_hydra_a_command_says_what_to_install():
    code = "import sys; sys.modules['hydra'] = None; from ssmr_torch.command import main; sys.exit(main())"
    done = subprocess.run([sys.executable, "-c", code, "train"], capture_output=True, text=True)
    assert done.returncode == 1
    assert done.stderr == "ssmr train: hydra is not installed: pip install 'ssmr_torch[train]'\n"


def test_without_optuna_a_search_says_what_to_install():
    code = "import sys; sys.modules['optuna'] = None; from ssmr_torch.command import main; sys.exit(main())"
    done = subprocess.run([sys.executable, "-c", code, "train", "-m", "search=ssmr"], capture_output=True, text=True)
    assert done.returncode == 1
    assert done.stderr == "ssmr train: optuna is not installed: pip install 'ssmr_torch[search]'\n"


def test_without_torch_a_command_says_what_to_install(tmp_path):
    code = "import sys; sys.modules['lightning'] = None; from ssmr_torch.command import main; sys.exit(main())"
    done = subprocess.run([sys.executable, "-c", code, "train", "data.path=nowhere.h5"], cwd=tmp_path,
                          capture_output=True, text=True)
    assert done.returncode == 1
    assert done.stderr == "train: lightning is not installed: pip install 'ssmr_torch[train]'\n"


def test_every_package_that_a_message_names_is_brought_by_that_extra():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    brought = project["optional-dependencies"]
    distributions = packages_distributions()
    for module, extra in extras.BROUGHT_BY.items():
        names = {name.lower() for name in distributions.get(module, [module])} | {extra == "view" and "rerun-sdk"}
        required = {re.split(r"[\[<>=!; ]", line)[0].lower() for line in brought[extra]}
        assert names & required or extra == "parallel", (module, extra)
    assert len(project["dependencies"]) == 4


def explained(path):
    """The docstrings and comments of a Python file; the comments of a configuration."""
    text = path.read_text(encoding="utf-8")
    if path.suffix == ".yaml":
        return "\n".join(re.findall(r"(?m)(?:^|\s)#\s?(.*)$", text))
    nodes = [node for node in ast.walk(ast.parse(text))
             if isinstance(node, (ast.Module, ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef))]
    with open(path, "rb") as file:
        comments = [token.string.lstrip("# ") for token in tokenize.tokenize(file.readline)
                    if token.type == tokenize.COMMENT]
    return "\n".join([*(ast.get_docstring(node) or "" for node in nodes), *comments])


def shown():
    """(document, command, what follows it) of every command that pages, docstrings and comments show with options."""
    for path in [*PAGES, *SOURCES]:
        text = (explained(path) if path in SOURCES else path.read_text(encoding="utf-8")).replace("\\\n", " ")
        for name, rest in NAMED.findall(text):
            yield path, name, rest


def documented():
    """(command, overrides) of all of them, without what stands for something of the reader's own."""
    seen = set()
    for path, name, rest in shown():
        words = [shlex.split(word)[0] for word in OPTION.findall(rest)]
        kept = tuple(word for word in words if not OF_THE_READER.search(word.partition("=")[2])
                     and not word.endswith("…"))
        own = re.search(r"--config-dir (\S+)", rest)
        first = next(iter(rest.split()), "")
        if name == "benchmark" and first.islower() and "=" not in first:
            kept = tuple(as_overrides([first, *kept]))
        if own:  # docs/extending.md shows the package of tests/extension
            kept += (f"hydra.searchpath=['file://{ROOT}/tests/extension/{own[1]}']",)
        if kept and (path, name, kept) not in seen:
            seen.add((path, name, kept))
            yield pytest.param(name, kept, id=f"{path.name}: {name} {' '.join(kept)}")


@pytest.fixture(scope="module")
def configurations():
    offer("benchmark", {name: settings_of(name) for name in NAMES})
    with initialize_config_dir(str(CONF), version_base="1.3"):
        yield


@pytest.mark.parametrize(("name", "words"), list(documented()))
def test_every_documented_command_composes(name, words, configurations):
    overrides = OverridesParser.create().parse_overrides([word for word in words if word != "--multirun"])
    single = [f"{override.input_line.partition('=')[0]}={next(iter(override.sweep_string_iterator()))}"
              if override.is_sweep_override() else override.input_line for override in overrides]
    compose(name.replace("-", "_"), single, return_hydra_config=True)


CHEAP = ("check", "export", "evaluate")
STAND_INS = {"FILE.h5", "trajectories.h5", "FILE.ckpt", "DIR", "[A,B]"}  # what `recorded` has


@pytest.fixture(scope="module")
def recorded(tmp_path_factory):
    """A folder with what the pages call FILE.h5, FILE.ckpt, DIR, A and B."""
    at = tmp_path_factory.mktemp("recorded")
    small = ["excitation.decays.count=20", "excitation.validation_decays=1", "excitation.test_decays=1",
             "excitation.decay_duration=2.0", "excitation.progress=false", "plant=slow_manifold", "workers=1"]
    lines = [["collect", *small, "hydra.run.dir=collect"]]
    for model, name in (("ssmr", "A"), ("sssr", "B")):
        lines += [["train", f"model={model}", "data.path=collect/trajectories.h5", f"hydra.run.dir={model}"],
                  ["export", f"checkpoint={model}/model.ckpt", f"artifact={name}", f"name={name}", "formats=[]"]]
    for line in lines:
        subprocess.run([SSMR, *line], cwd=at, check=True, capture_output=True)
    for source, name in (("collect/trajectories.h5", "FILE.h5"), ("collect/trajectories.h5", "trajectories.h5"),
                         ("ssmr/model.ckpt", "FILE.ckpt")):
        shutil.copy(at / source, at / name)
    shutil.copytree(at / "A", at / "DIR")
    return at


def cheap():
    """Commands of a few seconds whose files all have stand-ins."""
    for path, name, rest in shown():
        words = [shlex.split(word)[0] for word in OPTION.findall(rest)]
        files = {word.partition("=")[2] for word in words
                 if word.partition("=")[0] in ("checkpoint", "artifact", "data", "data.path", "recordings")}
        if name in CHEAP and path in PAGES and files and files <= STAND_INS:
            yield pytest.param(name, words, id=f"{path.name}: {name} {' '.join(words)}")


@pytest.mark.slow
@pytest.mark.parametrize(("name", "words"), list(cheap()))
def test_a_cheap_documented_command_runs(name, words, recorded):
    done = subprocess.run([SSMR, name, *words, f"hydra.run.dir=run_{name}"], cwd=recorded, capture_output=True,
                          text=True)
    assert done.returncode == 0, done.stderr
