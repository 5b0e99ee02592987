"""Open-loop scores of models and baselines whose errors are known in closed form."""

import json
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
import torch

from ssmr_torch.data.starts import draw_starts
from ssmr_torch.evaluation.comparison_tables import format_table
from ssmr_torch.evaluation.measured_rollouts import predict_trajectory
from ssmr_torch.evaluation.open_loop import compare_open_loop, score_open_loop
from ssmr_torch.models.predictors import Predictor, constant_velocity, persistence
from ssmr_torch.models.ssmr import SSMR
from ssmr_torch.trajectory import Trajectory, TrajectoryDataset

DT = 0.01


def run(observation, inputs=None, timestep=DT, **labels):
    observation = np.asarray(observation, dtype=float).reshape(len(observation), -1)
    inputs = np.zeros((len(observation), 1)) if inputs is None else inputs
    return Trajectory(timestep * np.arange(len(observation)), observation, inputs, **labels)


def line(samples, velocity=(0.3, -0.4), start=(0.0, 0.0)):
    """Straight motion at constant velocity, m/s."""
    return run(np.asarray(start) + DT * np.arange(samples)[:, None] * np.asarray(velocity))


def scalar_model(rate=0.0, gain=0.0, delays=0, timestep=DT, **options):
    """dz/dt = rate z + gain u, y = z, in one dimension, with the newest sample as chart."""
    model = SSMR(1, 1, 1, delays, control_degree=0, timestep=timestep, substeps=1, **options)
    with torch.no_grad():
        model.chart[0, -1] = 1.0
        model.parametrization[-1, 0] = 1.0
        model.drift_table[0, 0] = rate
        model.control_table[0, 0] = gain
    return model


def exponential(samples, rate=-2.0, start=1.0):
    return run(start * np.exp(rate * DT * np.arange(samples)))


def test_a_model_with_the_right_dynamics_errs_by_the_integrator_only():
    score = score_open_loop(scalar_model(rate=-2.0), [exponential(300)])
    for part in score.horizons:
        assert part.diverged == 0.0
        assert part.mean < 1e-8


def test_the_error_of_a_linear_model_is_the_closed_form():
    """y stays at 1, the model decays: e_k = 1 − a^k with a the Runge-Kutta factor of −2 DT."""
    h = -2.0 * DT
    k = np.arange(1, 21)
    factor = 1 + h + h ** 2 / 2 + h ** 3 / 6 + h ** 4 / 24
    expected = np.sqrt(np.mean((1 - factor ** k) ** 2))
    score = score_open_loop(scalar_model(rate=-2.0), [run(np.ones(300))], horizons=(0.2,))["200 ms"]
    np.testing.assert_allclose(score.errors, expected, rtol=1e-12)
    assert (score.mean, score.median, score.p95) == pytest.approx((expected,) * 3)
    np.testing.assert_allclose(score.output_errors[:, 0], expected, rtol=1e-12)


def test_an_input_acts_from_its_own_sample_on():
    """dy/dt = u: the model that sums the inputs is exact; one that saw them a sample late would not be."""
    inputs = np.random.default_rng(1).normal(size=(200, 1))
    observation = DT * np.concatenate([[0.0], np.cumsum(inputs[:-1])])
    assert score_open_loop(scalar_model(gain=1.0), [run(observation, inputs)])["1 s"].mean < 1e-12
    late = run(observation, np.roll(inputs, 1, axis=0))
    assert score_open_loop(scalar_model(gain=1.0), [late])["1 s"].mean > 1e-3


def test_persistence_on_a_ramp_errs_by_the_root_mean_square_of_the_distance_covered():
    """e_k = k DT v, so that the error is DT ‖v‖ √((H + 1)(2 H + 1) / 6)."""
    score = score_open_loop(persistence(DT), [line(400), line(250)])
    for label, steps in (("50 ms", 5), ("200 ms", 20), ("1 s", 100)):
        expected = DT * 0.5 * np.sqrt((steps + 1) * (2 * steps + 1) / 6)
        np.testing.assert_allclose(score[label].errors, expected, rtol=1e-9)


def test_constant_velocity_is_exact_on_a_straight_line():
    score = score_open_loop(constant_velocity(DT), [line(400), line(250, velocity=(-1.0, 0.2))])
    assert max(part.errors.max() for part in score.horizons) < 1e-12


@pytest.mark.slow
def test_the_order_of_the_trajectories_does_not_change_an_error_and_a_block_holds_any_batch(monkeypatch):
    rng = np.random.default_rng(2)
    runs = [run(np.cumsum(rng.normal(size=(150 + 10 * i, 1)), axis=0), rng.normal(size=(150 + 10 * i, 1)))
            for i in range(3)]
    model = scalar_model(rate=-2.0, gain=0.5)
    options = {"starts": 10 ** 6, "horizons": (0.05, 0.2)}
    forward, backward = score_open_loop(model, runs, **options), score_open_loop(model, runs[::-1], **options)
    for one, other in zip(forward.horizons, backward.horizons):
        np.testing.assert_allclose(np.sort(one.errors), np.sort(other.errors), rtol=1e-12)
    monkeypatch.setattr("ssmr_torch.evaluation.open_loop.SAMPLES_PER_BLOCK", 50)
    for one, other in zip(forward.horizons, score_open_loop(model, runs, **options).horizons):
        np.testing.assert_allclose(one.errors, other.errors, rtol=1e-12)


def test_the_torch_model_and_its_tables_get_the_same_score():
    rng = np.random.default_rng(3)
    model = SSMR(4, 2, 2, 1, dynamics_degree=3, parametrization_degree=2)
    with torch.no_grad():
        for table in model.parameters():
            table.copy_(torch.from_numpy(0.1 * rng.normal(size=table.shape)))
    data = [run(0.1 * rng.normal(size=(180, 2)), rng.normal(size=(180, 2)))]
    one, other = score_open_loop(model, data), score_open_loop(model.reduced.numpy(), data)
    for left, right in zip(one.horizons, other.horizons):
        np.testing.assert_allclose(left.errors, right.errors, rtol=1e-10)


@pytest.mark.parametrize("as_tables", [False, True])
def test_a_diverging_model_has_diverged_everywhere_and_its_mean_is_infinite(as_tables):
    model = scalar_model(rate=200.0)
    score = score_open_loop(model.reduced.numpy() if as_tables else model, [exponential(300)], horizons=(1.0,))
    for part in score.horizons:
        assert part.diverged == 1.0
        assert part.mean == part.median == part.p95 == part.mean_of_survivors == np.inf
        assert part.as_dict()["mean"] is None
    assert "∞ (100 %)" in format_table({"unstable": score})


@pytest.mark.parametrize("as_tables", [False, True])
def test_a_rollout_that_the_model_itself_flags_has_diverged_although_its_prediction_is_close(as_tables):
    model = scalar_model()
    model.state_scale.fill_(1e-3)
    model = model.reduced.numpy() if as_tables else model
    score = score_open_loop(model, [run(np.ones(150))], horizons=(0.05,))
    assert score["50 ms"].diverged == 1.0
    time, outputs = predict_trajectory(model, run(np.ones(150)))
    assert np.isinf(outputs).all() and len(time) == len(outputs) == 149


def test_the_mean_of_rollouts_that_did_not_diverge_has_its_own_name():
    """Starts at y = 1 blow up (prediction 11 > 10 max‖y‖), starts at y = 0 err by 0.5."""
    def predict(window, window_inputs, inputs):
        return np.repeat(np.where(window[:, -1:] > 0.5, 11.0, 0.5), inputs.shape[1], axis=1)

    halves = [run(np.zeros(111)), run(np.ones(111))]
    part = score_open_loop(Predictor(predict, 0, DT, DT), halves, horizons=(0.1,))["100 ms"]
    assert (part.diverged, part.mean, part.mean_of_survivors) == (0.5, np.inf, 0.5)
    summary = part.as_dict()
    assert (summary["mean"], summary["p95"], summary["mean_of_survivors"]) == (None, None, 0.5)
    assert summary["mean_per_output"] == [None]


def test_nan_counts_as_diverged():
    nan = Predictor(lambda window, _, inputs: np.full((len(window), inputs.shape[1], 1), np.nan), 0, DT, DT)
    assert score_open_loop(nan, [run(np.ones(150))])["full"].diverged == 1.0


def test_windows_inputs_and_measurements_of_a_start_are_consecutive_and_never_cross_an_end():
    """Every sample carries its trajectory and index; the predictor checks what it is shown."""
    lengths = (40, 31, 57)
    runs = [run(1000 * i + np.arange(n), (1000.0 * i + np.arange(n))[:, None]) for i, n in enumerate(lengths)]
    seen = []

    def predict(window, window_inputs, inputs):
        newest = window[:, -1, 0]
        np.testing.assert_array_equal(window[..., 0], newest[:, None] + np.arange(-3, 1))
        np.testing.assert_array_equal(window_inputs[..., 0], newest[:, None] + np.arange(-3, 0))
        if inputs.shape[1] == 20:
            np.testing.assert_array_equal(inputs[..., 0], newest[:, None] + np.arange(20))
            seen.extend(newest)
        return newest[:, None, None] + np.arange(1, inputs.shape[1] + 1)[:, None]

    score = score_open_loop(Predictor(predict, 3, DT, DT), runs, horizons=(0.2,))
    assert score["200 ms"].mean == 0.0 and score["full"].mean == 0.0
    assert sorted(seen) == [1000 * i + k for i, n in enumerate(lengths) for k in range(3, n - 20)]


def test_starts_are_distinct_admissible_reproducible_and_uniform():
    lengths = np.array([50, 5, 200])
    owner, sample = draw_starts(lengths, margin=4, span=20, count=60, seed=7)
    assert len(set(zip(owner, sample))) == 60 and 1 not in owner
    assert (sample >= 4).all() and (sample + 20 < lengths[owner]).all()
    np.testing.assert_array_equal(sample, draw_starts(lengths, 4, 20, 60, seed=7)[1])
    shares = [np.mean(draw_starts(lengths, 4, 20, 60, seed)[0] == 0) for seed in range(300)]
    assert np.mean(shares) == pytest.approx(26 / (26 + 176), abs=0.01)


def test_all_admissible_starts_are_taken_once_where_there_are_fewer_than_asked():
    owner, sample = draw_starts(np.array([10, 12]), margin=1, span=5, count=500, seed=0)
    assert list(zip(owner, sample)) == [(0, k) for k in range(1, 5)] + [(1, k) for k in range(1, 7)]


def test_models_of_any_delay_and_timestep_and_the_baselines_share_their_starts():
    """On y = t² every start has its own persistence error, so that equal errors mean equal starts."""
    parabola = run((DT * np.arange(400)) ** 2)
    models = {f"{d} delays": replace(persistence(DT), delays=d) for d in (0, 2, 7)}
    models["window of 3 x 40 ms"] = replace(persistence(DT), delays=3, window_timestep=4 * DT)
    scores = compare_open_loop(models, [parabola], starts=50, seed=3)
    assert {score.margin for score in scores.values()} == {12}
    assert set(scores) == {*models, "persistence", "constant velocity"}
    for label in ("50 ms", "200 ms", "1 s", "full"):
        for name in models:
            np.testing.assert_array_equal(scores[name][label].errors, scores["persistence"][label].errors)


def drift(step, model_timestep, initial=None):
    """ŷ_k = y_0 + k step, once per `model_timestep`, whatever the inputs."""
    def predict(window, window_inputs, inputs):
        return window[:, -1:] + np.arange(1, inputs.shape[1] + 1)[:, None] * np.asarray(step)

    return Predictor(predict, 0, model_timestep, DT, initial=initial)


@pytest.mark.parametrize("stride", [2, 5, 20])
def test_models_of_any_step_are_compared_at_every_sample_and_agree_where_the_motion_is_straight(stride):
    """Both predict 0.1 m/s where the robot moves at 0.3: they err by the same at the same 23 instants."""
    fine, coarse = (score_open_loop(drift([0.1 * DT * n, -0.4 * DT * n], n * DT), [line(100)], horizons=(0.05, 0.23))
                    for n in (1, stride))
    for one, other in zip(fine.horizons, coarse.horizons):
        assert (one.steps, one.duration) == (other.steps, other.duration)
        np.testing.assert_allclose(one.errors, other.errors, rtol=1e-9)
    assert (coarse["230 ms"].steps, coarse["230 ms"].duration) == (23, pytest.approx(0.23))


def test_a_model_of_long_steps_has_an_error_between_them():
    """dy/dt = −2 y by steps of 0.1 s, exact at its own: in between the error is that of a chord of e^{−2t}."""
    inside = np.arange(1, 100) / 10
    low, high = np.exp(-0.2 * np.floor(inside)), np.exp(-0.2 * np.ceil(inside))
    chord = low + (inside - np.floor(inside)) * (high - low) - np.exp(-0.2 * inside)
    expected = np.sqrt(np.append(chord, 0.0) @ np.append(chord, 0.0) / 100)
    found = score_open_loop(scalar_model(rate=-2.0, timestep=10 * DT), [exponential(102)], horizons=(1.0,))["1 s"]
    assert found.errors[0] == pytest.approx(expected * np.exp(-2.0 * DT), rel=1e-2)


def test_between_the_start_and_the_first_step_a_model_is_seen_from_its_own_initial_output():
    """A chart that misses y_0 by 1 m and is right at its steps of 4 samples errs by 3/4, 2/4, 1/4, 0."""
    off = drift([0.0], 4 * DT, initial=lambda window, window_inputs: window[:, -1] + 1.0)
    found = score_open_loop(off, [run(np.ones(60))], horizons=(0.04,))["40 ms"]
    np.testing.assert_allclose(found.errors, np.sqrt((9 + 4 + 1) / 16 / 4), rtol=1e-12)


def test_a_step_sees_the_mean_of_its_inputs_and_none_after_the_horizon():
    """y sums the inputs of each sample. Steps of 4 in a horizon of 6: the second one holds its second input to its end.
    """
    inputs = np.random.default_rng(4).normal(size=(40, 1))
    seen = []

    def predict(window, window_inputs, given):
        seen.append(given)
        return np.zeros((len(given), given.shape[1], 1))

    score_open_loop(Predictor(predict, 0, 4 * DT, DT), [run(np.ones(40), inputs)], horizons=(0.06,), starts=10**6)
    starts = np.arange(1, 34)
    np.testing.assert_allclose(seen[0][:, 0, 0], [inputs[k:k + 4].mean() for k in starts])
    np.testing.assert_allclose(seen[0][:, 1, 0], [(inputs[k + 4, 0] + 3 * inputs[k + 5, 0]) / 4 for k in starts])


def test_the_noise_of_the_loop_is_on_the_windows_only_and_the_clean_score_stays_what_it_was():
    """Persistence at a robot at rest errs by nothing, with noise by what is on the newest sample, all the horizon long:
    √(chi² of two outputs), on average σ √(π/2).
    """
    runs, sigma = [run(np.zeros((3000, 2)) + 1.0)], 0.02
    plain = score_open_loop(persistence(DT), runs, starts=2000)
    score = score_open_loop(persistence(DT), runs, starts=2000, noise=sigma)
    assert score["200 ms"].mean == plain["200 ms"].mean == 0.0 and plain.noisy is None
    assert score.noisy["200 ms"].mean == pytest.approx(sigma * np.sqrt(np.pi / 2), rel=0.05)
    assert score.noisy.noise == sigma and score.as_dict()["noisy"]["noise"] == sigma
    again = score_open_loop(persistence(DT), runs, starts=2000, noise=sigma)
    np.testing.assert_array_equal(score.noisy["1 s"].errors, again.noisy["1 s"].errors)
    with pytest.raises(ValueError, match="noise is -0.1 m; expected a positive standard deviation"):
        score_open_loop(persistence(DT), runs, noise=-0.1)


def test_all_models_see_the_same_noise_from_the_same_starts():
    scores = compare_open_loop({"again": persistence(DT)}, [line(300)], noise=0.01)
    for label in ("50 ms", "full"):
        np.testing.assert_array_equal(scores["again"].noisy[label].errors, scores["persistence"].noisy[label].errors)
        assert (scores["again"].noisy[label].sample == scores["again"][label].sample).all()


def test_the_normalized_mean_trajectory_error_is_the_mean_distance_over_the_largest_size_of_the_run():
    """‖y‖ rises from 0 to 0.5 · 3.99 m; persistence is off by k DT 0.5 m, on average DT 0.5 (H + 1) / 2."""
    found = score_open_loop(persistence(DT), [line(400)], horizons=(0.2,))["200 ms"]
    np.testing.assert_allclose(found.trajectory_errors, DT * 0.5 * 21 / 2 / (0.5 * 3.99), rtol=1e-9)
    assert found.nmte == found.as_dict()["nmte"] == pytest.approx(DT * 21 / 2 / 3.99)
    assert score_open_loop(scalar_model(rate=200.0), [exponential(300)])["1 s"].nmte == np.inf


@pytest.mark.parametrize("timestep, shown", [(0.015, "1.5 times"), (0.004, "0.4 times"),
                                             (0.0201, "2.01 times")])
def test_a_timestep_that_is_no_multiple_of_the_sampling_time_is_refused(timestep, shown):
    with pytest.raises(ValueError, match=shown):
        score_open_loop(scalar_model(timestep=timestep), [exponential(200)])
    with pytest.raises(ValueError, match="window_timestep"):
        score_open_loop(scalar_model(window_timestep=timestep), [exponential(200)])


def test_full_rollouts_end_with_their_trajectory():
    """e_k = k DT ‖v‖ up to each trajectory's own last sample."""
    lengths = np.array([400, 120, 250])
    full = score_open_loop(persistence(DT), [line(n) for n in lengths])["full"]
    steps = lengths - 2
    np.testing.assert_allclose(full.errors, DT * 0.5 * np.sqrt((steps + 1) * (2 * steps + 1) / 6), rtol=1e-9)
    assert full.steps == 398


def test_trajectories_shorter_than_the_horizon_are_skipped_and_counted():
    score = score_open_loop(persistence(DT), [line(400), line(50), line(2)])
    assert [part.skipped for part in score.horizons] == [1, 1, 2, 1]
    assert score["1 s"].as_dict()["skipped_trajectories"] == 2


def test_a_horizon_that_no_trajectory_holds_is_refused_with_both_numbers():
    with pytest.raises(ValueError, match="80 samples.*102 in all"):
        score_open_loop(persistence(DT), [line(50), line(80)])


def test_a_horizon_shorter_than_a_sample_is_refused_and_one_shorter_than_a_step_is_interpolated():
    with pytest.raises(ValueError, match="shorter than the sampling time"):
        score_open_loop(persistence(DT), [line(400)], horizons=(0.5 * DT,))
    fine, coarse = (score_open_loop(persistence(n * DT), [line(400)], horizons=(0.05,)) for n in (1, 10))
    np.testing.assert_array_equal(fine["50 ms"].errors, coarse["50 ms"].errors)


def test_a_margin_shorter_than_the_window_is_refused():
    with pytest.raises(ValueError, match="margin is 2 samples, but the model needs 5"):
        score_open_loop(scalar_model(delays=5), [exponential(200)], margin=2)


def test_columns_that_the_model_was_not_fitted_to_are_refused():
    with pytest.raises(ValueError, match="2 outputs, the model 1"):
        score_open_loop(scalar_model(), [line(200)])
    with pytest.raises(ValueError, match="indices from 0 to 1"):
        score_open_loop(persistence(DT), [line(200)], outputs=(2,))


def test_selected_outputs_are_the_only_ones_compared():
    score = score_open_loop(persistence(DT), [line(400, velocity=(0.0, 1.0))], outputs=(0,))
    assert score["1 s"].mean == 0.0 and score.as_dict()["outputs"] == [0]


def test_no_trajectory_or_trajectories_of_different_sampling_time_are_refused():
    with pytest.raises(ValueError, match="no trajectory"):
        score_open_loop(persistence(DT), [])
    with pytest.raises(ValueError, match="0.01 to 0.02 s"):
        score_open_loop(persistence(DT), [line(200), run(np.ones(200), timestep=0.02)])


def test_stored_trajectories_score_as_those_in_memory(tmp_path):
    data = TrajectoryDataset([line(300), line(150)], np.zeros(2), ("x", "y"), ("u",))
    stored = TrajectoryDataset.load(data.save(tmp_path / "runs.h5"))
    from_file, from_memory = (score_open_loop(persistence(DT), runs) for runs in (stored, data))
    assert from_file.as_dict() == from_memory.as_dict()


def test_the_summary_is_valid_json_even_when_everything_diverged():
    score = score_open_loop(scalar_model(rate=200.0), [exponential(300)])
    assert json.loads(json.dumps(score.as_dict(), allow_nan=False))["horizons"][2]["diverged"] == 1.0


def test_the_table_shows_millimetres_and_refuses_scores_of_different_starts():
    scores = compare_open_loop({}, [line(400)])
    lines = format_table(scores).splitlines()
    assert lines[0].split() == ["model", *"50 ms 200 ms 1 s full".split()]
    distance = DT * 0.5 * np.sqrt(6 * 11 / 6) * 1e3
    assert lines[2].split()[:2] == ["persistence", f"{distance:.3g}"]
    other = score_open_loop(persistence(DT), [line(400)], margin=9)
    with pytest.raises(ValueError, match="compare_open_loop"):
        format_table({**scores, "other": other})


def test_scores_of_numpy_models_need_no_torch():
    code = ("import sys, ssmr_torch.evaluation.open_loop, ssmr_torch.evaluation.metrics; "
            "sys.exit('torch' in sys.modules)")
    assert subprocess.run([sys.executable, "-c", code]).returncode == 0
