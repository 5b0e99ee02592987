"""Refinement of the coefficients of the flow map by Gauss-Newton steps on the rollout error.

It helps if a window does not show all modes of the robot.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ssmr_torch.models.batch_rollout import batch_of
from ssmr_torch.models.monomials import Form
from ssmr_torch.models.polynomial import PolynomialModel
from ssmr_torch.selection.folds_and_starts import Starts

STEPS = (0.01, 0.02, 0.03, 0.05, 0.08, 0.13, 0.2, 0.35, 0.6, 1.0)  # shares of the horizon at which errors count
ROUNDS, ENOUGH = 3, 3e-3      # number of Gauss-Newton steps; relative gain below which no further step is taken
CLIP = 10.0                   # relative to its error at first: a sample with a larger error has no gradient
BLOCK = 50                    # number of starts whose sensitivities are in memory at once
LARGEST = 3e9                 # multiplications of a round; they take a few seconds
PULLS = (1e-4,)               # strengths of the pull towards the closed-form fit that are tried


@dataclass(frozen=True)
class Problem:
    """A refinement: dynamics[:n] + E ΔΘ of a model, for rollouts from starts. targets: the columns of y that count."""

    model: PolynomialModel
    E: np.ndarray
    starts: Starts
    targets: Sequence[int]

    @property
    def steps(self) -> list[int]:
        """Steps of the horizon at which errors count."""
        horizon = self.starts.inputs.shape[1]
        return sorted({max(1, round(horizon * share)) for share in STEPS})

    @property
    def work(self) -> float:
        """Number of multiplications in one round."""
        n, k = self.E.shape
        unknown = k * len(self.model.structure.dynamics)
        N, H, _ = self.starts.inputs.shape
        return N * (H * n * n * unknown + len(self.steps) * len(self.targets) * unknown ** 2)

    def changed(self, theta: np.ndarray) -> PolynomialModel:
        """The model with this ΔΘ (k, F)."""
        dynamics = self.model.dynamics.copy()
        dynamics[:len(self.E)] += self.E @ theta
        return replace(self.model, dynamics=dynamics)

    def begin(self, model: PolynomialModel) -> tuple[np.ndarray, np.ndarray]:
        """Initial states, and the targets at the steps that count."""
        starts, D = self.starts, model.delays
        z = model.encode(starts.window[:, starts.window.shape[1] - D - 1:], starts.past[:, starts.past.shape[1] - D:])
        return z, starts.follows[:, [step - 1 for step in self.steps]][..., list(self.targets)]

    def errors(self, model: PolynomialModel) -> np.ndarray:
        """Measured minus predicted, (N, steps, targets)."""
        z, measured = self.begin(model)
        with np.errstate(all="ignore"):
            found = batch_of(model).outputs(z, self.starts.inputs)
        return measured - found[:, [step - 1 for step in self.steps]][..., list(self.targets)]


def refine(problem: Problem, pull: float) -> PolynomialModel:
    """The model after a few damped Gauss-Newton steps on

        mean over starts and steps k of min(‖ŷ_k − y_k‖² / σ_k², C²) + pull ‖ΔΘ‖²_D

    with σ_k the error k steps ahead of the first model, and D the diagonal of the first JᵀJ.
    """
    unknown = problem.E.shape[1] * len(problem.model.structure.dynamics)
    theta, damping = np.zeros(unknown), 1e-2
    shape = (problem.E.shape[1], -1)
    model = problem.model
    weights = _weights(problem, model)
    cost = _cost(problem.errors(model), weights)
    diagonal = None
    for _ in range(ROUNDS):
        normal, gradient = _normal_equations(problem, model, weights)
        if diagonal is None:
            diagonal = np.maximum(np.diag(normal), 1e-12 * np.diag(normal).max())
        normal[np.diag_indices_from(normal)] += pull * diagonal
        gradient = gradient - pull * diagonal * theta
        scale = np.sqrt(np.diag(normal))
        scaled = normal / np.outer(scale, scale)
        before, gain = cost + pull * (theta ** 2 * diagonal).sum(), 0.0
        while damping < 1e4:
            step = np.linalg.solve(scaled + damping * np.eye(unknown), gradient / scale) / scale
            trial = problem.changed((theta + step).reshape(shape))
            cost_there = _cost(problem.errors(trial), weights)
            total = cost_there + pull * ((theta + step) ** 2 * diagonal).sum()
            if total < before:
                theta, model, cost, gain = theta + step, trial, cost_there, 1.0 - total / before
                damping = max(damping / 5.0, 1e-7)
                break
            damping *= 6.0
        if gain < ENOUGH:
            break
    return model


def _weights(problem: Problem, model: PolynomialModel) -> np.ndarray:
    """1 / σ_k, (steps,); σ_k at most the size of the outputs."""
    squares = np.square(problem.errors(model)).sum(-1)
    size = np.square(problem.begin(model)[1]).sum(-1).mean()
    sigma = np.minimum(np.nan_to_num(squares, nan=size, posinf=size), size).mean(0)
    return 1.0 / np.sqrt(np.maximum(sigma, 1e-12 * size))


def _cost(errors: np.ndarray, weights: np.ndarray) -> float:
    squares = np.square(errors).sum(-1) * weights ** 2
    return float(np.minimum(np.nan_to_num(squares, nan=CLIP ** 2, posinf=CLIP ** 2), CLIP ** 2).mean())


def _normal_equations(problem: Problem, model: PolynomialModel,
                      weights: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """JᵀJ and Jᵀr over starts and steps, by forward sensitivities, Z⁺ = ∂z⁺/∂z Z + E ⊗ φ."""
    n, k = problem.E.shape
    size = k * len(model.structure.dynamics)
    normal, gradient = np.zeros((size, size), np.float32), np.zeros(size)
    first, measured = problem.begin(model)
    count = len(first) * len(problem.steps)
    for block in range(0, len(first), BLOCK):
        part = slice(block, block + BLOCK)
        states = batch_of(model).rollout(first[part], problem.starts.inputs[part]).states
        for rows, residual in _sensitivities(problem, model, states, problem.starts.inputs[part], measured[part],
                                             weights):
            normal += rows.T @ rows
            gradient += rows.T @ residual
    return normal.astype(np.float64) / count, gradient / count


def _sensitivities(problem: Problem, model: PolynomialModel, states: np.ndarray, inputs: np.ndarray,
                   measured: np.ndarray, weights: np.ndarray):
    """Weighted rows of J and r, one counting step after the other."""
    n, k = problem.E.shape
    E, size, targets = problem.E.astype(np.float32), len(model.structure.dynamics), list(problem.targets)
    slow = _slow_step(model, n)
    carried = np.zeros((len(states), n, k * size), np.float32)
    for step in range(1, inputs.shape[1] + 1):
        z, u = states[:, step - 1], inputs[:, step - 1]
        slopes, features = slow(z, u)
        carried = slopes @ carried
        carried += (E[None, :, :, None] * features[:, None, None, :]).reshape(carried.shape)
        if step in problem.steps:
            place = problem.steps.index(step)
            C = model.linearize_output(states[:, step]).C[:, targets, :n].astype(np.float32)
            residual = (measured[:, place] - model.decode(states[:, step])[:, targets]) * weights[place]
            near = np.square(residual).sum(1) < CLIP ** 2
            rows = (weights[place] * (C[near] @ carried[near])).astype(np.float32)
            yield rows.reshape(-1, k * size), residual[near].ravel()


def _slow_step(model: PolynomialModel, n: int):
    """A function of states and inputs that returns ∂z⁺/∂z (N, n, n) of the slow coordinates, and the regressors (N, F).
    """
    structure, linear = model.structure, model.linear_part[:n, :n]
    form = Form(structure.dynamics, model.dynamics[:n])

    def step(x: np.ndarray, u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        joint, slopes = model.joint(x, u)
        inside = form.jacobian(structure.dynamics.multiplied_out(joint), 0, n)
        slopes = slopes[:, None, :n]
        found = slopes * inside + (1.0 - slopes) * linear
        return found.astype(np.float32), model.dynamics_regressors(x, u).astype(np.float32)

    return step


def refined(trial, pool: Sequence, count: int = 2, say: Callable[[str], None] = lambda line: None) -> list:
    """The pool, best first, extended by refined forms of its first `count` members that are small enough."""
    found, tried = list(pool), 0
    for each in pool:
        if tried == count:
            break
        if not trial.refinable(each):
            continue
        tried += 1
        for pull in PULLS:
            candidate = replace(each, pull=pull)
            if np.isfinite(trial(candidate)) and trial.bounded(candidate):
                found.append(candidate)
    found.sort(key=lambda each: trial.outcomes[each].score)
    say(f"refinement: {tried} refined, best {trial.outcomes[found[0]].score:.4f} {found[0]}")
    return found
