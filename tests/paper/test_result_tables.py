"""Rows of the tables: numbers of known runs and models, in SI units, and nothing where there is no number."""

import math

import numpy as np
import pytest

from ssmr_torch.collection.excitation import SmoothRandom
from ssmr_torch.models.predictors import Predictor
from ssmr_torch.paper.result_tables import MODEL_COLUMNS, RUN_COLUMNS, model_row, note_of, run_row
from ssmr_torch.paper.workspace_errors import map_open_loop
from ssmr_torch.trajectory import Trajectory

ABOUT = {"figure": "fig7", "robot": "trunk", "method": "SSMR", "task": "ASL", "seed": 3, "period": 0.02}
METRICS = {"ise": 1e-5, "rmse": 1e-4, "max_error": 3e-4, "solve_time_median": 4e-4, "solve_time_p99": 0.02,
           "fallbacks": 2.0}


def test_a_run_is_in_real_time_as_long_as_its_period_holds_99_percent_of_its_solve_times():
    row = run_row(ABOUT, METRICS, "runs/record.h5")
    assert tuple(row) == RUN_COLUMNS
    assert row["real_time"] == "true" and row["fallbacks"] == 2 and row["seed"] == 3
    assert run_row(ABOUT, METRICS | {"solve_time_p99": 0.0201}, "")["real_time"] == "false"
    assert run_row(ABOUT | {"period": 0.04}, METRICS | {"solve_time_p99": 0.0201}, "")["real_time"] == "true"


def test_what_a_run_has_no_number_for_is_left_empty():
    row = run_row(ABOUT, METRICS | {"ise": None, "rmse": math.inf}, "runs/record.h5")
    assert row["ise"] is None and row["rmse"] is None and row["violation_ratio"] is None
    assert run_row(ABOUT, METRICS | {"violation_ratio": 0.0, "max_violation": 0.0}, "")["max_violation"] == 0.0


def test_a_model_is_counted_in_whole_numbers():
    cost = {"state_dim": 8.0, "parameters": 1216.0, "decays": 40.0, "controlled_samples": 6000.0, "fit_time": 0.5,
            "step_time": 1e-5}
    row = model_row({"robot": "trunk", "method": "SSMR", "model": "ssmr"}, cost, {"timestep": 0.01, "delays": 1}, "")
    assert tuple(row) == MODEL_COLUMNS
    assert [row[name] for name in ("state_dim", "parameters", "decays", "controlled_samples")] == [8, 1216, 40, 6000]
    assert (row["timestep"], row["delays"], row["fit_time"]) == (0.01, 1, 0.5)


def test_the_note_of_a_model_says_which_found_settings_its_training_took():
    found = {"table": "conf/found/trunk.yaml", "row": "models.ssmr", "date": "2026-11-27", "metric": "validation/rmse",
             "score": 0.1, "trials": 3}
    assert note_of({"provenance": {"configuration": {"found": found}}}) == (
        "found settings: row models.ssmr of conf/found/trunk.yaml, of 2026-11-27 (validation/rmse 0.1; best of 3 "
        "trials).")
    assert note_of({"provenance": {"configuration": {}}}) == ""


def constant(value: float) -> Predictor:
    """Predicts the constant `value`, m."""
    return Predictor(lambda window, window_inputs, inputs: np.full((*inputs.shape[:2], 2), value), 1, 0.01, 0.01, 2, 1)


def test_each_error_of_the_map_belongs_to_the_position_where_its_rollout_started():
    rng = np.random.default_rng(0)
    time = 0.01 * np.arange(300)
    runs = [Trajectory(time, np.repeat(rng.uniform(-1, 1, (1, 2)), 300, axis=0), SmoothRandom()(
        rng, 300, 0.01, np.array([[0.0], [1.0]])), split="test") for _ in range(3)]
    found = map_open_loop({"zero": constant(0.0), "half": constant(0.5)}, runs, outputs=[0, 1], starts=40)
    assert found.position.shape == (40, 2) and set(found.errors) == {"zero", "half"}
    assert found.errors["zero"] == pytest.approx(np.linalg.norm(found.position, axis=1))
    assert found.errors["half"] == pytest.approx(np.linalg.norm(found.position - 0.5, axis=1))
    assert set(found.scores) == {"zero", "half", "persistence", "constant velocity"}
    assert found.scores["persistence"]["50 ms"].mean == pytest.approx(0.0)
