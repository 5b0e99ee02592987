"""Runs that no fit sees, and whether they are any others than those of the training."""

from __future__ import annotations

from ssmr_torch.data.shared_samples import equal_pairs, is_copied, shared_rows
from ssmr_torch.recording_checks.context import Recorded
from ssmr_torch.recording_checks.finding import GOOD, LOOK, MISSING, Finding


def held_out(recorded: Recorded) -> Finding:
    """Whether there are test and validation runs, and none of them is in the training."""
    subject, training = "held-out runs", recorded.training
    count = {split: len(recorded.of(split)) for split in ("train", "validation", "test")}
    for run in (*recorded.of("test"), *recorded.of("validation")):
        rows, name = shared_rows(run, training)
        if is_copied(run, rows):
            return Finding(subject, MISSING, f"{rows} of the {run.length} samples of the {run.split} run {run.name!r} "
                                             "are "
                           f"those of the training run {name!r}.", "Fits refuse this: record another run, or leave "
                           "these samples out of the training.", {**count, "shared_samples": rows})
    twice = equal_pairs(training)
    numbers = {**count, "shared_samples": 0, "copies": len(twice)}
    if not count["test"]:
        return Finding(subject, MISSING, "0 test runs: no score would tell how the model does on what it has not seen.",
                       "Record a run of 10 s with other inputs and name it under split: {test: […]}.", numbers)
    if twice:
        return Finding(subject, LOOK, f"{len(twice)} pairs of training runs are copies, the first is {twice[0][0]!r} "
                                      "and "
                       f"{twice[0][1]!r}.", "Leave one of each pair out: a copy counts twice and tells "
                                            "nothing.", numbers)
    kinds = {run.kind for run in recorded.of("test")}
    if "controlled" not in kinds:
        return Finding(subject, LOOK, f"{count['test']} test runs, all of them decays.",
                       "Hold a controlled run out as well: the score is to tell how inputs act.", numbers)
    return Finding(subject, GOOD, f"{count['test']} test and {count['validation']} validation runs; none shares "
                                  "samples "
                   "with the training.", "", numbers)
