"""`Baseline`: the form of a model of a known kind, as strings and numbers."""

from __future__ import annotations

from dataclasses import dataclass

RIDGES = (1e-11, 1e-9, 1e-7, 1e-5, 1e-3)


@dataclass(frozen=True)
class Baseline:
    """One form of a model of a known kind, fitted in closed form.

    kind: a name of conf/model, see `baseline_choice.KINDS`. coordinates: name of output coordinates. delays: number of
    samples before the newest one in a window; input_delays: number of past inputs in it. states: number of reduced
    coordinates; 0 if it follows from the window. smoothed: for models in continuous time, whether time derivatives come
    from a local polynomial (Savitzky-Golay) instead of central differences. decays: whether the dynamics are fitted to
    decays as well. ridge: relative to the mean square of each regressor.
    """

    kind: str
    coordinates: str = "identity"
    delays: int = 1
    input_delays: int = 0
    states: int = 0
    smoothed: bool = False
    decays: bool = True
    ridge: float = 1e-5

    @property
    def regression(self) -> tuple:
        """Everything on which the regressors depend."""
        return (self.kind, self.coordinates, self.delays, self.input_delays, self.states, self.smoothed, self.decays)

    def __str__(self) -> str:
        words = [*([f"{self.states} states"] if self.states else []), f"a window of {self.delays + 1} samples",
                 *([f"{self.input_delays} past inputs"] if self.input_delays else []),
                 *([] if self.coordinates == "identity" else [f"{self.coordinates.replace('_', ' ')} outputs"]),
                 *(["smoothed derivatives"] if self.smoothed else []), f"ridge {self.ridge:.0e}",
                 *([] if self.decays else ["no decays"])]
        return ", ".join(words)
