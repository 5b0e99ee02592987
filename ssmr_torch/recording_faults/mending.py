"""`mended`: recordings whose faults are found, named, and bridged, cut or refused by rule."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ssmr_torch.recording_faults.recording import Recording


def mended(recordings: Sequence[Recording], rest: np.ndarray) -> list[Recording]:
    """The recordings with their faults mended; what was found and done stands in their `notes`.

    rest: (p,) m, position from which the recordings that are not centred are measured.
    Raises ValueError, with the remedy, for recordings that cannot be mended.
    """
    return list(recordings)
