"""From raw recordings to the trajectories of a dataset: refuse, cut at seams, put on a grid, centre."""

from __future__ import annotations

import hashlib
import logging
from pathlib import Path

import numpy as np

from ssmr_torch.data.run_boundaries import find_seams
from ssmr_torch.data.sampling import SamplingRule, is_uniform, refuse_irregular, to_grid
from ssmr_torch.data.units import Plausible, Units
from ssmr_torch.recording_clocks.gaps import find_time_gaps
from ssmr_torch.recording_clocks.time_units import refuse_implausible
from ssmr_torch.recording_faults.recording import Recording
from ssmr_torch.recording_files.note import Note
from ssmr_torch.trajectory import Trajectory, TrajectoryDataset

logger = logging.getLogger(__name__)

PLAUSIBLE = Plausible()


def assemble(recordings: list[Recording], rest: np.ndarray, output_names, input_names, units: Units,
             rule: SamplingRule, provenance: dict, plausible: Plausible = PLAUSIBLE) -> TrajectoryDataset:
    """The dataset of all recordings, observations measured from `rest` (p,) in m.

    Adds to the provenance: intervals and peaks found, seams, the notes of the recordings, and dropped runs. `units`
    are those of the source, for the messages about what is not plausible.
    Raises ValueError for rows that are not finite (unless the rule splits there), time that does not
    increase, implausible intervals, displacements and inputs, and sampling that the rule refuses.
    """
    refuse_wrong_clock(recordings, units, plausible)
    usable = [(recording, _refuse_bad_rows(recording, rule)) for recording in recordings]
    peaks = _peaks(usable, rest)
    plausible.refuse("length", peaks["displacement_m"], units, "the largest displacement from rest")
    plausible.refuse("input", peaks["input"], units, "the largest input")
    timestep = rule.timestep or _common_timestep([r.time[good] for r, good in usable])
    for recording, good in usable:
        refuse_irregular(recording.time[good], rule, timestep, recording.name)
    seams = {recording.name: _seams(recording, good) for recording, good in usable}
    trajectories, dropped, resampled = [], [], 0
    for recording, good in usable:
        kept, short, moved = _trajectories(recording, good, seams[recording.name], rest, rule, timestep)
        trajectories, dropped, resampled = trajectories + kept, dropped + short, resampled + moved
    if not trajectories:
        raise ValueError(f"no run is left: all {len(dropped)} are shorter than {rule.minimum_length} samples")
    notes = [note for recording in recordings for note in recording.notes]
    tiny = plausible.too_small(peaks["input"], units)
    notes += [Note("all runs", "wrong_units", tiny)] if tiny else []
    provenance = provenance | {
        "rest_m": [float(x) for x in rest], "peaks": peaks,
        "sampling": _intervals(usable) | {"rule": rule.sampling, "timestep_s": float(timestep),
                                          "resampled_runs": resampled},
        "notes": [note.as_dict() for note in notes],
        "seams": {name: found for name, found in seams.items() if found},
        "shorter_than_minimum": dropped, "minimum_length": rule.minimum_length}
    for note in notes:
        logger.warning("%s", note)
    _log(provenance, units)
    return TrajectoryDataset(trajectories, rest, output_names, input_names, units.input_inside, provenance)


def refuse_wrong_clock(recordings: list[Recording], units: Units, plausible: Plausible) -> None:
    """Raises ValueError for a run whose median sampling interval is not plausible."""
    for recording in recordings:
        steps = np.diff(recording.time[np.isfinite(recording.time)])
        # Time that repeats or goes back has a message of its own.
        if (steps > 0).any():
            refuse_implausible(recording.name, float(np.median(steps[steps > 0])), units.time, plausible.interval)


def fingerprint(*paths: str | Path) -> dict[str, str]:
    """SHA-256 of each file by its name."""
    digests = {}
    for path in map(Path, paths):
        with path.open("rb") as file:
            digests[path.name] = hashlib.file_digest(file, "sha256").hexdigest()
    return digests


def rest_at_end(time: np.ndarray, observation: np.ndarray, inputs: np.ndarray, name: str,
                duration: float = 1.0) -> np.ndarray:
    """Median position over the last `duration` s, (p,).

    Raises ValueError unless the input is constant there, since the robot is then not known to rest.
    """
    rows = time >= time[-1] - duration
    if np.ptp(inputs[rows], axis=0).max(initial=0.0) > 0:
        raise ValueError(f"{name}: the input changes by {np.ptp(inputs[rows], axis=0).max():.3g} during the "
                         f"last {duration:g} s, so the robot does not end at rest; give rest as a vector")
    return np.median(observation[rows], axis=0)


def _refuse_bad_rows(recording: Recording, rule: SamplingRule) -> np.ndarray:
    table = np.column_stack([recording.time, recording.observation, recording.input])
    good = np.isfinite(table).all(axis=1)
    bad = np.flatnonzero(~good)
    if len(bad) and rule.missing == "refuse":
        raise ValueError(f"{recording.name}: {len(bad)} of {len(good)} rows are not finite, the first are "
                         f"rows {bad[:5].tolist()} (from 0); repair them, or set missing=split to cut the "
                         "run there")
    if good.sum() < 2:
        raise ValueError(f"{recording.name}: {good.sum()} rows are finite; at least 2 are needed")
    rows = np.flatnonzero(good)
    steps = np.diff(recording.time[rows])
    if (steps <= 0).any():
        row = int(rows[np.argmax(steps <= 0) + 1])
        word = "repeats" if (steps[steps <= 0] == 0).all() else "goes back"
        raise ValueError(f"{recording.name}: time {word} at row {row} (from 0) with "
                         f"{recording.time[row]:.6g} s, and in {int((steps <= 0).sum())} rows in all; "
                         "expected strictly increasing time")
    return good


def _peaks(usable, rest: np.ndarray) -> dict[str, float]:
    """Largest |displacement from rest|, m, and largest |input|, over all runs."""
    return {"displacement_m": max(float(np.abs(r.observation[good] - (0.0 if r.centred else rest)).max())
                                  for r, good in usable),
            "input": max(float(np.abs(r.input[good]).max(initial=0.0)) for r, good in usable)}


def _trajectories(recording: Recording, good: np.ndarray, seams: list[int], rest: np.ndarray, rule: SamplingRule,
                  timestep: float) -> tuple[list[Trajectory], list[str], int]:
    """The runs between the seams on the grid, those too short for the rule, and how many were resampled."""
    trajectories, dropped, resampled = [], [], 0
    parts = _runs(recording, good, seams)
    for index, rows in enumerate(parts):
        name = recording.name if len(parts) == 1 else f"{recording.name}/{index}"
        if len(rows) < rule.minimum_length:
            dropped.append(f"{name} ({len(rows)} samples)")
            continue
        observation = recording.observation[rows] - (0.0 if recording.centred else rest)
        samples = to_grid(recording.time[rows], observation, recording.input[rows], rule, timestep, name)
        resampled += not is_uniform(recording.time[rows], timestep)
        trajectories.append(Trajectory(*samples, recording.kind, recording.split, name))
    return trajectories, dropped, resampled


def _intervals(usable) -> dict[str, float]:
    steps = np.concatenate([np.diff(r.time[good]) for r, good in usable])
    return {"shortest_s": float(steps.min()), "median_s": float(np.median(steps)), "longest_s": float(steps.max())}


def _common_timestep(times: list[np.ndarray]) -> float:
    return float(f"{np.median([np.median(np.diff(time)) for time in times]):.4g}")


def _seams(recording: Recording, good: np.ndarray) -> list[int]:
    """Rows of the file at which another run begins, because one was joined there or samples were lost."""
    observation = recording.observation[good]
    rows = recording.rows[good]
    if recording.seams == "auto":
        seams = [int(rows[k]) for k in find_seams(observation)]
    else:
        seams = [int(k) for k in recording.seams]
    seams += [int(rows[k]) for k in find_time_gaps(recording.time[good])]
    taken_out = {row for row in recording.cuts if row - 1 not in recording.rows}
    return sorted(set(seams) - taken_out)


def _runs(recording: Recording, good: np.ndarray, seams: list[int]) -> list[np.ndarray]:
    rows = np.flatnonzero(good)
    holes = rows[1:][np.diff(rows) > 1]
    cuts = np.searchsorted(recording.rows[rows], sorted({*seams, *recording.cuts, *recording.rows[holes].tolist()}))
    return [part for part in np.split(rows, cuts) if len(part)]


def _log(provenance: dict, units: Units) -> None:
    logger.info("read %s: %s", ", ".join(provenance["sources"]), " ".join(provenance["assumptions"]))
    sampling, peaks = provenance["sampling"], provenance["peaks"]
    logger.info("largest displacement %.4g m, largest input %.4g %s", peaks["displacement_m"], peaks["input"],
                "N" if units.input_inside == "N" else "(normalized)")
    logger.info("sampling intervals %.4g to %.4g s, median %.4g s; %d runs put on a grid of %.4g s",
                sampling["shortest_s"], sampling["longest_s"], sampling["median_s"],
                sampling["resampled_runs"], sampling["timestep_s"])
    if provenance["seams"]:
        logger.warning("cut at seams before rows %s", provenance["seams"])
    if provenance["shorter_than_minimum"]:
        logger.warning("left out as too short: %s", ", ".join(provenance["shorter_than_minimum"]))
