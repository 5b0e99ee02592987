"""The row of found settings that a search ends with: what its best job set, and how it was found."""

from __future__ import annotations

from datetime import date
from pathlib import Path

from hydra.core.override_parser.overrides_parser import OverridesParser
from omegaconf import OmegaConf

from ssmr_torch import found_settings
from ssmr_torch.renamed import kind_now
from ssmr_torch.result_files import read_json

SECTIONS = ("model", "fit", "derivative")  # of a training's configuration, that a search may set
OF_A_CONTROLLER = "controller/"  # beginning of the options of search that search a controller
OF_ONE_RUN = ("hydra.sweep.dir=", "save_to=")


def save_best(directory: Path, config, rows: list[dict], first: str) -> str:
    """found.yaml in the directory of a search: a table of one row, that of the best job; merged into save_to as well.

    config: that of the multirun, with Hydra's own settings. rows: of the finished jobs, best first by the metric
    `first`. Returns what to tell the user. Raises ValueError for a save_to that is no table of found settings.
    """
    choices, best = config.hydra.runtime.choices, directory / rows[0]["job"]
    composed = OmegaConf.load(best / ".hydra" / "config.yaml")
    metric, scale = ("ISE, mm²", 1e6) if first == "ise" else (first, 1.0)
    how = found_settings.facts(
        date=date.today().isoformat(), command=command(config), budget=budget(config), trials=len(rows),
        seed=config.hydra.sweeper.sampler.get("seed"), metric=metric, score=float(f"{scale * rows[0][first]:.4g}"))
    if choices.search.startswith(OF_A_CONTROLLER):
        part, (name, row) = "controllers", controller_row(choices, composed, overrides_of(best))
    else:
        part, (name, row) = "models", (choices.model, {"settings": model_settings(composed, overrides_of(best))})
    row = {"found": how} | row
    table = directory / "found.yaml"
    found_settings.write(table, choices.get("robot") or "ROBOT", {part: {name: row}})
    told = f"found settings, row {part}.{name}: {table}"
    if config.get("save_to") is None:
        return f"{told}; save_to=conf/found/ROBOT.yaml merges it into a table"
    found_settings.merge(Path(config.save_to), part, name, row)
    return f"{told}, merged into {config.save_to}"


def model_settings(composed, overrides: list) -> dict:
    """The settings of a model that its best job had: those of the row that the search began with, where it took one,
    and over them its overrides of model, fit, derivative, and of the transient that is cut. Another fit or derivative
    is written out as it was composed: a row cannot choose an option.
    """
    settings = OmegaConf.create()
    begun = composed.get("found")
    if begun:
        part, _, name = begun.row.partition(".")
        settings = OmegaConf.create(found_settings.read(table_of(begun.table))[part][name]["settings"])
    for override in overrides:
        key = override.key_or_group
        section, _, rest = key.partition(".")
        if (section in SECTIONS and rest) or key == "module.transient":
            OmegaConf.update(settings, key, override.value(), force_add=True)
        elif section in SECTIONS and section != "model":
            OmegaConf.update(settings, section, composed[section], force_add=True)
    return OmegaConf.to_container(settings)


def controller_row(choices, composed, overrides: list) -> tuple[str, dict]:
    """The name of a controller's row, that of the kind of model in its artifact, and the row without how it was found.
    """
    card = read_json(Path(composed.artifact) / "card.json")
    training = (card.get("provenance") or {}).get("training") or {}
    kind = kind_now(training.get("kind") or card["name"].lower().replace(" ", "_"))
    observer = choices.get("observer@controller.observer", "none")  # a static pregain has no place for one
    settings = OmegaConf.create()
    for override in overrides:
        section, _, rest = override.key_or_group.partition(".")
        if section == "controller" and rest:
            OmegaConf.update(settings, rest, override.value(), force_add=True)
    return kind, {"model": f"model={kind}", "controller": choices.controller,
                  **({"observer": observer} if observer != "none" else {}),
                  "settings": OmegaConf.to_container(settings)}


def command(config) -> str:
    """The command of a multirun, without what tells one run of it from another."""
    given = [*config.hydra.overrides.task, *config.hydra.overrides.hydra]
    kept = [each for each in given if not each.startswith((*OF_ONE_RUN, "hydra.mode="))]
    return " ".join([f"ssmr {config.hydra.job.name.replace('_', '-')} -m", *kept])


def budget(config) -> str:
    """Trials and CPU minutes that a search was given."""
    minutes = config.get("search_minutes")
    return f"{config.hydra.sweeper.n_trials} trials" + (f", {minutes:g} CPU minutes" if minutes is not None else "")


def overrides_of(job: Path) -> list:
    return OverridesParser.create().parse_overrides(read_json(job / "result.json")["overrides"])


def table_of(shown: str) -> Path:
    """The file of a table, from the name under which a run tells it."""
    from ssmr_torch.configuration import folder

    return folder() / "found" / Path(shown).name if shown.startswith("conf/found/") else Path(shown)
