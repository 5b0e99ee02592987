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

    coordinates: with chart "tangent_space", SVD of the windows ŷ of the decays (manifold_data "decays") or of all
        runs ("all"): the chart is the n leading directions, blind to the inputs until it is refined. With chart
        "predictive", the outputs of the next `future` samples are regressed on [ŷ, û] and the inputs that act
        meanwhile; what the past explains of them, a projection along the future inputs, has n leading directions
        [subspace identification: Van Overschee and De Moor 1994]. It takes the inputs' part out of the window, and
        what varies much without mattering later.
    dynamics: (z⁺ - z) / h on (z, u)^{1:n_r};   parametrization: y on z^{1:n_w}.
    Raises ValueError for another chart or manifold_data, for a window or a future with fewer values than n, and in
    `assign` where a stage found no rows.
    """

    stages = ("coordinates", "dynamics")
    names = ("coordinates", "dynamics", "parametrization")

    def __init__(self, model: ControlAugmentedSSMR, *, chart: str = "predictive", future: int = 10,
                 manifold_data: str = "decays"):
        super().__init__()
        for name, value, options in (("manifold_data", manifold_data, ("decays", "all")),
                                     ("chart", chart, ("tangent_space", "predictive"))):
            if value not in options:
                raise ValueError(f"{name} is {value!r}; expected one of {options}")
        if future < 1:
            raise ValueError(f"future is {future} samples; expected 1 or more")
        shown, of_what = model.window_dim, "the window"
        if chart == "predictive":
            shown = (future + 1) * model.output_dim
            of_what = f"this and {future} further samples of {model.output_dim} outputs"
        if shown < model.state_dim:
            raise ValueError(f"{shown} values in {of_what} are fewer than the {model.state_dim} reduced coordinates "
                             "that their singular vectors must give; use more delays, a larger future or a smaller "
                             "state_dim")
        # not a submodule: the fit that holds this procedure also holds the model, and saves it once
        self.__dict__["model"] = model
        self.predictive, self.future, self.manifold_data = chart == "predictive", int(future), manifold_data
        self.register_buffer("singular_values", torch.zeros(model.window_dim, dtype=torch.float64))

    @property
    def before(self) -> int:
        return self.model.delays

    @property
    def after(self) -> int:
        return self.future if self.predictive else 1

    @torch.no_grad()
    def regressions(self, segment: Segment, stage: str) -> dict[str, Regression]:
        """The rows of a segment for the coordinates, or one-step pairs for the dynamics and the parametrization."""
        model, delays = self.model, self.model.delays
        windows = delay_windows(segment.observation, delays)
        held = windows.new_zeros(len(windows), 0, model.input_dim)
        if delays:
            held = delay_windows(segment.input[:-1], delays - 1)
        if stage == "coordinates":
            return self._coordinates(segment, windows, held)
        z = model.encode(windows, held)
        u, y = segment.input[delays:-1], segment.observation[delays:-1]
        now, rate, u, y = self._core(segment, z[:-1], (z[1:] - z[:-1]) / model.base_timestep, u, y)
        monomials = model.structure.dynamics(torch.cat([now, u], dim=-1))  # nothing saturates within the training range
        return {"dynamics": Regression(monomials, rate),
                "parametrization": Regression(model.structure.parametrization(now), y)}

    def _coordinates(self, segment: Segment, windows: Tensor, held: Tensor) -> dict[str, Regression]:
        if not self.predictive:
            if segment.kind != "decay" and self.manifold_data == "decays":
                return {}
            (rows,) = self._core(segment, windows.flatten(1))
            return {"coordinates": Regression(rows, rows[:, :0])}
        delays, future = self.model.delays, self.future
        if len(windows) <= future:
            return {}
        past = self.model.reduced.chart_regressors(windows, held)[:-future]
        inputs = delay_windows(segment.input[delays:-1], future - 1).flatten(1)
        outputs = delay_windows(segment.observation[delays:], future).flatten(1)
        past, inputs, outputs = self._core(segment, past, inputs, outputs)
        return {"coordinates": Regression(torch.cat([past, inputs], dim=1), outputs)}

    @torch.no_grad()
    def assign(self, stage: str, solutions: Mapping[str, Solution]) -> None:
        """Put the solutions of a stage in place. Raises ValueError when the data held no rows for it."""
        needed = self.names[:1] if stage == "coordinates" else self.names[1:]
        missing = [name for name in needed if name not in solutions]
        if missing:
            raise ValueError(f"the {stage} stage found no rows for {missing}: the training data hold no decays, or no "
                             "run is long enough; record some, use manifold_data=all or a smaller future")
        model = self.model
        if stage == "coordinates":
            self._assign_coordinates(solutions["coordinates"])
        else:
            model.dynamics_table.copy_(solutions["dynamics"].coefficients)
            model.parametrization.copy_(solutions["parametrization"].coefficients)

    def _assign_coordinates(self, solution: Solution) -> None:
        model, n = self.model, self.model.state_dim
        model.chart.zero_()
        if not self.predictive:
            values, vectors = singular_values(solution.factor)
            self.singular_values.copy_(values)
            model.chart[:, :model.window_dim] = vectors[:, :n].T
            return
        seen = model.chart.shape[1]
        explained = solution.coefficients[:, :seen]
        past = solution.factor.triangle[:seen, :seen]
        _, values, directions = torch.linalg.svd(past @ explained.T, full_matrices=False)
        count = min(len(values), len(self.singular_values))
        self.singular_values[:count] = values[:count]
        size = solution.rows ** 0.5 / values[:n].clamp_min(1e-300)
        reach = torch.linalg.vector_norm(past[:, model.window_dim - model.output_dim:model.window_dim])
        # every coordinate as large as the outputs, so that one range of states speaks for all
        model.chart.copy_(size[:, None] * reach / solution.rows ** 0.5 * (directions[:n] @ explained))

    def _core(self, segment: Segment, *arrays: Tensor) -> tuple[Tensor, ...]:
        return tuple(segment.core_rows(array, self.model.delays) for array in arrays)
