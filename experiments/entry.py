"""What all entry points share: configuration, one clear message on bad input, a result file."""

import functools
import json
import logging
import os
import warnings
from pathlib import Path

import hydra
from hydra.core.hydra_config import HydraConfig
from hydra.errors import InstantiationException
from omegaconf import OmegaConf

OmegaConf.register_new_resolver("upper", str.upper, replace=True)

CONF = str(Path(__file__).resolve().parent.parent / "conf")


def entry_point(name: str):
    """Run function(config, directory) → metric under Hydra, with conf/NAME.yaml; bad input ends in one message."""

    def decorate(function):
        @functools.wraps(function)
        def task(config):
            quiet()
            try:
                return function(config, Path(HydraConfig.get().runtime.output_dir))
            except InstantiationException as error:
                raise SystemExit(f"{name}: {error.__cause__ or error}") from error
            except (ValueError, FileNotFoundError) as error:
                raise SystemExit(f"{name}: {error}") from error

        return hydra.main(version_base="1.3", config_path=CONF, config_name=name)(task)

    return decorate


def quiet() -> None:
    """Silence what third parties say about themselves: hardware that is not there, advertisements, deprecations."""
    for name in ("lightning.pytorch.utilities.rank_zero", "lightning.pytorch.accelerators.cuda"):
        logging.getLogger(name).setLevel(logging.WARNING)
    warnings.filterwarnings("ignore", module="lightning|torch")


def save_json(path: Path, content: dict) -> None:
    """Write aside, then rename; infinite and undefined numbers become null."""
    finite = json.loads(json.dumps(content), parse_constant=lambda _: None)
    aside = path.with_name(path.name + ".part")
    aside.write_text(json.dumps(finite, indent=2) + "\n")
    os.replace(aside, path)


def save_result(directory: Path, metrics: dict) -> None:
    """result.json: the metrics of this job, for the table of a sweep."""
    save_json(directory / "result.json", {"overrides": list(HydraConfig.get().overrides.task), "metrics": metrics})
