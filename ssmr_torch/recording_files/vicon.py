"""Exports of Vicon Nexus and Tracker: CSV in sections, each with its rate and rows of names."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from ssmr_torch.recording_files.cells import number
from ssmr_torch.recording_files.marker_tables import TIME, marker_table, with_time, without_subject
from ssmr_torch.recording_files.table import Table
from ssmr_torch.recording_files.text_columns import split_row
from ssmr_torch.recording_files.text_file import text_of
from ssmr_torch.recording_files.units_said import unit_called

FORMAT = "Vicon CSV"
SECTIONS = ("Trajectories", "Devices", "Model Outputs", "Joints", "Segments", "Events", "Objects", "Global Angles")
UNREAD = ("Events",)


def read(path: Path) -> list[Table]:
    """The tables of an export with columns such as tip_X, and Time in s, counted from the first frame.

    Names of subjects are left out where the markers stay different. Devices, at a multiple of the rate of the
    trajectories, are averaged over each frame, which keeps the impulse of an input, and stand beside the markers; other
    sections with a clock of their own are tables of their own.
    Raises ValueError for a section without its rows of names.
    """
    text = text_of(path)
    lines = text.splitlines()
    bare = [line.strip(' ,;\t"') for line in lines]
    starts = [k for k, line in enumerate(bare) if line in SECTIONS]
    tables = []
    for start, stop in zip(starts, [*starts[1:], len(lines)]):
        kept = [line for line, text_ in zip(lines[start:stop], bare[start:stop]) if text_]
        if kept and bare[start] not in UNREAD:
            tables.append(_section(bare[start], kept[1:], path.name, stop == len(lines) and text[-1] not in "\r\n"))
    if not tables:
        raise ValueError(f"{path.name} is a Vicon export without trajectories; export them as CSV (ASCII)")
    return _joined(tables)


def recognises(head: str) -> bool:
    first = [line.strip(' ,;\t"\ufeff') for line in head.splitlines()[:4]]
    return len(first) > 2 and first[0] in SECTIONS and first[1].replace(".", "").isdigit()


def _section(section: str, lines: list[str], file: str, open_end: bool) -> Table:
    head = next((k for k, line in enumerate(lines) if line.strip(' "').lower().startswith("frame")), None)
    if not head or len(lines) < head + 3:
        raise ValueError(f"{file} is a Vicon export whose section {section} has no row 'Frame, Sub Frame, X, Y, Z'; "
                         "export it again")
    delimiter = max(",;\t", key=lines[head].count)
    above, components, units = ([cell.strip() for cell in split_row(line, delimiter)]
                                for line in (lines[head - 1], lines[head], lines[head + 1]))
    rate = number(lines[0].strip(' ,;\t"'))
    if not rate or not rate > 0:
        raise ValueError(f"{file}: the rate of the section {section} is {lines[0][:40]!r}; expected frames per second")
    filled, owners = "", []
    for place in range(len(components)):
        filled = above[place] if place < len(above) and above[place] else filled
        owners.append(filled if place > 1 else "")
    short = dict(zip(owners, without_subject(owners))) if section != "Devices" else {}
    names = ["_".join(filter(None, (short.get(owner, owner), component)))
             for owner, component in zip(owners, components)]
    said = {name: unit for name, cell in zip(names, units) if cell and (unit := unit_called(cell))}
    table = marker_table(lines[head + 2:], names, said, delimiter, file, FORMAT, rate, open_end, part=section)
    if not np.isfinite(table.numbers(list(table.columns)[:2], file)).all() or any(
            column.dtype.kind == "O" for column in list(table.columns.values())[:2]):
        raise ValueError(f"{file}, section {section}: a row has no frame number; export it again")
    return table


def _joined(tables: list[Table]) -> list[Table]:
    """The tables with a column of Time; those of a multiple of the first one's rate beside it."""
    first, others = tables[0], []
    frames = first.columns[next(iter(first.columns))]
    columns, units = dict(first.columns), dict(first.units)
    for table in tables[1:]:
        names = list(table.columns)
        times = round(first.interval / table.interval)
        if times >= 1 and table.length == times * first.length and (table.columns[names[0]][::times] == frames).all():
            taken = {name if name not in columns else f"{table.part} {name}": name for name in names[2:]}
            columns |= {new: per_frame(table.columns[name], times) for new, name in taken.items()}
            units |= {new: table.units[name] for new, name in taken.items() if name in table.units}
            continue
        own = dict(table.units)
        seconds = (table.columns[names[0]] - frames[0]) * first.interval + table.columns[names[1]] * table.interval
        others.append(replace(table, columns=with_time(table.columns, own, seconds), units=own))
    seconds = (frames - frames[0]) * first.interval
    columns = columns if TIME in columns else with_time(columns, units, seconds)
    return [replace(first, columns=columns, units=units, part=first.part if others else ""), *others]


def per_frame(values: np.ndarray, times: int) -> np.ndarray:
    """The mean of each `times` samples (T·times,) → (T,)."""
    if times == 1 or values.dtype.kind == "O":
        return values[::times]
    return values.reshape(-1, times).mean(axis=1)
