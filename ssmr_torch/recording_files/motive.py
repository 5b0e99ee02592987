"""Exports of OptiTrack Motive: CSV with its own five or six rows of names."""

from __future__ import annotations

from pathlib import Path

from ssmr_torch.recording_files.cells import number
from ssmr_torch.recording_files.marker_tables import Axis, marker_table
from ssmr_torch.recording_files.table import Table
from ssmr_torch.recording_files.text_columns import split_row
from ssmr_torch.recording_files.text_file import text_of
from ssmr_torch.recording_files.units_said import unit_called

FORMAT = "Motive CSV"
QUANTITIES = {"position": "", "rotation": "rotation", "mean marker error": "error", "error per marker": "error",
              "marker quality": "quality", "force": "force", "moment": "moment", "torque": "torque"}
TYPES = ("rigid body", "rigid body marker", "marker", "bone", "bone marker", "skeleton", "unlabeled marker", "asset",
         "force plate", "device", "trained markerset", "trained markerset bone")


def read(path: Path) -> list[Table]:
    """The table of a Motive export (1.2x, 2.x, 3.x) with columns such as tip_X, tip_rotation_W, tip_error.

    Frame and Time (Seconds) keep their names. Positions are in the `Length Units` of the first line; the interval is
    that of the export's frame rate. A marker that was hidden has empty cells, which are NaN.
    Raises ValueError for an export without the row of X, Y, Z or without frames.
    """
    text = text_of(path)
    lines = [line for line in text.splitlines() if line.strip(" ,;\t\"")]
    delimiter = max(",;\t", key=lines[0].count)
    said = [cell.strip() for cell in split_row(lines[0], delimiter)]
    stated = dict(zip(said[::2], said[1::2]))
    rows = [[cell.strip() for cell in split_row(line, delimiter)] for line in lines[:12]]
    last = next((k for k, row in enumerate(rows) if row[0].lower() == "frame"), None)
    if last is None:
        raise ValueError(f"{path.name} is a Motive export without its row 'Frame, Time (Seconds), X, Y, Z'; export it "
                         "again with the header information")
    axes = _axes(rows[1:last], rows[last])
    length = unit_called(stated.get("Length Units", ""))
    rate = next((found for key in ("Export Frame Rate", "Capture Frame Rate")
                 if stated.get(key) and (found := number(stated[key])) and found > 0), None)
    names = [axis.name for axis in axes]
    units = {axis.name: unit for axis in axes
             if (unit := {"": length, "error": length, "time": "s"}.get(axis.quantity))}
    return [marker_table(lines[last + 1:], names, units, delimiter, path.name, FORMAT, rate,
                         open_end=text[-1] not in "\r\n")]


def recognises(head: str) -> bool:
    first = head.lstrip("\ufeff \"").splitlines()[:1]
    return bool(first) and first[0].startswith("Format Version")


def _axes(above: list[list[str]], components: list[str]) -> list[Axis]:
    """What each column holds, by the rows above the row of components."""
    quantities = next((row for row in reversed(above) if any(cell.lower() in QUANTITIES for cell in row)), [])
    kinds = next((row for row in above if any(cell.lower() in TYPES for cell in row[1:])), [])
    after = [row for row in above if row is not quantities and row is not kinds]
    named = next((row for row in after if "name" in (cell.lower() for cell in row[:2])), after[0] if after else [])
    axes, taken = [], set()
    for place, component in enumerate(components):
        if place < 2:
            axes.append(Axis(component, "time" if place else "frame"))
            continue
        name, kind, said = (row[place] if place < len(row) else "" for row in (named, kinds, quantities))
        quantity = QUANTITIES.get(said.lower(), said)
        column = "_".join(filter(None, (name or f"column {place + 1}", quantity, component)))
        if column in taken:  # a rigid body and a marker of one name
            column = f"{kind or place} {column}"
        taken.add(column)
        axes.append(Axis(column, quantity))
    return axes
