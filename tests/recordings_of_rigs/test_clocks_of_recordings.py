"""Clocks of cameras, robots and microcontrollers: their unit, their order, their gaps, and two of them at once."""

import numpy as np
import pytest
from recordings_of_rigs.base_set import CONTROLLED, base_set, small


@pytest.fixture
def rig(tmp_path):
    return base_set(tmp_path)


def in_small(tmp_path, stamps, **card):
    rig = small(tmp_path, **card)
    k = np.arange(len(stamps))
    rig.runs["m"].text = "t,x,y,z,u1,u2\n" + "".join(
        f"{stamp},{5 + 0.1 * n:g},-3,120,{0.01 * n:g},0\n" for stamp, n in zip(stamps, k))
    return rig


def units(time: str) -> dict:
    return {"length": "mm", "input": "1", "time": time}


def holds_the_small_run(rig) -> None:
    run, = rig.read()
    assert run.length == 20 and run.timestep == pytest.approx(0.01, rel=1e-9)
    assert 1e3 * run.observation[-1, 0] == pytest.approx(1.9, abs=1e-9)


def test_frame_numbers_are_suspected_and_not_taken_for_milliseconds(rig):
    for run in rig.runs.values():
        run.t = np.arange(len(run.t))
    said = rig.refused()
    assert "frame" in said and "rate" in said and "look like ms" not in said


@pytest.mark.parametrize(("unit", "stamp"), [
    ("ns", lambda k: 1700000000000000000 + 10000000 * k), ("us", lambda k: 10000 * k), ("ms", lambda k: 10 * k),
    ("ns", lambda k: 10000000 * k), ("us", lambda k: 1700000000000000 + 10000 * k)])
def test_nanoseconds_and_microseconds_are_exact(tmp_path, unit, stamp):
    holds_the_small_run(in_small(tmp_path, [stamp(k) for k in range(20)], units=units(unit)))


@pytest.mark.parametrize(("unit", "stamp"), [("ns", lambda k: 1700000000000000000 + 10000000 * k),
                                             ("us", lambda k: 7 + 10000 * k)])
def test_the_unit_of_a_fine_clock_is_suggested(tmp_path, unit, stamp):
    with pytest.raises(ValueError, match=rf"\b{unit}\b"):
        in_small(tmp_path, [stamp(k) for k in range(20)]).read()


@pytest.mark.parametrize("stamps", [["1.73234e+09"] * 200, [f"{1732340000 + k // 100}" for k in range(200)]])
def test_a_clock_of_too_few_digits_is_refused_with_the_remedy(tmp_path, stamps):
    with pytest.raises(ValueError, match="too few digits.*sampling_time") as refusal:
        in_small(tmp_path, stamps).read()
    assert "look like" not in str(refusal.value)


def test_a_row_that_was_written_twice_is_dropped_and_said(tmp_path):
    rig = small(tmp_path)
    lines = rig.write() and (tmp_path / "m.csv").read_text().splitlines()
    rig.runs["m"].text = "\n".join([*lines[:12], *lines[11:]]) + "\n"
    holds_the_small_run(rig)
    assert any("11" in text for text in rig.said), rig.said


def test_rows_that_are_exchanged_are_sorted_and_said(tmp_path):
    rig = small(tmp_path)
    lines = rig.write() and (tmp_path / "m.csv").read_text().splitlines()
    lines[11], lines[12] = lines[12], lines[11]
    rig.runs["m"].text = "\n".join(lines) + "\n"
    holds_the_small_run(rig)
    assert any("10" in text for text in rig.said), rig.said


def test_one_stamp_that_is_too_early_is_named(rig):
    rig.runs["c1"].t[700] = 6.985
    rig.refused_or_within(0.90, "c1", "700")


def test_stamps_with_a_time_zone_pass_the_change_of_the_clocks(tmp_path):
    stamps = [f"2024-03-31T01:59:59.{900 + 10 * k:03d}+01:00" for k in range(10)]
    stamps += [f"2024-03-31T03:00:00.{10 * k:03d}+02:00" for k in range(10)]
    rig = in_small(tmp_path, stamps)
    holds_the_small_run(rig)
    assert not any("clock" in text or "stamp" in text or "gap" in text for text in rig.said), rig.said


@pytest.mark.slow
@pytest.mark.parametrize("gap", [1, 20, 200])
def test_gaps_are_bridged_or_cut(rig, gap):
    run = rig.runs["c1"]
    kept = np.r_[:700, 700 + gap:1500]
    run.t, run.y, run.u = run.t[kept], run.y[kept], run.u[kept]
    data = rig.read()
    assert len([each for each in data if each.name.startswith("c1")]) == (1 if gap == 1 else 2)
    assert rig.error() <= 0.90


@pytest.mark.slow
@pytest.mark.parametrize(("rows", "lag"), [(5, 50), (30, 300), (-1, -10)])
def test_the_lag_of_the_inputs_is_estimated(rig, rows, lag):
    for name in CONTROLLED:
        rig.runs[name].u = np.roll(rig.runs[name].u, rows, axis=0)
    data = rig.read()
    found = [note["numbers"]["lag_s"] for note in data.provenance["notes"] if "lag_s" in note["numbers"]]
    assert found and all(abs(1e3 * each - lag) <= 10 for each in found), rig.said


@pytest.mark.slow
def test_stamps_in_bursts_are_named(rig):
    for run in rig.runs.values():
        k = np.arange(len(run.t))
        run.t = 0.04 * (k // 4) + 0.0005 * (k % 4)
    said = rig.refused()
    assert "four" in said or "4" in said
    assert "raise irregularity" not in said
