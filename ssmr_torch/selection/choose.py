"""`choose`: chooses the form of a slow-fast model from training runs and fits it (`model=auto`)."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np

from ssmr_torch.lazy import found
from ssmr_torch.models.output_coordinates import OutputCoordinates
from ssmr_torch.models.polynomial import PolynomialModel
from ssmr_torch.selection.coordinates import offered
from ssmr_torch.selection.folds_and_starts import MOST, SCOUTED, Samples
from ssmr_torch.selection.noise import measured_noise, recharted
from ssmr_torch.selection.refinement import refined
from ssmr_torch.selection.report import facts, sentences
from ssmr_torch.selection.search import search
from ssmr_torch.selection.settings import SelectionSettings
from ssmr_torch.selection.specification import Specification
from ssmr_torch.selection.symmetry import with_symmetry
from ssmr_torch.selection.team import averaged, choose_team, merged, stable_pool
from ssmr_torch.selection.trial import Outcome, Trial
from ssmr_torch.symmetry_turns import Turn

POOL = 12          # number of the best stable specifications, from which a team is chosen
RECONSIDERED = 40  # number of the best specifications that are scored again with all starts and more rows
SCOUTING = 0.6     # share of the CPU time for the first scores of all specifications
ROUND_TRIP = 1e-6  # relative to the outputs' size: largest permitted error of χ⁻¹(χ(y)) = y


@dataclass(frozen=True, eq=False)
class Choice:
    """The chosen model. team: specifications of its members, best first. outcome: outcome of the team.

    sentences: what was chosen, the numbers behind it, and what the data could not decide. facts: the same as plain
    values.
    """

    model: PolynomialModel
    team: list[Specification]
    outcome: Outcome
    sentences: list[str] = field(default_factory=list)
    facts: dict = field(default_factory=dict)


def choose(decays: Sequence, controlled: Sequence, timestep: float, settings: SelectionSettings | None = None, *,
           scored: Sequence[int] | None = None, input_names: Sequence[str] | None = None,
           say: Callable[[str], None] = lambda line: None) -> Choice:
    """Choose and fit a model from training runs only: lists of (y (T, p) m, u (T, m)), sampled every `timestep` s.

    scored: the columns of y that matter; None: all. input_names: names of the columns of u, which a stated symmetry
    uses; None: "1", "2", … say: function that receives a line at every stage.
    Raises ValueError if the runs are too short, or if no model that was tried stays bounded.
    """
    settings = SelectionSettings() if settings is None else settings
    y = np.concatenate([run[0] for run in (*decays, *controlled)])
    coordinates = _coordinates(y, settings.coordinates)
    targets = range(y.shape[1]) if scored is None else scored
    noise = measured_noise([run[0] for run in (decays or controlled)])

    def trial_with(turns: Sequence[Turn], most: int = MOST) -> Trial:
        samples = Samples(decays, controlled, timestep, coordinates=coordinates, targets=targets, turns=turns,
                          most=most)
        horizons = range(len(samples.horizons))[1:] if settings.purpose == "control" else None
        return Trial(samples, horizons=horizons or None, noise=max(noise, settings.noise))

    symmetric = with_symmetry(trial_with, settings.symmetry, input_names)
    scout = trial_with(symmetric.turns, SCOUTED)
    search(scout, decays=bool(decays), minutes=SCOUTING * settings.minutes, say=say)
    symmetric.trial.reconsider(scout.best(RECONSIDERED))
    symmetric = symmetric.kept()
    trial = symmetric.trial
    pool, refused = stable_pool(trial, trial.best(), POOL)
    if not pool:
        raise ValueError(f"no stable model was found: {len(scout.outcomes)} forms were tried, the best {len(refused)} "
                         "were checked, and all leave three times the measured range. Record longer runs with slower "
                         "or smaller inputs, and run ssmr check")
    if settings.refine:
        pool = refined(trial, pool, say=say)
    team = choose_team(trial, pool, 1 if settings.purpose == "control" else settings.team)
    members = [trial.final(each) for each in team]
    model = merged(members)
    if settings.noise > noise:
        model = recharted(model, trial.samples, settings.noise, noise)
    outcome = averaged(trial, team)
    found_out = facts(trial, team, outcome, scout=scout, pool=pool, refused=refused, noise=noise,
                      symmetry=symmetric.found, settings=settings)
    return Choice(model, team, outcome, sentences(found_out), found_out)


def _coordinates(y: np.ndarray, names: Sequence[str] | None) -> dict[str, OutputCoordinates | None]:
    """Output coordinates by name. Raises ValueError for coordinates that do not suit the data, or have no inverse."""
    suggested = offered(y)
    if names is None:
        return suggested
    chosen = {}
    for name in names:
        if name in suggested:
            chosen[name] = suggested[name]
        elif ":" in name:
            chosen[name] = _own(name, y)
        else:
            raise ValueError(f"output coordinates {name!r} are not possible with these data; give one of "
                             f'{list(suggested)}, or your own class as "module:Class"')
    return chosen


def _own(name: str, y: np.ndarray) -> OutputCoordinates:
    family = found(name)
    if not (isinstance(family, type) and issubclass(family, OutputCoordinates)):
        raise ValueError(f"{name} is not a class of output coordinates; derive it from "
                         "ssmr_torch.models.output_coordinates.OutputCoordinates")
    chi = family()
    with np.errstate(all="ignore"):
        back = chi.inverse(chi.forward(y))
        missed = np.abs(back - y).max() if back.shape == y.shape else np.inf
    size = np.abs(y).max()
    if not missed <= ROUND_TRIP * size:
        raise ValueError(f"{name} is not invertible on the recordings: χ⁻¹(χ(y)) differs from y by up to "
                         f"{1e3 * missed:.3g} mm, more than {ROUND_TRIP:g} times their size of {1e3 * size:.3g} mm; "
                         "correct the method inverse, or choose coordinates that are one-to-one over the whole range")
    if not np.allclose(chi.forward(np.zeros((1, y.shape[1]))), 0.0, atol=ROUND_TRIP * size):
        raise ValueError(f"{name} must map rest to zero, but χ(0) ≠ 0; subtract χ(0) in its method forward")
    return chi
