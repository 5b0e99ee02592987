"""How a deployed form is checked: its results on the reference batch must agree with the model's within a tolerance."""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple

import numpy as np

from ssmr_torch.models.base import Model
from ssmr_torch.models.integrators import DIVERGENCE_FACTOR

TOLERANCE = 1e-12
ROUNDING = 10.0  # allowed difference, as a multiple of the change that rounding the model's arrays makes


class Signature(NamedTuple):
    """Arguments and results of a function of a deployed model, by their names in the reference batch."""

    inputs: tuple[str, ...]
    outputs: tuple[str, ...]


SIGNATURES = {"encode": Signature(("window", "window_input"), ("z",)), "decode": Signature(("state",), ("y",)),
              "step": Signature(("state", "input"), ("next",)),
              "step_jacobians": Signature(("state", "input"), ("next", "A", "B"))}


class Sought(NamedTuple):
    """The result of the model, and the largest allowed difference, relative to its largest entry."""

    values: np.ndarray
    tolerance: float


def expected(model: Model, batch: dict[str, np.ndarray]) -> dict[str, Sought]:
    """The model's results on an artifact's reference batch: encode, decode, step, A, B, C, and, with "horizon " before
    their names, states, A, B, outputs, C along `horizon_inputs`.

    The tolerance is 1e-12. It is ten times the change of the result under a change of the arrays' last bit where that
    is more: the result of a Kalman filter may be less well determined.
    """
    rng = np.random.default_rng(0)
    moved = model.with_arrays(lambda array: array * (1 + 2.0 ** -52 * rng.choice([-1, 1], array.shape)))
    z, inputs = horizon_inputs(model, batch)
    values, other = (_answers(each, batch) | _along(each, z, inputs) for each in (model, moved))
    return {name: Sought(values[name], max(TOLERANCE, ROUNDING * _difference(other[name], values[name])))
            for name in values}


def horizon_inputs(model: Model, batch: dict[str, np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """The first state (n,) of the batch, and its inputs (H, m) in a row, up to where the model diverges."""
    z, inputs = batch["state"][0], batch["input"]
    with np.errstate(over="ignore", invalid="ignore"):  # a rollout that diverges
        norm = np.linalg.norm(model.states(z, inputs), axis=-1)
    inside = np.isfinite(norm) & (norm <= DIVERGENCE_FACTOR * np.linalg.norm(model.state_scale))
    return z, inputs if inside.all() else inputs[:max(0, int(inside.argmin()) - 1)]


def check(form: str, comparisons: Iterable[tuple[str, np.ndarray, Sought]]) -> float:
    """The largest difference between found and sought in (name, found, sought), relative to the largest sought entry.

    Raises ValueError where one exceeds its tolerance, or where shapes differ.
    """
    largest = 0.0
    for name, found, (values, tolerance) in comparisons:
        if found.shape != values.shape:
            raise ValueError(f"{form}: {name} has the shape {found.shape}; expected {values.shape}, as the model gives "
                             "it. No file was replaced")
        error = _difference(found, values)
        if not error <= tolerance:
            raise ValueError(f"{form}: {name} differs from the model's by {error:.3g} relative; at most "
                             f"{tolerance:.3g} is allowed. No file was replaced. Leave this format out, or "
                             "report this as an error of the package")
        largest = max(largest, error)
    return largest


def _answers(model: Model, batch: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    z, u = batch["state"], batch["input"]
    A, B, _ = model.linearize(z, u)
    C, _ = model.linearize_output(z)
    return {"encode": model.encode(batch["window"], batch["window_input"]), "decode": model.decode(z),
            "step": model.step(z, u), "A": A, "B": B, "C": C}


def _along(model: Model, z: np.ndarray, inputs: np.ndarray) -> dict[str, np.ndarray]:
    states = model.states(z, inputs)
    A, B, _ = model.linearize(states[:-1], inputs)
    C, _ = model.linearize_output(states)
    return {"horizon states": states, "horizon A": A, "horizon B": B, "horizon outputs": model.decode(states),
            "horizon C": C}


def _difference(found: np.ndarray, values: np.ndarray) -> float:
    if not values.size:
        return 0.0
    return float(np.abs(found - values).max() / max(np.abs(values).max(), np.finfo(np.float64).tiny))
