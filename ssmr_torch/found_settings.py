"""Found settings: what searches found for a robot, one table per robot, and what a run says of the row that it takes.

A table is a YAML file, found/ROBOT.yaml of a folder of configurations. Its `models` and `controllers` hold one row per
model: `settings`, and `found`, which says when and how they were found. A row of a controller also names the
`controller`, its `observer`, and the `model` of the artifact that it was found with.
"""

from __future__ import annotations

import logging
from collections.abc import Iterator, Mapping
from pathlib import Path

from omegaconf import OmegaConf

from ssmr_torch import checksum
from ssmr_torch.result_files import save_text

log = logging.getLogger(__name__)
PARTS = ("models", "controllers")
FACTS = ("date", "command", "budget", "trials", "seed", "metric", "score", "note")
HEADER = """\
# Found settings of the robot {robot}: what searches found, for comparisons; docs/training.md.
# settings=found takes a row of models, controller={robot}/NAME one of controllers. A search writes a row: save_to=FILE.
"""


def read(path: Path) -> dict:
    """The table of a file: part → name → row. Raises ValueError where it is no table of found settings.

    One line in the log says that a table was edited, or damaged, after a search wrote it.
    """
    try:
        text = Path(path).read_text(encoding="utf-8")
        table = OmegaConf.to_container(OmegaConf.create(text) if text.strip() else OmegaConf.create())
    except Exception as error:  # OmegaConf and the library below it raise many types of errors
        raise ValueError(f"{path} is no table of found settings ({' '.join(str(error).split())[:200]}); correct or "
                         "write it again") from error
    if checksum.edited(text) or not table:
        log.warning("%s was edited or damaged after it was written; its scores may not belong to its settings", path)
    if not isinstance(table, dict) or not set(table) <= set(PARTS):
        keys = ", ".join(map(str, table)) if isinstance(table, Mapping) else type(table).__name__
        raise ValueError(f"{path} holds {keys}; expected a table of found settings: {' and '.join(PARTS)}")
    for part, rows in table.items():
        if not isinstance(rows or {}, dict):
            raise ValueError(f"{path}: {part} is {rows!r:.60}; expected rows by name")
        for name, row in (rows or {}).items():
            row = row if isinstance(row, dict) else {}
            wanted = {"settings", "found"} | ({"controller"} if part == "controllers" else set())
            if not wanted <= set(row):
                raise ValueError(f"{path}: the row {part}.{name} lacks {', '.join(sorted(wanted - set(row)))}")
    return {part: table.get(part) or {} for part in PARTS}


def write(path: Path, robot: str, table: Mapping) -> None:
    """The table as a file, written aside and renamed into place."""
    kept = OmegaConf.create({part: dict(table[part]) for part in PARTS if table.get(part)})
    save_text(path, checksum.commented(HEADER.format(robot=robot) + OmegaConf.to_yaml(kept)))


def merge(path: Path, part: str, name: str, row: Mapping) -> None:
    """Put a row into the table of a file, in place of an earlier one of its name; the file may not exist yet."""
    table = read(path) if path.is_file() else {part: {} for part in PARTS}
    table[part] = dict(sorted((table[part] | {name: dict(row)}).items()))
    write(path, path.stem, table)


def facts(**known) -> dict:
    """What a row says of how it was found: those of `FACTS` that are known, in their order."""
    return {name: known[name] for name in FACTS if known.get(name) is not None}


def records(path: Path, part: str, shown: str) -> dict[str, dict]:
    """What a configuration says under `found` of each row of a part: table, row, and how it was found.

    shown: the table as a person names it, such as conf/found/trunk.yaml.
    """
    return {name: {"table": shown, "row": f"{part}.{name}"} | row["found"] | (
        {"model": row["model"]} if row.get("model") else {}) for name, row in read(path)[part].items()}


def in_words(record: Mapping) -> str:
    """One sentence on a row that a run takes."""
    how = [f"{record['metric']} {record['score']:.4g}"] if record.get("score") is not None else []
    how += [f"best of {record['trials']} trials"] if record.get("trials") else []
    how += [f"for artifacts of {record['model']}"] if record.get("model") else []
    how += [record["note"].rstrip(".")] if record.get("note") else []
    return f"found settings: row {record['row']} of {record['table']}, of {record.get('date', 'an unknown date')}" + (
        f" ({'; '.join(how)})" if how else "")


def lines(found: Mapping | None, choices: Mapping, has_row) -> Iterator[str]:
    """What a run says first: the row of found settings that it takes, or that the defaults hold.

    found: `found` of its configuration; choices: option by group, as Hydra gives them; has_row(robot, model): whether
    a table has it. Raises ValueError for settings=found without a robot.
    """
    model, robot, controller = (choices.get(group) for group in ("model", "robot", "controller"))
    asked = choices.get("settings") == "found"
    if asked and not robot:
        raise ValueError("settings=found takes the found settings of a robot, and none is given; add robot=NAME, or "
                         "leave out settings=found for the defaults")
    if found:
        yield in_words(found)
    elif model and asked:
        yield (f"no found settings: found/{robot}.yaml has no row models.{model}; the defaults of "
               f"conf/model/{model}.yaml")
    elif model:
        other = f"; settings=found takes row models.{model} of found/{robot}.yaml" if robot and has_row(robot, model) \
            else ""
        yield f"no found settings: the defaults of conf/model/{model}.yaml{other}"
    elif controller:
        yield f"no found settings: the defaults of conf/controller/{controller}.yaml"
