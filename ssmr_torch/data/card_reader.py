"""Recordings of the user's own, as a card describes them."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from ssmr_torch.checked_arguments import checked
from ssmr_torch.data.assembly import assemble, refuse_wrong_clock
from ssmr_torch.data.file_units import refuse_other_units
from ssmr_torch.data.input_lag import with_lag
from ssmr_torch.data.named_files import digests, found_files, names_of_files
from ssmr_torch.data.paired_files import Commands, command_files, commands_of, with_commands
from ssmr_torch.data.recording_card import RecordingCard, read_recording_card
from ssmr_torch.data.run_names import in_pieces, kind_and_split, with_full_names
from ssmr_torch.data.sampling import SamplingRule
from ssmr_torch.data.units import Plausible
from ssmr_torch.quantities import PATH
from ssmr_torch.recording_clocks.seconds import clock_of
from ssmr_torch.recording_faults.copies import without_copies
from ssmr_torch.recording_faults.mending import compared, mended
from ssmr_torch.recording_faults.moving_decays import moving_decays
from ssmr_torch.recording_faults.recording import Recording, longest
from ssmr_torch.recording_faults.rules import FaultRules
from ssmr_torch.recording_files.reading import read_tables
from ssmr_torch.recording_files.table import Table
from ssmr_torch.trajectory import TrajectoryDataset


@checked(card=PATH)
def custom(card: str | Path) -> TrajectoryDataset:
    """Runs in files of any format of `recording_files.reading` that a YAML card describes (`RecordingCard`); files
    are relative to the card.

    A run is a file, a run within a file, or the rows of a file with one value in the run column. Its name is the stem
    of the file, with ":NAME" behind it where a file holds several; where two files share a stem, their path below the
    card.
    Raises FileNotFoundError, or ValueError for a wrong card or recordings that do not fit it.
    """
    path = Path(card)
    described = read_recording_card(path)
    files = found_files(path, [*described.files, *(pair.outputs for pair in described.pairs)])
    all_files = [*files, *command_files(described, path.parent, files)]
    runs = _runs(files, described, path.parent)
    described = with_full_names(described, list(runs))
    commands = commands_of(runs, described, path.parent)
    recordings = in_pieces([_recording(name, *run, described, commands.get(name)) for name, run in runs.items()],
                           described)
    plausible = Plausible(tuple(described.range), tuple(described.interval_range), described.largest_input)
    # Before the rest position: resting samples are found by how long they last.
    refuse_wrong_clock(recordings, described.units, plausible)
    rules = FaultRules.of(described.faults, longest(recordings))
    recordings = mended(moving_decays(recordings, described.columns.input, rules.moving_decays), rules,
                        described.missing)
    rest, assumed = _rest(recordings, described)
    recordings = compared(recordings, rest, rules, described.units.scale("length"), described.units.length,
                          described.rest == "last sample of decays")
    rule = SamplingRule(described.sampling, described.timestep, described.irregularity, "refuse",
                        described.minimum_length)
    provenance = {"reader": "custom", "sources": digests(path, all_files), "assumptions": [
        f"Lengths in {described.units.length}, inputs in {described.units.input}, time in "
        f"{described.units.time}.",
        assumed, "Each input is held until the next sample and acts after the observation of its row.",
        *_without_inputs({name: run for name, run in runs.items() if name not in commands}, described)]}
    if described.symmetry:
        provenance["symmetry"] = described.symmetry
    dataset = assemble(recordings, rest, described.columns.observation, described.columns.input, described.units, rule,
                       provenance, plausible)
    # Of two clocks the offset is said where they are joined.
    return with_lag(without_copies(dataset, rules.copies), described.input_lag, told=not commands)


def _runs(files: list[Path], card: RecordingCard, folder: Path) -> dict[str, tuple[Table, str]]:
    """The table of each run, and the name of its file, by the name of the run."""
    runs: dict[str, tuple[Table, str]] = {}
    for path, stem in names_of_files(files, folder).items():
        for tables in _by_run(read_tables(path)):
            table = _fitting(tables, card, path.name)
            refuse_other_units(table, card, path.name)
            for part in _parts(table, card.columns.run, path):
                runs[f"{stem}:{part.run}" if part.run else stem] = part, path.name
    return runs


def _by_run(tables: Iterable[Table]) -> list[list[Table]]:
    groups: dict[str, list[Table]] = {}
    for table in tables:
        groups.setdefault(table.run, []).append(table)
    return list(groups.values())


def _fitting(tables: list[Table], card: RecordingCard, file: str) -> Table:
    """Of the tables of a run, each with a clock of its own, the one that has the columns of the card."""
    columns = card.columns
    outputs = [*columns.observation, *columns.clock, *filter(None, (columns.run,))]
    for wanted in ([*outputs, *columns.input], outputs):
        fitting = [table for table in tables if all(table.find(name) for name in wanted)]
        if len(tables) == 1 or fitting:
            return (fitting or tables)[0]
    most = max(tables, key=lambda table: sum(table.find(name) is not None for name in columns.observation))
    spread = {table.part or "the first": list(table.columns)[:6] for table in tables}
    raise ValueError(f"{file} holds {len(tables)} tables with clocks of their own, {spread}; none has all of "
                     f"{outputs}, most has {most.part or 'the first'!r}")


def _parts(table: Table, column: str | None, path: Path) -> list[Table]:
    """The table, or its rows for each value of the column that numbers or names the runs."""
    if column is None:
        return [table]
    run = table.columns[table.find(column)] if table.find(column) else table.numbers([column], path.name)[:, 0]
    known = np.array([value == value for value in run])
    if not known.all():
        raise ValueError(f"{path.name}: the run column {column!r} has {int(known.sum())} numbers for "
                         f"{len(run)} rows; expected one per row")
    return [replace(table, run=f"{value:g}" if isinstance(value, int | float) else str(value),
                    columns={name: each[run == value] for name, each in table.columns.items()},
                    notes=() if place else table.notes)
            for place, value in enumerate(dict.fromkeys(run.tolist()))]


def _recording(name: str, table: Table, file: str, card: RecordingCard, commands: Commands | None) -> Recording:
    observation = table.numbers(card.columns.observation, file)
    inputs = np.zeros((table.length, len(card.columns.input))) \
        if commands is not None or _has_no_inputs(name, table, card) else table.numbers(card.columns.input, file)
    clock = clock_of(table, name, file, card.clock_rules())
    observation, inputs = observation[clock.rows], inputs[clock.rows]
    if commands is not None:
        clock, observation, inputs = with_commands(name, clock, observation, commands, card)
    return Recording(
        name, clock.time, observation * card.units.scale("length"), inputs * card.units.scale("input"),
        seams="auto" if card.seams == "auto" else tuple(card.seams.get(name, [])), rows=np.sort(clock.rows),
        notes=tuple(replace(note, run=name) for note in (*table.notes, *clock.notes)),
        output_names=tuple(card.columns.observation), **kind_and_split(name, card))


def _has_no_inputs(name: str, table: Table, card: RecordingCard) -> bool:
    """Whether a run is a decay whose file has none of the inputs, such as an export of motion capture."""
    return name in card.decays and not any(table.find(each) for each in card.columns.input)


def _without_inputs(runs: Mapping[str, tuple[Table, str]], card: RecordingCard) -> list[str]:
    bare = [name for name, (table, _) in runs.items() if _has_no_inputs(name, table, card)]
    return [f"The inputs of the decays {', '.join(bare)}, which their files do not hold, are zero."] if bare else []


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
