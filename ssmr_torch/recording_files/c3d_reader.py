"""Tables from C3D files of motion capture."""

from __future__ import annotations

import warnings
from pathlib import Path

import numpy as np

from ssmr_torch.extras import require
from ssmr_torch.recording_files.marker_tables import with_time, without_subject
from ssmr_torch.recording_files.note import Note
from ssmr_torch.recording_files.table import Table
from ssmr_torch.recording_files.units_said import unit_called

FORMAT = "C3D"


def read(path: Path) -> list[Table]:
    """The table of a C3D file: Time in s, points such as tip_X, and analog channels by their labels.

    A point with a negative residual was not seen and is NaN. Analog channels, at a multiple of the points' rate, are
    averaged over each frame, which keeps the impulse of an input. Numbers are of single precision, as in the file.
    Raises ValueError for a file that is damaged or without frames; ModuleNotFoundError without the extra rigs.
    """
    require("c3d")
    import c3d

    try:
        with path.open("rb") as handle, warnings.catch_warnings():
            warnings.simplefilter("ignore")
            reader = c3d.Reader(handle)
            points, analog = _frames(reader)
            labels = [[str(label).strip() for label in each] for each in (
                reader.point_labels if reader.point_used else [], reader.analog_labels if reader.analog_used else [])]
            said = [unit_called(reader.get("POINT:UNITS").string_value) if reader.get("POINT:UNITS") else None,
                    [unit_called(each) for each in _strings(reader, "ANALOG:UNITS")]]
            rate, expected = float(reader.point_rate), reader.last_frame - reader.first_frame + 1
    except Exception as error:  # the library raises what it stumbles upon
        raise ValueError(f"{path.name} cannot be read as C3D ({error}); export it again") from error
    if not len(points) or not np.isfinite(rate) or rate <= 0:
        raise ValueError(f"{path.name} holds {len(points)} frames at {rate:g} Hz; expected frames of points")
    columns, units = _columns(points, analog, *labels, *said)
    notes = [] if len(points) == expected else [Note(
        "", "cut file", f"the file ends after {len(points)} of {expected} frames; copy or export it again", "kept")]
    columns = with_time(columns, units, np.arange(len(points)) / rate)
    return [Table(columns, "", units, 1 / rate, FORMAT, tuple(notes))]


def _frames(reader) -> tuple[np.ndarray, np.ndarray]:
    """Points (T, n, 5) and the means of the analog channels (T, m)."""
    points, analog = [], []
    for _, seen, channels in reader.read_frames():
        points.append(seen)
        analog.append(np.asarray(channels, dtype=np.float64).reshape(reader.analog_used, -1).mean(axis=1)
                      if reader.analog_used else np.empty(0))
    return np.array(points, dtype=np.float64), np.array(analog)


def _columns(points: np.ndarray, analog: np.ndarray, markers: list[str], channels: list[str], length: str | None,
             analog_units: list[str | None]) -> tuple[dict[str, np.ndarray], dict[str, str]]:
    columns, units = {}, {}
    markers = without_subject([name or f"point {place}" for place, name in enumerate(markers, start=1)])
    markers += [f"point {place}" for place in range(len(markers) + 1, points.shape[1] + 1)]
    for place, marker in enumerate(markers[:points.shape[1]]):
        seen = np.where(points[:, place, 3:4] < 0, np.nan, points[:, place, :3])
        for axis, values in zip("XYZ", seen.T):
            columns[f"{marker}_{axis}"] = values
            units |= {f"{marker}_{axis}": length} if length else {}
    for place, values in enumerate(analog.T):
        name = channels[place] if place < len(channels) and channels[place] else f"analog {place + 1}"
        columns[name if name not in columns else f"analog {name}"] = values
        unit = analog_units[place] if place < len(analog_units) else None
        units |= {name: unit} if unit else {}
    return columns, units


def _strings(reader, key: str) -> list[str]:
    found = reader.get(key)
    if found is None:
        return []
    listed = found.string_array
    return [str(each).strip() for each in np.ravel(listed)]
