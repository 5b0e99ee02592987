"""The check finds faults, gives no warning about good recordings, and names a remedy."""

import json

import numpy as np
import pytest

import ssmr_torch as ssmr
from ssmr_torch.recording_checks.finding import Finding

SUBJECTS = {"faults", "decays", "range", "dither", "held-out runs", "noise", "sampling", "delay", "friction", "drift",
            "neutral input"}


def waves(rng, seconds, step):
    """One input goes slowly up and down, four seconds each way, the other more slowly."""
    time = step * np.arange(round(seconds / step)) + rng.uniform(0, 8)
    return np.column_stack([2 * np.sin(2 * np.pi * time / 8), np.sin(0.3 * time)])


def ramps(rng, seconds, step):
    """The same at constant speed."""
    return 2 / np.pi * np.arcsin(np.clip(waves(rng, seconds, step) / [2.0, 1.0], -1, 1)) * [2.0, 1.0]


def test_good_recordings_give_no_warning(robot):
    report = ssmr.check(robot())
    assert {finding.subject for finding in report.findings} == SUBJECTS
    assert report.counts() == {"good": 10, "warning": 0, "missing": 0, "unknown": 1}
    assert report["friction"].severity == "unknown"


@pytest.mark.parametrize(("changes", "subject", "severity"), [
    ({"decays": 0}, "decays", "missing"), ({"decays": 2}, "decays", "warning"),
    ({"duration": 0.6}, "decays", "warning"), ({"stretch": 3.0}, "range", "warning"),
    ({"controlled": 0, "test": False}, "range", "missing"), ({"controlled": 0, "test": False}, "dither", "missing"),
    ({"test": False}, "held-out runs", "missing"), ({"noise": 0.3}, "noise", "warning"),
    ({"step": 0.04, "seconds": 60.0, "duration": 6.0}, "sampling", "warning"), ({"late": 5}, "delay", "warning"),
    ({"late": -1}, "delay", "warning"), ({"drift": 10.0}, "drift", "warning"),
    ({"shift": 0.5}, "neutral input", "warning"),
    ({"inputs": waves, "loop": 4.0, "seconds": 60.0}, "friction", "warning"),
    ({"inputs": waves, "seconds": 60.0}, "friction", "good"), ({"inputs": ramps, "seconds": 60.0}, "friction", "good"),
    ({"inputs": waves, "seconds": 60.0}, "dither", "missing")])
def test_each_fault_is_found_under_its_subject(robot, changes, subject, severity):
    finding = ssmr.check(robot(**changes))[subject]
    assert finding.severity == severity, finding
    assert severity == "good" or finding.remedy.endswith(".")


def test_a_drift_is_measured_in_millimetres(robot):
    assert ssmr.check(robot(drift=10.0))["drift"].numbers["within_m"] == pytest.approx(0.010, rel=0.03)


def test_a_loop_is_as_wide_as_it_was_made(robot):
    numbers = ssmr.check(robot(inputs=waves, loop=4.0, seconds=60.0))["friction"].numbers
    assert max(numbers["widths_m"]) == pytest.approx(0.004, rel=0.15)


def test_at_one_speed_a_loop_is_found_and_may_be_a_lag(robot):
    finding = ssmr.check(robot(inputs=ramps, loop=4.0, seconds=60.0))["friction"]
    assert finding.severity == "warning" and "may be a lag" in finding.said


def test_the_neutral_input_is_the_one_that_was_subtracted(robot):
    numbers = ssmr.check(robot(shift=0.5))["neutral input"].numbers
    np.testing.assert_allclose(numbers["neutral_input"], [0.5, 0.5], rtol=0.05)
    assert numbers["signed_inputs"] == 2


def test_a_test_run_that_is_part_of_a_training_run_is_reported_with_its_samples(robot):
    data = robot()
    run = data.select("train", "controlled")[0]
    part = type(run)(run.time[:1200], run.observation[300:], run.input[300:], "controlled", "test", "part")
    finding = ssmr.check(ssmr.TrajectoryDataset([*data, part], data.rest, data.output_names, data.input_names, "1"))[
        "held-out runs"]
    assert finding.severity == "missing" and finding.numbers["shared_samples"] == 1200 and "'part'" in finding.said


def test_the_report_prints_one_line_for_each_subject_and_is_plain_in_json(robot):
    report = ssmr.check(robot(late=5))
    lines = str(report).splitlines()
    assert len(lines) == 1 + len(SUBJECTS) and "8 good, 2 warning, 0 missing, 1 unknown" in lines[0]
    assert "<table>" in report._repr_html_()
    assert json.loads(json.dumps(report.as_dict()))["delay"]["numbers"]["delay_s"] == pytest.approx(0.05, abs=0.011)
    with pytest.raises(KeyError, match="dither"):
        report["jitter"]


def test_the_figure_has_a_panel_for_each_subject_even_where_there_is_nothing_to_show(robot, tmp_path):
    for number, data in enumerate((robot(), robot(decays=0, controlled=1), robot(controlled=0, test=False))):
        [path] = ssmr.check(data).figures(tmp_path / str(number))
        assert path.stat().st_size > 5000


def test_a_finding_that_is_not_good_names_a_remedy():
    with pytest.raises(ValueError, match="has no remedy"):
        Finding("noise", "warning", "much noise.")
    with pytest.raises(ValueError, match="expected one of"):
        Finding("noise", "bad", "much noise.", "Less.")


def test_only_a_dataset_is_checked():
    with pytest.raises(TypeError, match="expected a TrajectoryDataset"):
        ssmr.check("robot.yaml")
