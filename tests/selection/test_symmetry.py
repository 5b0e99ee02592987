"""Robots of known symmetry: a nonlinear arm with four cables about z, and given linear responses."""

import numpy as np
import pytest

from ssmr_torch.selection.closed_form import ClosedForm
from ssmr_torch.selection.folds_and_starts import FOLDS, Samples
from ssmr_torch.selection.rollouts import rolled_out
from ssmr_torch.selection.settings import SelectionSettings
from ssmr_torch.selection.suggested_turns import suggested
from ssmr_torch.selection.symmetry import FORMS, Symmetric, response, with_symmetry
from ssmr_torch.selection.trial import Trial
from ssmr_torch.symmetry_turns import Turn, closed, mirror, on_markers, rotation, stated

TIMESTEP = 0.02
CABLES = [f"cable{k}" for k in (1, 2, 3, 4)]
QUARTER = {"angle": 90, "axis": [0, 0, 1], "inputs": ["cable2", "cable3", "cable4", "cable1"]}


def arm(seed, seconds=8.0, strengths=(1.0, 1.0, 1.0, 1.0), released=False):
    """Tip (x, y, z) in m of an arm that four cables along +x, +y, −x, −y bend, and their tensions.

    q̈ = −ω² (1 + 400 ‖q‖²) q − 2 ζ ω q̇ + Σ strength_k u_k (1 − 3 u_k) d_k,  z = −4 ‖q‖² − 0.002 Σ u_k.
    """
    rng, steps, within = np.random.default_rng(seed), round(seconds / TIMESTEP), 20
    directions = np.array([[1, 0], [0, 1], [-1, 0], [0, -1]]) * np.asarray(strengths)[:, None]
    held = rng.uniform(0.0, 0.15, (steps // 8 + 2, 4)) * (not released)
    u = np.repeat(held, 8, axis=0)[:steps]
    q, v = (0.02 * rng.uniform(-1, 1, 2), np.zeros(2)) if released else (np.zeros(2), np.zeros(2))
    y = []
    for now in u:
        y.append([*q, -4 * q @ q - 0.002 * now.sum()])
        force = 20 * (now * (1 - 3 * now)) @ directions
        for _ in range(within):
            v = v + TIMESTEP / within * (force - 100 * (1 + 400 * q @ q) * q - 4 * v)
            q = q + TIMESTEP / within * v
    return np.array(y), u


def trial_on(strengths=(1.0, 1.0, 1.0, 1.0), runs=2):
    decays = [arm(seed, 3.0, strengths, released=True) for seed in (10, 11, 12)]
    controlled = [arm(seed, 8.0, strengths) for seed in range(runs)]

    def make(turns) -> Trial:
        return Trial(Samples(decays, controlled, TIMESTEP, coordinates={"identity": None}, targets=range(3),
                             turns=turns))
    return make


def quarter() -> Turn:
    return stated(QUARTER, CABLES, 3)


def test_a_quarter_turn_of_four_equal_cables_is_found_and_lowers_the_error_on_what_is_held_out():
    symmetric = with_symmetry(trial_on(), "find", CABLES)
    assert any(turn.same(quarter()) for turn in symmetric.turns)
    assert "by 90° about z" in symmetric.found and "cable1 → cable2 → cable3 → cable4 → cable1" in symmetric.found
    assert symmetric.kept() is symmetric


def test_with_one_cable_stronger_by_a_fifth_only_the_reflection_that_keeps_it_is_found():
    symmetric = with_symmetry(trial_on((1.2, 1.0, 1.0, 1.0), runs=4), "find", CABLES)
    assert [turn.moved().tolist() for turn in symmetric.turns] == [[0, 3, 2, 1]]
    np.testing.assert_allclose(symmetric.turns[0].isometry, mirror((0, 1, 0)), atol=0.05)


def test_four_unequal_cables_have_no_symmetry():
    symmetric = with_symmetry(trial_on((1.2, 1.0, 0.9, 0.75)), "find", CABLES)
    assert not symmetric.turns and symmetric.found.startswith("No symmetry")


def test_turned_runs_lower_the_error_on_new_runs_if_there_are_few_runs():
    make, fresh = trial_on(runs=1), Samples([], [arm(seed) for seed in (50, 51)], TIMESTEP,
                                            coordinates={"identity": None}, targets=range(3))
    errors = []
    for turns in ((), closed([quarter()])):
        model = ClosedForm(make(turns).samples, FORMS[0]).model(FORMS[0].ridge)
        starts = [fresh.held_out(fold) for fold in range(FOLDS)]
        errors.append(np.mean([np.square(rolled_out(model, each) - each.follows).mean() for each in starts]) ** 0.5)
    assert errors[1] < 0.8 * errors[0]


def test_a_copy_is_held_out_with_its_original_and_never_scored():
    plain, turned = (trial_on()(turns).samples for turns in ((), closed([quarter()])))
    count = len(plain.y)
    assert turned.originals == count and len(turned.y) == 4 * count
    for copy in range(1, 4):
        np.testing.assert_array_equal(turned.fold[copy * count:(copy + 1) * count], plain.fold)
        np.testing.assert_array_equal(turned.is_decay[copy * count:(copy + 1) * count], plain.is_decay)
    R = rotation(90, (0, 0, 1))
    np.testing.assert_allclose(turned.y[count:2 * count], plain.y @ R.T, atol=1e-15)
    for fold in range(FOLDS):
        np.testing.assert_array_equal(turned.held_out(fold).window, plain.held_out(fold).window)
        rows = turned.rows(1, decays=True)
        left = rows[~turned.touching(rows, 1)[fold]]
        assert not (turned.fold[left] == fold).any() and not (turned.fold[left + 1] == fold).any()
    np.testing.assert_array_equal(turned.hurried().inputs, plain.hurried().inputs)


def test_a_linear_response_suggests_the_permutation_that_goes_with_every_rotation():
    for count in (2, 3, 4, 6):
        angles = 2 * np.pi * np.arange(count) / count
        G = np.stack([np.cos(angles), np.sin(angles), np.full(count, 0.3)])[None]
        turns = suggested(G, np.zeros(count, bool), np.ones(count))
        rotations = [turn for turn in turns if np.allclose(turn.isometry, rotation(360 / count, (0, 0, 1)), atol=1e-6)]
        assert len(rotations) == 1 and len(closed(rotations)) == count - 1
        np.testing.assert_array_equal(rotations[0].moved(), np.roll(np.arange(count), -1))


def test_the_axis_of_a_robot_that_is_tilted_in_the_marker_frame_is_inferred():
    tilt = rotation(20, (0.6, 0.8, 0.0))
    G = tilt @ np.array([[[1.0, 0.0, -1.0, 0.0], [0.0, 1.0, 0.0, -1.0], [0.3] * 4]])
    askew = Turn(tilt @ quarter().outputs @ tilt.T, quarter().inputs)
    plain, inferred = (suggested(G, np.zeros(4, bool), np.ones(4), inferred=each) for each in (False, True))
    assert not any(turn.same(askew) for turn in plain) and any(turn.same(askew) for turn in inferred)


def test_a_reflection_of_the_robot_permutes_its_markers():
    left, right = [[1.0, 0.2], [0.5, 0.7]], [[-0.2, -1.0], [0.7, 0.5]]
    turns = suggested(np.array([[*left, *right]]), np.zeros(2, bool), np.ones(2))
    expected = Turn(on_markers(mirror((1, 0)), (1, 0)), np.eye(2)[::-1])
    assert any(turn.same(expected) for turn in turns)


def test_inputs_of_both_signs_are_renumbered_with_signs():
    G = np.array([[[1.0, 0.0], [0.0, 1.0], [0.0, 0.0]]])
    turn = stated({"angle": 90, "axis": [0, 0, 1], "inputs": ["fy", "-fx"]}, ["fx", "fy"], 3)
    assert any(each.same(turn) for each in suggested(G, np.ones(2, bool), np.ones(2)))
    assert turn.renumbering(["fx", "fy"]) == "fx → fy → −fx"


def test_inputs_of_different_ranges_are_not_permuted():
    G = np.array([[[1.0, 0.0, -1.0, 0.0], [0.0, 1.0, 0.0, -1.0], [0.3] * 4]])
    turns = suggested(G, np.zeros(4, bool), np.array([2.0, 1.0, 1.0, 1.0]))
    assert turns and all(turn.moved()[0] == 0 for turn in turns)


def test_the_response_to_steps_of_a_symmetric_arm_is_symmetric():
    G = response(trial_on()(()).samples)
    assert quarter().missed(G) < 0.1
    assert Turn(np.eye(3), quarter().inputs).missed(G) > 0.5


def test_a_stated_symmetry_is_used_and_a_doubtful_one_is_named():
    symmetric = with_symmetry(trial_on(), QUARTER, CABLES)
    assert len(symmetric.turns) == 3 and symmetric.found.startswith("As stated: A turn by 90°")
    wrong = with_symmetry(trial_on(), {**QUARTER, "angle": -90}, CABLES)
    assert "check the axis" in wrong.found


def test_turned_copies_are_not_used_if_the_best_model_is_better_without_them():
    symmetric = with_symmetry(trial_on((1.2, 1.0, 1.0, 1.0)), "none")
    make = trial_on((1.2, 1.0, 1.0, 1.0))
    forced = Symmetric(make(closed([quarter()])), closed([quarter()]), "A turn.", symmetric.trial)
    forced.trial(FORMS[0])
    kept = forced.kept()
    assert kept.trial is symmetric.trial and not kept.turns and "not used" in kept.found


@pytest.mark.parametrize("change, says", [
    ({"inputs": ["cable2", "cable3", "cable4", "cable9"]}, "cable9.*the inputs are"),
    ({"inputs": ["cable2", "cable3", "cable4", "cable4"]}, "each of the 4 inputs"),
    ({"inputs": ["cable2", "cable1", "cable4", "cable3"]}, "after 4 turns by 90°"),
    ({"angle": 80}, "divide 360"),
    ({"angle": "90"}, "divide 360"),
    ({"axis": [0, 0, 0]}, "three numbers"),
    ({"turn": 4}, "expected angle, axis and inputs")])
def test_a_stated_symmetry_that_makes_no_sense_is_refused(change, says):
    with pytest.raises(ValueError, match=says):
        stated({**QUARTER, **change}, CABLES, 3)


def test_outputs_that_are_no_markers_cannot_be_turned():
    with pytest.raises(ValueError, match="5 outputs are not markers"):
        stated(QUARTER, CABLES, 5)


def test_settings_take_a_symmetry_in_words_or_stated():
    assert SelectionSettings(symmetry=QUARTER).symmetry == QUARTER
    with pytest.raises(ValueError, match="symmetry is 'some'"):
        SelectionSettings(symmetry="some")
