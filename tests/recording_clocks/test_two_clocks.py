"""Inputs on a clock of their own, and inputs that were logged late, with the offset, drift and lag that were put in."""

import h5py
import numpy as np
import pytest
import yaml
from recording_clocks.robot import commands, motion

import ssmr_torch as ssmr
from ssmr_torch.data.card_reader import custom
from ssmr_torch.data.input_lag import shifted, with_lag
from ssmr_torch.recording_clocks.clock_rules import Clock
from ssmr_torch.recording_clocks.held_inputs import mean_of_held
from ssmr_torch.recording_clocks.lag import lag_of
from ssmr_torch.recording_clocks.two_clocks import estimate, joined
from ssmr_torch.trajectory import Trajectory

SECONDS = 8.0
SENT, HELD = commands(SECONDS)
TIME, Y = motion(SENT, HELD, SECONDS)
COUNT, HALF = len(TIME), len(TIME) // 2


def clock(time, origin=0):
    return Clock(time, np.arange(len(time)), (), origin)


def acting(time=TIME):
    """The true inputs, held on the times of the outputs."""
    return mean_of_held(SENT, HELD, np.r_[time, time[-1] + 0.01])


def logged(offset=0.0, drift=0.0):
    """Stamps of the commands on a clock that is `offset` s behind and runs slow by `drift`."""
    return (SENT - offset) * (1 - drift)


# Two clocks

def test_commands_are_held_from_their_own_stamps_with_their_impulse():
    found, y, u = joined("m", clock(TIME), Y, clock(SENT), HELD)
    np.testing.assert_allclose(u, acting(), atol=1e-12)
    np.testing.assert_allclose(u.sum(axis=0) * 0.01, np.diff(np.r_[SENT, SECONDS]) @ HELD, rtol=1e-9)
    np.testing.assert_array_equal(y, Y)
    assert found.notes == () and len(found.time) == COUNT


@pytest.mark.slow
@pytest.mark.parametrize(("offset", "drift"), [(0.0, 0.0), (-0.2, 0.0), (0.013, 0.0), (0.4, 0.0), (0.0, 5e-3),
                                               (0.1, -4e-3)])
def test_offset_and_drift_are_estimated_to_half_a_sample(offset, drift):
    found = estimate(TIME, Y, logged(offset, drift), HELD)
    assert found.told and found.moved == (offset != 0)
    assert found.offset == pytest.approx(offset, abs=0.006) and found.drift == pytest.approx(drift, abs=3e-4)


@pytest.mark.parametrize(("offset", "drift"), [(0.05, 0.0), (0.1, -4e-3)])
def test_offset_and_drift_are_said_and_removed_on_request(offset, drift):
    stamps = logged(offset, drift)
    kept = joined("m", clock(TIME), Y, clock(stamps), HELD)[0]
    assert any("set clock_offset: auto" in str(note) and note.done == "kept" for note in kept.notes)
    after, _, u = joined("m", clock(TIME), Y, clock(stamps), HELD, "auto", "auto")
    assert np.mean(np.abs(u - acting()[after.rows])) < 0.02 * np.ptp(HELD)
    assert any(note.done == "corrected" for note in after.notes)


def test_a_given_offset_and_drift_are_applied_as_they_are():
    stamps = logged(0.05, 1e-3)
    found, _, u = joined("m", clock(TIME), Y, clock(stamps), HELD, 0.05, 1e3)
    np.testing.assert_allclose(u[:-50], acting()[found.rows][:-50], atol=0.02)


def test_clocks_of_two_epochs_are_refused_with_the_remedy_and_joined_on_request():
    epoch = 1_700_000_000_000_000_000
    with pytest.raises(ValueError, match="another clock; give clock_offset: auto, or s .*about -1700000000"):
        joined("m", clock(TIME), Y, clock(SENT, epoch), HELD)
    found, _, u = joined("m", clock(TIME), Y, clock(SENT, epoch), HELD, "auto")
    assert np.mean(np.abs(u - acting()[found.rows])) < 0.02 * np.ptp(HELD)


def test_samples_without_a_known_input_are_cut_and_said():
    found, y, _ = joined("m", clock(TIME), Y, clock(SENT[5:50]), HELD[5:50])
    assert "no inputs are known at rows 0..47" in str(found.notes[-1])
    assert len(y) == len(found.time) == len(found.rows) < COUNT


def test_inputs_that_never_change_need_no_common_clock():
    found, _, u = joined("m", clock(TIME), Y, clock(SENT + 99.0), 0 * HELD, "auto", "auto")
    assert found.notes == () and not u.any() and len(u) == COUNT


# Files

def card(folder, **changes):
    """A controlled run and a test, outputs at 100 Hz in one file, commands from 0.003 s on at 50 Hz in another."""
    pairs = []
    for seed, name in ((0, "run"), (1, "check")):
        sent, held = commands(4.0, seed)
        time, y = motion(sent + 0.003, held, 4.0)
        stamps = np.arange(0.003, 4.0, 0.02)
        u = held[np.clip(np.searchsorted(sent + 0.003, stamps + 1e-9, side="right") - 1, 0, None)]
        np.savetxt(folder / f"{name}.csv", np.c_[time, y], delimiter=",", header="t,x,y,z", comments="")
        np.savetxt(folder / f"{name}_u.csv", np.c_[1e3 * stamps, u], delimiter=",", header="ms,u1,u2", comments="")
        pairs.append({"outputs": f"{name}.csv", "inputs": f"{name}_u.csv"})
    content = {"pairs": pairs, "columns": {"time": "t", "input_time": "ms", "observation": ["x", "y", "z"],
                                           "input": ["u1", "u2"]},
               "units": {"length": "mm", "input": "1", "time": "s", "input_time": "ms"}, "rest": [0, 0, 0],
               "split": {"test": ["check"]}} | changes
    path = folder / "card.yaml"
    path.write_text(yaml.safe_dump(content))
    return path


def test_a_card_pairs_the_files_of_outputs_and_inputs(tmp_path):
    data = custom(card(tmp_path))
    assert [(run.name, run.split, run.length) for run in data] == [("run", "train", 400), ("check", "test", 400)]
    assert data.provenance["notes"] == [] and set(data.provenance["sources"]) == {
        "card.yaml", "run.csv", "run_u.csv", "check.csv", "check_u.csv"}
    sent, held = commands(4.0, 0)
    stamps = np.arange(0.003, 4.0, 0.02)
    u = held[np.searchsorted(sent + 0.003, stamps + 1e-9, side="right") - 1]
    np.testing.assert_allclose(data[0].input, mean_of_held(stamps, u, 0.01 * np.arange(401)), atol=1e-9)


@pytest.mark.parametrize(("changes", "message"), [
    ({"pairs": [{"outputs": "run.csv"}]}, "pairs lacks the key inputs"),
    ({"pairs": [{"outputs": "run.csv", "inputs": "none.csv"}]}, "no file .*none.csv"),
    ({"pairs": [{"outputs": "run.csv", "inputs": "check.csv"}], "split": {}}, "no table with the inputs"),
    ({"clock_offset": "soon"}, "clock_offset is 'soon'; expected auto, or a number of s"),
    ({"clock_drift": True}, "clock_drift is True; expected auto, or a number of ppm"),
    ({"input_lag": "late"}, "input_lag is 'late'; expected keep, remove"), ({"input_lag": 99}, "input_lag is 99"),
    ({"stamps": "odd"}, "stamps is 'odd'; expected as_given or even"), ({"rate": 100}, "rate without columns.frame"),
    ({"same_stamp": "both"}, "same_stamp is 'both'; expected"), ({"rate": -1}, "rate is -1; expected a positive")])
def test_wrong_keys_of_clocks_are_refused(tmp_path, changes, message):
    with pytest.raises((ValueError, FileNotFoundError), match=message):
        custom(card(tmp_path, **changes))


def test_topics_with_clocks_of_their_own_in_one_file_may_be_paired_with_each_other(tmp_path):
    with h5py.File(tmp_path / "run.h5", "w") as file:
        file["x"], file["t"] = Y[:, 0], TIME
    with h5py.File(tmp_path / "sent.h5", "w") as file:
        file["stamp"], file["u"] = SENT, HELD[:, 0]
    (tmp_path / "card.yaml").write_text(yaml.safe_dump({
        "pairs": [{"outputs": "run.h5", "inputs": "sent.h5"}], "rest": [0], "units": {"length": "mm", "input": "1"},
        "columns": {"time": "t", "input_time": "stamp", "observation": ["x"], "input": ["u"]}}))
    run, = custom(tmp_path / "card.yaml")
    np.testing.assert_allclose(run.input[:, 0], acting()[:, 0], atol=1e-12)


# Lag

def rolled(rows):
    return np.roll(acting(), rows, axis=0)


@pytest.mark.parametrize("rows", [5, 30, -1, 1, -20, 60])
def test_a_lag_is_found_to_the_sample(rows):
    found = lag_of([(Y, rolled(rows))], 0.01)
    assert found.samples == rows and found.significant and found.low <= rows <= found.high


def test_without_a_lag_nothing_is_significant_whatever_the_noise_and_rate():
    for noise, step in ((0.0, 0.01), (0.2, 0.01), (1.0, 0.01), (0.02, 0.002), (0.02, 0.02)):
        time, y = motion(SENT, HELD, SECONDS, step, noise)
        u = mean_of_held(SENT, HELD, np.r_[time, time[-1] + step])
        assert not lag_of([(y, u)], step).significant, (noise, step)


@pytest.mark.slow
def test_an_actuator_that_follows_slowly_is_a_lag_of_one_sample_at_most():
    for constant in (0.02, 0.05, 0.1, 0.2):
        keep = np.exp(-0.001 / constant)
        fine = np.arange(0.0, SECONDS, 0.001)
        u = HELD[np.searchsorted(SENT, fine + 1e-9, side="right") - 1]
        slow = np.empty_like(u)
        value = np.zeros(2)
        for row, wanted in enumerate(u):
            value = wanted + keep * (value - wanted)
            slow[row] = value
        y = motion(fine, slow, SECONDS)[1]
        found = lag_of([(y, acting())], 0.01)
        assert found.samples in (-1, 0) or not found.significant, constant


def test_inputs_that_never_change_tell_no_lag():
    assert lag_of([(Y, 0 * acting())], 0.01).samples is None
    assert lag_of([], 0.01).samples is None


def of_arrays(rows, **options):
    return ssmr.trajectories(
        controlled=[(0.01, Y[:HALF], rolled(rows)[:HALF])], test=[(0.01, Y[HALF:], rolled(rows)[HALF:])],
        units={"length": "mm", "input": "1"}, **options)


def test_a_lag_is_said_and_removed_on_request():
    data = of_arrays(5)
    note, = data.provenance["notes"]
    assert note["numbers"]["lag_s"] == pytest.approx(0.05) and "set input_lag: remove, or 0.05" in note["said"]
    np.testing.assert_allclose(data[0].input, rolled(5)[:HALF])
    for rule in ("remove", 0.05):
        data = of_arrays(5, input_lag=rule)
        np.testing.assert_allclose(data[0].input, acting()[:HALF - 5], atol=1e-12)
        np.testing.assert_allclose(data[0].observation, 1e-3 * Y[:HALF - 5], atol=1e-12)
        assert data.provenance["notes"][0]["done"] == "corrected"
    assert of_arrays(0).provenance["notes"] == []


def test_the_lag_of_one_run_alone_is_said_of_that_run():
    runs = [(0.01, Y[:HALF], acting()[:HALF]), (0.01, Y[HALF:], rolled(7)[HALF:])]
    notes = ssmr.trajectories(controlled={"good": runs[0], "late": runs[1]},
                              units={"length": "mm", "input": "1"}).provenance["notes"]
    assert [note["run"] for note in notes] == ["late"] and notes[0]["numbers"]["lag_s"] == pytest.approx(0.07)


def test_inputs_are_shifted_by_parts_of_a_sample_as_means():
    run = Trajectory(0.01 * np.arange(50), np.zeros((50, 1)), np.arange(50.0)[:, None])
    moved = shifted(run, 0.005)
    np.testing.assert_allclose(moved.input[:, 0], np.arange(49.0) + 0.5)
    np.testing.assert_allclose(shifted(run, -0.02).input[:, 0], np.arange(48.0))
    with pytest.raises(ValueError, match="leaves 5 of 50 samples"):
        shifted(run, 0.45)


def test_a_lag_that_nothing_tells_is_not_removed():
    still = of_arrays(0)
    quiet = type(still)([Trajectory(run.time, run.observation, 0 * run.input + 1e-9 * run.time[:, None])
                         for run in still], still.rest, still.output_names, still.input_names, "1")
    with pytest.raises(ValueError, match="do not tell a lag"):
        with_lag(quiet, "remove")


# Arrays

def test_times_in_memory_may_be_dates_or_nanoseconds():
    u = acting()
    epoch = np.datetime64("2024-03-31T00:59:59", "ns") + (1e7 * np.arange(COUNT)).astype("timedelta64[ns]")
    pandas = pytest.importorskip("pandas")
    for time, units in ((epoch, {}), (list(pandas.to_datetime(epoch).tz_localize("UTC")), {}),
                        (epoch.astype(np.int64), {"time": "ns"}), (pandas.Series(epoch), {})):
        data = ssmr.trajectories(controlled=[(time, Y, u)], units={"length": "mm", "input": "1"} | units)
        np.testing.assert_allclose(data[0].time, TIME, atol=1e-12)
        np.testing.assert_allclose(data[0].input, u)
