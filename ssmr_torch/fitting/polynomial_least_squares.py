"""Least-squares fit of any polynomial model in closed form: first its chart, then its dynamics and parametrization."""

from __future__ import annotations

from collections.abc import Mapping

import torch
from torch import Tensor, nn

from ssmr_torch.checked_arguments import checked
from ssmr_torch.data.derivatives import Stencil, central_difference
from ssmr_torch.data.windows import Segment, delay_windows
from ssmr_torch.fitting.ssmr_least_squares import Regression
from ssmr_torch.fitting.streamed_least_squares import Solution, singular_values
from ssmr_torch.models.torch_model import PolynomialTorchModel
from ssmr_torch.periods import TOLERANCE
from ssmr_torch.ranges import OneOf, Whole


class PolynomialLeastSquares(nn.Module):
    """The stages of the fit of a `PolynomialTorchModel`, over decays and controlled runs. Its structure gives the
    terms.

    coordinates: the columns of the chart that are linear in the window ŷ and in the inputs û held within it. Other
        columns stay unchanged. chart "tangent_space": SVD of the windows of the decays (manifold_data "decays") or of
        all runs ("all"). The chart is the n leading directions; it does not depend on the inputs until it is refined.
        chart "predictive": the outputs of the next `future` samples are regressed on [ŷ, û] and on the inputs that act
        meanwhile. The part that the past explains, a projection along the future inputs, has n leading directions
        [subspace identification: Van Overschee and De Moor 1994]. This removes from the window the direct effect of the
        inputs, and variation that does not matter for the future.
    dynamics: regression on the monomials of f(z, u) of z⁺ for a map (ζ⁺ with relift), of (z⁺ - z) / h for an Euler
        step, and of dz/dt, computed with the stencil `derivative`, for a flow. parametrization: regression of y.
    A table whose parameters are buffers is given and stays unchanged. If the state is the lifted window itself, the
    chart is given as well, and the stage "coordinates" is left out.
    Raises ValueError for another chart or manifold_data, for a window or a future with fewer values than n, for data
    with another sampling time than that of the map or Euler step, and in `assign` if the data had no rows for a stage.
    """

    names = ("coordinates", "dynamics", "parametrization")

    @checked(chart=OneOf("predictive", "tangent_space"), future=Whole(1, 10_000),
             manifold_data=OneOf("decays", "all"))
    def __init__(self, model: PolynomialTorchModel, *, derivative: Stencil | None = None, chart: str = "predictive",
                 future: int = 10, manifold_data: str = "decays"):
        super().__init__()
        if not isinstance(model, PolynomialTorchModel):
            raise ValueError(f"{type(model).__name__} is not a polynomial model; expected a PolynomialTorchModel with "
                             "a structure. Use the fit in the configuration of this model")
        for name, value, options in (("manifold_data", manifold_data, ("decays", "all")),
                                     ("chart", chart, ("tangent_space", "predictive"))):
            if value not in options:
                raise ValueError(f"{name} is {value!r}; expected one of {options}")
        if future < 1:
            raise ValueError(f"future is {future} samples; expected 1 or more")
        # not a submodule: the fit that contains this procedure also contains the model, and saves it only once
        self.__dict__["model"] = model
        self.derivative = derivative or central_difference(6)
        self.predictive, self.future, self.manifold_data = chart == "predictive", int(future), manifold_data
        self.fitted = [form for form in ("parametrization", "dynamics") if _is_fitted(model, form)]
        self.stages = ("dynamics",)
        self.register_buffer("singular_values", None)
        if _is_fitted(model, "chart"):
            self.stages = ("coordinates", "dynamics")
            self._prepare_chart()

    def _prepare_chart(self) -> None:
        """Find the columns of the chart that are linear in ŷ, in its newest sample, and in û."""
        model, (order, monomials) = self.model, (self.model.structure.window_order, self.model.structure.chart)
        linear = {column: order[factors[0]] for column, factors in enumerate(monomials.factors) if len(factors) == 1}
        seen = {column: place for column, place in linear.items() if place < model.window_dim}
        self.linear, self.of_window = list(linear), list(seen)
        self.newest = _run([list(linear).index(column) for column, place in seen.items()
                            if place >= model.window_dim - model.output_dim])
        shown, of_what = len(seen), "the window"
        if self.predictive:
            shown = (self.future + 1) * model.output_dim
            of_what = f"this and {self.future} further samples of {model.output_dim} outputs"
        if shown < model.state_dim:
            raise ValueError(f"{shown} values in {of_what}, fewer than the {model.state_dim} reduced coordinates that "
                             "are computed from them; use more delays, a larger future or a smaller state_dim")
        self.singular_values = torch.zeros(max(model.window_dim, model.state_dim), dtype=torch.float64)

    def sampled_every(self, timestep: float) -> None:
        """Set the data's sampling time, s. Raises ValueError unless a map or an Euler step covers exactly this time."""
        model = self.model.reduced
        if not model.flow and abs(model.base_timestep / timestep - 1) > TOLERANCE:
            raise ValueError(f"a step of {type(self.model).__name__} covers {model.base_timestep} s, but the data are "
                             f"sampled every {timestep} s; set the model's timestep to it, or resample the data")

    @property
    def flow(self) -> bool:
        return self.model.structure.scheme == "runge_kutta"

    @property
    def before(self) -> int:
        return self.model.delays + (self.derivative.half_width if self.flow else 0)

    @property
    def after(self) -> int:
        following = self.derivative.half_width if self.flow else 1
        return max(self.future, following) if self.predictive and "coordinates" in self.stages else following

    @torch.no_grad()
    def regressions(self, segment: Segment, stage: str) -> dict[str, Regression]:
        """The rows of a segment for the chart, or for the dynamics and the parametrization."""
        model, delays = self.model, self.model.delays
        windows = delay_windows(segment.observation, delays)
        held = windows.new_zeros(len(windows), 0, model.input_dim)
        if delays:
            held = delay_windows(segment.input[:-1], delays - 1)
        if stage == "coordinates":
            return self._coordinates(segment, windows, held)
        now, u, target, seen = self._flow(segment, windows, held) if self.flow else self._steps(segment, windows, held)
        structure = model.structure  # nothing saturates within the training range
        found = {"dynamics": lambda: Regression(structure.dynamics(torch.cat([now, u], dim=-1)), target),
                 "parametrization": lambda: Regression(structure.parametrization(now), seen)}
        return {form: found[form]() for form in self.fitted}

    def _steps(self, segment: Segment, windows: Tensor, held: Tensor) -> tuple[Tensor, ...]:
        """For every core sample: z, u, the target of the map or Euler step, and the target of the parametrization."""
        model, delays = self.model, self.model.delays
        z = model.encode(windows, held)
        if model.structure.scheme == "euler":
            target = (z[1:] - z[:-1]) / model.reduced.base_timestep
        else:
            target = (model.reduced.observables(windows, held) if model.structure.relift else z)[1:]
        return self._core(segment, delays, z[:-1], segment.input[delays:-1], target, self._seen(windows)[:-1])

    def _flow(self, segment: Segment, windows: Tensor, held: Tensor) -> tuple[Tensor, ...]:
        """For every core sample: z, the inputs within the stencil of the derivative, dz/dt, and the target of the
        parametrization.
        """
        stencil, delays, z = self.derivative, self.model.delays, self.model.encode(windows, held)
        width, rate = stencil.half_width, stencil(z, segment.timestep)
        middle = slice(width, width + len(rate))
        return self._core(segment, delays + width, z[middle], stencil.held_input(segment.input[delays:]), rate,
                          self._seen(windows)[middle])

    def _seen(self, windows: Tensor) -> Tensor:
        """The target of the parametrization: the newest sample, or the whole window."""
        newest = len(self.model.reduced.parametrization) == self.model.output_dim
        return windows[:, -1] if newest else windows.flatten(1)

    def _coordinates(self, segment: Segment, windows: Tensor, held: Tensor) -> dict[str, Regression]:
        past = self.model.reduced.chart_regressors(windows, held)
        if not self.predictive:
            if segment.kind != "decay" and self.manifold_data == "decays":
                return {}
            (rows,) = self._core(segment, self.model.delays, past[:, self.of_window])
            return {"coordinates": Regression(rows, rows[:, :0])}
        delays, future = self.model.delays, self.future
        if len(windows) <= future:
            return {}
        inputs = delay_windows(segment.input[delays:-1], future - 1).flatten(1)
        outputs = delay_windows(segment.observation[delays:], future).flatten(1)
        past, inputs, outputs = self._core(segment, delays, past[:-future, self.linear], inputs, outputs)
        return {"coordinates": Regression(torch.cat([past, inputs], dim=1), outputs)}

    @torch.no_grad()
    def assign(self, stage: str, solutions: Mapping[str, Solution]) -> None:
        """Write the solutions of a stage into the model. Raises ValueError if the data had no rows for it."""
        missing = [name for name in (["coordinates"] if stage == "coordinates" else self.fitted)
                   if name not in solutions]
        if missing:
            raise ValueError(f"the {stage} stage found no data for {missing}: there are no decays among the training "
                             "runs, or all are too short; record decays, or use manifold_data=all or a smaller future")
        if stage == "coordinates":
            self._assign_coordinates(solutions["coordinates"])
            return
        for form in self.fitted:
            _put(self.model, form, solutions[form].coefficients)

    def _assign_coordinates(self, solution: Solution) -> None:
        model, n = self.model, self.model.state_dim
        chart = model.reduced.chart.clone()
        chart[:, self.linear] = 0.0
        if not self.predictive:
            values, vectors = singular_values(solution.factor)
            self.singular_values[:len(values)] = values
            chart[:, self.of_window] = vectors[:, :n].T
            _put(model, "chart", chart)
            return
        count = len(self.linear)
        explained = solution.coefficients[:, :count]
        past = solution.factor.triangle[:count, :count]
        _, values, directions = torch.linalg.svd(past @ explained.T, full_matrices=False)
        known = min(len(values), len(self.singular_values))
        self.singular_values[:known] = values[:known]
        size = solution.rows ** 0.5 / values[:n].clamp_min(1e-300)
        reach = torch.linalg.vector_norm(past[:, self.newest])
        # scale every coordinate to the size of the outputs, so that all have the same range
        chart[:, self.linear] = size[:, None] * reach / solution.rows ** 0.5 * (directions[:n] @ explained)
        _put(model, "chart", chart)

    @staticmethod
    def _core(segment: Segment, first: int, *arrays: Tensor) -> tuple[Tensor, ...]:
        return tuple(segment.core_rows(array, first) for array in arrays)


def _run(columns: list[int]) -> slice | list[int]:
    """Consecutive columns as a slice, which needs no copy; other columns unchanged."""
    follow = columns == list(range(columns[0], columns[0] + len(columns))) if columns else False
    return slice(columns[0], columns[-1] + 1) if follow else columns


def _is_fitted(model: PolynomialTorchModel, form: str) -> bool:
    """Whether a table is fitted: its parameters are neither buffers nor empty."""
    parameters = dict(model.named_parameters())
    return all(part in parameters and parameters[part].numel() for part in model.tables[form])


def _put(model: PolynomialTorchModel, form: str, coefficients: Tensor) -> None:
    """Write the columns of a table into the parameters that form it side by side."""
    parts = [getattr(model, part) for part in model.tables[form]]
    for part, columns in zip(parts, coefficients.split([part.shape[1] for part in parts], dim=1)):
        part.copy_(columns)
