"""The closed-loop record: all samples of one run in closed loop, and their file."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from ssmr_torch import checksum
from ssmr_torch import data_sheet as sheet
from ssmr_torch.data_sheet import DataSheet
from ssmr_torch.evaluation.loop_report import LoopReport, loop_report, natural_frequency
from ssmr_torch.evaluation.metrics import SETTLING_TIME, max_tracking_error, tracking_rmse

ARRAYS = ("time", "reference", "observation", "measurement", "input", "fallback", "solve_time", "iterations",
          "violation")
FORMAT = "ssmr_torch closed loop 2"
BEFORE = "ssmr_torch closed loop 1"  # of versions up to 0.11, without a checksum
LONGEST_STATUS = 100  # characters


@dataclass(frozen=True, eq=False)
class ClosedLoopRecord(DataSheet):
    """One run in closed loop, T samples.

    time: (T,) s.   reference: (T, q) m, for the outputs `tracked`.   observation: (T, p) m, the true outputs of the
    plant.   measurement: (T, p) m, what the controller measured, NaN where a sample was missing.   input: (T, m), the
    command from time[k] to time[k+1].   fallback: (T,), whether the controller fell back.   statuses: (T,), names of
    the Status, empty at samples without a decision.   solve_time: (T,) s of CPU time for the decision, which other
    work on the computer does not lengthen.   iterations: (T,), number of programs solved. At samples that hold an
    input, solve_time is NaN and iterations is 0.   violation: (T,) m, the largest violation of a constraint in the
    plan, with margins; NaN where there was no plan with constraints, and in old records without this column.
    """

    time: np.ndarray
    reference: np.ndarray
    observation: np.ndarray
    measurement: np.ndarray
    input: np.ndarray
    fallback: np.ndarray
    solve_time: np.ndarray
    iterations: np.ndarray
    statuses: tuple[str, ...]
    tracked: tuple[int, ...]
    output_names: tuple[str, ...]
    input_names: tuple[str, ...]
    input_unit: str = "N"
    provenance: dict = field(default_factory=dict)
    violation: np.ndarray | None = None

    def __post_init__(self):
        if self.violation is None:
            object.__setattr__(self, "violation", np.full(len(self.time), np.nan))
        for name in ("statuses", "tracked", "output_names", "input_names"):
            object.__setattr__(self, name, tuple(getattr(self, name)))
        lengths = {name: len(getattr(self, name)) for name in (*ARRAYS, "statuses")}
        if len(set(lengths.values())) != 1:
            raise ValueError(f"a record needs the same number of samples everywhere; got {lengths}")

    @property
    def error(self) -> np.ndarray:
        """Observation minus reference in the tracked columns, (T, q) m."""
        return self.observation[:, list(self.tracked)] - self.reference

    def data_sheet(self) -> tuple[str, dict]:
        said, times = self.provenance, self.solve_time[np.isfinite(self.solve_time)]
        name = f" of {said['task']!r}" if said.get("task") else ""
        tracked = sheet.listed(self.output_names[column] for column in self.tracked)
        entries: dict[str, object] = {
            "tracked": f"{tracked}; {self._errors()}",
            "samples": f"{len(self.time)}, {sheet.period(self.time[1] - self.time[0])}"}
        if "period" in said:
            entries["control"] = f"{said.get('controller', 'controller')}, {sheet.period(said['period'])}"
        entries["fallbacks"] = f"{int(self.fallback.sum())} of {len(times)} decisions"
        entries["inputs"] = sheet.spans(self.input_names, self.input.min(axis=0), self.input.max(axis=0),
                                        sheet.unit_of(self.input_unit))
        if "tuned" in said:
            entries["tuned"] = said["tuned"]
        if "noise_std" in said:
            entries["noise"] = f"{sheet.number(1e3 * said['noise_std'])} mm, seed {said['seed']}"
        return f"ClosedLoopRecord{name}: {sheet.number(self.time[-1] - self.time[0])} s", entries | sheet.origin(said)

    def report(self, obstacles: Sequence = ()) -> LoopReport:
        """Everything that ssmr control prints about the run; obstacles: those of the task."""
        return loop_report(self, obstacles)

    def _errors(self) -> str:
        if not np.isfinite(self.error).all():
            return "not finite until the end"
        settling = SETTLING_TIME if self.time[-1] - self.time[0] > SETTLING_TIME else 0.0
        measured = self.time, self.observation[:, list(self.tracked)], self.reference
        rmse, largest = (sheet.number(1e3 * error(*measured, settling_time=settling))
                         for error in (tracking_rmse, max_tracking_error))
        return f"RMSE {rmse} mm, at most {largest} mm" + (f" after {settling:g} s" if settling else "")

    def save(self, path: str | Path) -> Path:
        """Write one HDF5 file. The file appears only when it is complete."""
        import h5py

        from ssmr_torch.hdf5_file import new_hdf5

        card = {"format": FORMAT, "length_unit": "m", "time_unit": "s", "input_unit": self.input_unit,
                "tracked": self.tracked, "output_names": self.output_names, "input_names": self.input_names,
                "provenance": self.provenance}
        size = 2 * sum(getattr(self, name).nbytes for name in ARRAYS) + 2 ** 20
        with new_hdf5(path, size, sealed=True) as file:
            file.attrs["card"] = json.dumps(card)
            for name in ARRAYS:
                file[name] = getattr(self, name)
            file.create_dataset("statuses", data=list(self.statuses), dtype=h5py.string_dtype())
        return Path(path)

    @classmethod
    def load(cls, path: str | Path) -> ClosedLoopRecord:
        """Read a file written by `save`. Raises FileNotFoundError, ValueError for another kind of file, and
        `checksum.Damaged`, which is one, for a damaged file.
        """
        path = Path(path)
        if not path.is_file():
            raise FileNotFoundError(f"no closed-loop record at {path}; make one with ssmr control")
        try:
            return cls(**_stored(path, checksum.check(path) is not None))
        except (KeyError, AttributeError, TypeError, IndexError, OSError, RuntimeError) as error:
            raise checksum.Damaged(f"{path} is damaged ({error}); record the run again") from error


def _stored(path: Path, sealed: bool) -> dict:
    """The fields of the record in a file. Raises ValueError for values that no record has."""
    from ssmr_torch.hdf5_file import card_of, open_hdf5

    with open_hdf5(path) as file:
        card = card_of(file, path) if "card" in file.attrs else {}
        if card.get("format") not in (FORMAT, BEFORE):
            raise ValueError(f"{path} is of format {card.get('format')!r}; expected {FORMAT!r} or {BEFORE!r}")
        checksum.refuse_unsealed(path, sealed, card["format"], BEFORE)
        fields = {name: card[name] for name in ("tracked", "output_names", "input_names", "input_unit", "provenance")}
        fields |= {name: file[name][:] for name in ARRAYS if name in file or name != "violation"}
        # some at a time, because each of them may be as long as the file
        texts, piece = file["statuses"].asstr(), max(1, min(4096, 2 ** 26 // path.stat().st_size))
        statuses = [status for start in range(0, len(texts), piece) for status in _short(texts[start:start + piece])]
    samples, p, m = len(fields["time"]), len(fields["output_names"]), len(fields["input_names"])
    shapes = {name: (samples,) for name in ARRAYS} | {
        "reference": (samples, len(fields["tracked"])), "observation": (samples, p), "measurement": (samples, p),
        "input": (samples, m)}
    wrong = [f"{name} has the shape {fields[name].shape} and the type {fields[name].dtype}"
             for name, shape in shapes.items() if name in fields
             and (fields[name].shape != shape or fields[name].dtype.kind not in "fiub")]
    wrong += [f"{name} is not finite" for name in ("time", "reference", "input")
              if not wrong and not np.isfinite(fields[name]).all()]
    wrong += [f"the tracked columns are {fields['tracked']} of {p} outputs"
              for column in fields["tracked"] if not (isinstance(column, int) and 0 <= column < p)]
    if wrong or samples < 1 or (np.diff(fields["time"]) <= 0).any():
        raise checksum.Damaged(f"{path}: {(wrong or ['time does not increase'])[0]}; record the run again")
    return fields | {"statuses": statuses}


def _short(statuses) -> list[str]:
    if any(len(status) > LONGEST_STATUS for status in statuses):
        raise ValueError(f"a status of more than {LONGEST_STATUS} characters; record the run again")
    return list(statuses)


def told_by(controller) -> dict:
    """What a controller reports about itself and its run: how it was tuned, minutes of recordings, reach in m, first
    natural frequency of its model in rad/s, and its counts. What the controller does not report is left out.
    """
    facts, model = getattr(controller, "facts", {}), getattr(controller, "model", None)
    told = {name: facts[name] for name in ("tuned", "minutes", "reach") if facts.get(name) is not None}
    rates = getattr(model, "rates", None)
    if rates is not None:
        told["natural_frequency"] = natural_frequency(rates)
    if hasattr(controller, "counts"):
        told["counts"] = {str(name): int(count) for name, count in controller.counts.items() if count}
    return told


def planned_violations(commands) -> np.ndarray:
    """(T,) m, the column `violation` of `ClosedLoopRecord`."""
    return np.array([getattr(command.plan, "violation", np.nan) for command in commands])
