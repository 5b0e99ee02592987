"""A fitted model with what is known of its data: what `fit` gives, what an artifact holds, what predicts."""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path

import numpy as np

from ssmr_torch import data_sheet as sheet
from ssmr_torch.data_sheet import DataSheet
from ssmr_torch.deployment import artifact
from ssmr_torch.evaluation.predictors import as_predictor, at_every_sample
from ssmr_torch.models.base import Model
from ssmr_torch.periods import whole_multiple

OUTSIDE = 0.25  # of the range of the training, by which a prediction may leave it without a word


class OutsideTraining(UserWarning):
    """A prediction that leaves what the training explains."""


@dataclass(frozen=True, eq=False)
class TrainedModel(DataSheet):
    """z = v(window), z⁺ = f(z, u), y = w(z), with the names, units and ranges of the data behind it.

    reduced: the model as plain arrays, what controllers take. card: plain values: name, output_names, input_names,
    input_unit, rest (p,) m, input_range (2, m), sampling_time s, scores, cost, provenance. module: the torch.nn.Module
    that was fitted, None of an artifact. report: what determined each fit, empty of an artifact. designed: the
    controller that an artifact of `ssmr design` carries, as JSON; None without one, see `controller`.

    `ssmr_torch.fit` and `ssmr_torch.load` give one; see `predict`, `save` and `export`.

    >>> model                                                                                      # of an oscillator
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
        """The model of an artifact. Raises what `artifact.load` raises."""
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
        """(p,) absolute position that outputs are displacements from, m."""
        return np.array(self.card["rest"], dtype=np.float64)

    @property
    def input_range(self) -> np.ndarray:
        """(2, m) lowest and highest input of the training."""
        return np.array(self.card["input_range"], dtype=np.float64)

    @property
    def scores(self) -> dict[str, float]:
        """Open-loop errors of the validation and test runs at the fit, m, by name; infinite where one diverged."""
        return _finite(self.card.get("scores"))

    @property
    def delays(self) -> int:
        """Samples in a window beside the newest one."""
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
        """Sampling time of the recordings, s; of an artifact that does not tell, the window's."""
        return float(self.card.get("sampling_time") or self.window_timestep)

    def predict(self, window, inputs, past_inputs=None) -> np.ndarray:
        """Outputs at the next H instants of the recording's sampling:  y_k = w(f(… f(v(window), u_0) …, u_{k-1})).

        window (…, delays + 1, p): measured displacements from rest, m, newest last, `window_timestep` s apart.
        inputs (…, H, m): held one `sampling_time` each, from the newest sample on. past_inputs (…, delays, m): those
        held between the samples of the window; only models whose chart sees them need them. Leading dimensions are
        broadcast. Returns (…, H, p), m, infinite from where the model leaves its range.

        Where inputs or outputs leave what the training held by more than a quarter of its range, a warning says which
        and how far: the prediction is then a guess, though a bounded one.
        The model steps by the sampling time where it can. One that is coarser, fitted at a multiple of it, sees the
        mean of the inputs over each of its steps (the last one held to the end), and its outputs are interpolated
        linearly in between.
        Raises ValueError for arrays of another shape, numbers that are not finite, and missing past_inputs.
        """
        window, inputs, past = self._arguments(window, inputs, past_inputs)
        leading, horizon = inputs.shape[:-2], inputs.shape[-2]
        count = int(np.prod(leading))  # without delays there are no past inputs, whose size tells nothing
        window, inputs, past = (array.reshape(count, *array.shape[-2:]) for array in (window, inputs, past))
        model, stride = self._at_sampling_time
        outputs = at_every_sample(as_predictor(model), stride).predict(window, past, inputs)
        self._warn_outside("inputs", inputs, self.input_names, self.card.get("input_range"), 1.0, self.input_unit)
        self._warn_outside("outputs", outputs, self.output_names, self.card.get("output_range"), 1e3, "mm")
        return outputs.reshape(*leading, horizon, -1)

    def _warn_outside(self, what: str, values: np.ndarray, names, seen, factor: float, unit: str) -> None:
        """Say, once a call, what leaves the range of the training farthest, where it does by more than `OUTSIDE`."""
        if seen is None or not values.size:
            return
        lowest, highest = np.array(seen, dtype=np.float64)
        span = np.maximum(highest - lowest, 1e-300)
        flat = values.reshape(-1, values.shape[-1])
        beyond = np.maximum((lowest - flat.min(0)) / span, (flat.max(0) - highest) / span)
        worst = int(np.argmax(beyond))
        if beyond[worst] > OUTSIDE:
            warnings.warn(f"{what} leave the range of the training: {names[worst]} goes from "
                          f"{factor * flat[:, worst].min():.3g} to {factor * flat[:, worst].max():.3g} {unit}, the "
                          f"training from {factor * lowest[worst]:.3g} to {factor * highest[worst]:.3g}; do not trust "
                          "this prediction, or train on recordings that go as far", OutsideTraining, stacklevel=3)

    @cached_property
    def _at_sampling_time(self) -> tuple[Model, int]:
        """The model that steps by the sampling time, and 1; or as it is, and how many samples one of its steps covers.
        """
        if abs(self.timestep / self.sampling_time - 1.0) <= 1e-6:
            return self.reduced, 1
        try:
            return self.reduced.at_timestep(self.sampling_time), 1
        except ValueError:
            return self.reduced, whole_multiple("the model's timestep", self.timestep, "the recording's sampling time",
                                                self.sampling_time, "fit it at a multiple")

    def _arguments(self, window, inputs, past_inputs) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """All three as (…, rows, columns) with the same leading dimensions."""
        delays, p, m = self.delays, self.reduced.output_dim, self.reduced.input_dim
        if past_inputs is None:
            if self.reduced.takes_past_inputs and delays:
                raise ValueError(f"the chart of this model sees the inputs held between the {delays + 1} samples of a "
                                 f"window; give past_inputs (…, {delays}, {m}), oldest first, zeros where the robot "
                                 "was at rest")
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
            raise ValueError(f"window, inputs and past_inputs are batches of {batches}, which do not fit; expected "
                             "equal leading shapes, or none to share one") from error
        return tuple(np.broadcast_to(array, leading + array.shape[-2:]) for array in found)

    def controller(self, task=None, bounds=None, **changes):
        """The `DesignedController` that the artifact carries, which commands what the design's own would, bit by bit.

        task: one that tracks the same outputs; None: that of the design.   bounds: (2, m), of the robot, within which
        the commands stay as well; None: those of the design.   changes: of the settings, by name.
        Raises ValueError, saying what to run, for an artifact without one, and for a task of other outputs.
        """
        from ssmr_torch.control.designed import designed_controller

        return designed_controller(self, task, bounds, **changes)

    def save(self, folder: str | Path) -> Path:
        """Write the artifact that runs on a robot, whole or not at all; one already there is replaced.

        Raises ValueError where the folder holds other files.
        """
        return self._save(folder)

    def export(self, folder: str | Path, *formats: str) -> list:
        """Write the artifact with deployable forms of it, each checked against the model; returns what was written.

        formats: "c" (C99), "onnx", "torch" (torch.export), "casadi". They lie in the folder's subfolder `deployed`.
        Raises ValueError for a format that does not exist or that the model has not, one whose packages are missing,
        and a folder that holds other files; then nothing is written.
        """
        from ssmr_torch.deployment.deploy import deploy

        if not formats or not all(isinstance(format, str) for format in formats):
            raise ValueError('no formats were given, or not by name; expected some of them, such as '
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
                             output_range=card.get("output_range"), designed=self.designed, **more)

    def data_sheet(self) -> tuple[str, dict]:
        model, said = self.reduced, self.card.get("provenance") or {}
        cost, scores = self.card.get("cost") or {}, self.scores
        entries = {
            "outputs": f"{sheet.listed(self.output_names)}; displacement from rest, m",
            "inputs: range of the training": sheet.spans(self.input_names, *self.input_range,
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
    """(…, rows, columns), rows None for any number but none. Raises ValueError for other shapes, or not finite numbers.
    """
    array = np.asarray(given, dtype=np.float64)
    fits = array.ndim >= 2 and array.shape[-1] == columns and array.shape[-2] == (rows if rows is not None
                                                                                  else array.shape[-2] or 1)
    if not fits:
        raise ValueError(f"{what} has shape {array.shape}; expected (…, {'H' if rows is None else rows}, {columns}): "
                         f"{meaning}")
    if not np.isfinite(array).all():
        raise ValueError(f"{what} holds numbers that are not finite; predict from samples that were measured")
    return array


def _finite(scores: Mapping | None) -> dict[str, float]:
    """Scores as `artifact.save` takes them: what is unknown was infinite."""
    return {name: np.inf if value is None else value for name, value in (scores or {}).items()}
