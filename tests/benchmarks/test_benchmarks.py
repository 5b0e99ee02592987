"""The benchmarks of control run in miniature, and agree on what they compute; none of their times is judged."""

from functools import partial

import numpy as np
import pytest

from ssmr_torch.benchmarks import comparison, endurance, obstacles, scaling
from ssmr_torch.benchmarks import tracking_instance as instance
from ssmr_torch.benchmarks.machine import in_words, machine
from ssmr_torch.benchmarks.table import BenchmarkFailed

LAPS = 0.7  # the least that leaves room to speed up and slow down, 105 control steps


def test_the_machine_is_told_with_its_load_threads_and_versions():
    text = in_words(machine())
    assert "cores" in text and "OMP_NUM_THREADS" in text and "numpy" in text and "load" in text


def test_the_comparison_has_a_row_per_solver_the_first_as_the_measure_and_says_what_it_left_out():
    pytest.importorskip("quadprog", reason="quadprog is not installed: pip install 'ssmr_torch[benchmarks]'")
    first, second, left_out = comparison.rows(horizons=[3], laps=LAPS,
                                              solvers=["proxqp", "qpsolvers:quadprog", "acados"])
    assert (first["N"], first["solver"], first["times the first"], first["failures"]) == (3, "proxqp", 1.0, 0)
    assert second["solver"] == "qpsolvers:quadprog" and second["steps"] == first["steps"]
    assert left_out.startswith("acados left out: ")


def test_a_solver_that_is_none_is_refused_with_those_that_are():
    with pytest.raises(ValueError, match="solvers has simplex; known are proxqp, daqp"):
        next(comparison.rows(solvers=["simplex"]))


@pytest.fixture
def others():
    pytest.importorskip("casadi", reason="casadi is not installed: pip install 'ssmr_torch[benchmarks]'")
    from ssmr_torch.benchmarks import other_solvers

    return other_solvers


def test_ours_costs_the_same_as_solving_every_program_to_convergence(others):
    measure = instance.measure
    optimum, found = measure(5, LAPS, others.ipopt), {
        "ours": measure(5, LAPS), "casadi": measure(5, LAPS, partial(others.casadi_rti, qp="qrqp"))}
    assert optimum["failures"] == 0
    for name, result in found.items():
        assert result["failures"] == 0 and result["cost"] == pytest.approx(optimum["cost"], rel=0.03), name


def test_another_solver_that_fails_goes_on_with_its_shifted_plan_and_counts(others):
    controller = others.ipopt(instance.oscillators(), instance.figure_eight(), instance.BOUNDS, horizon=5)
    controller(0.0, np.array([0.002, 0.001, 0.0, 0.0, 0.0, 0.0]))
    intended = controller._x[:4] * controller.input_scale
    controller(0.01, np.zeros(6))
    command = controller(0.02, np.full(6, np.nan))
    np.testing.assert_allclose(command.input, np.clip(intended, *instance.BOUNDS), atol=1e-12)
    assert controller.fallbacks == {"not solved": 1}


def test_the_symbolic_step_is_our_step(others):
    model = instance.oscillators().at_timestep(0.02)
    rng = np.random.default_rng(0)
    z, u = 0.02 * rng.standard_normal(6), 0.6 * rng.uniform(size=4)
    step = others.symbolic_step(model)
    np.testing.assert_allclose(step(z, u).full().ravel(), model.step(z, u), rtol=1e-12, atol=1e-15)


@pytest.mark.slow
def test_scaling_runs_over_horizons_states_and_obstacles():
    found = list(scaling.rows(horizons=[3], states=[6, 24], circles=[0, 3], laps=LAPS))
    assert [row["size"] for row in found] == ["N = 3", "6 states", "24 states", "0 circles", "3 circles"]
    assert [row["clearance, mm"] is None for row in found] == [True, True, True, True, False]


def test_windows_of_measurements_follow_the_plant():
    """Linear, so a few per cent of the range are left, and less than a model without memory of the noise leaves."""
    plant = instance.ModelPlant(instance.perturbed(instance.oscillators(), 0.03))
    model = scaling.window_model(24)
    window = np.array([plant.step(np.array([0.1, 0.0, 0.05, 0.0])) for _ in range(4)])
    z = model.encode(window, np.empty((3, 4)))
    for _ in range(10):
        z, truth = model.step(z, np.array([0.0, 0.1, 0.0, 0.05])), plant.step(np.array([0.0, 0.1, 0.0, 0.05]))
    assert np.abs(model.decode(z) - truth).max() < 0.05 * instance.RANGE


@pytest.mark.slow
def test_endurance_says_whether_memory_grew(monkeypatch):
    *found, verdict = endurance.rows(steps=100)
    assert [row["steps"] for row in found] == [10 * k for k in range(1, 11)] and "MB are accepted" in verdict
    growing = iter(range(100))
    monkeypatch.setattr(endurance, "memory", lambda: float(next(growing)))
    with pytest.raises(BenchmarkFailed, match=r"\+9.00 MB after the first 1 steps; at most 5 MB"):
        list(endurance.rows(steps=10))


def test_letters_among_circles_are_judged_between_samples_and_said_in_one_line():
    plant = instance.ModelPlant(instance.oscillators(), np.array([[0.0] * 4, [1.2] * 4]))
    found = []
    for seed in range(2):
        task = obstacles.letters(seed, 0.010, 5.0, (0, 1))
        controller = obstacles.designed(plant.model, plant, task, [], observer=None, margins=[1e-4] * 5)
        found.append(obstacles.outcome(seed, plant, controller, task, 0.0))
    assert max(one.depth for one in found) < 1e-4 and max(one.inside for one in found) < 5e-3
    assert all(one.rmse < 4e-3 and one.fallbacks == 0 for one in found)
    bad = found[0]._replace(depth=2e-3, inside=0.1)
    assert obstacles.summary([found[1]._replace(depth=0.0, inside=0.0), bad]).startswith(
        "2 sets: 1 violated; inside 5 % of the time, at most 10 %; deepest 2 mm;")
