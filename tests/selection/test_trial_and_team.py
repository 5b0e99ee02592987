"""Scores of predictions, and the choice of models that are averaged."""

from dataclasses import replace

import numpy as np
import pytest

from ssmr_torch.models.output_coordinates import ConstantCurvature
from ssmr_torch.selection.closed_form import ClosedForm
from ssmr_torch.selection.folds_and_starts import FOLDS
from ssmr_torch.selection.rollouts import rolled_out
from ssmr_torch.selection.specification import Specification
from ssmr_torch.selection.team import LARGEST, averaged, choose_team, merged
from ssmr_torch.selection.trial import FAR, Trial


@pytest.fixture(scope="module")
def trial(systems):
    return Trial(systems.samples(systems.configuration_affine))


def missing_by(trial, left, apart=(0.0, 0.0, 0.0, 0.0)):
    """Predictions that miss by `left`, scaled, and whose fits differ at double speed by `apart`."""
    truth = [starts.follows / trial.samples.scale for starts in trial.held_out]
    fast = np.zeros_like(trial.fast.follows)
    return [*(true + left for true in truth), *(fast + each for each in apart)]


def test_error_and_spread_are_those_of_hand_made_predictions(trial):
    """A constant error of 0.03 in both outputs, and fits that lie ±0.01 about their mean."""
    found = trial.judged(missing_by(trial, 0.03, (0.01, -0.01, 0.01, -0.01)))
    e, v = 0.03 * np.sqrt(2) / trial.persistence, 0.01 * np.sqrt(2) / trial.persistence
    np.testing.assert_allclose(found.e, e, rtol=1e-6)
    np.testing.assert_allclose(found.v, v, rtol=1e-6)
    assert found.score == pytest.approx(np.mean(0.5 * np.log(e ** 2 + v ** 2)), rel=1e-6)


def test_persistence_is_the_unit_of_the_errors(trial):
    still = [np.broadcast_to(starts.window[:, -1:] / trial.samples.scale, starts.follows.shape)
             for starts in trial.held_out]
    np.testing.assert_allclose(trial.judged([*still, *missing_by(trial, 0.0)[FOLDS:]]).e, 1.0, rtol=1e-9)


def test_a_rollout_that_diverges_scores_infinite_though_it_is_one_of_many(trial):
    predictions = missing_by(trial, 0.01)
    predictions[2][5, -1] = 1e3
    found = trial.judged(predictions)
    assert found.score == np.inf and np.isfinite(found.e).all() and found.e[-1] < FAR


def test_what_cannot_be_fitted_scores_infinite(trial):
    each = Specification(chart="predictive", states=200, delays=3)
    assert trial(each) == np.inf and each not in trial.best()


def test_for_control_only_the_horizons_of_control_are_scored(systems):
    samples = systems.samples()
    all_of_them, long_ones = Trial(samples), Trial(samples, horizons=[1, 2])
    predictions = missing_by(all_of_them, 0.0)
    for each in predictions[:FOLDS]:
        each[:, :samples.horizons[0]] += 0.5
    late = missing_by(all_of_them, 0.02)
    assert long_ones.judged(late).score == pytest.approx(np.log(long_ones.judged(late).e)[1:].mean(), abs=1e-6)
    assert all_of_them.judged(predictions).e[0] > all_of_them.judged(late).e[0]


def test_specifications_that_contain_the_system_score_best_and_predict_held_out_parts(trial):
    right = Specification(memory=("shift", 1), features="configuration_affine", ridge=1e-6)
    forms = [right, replace(right, features="linear"), replace(right, features="bilinear"), replace(right, delays=0)]
    for each in forms:
        trial(each)
    assert trial.best(1, lambda each: each in forms) == [right] and trial.outcomes[right].e.max() < 1e-3


def members(trial, errors):
    """As many specifications with these predictions, the best first."""
    found = {Specification(states=1000 + k): trial.judged(each) for k, each in enumerate(errors)}
    trial.outcomes.update(found)
    return sorted(found, key=lambda each: found[each].score)


def test_two_equal_members_do_not_make_a_team(trial):
    pool = members(trial, [missing_by(trial, 0.03), missing_by(trial, 0.03)])
    assert averaged(trial, pool).score == pytest.approx(trial.outcomes[pool[0]].score, abs=1e-6)
    assert choose_team(trial, pool) == pool[:1]


def test_two_models_with_opposite_errors_are_averaged(trial):
    pool = members(trial, [missing_by(trial, 0.03), missing_by(trial, 0.031), missing_by(trial, -0.032)])
    assert choose_team(trial, pool) == [pool[0], pool[2]]


def test_a_team_has_at_most_four_members_and_for_control_one(trial):
    rng = np.random.default_rng(0)
    noisy = [[each + 0.05 * rng.normal(size=each.shape) for each in missing_by(trial, 0.0)] for _ in range(7)]
    pool = members(trial, noisy)
    assert len(choose_team(trial, pool)) == LARGEST == 4 and choose_team(trial, pool, 1) == pool[:1]


def test_a_merged_model_predicts_the_mean_of_its_members(systems):
    """Members of other windows, memories, charts and output coordinates."""
    arc = ConstantCurvature(((0.01, 0.1),))
    samples = systems.samples(systems.configuration_affine,
                              coordinates={"identity": None, "constant_curvature": arc})
    forms = [Specification(delays=1, memory=("shift", 4), features="configuration_affine"),
             Specification("constant_curvature", delays=3, memory=("shift", 1), features="bilinear"),
             Specification(delays=2, memory=("pole", 0.5), features="linear"),
             Specification("constant_curvature", "predictive", 5, 8, 4, features="quadratic")]
    models = [ClosedForm(samples, each).model(1e-4) for each in forms]
    starts = samples.held_out(0)
    for chosen in ([0], [0, 2], [1], [0, 1], [0, 2, 3]):
        team = [models[k] for k in chosen]
        expected = np.mean([rolled_out(model, starts) for model in team], axis=0)
        one = merged(team)
        np.testing.assert_allclose(rolled_out(one, starts), expected, atol=1e-11 * samples.scale)
        assert one.state_dim == sum(model.state_dim for model in team)
    arcs = [arc.forward(rolled_out(models[k], starts)) for k in (1, 3)]  # of equal coordinates, the mean is of these
    np.testing.assert_allclose(rolled_out(merged([models[1], models[3]]), starts), arc.inverse(np.mean(arcs, axis=0)),
                               atol=1e-11 * samples.scale)
