"""Recordings of the user's own, as a card describes them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from ssmr_torch.checked_arguments import checked
from ssmr_torch.data.column_files import pick, read_columns
from ssmr_torch.data.recording import Recording, assemble, fingerprint, refuse_wrong_clock
from ssmr_torch.data.recording_card import RecordingCard, read_recording_card
from ssmr_torch.data.sampling import SamplingRule
from ssmr_torch.data.units import Plausible
from ssmr_torch.quantities import PATH
from ssmr_torch.trajectory import TrajectoryDataset


@checked(card=PATH)
def custom(card: str | Path) -> TrajectoryDataset:
    """Runs in CSV or HDF5 files that a YAML card describes (`RecordingCard`); files are relative to the card.

    A run is a file, or the rows of a file with one value in the run column; its name is the stem of the file,
    with ":value" behind it for a run column.
    Raises FileNotFoundError, or ValueError for a wrong card or recordings that do not fit it.
    """
    path = Path(card)
    described = read_recording_card(path)
    files = [path.parent / name for name in described.files]
    tables = _tables(files, described)
    _refuse_unknown_runs(described, [name for name, _ in tables])
    recordings = [_recording(name, table, described) for name, table in tables]
    plausible = Plausible(tuple(described.range), tuple(described.interval_range), described.largest_input)
    # Before the rest position: resting samples are found by how long they last.
    refuse_wrong_clock(recordings, described.units, plausible)
    rest, assumed = _rest(recordings, described)
    rule = SamplingRule(described.sampling, described.timestep, described.irregularity, described.missing,
                        described.minimum_length)
    provenance = {"reader": "custom", "sources": fingerprint(path, *files), "assumptions": [
        f"Lengths in {described.units.length}, inputs in {described.units.input}, time in "
        f"{described.units.time}.",
        assumed, "Each input is held until the next sample and acts after the observation of its row."]}
    if described.symmetry:
        provenance["symmetry"] = described.symmetry
    return assemble(recordings, rest, described.columns.observation, described.columns.input, described.units, rule,
                    provenance, plausible)


def _tables(files: list[Path], card: RecordingCard) -> list[tuple[str, np.ndarray]]:
    """Name and columns [time, observations, inputs] of each run, in the units of the file."""
    clock = [] if card.columns.time is None else [card.columns.time]
    wanted = [*clock, *card.columns.observation, *card.columns.input]
    if len({path.stem for path in files}) < len(files):
        raise ValueError(f"two files share a name, {[path.name for path in files]}; runs are named after "
                         "their files")
    tables = []
    for path in files:
        columns = read_columns(path)
        values = pick(columns, wanted, path)
        if card.columns.time is None:
            values = np.column_stack([card.sampling_time * np.arange(len(values)), values])
        if card.columns.run is None:
            tables.append((path.stem, values))
            continue
        run = pick(columns, [card.columns.run], path)[:, 0]
        if len(run) != len(values) or not np.isfinite(run).all():
            raise ValueError(f"{path.name}: the run column {card.columns.run!r} has "
                             f"{int(np.isfinite(run).sum())} numbers for {len(values)} rows; expected one "
                             "per row")
        tables += [(f"{path.stem}:{value:g}", values[run == value]) for value in dict.fromkeys(run.tolist())]
    return tables


def _recording(name: str, values: np.ndarray, card: RecordingCard) -> Recording:
    outputs = len(card.columns.observation)
    if isinstance(card.seams, dict):
        rows = card.seams.get(name, [])
        if not isinstance(rows, list) or not all(isinstance(row, int) for row in rows):
            raise ValueError(f"seams of {name!r} is {rows!r}; expected a list of rows")
    return Recording(
        name, values[:, 0] * card.units.scale("time"), values[:, 1:1 + outputs] * card.units.scale("length"),
        values[:, 1 + outputs:] * card.units.scale("input"), "decay" if name in card.decays else "controlled",
        next((split for split, runs in card.split.items() if name in runs), "train"), name in card.centred,
        "auto" if card.seams == "auto" else tuple(rows))


def _rest(recordings: list[Recording], card: RecordingCard) -> tuple[np.ndarray, str]:
    """Rest position in m, and in words how it was found."""
    if not isinstance(card.rest, str):
        rest = np.array(card.rest, dtype=np.float64) * card.units.scale("length")
        return rest, "The rest position is the one that the card gives."
    if card.rest == "last sample of decays":
        ends = [_finite(r)[-1] for r in recordings if r.kind == "decay" and not r.centred]
        if not ends:
            raise ValueError("rest is the last sample of decays, but no run is a decay that is not centred; "
                             "list decays, or give rest as a vector")
        spread = 1e3 * np.ptp(ends, axis=0).max()
        return np.median(ends, axis=0), (f"The rest position is the median of the last samples of "
                                         f"{len(ends)} decays, which lie within {spread:.3g} mm.")
    resting = np.concatenate([_resting_samples(r) for r in recordings if not r.centred] or [np.empty((0, 0))])
    if not len(resting):
        raise ValueError("rest is the median of resting samples, but no input is zero and no robot still "
                         "for 0.5 s; give rest as a vector")
    return (np.median(resting, axis=0),
            f"The rest position is the median of {len(resting)} samples at zero input.")


def _finite(recording: Recording) -> np.ndarray:
    good = np.isfinite(recording.observation).all(axis=1)
    if not good.any():
        raise ValueError(f"{recording.name}: no row is finite; check the observation columns")
    return recording.observation[good]


def _resting_samples(recording: Recording, still: float = 0.01, duration: float = 0.5) -> np.ndarray:
    """Observations at zero input whose last `duration` s stayed within `still` of the extent of the run."""
    y = recording.observation
    window = max(2, int(np.ceil(duration / np.median(np.diff(recording.time)))) + 1)
    if len(y) < window:
        return y[:0]
    views = sliding_window_view(y, window, axis=0)
    calm = np.ptp(views, axis=-1).max(axis=1) <= still * np.nanmax(np.ptp(_finite(recording), axis=0))
    idle = sliding_window_view(np.abs(recording.input).sum(axis=1) == 0, window).all(axis=1)
    return y[window - 1:][calm & idle]


def _refuse_unknown_runs(card: RecordingCard, names: list[str]) -> None:
    named = {"decays": card.decays, "centred": card.centred,
             **{f"split.{split}": runs for split, runs in card.split.items()},
             "seams": list(card.seams) if isinstance(card.seams, dict) else []}
    for key, runs in named.items():
        unknown = [run for run in runs if run not in names]
        if unknown:
            raise ValueError(f"{key} names the runs {runs}, of which {unknown} do not exist; "
                             f"the runs are {names[:10]}{'…' if len(names) > 10 else ''}")
