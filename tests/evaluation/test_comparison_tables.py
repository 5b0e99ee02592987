"""The table that compares many models."""

import json

import numpy as np
import pytest

from ssmr_torch.evaluation.comparison_tables import (
    comparison_table,
    difference,
    format_groups,
    format_table,
    marks,
    stored,
)
from ssmr_torch.evaluation.horizon_scores import HorizonScore, OpenLoopScore
from ssmr_torch.evaluation.open_loop import compare_open_loop
from ssmr_torch.evaluation.run_groups import compare_groups
from ssmr_torch.models.predictors import Predictor
from ssmr_torch.trajectory import Trajectory

DT = 0.01


def score(*errors):
    parts = [HorizonScore(label, 5, 0.05, np.array(values), np.array(values)[:, None], 0)
             for label, values in zip(("50 ms", "full"), errors)]
    return OpenLoopScore(tuple(parts), 1, 0, (0,))


def test_means_and_medians_are_in_millimetres_and_divergence_is_never_averaged_away():
    text = comparison_table({"good": score([1e-3, 3e-3, 5e-3], [2e-3]), "wild": score([1e-3, np.inf, 2e-3], [np.inf])},
                            {"good": {"state_dim": 6.0, "parameters": 240.0, "fit_time": 1.234}})
    rows = [[cell.strip() for cell in line.strip("|").split("|")] for line in text.splitlines()]
    assert rows[0] == ["model", "50 ms", "full", "diverged", "n", "parameters", "fit (CPU)"]
    assert rows[2] == ["good", "3 / 3", "2 / 2", "0 %", "6", "240", "1.23 s"]
    assert rows[3] == ["wild", "∞ / 2", "∞ / ∞", "100 %", "–", "–", "–"]


def run(observation, name="", kind="controlled"):
    time, inputs = DT * np.arange(len(observation)), np.zeros((len(observation), 1))
    return Trajectory(time, observation, inputs, kind, "test", name)


def off_by(size):
    """A predictor that is off by a distance of `size` m everywhere, to a side that its start decides."""
    def predict(window, window_inputs, inputs):
        side = np.sign(np.sin(1e6 * window[:, -1:, :1]))
        return window[:, -1:] + size * np.concatenate([side, 0 * side], axis=2) + 0 * inputs[:, :, :1]

    return Predictor(predict, 0, DT, DT)


def test_two_copies_of_a_model_are_tied_and_one_that_is_clearly_better_stands_alone():
    """The robot rests, so that the errors are the sizes: 1, 1 and 2 mm."""
    resting = [run(np.ones((2000, 2)))]
    scores = compare_open_loop({"one": off_by(1e-3), "copy": off_by(1e-3), "worse": off_by(2e-3)}, resting)
    without = {name: scores[name] for name in ("one", "copy", "worse")}
    found = marks(without)
    assert [found[name]["200 ms"] for name in without] == ["*", "=", ""]
    assert all(not each["full"] for each in found.values())  # one rollout tells nothing
    assert difference(without, "worse", "one", "1 s") == pytest.approx((1e-3, 1e-3, 1e-3))
    table = format_table(without)
    assert [line.split()[-1] for line in table.splitlines()[2:5]] == ["%]"] * 3 and "tie, because" in table
    assert [cell.split()[-1] for cell in comparison_table(without, {}).splitlines()[3].split("|")[2:4]] == ["=", "="]


def test_a_difference_that_lies_in_one_second_of_the_recording_is_a_tie():
    """Of the 20 s one model errs in the first only: many neighbouring starts, but one piece of evidence."""
    ramp = np.stack([np.arange(2000.0), np.zeros(2000)], axis=1)

    def predict(window, window_inputs, inputs):
        wrong = 1e-2 * (window[:, -1:, :1] < 100) * [[[0.0, 1.0]]]
        return window[:, -1:] + np.arange(1, inputs.shape[1] + 1)[:, None] * [1.0, 0.0] + wrong

    def right(window, window_inputs, inputs):
        return window[:, -1:] + np.arange(1, inputs.shape[1] + 1)[:, None] * [1.0, 0.0] + [0.0, 1e-4]

    models = {"right": Predictor(right, 0, DT, DT), "once wrong": Predictor(predict, 0, DT, DT)}
    scores = compare_open_loop(models, [run(ramp)], horizons=(0.05,), starts=1500)
    kept = {name: scores[name] for name in models}
    assert kept["right"]["50 ms"].mean < kept["once wrong"]["50 ms"].mean
    assert marks(kept)["once wrong"]["50 ms"] == "="
    assert difference(kept, "once wrong", "right", "50 ms").low < 0


def test_a_model_that_diverged_from_one_start_is_no_tie():
    def predict(window, window_inputs, inputs):
        outputs = np.repeat(window[:, -1:], inputs.shape[1], axis=1)
        outputs[0] = np.inf
        return outputs

    scores = compare_open_loop({"once lost": Predictor(predict, 0, DT, DT)}, [run(np.ones((1500, 2)))],
                               horizons=(0.05,))
    assert marks(scores)["once lost"]["50 ms"] == "" and marks(scores)["persistence"]["50 ms"] == "*"
    assert np.isinf(difference(scores, "once lost", "persistence", "50 ms").mean)


def test_with_noise_every_model_has_a_second_row_that_is_ranked_separately():
    scores = compare_open_loop({"mine": off_by(1e-3)}, [run(np.ones((1500, 2)))], noise=1e-3)
    rows = [line.split("|")[1].strip() for line in comparison_table(scores, {}).splitlines()[2:]]
    assert rows[:4] == ["mine", "mine, noise 1 mm", "persistence", "persistence, noise 1 mm"]
    assert marks({name: score.noisy for name, score in scores.items()})["persistence"]["50 ms"] == "*"


def test_runs_of_one_name_are_a_group_and_decays_are_never_pooled_with_controlled_runs():
    """Persistence is off by nothing on runs at rest, by the ramp on those that move, and pooled by both."""
    still, ramp = np.ones((400, 2)), np.cumsum(np.full((400, 2), 1e-3), axis=0)
    runs = [run(still, "fast-1"), run(still, "fast-2"), run(ramp, "slow-1"), run(ramp, "release 1", "decay"),
            run(ramp[:40], "set point", "static")]
    found = compare_groups({}, runs, horizons=(0.05, 1.0), starts=300)
    assert list(found.groups) == ["fast", "slow", "all controlled", "decays", "static"]
    assert found.sizes == {"fast": 2, "slow": 1, "all controlled": 3, "decays": 1, "static": 1} and found.size == 3
    fast, slow, both = (found.groups[name]["persistence"]["1 s"] for name in ("fast", "slow", "all controlled"))
    assert fast.mean == 0 and slow.mean > 0 and len(fast.errors) + len(slow.errors) == len(both.errors) == 300
    assert both.mean == pytest.approx(len(slow.errors) / 300 * slow.mean) == found.scores["persistence"]["1 s"].mean
    assert len(found.groups["decays"]["persistence"]["1 s"].errors) == 299  # every sample with a second after it
    assert [part.label for part in found.groups["static"]["persistence"].horizons] == ["50 ms", "full"]
    text = format_groups(found)
    assert "fast, 2 runs\n" in text and text.count("persistence") == 5
    plain = stored(found)
    assert set(plain["groups"]) == set(found.groups) and json.loads(json.dumps(plain, allow_nan=False))


def test_kinds_of_runs_shorter_than_every_horizon_are_left_out_with_a_note():
    runs = [run(np.ones((400, 2)), "a"), run(np.ones((20, 2)), "release 1", "decay")]
    found = compare_groups({}, runs, horizons=(0.5,))
    assert found.left_out == ("decay",) and list(found.groups) == ["a"]
    with pytest.raises(ValueError, match="the longest of 1 trajectories has 20 samples"):
        compare_groups({}, runs[1:], horizons=(0.5,))
