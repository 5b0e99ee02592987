"""`TrainedModel`: a fitted model with the names, units and ranges of its data; the result of `fit` and `load`."""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from ssmr_torch import data_sheet as sheet
from ssmr_torch.data_sheet import DataSheet
from ssmr_torch.deployment import artifact
from ssmr_torch.models.base import Model
from ssmr_torch.models.predictors import as_predictor, at_every_sample
from ssmr_torch.periods import whole_multiple

if TYPE_CHECKING:
    from ssmr_torch.control.designed import DesignedController
    from ssmr_torch.tasks.references import Task

OUTSIDE = 0.25  # a prediction may leave the training range by this share of the range without a warning


class OutsideTraining(UserWarning):
    """Warning: a prediction leaves the range of the training data."""


@dataclass(frozen=True, eq=False)
class TrainedModel(DataSheet):
    """z = v(window), z⁺ = f(z, u), y = w(z), with the names, units and ranges of the training data.

    reduced: the model as plain arrays, which controllers take. card: plain values: name, output_names, input_names,
    input_unit, rest (p,) m, input_range (2, m), sampling_time s, scores, cost, provenance. module: the torch.nn.Module
    that was fitted; None for an artifact. report: the report of each fit; empty for an artifact. designed: the
    controller in an artifact of `ssmr design`, as JSON; None if there is none, see `controller`.

    `ssmr_torch.fit` and `ssmr_torch.load` return it; see `predict`, `save` and `export`.

    >>> model                                                                            # a model of an oscillator
    TrainedModel DMD: 6 states, 1 inputs, 2 outputs
    ├─ outputs: x, v; displacement from rest, m
    ├─ inputs: range of the training
    │  └─ u: -0.199 … 0.199 N
    ├─ window: 2 samples, 0.01 s apart; delays = 1
    ├─ step: 0.01 s (100 Hz)
    ├─ recordings: 0.01 s (100 Hz)
    ├─ stability: margin 1.01 1/s, slowest mode -1.01 ± 10i 1/s
    ├─ scores
    ...
    ├─ trained on: 2 decays, 1360 samples of controlled runs
    ├─ rest: 0, 0 mm
    ├─ from: arrays
    ├─ sources: decay 1 (...), decay 2 (...), controlled 1 (...), … (5)
    └─ made by: ssmr_torch ...
    """

    reduced: Model
    card: Mapping
    module: object = None
    report: Mapping = field(default_factory=dict)
    designed: Mapping | None = None

    @classmethod
    def load(cls, folder: str | Path) -> TrainedModel:
        """The model of an artifact. Raises the errors of `artifact.load`."""
        loaded = artifact.load(folder)
        return cls(loaded.model, {"input_unit": loaded.card["units"]["input"], **loaded.card}, designed=loaded.designed)

    @property
    def name(self) -> str:
        return self.card["name"]

    @property
    def output_names(self) -> tuple[str, ...]:
        return tuple(self.card["output_names"])

    @property
    def input_names(self) -> tuple[str, ...]:
        return tuple(self.card["input_names"])

    @property
    def input_unit(self) -> str:
        """"N", or "1" for normalized commands."""
        return self.card["input_unit"]

    @property
    def rest(self) -> np.ndarray:
        """(p,), m, the absolute position from which the outputs are displacements."""
        return np.array(self.card["rest"], dtype=np.float64)

    @property
    def input_range(self) -> np.ndarray:
        """(2, m), lowest and highest input in the training data."""
        return np.array(self.card["input_range"], dtype=np.float64)

    @property
    def scores(self) -> dict[str, float]:
        """Open-loop errors on the validation and test runs at the time of the fit, m, by name; infinite if a rollout
        diverged.
        """
        return _finite(self.card.get("scores"))

    @property
    def delays(self) -> int:
        """Number of samples in a window before the newest one."""
        return self.reduced.delays

    @property
    def timestep(self) -> float:
        """Length of one step of the model, s."""
        return self.reduced.timestep

    @property
    def window_timestep(self) -> float:
        """Time between the samples of a window, s."""
        return self.reduced.window_timestep

    @property
    def sampling_time(self) -> float:
        """Sampling time of the recordings, s; for an artifact that does not state it, that of the window."""
        return float(self.card.get("sampling_time") or self.window_timestep)

    def predict(self, window: npt.ArrayLike, inputs: npt.ArrayLike,
                past_inputs: npt.ArrayLike | None = None) -> np.ndarray:
        """Outputs at the next H instants of the recording's sampling:  y_k = w(f(… f(v(window), u_0) …, u_{k-1})).

        window (…, delays + 1, p): measured displacements from rest, m, newest last, `window_timestep` s apart.
        inputs (…, H, m): each held for one `sampling_time`, beginning at the newest sample. past_inputs (…, delays, m):
        the inputs held between the samples of the window; only models whose chart uses them need them. Leading
        dimensions are broadcast. Returns (…, H, p), m, infinite from the step at which the prediction diverged.

        If inputs or outputs leave the training range by more than a quarter of it, a warning says which and how far.
        The prediction is then not reliable.
        The model steps by the sampling time if it can. A model that was fitted at a multiple of it takes the mean of
        the inputs over each of its steps (the last input is held to the end), and its outputs are interpolated linearly
        in between.
        Raises ValueError for arrays of another shape, numbers that are not finite, and missing past_inputs.
        """
        window, inputs, past = self._arguments(window, inputs, past_inputs)
        leading, horizon = inputs.shape[:-2], inputs.shape[-2]
        count = int(np.prod(leading))  # without delays the size of past_inputs is 0 and cannot be used here
        window, inputs, past = (array.reshape(count, *array.shape[-2:]) for array in (window, inputs, past))
        model, stride = self._at_sampling_time
        outputs = at_every_sample(as_predictor(model), stride).predict(window, past, inputs)
        self._warn_outside("inputs", inputs, self.input_names, self.card.get("input_range"), 1.0, self.input_unit)
        self._warn_outside("outputs", outputs, self.output_names, self.card.get("output_range"), 1e3, "mm")
        return outputs.reshape(*leading, horizon, -1)

    def _warn_outside(self, what: str, values: np.ndarray, names, seen, factor: float, unit: str) -> None:
        """Warn, once per call, about the quantity that leaves the training range most, if it is by more than `OUTSIDE`.
        """
        if seen is None or not values.size:
            return
        lowest, highest = np.array(seen, dtype=np.float64)
        span = np.maximum(highest - lowest, 1e-300)
        flat = values.reshape(-1, values.shape[-1])
        beyond = np.maximum((lowest - flat.min(0)) / span, (flat.max(0) - highest) / span)
        worst = int(np.argmax(beyond))
        if beyond[worst] > OUTSIDE:
            warnings.warn(f"{what} leave the training range: {names[worst]} is between "
                          f"{factor * flat[:, worst].min():.3g} and {factor * flat[:, worst].max():.3g} {unit}, in the "
                          f"training between {factor * lowest[worst]:.3g} and {factor * highest[worst]:.3g}. This "
                          "prediction is not reliable; train on recordings with this range", OutsideTraining,
                          stacklevel=3)

    @cached_property
    def _at_sampling_time(self) -> tuple[Model, int]:
        """The model with steps of the sampling time, and 1; or the unchanged model, and the number of samples per step.
        """
        if abs(self.timestep / self.sampling_time - 1.0) <= 1e-6:
            return self.reduced, 1
        try:
            return self.reduced.at_timestep(self.sampling_time), 1
        except ValueError:
            return self.reduced, whole_multiple("the model's timestep", self.timestep, "the recording's sampling time",
                                                self.sampling_time, "fit the model at a multiple of it")

    def _arguments(self, window, inputs, past_inputs) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """All three as (…, rows, columns) with the same leading dimensions."""
        delays, p, m = self.delays, self.reduced.output_dim, self.reduced.input_dim
        if past_inputs is None:
            if self.reduced.takes_past_inputs and delays:
                raise ValueError(f"the chart of this model needs the inputs held between the {delays + 1} samples of a "
                                 f"window; give past_inputs (…, {delays}, {m}), oldest first, with zeros while the "
                                 "robot was at rest")
            past_inputs = np.zeros((delays, m))
        apart = f"{self.window_timestep:g} s apart, newest last"
        found = [
            _array("window", window, delays + 1, p, f"samples of {sheet.listed(self.output_names)}, {apart}"),
            _array("inputs", inputs, None, m, f"{sheet.listed(self.input_names)}, held {self.sampling_time:g} s each"),
            _array("past_inputs", past_inputs, delays, m, "held between the samples of the window, oldest first")]
        batches = [array.shape[:-2] for array in found]
        try:
            leading = np.broadcast_shapes(*batches)
        except ValueError as error:
            raise ValueError(f"window, inputs and past_inputs have the leading shapes {batches}, which do not fit "
                             "together; expected equal leading shapes, or an array without one") from error
        window, inputs, past_inputs = (np.broadcast_to(array, leading + array.shape[-2:]) for array in found)
        return window, inputs, past_inputs

    def controller(self, task: Task | None = None, bounds: npt.ArrayLike | None = None,
                   **changes: Any) -> DesignedController:
        """The `DesignedController` in the artifact. Its commands are identical to those of the controller of the
        design.

        task: a task that tracks the same outputs; None: that of the design.   bounds: (2, m), further bounds of the
        robot for the commands; None: only those of the design.   changes: settings by name.
        Raises ValueError for an artifact without a controller, with the command to run, and for a task with other
        outputs.
        """
        from ssmr_torch.control.designed import designed_controller

        return designed_controller(self, task, bounds, **changes)

    def save(self, folder: str | Path) -> Path:
        """Write the artifact, which can run on a robot, completely or not at all. An artifact already there is
        replaced.

        Raises ValueError if the folder contains other files.
        """
        return self._save(folder)

    def export(self, folder: str | Path, *formats: str) -> list:
        """Write the artifact and programs of it, each checked against the model. Returns what was written.

        formats: "c" (C99), "onnx", "torch" (torch.export), "casadi"; they are written into the subfolder `deployed`.
        Raises ValueError for an unknown format, for one that this model does not support, for one whose packages are
        missing, and for a folder with other files. In all these cases nothing is written.
        """
        from ssmr_torch.deployment.exported_programs import deploy

        if not formats or not all(isinstance(format, str) for format in formats):
            raise ValueError('no formats were given by name; expected one or more, for example '
                             'export(folder, "c", "onnx")')
        forms: list = []
        self._save(folder, complete=lambda aside: forms.extend(deploy(aside, formats)))
        return forms

    def _save(self, folder: str | Path, **more) -> Path:
        card = self.card
        return artifact.save(folder, self.reduced, output_names=card["output_names"], input_names=card["input_names"],
                             rest=card["rest"], input_range=card["input_range"], input_unit=card["input_unit"],
                             name=card["name"], provenance=card.get("provenance"), scores=_finite(card.get("scores")),
                             cost=card.get("cost"), sampling_time=self.sampling_time,
                             output_range=card.get("output_range"), **more,
                             designed=None if self.designed is None else dict(self.designed))

    def data_sheet(self) -> tuple[str, dict]:
        model, said = self.reduced, self.card.get("provenance") or {}
        cost, scores = self.card.get("cost") or {}, self.scores
        entries = {
            "outputs": f"{sheet.listed(self.output_names)}; displacement from rest, m",
            "inputs: range of the training": sheet.spans(self.input_names, self.input_range[0], self.input_range[1],
                                                         sheet.unit_of(self.input_unit)),
            "window": f"{self.delays + 1} samples, {self.window_timestep:g} s apart; delays = {self.delays}",
            "step": sheet.period(self.timestep), "recordings": sheet.period(self.sampling_time),
            "stability": sheet.stability(model.rates)}
        if scores:
            entries["scores"] = {name: "∞" if value is None else f"{sheet.number(1e3 * value)} mm"
                                 for name, value in sorted(scores.items()) if "rmse" in name}
        if "decays" in cost:
            entries["trained on"] = (f"{cost['decays']:.0f} decays, {cost['controlled_samples']:.0f} samples of "
                                     "controlled runs")
        if self.designed:
            entries["controller"] = (f"tracks {sheet.listed(self.designed['tracked'])}; "
                                     f"{self.designed['facts'].get('tuned', 'by given settings')}")
        entries["rest"] = f"{sheet.listed(sheet.number(1e3 * x) for x in self.rest)} mm"
        made = sheet.origin(said.get("training") or said)
        sizes = f"{model.state_dim} states, {model.input_dim} inputs, {model.output_dim} outputs"
        return f"TrainedModel {self.name}: {sizes}", entries | sheet.origin(said.get("data") or {}) | made


def _array(what: str, given, rows: int | None, columns: int, meaning: str) -> np.ndarray:
    """An array (…, rows, columns); rows None means any number above 0. Raises ValueError for another shape, or for
    numbers that are not finite.
    """
    array = np.asarray(given, dtype=np.float64)
    fits = array.ndim >= 2 and array.shape[-1] == columns and array.shape[-2] == (rows if rows is not None
                                                                                  else array.shape[-2] or 1)
    if not fits:
        raise ValueError(f"{what} has shape {array.shape}; expected (…, {'H' if rows is None else rows}, {columns}): "
                         f"{meaning}")
    if not np.isfinite(array).all():
        raise ValueError(f"{what} contains numbers that are not finite; predict only from complete measurements")
    return array


def _finite(scores: Mapping | None) -> dict[str, float]:
    """Scores in the form that `artifact.save` takes: None becomes infinite."""
    return {name: np.inf if value is None else value for name, value in (scores or {}).items()}
