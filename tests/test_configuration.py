"""Claims about what YAML files leave out: it is filled in from the code, which is read and never imported."""

import importlib
import inspect
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from hydra import compose, initialize_config_dir
from hydra.core.global_hydra import GlobalHydra
from hydra.errors import ConfigCompositionException
from omegaconf import OmegaConf

from ssmr_torch import configuration, option_tables
from ssmr_torch.defaults_of_signatures import is_library, keyword_defaults
from ssmr_torch.extras import remedy

CONF = configuration.folder()
FILES = sorted(CONF.rglob("*.yaml"))
FOREIGN = '''
"""Somebody's package: what it needs is not there, and is not looked for."""

from dataclasses import dataclass, field
from types import MappingProxyType

import a_library_that_is_not_installed
from ssmr_torch.keywords import configurable

SHARE = 0.25


@dataclass(frozen=True)
class Stuff:
    stiffness: float
    damping: float = 2 * SHARE
    shape: dict = field(default_factory=dict)


RUBBER = Stuff(stiffness=1e3, damping=0.1)


class Base:
    given = ("timestep",)

    def __init__(self, sizes, timestep: float = 0.01, gain: float = -1.5, names=("a", "b"),
                 solver: Solver | None = None, points=MappingProxyType({"tip": (0.0, 1.0)}), computed=sum((1, 2)),
                 limit: float = float("inf")):
        raise AssertionError("nothing is built here")


class Inherits(Base):
    pass


@configurable(RUBBER, given=("workers",))
def make(name: str, *, share: float = SHARE, workers: int = 1, **stuff):
    raise AssertionError("nothing is built here")
'''


def repeated(node, path: str = "") -> Iterator[str]:
    """Where a plain configuration sets what its target has by default."""
    if isinstance(node, dict):
        defaults = configuration.defaults_of(node["_target_"]) if isinstance(node.get("_target_"), str) else {}
        yield from (f"{path}{name} = {value!r}" for name, value in node.items()
                    if name in defaults and defaults[name] == value and isinstance(defaults[name], bool)
                    == isinstance(value, bool))
    for name, value in node.items() if isinstance(node, dict) else enumerate(node) if isinstance(node, list) else ():
        yield from repeated(value, f"{path}{name}.")


def targets(node) -> Iterator[str]:
    if isinstance(node, dict) and isinstance(node.get("_target_"), str):
        yield node["_target_"]
    for value in node.values() if isinstance(node, dict) else node if isinstance(node, list) else ():
        yield from targets(value)


def contents(path: Path):
    return OmegaConf.to_container(OmegaConf.load(path))


PAPER = (CONF.parent / "ssmr_torch" / "paper").is_dir()
TARGETS = sorted({target for path in FILES for target in targets(contents(path)) if target.startswith("ssmr_torch.")
                  and (PAPER or not target.startswith("ssmr_torch.paper."))})


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.relative_to(CONF).as_posix())
def test_no_file_repeats_a_default(path):
    assert not list(repeated(contents(path)))


def inherited(group: str, name: str) -> dict:
    """What an option sets, with what the options of its own group set that it builds on."""
    entry, _ = option_tables.option(CONF, f"{group}/{name}") or (contents(CONF / group / f"{name}.yaml"), None)
    parents = [each for each in entry.pop("defaults", []) if isinstance(each, str) and each != "_self_"]
    merged = OmegaConf.merge(*(inherited(group, parent) for parent in parents), entry)
    return OmegaConf.to_container(merged)


def echoed(own, before, path: str = "") -> Iterator[str]:
    """Where an option sets what it would have without."""
    for name, value in own.items():
        if isinstance(value, dict) and isinstance(before.get(name), dict):
            yield from echoed(value, before[name], f"{path}{name}.")
        elif name in before and before[name] == value and name not in ("_target_", "defaults"):
            yield f"{path}{name} = {value!r}"


@pytest.mark.parametrize(("group", "name"), [
    (group, name) for group in sorted({*option_tables.groups(CONF), "excitation", "model", "fit", "controller"})
    for name in configuration.options(group) if not group.startswith(("row/", "controller/"))])
def test_no_option_repeats_what_it_inherits(group, name):
    entry, _ = option_tables.option(CONF, f"{group}/{name}") or (contents(CONF / group / f"{name}.yaml"), None)
    parents = [each for each in entry.pop("defaults", []) if isinstance(each, str) and each != "_self_"]
    for parent in parents:
        before = inherited(group.partition("/")[0], parent)
        configured = OmegaConf.create(before)
        configuration.fill(configured)
        assert not list(echoed(entry, OmegaConf.to_container(configured)))


def test_a_repeated_default_would_be_found_at_any_depth():
    node = {"controlled": [{"excitation": {"_target_": "ssmr_torch.collection.excitation.SmoothRandom", "share": 0.5,
                                            "knot_interval": 0.4}}],
            "controller": {"_target_": "ssmr_torch.control.mpc.ModelPredictiveController", "horizon": 5, "period": 1.0}}
    assert list(repeated(node)) == ["controlled.0.excitation.knot_interval = 0.4", "controller.horizon = 5"]


@pytest.mark.parametrize("target", TARGETS)
def test_what_is_read_of_the_source_is_what_python_says(target):
    module, _, name = target.rpartition(".")
    try:
        parameters = inspect.signature(getattr(importlib.import_module(module), name)).parameters
    except ModuleNotFoundError as error:
        if remedy(error) is None and not error.name.startswith("ssmr_torch.paper"):  # paper/ can be deleted
            raise
        pytest.skip(f"{error.name} is not there")
    for key, value in keyword_defaults(target).items():
        assert plain(parameters[key].default) == value, key


def plain(value):
    if isinstance(value, tuple | list):
        return [plain(each) for each in value]
    return {key: plain(each) for key, each in value.items()} if hasattr(value, "items") else value


@pytest.fixture
def somebody(tmp_path, monkeypatch):
    (tmp_path / "somebody").mkdir()
    (tmp_path / "somebody" / "things.py").write_text(FOREIGN)
    (tmp_path / "conf" / "plant").mkdir(parents=True)
    monkeypatch.syspath_prepend(tmp_path)
    configuration.defaults_of.cache_clear()
    return tmp_path


def test_somebodys_own_classes_and_functions_are_filled_by_their_source_alone(somebody):
    assert keyword_defaults("somebody.things.Inherits") == keyword_defaults("somebody.things.Base") == {
        "gain": -1.5, "names": ["a", "b"], "points": {"tip": [0.0, 1.0]}, "limit": float("inf")}
    assert keyword_defaults("somebody.things.make") == {"share": 0.25, "stiffness": 1e3, "damping": 0.1}
    assert keyword_defaults("somebody.things.Stuff") == {"damping": 0.5}
    assert keyword_defaults("somebody.things.nothing") == keyword_defaults("nowhere.Thing") == {}
    assert not any(name.startswith("somebody") for name in sys.modules)


def test_a_file_of_somebodys_own_folder_is_filled_and_can_be_overridden_and_a_misspelled_key_is_refused(somebody):
    (somebody / "conf" / "own.yaml").write_text("_target_: somebody.things.Base\nnames: [c]\n")
    with initialize_config_dir(str(somebody / "conf"), version_base="1.3"):
        config = compose("own", ["gain=3"])
        assert (config.gain, list(config.names), config.points.tip[1]) == (3, ["c"], 1.0) and "timestep" not in config
        with pytest.raises(ConfigCompositionException, match="gian"):
            compose("own", ["gian=3"])


def test_what_a_defaults_list_puts_into_a_mapping_stays():
    config = configuration.composed("control", ["observer@controller.observer=output_disturbance"])
    assert config.controller.observer.process_noise == 1e-3 and config.controller.horizon == 5


def test_libraries_are_left_as_they_are():
    assert is_library("lightning") and is_library("os") and not is_library("ssmr_torch")
    assert set(configuration.composed("train").trainer) == set(contents(CONF / "groups" / "trainer.yaml")["cpu"])


@pytest.mark.parametrize("model", configuration.options("model"))
def test_no_model_is_configured_with_what_the_data_give(model):
    config = configuration.composed("train", [f"model={model}"]).model
    assert not {"input_dim", "output_dim", "window_timestep"} & set(config) and config.get("timestep") is None


def test_composing_in_the_middle_of_hydra_leaves_it_as_it_was():
    with initialize_config_dir(str(CONF), version_base="1.3"):
        before = GlobalHydra.instance().hydra
        assert configuration.composed("train", ["model.delays=3"]).model.delays == 3
        assert GlobalHydra.instance().hydra is before and compose("collect").plant
    assert configuration.composed("collect", hydra=True).hydra.run.dir and not GlobalHydra.instance().is_initialized()


def test_all_is_shown_without_importing_torch_or_lightning():
    code = ("import sys\nfor name in ('torch', 'lightning', 'numba', 'h5py'): sys.modules[name] = None\n"
            "from ssmr_torch.configuration import composed\nprint(composed('train').model.dynamics_degree, "
            "composed('control').controller.first_iterations, composed('train').module.transient)")
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.stdout.split() == ["3", "10", "0.1"], done.stderr
