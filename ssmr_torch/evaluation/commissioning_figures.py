"""Figures of a commissioning: the robot's step responses, and the circles that it drew.

Arguments are in SI units; the axes show mm and s.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure

from ssmr_torch.evaluation.figures import MM, MS, WIDTH, panels, styled

INK, REFERENCE, REST = "#0072B2", "#000000", "#B0B0B0"


@styled
def steps(answers: Sequence, output_names: Sequence[str]) -> Figure:
    """One panel per input: the step response of the outputs per unit of input, and a line at the delay. The output that
    moves most is in colour.

    answers: from `ssmr_torch.commissioning.steps`.
    """
    columns = min(4, len(answers))
    rows = -(-len(answers) // columns)
    figure, grid = panels(WIDTH, 1.7 * rows, rows, columns)
    places = list(np.ravel(grid))
    for axes, answer in zip(places, answers):
        time, trace = np.array(answer.time_s), MM * np.array(answer.trace_m) / answer.size
        most = int(np.argmax(np.abs(answer.moved_m)))
        axes.plot(time, trace, color=REST, linewidth=0.7)
        axes.plot(time, trace[:, most], color=INK)
        if answer.delay_s is not None:
            axes.axvline(answer.delay_s, color=REFERENCE, linewidth=0.7, linestyle=":")
        late = "dead" if answer.output is None else f"{output_names[most]}"
        late += "" if answer.delay_s is None else f", {MS * answer.delay_s:.3g} ms"
        axes.set_title(f"{answer.input}: {late}", loc="left")
        axes.set(xlabel="time (s)", ylabel="mm per unit")
    for axes in places[len(answers):]:
        axes.set_axis_off()
    return figure


@styled
def circles(records: Sequence) -> Figure:
    """One panel per `ClosedLoopRecord`: the reference (dashed) and the path of the robot."""
    figure, grid = panels(WIDTH, 3.2, 1, len(records))
    for axes, record in zip(np.ravel(grid), records):
        path = MM * record.observation[:, list(record.tracked)]
        reference = MM * record.reference
        axes.plot(*reference.T, color=REFERENCE, linestyle="--", linewidth=0.8, label="reference")
        axes.plot(*path.T, color=INK, linewidth=0.9, label="robot")
        names = [record.output_names[column] for column in record.tracked]
        axes.set(xlabel=f"{names[0]} (mm)", ylabel=f"{names[1]} (mm)", aspect="equal")
        axes.set_title(record.provenance.get("task", ""), loc="left")
    figure.legend(*axes.get_legend_handles_labels(), loc="outside upper center", ncols=2)
    return figure
