"""Faults that only a comparison of recordings shows: rest, units, dead columns, whole runs, drift, decays, copies."""

from dataclasses import replace

import numpy as np
import pytest

from ssmr_torch.recording_faults.copies import without_copies
from ssmr_torch.recording_faults.mending import compared
from ssmr_torch.recording_faults.moving_decays import moving_decays
from ssmr_torch.recording_faults.rules import FaultRules
from ssmr_torch.trajectory import Trajectory, TrajectoryDataset


def said(recordings):
    return [str(note) for each in recordings for note in each.notes]


def test_sound_recordings_are_returned_as_they_are(rig, two_markers):
    for each in (rig, two_markers):
        assert all(one is other for one, other in zip(each.recordings, compared(each.recordings, each.rest)))


@pytest.mark.parametrize(("rest", "away"), [([0, 0, 0], "120 mm in z"), ([5, -3, -120], "240 mm in z"),
                                            ([5, -3, 105], "15 mm in z"), ([-25, -3, 120], "30 mm in x")])
def test_a_rest_position_far_from_the_ends_of_the_decays_is_refused_with_the_right_one(rig, rest, away):
    with pytest.raises(ValueError, match=rf"decays end {away} from the rest position.*rest should be \[.*12\d.*\] mm"):
        compared(rig.recordings, 1e-3 * np.array(rest, dtype=float))


def test_absolute_positions_that_are_called_centred_are_refused(rig):
    centred = [replace(each, centred=each.kind == "decay") for each in rig.recordings]
    with pytest.raises(ValueError, match="end 120 mm from zero.*subtract the rest position"):
        compared(centred, rig.rest)


def test_a_decay_that_ends_elsewhere_is_named(rig):
    rig.shift("d6", [0, 0, 15e-3])
    with pytest.raises(ValueError, match="^d6: it ends 15 mm in z from where the other decays end"):
        compared(rig.recordings, rig.rest)
    kept = compared(rig.recordings, rig.rest, FaultRules(rest_position="keep"))
    assert len(said(kept)) == 1 and said(kept)[0].startswith("d6: it ends 15 mm in z")


def test_decays_that_still_move_give_no_rest_position_but_may_be_fitted(rig):
    for name in ("d1", "d2", "d3", "d4", "d5", "d6"):
        run = rig.runs[name]
        rig.runs[name] = replace(run, time=run.time[:40], observation=run.observation[:40], input=run.input[:40],
                                 rows=None)
    rest = np.median([rig.runs[name].observation[-1] for name in ("d1", "d2", "d3", "d4", "d5", "d6")], axis=0)
    with pytest.raises(ValueError, match="still moves at its end, with .* mm/s.*ends lie .* mm apart"):
        compared(rig.recordings, rest, rest_from_decays=True)
    assert said(compared(rig.recordings, rig.rest)) == []


@pytest.mark.parametrize(("centred", "factor", "match"), [
    (False, 0.1, "c1: it lies 1.. mm from the others"), (True, 0.1, "c1: its inputs move it a tenth as much"),
    (True, 100.0, "c1: its inputs move it (99.*|100|101) times as much")])
def test_a_file_in_another_unit_is_named(rig, centred, factor, match):
    if centred:
        rig.runs = {name: replace(run, observation=run.observation - rig.rest, centred=True)
                    for name, run in rig.runs.items()}
    rig.change("c1", slice(None), factor * rig.runs["c1"].observation)
    with pytest.raises(ValueError, match=f"^{match}.*another unit"):
        compared(rig.recordings, rig.rest)


def test_inputs_of_one_file_in_another_unit_are_named_as_inputs(rig):
    rig.runs["c2"] = replace(rig.runs["c2"], input=1e-3 * rig.runs["c2"].input)
    with pytest.raises(ValueError, match="^c2: its inputs move it .* are its inputs in another unit"):
        compared(rig.recordings, rig.rest)


def test_a_column_in_another_unit_is_named(rig):
    for name in rig.runs:
        rig.change(name, slice(None), 1e-3 * rig.runs[name].observation[:, 2], 2)
    with pytest.raises(ValueError, match="^z moves by .* times less than the largest column: is it in another unit"):
        compared(rig.recordings, rig.rest * [1, 1, 1e-3])


def test_a_column_that_is_dead_in_one_run_is_refused(rig):
    rig.change("c2", slice(None), 0.12, 2)
    with pytest.raises(ValueError, match="^c2: z never moves in this run, but in others"):
        compared(rig.recordings, rig.rest)
    assert said(compared(rig.recordings, rig.rest, FaultRules(dead_columns="keep")))


def test_a_column_that_is_dead_in_all_runs_is_refused(rig):
    for name in rig.runs:
        rig.change(name, slice(None), 0.12, 2)
    with pytest.raises(ValueError, match="^z never moves in any run"):
        compared(rig.recordings, rig.rest)
    text, = said(compared(rig.recordings, rig.rest, FaultRules(dead_columns="keep")))
    assert "z never moves in any run" in text


def test_markers_exchanged_in_a_whole_run_are_refused_or_exchanged_back(two_markers):
    true = two_markers.runs["c1"].observation.copy()
    two_markers.change("c1", slice(None), true[:, [3, 4, 5, 0, 1, 2]])
    with pytest.raises(ValueError, match="^c1: the markers a and b are exchanged in the whole run"):
        compared(two_markers.recordings, two_markers.rest)
    back = compared(two_markers.recordings, two_markers.rest, FaultRules(exchanged_markers="correct"))
    np.testing.assert_array_equal(back[6].observation, true)


def test_a_drift_of_10_mm_in_15_s_is_said_and_removed_to_a_twentieth(rig):
    true = {name: rig.runs[name].observation.copy() for name in ("c1", "c2", "c3")}
    for name in true:
        rig.shift(name, np.linspace(0, 10e-3, 1500)[:, None] * [0, 0, 1])
    found = compared(rig.recordings, rig.rest)
    assert len(said(found)) == 3
    assert all("drifts by +10" in text or "drifts by +9.9" in text for text in said(found))
    for each in compared(rig.recordings, rig.rest, FaultRules(drift="remove")):
        if each.name in true:
            assert np.abs(each.observation - true[each.name]).max() < 0.5e-3 and each.notes[0].done == "corrected"


def test_levels_that_differ_from_run_to_run_are_said_and_removed(rig):
    true = {name: rig.runs[name].observation.copy() for name in ("c2", "c3")}
    for name, level in (("c2", 4e-3), ("c3", 8e-3)):
        rig.shift(name, [0, 0, level])
    texts = said(compared(rig.recordings, rig.rest))
    assert [text[:2] for text in texts] == ["c2", "c3"]
    assert all(" mm in z from the other runs" in text for text in texts)
    for each in compared(rig.recordings, rig.rest, FaultRules(drift="remove")):
        if each.name in true:
            np.testing.assert_allclose(each.observation, true[each.name], atol=0.5e-3)


def test_a_decay_whose_inputs_move_is_refused_and_noise_of_a_measured_input_is_not(rig):
    rig.runs["d1"].input[:] += 0.01 * np.random.default_rng(0).normal(size=(300, 2)).clip(-2, 2)
    assert said(moving_decays(rig.recordings, ["u1", "u2"], "refuse")) == []
    rig.runs["c1"] = replace(rig.runs["c1"], kind="decay")
    with pytest.raises(ValueError, match="^c1 is a decay, but its input u. changes by"):
        moving_decays(rig.recordings, ["u1", "u2"], "refuse")


def dataset(rig, **other):
    runs = [Trajectory(each.time, each.observation - rig.rest, each.input, each.kind, each.split, each.name)
            for each in {**rig.runs, **other}.values()]
    return TrajectoryDataset(runs, rig.rest, rig.names, ["u1", "u2"], "1")


@pytest.mark.parametrize("digits", [None, 5])
def test_a_test_run_that_is_part_of_the_training_is_refused_even_if_it_was_rounded(rig, digits):
    run = rig.runs["c1"]
    y = run.observation[300:] if digits is None else run.observation[300:].round(digits)
    part = replace(run, name="test", split="test", time=run.time[:1200], observation=y, input=run.input[300:],
                   rows=None)
    assert without_copies(dataset(rig), "refuse").provenance == {}
    with pytest.raises(ValueError, match="^1200 of the 1200 samples of the test run 'test' are those .* run 'c1'"):
        without_copies(dataset(rig, test=part), "refuse")


def test_a_repeated_measurement_under_the_same_inputs_is_no_copy(rig, make_rig):
    again = make_rig(noise=0.0).runs["c1"].observation + 2e-5 * np.random.default_rng(5).normal(size=(1500, 3))
    repeated = replace(rig.runs["c1"], name="test", split="test", observation=again)
    assert without_copies(dataset(rig, test=repeated), "refuse").provenance == {}


def test_copies_within_the_training_are_said(rig):
    found = without_copies(dataset(rig, c4=replace(rig.runs["c1"], name="c4")), "refuse").provenance["notes"]
    assert [note["run"] for note in found] == ["c4"] and "c1" in found[0]["said"]
