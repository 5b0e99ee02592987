"""Trajectories from arrays and frames."""

from pathlib import Path

import numpy as np
import pytest
from linear_robot import DT, MILLIMETRES, NAMES, linear_robot, write_card

import ssmr_torch as ssmr

ROOT = Path(__file__).resolve().parents[2]


class Frame:
    """What pandas and polars have in common, as far as it is needed."""

    def __init__(self, table, columns):
        self.table, self.columns = table, list(columns)

    def to_numpy(self):
        return self.table


def same(one, other):
    assert one.output_names == other.output_names and one.input_names == other.input_names
    assert one.input_unit == other.input_unit and (one.rest == other.rest).all() and len(one) == len(other)
    for left, right in zip(one, other):
        assert (left.kind, left.split, left.name) == (right.kind, right.split, right.name)
        for name in ("time", "observation", "input"):
            assert np.array_equal(getattr(left, name), getattr(right, name))


def frames(runs, make):
    """The same runs with y and u as frames, whose columns stand in another order."""
    def of(dt, y, u):
        return dt * np.arange(len(y)), make(y[:, ::-1], NAMES["output_names"][::-1]), make(u, NAMES["input_names"])

    return {part: {name: of(*run) for name, run in of_part.items()} for part, of_part in runs.items()}


def test_arrays_frames_and_a_card_give_the_same_dataset(tmp_path):
    runs = write_card(tmp_path)
    by_card = ssmr.read(tmp_path / "robot.yaml")
    same(by_card, ssmr.trajectories(**runs, **NAMES, **MILLIMETRES))
    same(by_card, ssmr.trajectories(**frames(runs, Frame), output_names=["x", "y", "z"], **MILLIMETRES))


def test_frames_of_pandas_bring_their_names(tmp_path):
    pandas = pytest.importorskip("pandas")
    runs = linear_robot()
    named = {part: {f"{part.removesuffix('s')} {number}": run for number, run in enumerate(of_part, start=1)}
             for part, of_part in runs.items()}
    found = ssmr.trajectories(**frames(named, lambda table, columns: pandas.DataFrame(table, columns=columns)),
                              **MILLIMETRES)
    assert found.output_names == ("z", "y", "x") and found.input_names == NAMES["input_names"]
    same(found.observing(["x", "y", "z"]), ssmr.trajectories(**runs, **NAMES, **MILLIMETRES))


def test_a_decay_needs_no_inputs_and_a_run_one_number_for_its_clock():
    t = DT * np.arange(200)
    swing = 0.01 * np.exp(-3 * t) * np.cos(10 * t)
    found = ssmr.trajectories(decays=[(t, swing)], controlled=[(DT, swing, t)])
    assert found[0].input.shape == (200, 1) and not found[0].input.any()
    np.testing.assert_allclose(found[1].time, t, rtol=0, atol=1e-12)
    assert [run.kind for run in found] == ["decay", "controlled"] and found.output_names == ("y1",)


def spoilt(change):
    runs = linear_robot()
    change(runs)
    return {**NAMES, **MILLIMETRES, **runs}


def one_longer(runs):
    dt, y, u = runs["controlled"][0]
    runs["controlled"][0] = dt, y, u[:-1]


def moving_decay(runs):
    runs["decays"].append(runs["controlled"][0])


def absolute(runs):
    runs["decays"] = [(dt, y + [5.0, -3.0, 120.0], u) for dt, y, u in runs["decays"]]


def cut_short(runs):
    runs["controlled"] = [(dt, y[:, :2], u) for dt, y, u in runs["controlled"]]


@pytest.mark.parametrize(("change", "message"), [
    (one_longer, r"controlled 1 has 840 observations and 839 inputs; expected equally many: u\[k\] is held"),
    (moving_decay, "decay 7 is a decay, but its input left changes by 3.*; list it under controlled"),
    (absolute, r"decays end 120 mm from zero.*y is the displacement from rest: subtract the rest position, \[4\.95"),
    (cut_short, r"controlled 1 has 2 outputs; expected 3, \['x', 'y', 'z'\]"),
    (lambda runs: runs.update(units={"length": "m"}), "read in m; expected between 0.001 and 2 m: .* like cm or mm"),
    (lambda runs: runs.update(units="mm"), "units is 'mm'; expected a mapping, such as {'length': 'mm'"),
    (lambda runs: runs.update(output_names=["x", "y", "x"]), "two outputs are named 'x'"),
    (lambda runs: runs.update(decays=[(DT, np.ones((50, 3), dtype=complex), np.zeros((50, 2)))]),
     "decay 1: y is not all numbers .*complex"),
    (lambda runs: runs.update(units={"lenght": "m"}), "units has the unknown key 'lenght'; did you mean 'length'"),
    (lambda runs: runs.update(output_names=["x", "y"]), "decay 1 has 3 outputs; expected 2"),
    (lambda runs: runs.update(decays=[(DT,)]), r"decay 1 of decays is no run; expected \(t, y, u\)"),
    (lambda runs: runs.update(decays=[], controlled=[], test=[]), r"no runs were given; expected decays=\["),
    (lambda runs: runs.update(controlled={"decay 1": runs["controlled"][0]}), "two runs are named 'decay 1'"),
])
def test_recordings_that_cannot_be_are_refused_with_the_remedy(change, message):
    with pytest.raises(ValueError, match=message):
        ssmr.trajectories(**spoilt(change))


def test_decays_that_stop_before_they_rest_are_said(caplog):
    runs = linear_robot()
    runs["decays"] = [(dt, np.abs(y[:120]) + 2.0, u[:120]) for dt, y, u in runs["decays"]]
    ssmr.trajectories(**runs, **NAMES, **MILLIMETRES)
    assert "y is the displacement from rest: record them longer" in caplog.text
