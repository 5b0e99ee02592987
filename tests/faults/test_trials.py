"""What `ssmr faults` injects: every trial of text, cards and containers, and some of the others."""

import pytest

from ssmr_torch.faults.campaign import ROOM
from ssmr_torch.faults.damaged_files import flips
from ssmr_torch.faults.garbage_control import steps
from ssmr_torch.faults.hostile_frames import frames
from ssmr_torch.lazy import found

FAST = ("dialect_trials", "card_trials", "container_trials", "tool_trials")
SLOW = ("measurement_trials", "level_trials", "missing_row_trials", "clock_trials", "two_clock_trials", "clean_trials")
EVERY = 16  # of these, which take a fit each, one in so many
FITTED = "inside the last number"


def trials(files, every=1, fitted=False):
    for file in files:
        for trial in found(f"{ROOM}.{file}:TRIALS")[::every]:
            if fitted == (trial.name == FITTED) or every > 1:
                yield pytest.param(trial, id=f"{trial.kind}: {trial.name}")


@pytest.mark.parametrize("trial", list(trials(FAST)))
def test_a_fault_in_a_file_or_a_card_has_its_right_answer(trial, tmp_path):
    outcome = trial.run(tmp_path, seed=0)
    assert outcome.good, outcome.said


@pytest.mark.slow
@pytest.mark.parametrize("trial", [*trials(SLOW, EVERY), *trials(FAST, fitted=True)])
def test_a_fault_in_measurements_or_clocks_has_its_right_answer(trial, tmp_path):
    outcome = trial.run(tmp_path, seed=0)
    assert outcome.good, outcome.said


@pytest.mark.slow
def test_damaged_files_are_refused_or_load_as_what_they_were():
    wrong = [row for row in flips(84) if row["outcome"] not in ("refused", "survived")]
    assert wrong == []


@pytest.mark.slow
def test_hostile_frames_are_counted_and_an_honest_robot_gets_its_commands():
    row, = frames(2000)
    assert row["outcome"] == "counted", row["said"]


@pytest.mark.slow
def test_no_exception_leaves_a_controller_and_every_input_is_within_its_bounds():
    found_rows = steps(200)
    assert len(found_rows) == 4 and {row["outcome"] for row in found_rows} == {"survived"}, found_rows
