"""What a deployed form must agree on with the model it was made from."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from ssmr_torch.models.integrators import DIVERGENCE_FACTOR
from ssmr_torch.models.tables import ModelTables

TOLERANCE = 1e-12


def expected(model: ModelTables, batch: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """What the tables make of an artifact's reference batch: state z, A, B, next; window z; outputs y, C."""
    z, u = batch["state"], batch["input"]
    A, B, _ = model.linearize(z, u)
    C, _ = model.linearize_output(z)
    return {"encode": model.encode(batch["window"], batch["window_input"]), "decode": model.decode(z),
            "step": model.step(z, u), "A": A, "B": B, "C": C}


def expected_horizon(model: ModelTables, z: np.ndarray, inputs: np.ndarray) -> dict[str, np.ndarray]:
    """The horizon from z (n,) under inputs (H, m), up to where the model diverges: its inputs, and what to find."""
    with np.errstate(over="ignore", invalid="ignore"):  # of a rollout that diverges
        states = model.rollout(z, inputs)
        norm = np.linalg.norm(states, axis=-1)
    inside = np.isfinite(norm) & (norm <= DIVERGENCE_FACTOR * np.linalg.norm(model.state_scale))
    states = states[:len(states) if inside.all() else max(1, int(inside.argmin()))]
    A, B, _ = model.linearize(states[:-1], inputs[:len(states) - 1])
    C, _ = model.linearize_output(states)
    return {"inputs": inputs[:len(states) - 1], "states": states, "A": A, "B": B, "outputs": model.decode(states),
            "C": C}


def check(form: str, comparisons: Iterable[tuple[str, np.ndarray, np.ndarray]]) -> float:
    """The largest difference of (name, found, expected), relative to the largest entry of what is expected.

    Raises ValueError where one exceeds `TOLERANCE`, or a shape differs.
    """
    largest = 0.0
    for name, found, sought in comparisons:
        if found.shape != sought.shape:
            raise ValueError(f"{form}: {name} has shape {found.shape}, the model's is {sought.shape}; nothing was "
                             "replaced")
        if not sought.size:
            continue
        error = float(np.abs(found - sought).max() / max(np.abs(sought).max(), np.finfo(np.float64).tiny))
        if not error <= TOLERANCE:
            raise ValueError(f"{form}: {name} differs from the model's by {error:.3g} relative, more than "
                             f"{TOLERANCE:g}; nothing was replaced. Leave this format out, or report the model")
        largest = max(largest, error)
    return largest
