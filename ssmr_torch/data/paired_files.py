"""Runs whose inputs stand in a file, or a table, of their own, with a clock of their own."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ssmr_torch.data.named_files import found_files, names_of_files
from ssmr_torch.data.recording_card import RecordingCard
from ssmr_torch.recording_clocks.clock_rules import Clock
from ssmr_torch.recording_clocks.seconds import clock_of
from ssmr_torch.recording_clocks.two_clocks import joined
from ssmr_torch.recording_files.reading import read_tables
from ssmr_torch.recording_files.table import Table


class Commands(NamedTuple):
    """The table of a run's inputs, and the name of its file."""

    table: Table
    file: str


def command_files(card: RecordingCard, folder: Path, known: Sequence[Path] = ()) -> list[Path]:
    """The files of inputs that the card pairs, without those that are `known`."""
    if not card.pairs:
        return []
    files = found_files(folder / "card", list(dict.fromkeys(pair.inputs for pair in card.pairs)))
    return [path for path in files if path not in known]


def commands_of(runs: Mapping[str, tuple[Table, str]], card: RecordingCard, folder: Path) -> dict[str, Commands]:
    """The inputs of each run that has them elsewhere: in the file that is paired with its own, or in another table of
    its own file.

    Raises ValueError for a paired file of which no table has all inputs.
    """
    outputs = found_files(folder / "card", [*card.files, *(pair.outputs for pair in card.pairs)])
    stems = {stem: path for path, stem in names_of_files(outputs, folder).items()}
    paired = {(folder / pair.outputs): folder / pair.inputs for pair in card.pairs}
    found: dict[str, Commands] = {}
    for name, (table, _) in runs.items():
        path = next((stems[stem] for stem in (name, name.rpartition(":")[0]) if stem in stems), None)
        if path in paired:
            found[name] = _commands(table, paired[path], card)
        elif path is not None and table.part and not all(table.find(each) for each in card.columns.input):
            beside = _with_inputs(table, path, card)
            found |= {name: Commands(beside, path.name)} if beside is not None else {}
    return found


def with_commands(name: str, clock: Clock, observation: np.ndarray, commands: Commands,
                  card: RecordingCard) -> tuple[Clock, np.ndarray, np.ndarray]:
    """The clock and outputs of a run where its inputs are known, and the inputs that are held there."""
    columns = card.columns
    time = columns.input_time or (columns.time if columns.time is not None else None)
    named = time if isinstance(time, str | None) else tuple(time)
    rules = replace(card.clock_rules(), time=named, unit=card.units.input_time or card.units.time, frame=None,
                    rate=None, bounds=(0.0, np.inf), outputs=())
    own = clock_of(commands.table, f"{name}, inputs", commands.file, rules)
    inputs = commands.table.numbers(columns.input, commands.file)[own.rows]
    return joined(name, clock, observation, own, inputs, card.clock_offset, card.clock_drift)


def _commands(table: Table, path: Path, card: RecordingCard) -> Commands:
    found = _with_inputs(table, path, card)
    if found is None:
        names = [list(each.columns)[:20] for each in read_tables(path)]
        raise ValueError(f"{path.name} has no table with the inputs {card.columns.input}; it has {names}")
    return Commands(found, path.name)


def _with_inputs(table: Table, path: Path, card: RecordingCard) -> Table | None:
    """The table with all inputs: that of the same run within the file, else the only one."""
    having = [each for each in read_tables(path) if all(each.find(name) for name in card.columns.input)]
    same = [each for each in having if each.run == table.run]
    return (same or having)[0] if len(same) == 1 or len(having) == 1 else None
