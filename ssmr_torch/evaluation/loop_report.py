"""Report of a run in closed loop: errors, speed relative to the robot's modes, computing time, distance to bounds."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from ssmr_torch import data_sheet as sheet
from ssmr_torch.data_sheet import DataSheet
from ssmr_torch.evaluation.metrics import SETTLING_TIME, closed_loop_metrics

RESONANT = np.sqrt(0.5)  # damping ratio below which a mode has a resonance
AT_BOUND = 1e-3          # share of an input's range; an input nearer to a bound counts as at the bound


class BoundMargin(NamedTuple):
    """Smallest distance of an input to one of its bounds, in its unit, and the share of the samples at the bound."""

    input: str
    side: str
    distance: float
    share: float


@dataclass(frozen=True, eq=False)
class LoopReport(DataSheet):
    """metrics: from `closed_loop_metrics`.   share_of_reach: RMSE as a share of the reach, None if it is not known.
    speed: frequency of the reference as a fraction of the model's first natural frequency, see `reference_frequency`;
    None if the model has no resonance.   rate: control steps per s.   minutes: length of the recordings that the design
    used; tuned: who or what tuned the controller; None if the controller does not state them.
    decisions: number of control steps; late: number of those that took longer than the period.   counts: the
    controller's counters by name; None if it has none.   margins: one per input bound; () if bounds are not known.
    """

    task: str
    metrics: dict[str, float]
    share_of_reach: float | None
    speed: float | None
    rate: float
    minutes: float | None
    tuned: str | None
    decisions: int
    late: int
    counts: dict[str, int] | None
    margins: tuple[BoundMargin, ...]
    input_unit: str

    @property
    def gated(self) -> int | None:
        """Number of samples that were rejected as outliers."""
        return None if self.counts is None else self.counts.get("gated", 0)

    @property
    def facts(self) -> dict:
        """Plain values for JSON: the metrics and all other fields."""
        return self.metrics | {
            "share_of_reach": self.share_of_reach, "speed": self.speed, "control_rate": self.rate,
            "minutes": self.minutes, "tuned": self.tuned, "late": self.late, "gated": self.gated,
            "counts": self.counts, "margins": [margin._asdict() for margin in self.margins]}

    def data_sheet(self) -> tuple[str, dict]:
        found, unit = self.metrics, sheet.unit_of(self.input_unit)
        share = "" if self.share_of_reach is None else f", {sheet.number(100 * self.share_of_reach)} % of the reach"
        speed = "not known" if self.speed is None else f"{sheet.number(self.speed)} of the first natural frequency"
        counted = {name: count for name, count in (self.counts or {}).items() if name != "gated"}
        return f"Closed loop {self.task!r}", {
            "RMSE": f"{sheet.number(1e3 * found['rmse'])} mm{share}; ISE {sheet.number(1e6 * found['ise'], 4)} mm²",
            "speed of the reference": speed,
            "control": f"{sheet.number(self.rate)} Hz; {self.late} of {self.decisions} steps longer than the period",
            "tuned": self.tuned or "not told",
            "recordings used": "not known" if self.minutes is None else f"{sheet.number(self.minutes)} min",
            "fallbacks": f"{found['fallbacks']:.0f} of {self.decisions} decisions",
            "gated samples": "not counted" if self.gated is None else str(self.gated),
            "counted": ", ".join(f"{count} {name}" for name, count in sorted(counted.items())) or "nothing else",
            "bounds": {f"{margin.input}, {margin.side}": _distance(margin, unit) for margin in self.margins}
            or "not known"}


def _distance(margin: BoundMargin, unit: str) -> str:
    if margin.share:
        return f"at the bound {sheet.number(100 * margin.share)} % of the time"
    return f"never nearer than {sheet.number(margin.distance)} {unit}".rstrip()


def loop_report(record, obstacles=()) -> LoopReport:
    """The report of a `ClosedLoopRecord`; values that its provenance does not contain are None.

    obstacles: as in `closed_loop_metrics`. Raises the same errors as that function.
    """
    said, metrics = record.provenance, closed_loop_metrics(record, obstacles)
    times = record.solve_time[np.isfinite(record.solve_time)]
    reach, natural = said.get("reach"), said.get("natural_frequency")
    speed = reference_frequency(record.time, record.reference) / natural if natural else None
    return LoopReport(
        said.get("task", "path"), metrics, metrics["rmse"] / reach if reach else None, speed, 1.0 / said["period"],
        said.get("minutes"), said.get("tuned"), len(times), int((times > said["period"]).sum()), said.get("counts"),
        bound_margins(record.input, said["input_bounds"], record.input_names) if said.get("input_bounds") else (),
        record.input_unit)


def bound_margins(inputs: np.ndarray, bounds, names) -> tuple[BoundMargin, ...]:
    """Margins of inputs (T, m) to bounds (2, m): to the lower and to the upper bound of every input."""
    found = []
    for name, column, (lowest, highest) in zip(names, np.asarray(inputs).T, np.asarray(bounds, dtype=np.float64).T):
        for side, distance in (("lowest", column - lowest), ("highest", highest - column)):
            at = distance <= AT_BOUND * (highest - lowest)
            found.append(BoundMargin(name, side, float(max(distance.min(), 0.0)), float(at.mean())))
    return tuple(found)


def reference_frequency(time: np.ndarray, reference: np.ndarray) -> float:
    """ω = √(Σ ‖ṙ‖² / Σ ‖r − r̄‖²), rad/s, of references (T, q), m, after the settling time.

    For a circle or a sine it is their frequency; for a point it is zero.
    """
    time, reference = np.asarray(time), np.asarray(reference)
    if time[-1] - time[0] > 2 * SETTLING_TIME:
        reference, time = reference[time - time[0] >= SETTLING_TIME], time[time - time[0] >= SETTLING_TIME]
    around = np.square(reference - reference.mean(axis=0)).sum(axis=1).mean()
    rate = np.square(np.diff(reference, axis=0) / np.diff(time)[:, None]).sum(axis=1).mean()
    return float(np.sqrt(rate / around)) if around > 0 else 0.0


def natural_frequency(rates: Iterable[complex]) -> float | None:
    """The lowest |λ|, rad/s, of the resonant pairs among eigenvalues λ, 1/s: pairs with a damping ratio below √½.

    None if there is no resonance, for example for an overdamped robot.
    """
    found = [abs(rate) for rate in map(complex, rates)
             if np.isfinite(rate) and abs(rate.imag) > 1e-9 and -rate.real < RESONANT * abs(rate)]
    return float(min(found)) if found else None
