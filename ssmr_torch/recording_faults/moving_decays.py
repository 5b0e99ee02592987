"""Decays whose inputs move."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ssmr_torch.recording_faults.recording import Recording

NOISE = 0.02        # of the range of an input over all runs, that a measured input at rest may vary by


def moving_decays(recordings: Sequence[Recording], input_names: Sequence[str], rule: str) -> list[Recording]:
    """The recordings, with a note on decays whose inputs change; raises ValueError for them unless the rule is "keep".

    Measured inputs may vary by 2 % of their range over all runs.
    """
    finite = [each.input[np.isfinite(each.input).all(axis=1)] for each in recordings]
    finite = [each for each in finite if len(each)]
    if not finite or not finite[0].shape[1]:
        return list(recordings)
    table = np.concatenate(finite)
    allowed = NOISE * np.ptp(table, axis=0)
    found = []
    for each in recordings:
        moved = np.nanmax(each.input, axis=0) - np.nanmin(each.input, axis=0)
        if each.kind != "decay" or not (moved > allowed).any():
            found.append(each)
            continue
        worst = int(np.nanargmax(moved))
        said = f"is a decay, but its input {input_names[worst]} changes by {moved[worst]:.3g}"
        if rule != "keep":
            raise ValueError(f"{each.name} {said}; list it under controlled, or cut it to where the robot is let go "
                             "(in a card: leave it out of decays)")
        found.append(each.noted("moving_decays", f"{said}; kept, as faults.moving_decays says", "kept"))
    return found
