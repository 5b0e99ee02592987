"""`mended` and `compared`: recordings whose faults are found, named, and bridged, cut or refused by rule."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ssmr_torch.recording_faults.continuity import usual_reach
from ssmr_torch.recording_faults.drift import drift
from ssmr_torch.recording_faults.exchanged_markers import exchanged_markers, exchanged_runs
from ssmr_torch.recording_faults.held_values import held_values
from ssmr_torch.recording_faults.input_spikes import input_spikes
from ssmr_torch.recording_faults.lost_markers import lost_markers
from ssmr_torch.recording_faults.missing_rows import missing_rows
from ssmr_torch.recording_faults.outliers import outliers
from ssmr_torch.recording_faults.recording import Recording
from ssmr_torch.recording_faults.rest_position import refuse_wrong_rest
from ssmr_torch.recording_faults.rules import FaultRules
from ssmr_torch.recording_faults.slow_camera import slow_cameras
from ssmr_torch.recording_faults.unwritten_rows import unwritten_rows
from ssmr_torch.recording_faults.wrong_units import dead_columns, wrong_units

RULES = FaultRules()
PICTURES = 4        # notes whose recorded values are kept, so that the provenance stays small


def mended(recordings: Sequence[Recording], rules: FaultRules = RULES, missing: str = "refuse") -> list[Recording]:
    """The recordings with the faults mended that each shows by itself; what was found and done stands in their `notes`.

    In this order: empty rows (by the rule `missing`), rows never written, lost markers, a slow camera, held values,
    exchanged markers, outliers and jumps, input spikes. Sound recordings are returned unchanged. Under
    missing="refuse", recordings with empty cells are left as they are, because they are refused later.
    Raises ValueError, with the remedy, for recordings that a rule refuses.
    """
    found = [missing_rows(each, missing) for each in recordings]
    sound = [np.isfinite(each.observation).all() and np.isfinite(each.input).all() for each in found]
    judged = [each for each, whole in zip(found, sound) if whole]
    for mend in (lambda each, reach: unwritten_rows(each, rules.unwritten_rows, reach),
                 lambda each, reach: lost_markers(each, rules.lost_markers, reach)):
        reach = usual_reach(judged)
        judged = [mend(each, reach) for each in judged]
    judged = slow_cameras(judged, rules.slow_camera)
    reach = usual_reach(judged)
    judged = [each if _slow(each) else held_values(each, rules.held_values, reach) for each in judged]
    if judged:
        usual = np.median([np.median(each.observation, axis=0) for each in judged], axis=0)
        judged = [exchanged_markers(each, rules.exchanged_markers, reach, usual) for each in judged]
    judged = [input_spikes(outliers(each, rules.outliers, reach), rules.outliers) for each in judged]
    mending = iter(judged)
    return [next(mending) if whole else each for each, whole in zip(found, sound)]


def _slow(recording: Recording) -> bool:
    """Whether the recording keeps the repeated values of a slow camera, as its rule says."""
    return any(note.kind == "slow_camera" and note.done == "kept" for note in recording.notes)


def compared(recordings: Sequence[Recording], rest: np.ndarray, rules: FaultRules = RULES, scale: float = 1e-3,
             unit: str = "mm", rest_from_decays: bool = False) -> list[Recording]:
    """The recordings with the faults said, removed or refused that only their comparison with each other shows.

    In this order: dead columns, markers exchanged in a whole run, the rest position, units, drift. rest: (p,) m.
    scale, unit: of length in the source. rest_from_decays: whether the rest position was taken from the decays.
    Raises ValueError, with the remedy, for recordings that a rule refuses.
    """
    found = list(recordings)
    if not all(np.isfinite(each.observation).all() and np.isfinite(each.input).all() for each in found):
        return found
    found = dead_columns(found, rules.dead_columns)
    found = exchanged_runs(found, rest, rules.exchanged_markers)
    found = refuse_wrong_rest(found, rest, rules.rest_position, scale, unit, rest_from_decays)
    found = wrong_units(found, rest, rules.wrong_units)
    return with_few_pictures(drift(found, rest, rules.drift))


def with_few_pictures(recordings: Sequence[Recording]) -> list[Recording]:
    """The recordings, with recorded values in their first few notes only."""
    left, kept = PICTURES, []
    for each in recordings:
        notes = []
        for note in each.notes:
            left -= "recorded_m" in note.numbers
            notes.append(note if left >= 0 else replace(note, numbers={
                key: value for key, value in note.numbers.items() if key not in ("recorded_m", "first_row", "column")}))
        kept.append(replace(each, notes=tuple(notes)) if each.notes else each)
    return kept
