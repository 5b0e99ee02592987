"""Faults that a recording shows by itself are found at their rows and mended; sound recordings stay as they are."""

import numpy as np
import pytest

from ssmr_torch.recording_faults.mending import mended
from ssmr_torch.recording_faults.rules import CHOICES, FaultRules

NOISE = 2e-5    # m


def only(recordings):
    """The single note of all recordings."""
    notes = [note for each in recordings for note in each.notes]
    assert len(notes) == 1, [str(note) for note in notes]
    return notes[0]


def named(recordings, name):
    return next(each for each in recordings if each.name == name)


# Outliers and lost markers

@pytest.mark.parametrize(("row", "size"), [(700, 1.0), (20, 3.0), (3, 30.0), (700, 1e6), (0, 30.0), (1, 500.0),
                                           (1498, 500.0), (1499, 30.0)])
def test_one_wrong_row_is_found_and_bridged_or_cut_at_the_ends(make_rig, row, size):
    rig = make_rig()
    true = rig.runs["c1"].observation.copy()
    rig.change("c1", row, true[row, 0] + 1e-3 * size, 0)
    after = mended(rig.recordings)
    note, run = only(after), named(after, "c1")
    assert row in note.rows and len(note.rows) <= 2 and note.run == "c1"
    np.testing.assert_allclose(run.observation, true[run.rows], atol=2e-4)
    assert note.done == ("cut" if row in (0, 1, 1498, 1499) else "bridged")


def test_the_picture_of_a_fault_shows_the_column_that_is_wrong_in_its_first_row(make_rig):
    rig = make_rig()
    true = rig.runs["c1"].observation.copy()
    rig.change("c1", 700, true[700, 0] + 0.03, 0)
    rig.change("c1", slice(900, 903), true[900:903, 1] - 0.02, 1)
    shown = only(mended(rig.recordings)).numbers
    assert shown["column"] == 0
    assert shown["recorded_m"][700 - shown["first_row"]] == pytest.approx(true[700, 0] + 0.03, rel=1e-4)


@pytest.mark.parametrize("token", [0.0, -1e-3, 1e6])
@pytest.mark.parametrize("count", [1, 5, 300])
def test_a_value_for_not_seen_is_bridged_where_it_is_short_and_else_cut_at_both_ends(rig, token, count):
    true = rig.runs["c2"].observation.copy()
    rig.change("c2", slice(600, 600 + count), token)
    after = mended(rig.recordings)
    note, run = only(after), named(after, "c2")
    assert note.rows == tuple(range(600, 600 + count)) and "c2" in str(note)
    assert note.done == ("bridged" if count <= 5 else "cut")
    np.testing.assert_allclose(run.observation, true[run.rows], atol=5e-4)
    assert len(run.time) == 1500 - (count if count > 5 else 0)
    assert run.cuts == ((600 + count,) if count > 5 else ())


def test_a_marker_that_is_lost_in_every_third_row_is_bridged_in_each(two_markers):
    true = two_markers.runs["c3"].observation.copy()
    rows = np.arange(30, 1470, 3)
    two_markers.change("c3", rows[:, None], 0.0, [3, 4, 5])
    after = mended(two_markers.recordings)
    assert only(after).rows == tuple(rows)
    np.testing.assert_allclose(named(after, "c3").observation, true, atol=3e-4)


def test_zeros_among_displacements_are_found_where_they_miss_the_motion(rig):
    for name in rig.runs:
        rig.shift(name, -rig.rest)
    rig.change("c1", slice(500, 530), 0.0)
    note = only(mended(rig.recordings))
    assert note.rows[0] in range(500, 503) and note.rows[-1] in range(527, 530) and note.done == "cut"


def test_a_stretch_of_disorder_is_cut(rig):
    noise = 0.05 * np.random.default_rng(1).normal(size=(30, 3))
    rig.change("c1", slice(400, 430), noise + rig.rest)
    note = only(mended(rig.recordings))
    assert note.rows[0] == 400 and note.rows[-1] == 429 and note.done == "cut"


def test_a_jump_that_does_not_return_cuts_the_run(rig):
    rig.change("c1", slice(839, None), rig.runs["c1"].observation[839:] + [6e-3, -4e-3, 5e-3])
    after = mended(rig.recordings)
    assert only(after).rows == (839,) and named(after, "c1").cuts == (839,)
    assert "8." in only(after).said and "does not return" in only(after).said


def test_a_spike_of_an_input_that_the_robot_does_not_answer_is_replaced(rig):
    inputs = rig.runs["c1"].input.copy()
    rig.runs["c1"].input[700, 1] = 9.0
    after = mended(rig.recordings)
    assert only(after).rows == (700,)
    expected = inputs.copy()
    expected[700, 1] = inputs[699, 1]
    np.testing.assert_array_equal(named(after, "c1").input, expected)


# Exchanged markers

@pytest.mark.parametrize("count", [1, 3, 400])
@pytest.mark.parametrize("displacements", [False, True])
def test_rows_in_which_two_markers_are_exchanged_are_found_exactly(make_rig, count, displacements):
    rig = make_rig(markers=2)
    if displacements:
        for name in rig.runs:
            rig.shift(name, -rig.rest)
    true = rig.runs["c1"].observation.copy()
    rig.change("c1", slice(500, 500 + count), true[500:500 + count][:, [3, 4, 5, 0, 1, 2]])
    after = mended(rig.recordings)
    note = only(after)
    assert note.rows == tuple(range(500, 500 + count)) and "a and b" in note.said and note.done == "cut"
    back = mended(rig.recordings, FaultRules(exchanged_markers="correct"))
    np.testing.assert_array_equal(named(back, "c1").observation, true)


def test_markers_exchanged_to_the_end_are_found_on_the_wrong_side(two_markers):
    true = two_markers.runs["c1"].observation.copy()
    two_markers.change("c1", slice(None, 1000), true[:1000, [3, 4, 5, 0, 1, 2]])
    assert only(mended(two_markers.recordings)).rows == tuple(range(1000))


# Held values and rows never written

@pytest.mark.parametrize("count", [3, 15, 120])
def test_a_marker_that_is_held_while_the_robot_moves_is_found(rig, count):
    true = rig.runs["c1"].observation.copy()
    rig.change("c1", slice(301, 301 + count), true[300])
    after = mended(rig.recordings)
    note = only(after)
    assert note.rows == tuple(range(301, 301 + count)) and note.kind == "held_values"
    np.testing.assert_allclose(named(after, "c1").observation, true[named(after, "c1").rows], atol=4e-4)


def test_a_sensor_that_dies_is_cut_from_there_on(rig):
    rig.change("c1", slice(800, None), rig.runs["c1"].observation[799])
    after = mended(rig.recordings)
    assert only(after).rows == tuple(range(800, 1500)) and len(named(after, "c1").time) == 800


def test_one_column_that_dies_is_cut_from_there_on(rig):
    rig.change("c1", slice(800, None), rig.runs["c1"].observation[799, 2], 2)
    after = mended(rig.recordings)
    assert only(after).rows == tuple(range(800, 1500)) and "z" in only(after).said


@pytest.mark.parametrize(("every", "columns", "rate"), [(2, [0, 1, 2], 50), (5, [0, 1, 2], 20), (4, [2], 25)])
def test_the_true_rate_of_a_slow_camera_is_found_and_the_rows_between_are_filled(make_rig, every, columns, rate):
    rig = make_rig()
    true = rig.runs["c1"].observation.copy()
    for name in ("c1", "c2", "d1"):
        rows = every * (np.arange(len(rig.runs[name].time)) // every)
        rig.change(name, slice(None), rig.runs[name].observation[rows][:, columns], columns)
    with pytest.raises(ValueError, match=f"at {rate} Hz only, in a log of 100 Hz.*faults.slow_camera: bridge"):
        mended(rig.recordings)
    filled = named(mended(rig.recordings, FaultRules(slow_camera="bridge")), "c1")
    assert np.sqrt(np.mean((filled.observation - true[filled.rows]) ** 2)) < 2e-4
    thin = named(mended(rig.recordings, FaultRules(slow_camera="thin")), "c1")
    np.testing.assert_allclose(np.diff(thin.time), every * 0.01, rtol=1e-9)


def test_rows_that_were_never_written_are_cut(rig):
    for name in rig.runs:
        rig.shift(name, -rig.rest)
    rig.change("c1", slice(1000, None), 0.0)
    rig.runs["c1"].input[1000:] = 0.0
    after = mended(rig.recordings)
    assert only(after).rows == tuple(range(1000, 1500)) and only(after).kind == "unwritten_rows"
    assert len(named(after, "c1").time) == 1000


# Empty cells

@pytest.mark.parametrize(("rule", "filled"), [("split", 2), ("bridge", 5)])
def test_empty_cells_are_bridged_where_they_are_few(rig, rule, filled):
    true = rig.runs["c1"].observation.copy()
    rig.change("c1", slice(300, 300 + filled), np.nan, 1)
    rig.change("c1", slice(700, 701 + filled), np.nan)
    run = named(mended(rig.recordings, missing=rule), "c1")
    assert run.cuts == (701 + filled,) and len(run.time) == 1500 - filled - 1
    np.testing.assert_allclose(run.observation, true[run.rows], atol=4e-4)


def test_an_empty_input_is_that_of_the_row_before(rig):
    rig.runs["c1"].input[400:403] = np.nan
    run = named(mended(rig.recordings, missing="bridge"), "c1")
    np.testing.assert_array_equal(run.input[400:403], np.repeat(run.input[399:400], 3, axis=0))


# Rules

def test_each_rule_is_known_and_a_wrong_one_is_refused_with_those_that_are():
    assert set(CHOICES) == set(FaultRules.__dataclass_fields__)
    with pytest.raises(ValueError, match="faults.outliers is 'ignore'; expected one of bridge, cut, refuse, keep"):
        FaultRules(outliers="ignore")


def test_a_rule_keeps_refuses_or_cuts_what_was_found(rig):
    rig.change("c1", 700, 0.5)
    kept = mended(rig.recordings, FaultRules(outliers="keep", lost_markers="keep"))
    assert (named(kept, "c1").observation[700] == 0.5).all() and only(kept).done == "kept"
    with pytest.raises(ValueError, match="^c1: .* in row 700; repair them, or set faults.*: bridge$"):
        mended(rig.recordings, FaultRules(outliers="refuse", lost_markers="refuse"))
    cut = mended(rig.recordings, FaultRules(outliers="cut", lost_markers="cut"))
    assert named(cut, "c1").cuts == (701,)


# Sound recordings

def dithered(random):
    return np.cumsum(0.02 * random.normal(size=(1500, 2)), axis=0) + 0.3 * random.normal(size=(1500, 2))


def ramps(random):
    return np.abs((np.arange(1500)[:, None] * [0.01, 0.013] + random.uniform(0, 4, 2)) % 4 - 2)


def steps_from_rest(random):
    u = np.repeat(random.choice([-2.0, 0.0, 2.0], (10, 2)), 150, axis=0)
    u[:300] = 0.0
    return u


@pytest.mark.parametrize("inputs", [None, dithered, ramps, steps_from_rest])
@pytest.mark.parametrize(("noise", "step"), [(0.0, None), (0.2, None), (0.0, 1e-4), (0.02, 1e-5), (0.02, 1e-4)])
def test_sound_recordings_are_returned_as_they_are(make_rig, inputs, noise, step):
    rig = make_rig(noise=noise, inputs=inputs, seed=3)
    if step:
        for run in list(rig.runs.values()):
            rig.change(run.name, slice(None), step * np.round(run.observation / step))
    before = rig.recordings
    after = mended(before)
    assert [str(note) for each in after for note in each.notes] == []
    assert all(one is other for one, other in zip(before, after, strict=True))
