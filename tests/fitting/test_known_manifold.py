"""A fit of degree d to data of amplitude a approaches the known manifold and dynamics as a^{d+1}."""

import numpy as np
import pytest
import torch

from ssmr_torch.fitting.ssmr_least_squares import SSMRLeastSquares
from ssmr_torch.models.ssmr import SSMR
from ssmr_torch.plants.slow_manifold import SLOW_DIM, SlowManifold
from ssmr_torch.trajectory import Trajectory

AMPLITUDES = np.array([0.1, 0.05, 0.025])
SCALE = np.array([1.0, 1.0, 1.0, 10.0, 10.0, 12.0])


def slow_states(rng, count, amplitude):
    directions = rng.normal(size=(count, SLOW_DIM))
    directions *= rng.uniform(0.2, 1.0, (count, 1)) / np.linalg.norm(directions, axis=1, keepdims=True)
    return amplitude * SCALE * directions


def decay(plant, xi, samples):
    states = [xi]
    for _ in range(samples - 1):
        states.append(plant.flow(states[-1], plant.timestep))
    observation = plant.observe_slow(np.stack(states))
    return Trajectory(plant.timestep * np.arange(samples), observation, np.zeros((samples, 4)), "decay")


def controlled(plant, rng, xi, amplitude, samples):
    """A run from a state on the manifold under a constant input of size ~ amplitude: no jump blurs the differences."""
    u = plant.input_bounds[1] * amplitude * rng.uniform(0, 1, 4)
    observation = [plant.reset(state=plant.on_manifold(xi))]
    for _ in range(samples - 1):
        observation.append(plant.step(u))
    time, inputs = plant.timestep * np.arange(samples), np.tile(u, (samples, 1))
    return Trajectory(time, np.array(observation), inputs, "controlled")


def errors(solve_stages, degree, amplitude, observe, delays, calibration):
    rng = np.random.default_rng(0)
    plant = SlowManifold(observe, timestep=1e-3, fast_input_gain=0.0, substeps=2)
    runs = [decay(plant, xi, 300) for xi in slow_states(rng, 60, amplitude)]
    if calibration is not None:
        runs += [controlled(plant, rng, xi, amplitude, 300) for xi in slow_states(rng, 60, amplitude)]
    model = SSMR(SLOW_DIM, 4, len(plant.output_names), delays, parametrization_degree=degree, dynamics_degree=degree,
                 control_degree=degree - 1, timestep=plant.timestep)
    procedure = SSMRLeastSquares(model, calibration=calibration or "frozen")
    solve_stages(procedure, runs, stages=procedure.stages[:2 if calibration is None else 3])
    xi = slow_states(rng, 300, amplitude)
    window = torch.from_numpy(plant.window(xi, delays))
    with torch.no_grad():
        z = model.encode(window)
        exact = model.encode(torch.from_numpy(plant.window_rate(xi, delays)))
        found = {"manifold": (model.reduced.decode_window(z) - window).flatten(1).norm(dim=1).max(),
                 "drift": (model.reduced.drift(z) - exact).norm(dim=1).max()}
        if calibration is not None:
            unit = [plant.observe_slow_rate(xi, u) - plant.observe_slow_rate(xi) for u in np.eye(4)]
            field = torch.stack([model.encode(torch.from_numpy(column)[:, None]) for column in unit], dim=-1)
            found["control field"] = (model.reduced.control_field(z) - field).flatten(1).norm(dim=1).max()
    return {name: float(value) for name, value in found.items()}


def orders(table):
    values = {name: np.array([row[name] for row in table]) for name in table[0]}
    return {name: np.log2(v[:-1] / v[1:]) for name, v in values.items()}, values


@pytest.mark.parametrize("degree", [1, 2, 3])
def test_manifold_and_reduced_dynamics_seen_through_delays_converge_at_the_order_of_the_degree(solve_stages, degree):
    observed, values = orders([errors(solve_stages, degree, a, "markers", 1, None) for a in AMPLITUDES])
    for name in ("manifold", "drift"):
        assert (observed[name] > degree + 1 - 0.35).all(), (name, observed[name], values[name])


@pytest.mark.parametrize("calibration", [pytest.param("frozen", marks=pytest.mark.slow), "joint"])
@pytest.mark.parametrize("degree", [2, pytest.param(3, marks=pytest.mark.slow)])
def test_the_control_field_converges_at_the_order_of_its_degree(solve_stages, degree, calibration):
    observed, values = orders([errors(solve_stages, degree, a, "state", 0, calibration) for a in AMPLITUDES])
    assert (observed["manifold"] > degree + 1 - 0.35).all(), (observed, values)
    assert (observed["drift"] > degree + 1 - 0.35).all(), (observed, values)
    assert (observed["control field"] > degree - 0.35).all(), (observed, values)
