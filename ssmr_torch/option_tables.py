"""Options of groups of configurations that are entries of a table, not files of their own.

groups/GROUP.yaml of a folder of configurations holds an entry for each option of GROUP. The rows of found/ROBOT.yaml
are options, too: those of its models of the group row/found/ROBOT, those of its controllers of controller/ROBOT, which
take in row/controllers/ROBOT, where the configuration says which row it took. An entry is what the file of the option
would hold; its key `_package_` is the package line of the file.
"""

from __future__ import annotations

from copy import deepcopy
from functools import cache
from pathlib import Path

from omegaconf import OmegaConf

from ssmr_torch import found_settings

TABLES, FOUND = "groups", "found"
OF_MODELS, OF_CONTROLLERS, SAID = "row/found/", "controller/", "row/controllers/"
HIDDEN = (TABLES, FOUND)  # folders that are no groups


def option(folder: Path, path: str) -> tuple[dict, str | None] | None:
    """Content and package of the option group/name, or None where no table of the folder has it."""
    group, _, name = path.removesuffix(".yaml").rpartition("/")
    entry = entries(folder, group).get(name) if group else None
    if entry is None:
        return None
    content = deepcopy(entry)
    return content, content.pop("_package_", None)


def entries(folder: Path, group: str) -> dict[str, dict]:
    """Option → entry of a group; empty where no table of the folder has the group."""
    found = {}
    if (file := folder / TABLES / f"{group}.yaml").is_file():
        found |= _table(file, file.stat().st_mtime_ns)
    for beginning in (OF_MODELS, OF_CONTROLLERS, SAID):
        file = folder / FOUND / f"{group.removeprefix(beginning)}.yaml"
        if group.startswith(beginning) and file.is_file():
            found |= _rows(file, beginning, file.stat().st_mtime_ns)
    return found


def groups(folder: Path) -> set[str]:
    """All groups that the tables of a folder have options of, and the groups above them."""
    files = [file.relative_to(folder / TABLES).with_suffix("").as_posix() for file in (folder / TABLES).rglob("*.yaml")]
    files += [f"{beginning}{file.stem}" for file in (folder / FOUND).glob("*.yaml")
              for beginning in (OF_MODELS, OF_CONTROLLERS) if entries(folder, f"{beginning}{file.stem}")]
    return {"/".join(parts[:depth]) for parts in (file.split("/") for file in files)
            for depth in range(1, len(parts) + 1)}


@cache
def _table(file: Path, _: int) -> dict[str, dict]:
    return {str(name): entry or {} for name, entry in OmegaConf.to_container(OmegaConf.load(file)).items()}


@cache
def _rows(file: Path, beginning: str, _: int) -> dict[str, dict]:
    part = "models" if beginning == OF_MODELS else "controllers"
    packaged = (file.parents[1] / "train.yaml").is_file()
    said = found_settings.records(file, part, f"conf/{FOUND}/{file.name}" if packaged else str(file))
    if beginning == SAID:
        return {name: {"_package_": "_global_", "found": record} for name, record in said.items()}
    rows = found_settings.read(file)[part]
    if beginning == OF_MODELS:
        return {name: {"_package_": "_global_", **row["settings"], "found": said[name]} for name, row in rows.items()}
    return {name: {"defaults": _parents(file.stem, name, row)} | row["settings"] for name, row in rows.items()}


def _parents(robot: str, name: str, row: dict) -> list:
    """The defaults list of a controller's row."""
    observer = [{"override /observer@observer": row["observer"]}] if row.get("observer") else []
    return [row["controller"], {f"/{SAID}{robot}@_global_": name}, *observer, "_self_"]
