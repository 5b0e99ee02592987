"""Report of a selection, as plain values and as sentences."""

from __future__ import annotations

import numpy as np

from ssmr_torch.selection.settings import SelectionSettings


def facts(trial, team, outcome, *, scout, pool, refused, noise, symmetry, settings: SelectionSettings) -> dict:
    """Plain values: the choice, errors and spread by horizon in m, the closest alternatives, noise, CPU time."""
    samples = trial.samples
    horizons = [round(steps * samples.timestep, 6) for steps in samples.horizons]
    in_m = samples.scale * trial.persistence
    rivals = [each for each in pool if each not in team][:3]
    return {"members": [str(each) for each in team], "horizons": horizons,
            "held_out_error": (outcome.e * in_m).tolist(), "undetermined": (outcome.v * in_m).tolist(),
            "persistence": in_m.tolist(), "score": outcome.score,
            "rivals": [[str(each), trial.outcomes[each].score] for each in rivals],
            "single": trial.outcomes[team[0]].score,
            "tried": len(scout.outcomes), "refused": [str(each) for each in refused],
            "noise": noise, "symmetry": symmetry, "purpose": settings.purpose, "coordinates": list(samples.coordinates),
            "cpu": trial.cpu, "left_out": scout.left_out}


def sentences(found: dict) -> list[str]:
    """Sentences: what was chosen, the numbers behind it, and what the data could not decide."""
    labels = [f"{seconds:g} s" if seconds >= 1 else f"{1e3 * seconds:g} ms" for seconds in found["horizons"]]
    errors, spread, still = (", ".join(f"{1e3 * value:.3g} mm ({label})" for value, label in zip(found[key], labels))
                             for key in ("held_out_error", "undetermined", "persistence"))
    members = found["members"]
    lines = [f"Chosen for {found['purpose']} among {found['tried']} forms in {found['cpu']:.0f} s of CPU "
             "time: " + (members[0] if len(members) == 1
                         else f"the mean of {len(members)} models: " + "; ".join(members)) + ".",
             f"Error on held-out parts of the runs: {errors}; error of persistence: {still}.",
             f"For inputs twice as fast and 1.25 times larger, fits to different parts of the data differ by {spread}. "
             "If this exceeds the error, more recordings help more than another model."]
    close = [name for name, score in found["rivals"] if score - found["single"] < np.log(1.1)]
    if close:
        others = "one other form" if len(close) == 1 else f"{len(close)} other forms"
        lines.append(f"The data cannot decide between this form and {others} with a score within 10 %: "
                     + "; ".join(close) + ".")
    if len(found["coordinates"]) > 1:
        lines.append(f"Output coordinates that were tried: {', '.join(found['coordinates'])}.")
    lines.append(f"Estimated white measurement noise: about {1e3 * found['noise']:.2g} mm.")
    if found["symmetry"]:
        lines.append(found["symmetry"])
    if found["refused"]:
        lines.append(f"{len(found['refused'])} better forms were refused: their rollouts leave three times the "
                     "measured range for inputs twice as fast or 1.5 times larger, or do not decay at rest.")
    if found["left_out"]:
        lines.append(f"{found['left_out']} forms were not tried because the time was over; raise minutes.")
    return lines
