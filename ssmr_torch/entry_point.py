"""What every command shares: its configuration by Hydra, one clear message on bad input, and result.json."""

from __future__ import annotations

import ctypes
import functools
import logging
import os
import sys
from collections.abc import Mapping
from pathlib import Path

import hydra
from hydra.core.config_store import ConfigStore
from hydra.core.hydra_config import HydraConfig
from hydra.errors import HydraException
from hydra.types import RunMode
from omegaconf import DictConfig, MissingMandatoryValue, OmegaConf
from omegaconf.errors import OmegaConfBaseException

from ssmr_torch.configuration import folder, plain_values, register, settings_lines
from ssmr_torch.configuration_check import check_values
from ssmr_torch.extras import remedy
from ssmr_torch.provenance import provenance
from ssmr_torch.quiet_libraries import quiet
from ssmr_torch.renamed import refuse_old_names
from ssmr_torch.result_files import save_json
from ssmr_torch.short_refusals import built_wrongly, in_one_sentence, one_sentence

THEIRS = ("MisconfigurationException",)  # what Lightning raises for a trainer that is not possible here

M_TRIM_THRESHOLD, M_MMAP_THRESHOLD = -1, -3  # of malloc.h


def entry_point(name: str):
    """Run function(config, directory) → metric under Hydra, with conf/NAME.yaml; bad input ends in one message."""

    def decorate(function):
        @functools.wraps(function)
        def task(config):
            look_here()
            quiet()
            keep_memory()
            directory = Path(HydraConfig.get().runtime.output_dir)
            try:
                check_values(name, plain_values(config))
                for line in settings_lines(config, HydraConfig.get().runtime.choices):
                    print(line, flush=True)
                return function(config, directory)
            except Exception as error:
                what, expected = said(error)
                if not expected and HydraConfig.get().mode != RunMode.MULTIRUN:
                    raise
                return refuse(f"{name}: {what}", directory, error, expected)

        look_here()
        register()
        return in_names_of_this_version(name, hydra.main(version_base="1.3", config_path=str(folder()),
                                                         config_name=name)(task))

    return decorate


def in_names_of_this_version(name: str, main):
    """main, which ends in one message where the command line has names of earlier versions."""
    @functools.wraps(main)
    def checked(*given):
        try:
            refuse_old_names(sys.argv[1:] if not given else ())
        except ValueError as error:
            raise SystemExit(f"{name}: {error}") from error
        with one_sentence(name):
            return main(*given)

    return checked


def offer(group: str, options: Mapping[str, Mapping]) -> None:
    """Offer options of a group that no file holds: GROUP=NAME puts the keys of the option at the top level."""
    for name, node in options.items():
        ConfigStore.instance().store(group=group, name=name, package="_global_", node=dict(node))


def not_given(error: Exception) -> str | None:
    """What to say of a key that has no value, such as `data.path: ???`; None for any other error."""
    if not isinstance(error, MissingMandatoryValue):
        return None
    return f"{error.full_key} is not given; it has no default: {error.full_key}=VALUE"


def said(error: Exception) -> tuple[str, bool]:
    """What to say of an error, and whether it is one of the input: then this is all that is said."""
    missing = remedy(error) or not_given(error)
    if missing:
        return missing, True
    if built_wrongly(error) or isinstance(error, (HydraException, OmegaConfBaseException)):
        return in_one_sentence(error), True
    if isinstance(error, (ValueError, OSError)) or type(error).__name__ in THEIRS:
        return str(error), True
    return f"{type(error).__name__}: {error}", False


def look_here() -> None:
    """Find classes in the working directory, where those that a configuration of one's own names may lie."""
    if os.getcwd() not in sys.path:
        sys.path.append(os.getcwd())


def refuse(message: str, directory: Path, error: Exception, expected: bool) -> float:
    """End a single run here; record a job of a multirun as failed, with an infinite metric: the others go on."""
    if HydraConfig.get().mode != RunMode.MULTIRUN:
        raise SystemExit(message) from error
    logging.getLogger(__name__).error(message, exc_info=None if expected else error)
    save_result(directory, {"failed": message})
    return float("inf")


def keep_memory() -> None:
    """Keep freed memory for the next allocation; else large tensors are mapped anew each time, which takes up to half
    of the time of a Gauss-Newton fit. Only the GNU C library needs it.
    """
    mallopt = getattr(ctypes.CDLL(None), "mallopt", None) if os.name == "posix" else None
    if mallopt:
        for parameter in (M_MMAP_THRESHOLD, M_TRIM_THRESHOLD):
            mallopt(parameter, 1 << 30)


def origin_of(config: DictConfig, resolve: bool = True) -> dict:
    """`provenance` of a run with this configuration; resolve: its interpolations as well."""
    return provenance(OmegaConf.to_container(config, resolve=resolve))


def found_row(config: DictConfig) -> dict | None:
    """The row of found settings that a run takes, as its configuration tells it; None without."""
    return OmegaConf.to_container(config.found) if config.get("found") else None


def save_result(directory: Path, metrics: dict, **more) -> None:
    """result.json: the metrics of this job, and what else tells it from others, for the table of a multirun."""
    save_json(directory / "result.json",
              {"overrides": list(HydraConfig.get().overrides.task), "metrics": metrics} | more)
