"""Configurations of the entry points as Hydra composes them; the only file of the package that knows Hydra.

A YAML file holds what differs from the code. `register` makes Hydra fill each mapping that has a `_target_` with the
defaults of what it names as it loads a file: all are shown by --cfg job, can be changed on the command line, and a
misspelled one is refused.
"""

from __future__ import annotations

import copy
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import cache
from importlib.util import find_spec
from pathlib import Path

from hydra import compose, initialize_config_dir
from hydra._internal.core_plugins import file_config_source
from hydra._internal.sources_registry import SourcesRegistry
from hydra.core.global_hydra import GlobalHydra
from hydra.core.hydra_config import HydraConfig
from hydra.core.object_type import ObjectType
from hydra.plugins.config_source import ConfigResult
from hydra.utils import instantiate
from omegaconf import DictConfig, ListConfig, MissingMandatoryValue, OmegaConf, open_dict
from omegaconf.errors import InterpolationResolutionError

from ssmr_torch import found_settings, option_tables
from ssmr_torch.defaults_of_signatures import is_library, keyword_defaults
from ssmr_torch.renamed import refuse_old_names

HERE = Path(__file__).resolve().parent
SOURCE = "file"


class FileConfigSource(file_config_source.FileConfigSource):
    """Files of a folder and entries of its tables (`option_tables`), each with the defaults of what it names.

    Its name is that of Hydra's own class, which it takes the place of.
    """

    def load_config(self, config_path: str) -> ConfigResult:
        entry = None if super().is_config(config_path) else option_tables.option(Path(self.path), config_path)
        if entry is None:
            result = super().load_config(config_path)
        else:
            content, package = entry
            result = ConfigResult(config=OmegaConf.create(content), path=f"{self.scheme()}://{self.path}",
                                  provider=self.provider, header={"package": package})
        fill(result.config)
        return result

    def is_config(self, config_path: str) -> bool:
        if config_path.partition("/")[0] in option_tables.HIDDEN:
            return False
        return super().is_config(config_path) or option_tables.option(Path(self.path), config_path) is not None

    def is_group(self, config_path: str) -> bool:
        if config_path.partition("/")[0] in option_tables.HIDDEN:
            return False
        return super().is_group(config_path) or config_path in option_tables.groups(Path(self.path))

    def list(self, config_path: str, results_filter: ObjectType | None) -> list[str]:
        """Names of the groups, of the options, or of both, that a group holds in files and tables."""
        place, found = Path(self.path), []
        files = super().list(config_path, results_filter) if super().is_group(config_path) else []
        if results_filter in (None, ObjectType.GROUP):
            found += [group.rpartition("/")[2] for group in option_tables.groups(place)
                      if group.rpartition("/")[0] == config_path]
        if results_filter in (None, ObjectType.CONFIG):
            found += option_tables.entries(place, config_path)
        return sorted({*files, *found})


def register() -> None:
    """Let Hydra read folders through `FileConfigSource`, and know the resolvers that conf/ uses. May be repeated."""
    OmegaConf.register_new_resolver("upper", str.upper, replace=True)
    SourcesRegistry.instance().types[SOURCE] = FileConfigSource


def folder() -> Path:
    """The folder of configurations: that of the installed package, in a checkout the one beside it."""
    try:
        spec = find_spec("ssmr_torch.conf")
    except ImportError:
        spec = None
    installed = [Path(place) for place in (spec.submodule_search_locations or [])] if spec else []
    for place in (*installed, HERE.parent / "conf"):
        if (place / "train.yaml").is_file():
            return place
    raise FileNotFoundError(f"no configurations beside {HERE}; install ssmr_torch again")


def own_folders() -> list[str]:
    """The folder that --config-dir has given to the command that runs; empty without one."""
    sources = HydraConfig.get().runtime.config_sources if HydraConfig.initialized() else []
    return [source.path for source in sources if source.provider == "command-line"]


def composed(entry: str, overrides: Sequence[str] = (), *, hydra: bool = False,
             config_dir: str | Path | None = None) -> DictConfig:
    """conf/ENTRY.yaml as the command line composes it with these overrides; hydra: with Hydra's own settings as well.

    Groups of the user's own count: those in config_dir, and those that --config-dir gave to the command that runs.
    Raises ValueError for a config_dir that is no folder and for names of earlier versions, and Hydra's
    ConfigCompositionException for overrides that the configuration does not have.
    """
    register()
    refuse_old_names(overrides)
    if config_dir is not None and not Path(config_dir).is_dir():
        raise ValueError(f"config_dir is {config_dir}, which is no folder; expected one with groups, such as "
                         "model/NAME.yaml")
    own = own_folders() if config_dir is None else [*own_folders(), str(Path(config_dir).resolve())]
    overrides = [*overrides, *([f"hydra.searchpath={[f'file://{place}' for place in own]}"] if own else [])]
    with _left_as_found(), initialize_config_dir(str(folder()), version_base="1.3"):
        return compose(entry, overrides, return_hydra_config=hydra)


def as_in_a_job(entry: str, overrides: Sequence[str], directory: Path) -> DictConfig:
    """A configuration as an entry point gets it from Hydra, for a run in this directory; `hydra:` resolves in it."""
    config = composed(entry, overrides, hydra=True)
    with open_dict(config):
        config.hydra.runtime.output_dir = str(directory)
        config.hydra.job.name, config.hydra.job.num = entry, 0
        HydraConfig.instance().set_config(config)
        del config["hydra"]
    return config


def options(group: str, config_dir: str | Path | None = None) -> list[str]:
    """Names of the options of a group, in files and tables of the package, of --config-dir, and of config_dir."""
    places = [folder(), *map(Path, own_folders()), *([] if config_dir is None else [Path(config_dir)])]
    sources = [FileConfigSource("main", f"{SOURCE}://{place}") for place in places]
    return sorted({name for source in sources if source.is_group(group)
                   for name in source.list(group, ObjectType.CONFIG)})


def of_groups(words: Sequence[str]) -> list[str]:
    """Those words of a command line that choose an option of a group, or have no key."""
    keys = [word.partition("=")[0].lstrip("+~").partition("@")[0] for word in words]
    return [word for word, key in zip(words, keys) if "=" in word and (not key or options(key))]


def settings_lines(config: DictConfig, choices: Mapping) -> list[str]:
    """What a run says first: which row of found settings it takes, or that the defaults hold.

    choices: option by group. Raises ValueError for settings=found without a robot, and for an option of module that
    there is not; that group may lack the name of a model.
    """
    module = choices.get("module")
    if module not in (None, choices.get("model"), *options("module")):
        raise ValueError(f"module={module} is no option; the options are {', '.join(options('module'))}")
    return list(found_settings.lines(config.get("found"), choices, lambda robot, model: model in options(
        f"{option_tables.OF_MODELS}{robot}")))


def plain(config: DictConfig, without: Sequence[str] = ()) -> dict:
    """A configuration as plain values, interpolations resolved; without these of its keys."""
    kept = OmegaConf.masked_copy(config, [key for key in config if key not in without])
    return OmegaConf.to_container(kept, resolve=True)


def plain_values(config: DictConfig) -> dict:
    """A configuration as plain values; a part with an interpolation that nothing resolves stays as it is written."""
    values = OmegaConf.to_container(config)
    for key, written_value in values.items():
        try:
            value = config[key]
            values[key] = OmegaConf.to_container(value, resolve=True) if OmegaConf.is_config(value) else value
        except (InterpolationResolutionError, MissingMandatoryValue):
            values[key] = written_value
    return values


def changed(config: DictConfig, values: Mapping[str, object]) -> DictConfig:
    """A copy with other values under these dotted names, merged in as the command line does; a mapping may add keys."""
    config = copy.deepcopy(config)
    for name, value in values.items():
        OmegaConf.update(config, name, value, merge=True, force_add=isinstance(value, Mapping))
    return config


def built(node: DictConfig):
    """What a mapping with a `_target_` describes, made by Hydra."""
    return instantiate(node)


def written(entry: str, overrides: Sequence[str] = ()) -> dict:
    """What is `composed`, in plain values; interpolations as they are written."""
    return OmegaConf.to_container(composed(entry, overrides))


@contextmanager
def _left_as_found() -> Iterator[None]:
    """Whatever Hydra is in the middle of, as when a job composes the configuration of another one."""
    running = GlobalHydra.instance().hydra
    GlobalHydra.instance().clear()
    try:
        yield
    finally:
        GlobalHydra.instance().hydra = running


def fill(config: DictConfig | ListConfig) -> None:
    """Add to each mapping with a `_target_`, at any depth, the defaults that it does not set.

    What the defaults list of a file puts into a mapping is set there.
    """
    listed = _listed(config)
    _fill(config, listed if isinstance(config, DictConfig) and "_target_" in config else frozenset())


def _fill(node, listed: frozenset[str] = frozenset()) -> None:
    if not isinstance(node, (DictConfig, ListConfig)) or node._is_none() or node._is_missing() \
            or node._is_interpolation():
        return
    inner = range(len(node)) if isinstance(node, ListConfig) else list(node)
    for key in inner:
        _fill(node._get_node(key))
    target = node._get_node("_target_") if isinstance(node, DictConfig) else None
    if target is None or target._is_interpolation() or target._is_missing() or not isinstance(target._value(), str):
        return
    for name, default in defaults_of(target._value()).items():
        if name not in node and name not in listed:
            node[name] = default


@cache
def defaults_of(target: str) -> dict:
    """`keyword_defaults` of a target, none of a library's: Lightning's trainer stays as short as its YAML."""
    return {} if is_library(target.partition(".")[0]) else keyword_defaults(target)


def _listed(config) -> frozenset[str]:
    """Keys that the defaults list of a file fills: `observer` of `/observer@observer: none`."""
    if not isinstance(config, DictConfig) or "defaults" not in config:
        return frozenset()
    entries = [key for entry in config.defaults if isinstance(entry, DictConfig) for key in entry]
    return frozenset(str(key).rpartition("@")[2].rpartition("/")[2].partition(".")[0] for key in entries)
