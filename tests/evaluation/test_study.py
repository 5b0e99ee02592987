"""Studies put jobs and test runs on one axis, and lose none that failed to predict."""

import numpy as np
import pytest

from ssmr_torch.evaluation.study import score_runs, study_rows
from ssmr_torch.models.predictors import Predictor
from ssmr_torch.trajectory import Trajectory

H = 0.01
TIME = H * np.arange(400)


def circle(amplitude, speed, name="", split="test"):
    """Once around in 2π/speed s: rms of ‖y‖ is the amplitude, of ‖dy/dt‖ amplitude · speed (1 − O((speed h)²))."""
    path = amplitude * np.stack([np.cos(speed * TIME), np.sin(speed * TIME)], axis=1)
    return Trajectory(TIME, path, np.zeros((len(TIME), 1)), "controlled", split, name)


def rotation(speed, gain=1.0):
    """Predicts the circle exactly for gain 1, and grows by the gain at every step."""
    def predict(window, window_inputs, inputs):
        step = np.arange(1, inputs.shape[1] + 1)
        turn = (gain * np.exp(1j * speed * H)) ** step
        found = (window[:, -1, 0] + 1j * window[:, -1, 1])[:, None] * turn
        return np.stack([found.real, found.imag], axis=-1)

    return Predictor(predict, 0, H, H)


def test_runs_are_placed_by_their_amplitude_and_speed_relative_to_the_training():
    rows = score_runs("exact", rotation(6.0), [circle(0.02, 3.0, "large"), circle(0.01, 6.0, "fast")],
                      [circle(0.01, 3.0, split="train")])
    placed = {row["run"]: (row["amplitude"], row["speed"]) for row in rows if row["model"] == "exact"}
    assert placed["large"] == pytest.approx((2.0, 2.0), rel=1e-3)
    assert placed["fast"] == pytest.approx((1.0, 2.0), rel=1e-3)


def test_every_run_has_its_own_score_beside_that_of_persistence():
    slow, fast = circle(0.01, 3.0, "slow"), circle(0.01, 6.0, "fast")
    rows = {(row["model"], row["run"]): row for row in score_runs("exact", rotation(6.0), [slow, fast], [slow])}
    assert rows["exact", "fast"]["1 s"] < 1e-12 < 1e-4 < rows["exact", "slow"]["1 s"]
    chords = 2 * 0.01 * np.sin(0.5 * 6.0 * H * np.arange(1, 6))
    assert rows["persistence", "fast"]["50 ms"] == pytest.approx(np.sqrt((chords ** 2).mean()), rel=1e-9)


def test_a_run_on_which_rollouts_diverge_has_no_mean_and_says_so():
    run = circle(0.01, 6.0, "run")
    row = next(row for row in score_runs("wild", rotation(6.0, 1.1), [run], [run]) if row["model"] == "wild")
    assert row["1 s"] is None and row["diverged"] == 1.0 and row["50 ms"] > 0


def job(name, overrides, **metrics):
    return {"name": name, "overrides": overrides, "metrics": {f"test/{key}": value for key, value in metrics.items()}}


def test_a_study_of_an_override_has_the_jobs_test_scores_over_its_values():
    results = [job("SSMR", ["model=ssmr", "module.decays=20"], rmse=2.0, rmse_50ms=0.2, rmse_200ms=0.7, diverged=0.0),
               job("SSMR", ["model=ssmr", "module.decays=5"], rmse=None, rmse_50ms=0.3, rmse_200ms=None, diverged=0.1),
               {"name": "SSMR", "overrides": ["module.decays=1"], "metrics": {"failed": "too few"}}]
    assert study_rows(results, "module.decays") == [
        {"model": "SSMR", "module.decays": 5.0, "50 ms": 0.3, "200 ms": None, "1 s": None, "diverged": 0.1},
        {"model": "SSMR", "module.decays": 20.0, "50 ms": 0.2, "200 ms": 0.7, "1 s": 2.0, "diverged": 0.0}]


def test_a_study_over_test_runs_keeps_every_model_and_each_baseline_once():
    def result(name):
        return {"name": name, "overrides": [], "metrics": {}, "runs": [
            {"model": model, "run": "a", "speed": 2.0, "50 ms": 1.0} for model in (name, "persistence")]}

    rows = study_rows([result("SSMR"), result("EDMD")], "speed")
    assert [(row["model"], row["speed"]) for row in rows] == [("EDMD", 2.0), ("SSMR", 2.0), ("persistence", 2.0)]
