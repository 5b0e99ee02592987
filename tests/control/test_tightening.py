"""Claims about margins from held-out runs."""

from dataclasses import replace

import numpy as np
import pytest

from ssmr_torch.closed_loop import simulate
from ssmr_torch.control.mpc import ModelPredictiveController
from ssmr_torch.control.tightening import prediction_margins
from ssmr_torch.tasks.obstacles import Circle
from ssmr_torch.tasks.references import figure_eight
from ssmr_torch.trajectory import Trajectory


def run_of(model, bench, samples=600, seed=0):
    """The plant under inputs that change every tenth sample."""
    rng, plant = np.random.default_rng(seed), bench.ModelPlant(model)
    inputs = np.repeat(rng.uniform(0, 0.3, (samples // 10, 4)), 10, axis=0)
    observation = [plant.reset(), *(plant.step(u) for u in inputs[:-1])]
    return Trajectory(0.01 * np.arange(samples), np.stack(observation), inputs)


def test_a_model_that_is_right_needs_no_margin_and_one_that_is_wrong_more_of_it_further_ahead(bench):
    model = bench.oscillators()
    run = run_of(model, bench)
    exact = prediction_margins(replace(model, substeps=4), [run], (0, 1), horizon=5, period=0.02)
    wrong = prediction_margins(bench.perturbed(model, 0.03), [run], (0, 1), horizon=5, period=0.02)
    assert exact.shape == (5,) and exact.max() < 1e-12
    assert (np.diff(wrong) >= 0).all() and wrong[0] > 1e-6 and wrong[-1] > 2 * wrong[0]


def test_the_margin_is_the_quantile_of_the_errors_of_prediction(bench):
    model, off = bench.oscillators(), bench.perturbed(bench.oscillators(), 0.03)
    run, errors = run_of(model, bench), []
    for start in range(0, 600 - 6, 5):
        state = off.encode(run.observation[start:start + 1], run.input[:0])
        states = off.states(state, run.input[start:start + 6])
        errors.append(np.linalg.norm(states[6, :2] - run.observation[start + 6, :2]))
    found = prediction_margins(off, [run], (0, 1), horizon=3, period=0.02, quantile=0.9)
    assert found[2] == pytest.approx(np.quantile(errors, 0.9), rel=1e-12)


def test_with_margins_a_wrong_model_stays_out_of_the_obstacle_that_it_enters_without(bench):
    model, wrong = bench.oscillators(), bench.perturbed(bench.oscillators(), 0.05)
    circle = Circle((0.0106, -0.0125), 0.004)
    task, depth = replace(figure_eight(laps=1.0), obstacles=(circle,)), []
    margins = prediction_margins(wrong, [run_of(model, bench)], (0, 1), horizon=5, period=0.02, quantile=0.99)
    for given in (None, margins):
        controller = ModelPredictiveController(wrong, task, bench.BOUNDS, margins=given)
        record = simulate(bench.ModelPlant(model), controller, task)
        depth.append(-circle.clearance(record.time, record.observation[:, :2]).min())
    assert depth[0] > 1e-5 and depth[1] < 0.5 * depth[0]


def test_runs_that_are_too_short_and_quantiles_that_are_none_are_refused(bench):
    model = bench.oscillators()
    with pytest.raises(ValueError, match="no run is long enough"):
        prediction_margins(model, [run_of(model, bench, 10)], (0, 1), horizon=5, period=0.02)
    with pytest.raises(ValueError, match="between 0 and 1"):
        prediction_margins(model, [run_of(model, bench)], (0, 1), horizon=5, period=0.02, quantile=1.0)
