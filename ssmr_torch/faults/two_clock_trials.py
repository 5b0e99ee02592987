"""Outputs and inputs of a run in two files, each with a clock of its own."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ssmr_torch.faults.made_recordings import MadeRecordings
from ssmr_torch.faults.outcome import Expected
from ssmr_torch.faults.trial import Trials
from ssmr_torch.result_files import save_text

TRIALS = Trials()
KIND = "two clocks"


def parted(made: MadeRecordings, folder: Path, *, offset: float = 0.0, drift: float = 0.0, every: int = 12,
           scale: float = 1.0) -> None:
    """NAME.csv with t and the outputs, NAME_u.csv with t and the inputs at each `every`-th row.

    The clock of the inputs shows scale · ((1 + drift) t + offset).
    """
    for name, run in made.runs.items():
        rows = [",".join(f"{value:.8g}" for value in row) for row in np.column_stack([run.time, run.y])]
        save_text(folder / f"{name}.csv", "\n".join([",".join(["t", *made.observation]), *rows]) + "\n")
        stamps = scale * ((1 + drift) * run.time[::every] + offset)
        rows = [",".join(f"{value:.12g}" for value in row) for row in np.column_stack([stamps, run.u[::every]])]
        save_text(folder / f"{name}_u.csv", "\n".join([",".join(["t", *made.input]), *rows]) + "\n")
    del made.card["files"]
    made.card["pairs"] = [{"outputs": f"{name}.csv", "inputs": f"{name}_u.csv"} for name in made.runs]


def paired(made: MadeRecordings, folder: Path, case: str, card: dict | None = None, **expected) -> Expected:
    made.card |= card or {}
    made.write_card(folder)
    return Expected(case, **expected)


@TRIALS.of(KIND)
def of_one_time(made, rng, folder):
    parted(made, folder)
    return paired(made, folder, "commands at 8 Hz in a second file", refused=False, error=1.1, timestep=0.01)


@TRIALS.of(KIND)
def commands_between_the_samples(made, rng, folder):
    for name, run in made.runs.items():
        if not name.startswith("d"):
            run.u = np.repeat(run.u[::12], 12, axis=0)[:len(run)]
    parted(made, folder, offset=0.003)
    return paired(made, folder, "commands 3 ms after samples", refused=False, error=1.8, timestep=0.01)


@TRIALS.of(KIND)
def with_an_offset_that_is_said(made, rng, folder):
    offset = round(float(rng.uniform(0.03, 0.09)), 3)
    parted(made, folder, offset=offset)
    return paired(made, folder, f"the clock of the commands {1e3 * offset:.0f} ms ahead",
                  said=("lag|late|offset|clock",),
                  remedy=("lag|late|offset|clock",))


@TRIALS.of(KIND)
def with_an_offset_that_is_found(made, rng, folder):
    offset = round(float(rng.uniform(0.03, 0.12)), 3)
    parted(made, folder, offset=offset)
    return paired(made, folder, f"the clock of the commands {1e3 * offset:.0f} ms ahead, clock_offset: auto",
                  {"clock_offset": "auto"}, said=("offset|clock",), error=1.8, refused=False)


@TRIALS.of(KIND)
def with_an_offset_that_is_given(made, rng, folder):
    parted(made, folder, offset=0.25)
    return paired(made, folder, "the clock of the commands 250 ms ahead, clock_offset: -0.25", {"clock_offset": -0.25},
                  error=1.1, refused=False)


@TRIALS.of(KIND)
def of_two_days(made, rng, folder):
    parted(made, folder, offset=86400.0)
    return paired(made, folder, "the clock of the commands a day ahead", refused=True, remedy=("clock|offset|overlap",))


@TRIALS.of(KIND)
def a_file_of_the_pair_is_absent(made, rng, folder):
    parted(made, folder)
    made.card["pairs"][0]["inputs"] = "nowhere.csv"
    return paired(made, folder, "the file of the commands is absent", refused=True, remedy=("nowhere.csv",))
