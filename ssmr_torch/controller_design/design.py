"""The function `design`: from recordings to a controller."""

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
from ssmr_torch.controller_design.settings_from_design import settings_of
from ssmr_torch.controller_design.weights import choose_weights
from ssmr_torch.provenance import provenance
from ssmr_torch.renamed import kind_now
from ssmr_torch.trained_model import TrainedModel
from ssmr_torch.trajectory import TrajectoryDataset, refuse_other_data

if TYPE_CHECKING:
    from ssmr_torch.tasks.references import Task

MARGIN_QUANTILE = 0.95   # quantile of the held-out errors by which constraints are tightened
DISBELIEF = 1.2      # an actuator is rejected if the best model's error with it is more than this times that without it
LOOPS = 300          # length of the progress bar: designs with computed margins, and loops against the twin


@dataclass(frozen=True, eq=False)
class Designed:
    """controller: ready to run.   report: the findings and their reasons, see `DesignReport`. Unpacks into the two."""

    controller: DesignedController
    report: DesignReport

    def __iter__(self):
        return iter((self.controller, self.report))

    def save(self, folder: str | Path) -> Path:
        """Write the artifact with model and controller; see `DesignedController.save`."""
        return self.controller.save(folder)


def design(model: str | TrainedModel | None, data: TrajectoryDataset, task: Task, bounds: npt.ArrayLike, *,
           identified: Actuator | None = None, progress: bool | None = None) -> Designed:
    """Design a controller for a task from recordings alone, without closed loops of the robot.

    1. Find delay, lag, friction and rate limit of the actuators, by the errors of a cheap model on held-out runs.
    2. Fit the model, trained on acting inputs. model: "predictive" (or None, "auto"): a predictive chart, chosen by the
       held-out runs; another kind in conf/model, such as "ssmr" or "dmd", with its defaults; or a `TrainedModel`, whose
       kind is fitted again with its defaults where acting inputs differ from commands.
    3. Find the noises of inputs, states, disturbance and sensors by the likelihood of held-out runs. They give the
       stationary observer.
    4. Choose observer and weights by margins along the recordings and by loops against a twin, a second model.

    Outputs that are not tracked, and inputs that tracking leaves free, tend to where the recordings are dense.
    Obstacles and output bounds, of this task and of later tasks, are tightened at each step of the horizon by the 95 %
    quantile of the prediction errors on held-out runs.

    data: recordings with controlled runs under dither. Training and validation runs are used, test runs never.
    task: of `ssmr_torch.tasks`; its outputs are tracked.   bounds: (2, m), lowest and highest command.
    identified: an actuator that is already known; None: identify it.
    progress: True: a progress bar, and a line for each finding; None: a progress bar where there is a terminal.

    Returns `(controller, report)`. Raises ValueError, with the reason, where the recordings are not sufficient, and
    TypeError where data is not a dataset.

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
    # An artifact loads arrays in C order. Products of arrays in another order would be rounded differently.
    ordered = chosen.model.with_arrays(np.ascontiguousarray)
    facts = report.facts | {"operation_error": operation_error(chosen.model, found.actuator, recordings)}
    controller = DesignedController(ordered, task, recordings.bounds, settings, timestep=data.timestep,
                                    output_names=data.output_names, facts=facts, card=_card(data, _name(model)))
    _tighten(controller, held_out(data), say)
    return Designed(controller, report)


def _tighten(controller: DesignedController, held: list, say: Callable[[str], None]) -> None:
    """Give the controller its margins, also for obstacles of later tasks. Raises ValueError where its own task has
    constraints and the prediction errors on held-out runs are too large for margins.
    """
    try:
        tightened(controller, held, MARGIN_QUANTILE)
    except ValueError as error:
        if controller.problem.constraints is not None:
            raise
        say(f"no margins for obstacles: {error}")


def _name(model) -> str:
    """The name of the model in the artifact."""
    if _is_searched(model):
        return "predictive"
    return model.upper() if isinstance(model, str) else model.name


def _is_searched(model) -> bool:
    """Whether a predictive model was requested."""
    return isinstance(model, str | None) and model in SEARCHED


def _card(data: TrajectoryDataset, name: str) -> dict:
    """The entries of an artifact's card that do not come from the model."""
    outputs, inputs = data.extremes()
    return {"name": name, "output_names": list(data.output_names), "input_names": list(data.input_names),
            "input_unit": data.input_unit, "rest": data.rest.tolist(), "input_range": inputs.tolist(),
            "output_range": outputs.tolist(), "sampling_time": data.timestep,
            "provenance": provenance() | {"data": data.provenance}}


def _given(actuator: Actuator, recordings: Recordings) -> Identification:
    if len(actuator.input_range) != recordings.input_dim or actuator.timestep != recordings.timestep:
        raise ValueError(f"the actuator has {len(actuator.input_range)} inputs and steps of {actuator.timestep:g} s; "
                         f"expected {recordings.input_dim} inputs and {recordings.timestep:g} s, as in the recordings")
    return Identification(actuator, np.nan, np.nan, {}, {}, {})


def _believed(found: Identification, recordings: Recordings, say) -> tuple[Identification, Recordings, list]:
    """The accepted actuator, the recordings with its acting inputs, and the errors of all models on them.

    The actuator is rejected if even the best model predicts worse with it; commands then act directly.
    """
    acted = recordings.under(found.actuator)
    tried = all_tried(acted)
    if found.actuator.trivial or np.isnan(found.error):
        return found, acted, tried
    plain = all_tried(recordings)
    if tried[0][1] <= DISBELIEF * plain[0][1]:
        return found, acted, tried
    say(f"the actuator is rejected: the best model's held-out error is {100 * tried[0][1]:.3g} % of the reach with it, "
        f"and {100 * plain[0][1]:.3g} % without it")
    none = Actuator(recordings.timestep, found.actuator.input_range)
    return replace(found, actuator=none, error=found.plain), recordings, plain


def _chosen(model, data: TrajectoryDataset, acted: Recordings, tried: list, actuator: Actuator,
            say: Callable[[str], None]) -> ChosenModel:
    """The requested model, with a predictive model as its twin."""
    if _is_searched(model):
        return choose_predictive(acted, tried, say=say)
    from ssmr_torch.fitting.fit import fit  # needs Torch and Lightning; a predictive model does not

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
        raise ValueError(f"{model} cannot predict the held-out runs over 20 samples; design with another model, such "
                         "as 'auto'")
    say(f"model: {reduced.kind} of {reduced.state_dim} states; held-out error {100 * error:.3g} % of the reach"
        + (f"; its Jacobians grow by up to {radius:.3g} per sample" if radius > WILD else ""))
    predictive = choose_predictive(acted, tried)
    return ChosenModel(reduced, error, predictive.model, predictive.error,
                       f"{getattr(trained, 'name', model)}: {reduced.kind} of {reduced.state_dim} states",
                       predictive.words, predictive.tried)


def _kind_of(model: TrainedModel) -> str:
    """The kind with which `fit` made a model. Raises ValueError where the model's card does not tell it."""
    kind = ((model.card.get("provenance") or {}).get("training") or {}).get("kind")
    if kind is None:
        raise ValueError(f"the acting inputs differ from the commands, so {model.name} must be fitted again, but its "
                         "card does not tell its kind. Give a kind by name, such as 'ssmr', or a model that was made "
                         "by fit of this version")
    return kind_now(kind)


def _bar(shown: bool):
    """A context manager that gives the function `tell(steps)` of a progress bar."""
    if not shown:
        return nullcontext(lambda steps: None)
    from tqdm import tqdm

    class Bar(tqdm):
        def __enter__(self):
            super().__enter__()
            return self.update

    return Bar(total=LOOPS, desc="design", leave=False)
