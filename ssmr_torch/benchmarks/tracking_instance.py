"""The tracking problem on which control steps are measured, and on which many tests stand.

A six-dimensional cubic model (three coupled oscillators of about 4 Hz, 5 % damping, four pulling inputs)
steers a plant with wrong parameters along the fast figure eight, with measurement noise.
"""

from __future__ import annotations

from dataclasses import replace
from time import perf_counter, thread_time

import numpy as np

from ssmr_torch.control.mpc import ModelPredictiveController
from ssmr_torch.control.mpc_settings import PredictiveControlSettings
from ssmr_torch.models.monomials import count_monomials
from ssmr_torch.models.named_structures import spectral_submanifold
from ssmr_torch.models.polynomial import PolynomialModel
from ssmr_torch.tasks.references import figure_eight

# The paper's weights: 100 per mm², and 1e-5 per mN² of inputs up to 0.6 N.
PAPER = PredictiveControlSettings(output_weight=1e8, input_weight=3.6, first_iterations=3)
RANGE = 0.02
BOUNDS = np.array([[0.0] * 4, [0.6] * 4])


def oscillators(seed: int = 0, degree: int = 3, control_degree: int = 1) -> PolynomialModel:
    """q̈_i + 2 ζ ω_i q̇_i + ω_i² q_i = polynomial(q, q̇) + input, in z = (q, q̇ / ω), observed in full.

    Opposed inputs pull along ±q_0 and ±q_1 (24 mm/N at rest); seed draws the rest.
    """
    rng = np.random.default_rng(seed)
    omega = 2 * np.pi * 4.0 * (1.0 + 0.1 * rng.uniform(-1, 1, 3))
    drift = np.zeros((6, count_monomials(6, 1, degree)))
    drift[:3, 3:6] = np.diag(omega)
    drift[3:, :3], drift[3:, 3:6] = -np.diag(omega), -0.1 * np.diag(omega)
    offset = 6
    for power in range(2, degree + 1):
        columns = count_monomials(6, power, power)
        size = 0.1 / np.sqrt(columns) / RANGE**(power - 1)
        drift[3:, offset:offset + columns] = size * omega[:, None] * rng.standard_normal((3, columns))
        offset += columns
    pull = 0.024 * np.array([[1, -1, 0, 0], [0, 0, 1, -1], [0.2, 0.2, -0.2, -0.2]])
    control = np.zeros((6, 1 + count_monomials(6, 1, control_degree), 4))
    control[3:, 0] = omega[:, None] * pull
    control[3:, 1:] = omega[:, None, None] * 0.024 * 0.03 / RANGE * rng.standard_normal(control[3:, 1:].shape)
    return spectral_submanifold(
        chart=np.eye(6), parametrization=np.eye(6), drift=drift, control=control.reshape(6, -1),
        state_scale=np.full(6, 2 * RANGE), chart_degree=1, parametrization_degree=1, dynamics_degree=degree,
        control_degree=control_degree, input_dim=4, output_dim=6, delays=0, timestep=0.01,
        window_timestep=0.01, substeps=1)


def perturbed(model: PolynomialModel, relative: float, seed: int = 1) -> PolynomialModel:
    """The same model with every parameter of its dynamics wrong by a normal relative error."""
    rng, rows = np.random.default_rng(seed), len(model.dynamics)
    free = sum(factors[-1] < model.state_dim for factors in model.structure.dynamics.factors)
    errors = [rng.standard_normal((rows, columns)) for columns in (free, model.dynamics.shape[1] - free)]
    return replace(model, dynamics=model.dynamics * (1 + relative * np.hstack(errors)))


class ModelPlant:
    """A plant that obeys a polynomial model, finely integrated; its state is that of the model."""

    name, input_unit = "model", "N"

    def __init__(self, model: PolynomialModel, input_bounds: np.ndarray = BOUNDS):
        self.model = replace(model, substeps=4)
        self.timestep, self.input_bounds = model.timestep, np.array(input_bounds)
        self.output_names = tuple(f"y{i}" for i in range(model.output_dim))
        self.input_names = tuple(f"u{i}" for i in range(model.input_dim))
        self.rest = np.zeros(model.output_dim)
        self.reset()

    @property
    def displacement(self) -> np.ndarray:
        return self.model.decode(self.state)

    def reset(self, seed: int | None = None, state: np.ndarray | None = None) -> np.ndarray:
        self.state = np.zeros(self.model.state_dim) if state is None else np.array(state, dtype=np.float64)
        return self.displacement

    def step(self, input: np.ndarray) -> np.ndarray:
        if np.shape(input) != (self.model.input_dim,) or not np.isfinite(input).all():
            raise ValueError(f"input is {input}; expected {self.model.input_dim} finite numbers")
        self.state = self.model.step(self.state, np.clip(input, *self.input_bounds))
        return self.displacement


def predictive(model, task, bounds, **changes) -> ModelPredictiveController:
    """Our controller with the paper's weights and these changes of its settings."""
    return ModelPredictiveController(model, task, bounds, PAPER, **changes)


def measure(horizon: int, laps: float = 6.0, build=predictive, model=None, task=None, prepare: bool = False) -> dict:
    """CPU and wall time of every control step of one run, in ms, with what happened in it.

    prepare: linearize and condense when an input has been sent, as on a robot; the step is then from the measurement to
    the input alone.

    build(model, task, BOUNDS, horizon=horizon) → the controller, which counts its `fallbacks`.   model, task: default
    the oscillators and the fast figure eight of so many laps; the plant is always the perturbed oscillators.
    cost: mean of ‖y − ŷ‖²_Q + ‖u / range‖²_R over the control steps, with the plant's true outputs.   clearance: the
    smallest from an obstacle at a control step, mm; infinite without one.
    """
    task = figure_eight(laps=laps) if task is None else task
    plant = ModelPlant(perturbed(oscillators(), 0.03))
    controller = build(oscillators() if model is None else model, task, BOUNDS, horizon=horizon)
    rng, observation = np.random.default_rng(0), plant.reset()
    cpu, wall, inputs, errors, clearance = [], [], [], [], np.inf
    for k in range(round(task.duration / plant.timestep)):
        measured = observation + 3e-5 * rng.standard_normal(6)
        starts = thread_time(), perf_counter()
        command = controller(k * plant.timestep, measured)
        if not command.held:
            cpu.append(thread_time() - starts[0])
            wall.append(perf_counter() - starts[1])
            inputs.append(command.input)
            errors.append(observation[:2] - task.reference(k * plant.timestep)[0])
            clearance = min([clearance, *(float(obstacle.clearance(k * plant.timestep, observation[None, :2])[0])
                                          for obstacle in task.obstacles)])
        if prepare:
            controller.prepare()
        observation = plant.step(command.input)
    saturated, squares = np.isclose(inputs, BOUNDS[1]).mean(), np.mean(np.sum(np.square(errors), axis=1))
    effort = np.mean(np.sum(np.square(inputs / np.ptp(BOUNDS, axis=0)), axis=1))
    return {"N": horizon, "steps": len(cpu), "cpu": 1e3 * np.array(cpu), "wall": 1e3 * np.array(wall),
            "failures": sum(controller.fallbacks.values()), "saturated": saturated, "rmse": 1e3 * np.sqrt(squares),
            "clearance": 1e3 * clearance,
            "cost": PAPER.output_weight * squares + PAPER.input_weight * effort}
