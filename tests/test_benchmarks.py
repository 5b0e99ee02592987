"""The benchmarks of control run in miniature, and agree on what they compute; none of their times is judged."""

import importlib
from functools import partial
from pathlib import Path

import numpy as np
import pytest

BENCHMARKS = Path(__file__).parents[1] / "experiments" / "benchmarks"
LAPS = 0.7  # the least that leaves room to speed up and slow down, 105 control steps


@pytest.fixture
def benchmark(monkeypatch):
    """A benchmark by its name, as a module."""
    monkeypatch.syspath_prepend(str(BENCHMARKS))
    return importlib.import_module


def test_the_comparison_prints_machine_versions_ratios_and_what_it_left_out(benchmark, capsys):
    comparison = benchmark("control_comparison")
    pytest.importorskip("quadprog", reason="quadprog is not installed: pip install 'ssmr_torch[benchmarks]'")
    comparison.main(["--horizons", "3", "--laps", str(LAPS), "--solvers", "proxqp", "qpsolvers:quadprog", "acados"])
    machine, head, first, second, *rest = capsys.readouterr().out.splitlines()
    assert "cores" in machine and "OMP_NUM_THREADS" in machine and "quadprog" in machine
    assert first.split()[:2] == ["3", "proxqp"] and " 1.00 " in first and " 0 of " in first
    assert second.split()[:2] == ["3", "qpsolvers:quadprog"]
    assert len(rest) == 1 and "acados" in rest[0]


@pytest.fixture
def contenders(benchmark):
    pytest.importorskip("casadi", reason="casadi is not installed: pip install 'ssmr_torch[benchmarks]'")
    return benchmark("contenders")


def test_ours_costs_the_same_as_solving_every_program_to_convergence(benchmark, contenders):
    measure = benchmark("control_step").measure
    optimum, others = measure(5, LAPS, contenders.ipopt), {
        "ours": measure(5, LAPS), "casadi": measure(5, LAPS, partial(contenders.casadi_rti, qp="qrqp"))}
    assert optimum["failures"] == 0
    for name, result in others.items():
        assert result["failures"] == 0 and result["cost"] == pytest.approx(optimum["cost"], rel=0.03), name


def test_a_contender_that_fails_goes_on_with_its_shifted_plan_and_counts(benchmark, contenders):
    step = benchmark("control_step")
    controller = contenders.ipopt(step.oscillators(), step.figure_eight(), step.BOUNDS, horizon=5)
    controller(0.0, np.array([0.002, 0.001, 0.0, 0.0, 0.0, 0.0]))
    intended = controller._x[:4] * controller.input_scale
    controller(0.01, np.zeros(6))
    command = controller(0.02, np.full(6, np.nan))
    np.testing.assert_allclose(command.input, np.clip(intended, *step.BOUNDS), atol=1e-12)
    assert controller.fallbacks == {"not solved": 1}


def test_the_symbolic_step_is_our_step(benchmark, contenders):
    model = benchmark("control_step").oscillators().at_timestep(0.02)
    rng = np.random.default_rng(0)
    z, u = 0.02 * rng.standard_normal(6), 0.6 * rng.uniform(size=4)
    step = contenders.symbolic_step(model)
    np.testing.assert_allclose(step(z, u).full().ravel(), model.step(z, u), rtol=1e-12, atol=1e-15)


@pytest.mark.slow
def test_scaling_runs_over_horizons_states_and_obstacles(benchmark, monkeypatch, capsys):
    scaling = benchmark("control_scaling")
    for name, sizes in (("HORIZONS", (3,)), ("STATES", (6, 24)), ("CIRCLES", (0, 3))):
        monkeypatch.setattr(scaling, name, sizes)
    scaling.main(["--laps", str(LAPS)])
    lines = capsys.readouterr().out.splitlines()[2:]
    assert [line[:12].strip() for line in lines] == ["N = 3", "6 states", "24 states", "0 circles", "3 circles"]


def test_windows_of_measurements_follow_the_plant(benchmark):
    """Linear, so a few per cent of the range are left, and less than a model without memory of the noise leaves."""
    scaling, step = benchmark("control_scaling"), benchmark("control_step")
    plant, model = step.ModelPlant(step.perturbed(step.oscillators(), 0.03)), scaling.window_model(24)
    window = np.array([plant.step(np.array([0.1, 0.0, 0.05, 0.0])) for _ in range(4)])
    z = model.encode(window, np.empty((3, 4)))
    for _ in range(10):
        z, truth = model.step(z, np.array([0.0, 0.1, 0.0, 0.05])), plant.step(np.array([0.0, 0.1, 0.0, 0.05]))
    assert np.abs(model.decode(z) - truth).max() < 0.05 * step.RANGE


@pytest.mark.slow
def test_endurance_says_whether_memory_grew(benchmark, monkeypatch, capsys):
    endurance = benchmark("control_endurance")
    assert endurance.main(["--steps", "100"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert [line.split()[0] for line in lines[2:12]] == [str(10 * k) for k in range(1, 11)]
    growing = iter(range(100))
    monkeypatch.setattr(endurance, "memory", lambda: float(next(growing)))
    assert endurance.main(["--steps", "10"]) == 1


def test_letters_among_circles_are_judged_between_samples_and_said_in_one_line(benchmark):
    step, obstacles = benchmark("control_step"), benchmark("obstacles")
    plant = step.ModelPlant(step.oscillators(), np.array([[0.0] * 4, [1.2] * 4]))
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
