"""`first_card`: a recording card for files that nobody has described yet, every guess marked for correction."""

from __future__ import annotations

import os
import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from ssmr_torch.data.column_roles import Roles, input_unit, length_unit, roles
from ssmr_torch.data.file_contents import PART, Contents
from ssmr_torch.recording_files.table import Table

TEST = re.compile(r"test|check|valid|eval|held", re.IGNORECASE)
GUESS = "# a guess: "
PLAIN = re.compile(r"[A-Za-z_][\w./]*")  # names that YAML reads as text without quotes
WORDS = ("true", "false", "null")


def first_card(found: Contents, folder: Path) -> str:
    """The card as YAML with comments, for a file in `folder`: `# a guess: …` stands behind what a person should check.

    Time, observation, input, units, decays (runs whose inputs are still), the rest and the test run are guessed.
    """
    runs = found.runs
    first, guessed, commands = max(map(_whole, runs.values()), key=lambda run: (len(run[1].input),
                                                                                len(run[1].observation)))
    decays = [name for name, tables in runs.items() if _is_still(tables, guessed.input)]
    lines = ["# Written by ssmr read. Check every line that ends with a guess; docs/data.md explains the keys."]
    lines += _files(found, folder)
    lines += _columns(first, guessed)
    lines += _units(first, commands, guessed)
    lines += _rest(first, guessed, decays)
    lines.append(f"decays: {_list(decays)}  {GUESS}runs whose inputs do not change")
    lines += _split([name for name in runs if name not in decays], decays)
    for label in found.tables:
        if PART in label:
            lines.append(f"# {label} has a clock of its own: {', '.join(list(found.tables[label].columns)[:8])}")
    return "\n".join(lines) + "\n"


def _whole(tables: Sequence[Table]) -> tuple[Table, Roles, Table]:
    """The table of a run's positions, the roles of its columns, and the table of its inputs, which may be another."""
    first = tables[0]
    guessed = roles(first)
    beside = next((table for table in tables[1:] if roles(table).input), first)
    if guessed.input or beside is first:
        return first, guessed, first
    return first, guessed._replace(input=roles(beside).input), beside


def _files(found: Contents, folder: Path) -> list[str]:
    used = [path for path in found.files if path in found.of_file.values()]
    names = [os.path.relpath(path, folder) if path.resolve().is_relative_to(folder.resolve()) else str(path.resolve())
             for path in used]
    return ["files:", *(f"  - {_text(name)}" for name in names)]


def _columns(table: Table, found: Roles) -> list[str]:
    clock = f"time: {_text(found.time)}, " if _has_clock(found) else ""
    unsure = f"  {GUESS}{' and '.join(found.unsure)} by how the columns change" if found.unsure else \
        f"  {GUESS}by the names of the columns"
    inputs = found.input or ["u"]
    lines = [f"columns: {{{clock}observation: {_list(found.observation or ['x'])}, input: {_list(inputs)}}}{unsure}"]
    if not found.input:
        lines.append("# No column looks like an input: name those of the commands; decays may do without.")
    if found.frames and not _has_clock(found):
        return [line.replace("columns: {", f"columns: {{frame: {_text(found.time)}, ") for line in lines] + [
            f"rate: {1 / (table.interval or 0.01):.6g}  {GUESS}" + ("as the file says" if table.interval else
                                                                   "CORRECT IT: frames in 1 s")]
    if not _has_clock(found):
        interval = table.interval or 0.01
        why = "as the file says" if table.interval else "CORRECT IT: no column of time was found"
        lines.append(f"sampling_time: {interval:.6g}  {GUESS}{why}")
    return lines


def _has_clock(found: Roles) -> bool:
    return found.time is not None and not found.frames and found.unit is not None


def _units(table: Table, commands: Table, found: Roles) -> list[str]:
    length, length_said = length_unit(table, found.observation)
    inputs, input_said = input_unit(commands, found.input)
    time = found.unit if _has_clock(found) else "s"
    time_said = not _has_clock(found) or found.time in table.units
    guesses = [name for name, said in (("length", length_said), ("input", input_said), ("time", time_said)) if not said]
    comment = f"  {GUESS}{', '.join(guesses)} by the size of the numbers" if guesses else "  # as the files say"
    return [f"units: {{length: {length}, input: {_text(inputs)}, time: {time}}}{comment}"]


def _rest(table: Table, found: Roles, decays: Sequence[str]) -> list[str]:
    if decays:
        return [f"rest: last sample of decays  {GUESS}the robot rests where decays end"]
    first = [float(f"{np.nanmedian(table.columns[name][:10]):.6g}") for name in found.observation]
    return [f"rest: {first}  {GUESS}CORRECT IT: where the first run begins"]


def _split(controlled: Sequence[str], decays: Sequence[str]) -> list[str]:
    named = [name for name in (*controlled, *decays) if TEST.search(name)]
    if named:
        return [f"split: {{test: {_list(named)}}}  {GUESS}by their names"]
    if len(controlled) > 1:
        return [f"split: {{test: {_list(controlled[-1:])}}}  {GUESS}the last run that is no decay"]
    return [f"split: {{test: []}}  {GUESS}name a run that the model shall not see"]


def _is_still(tables: Sequence[Table], inputs: Sequence[str]) -> bool:
    """Whether the inputs of a run do not change, or it has none, while something moves."""
    columns = [table.columns[column] for table in tables for name in inputs if (column := table.find(name))]
    with np.errstate(invalid="ignore"):
        still = all(np.nanmax(column) == np.nanmin(column) for column in columns)
    return still and bool(roles(tables[0]).observation)


def _list(names: Sequence[str]) -> str:
    return f"[{', '.join(map(_text, names))}]"


def _text(name: str) -> str:
    """A name as YAML text, in quotes where it could be read as something else."""
    if PLAIN.fullmatch(name) and name.lower() not in WORDS:
        return name
    escaped = name.replace("\\", "\\\\").replace('"', '\\"')
    return f'"{escaped}"'
