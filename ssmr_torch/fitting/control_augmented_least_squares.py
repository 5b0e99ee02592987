"""Control-augmented SSMR in closed form: tangent space, then reduced dynamics and parametrization in one pass."""

from __future__ import annotations

from collections.abc import Mapping

import torch
from torch import Tensor, nn

from ssmr_torch.data.windows import Segment, delay_windows
from ssmr_torch.fitting.ssmr_least_squares import Regression
from ssmr_torch.fitting.statistics import Solution, singular_values
from ssmr_torch.models.control_augmented import ControlAugmentedSSMR


class ControlAugmentedLeastSquares(nn.Module):
    """The regressions of a `ControlAugmentedSSMR`, one-step pairs of decays and controlled runs alike:

    tangent_space: SVD of the windows [ŷ] of the decays (manifold_data "decays") or of all runs ("all"); the chart is
        the n leading directions, blind to the inputs until it is refined.
    dynamics: (z⁺ - z) / h on (z, u)^{1:n_r};   parametrization: y on z^{1:n_w}.
    Raises ValueError for another manifold_data, for a window with fewer values than n, and in `assign` where a stage
    found no rows.
    """

    stages = ("tangent_space", "dynamics")
    names = ("tangent_space", "dynamics", "parametrization")

    def __init__(self, model: ControlAugmentedSSMR, *, manifold_data: str = "decays"):
        super().__init__()
        if manifold_data not in ("decays", "all"):
            raise ValueError(f"manifold_data is {manifold_data!r}; expected one of ('decays', 'all')")
        if model.window_dim < model.state_dim:
            raise ValueError(f"the window holds {model.window_dim} values, fewer than the {model.state_dim} reduced "
                             "coordinates that its singular vectors must give; use more delays or a smaller state_dim")
        # not a submodule: the fit that holds this procedure also holds the model, and saves it once
        self.__dict__["model"] = model
        self.manifold_data = manifold_data
        self.register_buffer("singular_values", torch.zeros(model.window_dim, dtype=torch.float64))

    @property
    def before(self) -> int:
        return self.model.delays

    @property
    def after(self) -> int:
        return 1

    @torch.no_grad()
    def regressions(self, segment: Segment, stage: str) -> dict[str, Regression]:
        if stage == "tangent_space":
            if segment.kind != "decay" and self.manifold_data == "decays":
                return {}
            (rows,) = self._core(segment, delay_windows(segment.observation, self.model.delays).flatten(1))
            return {"tangent_space": Regression(rows, rows[:, :0])}
        model, delays = self.model, self.model.delays
        windows = delay_windows(segment.observation, delays)
        held = windows.new_zeros(len(windows), 0, model.input_dim)
        if delays:
            held = delay_windows(segment.input[:-1], delays - 1)
        z = model.encode(windows, held)
        u, y = segment.input[delays:-1], segment.observation[delays:-1]
        now, rate, u, y = self._core(segment, z[:-1], (z[1:] - z[:-1]) / model.base_timestep, u, y)
        return {"dynamics": Regression(model.dynamics_regressors(now, u), rate),
                "parametrization": Regression(model.parametrization_features(now), y)}

    @torch.no_grad()
    def assign(self, stage: str, solutions: Mapping[str, Solution]) -> None:
        """Put the solutions of a stage in place. Raises ValueError when the data held no rows for it."""
        needed = self.names[:1] if stage == "tangent_space" else self.names[1:]
        missing = [name for name in needed if name not in solutions]
        if missing:
            raise ValueError(f"the {stage} stage found no rows for {missing}: the training data hold no decays; record "
                             "some, or use manifold_data=all")
        model = self.model
        if stage == "tangent_space":
            values, vectors = singular_values(solutions["tangent_space"].factor)
            self.singular_values.copy_(values)
            model.chart.zero_()
            model.chart[:, :model.window_dim] = vectors[:, :model.state_dim].T
        else:
            model.dynamics_table.copy_(solutions["dynamics"].coefficients)
            model.parametrization.copy_(solutions["parametrization"].coefficients)

    def _core(self, segment: Segment, *arrays: Tensor) -> tuple[Tensor, ...]:
        return tuple(segment.core_rows(array, self.model.delays) for array in arrays)
