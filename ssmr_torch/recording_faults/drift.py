"""Drift: a position that wanders within a run, or from run to run, without the inputs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ssmr_torch.recording_estimates.response import Response, response
from ssmr_torch.recording_faults.recording import Recording
from ssmr_torch.recording_faults.responses import Part, modes_of, parts

CERTAIN = 6.0       # standard errors
LEVEL, TREND = 2.0, 4.0  # lengths of a part, relative to the memory of the modes, from which either can be told
MATTERS = 0.06      # of the reach


def drift(recordings: Sequence[Recording], rest: np.ndarray, rule: str) -> list[Recording]:
    """The recordings with a note on each whose position drifts, and without the drift for the rule "remove".

    Least squares of the positions of all controlled runs on their inputs, filtered by the slow modes, with a constant
    and a slope for each run (`recording_estimates.response`). A slope counts if it is more than six standard errors
    and 6 % of the reach; so does a level relative to that of the run that is nearest to rest.
    Raises ValueError for the rule "refuse".
    """
    every = parts(recordings, rest)
    driven = [part for part in every if part.run.kind == "controlled"]
    found = _fitted(every, driven)
    if found is None:
        return list(recordings)
    fit, judged = found
    trends = _trends(fit, judged)
    said = {}
    for part, trend in zip(judged, trends):
        if trend.any():
            said.setdefault(part.name, []).append((part, trend))
    return [_treated(each, said[each.name], rule) if each.name in said else each for each in recordings]


def _fitted(every: list[Part], driven: list[Part]) -> tuple[Response, list[Part]] | None:
    if not driven:
        return None
    modes = modes_of(every)
    if modes.memory is None:
        return None
    judged = [part for part in driven if part.run.length * part.run.timestep > LEVEL * modes.memory]
    count = len(judged)
    if not count or not any(np.ptp(part.run.input, axis=0).any() for part in judged):
        return None

    def own(run, number, _):
        constant, slope = np.zeros((run.length, count)), np.zeros((run.length, count))
        constant[:, number] = 1.0
        if run.length * run.timestep > TREND * modes.memory:
            slope[:, number] = np.linspace(-0.5, 0.5, run.length)
        return {"constant": constant, "slope": slope}

    fit = response([part.run for part in judged], modes, own, shortest=LEVEL)
    return None if fit is None else (fit, judged)


def _trends(fit: Response, judged: list[Part]) -> list[np.ndarray]:
    """(2, p) for each part, m: the position at its begin and at its end that neither inputs nor rest explain."""
    reach = float(np.median([np.ptp(part.run.observation, axis=0).max() for part in judged]))
    slope, doubt = fit.coefficients["slope"], fit.errors["slope"]
    slope = np.where(np.abs(slope) > np.maximum(CERTAIN * doubt, MATTERS * reach), slope, 0.0)
    begin, unsure = fit.coefficients["constant"] - slope / 2, fit.errors["constant"] + doubt / 2
    nearest = begin[np.linalg.norm(begin, axis=1).argmin()] if len(judged) > 1 else begin[0]
    level = begin - nearest
    level = np.where(np.abs(level) > np.maximum(CERTAIN * unsure, MATTERS * reach), level, 0.0)
    return [np.stack([low, low + rise]) for low, rise in zip(level, slope)]


def _treated(recording: Recording, found: list[tuple[Part, np.ndarray]], rule: str) -> Recording:
    words = []
    y = recording.observation.copy()
    for part, trend in found:
        duration = part.run.timestep * (part.run.length - 1)
        y[part.first:part.stop] -= np.linspace(0, 1, part.stop - part.first)[:, None] * (trend[1] - trend[0]) + trend[0]
        rise, level = trend[1] - trend[0], trend[0]
        rows = f" in rows {recording.rows[part.first]}..{recording.rows[part.stop - 1]}" if (
            part.stop - part.first < len(recording.time)) else ""
        if rise.any():
            words.append(f"the position drifts by {_sizes(recording, rise)} in {duration:.3g} s{rows}")
        if level.any():
            words.append(f"a drift or shift of {_sizes(recording, level)} from the other runs{rows}")
    said = "; ".join(words)
    if rule == "refuse":
        raise ValueError(f"{recording.name}: {said}; set faults.drift: remove to subtract it")
    numbers = {"drift_m": [[float(f"{value:.4g}") for value in row] for row in found[0][1]]}
    if rule == "keep":
        return recording.noted("drift", f"{said}; kept (faults.drift: remove subtracts it)", "kept", **numbers)
    return replace(recording, observation=y).noted("drift", f"{said}; subtracted, as faults.drift says", "corrected",
                                                   **numbers)


def _sizes(recording: Recording, sizes: np.ndarray) -> str:
    names = recording.output_names or [f"y{number}" for number in range(1, len(sizes) + 1)]
    return " and ".join(f"{1e3 * size:+.3g} mm in {name}" for name, size in zip(names, sizes) if size)
