"""Rollouts from many starts at once. Evaluation, validation and the stability guard spend most of their time here."""

from __future__ import annotations

import numpy as np

from ssmr_torch.lazy import found
from ssmr_torch.models.base import Model, Rollout


class BatchRollout:
    """Rollouts of a model in NumPy from many states z (N, n) under inputs (N, H, m), held one timestep each.

    lengths (N,): steps after which each rollout ends; None: H for all. bound: a rollout with ‖z‖ > bound has diverged;
    None: the model's own bound. This class calls `Model.rollout`; a faster subclass, which a model names in `batched`,
    overrides `_run`. Raises ValueError for arrays of other shapes, before anything is computed.
    """

    def __init__(self, model: Model):
        self.model = model.reduced.numpy()

    def rollout(self, z: np.ndarray, inputs: np.ndarray, *, lengths: np.ndarray | None = None,
                bound: float | None = None) -> Rollout:
        """`Model.rollout`: states (N, H + 1, n), and diverged_at (N,)."""
        states, _, diverged_at = self._checked(z, inputs, lengths, bound, True, False)
        return Rollout(states, diverged_at)

    def outputs(self, z: np.ndarray, inputs: np.ndarray, *, lengths: np.ndarray | None = None,
                bound: float | None = None) -> np.ndarray:
        """y_1 … y_H, (N, H, p): infinite from the step at which a rollout diverged, undefined after its end."""
        return self._checked(z, inputs, lengths, bound, False, True)[1]

    def diverged(self, z: np.ndarray, inputs: np.ndarray, *, lengths: np.ndarray | None = None,
                 bound: float | None = None) -> np.ndarray:
        """Whether each rollout diverged before its end, (N,)."""
        ends = inputs.shape[-2] if lengths is None else lengths
        return self._checked(z, inputs, lengths, bound, False, False)[2] <= ends

    def _checked(self, z, inputs, lengths, bound, states: bool, outputs: bool):
        n, m = self.model.state_dim, self.model.input_dim
        if z.ndim != 2 or inputs.ndim != 3 or z.shape != (len(inputs), n) or inputs.shape[2] != m:
            raise ValueError(f"states of shape {z.shape} and inputs of shape {inputs.shape}; expected (N, {n}) and "
                             f"(N, H, {m}) with the same number of starts N")
        steps = inputs.shape[1]
        if lengths is not None and (lengths.shape != (len(z),) or not np.all((0 <= lengths) & (lengths <= steps))):
            raise ValueError(f"lengths of shape {lengths.shape} between {np.min(lengths, initial=steps)} and "
                             f"{np.max(lengths, initial=0)}; expected one for each of the {len(z)} starts, between 0 "
                             f"and the {steps} steps of the inputs")
        lengths = np.full(len(z), steps) if lengths is None else lengths
        return self._run(z, inputs, lengths, self.model.divergence_bound if bound is None else bound, states, outputs)

    def _run(self, z, inputs, lengths, bound, states: bool, outputs: bool) -> tuple:
        """States (N, H + 1, n), outputs (N, H, p) and `diverged_at` (N,). States or outputs may be empty if their
        argument is false.
        """
        found = self.model.rollout(z, inputs, lengths=lengths, bound=bound)
        if not outputs:
            return found.states, np.empty((0, 0, 0)), found.diverged_at
        with np.errstate(over="ignore", invalid="ignore"):
            seen = self.model.decode(found.states[:, 1:])
        left = found.diverged_at[:, None] <= np.minimum(np.arange(1, inputs.shape[1] + 1), lengths[:, None])
        return found.states, np.where(left[..., None], np.inf, seen), found.diverged_at


def batch_of(model) -> BatchRollout:
    """The fastest available rollouts of a `Model`, or of an object with a model as its `reduced`."""
    model = model.reduced.numpy()
    return found(model.batched)(model) if model.batched else BatchRollout(model)
