"""What every command shares: its configuration by Hydra, its directory, its end, one clear message, and result.json."""

from __future__ import annotations

import ctypes
import errno
import functools
import logging
import os
import sys
from collections.abc import Mapping
from pathlib import Path

import hydra
from hydra.core.config_store import ConfigStore
from hydra.core.hydra_config import HydraConfig
from hydra.experimental.callback import Callback
from hydra.types import RunMode
from omegaconf import DictConfig, MissingMandatoryValue, OmegaConf

from ssmr_torch.configuration import folder, of_groups, plain_values, register, settings_lines
from ssmr_torch.configuration_check import check_values
from ssmr_torch.extras import remedy
from ssmr_torch.interruption import END, belong_to, ended_in_order
from ssmr_torch.provenance import provenance
from ssmr_torch.quiet_libraries import quiet
from ssmr_torch.renamed import refuse_old_names
from ssmr_torch.result_files import save_json
from ssmr_torch.run_directory import DirectoryInUse, alone_in, lock, release
from ssmr_torch.short_refusals import OF_THE_COMMAND_LINE, built_wrongly, in_one_sentence

FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)
WHOLE_ERROR = "HYDRA_FULL_ERROR"  # with it Hydra hands errors on; without it, it prints them and ends the process
THEIRS = ("MisconfigurationException",)  # what Lightning raises for a trainer that is not possible here

M_TRIM_THRESHOLD, M_MMAP_THRESHOLD = -1, -3  # of malloc.h


def entry_point(name: str, *, resumed: str | None = None, at_a_robot: bool = False):
    """Run function(config, directory) → metric under Hydra, with conf/NAME.yaml.

    Bad input, a full disk and a signal end in one message; the directory is that of one command at a time.
    resumed: the option with which the same command goes on after an interruption, "" for none; None where it starts
    from its beginning.   at_a_robot: whether a signal leaves a robot all the time that it takes to stop.
    """

    def decorate(function):
        @functools.wraps(function)
        def task(config):
            look_here()
            quiet()
            keep_memory()
            directory = Path(HydraConfig.get().runtime.output_dir)
            follow(directory, resumed)
            try:
                check_values(name, plain_values(config))
                with alone_in(directory):
                    for line in settings_lines(config, HydraConfig.get().runtime.choices):
                        print(line, flush=True)
                    return function(config, directory)
            except DirectoryInUse as error:
                raise SystemExit(f"{name}: {error}") from error
            except Exception as error:
                what, expected = said(error)
                if not expected and HydraConfig.get().mode != RunMode.MULTIRUN:
                    raise
                return refuse(f"{name}: {what}", directory, error, expected)

        look_here()
        register()
        main = hydra.main(version_base="1.3", config_path=str(folder()), config_name=name)(task)
        return in_names_of_this_version(name, ended_well(name, main, at_a_robot))

    return decorate


def in_names_of_this_version(name: str, main):
    """main, which ends in one message where the command line has names of earlier versions."""
    @functools.wraps(main)
    def checked(*given):
        try:
            refuse_old_names(sys.argv[1:] if not given else ())
        except ValueError as error:
            raise SystemExit(f"{name}: {error}") from error
        return main(*given)

    return checked


class OneCommand(Callback):
    """The directory of a run, or of a multirun, is that of one command, before anything is written there.

    The processes of one search share it.
    """

    def on_run_start(self, config: DictConfig, **_) -> None:
        self._take(config, config.hydra.run.dir)

    def on_multirun_start(self, config: DictConfig, **_) -> None:
        self._take(config, config.hydra.sweep.dir, shared="search_sweeper" in config.hydra.sweeper._target_)

    @staticmethod
    def _take(config: DictConfig, directory: str, shared: bool = False) -> None:
        try:
            lock(directory, shared=shared)
        except (DirectoryInUse, OSError) as error:  # Hydra would make a warning of it
            raise SystemExit(f"{config.hydra.job.name}: {in_words(error)}") from error


def ended_well(name: str, main, at_a_robot: bool = False):
    """main, which ends in one message after a signal and where Hydra cannot write, and gives its directories back."""
    @functools.wraps(main)
    def checked(*given):
        asked = os.environ.get(WHOLE_ERROR)
        os.environ[WHOLE_ERROR] = "1"
        try:
            with ended_in_order(name):
                END.limit = None if at_a_robot else END.limit
                return main(*given)
        except (*OF_THE_COMMAND_LINE, ValueError) as error:  # those of the work are told within it
            if asked == "1":
                raise
            raise SystemExit(f"{name}: {in_one_sentence(error, of_groups(sys.argv[1:]))}") from error
        except OSError as error:
            raise SystemExit(f"{name}: {in_words(error)}") from error
        finally:
            release()
            os.environ.pop(WHOLE_ERROR)
            os.environ.update({} if asked is None else {WHOLE_ERROR: asked})

    return checked


def follow(directory: Path, resumed: str | None) -> None:
    """Say how the work goes on after a signal; in a process that a launcher has started, end with the one that did."""
    logging.raiseExceptions = False  # a log that a full disk does not take is no reason for a traceback
    several = HydraConfig.get().mode == RunMode.MULTIRUN
    if END.command is None and several:
        belong_to(os.getppid())
    if resumed is None:
        return
    searches = several and HydraConfig.get().runtime.choices.get("search")
    place = Path(HydraConfig.get().sweep.dir).absolute() if several else directory
    where = f"hydra.{'sweep' if several else 'run'}.dir={place}"
    END.further = f"the same command with {f'{resumed} and ' if resumed and not searches else ''}{where} goes on"
    if several or not resumed:
        END.can_go_on()


def in_words(error: Exception) -> str:
    """What an error says; of a full disk, what to do."""
    if isinstance(error, OSError) and error.errno in FULL:
        return (f"{error.filename or 'a file'} cannot be written, as the disk is full ({error.strerror}); free some "
                "space, and give the same command again")
    return str(error)


def said(error: Exception) -> tuple[str, bool]:
    """What to say of an error, and whether it is one of the input: then this is all that is said."""
    missing = remedy(error) or not_given(error)
    if missing:
        return missing, True
    if built_wrongly(error) and not isinstance(error.__cause__, OSError) or isinstance(error, OF_THE_COMMAND_LINE[1]):
        return in_one_sentence(error), True
    cause = error.__cause__ if built_wrongly(error) else error
    if isinstance(cause, (ValueError, OSError)) or type(cause).__name__ in THEIRS:
        return in_words(cause), True
    return f"{type(cause).__name__}: {cause}", False


def offer(group: str, options: Mapping[str, Mapping]) -> None:
    """Offer options of a group that no file holds: GROUP=NAME puts the keys of the option at the top level."""
    for name, node in options.items():
        ConfigStore.instance().store(group=group, name=name, package="_global_", node=dict(node))


def not_given(error: Exception) -> str | None:
    """What to say of a key that has no value, such as `data.path: ???`; None for any other error."""
    if not isinstance(error, MissingMandatoryValue):
        return None
    return f"{error.full_key} is not given; it has no default: {error.full_key}=VALUE"


def look_here() -> None:
    """Find classes in the working directory, where those that a configuration of one's own names may lie."""
    if os.getcwd() not in sys.path:
        sys.path.append(os.getcwd())


def refuse(message: str, directory: Path, error: Exception, expected: bool) -> float:
    """End a single run here; record a job of a multirun as failed, with an infinite metric: the others go on."""
    full = isinstance(error, OSError) and error.errno in FULL  # none of the others would find a place, either
    if full or HydraConfig.get().mode != RunMode.MULTIRUN:
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
