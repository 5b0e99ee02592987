"""Any polynomial model in closed form, from its structure: chart, then dynamics and parametrization in one pass."""

from __future__ import annotations

from collections.abc import Mapping

import torch
from torch import Tensor, nn

from ssmr_torch.data.derivatives import Stencil, central_difference
from ssmr_torch.data.windows import Segment, delay_windows
from ssmr_torch.fitting.ssmr_least_squares import Regression
from ssmr_torch.fitting.streamed_least_squares import Solution, singular_values
from ssmr_torch.models.torch_model import PolynomialTorchModel
from ssmr_torch.periods import TOLERANCE


class PolynomialLeastSquares(nn.Module):
    """The regressions of a `PolynomialTorchModel`, over decays and controlled runs alike; its structure says which.

    coordinates: of the chart, the columns that are linear in the window ŷ and in the inputs û held within it; columns
        beyond these stay as they are. With chart "tangent_space", SVD of the windows of the decays (manifold_data
        "decays") or of all runs ("all"): the chart is the n leading directions, blind to the inputs until it is
        refined. With chart "predictive", the outputs of the next `future` samples are regressed on [ŷ, û] and the
        inputs that act meanwhile; what the past explains of them, a projection along the future inputs, has n leading
        directions [subspace identification: Van Overschee and De Moor 1994]. It takes the inputs' part out of the
        window, and what varies much without mattering later.
    dynamics: what the scheme says of f(z, u) on its monomials: z⁺ of a map (ζ⁺ where that is lifted anew),
        (z⁺ - z) / h of an Euler step, dz/dt by the stencil `derivative` of a flow;   parametrization: y on its own.

    A table whose parameters are buffers is given, and stays; so is the chart of a model whose state is the lifted
    window itself, and there is no stage for it.
    Raises ValueError for another chart or manifold_data, for a window or a future with fewer values than n, for data
    at another sampling time than the map's or the Euler step's, and in `assign` where a stage found no rows.
    """

    names = ("coordinates", "dynamics", "parametrization")

    def __init__(self, model: PolynomialTorchModel, *, derivative: Stencil | None = None, chart: str = "predictive",
                 future: int = 10, manifold_data: str = "decays"):
        super().__init__()
        if not isinstance(model, PolynomialTorchModel):
            raise ValueError(f"{type(model).__name__} is no polynomial model, a PolynomialTorchModel with a structure; "
                             "choose the fit that its configuration brings")
        for name, value, options in (("manifold_data", manifold_data, ("decays", "all")),
                                     ("chart", chart, ("tangent_space", "predictive"))):
            if value not in options:
                raise ValueError(f"{name} is {value!r}; expected one of {options}")
        if future < 1:
            raise ValueError(f"future is {future} samples; expected 1 or more")
        # not a submodule: the fit that holds this procedure also holds the model, and saves it once
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
        """Which columns of the chart are linear in ŷ, in its newest sample, and in û."""
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
            raise ValueError(f"{shown} values in {of_what} are fewer than the {model.state_dim} reduced coordinates "
                             "that their singular vectors must give; use more delays, a larger future or a smaller "
                             "state_dim")
        self.singular_values = torch.zeros(max(model.window_dim, model.state_dim), dtype=torch.float64)

    def sampled_every(self, timestep: float) -> None:
        """Take the data's sampling time, s. Raises ValueError where it is not what a map or an Euler step covers."""
        model = self.model.reduced
        if not model.flow and abs(model.base_timestep / timestep - 1) > TOLERANCE:
            raise ValueError(f"a step of {type(self.model).__name__} covers {model.base_timestep} s, the data are "
                             f"sampled every {timestep} s; fit it at the data's sampling time, or resample the data")

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
        """The rows of a segment for the coordinates, or for the dynamics and the parametrization."""
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
        """z, u, what a map or an Euler step makes of them, and what is seen of z, of every core sample."""
        model, delays = self.model, self.model.delays
        z = model.encode(windows, held)
        if model.structure.scheme == "euler":
            target = (z[1:] - z[:-1]) / model.reduced.base_timestep
        else:
            target = (model.reduced.observables(windows, held) if model.structure.relift else z)[1:]
        return self._core(segment, delays, z[:-1], segment.input[delays:-1], target, self._seen(windows)[:-1])

    def _flow(self, segment: Segment, windows: Tensor, held: Tensor) -> tuple[Tensor, ...]:
        """z, the inputs that its derivative has felt, dz/dt, and what is seen of z."""
        stencil, delays, z = self.derivative, self.model.delays, self.model.encode(windows, held)
        width, rate = stencil.half_width, stencil(z, segment.timestep)
        middle = slice(width, width + len(rate))
        return self._core(segment, delays + width, z[middle], stencil.held_input(segment.input[delays:]), rate,
                          self._seen(windows)[middle])

    def _seen(self, windows: Tensor) -> Tensor:
        """The rows of the parametrization: the newest sample, or the whole window."""
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
        """Put the solutions of a stage in place. Raises ValueError when the data held no rows for it."""
        missing = [name for name in (["coordinates"] if stage == "coordinates" else self.fitted)
                   if name not in solutions]
        if missing:
            raise ValueError(f"the {stage} stage found no rows for {missing}: the training data hold no decays, or no "
                             "run is long enough; record some, use manifold_data=all or a smaller future")
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
        # every coordinate as large as the outputs, so that one range of states speaks for all
        chart[:, self.linear] = size[:, None] * reach / solution.rows ** 0.5 * (directions[:n] @ explained)
        _put(model, "chart", chart)

    @staticmethod
    def _core(segment: Segment, first: int, *arrays: Tensor) -> tuple[Tensor, ...]:
        return tuple(segment.core_rows(array, first) for array in arrays)


def _run(columns: list[int]) -> slice | list[int]:
    """Columns that follow each other as a slice, which copies nothing."""
    follow = columns == list(range(columns[0], columns[0] + len(columns))) if columns else False
    return slice(columns[0], columns[-1] + 1) if follow else columns


def _is_fitted(model: PolynomialTorchModel, form: str) -> bool:
    """Whether the parameters of a table are to be found: neither buffers nor empty."""
    parameters = dict(model.named_parameters())
    return all(part in parameters and parameters[part].numel() for part in model.tables[form])


def _put(model: PolynomialTorchModel, form: str, coefficients: Tensor) -> None:
    """The columns of a table into the parameters that make it, side by side."""
    parts = [getattr(model, part) for part in model.tables[form]]
    for part, columns in zip(parts, coefficients.split([part.shape[1] for part in parts], dim=1)):
        part.copy_(columns)
