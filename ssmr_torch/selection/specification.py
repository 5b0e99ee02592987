"""`Specification`: the form of a slow-fast model, as strings and numbers."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

CHARTS = ("delay", "predictive", "tangent_space")
FEATURES = ("linear", "bilinear", "leading_bilinear", "quadratic", "configuration_affine", "cubic", "leading_cubic",
            "full_quadratic", "quadratic_map")


@dataclass(frozen=True)
class Specification:
    """One form of a slow-fast model.

    coordinates: name of output coordinates, "identity", "constant_curvature", or one that the user gave.
    chart: slow coordinates z. "delay": the newest of delays + 1 samples and the differences between them;
        "predictive": the `states` directions of window and past inputs that explain most of the next `future` samples;
        "tangent_space": the `states` leading directions of the decays' windows.
    memory: past inputs as states. ("shift", k): the k newest inputs; ("pole", a): s⁺ = a s + (1 − a) u for each input,
        an actuator of first order, whose state then acts in place of the input.
    features: kind of the nonlinear monomials, see `features`. leading: largest number of coordinates in them; 0: all
        that span the outputs.
    ridge: on the nonlinear monomials, relative to the mean square of each.
    decays: whether decays are fitted as well.   pull: strength of the pull towards the closed-form fit in Gauss-Newton
        steps on rollouts; 0: no such steps.
    fibre: number of fast states, which describe the deviation from the slow manifold and only decay.
    """

    coordinates: str = "identity"
    chart: str = "delay"
    states: int = 0
    delays: int = 1
    future: int = 3
    memory: tuple[str, float] = ("shift", 1)
    features: str = "linear"
    leading: int = 0
    ridge: float = 1e-4
    decays: bool = True
    pull: float = 0.0
    fibre: int = 0

    @property
    def pole(self) -> bool:
        """Whether the memory is the state of an actuator."""
        return self.memory[0] == "pole"

    @property
    def regression(self) -> tuple:
        """Everything on which the regressors depend; equal for specifications that differ only in ridge and refinement.
        """
        return (self.coordinates, self.chart, self.states, self.delays, self.future, self.memory, self.features,
                self.leading, self.decays)

    @property
    def family(self) -> tuple:
        """The common part of specifications whose predictions are alike."""
        return self.chart, self.coordinates, self.features, self.memory[0]

    def memory_weights(self, past: int) -> np.ndarray:
        """(k, past), weights of the inputs before a sample, oldest first, in the memory at this sample."""
        if not self.pole:
            k = int(self.memory[1])
            if k > past:
                raise ValueError(f"a memory of {k} past inputs; expected at most {past}, the past inputs of a sample")
            return np.eye(past)[::-1][:k]
        a = float(self.memory[1])
        weights = (1.0 - a) * a ** np.arange(past - 1, -1, -1.0)
        weights[0] = a ** (past - 1.0)  # assumes that the oldest input was held before
        return weights[None]

    def __str__(self) -> str:
        size = {"delay": f"a window of {self.delays + 1} samples",
                "predictive": f"{self.states} predictive coordinates of {self.delays + 1} samples",
                "tangent_space": f"{self.states} coordinates of the decays' tangent space"}[self.chart]
        memory = (f"an actuator state with factor {self.memory[1]:.3g} per step" if self.pole
                  else f"{int(self.memory[1])} past inputs")
        words = [size, *([] if self.coordinates == "identity" else [f"{self.coordinates.replace('_', ' ')} outputs"]),
                 memory, f"{self.features.replace('_', ' ')} flow map" + (f" of {self.leading}" * bool(self.leading)),
                 *([] if self.features == "linear" else [f"ridge {self.ridge:.0e}"]),
                 *([] if self.decays else ["no decays"]), *(["Gauss-Newton"] if self.pull else []),
                 *([f"{self.fibre} fast states"] if self.fibre else [])]
        return ", ".join(words)
