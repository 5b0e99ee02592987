"""A controller that was designed from recordings, and how an artifact carries it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import fields
from pathlib import Path

import numpy as np

from ssmr_torch.control.input_bounds import changed_bounds
from ssmr_torch.control.mpc import ModelPredictiveController
from ssmr_torch.control.mpc_settings import PredictiveControlSettings
from ssmr_torch.keywords import configurable
from ssmr_torch.lazy import found
from ssmr_torch.targets import build, written

SAME = 1e-3  # relative, of a timestep that is the design's


class DesignedController(ModelPredictiveController):
    """A `ModelPredictiveController` as `ssmr_torch.design` and an artifact give it; it knows what tuned it.

    facts: plain values of the design's report; `tuned` says who or what tuned it and from how many minutes.
    card: plain values of a `TrainedModel`, with which `save` writes the artifact; None: it cannot be saved.
    All else is as of `ModelPredictiveController`.
    """

    @configurable(PredictiveControlSettings, given=("settings", "timestep", "output_names", "solver", "facts", "card"))
    def __init__(self, model, task, input_bounds, settings: PredictiveControlSettings | None = None, *,
                 facts: Mapping | None = None, card: Mapping | None = None, timestep: float | None = None,
                 output_names=None, solver=None, **changes):
        super().__init__(model, task, input_bounds, settings, timestep=timestep, output_names=output_names,
                         solver=solver, **changes)
        self.facts, self.card, self._solver_given = dict(facts or {}), card, solver
        self._designed_for = np.array(input_bounds, dtype=np.float64)

    def changed(self, task=None, *, facts: Mapping | None = None, **changes) -> DesignedController:
        """Another controller with this task, these facts and these settings by name; all else as it is here.

        Raises ValueError, with both lists, for a task that tracks other outputs than the design's.
        """
        task = self.task if task is None else task
        _refuse_other_outputs(task, self.output_names, self.tracked)
        again = type(self)(self.model, task, self._designed_for, self.settings.changed(**changes),
                           facts=self.facts if facts is None else facts, card=self.card, timestep=self.timestep,
                           output_names=self.output_names, solver=self._solver_given)
        if (self.input_bounds != self._designed_for).any():
            again.input_bounds = self.input_bounds
        return again

    @property
    def tracked(self) -> tuple:
        """Names of the tracked outputs, or their columns where no names are known."""
        return _tracked(self.task, self.output_names)

    def readjust(self, records, *, expected: float | None = None, fixed_friction: bool = False,
                 say: Callable[[str], None] = lambda line: None) -> tuple:
        """The controller with delay, lag, play, gains and offsets fitted to some 12 s of operation, and what was found,
        a `Readjustment`; this same controller where that was not accepted. See `controller_design.readjustment`.
        """
        adjust = found("ssmr_torch.controller_design.readjustment:readjustment")
        records = [records] if hasattr(records, "measurement") else list(records)
        told = adjust(self, records, expected=expected, fixed_friction=fixed_friction, say=say)
        if not told.accepted:
            return self, told
        seconds = sum(len(record.time) for record in records) * self.timestep
        tuned = f"{self.facts.get('tuned', 'given settings')}, readjusted from {seconds:.3g} s of operation"
        facts = self.facts | {"tuned": tuned, "actuator": told.actuator.plain(), "readjusted": told.words}
        return self.changed(actuator=told.actuator, facts=facts), told

    def rehearse(self, task=None):
        """The task, None: its own, on the controller's model before the robot: a `Rehearsal`. See
        `controller_design.rehearsal`.
        """
        return found("ssmr_torch.controller_design.rehearsal:rehearse")(self, task)

    def save(self, folder: str | Path) -> Path:
        """Write the artifact that holds model and controller, whole or not at all; one already there is replaced.

        Raises ValueError for a controller without a card, settings that no file can hold, a folder with other files.
        """
        if self.card is None:
            raise ValueError("this controller does not know the names, the rest position and the unit of its robot; "
                             "expected a card, as ssmr_torch.design and ssmr_torch.load give one")
        trained = found("ssmr_torch.trained_model:TrainedModel")
        return trained(self.model, self.card, designed=carried(self)).save(folder)

    def data_sheet(self) -> tuple[str, dict]:
        title, entries = super().data_sheet()
        return title, {"tuned": self.facts.get("tuned", "by given settings")} | entries


def carried(controller: DesignedController) -> dict:
    """The controller as `controller.json` of an artifact holds it, plain values to the last bit.

    `controller`: its settings, as `build` takes them; `task`: that of the design, null where no file can hold its path;
    `tracked`, `timestep` s, `input_bounds` (2, m), `facts`.
    Raises ValueError for an observer or a solver that no file can name.
    """
    if controller._solver_given is not None:
        raise ValueError(f"the controller was given a {type(controller._solver_given).__name__} as its solver; name "
                         "one by the setting qp, which a file can hold")
    settings = {field.name: written(getattr(controller.settings, field.name), field.name)
                for field in fields(controller.settings)}
    try:
        task = written(controller.task, "task")
    except ValueError:
        task = None  # a path that is a function: another task is given when the controller is used
    return {"controller": {"_target_": f"{DesignedController.__module__}.{DesignedController.__name__}", **settings},
            "task": task, "tracked": written(controller.tracked), "timestep": controller.timestep,
            "input_bounds": controller._designed_for.tolist(), "facts": written(controller.facts, "facts")}


@configurable(given=("task", "input_bounds", "timestep", "output_names"))
def designed_controller(loaded, task=None, input_bounds=None, *, timestep: float | None = None, output_names=None,
                        **changes) -> DesignedController:
    """The controller that an artifact carries; `controller=designed` of the commands.

    loaded: an `Artifact` or a `TrainedModel`.   task: one that tracks the same outputs; None: that of the design.
    input_bounds: (2, m), of the robot; commands stay within these and the design's, in whose units the weights are.
    timestep, output_names: of the robot, which must be the design's.   changes: of the settings, by name.
    Raises ValueError for an artifact without one, saying what to run, and where task, timestep or bounds do not fit,
    with both sides.
    """
    designed = _designed(loaded)
    card = {"input_unit": loaded.card["units"]["input"], **loaded.card} if "units" in loaded.card else loaded.card
    names = tuple(card["output_names"] if output_names is None else output_names)
    if timestep is not None and abs(timestep / designed["timestep"] - 1.0) > SAME:
        raise ValueError(f"the controller was designed for samples every {designed['timestep']:g} s; the robot's come "
                         f"every {timestep:g} s: sample the robot so, or design on recordings of its timestep")
    if task is None:
        task = own_task(loaded)
    _refuse_other_outputs(task, names, tuple(designed["tracked"]))
    controller = build({**designed["controller"], **changes}, loaded.reduced, task, designed["input_bounds"],
                       timestep=designed["timestep"], output_names=names, facts=designed["facts"], card=card)
    if input_bounds is not None:
        _narrow(controller, input_bounds)
    return controller


def _designed(loaded) -> Mapping:
    designed = getattr(loaded, "designed", None)
    if not designed:
        raise ValueError("the artifact carries no designed controller; run ssmr design data.path=FILE.h5 task=TASK "
                         "plant=PLANT, which writes one that does, or name another controller, such as controller=scp")
    return designed


def own_task(loaded):
    """The task that the controller of an artifact was designed for. Raises ValueError where the file holds none."""
    designed = _designed(loaded)
    if not designed.get("task"):
        raise ValueError(f"the controller was designed for a task whose path no file can hold; give a task that tracks "
                         f"{designed['tracked']}")
    return build(designed["task"])


def _tracked(task, output_names) -> tuple:
    columns = task.columns(output_names)
    return columns if output_names is None else tuple(output_names[column] for column in columns)


def _refuse_other_outputs(task, output_names, tracked: tuple) -> None:
    asked = _tracked(task, output_names)
    if set(asked) != set(tracked):
        raise ValueError(f"the task {task.name!r} tracks {list(asked)}; the controller was designed to track "
                         f"{list(tracked)}: give a task of these, or design one for yours")


def _narrow(controller: DesignedController, bounds) -> None:
    """Commands within these bounds (2, m) and the design's."""
    own = controller.input_bounds
    bounds = changed_bounds(bounds, own.shape)
    both = np.stack([np.maximum(own[0], bounds[0]), np.minimum(own[1], bounds[1])])
    if (both[0] > both[1]).any():
        raise ValueError(f"the controller was designed for inputs from {own[0].tolist()} to {own[1].tolist()}; the "
                         f"robot's go from {bounds[0].tolist()} to {bounds[1].tolist()}, and have none in common")
    if (both != own).any():
        controller.input_bounds = both
