"""Recordings with faults: each is refused with the remedy, or named and mended; the error of a fit says which."""

import numpy as np
import pytest
from recordings_of_rigs.base_set import CONTROLLED, DECAYS, REST, base_set

TRAINING = [*DECAYS, "c1", "c2", "c3"]
pytestmark = pytest.mark.slow


@pytest.fixture
def rig(tmp_path):
    return base_set(tmp_path)


@pytest.fixture
def two_markers(tmp_path):
    return base_set(tmp_path, markers=2)


def test_the_clean_set_has_its_error_and_no_finding(rig):
    assert rig.error() == pytest.approx(0.87, abs=0.005) and rig.said == []


def test_the_clean_set_of_two_markers_has_its_error_and_no_finding(two_markers):
    assert two_markers.error() == pytest.approx(0.57, abs=0.005) and two_markers.said == []


@pytest.mark.parametrize("digits", [2, 1])
def test_rounded_positions_give_no_finding(rig, digits):
    for run in rig.runs.values():
        run.y = run.y.round(digits)
    rig.read()
    assert rig.said == []


@pytest.mark.parametrize(("rest", "away"), [(None, "120"), ([5, -3, -120], "240"), ([5, -3, 105], "15")])
def test_decays_that_end_far_from_the_rest_position_are_said(rig, rest, away):
    if rest is None:
        for run in rig.runs.values():
            run.y = run.y - REST
    else:
        rig.card["rest"] = rest
    assert away in rig.refused() and "rest" in rig.refused()


def test_absolute_decays_that_are_called_centred_are_said(rig):
    rig.card["centred"] = list(DECAYS)
    assert "120" in rig.refused()


def exchange(run, rows) -> None:
    run.y[rows] = run.y[rows][:, [3, 4, 5, 0, 1, 2]]


def test_markers_that_are_exchanged_for_a_while_are_named_and_cut(two_markers):
    exchange(two_markers.runs["c1"], slice(500, 550))
    two_markers.refused_or_within(0.65, "c1", "500..549")


def test_markers_that_are_exchanged_in_a_whole_run_are_named(two_markers):
    exchange(two_markers.runs["c1"], slice(None))
    two_markers.refused_or_within(0.65, "c1")


def test_exchanged_markers_whose_clouds_overlap_are_named_and_cut(two_markers):
    exchange(two_markers.runs["c1"], slice(500, 550))
    for run in two_markers.runs.values():
        run.y = run.y - two_markers.card["rest"]
    exchanged = np.array(two_markers.card["rest"])[[3, 4, 5, 0, 1, 2]] - two_markers.card["rest"]
    two_markers.runs["c1"].y[500:550] -= exchanged
    two_markers.card["rest"] = [0.0] * 6
    two_markers.refused_or_within(0.65, "c1", "500..549")


def test_markers_that_are_exchanged_in_one_row_are_named(two_markers):
    exchange(two_markers.runs["c1"], slice(500, 501))
    two_markers.refused_or_within(0.65, "c1", "500")


@pytest.mark.parametrize(("every", "rate"), [(5, "20"), (2, "50")])
def test_the_true_rate_of_held_positions_is_found(rig, every, rate):
    for name in TRAINING:
        run = rig.runs[name]
        run.y = run.y[every * (np.arange(len(run.y)) // every)]
    rig.refused_or_within(1.2 if every == 2 else 3.0, f"{rate} Hz")


@pytest.mark.parametrize(("row", "change"), [(700, lambda y: y + [30, 0, 0]), (700, lambda y: [500, *y[1:]]),
                                             (500, lambda y: [0, 0, 0])])
def test_one_wrong_row_is_named_and_mended(rig, row, change):
    rig.runs["c1"].y[row] = change(rig.runs["c1"].y[row])
    rig.refused_or_within(0.90, "c1", str(row))


def test_five_rows_of_minus_one_are_named_and_cut(rig):
    for run in rig.runs.values():
        run.y = run.y / 1e3
    rig.runs["c1"].y[500:505] = -1
    rig.card |= {"rest": (REST / 1e3).tolist(), "units": {"length": "m", "input": "1", "time": "s"}}
    rig.refused_or_within(0.90, "c1", "500..504")


def test_drift_within_runs_is_said(rig):
    for name in ("c1", "c2", "c3"):
        rig.runs[name].y[:, 2] += np.linspace(0, 10, 1500)
    rig.read()
    assert [text for text in rig.said if "c1" in text and "10" in text and "drift" in text], rig.said


def test_an_offset_from_run_to_run_is_said(rig):
    for name, offset in (("c1", 0), ("c2", 4), ("c3", 8)):
        rig.runs[name].y[:, 2] += offset
    rig.read()
    assert [text for text in rig.said if "c3" in text] and [text for text in rig.said if "c2" in text], rig.said


def test_decays_that_still_move_at_their_end_are_said_with_the_spread(rig):
    rig.card["rest"] = "last sample of decays"
    for name in DECAYS:
        run = rig.runs[name]
        run.t, run.y, run.u = run.t[:50], run.y[:50], run.u[:50]
    texts = [rig.refused()] if rig.refused() else rig.said
    assert any("mm" in text and ("still" in text or "move" in text or "within" in text) for text in texts), texts


def test_one_decay_that_still_moves_is_no_rest_position(rig):
    rig.card["rest"] = "last sample of decays"
    for name in DECAYS[1:]:
        del rig.runs[name]
    run = rig.runs["d1"]
    run.t, run.y, run.u = run.t[:50], run.y[:50], run.u[:50]
    rig.card["decays"] = ["d1"]
    assert rig.refused() or any("d1" in text for text in rig.said)


def test_a_decay_that_ends_elsewhere_is_named(rig):
    rig.card["rest"] = "last sample of decays"
    rig.runs["d6"].y[:, 2] += 15
    texts = [rig.refused()] if rig.refused() else rig.said
    assert any("d6" in text and "15" in text for text in texts), texts


@pytest.mark.parametrize("case", ["cm", "tenth", "metres", "dead"])
def test_a_file_or_a_column_in_another_unit_is_named(rig, case):
    if case == "cm":
        rig.runs["c1"].y /= 10
    elif case == "tenth":
        for run in rig.runs.values():
            run.y = run.y - REST
        rig.runs["c1"].y /= 10
        rig.card["rest"] = [0, 0, 0]
    else:
        for run in rig.runs.values():
            run.y[:, 2] = run.y[:, 2] / 1e3 if case == "metres" else 120
        rig.card["rest"] = [5, -3, 0.12 if case == "metres" else 120]
    texts = [rig.refused()] if rig.refused() else rig.said
    name = "c1" if case in ("cm", "tenth") else "z"
    assert any(name in text for text in texts), texts


def test_rows_that_were_never_written_are_cut_and_said(rig):
    run = rig.runs["c1"]
    rest = rig.card["rest"]
    for each in rig.runs.values():
        each.y = each.y - rest
    rig.card["rest"] = [0, 0, 0]
    run.t = 0.01 * np.arange(2000)
    run.y, run.u = (np.vstack([array, np.zeros((500, array.shape[1]))]) for array in (run.y, run.u))
    data = rig.read()
    assert [each.length for each in data if each.name.startswith("c1")] == [1500]
    assert any("c1" in text and "1500..1999" in text for text in rig.said), rig.said


def test_a_test_run_that_is_a_copy_of_the_training_is_refused(rig):
    rig.runs["test"] = rig.runs["c1"]
    assert "c1" in rig.refused() and "test" in rig.refused()


def test_a_test_run_that_is_a_part_of_a_training_run_is_refused(rig):
    run = rig.runs["c1"]
    rig.runs["test"] = type(run)(run.t[:1200], run.y[300:], run.u[300:])
    assert "1200" in rig.refused() and "c1" in rig.refused()


def test_copies_within_the_training_are_said(rig):
    rig.runs["c4"] = rig.runs["c1"]
    rig.read()
    assert any("c4" in text and "c1" in text for text in rig.said), rig.said


def test_a_decay_whose_inputs_move_is_refused(rig):
    rig.card["decays"] = [*DECAYS, "c1"]
    assert "c1 is a decay" in rig.refused() and "changes by" in rig.refused()


def emptied(rig, rows, absent: bool = False) -> None:
    for name in CONTROLLED:
        run = rig.runs[name]
        kept = np.ones(len(run.t), dtype=bool)
        kept[rows(len(run.t))] = False
        if absent:
            run.t, run.y, run.u = run.t[kept], run.y[kept], run.u[kept]
        else:
            run.y[~kept] = np.nan


@pytest.mark.parametrize("absent", [False, True])
def test_single_empty_rows_are_bridged_like_absent_ones(rig, absent):
    emptied(rig, lambda length: np.arange(30, length, 60), absent)
    rig.card["missing"] = "split"
    assert rig.error() <= 0.90
    rig.card.pop("missing")
    assert rig.error() <= 0.90


