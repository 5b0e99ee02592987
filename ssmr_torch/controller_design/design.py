"""From recordings to a controller: `design`."""

from __future__ import annotations

import sys
from collections.abc import Callable
from contextlib import nullcontext
from dataclasses import dataclass, replace
from pathlib import Path
from time import perf_counter
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from ssmr_torch.control.actuator import Actuator
from ssmr_torch.control.designed import DesignedController
from ssmr_torch.control.tightening import tightened
from ssmr_torch.controller_design.controller import settings_of
from ssmr_torch.controller_design.identification import Identification, identify
from ssmr_torch.controller_design.model_choice import (
    SEARCHED,
    WILD,
    ChosenModel,
    acting_dataset,
    all_tried,
    choose_predictive,
    horizon_error,
    spectral_radii,
)
from ssmr_torch.controller_design.noises import Likelihood
from ssmr_torch.controller_design.readjustment import operation_error
from ssmr_torch.controller_design.recordings import Recordings, held_out, recordings_of
from ssmr_torch.controller_design.report import DesignReport
from ssmr_torch.controller_design.weights import choose_weights
from ssmr_torch.provenance import provenance
from ssmr_torch.trained_model import TrainedModel
from ssmr_torch.trajectory import TrajectoryDataset, refuse_other_data

if TYPE_CHECKING:
    from ssmr_torch.tasks.references import Task

MARGIN_QUANTILE = 0.95   # of the held-out errors, by which constraints are tightened
DISBELIEF = 1.2      # times the error without an actuator: one with which the best model misses by more is not believed
LOOPS = 300          # steps of the bar: designs whose margins are looked at, and loops against the twin


@dataclass(frozen=True, eq=False)
class Designed:
    """controller: ready to run; report: what was found, and why, see `DesignReport`. Unpacks into the two."""

    controller: DesignedController
    report: DesignReport

    def __iter__(self):
        return iter((self.controller, self.report))

    def save(self, folder: str | Path) -> Path:
        """Write the artifact with model and controller, see `DesignedController.save`."""
        return self.controller.save(folder)


def design(model: str | TrainedModel | None, data: TrajectoryDataset, task: Task, bounds: npt.ArrayLike, *,
           identified: Actuator | None = None, progress: bool | None = None) -> Designed:
    """A controller for the task from recordings alone; no closed loop of the robot is needed.

    1. Delay, lag, friction and rate limit of the actuators, by what a cheap model predicts of held-out runs.
    2. The model, trained on inputs that act. model: "predictive" (or None, "auto"): a predictive chart chosen by the
       held-out runs; another kind of conf/model, such as "ssmr" or "dmd", fitted by its defaults; or a `TrainedModel`,
       whose kind is fitted again, by its defaults, where the inputs that act are not the commands.
    3. Noises of inputs, states, disturbance and sensors by the likelihood of held-out runs; the stationary observer.
    4. Observer and weights by margins along the recordings and by loops against a twin, a second model.

    Outputs that are not tracked, and inputs that tracking leaves free, tend to where the recordings are dense.
    Obstacles and output bounds, of this task and of those that the controller is given later, are tightened at each
    step of the horizon by the 95 % quantile of what it misses of the held-out runs.

    data: recordings with controlled runs under dither; training and validation runs are used, test runs never.
    task: of `ssmr_torch.tasks`; its outputs are tracked.   bounds: (2, m), lowest and highest command.
    identified: an actuator that is known already; None: it is identified.
    progress: a bar on the terminal, and a line for each finding; None: a bar alone, where there is a terminal.

    Returns `(controller, report)`. Raises ValueError, with the reason, where the recordings cannot tell; TypeError for
    data that are no dataset.

    >>> controller, report = design("auto", data, task, bounds)                            # doctest: +SKIP
    """
    refuse_other_data(data)
    began = perf_counter()
    recordings = recordings_of(data, task.columns(data.output_names), bounds)
    shown = progress if progress is not None else sys.stderr.isatty()
    say = print if progress else lambda line: None
    with _bar(shown) as tell:
        found = _given(identified, recordings) if identified else identify(recordings, say=say)
        found, acted, tried = _believed(found, recordings, say)
        chosen = _chosen(model, data, acted, tried, found.actuator, say)
        likelihood = Likelihood(chosen.model, acted)
        noises = likelihood.most_likely(say=say)
        search = choose_weights(chosen, found.actuator, acted, likelihood, noises, task=task, tell=tell, say=say)
    settings = settings_of(search.best.weights, search.best.observer, found.actuator, acted, likelihood)
    report = DesignReport(recordings, found, chosen, noises, search, likelihood, task.name, perf_counter() - began)
    # in the order in which an artifact gives arrays back: products of another order are rounded otherwise
    ordered = chosen.model.with_arrays(np.ascontiguousarray)
    facts = report.facts | {"operation_error": operation_error(chosen.model, found.actuator, recordings)}
    controller = DesignedController(ordered, task, recordings.bounds, settings, timestep=data.timestep,
                                    output_names=data.output_names, facts=facts, card=_card(data, _name(model)))
    _tighten(controller, held_out(data), say)
    return Designed(controller, report)


def _tighten(controller: DesignedController, held: list, say: Callable[[str], None]) -> None:
    """Give the controller margins, also for obstacles of tasks to come. Raises ValueError where its own task has
    constraints, and what it misses of the held-out runs is too large for any.
    """
    try:
        tightened(controller, held, MARGIN_QUANTILE)
    except ValueError as error:
        if controller.problem.constraints is not None:
            raise
        say(f"no margins for obstacles: {error}")


def _name(model) -> str:
    """Under which the artifact's model is known."""
    if _is_searched(model):
        return "predictive"
    return model.upper() if isinstance(model, str) else model.name


def _is_searched(model) -> bool:
    """Whether a predictive model is asked for."""
    return isinstance(model, str | None) and model in SEARCHED


def _card(data: TrajectoryDataset, name: str) -> dict:
    """What an artifact's card says beside the model."""
    outputs, inputs = data.extremes()
    return {"name": name, "output_names": list(data.output_names), "input_names": list(data.input_names),
            "input_unit": data.input_unit, "rest": data.rest.tolist(), "input_range": inputs.tolist(),
            "output_range": outputs.tolist(), "sampling_time": data.timestep,
            "provenance": provenance() | {"data": data.provenance}}


def _given(actuator: Actuator, recordings: Recordings) -> Identification:
    if len(actuator.input_range) != recordings.input_dim or actuator.timestep != recordings.timestep:
        raise ValueError(f"the actuator has {len(actuator.input_range)} inputs and steps of {actuator.timestep:g} s; "
                         f"the recordings {recordings.input_dim} and {recordings.timestep:g} s")
    return Identification(actuator, np.nan, np.nan, {}, {}, {})


def _believed(found: Identification, recordings: Recordings, say) -> tuple[Identification, Recordings, list]:
    """The actuator, unless the best of all models predicts worse with it: then commands act as they are; the recordings
    under it, and what all models miss of them.
    """
    acted = recordings.under(found.actuator)
    tried = all_tried(acted)
    if found.actuator.trivial or np.isnan(found.error):
        return found, acted, tried
    plain = all_tried(recordings)
    if tried[0][1] <= DISBELIEF * plain[0][1]:
        return found, acted, tried
    say(f"the actuator is not believed: the best model misses held-out runs by {100 * tried[0][1]:.3g} % of the reach "
        f"with it, by {100 * plain[0][1]:.3g} % without")
    none = Actuator(recordings.timestep, found.actuator.input_range)
    return replace(found, actuator=none, error=found.plain), recordings, plain


def _chosen(model, data: TrajectoryDataset, acted: Recordings, tried: list, actuator: Actuator,
            say: Callable[[str], None]) -> ChosenModel:
    """The model that was asked for, and a predictive one as its twin."""
    if _is_searched(model):
        return choose_predictive(acted, tried, say=say)
    from ssmr_torch.fitting.by_kind import fit  # Torch and Lightning, which a predictive model does not need

    if isinstance(model, str):
        trained = fit(acting_dataset(data, actuator), model, progress=False)
    elif not actuator.trivial and isinstance(model, TrainedModel):
        trained = fit(acting_dataset(data, actuator), _kind_of(model), progress=False)
    else:
        trained = model
    reduced = trained.reduced.numpy().at_timestep(data.timestep)
    error = horizon_error(reduced, acted)
    radius = float(np.quantile(spectral_radii(reduced, acted), 0.9))
    if not np.isfinite(error):
        raise ValueError(f"{model} does not follow the held-out runs for 20 samples; design on another model, such as "
                         "'auto'")
    say(f"model: {reduced.kind} of {reduced.state_dim} states; held-out error {100 * error:.3g} % of the reach"
        + (f"; its Jacobians grow by up to {radius:.3g} a sample" if radius > WILD else ""))
    predictive = choose_predictive(acted, tried)
    return ChosenModel(reduced, error, predictive.model, predictive.error,
                       f"{getattr(trained, 'name', model)}: {reduced.kind} of {reduced.state_dim} states",
                       predictive.words, predictive.tried)


def _kind_of(model: TrainedModel) -> str:
    """With which `fit` made a model. Raises ValueError for one that does not tell."""
    kind = ((model.card.get("provenance") or {}).get("training") or {}).get("kind")
    if kind is None:
        raise ValueError(f"the inputs that act are not the commands, so that {model.name} must be fitted again; its "
                         "card does not tell its kind: give a kind by name, such as 'ssmr', or a model that this "
                         "version's fit made")
    return kind


def _bar(shown: bool):
    """A context that gives `tell(steps)`."""
    if not shown:
        return nullcontext(lambda steps: None)
    from tqdm import tqdm

    class Bar(tqdm):
        def __enter__(self):
            super().__enter__()
            return self.update

    return Bar(total=LOOPS, desc="design", leave=False)
