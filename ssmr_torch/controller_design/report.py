"""The report of a design: its findings and reasons as sentences, plain values and figures."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ssmr_torch import data_sheet as sheet
from ssmr_torch.controller_design.identification import Identification, in_words
from ssmr_torch.controller_design.model_choice import ChosenModel
from ssmr_torch.controller_design.noises import Likelihood, Noises
from ssmr_torch.controller_design.recordings import Recordings
from ssmr_torch.controller_design.weights import PEAK, WeightSearch
from ssmr_torch.data_sheet import DataSheet
from ssmr_torch.result_files import save_text


@dataclass(frozen=True, eq=False)
class DesignReport(DataSheet):
    """All findings of a design. seconds: how long it took.

    `sentences` gives them in words, `facts` as plain values; `save(folder)` writes both with figures.
    """

    recordings: Recordings
    identification: Identification
    model: ChosenModel
    noises: Noises
    search: WeightSearch
    likelihood: Likelihood
    task: str
    seconds: float

    @property
    def facts(self) -> dict:
        """The findings as plain JSON values."""
        best, found, recordings = self.search.best, self.identification, self.recordings
        return {
            "tuned": f"designed from {recordings.minutes:.2g} min of recordings", "task": self.task,
            "reach": recordings.reach, "minutes": recordings.minutes,
            "actuator": self.identification.actuator.plain(), "actuator_error": _finite(found.error),
            "commands_error": _finite(found.plain), "model": self.model.words, "model_error": _finite(self.model.error),
            "twin": self.model.twin_words, "twin_error": _finite(self.model.twin_error),
            "noises": {"inputs": self.noises.inputs, "states": self.noises.states,
                       "disturbance": self.noises.disturbance, "sensor": self.noises.sensor},
            "designs": {"count": self.search.count, "stable": self.search.stable, "safe": self.search.safe,
                        "extra_delay": self.search.extra * recordings.timestep, "judged_by": self.search.judged_by},
            "weights": {"horizon": best.weights.horizon, "tolerance": best.weights.tolerance,
                        "input": best.weights.input, "move": best.weights.move, "observer": list(best.factors)},
            "margins": {name: _finite(value) for name, value in vars(best.margins).items()},
            "predicted_error": _finite(best.predicted),
            "against_twin": {name: _finite(value) for name, value in best.against_twin.items()},
            "seconds": self.seconds}

    @property
    def sentences(self) -> list[str]:
        """The findings, the decisions that follow from them, and what the recordings do not show."""
        best, found, search, reach = self.search.best, self.identification, self.search, self.recordings.reach
        mm = 1e3 * reach
        lines = [f"The actuators: {in_words(found.actuator)}."]
        if np.isfinite(found.error) and found.actuator.trivial:
            lines.append(f"A cheap model has an error of {100 * found.error:.3g} % of the reach on held-out runs. No "
                         "actuator was found that improves both this model and the best of all models.")
        elif np.isfinite(found.error):
            lines.append(f"With them a cheap model has an error of {100 * found.error:.3g} % of the reach on held-out "
                         f"runs, without them {100 * found.plain:.3g} %.")
        lines += [f"The model: {self.model.words}. Its error on held-out runs is {100 * self.model.error:.3g} % of the "
                  f"reach ({mm * self.model.error:.3g} mm), the mean over 1 to 20 samples.",
                  f"The noise of the sensors is {mm * self.noises.sensor:.3g} mm.",
                  f"{search.stable} of {search.count} designs are stable along the recordings. {search.safe} keep all "
                  f"margins: {1e3 * search.extra * self.recordings.timestep:g} ms more delay, half and twice the gain, "
                  f"a sensitivity of {PEAK:g}."]
        if not search.safe:
            lines.append("No design keeps all margins; the most robust one was taken. Expect calm motion, but not "
                         "accurate tracking. Recordings with more dither may help.")
        if search.judged_by == "margins":
            lines.append("Every loop against the twin was lost, so the designs were ranked by their margins alone.")
        lines.append(f"Predicted tracking error: {100 * best.predicted:.3g} % of the reach, "
                     f"{mm * best.predicted:.3g} mm.")
        lost = [name for name, error in best.against_twin.items() if not np.isfinite(error)]
        if lost:
            lines.append(f"Against the twin the loop was lost with: {', '.join(lost)}.")
        return lines

    def data_sheet(self) -> tuple[str, dict]:
        best, mm = self.search.best, 1e3 * self.recordings.reach
        twin = {name: "lost" if not np.isfinite(error) else f"{100 * error:.3g} % of the reach, {mm * error:.3g} mm"
                for name, error in best.against_twin.items()}
        minutes = f"{self.recordings.minutes:.2g} min of recordings"
        return f"DesignReport for {self.task!r}: {self.seconds:.0f} s, {minutes}", {
            "actuator": in_words(self.identification.actuator), "model": self.model.words,
            "held-out error": f"{100 * self.model.error:.3g} % of the reach of {mm:.4g} mm",
            "noise of the sensors": f"{sheet.number(mm * self.noises.sensor)} mm",
            "designs": f"{self.search.stable} of {self.search.count} stable, {self.search.safe} with all margins",
            "weights": f"move {best.weights.move:g}, observer × {', '.join(f'{each:g}' for each in best.factors)}",
            "margins": ", ".join(f"{name} {value:.3g}" for name, value in vars(best.margins).items()),
            "predicted error": f"{100 * best.predicted:.3g} % of the reach",
            "against the twin": twin or "not tried"}

    def save(self, folder: str | Path, *, figures: bool = True) -> Path:
        """Write design.json, design.md and the figures. Each file appears only when it is complete."""
        folder, pictures = Path(folder), []
        folder.mkdir(parents=True, exist_ok=True)
        if figures:
            from ssmr_torch.evaluation.design_figures import draw

            pictures = draw(self, folder)
        text = "\n\n".join([f"# Design for {self.task}", "```\n" + repr(self) + "\n```", *self.sentences,
                            *(f"![{path.stem}]({path.name})" for path in pictures)])
        for name, content in (("design.json", json.dumps(self.facts, indent=2, allow_nan=False)), ("design.md", text)):
            save_text(folder / name, content + "\n")
        return folder


def _finite(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None
