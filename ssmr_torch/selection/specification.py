"""What a selection chooses: the form of a slow-fast model, as words and numbers."""

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
        "predictive": the `states` directions of window and past inputs that say most of the next `future` samples;
        "tangent_space": the `states` leading directions of the decays' windows.
    memory: of the past inputs as states; ("shift", k): the k newest; ("pole", a): s⁺ = a s + (1 − a) u of each input,
        an actuator of first order, whose state then acts in place of the input.
    features: monomials beyond the linear ones, see `features`. leading: how many coordinates they are made of at most,
        0: all that span the outputs.
    ridge: on the monomials beyond the linear ones, relative to each one's mean square.
    decays: whether decays take part.   pull: towards the closed form in Gauss-Newton steps on rollouts; 0: no steps.
    fibre: states of the fast fibre, what leaves the slow manifold and only decays.
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
        """Whether the memory is that of an actuator."""
        return self.memory[0] == "pole"

    @property
    def regression(self) -> tuple:
        """All that the regressors depend on: equal for specifications of which only ridge and refinement differ."""
        return (self.coordinates, self.chart, self.states, self.delays, self.future, self.memory, self.features,
                self.leading, self.decays)

    @property
    def family(self) -> tuple:
        """What two specifications share that predict alike."""
        return self.chart, self.coordinates, self.features, self.memory[0]

    def memory_weights(self, past: int) -> np.ndarray:
        """(k, past): how the memory at a sample is made of the inputs before it, oldest first."""
        if not self.pole:
            k = int(self.memory[1])
            if k > past:
                raise ValueError(f"a memory of {k} past inputs; {past} are at hand")
            return np.eye(past)[::-1][:k]
        a = float(self.memory[1])
        weights = (1.0 - a) * a ** np.arange(past - 1, -1, -1.0)
        weights[0] = a ** (past - 1.0)  # as if the oldest input had always been held
        return weights[None]

    def __str__(self) -> str:
        size = {"delay": f"a window of {self.delays + 1} samples",
                "predictive": f"{self.states} predictive coordinates of {self.delays + 1} samples",
                "tangent_space": f"{self.states} coordinates of the decays' tangent space"}[self.chart]
        memory = (f"an actuator's memory of {self.memory[1]:.3g} a step" if self.pole
                  else f"{int(self.memory[1])} past inputs")
        words = [size, *([] if self.coordinates == "identity" else [f"{self.coordinates.replace('_', ' ')} outputs"]),
                 memory, f"{self.features.replace('_', ' ')} flow map" + (f" of {self.leading}" * bool(self.leading)),
                 *([] if self.features == "linear" else [f"ridge {self.ridge:.0e}"]),
                 *([] if self.decays else ["no decays"]), *(["Gauss-Newton"] if self.pull else []),
                 *([f"fast fibre of {self.fibre}"] if self.fibre else [])]
        return ", ".join(words)
