"""Check of the decays: how many there are, and whether they come to rest."""

from __future__ import annotations

import numpy as np

from ssmr_torch.recording_checks.context import Recorded
from ssmr_torch.recording_checks.finding import GOOD, LOOK, MISSING, Finding, millimetres

ENOUGH = 4
END = 0.1           # last part of a decay, as a share of its length
STILL = 0.05        # permitted motion in this part, as a share of the largest displacement
ELSEWHERE = 0.03    # permitted distance between the ends of decays, as a share of the reach


def decays(recorded: Recorded) -> Finding:
    """Number of training decays, their motion in the last tenth, and the scatter of their ends."""
    runs, subject = recorded.of("train", "decay"), "decays"
    if not runs:
        return Finding(subject, MISSING, "0 training decays: the slow modes must be estimated from controlled runs.",
                       "Pull the robot aside and release it, ten times from different sides, and record until it "
                       "rests; name these runs under decays.", {"count": 0})
    last = [run.observation[-max(2, round(END * run.length)):] for run in runs]
    size = np.array([np.abs(run.observation - run.observation[-1]).max() for run in runs])
    size[size == 0] = np.inf
    moves = np.array([max(0.0, np.ptp(rows, axis=0).max() - 6 * recorded.noise.std.max()) for rows in last]) / size
    ends = np.array([rows.mean(axis=0) for rows in last])
    apart = np.linalg.norm(ends - np.median(ends, axis=0), axis=1)
    away = float(np.linalg.norm(np.median(ends, axis=0)))
    numbers = {"count": len(runs), "moving_share": float(moves.max()), "still_moving": int((moves > STILL).sum()),
               "ends_apart_m": float(apart.max()), "ends_from_rest_m": away}
    curves = {"decays": [(run.time - run.time[0], np.linalg.norm(run.observation, axis=1)) for run in runs]}
    said = (f"{len(runs)} decays; in their last tenth they move by at most {100 * moves.max():.2g} % of their size. "
            f"Their ends are up to {millimetres(apart.max())} apart and {millimetres(away)} from rest.")
    if len(runs) == 1:
        said = (f"1 decay; in its last tenth it moves by at most {100 * moves.max():.2g} % of its size. Its end is "
                f"{millimetres(away)} from rest.")
    if away > ELSEWHERE * recorded.reach and away > 3 * np.median(apart):
        remedy = "State the position where the decays end as rest (rest: last sample of decays)."
        return Finding(subject, MISSING if away > 0.3 * recorded.reach else LOOK, said, remedy, numbers, curves)
    if (moves > STILL).sum() > 0.1 * len(runs):
        return Finding(subject, LOOK, f"{said} {(moves > STILL).sum()} of them still move at the end.",
                       "Record until the robot rests, about twice as long.", numbers, curves)
    if apart.max() > ELSEWHERE * recorded.reach:
        worst = runs[int(apart.argmax())].name
        return Finding(subject, LOOK, f"{said} The farthest one is {worst!r}.",
                       "Check that run for friction, drift or a moved camera, or measure each decay from its own end "
                       "(centred).", numbers, curves)
    if len(runs) < ENOUGH:
        return Finding(subject, LOOK, said, f"Record at least {ENOUGH}, from different sides.", numbers, curves)
    return Finding(subject, GOOD, said, "", numbers, curves)
