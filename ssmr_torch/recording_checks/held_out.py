"""Check of the held-out runs: whether there are test runs, and whether they differ from the training runs."""

from __future__ import annotations

from ssmr_torch.recording_checks.context import Recorded
from ssmr_torch.recording_checks.finding import GOOD, LOOK, MISSING, Finding
from ssmr_torch.recording_faults.copies import equal_pairs, is_copied, shared_rows


def held_out(recorded: Recorded) -> Finding:
    """Whether there are test and validation runs, and none of them shares samples with the training runs."""
    subject, training = "held-out runs", recorded.training
    count = {split: len(recorded.of(split)) for split in ("train", "validation", "test")}
    for run in (*recorded.of("test"), *recorded.of("validation")):
        rows, name = shared_rows(run, training)
        if is_copied(run, rows):
            return Finding(subject, MISSING, f"{rows} of the {run.length} samples of the {run.split} run {run.name!r} "
                                             "are "
                           f"those of the training run {name!r}.", "A fit refuses this: record another run, or remove "
                           "these samples from the training runs.", {**count, "shared_samples": rows})
    twice = equal_pairs(training)
    numbers = {**count, "shared_samples": 0, "copies": len(twice)}
    if not count["test"]:
        return Finding(subject, MISSING, "0 test runs: no score can show how well the model predicts new data.",
                       "Record a run of 10 s with other inputs, and name it under split: {test: […]}.", numbers)
    if twice:
        return Finding(subject, LOOK, f"{len(twice)} pairs of training runs are copies; the first is {twice[0][0]!r} "
                                      "and "
                       f"{twice[0][1]!r}.", "Leave one of each pair out: a copy counts twice and tells "
                                            "nothing.", numbers)
    kinds = {run.kind for run in recorded.of("test")}
    if "controlled" not in kinds:
        return Finding(subject, LOOK, f"{count['test']} test runs, all of them decays.",
                       "Use a controlled run as test run as well: the score must show the effect of the inputs.",
                       numbers)
    return Finding(subject, GOOD, f"{count['test']} test and {count['validation']} validation runs; none shares "
                                  "samples "
                   "with the training.", "", numbers)
