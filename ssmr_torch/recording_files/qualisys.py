"""Exports of Qualisys Track Manager: TSV with a header of keys."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ssmr_torch.recording_files.cells import is_number, number
from ssmr_torch.recording_files.marker_tables import marker_table, with_time
from ssmr_torch.recording_files.table import Table
from ssmr_torch.recording_files.text_columns import split_row
from ssmr_torch.recording_files.text_file import text_of

FORMAT = "Qualisys TSV"
KEYS = ("NO_OF_FRAMES", "NO_OF_CAMERAS", "NO_OF_MARKERS", "NO_OF_BODIES", "NO_OF_SAMPLES", "FREQUENCY",
        "MARKER_NAMES", "DATA_INCLUDED")
UNIT = "mm"  # of every export of positions from QTM


def read(path: Path) -> list[Table]:
    """The table of an export of 3D data with columns such as tip_X in mm, with or without Frame and Time.

    Without a column of Time, one is made from FREQUENCY.
    Raises ValueError for 2D, 6D or analog data, and for rows that do not fit the markers.
    """
    text = text_of(path)
    lines = [line for line in text.splitlines() if line.strip()]
    start = next((k for k, line in enumerate(lines) if any(is_number(line.split("\t")[0], sign) for sign in ".,")),
                 len(lines))
    said = {cells[0].strip().upper(): [cell.strip() for cell in cells[1:]]
            for cells in (split_row(line, "\t") for line in lines[:start])}
    included = " ".join(said.get("DATA_INCLUDED", ["3D"])).upper() or "3D"
    if included != "3D" or "NO_OF_BODIES" in said or "NO_OF_SAMPLES" in said:
        kind = included if included != "3D" else "6D" if "NO_OF_BODIES" in said else "analog"
        raise ValueError(f"{path.name} is a Qualisys export of {kind} data; export 3D data as TSV, or a table with a "
                         "row of names")
    markers = [name for name in said.get("MARKER_NAMES", []) if name]
    if not markers:
        raise ValueError(f"{path.name} is a Qualisys export without MARKER_NAMES; export the TSV file with its header")
    positions = [f"{marker}_{axis}" for marker in markers for axis in "XYZ"]
    cells = len(split_row(lines[start], "\t")) if start < len(lines) else 0
    titled = [name for name in ("FRAME", "TIME") if name in {lines[start - 1].split("\t")[0].upper(), *(
        cell.upper() for cell in said.get("FRAME", []))}] or ["FRAME", "TIME"][:max(cells - len(positions), 0)]
    names = [name.capitalize() for name in titled if cells >= len(positions) + len(titled)] + positions
    rate = number(" ".join(said.get("FREQUENCY", [])).replace(",", "."))
    rate = rate if rate and rate > 0 else None
    units = {**dict.fromkeys(positions, UNIT), "Time": "s"}
    table = marker_table(lines[start:], names, units, "\t", path.name, FORMAT, rate, text[-1] not in "\r\n")
    if rate and "Time" not in table.columns:
        frames = table.columns.get("Frame", np.arange(table.length))
        units = dict(table.units)
        columns = with_time(table.columns, units, (frames - frames[0]) / rate)
        return [Table(columns, "", units, table.interval, FORMAT, table.notes)]
    return [table]


def recognises(head: str) -> bool:
    return head.lstrip("\ufeff").split("\t")[0].strip().upper() in KEYS and "\t" in head
