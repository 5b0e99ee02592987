"""A controller that was designed from recordings, and how an artifact stores it."""

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

SAME = 1e-3  # relative: two timesteps that differ by less are equal


class DesignedController(ModelPredictiveController):
    """A `ModelPredictiveController` from `ssmr_torch.design` or from an artifact. It knows how it was tuned.

    facts: plain values of the design's report; `tuned` says how, and with how many minutes of recordings.
    card: plain values of a `TrainedModel`, with which `save` writes the artifact; None: it cannot be saved.
    Everything else is as in `ModelPredictiveController`.
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
        """Another controller with this task, these facts, and these settings by name; the rest is the same.

        Raises ValueError, with both lists, for a task that does not track the outputs of the design.
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
        """Names of the tracked outputs, or their columns where the names are unknown."""
        return _tracked(self.task, self.output_names)

    def readjust(self, records, *, expected: float | None = None, fixed_friction: bool = False,
                 say: Callable[[str], None] = lambda line: None) -> tuple:
        """Estimate delay, lag, play, gains and offsets again from about 12 s of operation. Returns the controller with
        them and a `Readjustment`; this same controller where the result is not accepted. See
        `controller_design.readjustment`.
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
        """Run a task (None: its own) on the controller's model, before the robot does. Returns a `Rehearsal`; see
        `controller_design.rehearsal`.
        """
        return found("ssmr_torch.controller_design.rehearsal:rehearse")(self, task)

    def save(self, folder: str | Path) -> Path:
        """Write the artifact with model and controller. An existing one is replaced as a whole, or not at all.

        Raises ValueError for a controller without a card, settings that no file can hold, and a folder of other files.
        """
        if self.card is None:
            raise ValueError("this controller does not know the names, the rest position and the unit of its robot; "
                             "expected a card, as controllers from ssmr_torch.design and ssmr_torch.load have it")
        trained = found("ssmr_torch.trained_model:TrainedModel")
        return trained(self.model, self.card, designed=carried(self)).save(folder)

    def data_sheet(self) -> tuple[str, dict]:
        title, entries = super().data_sheet()
        return title, {"tuned": self.facts.get("tuned", "by given settings")} | entries


def carried(controller: DesignedController) -> dict:
    """The controller as the content of `controller.json` in an artifact; plain values, exact to the last bit.

    `controller`: its settings, as `build` takes them; `task`: that of the design, null where no file can hold its path;
    `tracked`, `timestep` s, `input_bounds` (2, m), `facts`.
    Raises ValueError for an observer or a solver that has no name in a file.
    """
    if controller._solver_given is not None:
        raise ValueError(f"the controller was given a {type(controller._solver_given).__name__} as its solver, which a "
                         "file cannot hold; name a solver by the setting qp instead")
    settings = {field.name: written(getattr(controller.settings, field.name), field.name)
                for field in fields(controller.settings)}
    try:
        task = written(controller.task, "task")
    except ValueError:
        task = None  # its path is a function: the user gives another task with the controller
    return {"controller": {"_target_": f"{DesignedController.__module__}.{DesignedController.__name__}", **settings},
            "task": task, "tracked": written(controller.tracked), "timestep": controller.timestep,
            "input_bounds": controller._designed_for.tolist(), "facts": written(controller.facts, "facts")}


@configurable(given=("task", "input_bounds", "timestep", "output_names"))
def designed_controller(loaded, task=None, input_bounds=None, *, timestep: float | None = None, output_names=None,
                        **changes) -> DesignedController:
    """The controller in an artifact; `controller=designed` in the commands.

    loaded: an `Artifact` or a `TrainedModel`.   task: one that tracks the same outputs; None: that of the design.
    input_bounds: (2, m), of the robot. Commands stay within these bounds and those of the design, which also define the
    unit of the weights.   timestep, output_names: of the robot; they must equal those of the design.   changes: of the
    settings, by name.
    Raises ValueError for an artifact without a controller, with the command that makes one, and where task, timestep or
    bounds do not fit, with both sides.
    """
    designed = _designed(loaded)
    card = {"input_unit": loaded.card["units"]["input"], **loaded.card} if "units" in loaded.card else loaded.card
    names = tuple(card["output_names"] if output_names is None else output_names)
    if timestep is not None and abs(timestep / designed["timestep"] - 1.0) > SAME:
        raise ValueError(f"the controller was designed for samples every {designed['timestep']:g} s, but the robot has "
                         f"{timestep:g} s; change the robot's timestep, or design with recordings of this timestep")
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
        raise ValueError("the artifact has no designed controller; run ssmr design data.path=FILE.h5 task=TASK "
                         "plant=PLANT, which writes an artifact with one, or choose another controller, such as "
                         "controller=scp")
    return designed


def own_task(loaded):
    """The task that an artifact's controller was designed for. Raises ValueError where the file does not hold it."""
    designed = _designed(loaded)
    if not designed.get("task"):
        raise ValueError(f"the controller was designed for a task whose path a file cannot hold; give a task that "
                         f"tracks {designed['tracked']}")
    return build(designed["task"])


def _tracked(task, output_names) -> tuple:
    columns = task.columns(output_names)
    return columns if output_names is None else tuple(output_names[column] for column in columns)


def _refuse_other_outputs(task, output_names, tracked: tuple) -> None:
    asked = _tracked(task, output_names)
    if set(asked) != set(tracked):
        raise ValueError(f"the task {task.name!r} tracks {list(asked)}, but the controller was designed to track "
                         f"{list(tracked)}: give a task that tracks these, or design a controller for your task")


def _narrow(controller: DesignedController, bounds) -> None:
    """Keep commands within these bounds (2, m) and within those of the design."""
    own = controller.input_bounds
    bounds = changed_bounds(bounds, own.shape)
    both = np.stack([np.maximum(own[0], bounds[0]), np.minimum(own[1], bounds[1])])
    if (both[0] > both[1]).any():
        raise ValueError(f"the controller was designed for inputs from {own[0].tolist()} to {own[1].tolist()}; the "
                         f"robot's range from {bounds[0].tolist()} to {bounds[1].tolist()} does not overlap it")
    if (both != own).any():
        controller.input_bounds = both
