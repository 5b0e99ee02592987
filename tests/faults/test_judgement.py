"""The judge of the campaign: it must be able to fail."""

import json
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from ssmr_torch.faults.campaign import RECORDINGS, ROOM, FaultsFound, campaign, lines_of
from ssmr_torch.faults.limited_work import LimitedWork, ProcessEnded, TookTooLong
from ssmr_torch.faults.made_recordings import Robot, made_recordings, small_recordings
from ssmr_torch.faults.outcome import Expected, Found, counts, refusal_faults
from ssmr_torch.faults.reading import judged
from ssmr_torch.lazy import found
from ssmr_torch.recording_faults.rules import FaultRules


@pytest.fixture
def small(tmp_path):
    made = small_recordings()
    made.card["faults"] = {"dead_columns": "keep"}
    return partial(judged, made.write(tmp_path), made)


def test_a_free_decay_of_the_made_robot_is_the_solution_of_its_equation():
    robot = Robot(modes=1, inputs=1, seed=3)
    A, _, C = robot.matrices()
    start, times = np.array([3.0, -1.0]), 0.01 * np.arange(50)
    decay, frequency = -A[0, 0], A[0, 1]
    spiral = (start[0] - 1j * start[1]) * np.exp((1j * frequency - decay) * times)
    turned = np.stack([spiral.real, -spiral.imag])
    positions = robot.positions(np.zeros((50, 1)), start)
    np.testing.assert_allclose(positions, (C @ turned).T + robot.rest, atol=1e-10)


def test_a_held_input_moves_the_made_robot_to_its_static_position():
    robot = Robot()
    A, B, C = robot.matrices()
    positions = robot.positions(np.tile([1.0, -0.5], (1000, 1)), np.zeros(4))
    np.testing.assert_allclose(positions[-1], robot.rest - C @ np.linalg.solve(A, B @ [1.0, -0.5]), atol=1e-4)


def test_a_copy_of_made_recordings_is_not_changed_by_a_fault_in_another():
    spoilt = made_recordings()
    spoilt.runs["c1"].y[:] = 0.0
    assert np.abs(made_recordings().runs["c1"].y).min() > 0


def test_recordings_that_are_read_as_expected_survive(small):
    outcome, said = small(Expected("m", samples={"m": 20}, values=(("m", 0, 19, 0.0019, 1e-9),), timestep=0.01))
    assert (outcome, said) == ("survived", "")


@pytest.mark.parametrize(("expected", "why"), [
    (Expected("m", samples={"m": 19}), "m has 20 samples, expected 19"),
    (Expected("m", values=(("m", 0, 19, 0.019, 1e-9),)), "expected 0.019 m"),
    (Expected("m", timestep=0.02), "expected 0.02 s"),
    (Expected("m", said=("row 7 of m",)), "the log lacks 'row 7 of m'"),
    (Expected("m", rows=(7777,)), "the log does not name row 7777"),
    (Expected("m", names=("n",)), "no run ['n']"),
    (Expected("m", refused=True), "should be refused")])
def test_what_is_read_otherwise_than_expected_is_wrong(small, expected, why):
    outcome, said = small(expected)
    assert outcome == "wrong" and why in said


@pytest.mark.parametrize(("expected", "outcome"), [
    (Expected("no file", refused=True, remedy=("m.csv",)), "refused"), (Expected("no file", refused=False), "wrong"),
    (Expected("no file", remedy=("another word",)), "wrong")])
def test_a_refusal_must_be_expected_and_say_the_remedy(tmp_path, expected, outcome):
    made = small_recordings()
    assert judged(made.write_card(tmp_path), made, expected)[0] == outcome


def test_an_error_that_is_no_refusal_is_a_traceback(tmp_path, monkeypatch):
    monkeypatch.setattr("ssmr_torch.faults.reading.custom", lambda card: [][0])
    made = small_recordings()
    assert judged(made.write(tmp_path), made, Expected("m")) == ("traceback", "IndexError: list index out of range")


def test_a_refusal_has_three_lines_at_most():
    assert refusal_faults("m.csv is empty; expected rows") == ""
    assert "4 lines" in refusal_faults("a\nb\nc\nd") and "500 letters" in refusal_faults("x" * 500)
    assert "says nothing" in refusal_faults(" ")


def test_an_outcome_must_be_one_of_the_seven():
    with pytest.raises(ValueError, match="outcome is 'fine'; expected one of refused, bridged"):
        Found("kind", "case", "fine")


def test_the_table_counts_each_outcome_of_each_kind_and_ends_with_the_sum():
    rows = [Found(kind, "case", outcome).row() for kind, outcome in (
        ("copies", "refused"), ("copies", "wrong"), ("drift", "bridged"), ("copies", "refused"))]
    table = counts(rows)
    assert [(row["kind"], row["trials"], row["refused"], row["bridged"], row["wrong"]) for row in table] == [
        ("copies", 3, 2, 0, 1), ("drift", 1, 0, 1, 0), ("all", 4, 2, 1, 1)]
    assert len({len(line) for line in lines_of(table)}) == 1


def test_a_call_that_takes_too_long_or_ends_its_process_is_told_apart():
    with LimitedWork() as work:
        assert work.call("math:sqrt", 60.0) == (False, "TypeError: math.sqrt() takes exactly one argument (0 given)")
        with pytest.raises(TookTooLong, match="after 0.5 s"):
            work.call("ssmr_torch.faults.limited_work:sleep", 0.5, seconds=60.0)
        with pytest.raises(ProcessEnded, match="the code 7"):
            work.call("os:_exit", 60.0, status=7)


def test_the_campaign_writes_every_trial_and_its_table(tmp_path, monkeypatch):
    monkeypatch.setattr("ssmr_torch.faults.campaign._jobs", lambda *given: iter([
        lambda: [Found("copies", "c4", "refused", "copies of c1").row()]]))
    table = campaign(tmp_path, {}, progress=False, provenance={"package": "ssmr_torch 0"}, say=lambda line: None)
    assert (tmp_path / "trials.csv").read_text().splitlines() == ["kind,case,outcome,said",
                                                                  "copies,c4,refused,copies of c1"]
    kept = json.loads((tmp_path / "faults.json").read_text())
    assert kept["rows"] == table and kept["provenance"] == {"package": "ssmr_torch 0"}
    assert (tmp_path / "faults.csv").read_text().startswith("kind,trials,refused,bridged,counted,survived,wrong")


def test_every_group_of_the_campaign_has_trials_or_work():
    for files in RECORDINGS.values():
        for file in files:
            assert len({(trial.kind, trial.name) for trial in found(f"{ROOM}.{file}:TRIALS")}) == len(
                found(f"{ROOM}.{file}:TRIALS")) > 5


def test_an_unknown_group_of_faults_is_refused():
    with pytest.raises(ValueError, match="only names 'clock'; the groups are clean, measurements, clocks"):
        campaign(Path("nowhere"), {}, only=("clock",))


def test_a_campaign_with_wrong_outcomes_says_how_many(tmp_path, monkeypatch):
    monkeypatch.setattr("ssmr_torch.faults.campaign._jobs", lambda *given: iter([
        lambda: [Found("copies", "c4", "wrong", "nothing was said").row()],
        lambda: [Found("copies", "c5", "refused").row()]]))
    with pytest.raises(FaultsFound, match="1 of 2 faults had a wrong outcome"):
        campaign(tmp_path, {}, progress=False, say=lambda line: None)


@pytest.mark.parametrize(("rows", "rule"), [(49, "keep"), (50, "refuse")])
def test_by_default_nothing_is_refused_by_comparison_where_no_run_has_fifty_rows(rows, rule):
    rules = FaultRules.of({"outliers": "refuse", "copies": "refuse"}, rows)
    assert rules.dead_columns == rules.moving_decays == rules.rest_position == rule
    assert rules.outliers == rules.copies == "refuse" and rules.drift == "keep", "what is given counts"
