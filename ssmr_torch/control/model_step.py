"""One step of a model and the outputs after it, by the fastest way that the model has."""

from __future__ import annotations

import numpy as np

from ssmr_torch.lazy import found


class Stepper:
    """(z (n,), u (m,)) → z⁺ and w(z⁺), for a model in NumPy; with its compiled kernel where it has one."""

    def __init__(self, model):
        self.model = model
        self._compiled = found(model.compiled)(model) if model.compiled else None

    def __call__(self, z: np.ndarray, u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        if self._compiled is None:
            following = self.model.step(z, u)
            return following, self.model.decode(following)
        tables, rollout, _ = self._compiled
        states, outputs = rollout(z, np.ascontiguousarray(u)[None], tables)
        return states[1], outputs[0]
