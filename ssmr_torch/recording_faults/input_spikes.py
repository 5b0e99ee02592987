"""Single inputs far outside all others, that the robot does not answer."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ssmr_torch.recording_faults.continuity import FEWEST, extent
from ssmr_torch.recording_faults.recording import Recording
from ssmr_torch.recording_files.note import rows_said

OUTSIDE = 1.0       # of the range of the other inputs, by which a spike lies beyond the inputs before and after it
RARE = 3            # spikes of a run; more are how the robot was excited
ANSWERED = 1.2      # times the largest bend of the motion elsewhere, above which the robot answers


def input_spikes(recording: Recording, rule: str) -> Recording:
    """The recording with single inputs replaced by those before them that lie far outside all others, while the motion
    bends no more than elsewhere, by its second differences.

    Raises ValueError for the rule "refuse".
    """
    u, y = recording.input, recording.observation
    if len(u) < 2 * FEWEST or not u.shape[1]:
        return recording
    bends = np.abs(np.diff(y, 2, axis=0))
    spikes = np.zeros(u.shape, dtype=bool)
    for column in range(u.shape[1]):
        span = extent(u[:, [column]])
        alone = np.minimum(np.abs(u[1:-1, column] - u[:-2, column]), np.abs(u[1:-1, column] - u[2:, column]))
        rows = np.flatnonzero((alone > OUTSIDE * span) & (span > 0)) + 1
        outside = [row for row in rows if not _within(u[row, column], np.delete(u[:, column], rows), span)]
        quiet = [row for row in outside if not _answered(bends, row)]
        if 0 < len(outside) <= RARE:
            spikes[quiet, column] = True
    if not spikes.any():
        return recording
    rows = np.flatnonzero(spikes.any(axis=1))
    text = (f"the input is {u[spikes][0]:.3g} in {rows_said(recording.rows[rows])} alone, far outside all others, and "
            "the robot does not answer")
    if rule == "refuse":
        raise ValueError(f"{recording.name}: {text}; repair it, or set faults.outliers: bridge")
    if rule == "keep":
        return recording.noted("outliers", f"{text}; kept, as faults.outliers says", "kept", recording.rows[rows])
    mended = u.copy()
    mended[spikes] = u[np.flatnonzero(spikes.any(axis=1)) - 1][spikes[rows]]
    return replace(recording, input=mended).noted(
        "outliers", f"{text}; replaced by the input before (faults.outliers: keep leaves it)", "bridged",
        recording.rows[rows])


def _answered(bends: np.ndarray, row: int) -> bool:
    """Whether the motion bends around this row more than anywhere else; bends[k] is that of rows k to k + 2."""
    near = np.zeros(len(bends), dtype=bool)
    near[max(0, row - 1):row + 2] = True
    return bool((bends[near].max(axis=0) > ANSWERED * bends[~near].max(axis=0)).any())


def _within(value: float, others: np.ndarray, span: float) -> bool:
    return bool(others.min() - OUTSIDE * span / 2 <= value <= others.max() + OUTSIDE * span / 2)
