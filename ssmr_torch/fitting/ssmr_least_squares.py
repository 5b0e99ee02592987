"""Least-squares fit of SSMR in closed form: tangent space, reparametrization, manifold and control, stage by stage."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple, Protocol

import torch
from torch import Tensor, nn

from ssmr_torch.checked_arguments import checked
from ssmr_torch.data.derivatives import Stencil, central_difference
from ssmr_torch.data.windows import Segment, delay_windows
from ssmr_torch.fitting.streamed_least_squares import Solution, singular_values
from ssmr_torch.models.monomials import graded
from ssmr_torch.models.ssmr import SSMR
from ssmr_torch.ranges import OneOf, OrNone, Whole


class Regression(NamedTuple):
    """One batch of rows: targets (N, q) ≈ coefficients · features (N, k)."""

    features: Tensor
    targets: Tensor


class LeastSquaresModel(Protocol):
    """A procedure that fits a model in closed form, in stages. Each stage takes one pass over the data."""

    stages: tuple[str, ...]
    names: tuple[str, ...]
    model: nn.Module
    before: int
    after: int

    def regressions(self, segment: Segment, stage: str) -> dict[str, Regression]:
        """The rows of one segment for the regressions of a stage; none if its kind of run is not used."""

    def assign(self, stage: str, solutions: Mapping[str, Solution]) -> None:
        """Write the solutions of a stage into the model."""


class SSMRLeastSquares(nn.Module):
    """The three steps of SSMR for control (paper, Eq. 4-11) as stages of linear regressions.

    tangent_space: SVD of the decays' windows; V holds the n leading directions.
    reparametrization (only if detection_delays > model.delays): z̄ from the long windows; the model's own window is
        regressed on z̄^{1:n_w}; V = Gram-Schmidt of the linear block V̄, and z = Vᵀ V̄ z̄ (Eq. 10-11).
    manifold: W, and the nonlinear part of the chart if chart_degree > 1; with calibration "frozen" also R from the
        decays.
    control: with calibration "frozen", B and B_r from the controlled runs, while R is kept (Eq. 6). With "joint", R, B
        and B_r in one regression over decays and controlled runs, because few decays alone do not determine R.
    parametrization_fit: "full" regresses all of w; "tangent" keeps its linear block V (Eq. 5). "tangent" loses accuracy
        in all orders above the second, because the directions of the SVD are tangent to the manifold only for vanishing
        amplitude. The regression target is the part of the window beyond V z; without reparametrization, v(w(z)) = z
        exactly.
    input_alignment: "held" pairs each difference with the mean of the held inputs that act on it; "sample" pairs it
        with the input at its sample, as the authors do.
    manifold_data: the runs for the tangent space and the manifold: "decays", or "all" if there are no decays.

    names: names of all regressions that a stage may have.
    Raises ValueError for other options, if the SVD has fewer directions than state_dim, and in `assign` if the data had
    no run of the kind that a stage needs.
    """

    names = ("tangent_space", "reparametrization", "parametrization", "chart", "drift", "control", "dynamics")

    @checked(calibration=OneOf("joint", "frozen"), parametrization_fit=OneOf("full", "tangent"),
             input_alignment=OneOf("held", "sample"), detection_delays=OrNone(Whole(0, 1000)),
             manifold_data=OneOf("decays", "all"))
    def __init__(self, model: SSMR, *, derivative: Stencil | None = None, calibration: str = "joint",
                 parametrization_fit: str = "full", input_alignment: str = "held",
                 detection_delays: int | None = None, manifold_data: str = "decays"):
        super().__init__()
        if not isinstance(model, SSMR):
            raise ValueError(f"{type(model).__name__} is not an SSMR, but this closed-form fit is only for SSMR; for "
                             "other polynomial models use closed_form@fit.closed_form=polynomial")
        for name, value, options in (("calibration", calibration, ("joint", "frozen")),
                                     ("parametrization_fit", parametrization_fit, ("full", "tangent")),
                                     ("input_alignment", input_alignment, ("held", "sample")),
                                     ("manifold_data", manifold_data, ("decays", "all"))):
            if value not in options:
                raise ValueError(f"{name} is {value!r}; expected one of {options}")
        if detection_delays is not None and detection_delays < model.delays:
            raise ValueError(f"detection_delays is {detection_delays}; expected at least {model.delays}, the model's "
                             "number of delays")
        if model.chart_degree > 1 and (detection_delays is None or detection_delays == model.delays):
            raise ValueError(f"chart_degree is {model.chart_degree}; expected 1, because the coordinates Vᵀ · window "
                             "are linear. For a higher degree set detection_delays above the model's delays")
        # not a submodule: the fit that contains this procedure also contains the model, and saves it only once
        self.__dict__["model"] = model
        self.derivative = derivative or central_difference(6)
        self.calibration, self.parametrization_fit = calibration, parametrization_fit
        self.input_alignment, self.manifold_data = input_alignment, manifold_data
        self.detection_delays = model.delays if detection_delays is None else detection_delays
        self.reparametrized = self.detection_delays > model.delays
        self.stages = ("tangent_space", *(("reparametrization",) if self.reparametrized else ()),
                       "manifold", "control")
        n, long_window = model.state_dim, (self.detection_delays + 1) * model.output_dim
        if long_window < n:
            raise ValueError(f"a window of {long_window} values cannot give {n} reduced coordinates; use more delays "
                             "or a smaller state_dim")
        self.register_buffer("detection_chart", torch.zeros(n, long_window, dtype=torch.float64))
        self.register_buffer("singular_values", torch.zeros(long_window, dtype=torch.float64))
        self.nonlinear_features = graded(n, 1, model.parametrization_degree)

    @property
    def before(self) -> int:
        return self.detection_delays + self.derivative.half_width

    @property
    def after(self) -> int:
        return self.derivative.half_width

    @torch.no_grad()
    def regressions(self, segment: Segment, stage: str) -> dict[str, Regression]:
        decay = segment.kind == "decay"
        shown = decay or (self.manifold_data == "all" and segment.kind == "controlled")
        if stage == "tangent_space":
            return self._tangent_space(segment) if shown else {}
        if stage == "reparametrization":
            return self._reparametrization(segment) if shown else {}
        if stage == "manifold":
            manifold = self._manifold(segment) if shown else {}
            return manifold | (self._drift(segment) if decay and self.calibration == "frozen" else {})
        if self.calibration == "frozen":
            return self._control(segment) if segment.kind == "controlled" else {}
        return self._dynamics(segment) if segment.kind in ("decay", "controlled") else {}

    @torch.no_grad()
    def assign(self, stage: str, solutions: Mapping[str, Solution]) -> None:
        """Write the solutions of a stage into the model; a second call changes nothing.

        Raises ValueError if the data had no rows for a regression of the stage.
        """
        self._check(stage, solutions)
        model, n = self.model, self.model.state_dim
        if stage == "tangent_space":
            self._assign_tangent_space(solutions["tangent_space"])
        elif stage == "reparametrization":
            linear = solutions["reparametrization"].coefficients[:, :n]
            orthonormal, triangle = torch.linalg.qr(linear)
            self._set_chart(orthonormal * torch.sign(triangle.diagonal()))
            self.detection_chart.copy_(model.chart[:, :model.window_dim] @ linear @ self.detection_chart)
        elif stage == "manifold":
            self._set_chart(model.chart[:, :model.window_dim].T.clone())
            if "parametrization" in solutions:
                coefficients = solutions["parametrization"].coefficients
                model.parametrization[:, -coefficients.shape[1]:] += coefficients
            if model.chart_degree > 1:
                model.chart[:, model.window_dim:] = solutions["chart"].coefficients
            if "drift" in solutions:
                model.drift_table.copy_(solutions["drift"].coefficients)
        else:
            self._assign_control(solutions)

    def _check(self, stage: str, solutions: Mapping[str, Solution]) -> None:
        frozen, curved_chart = self.calibration == "frozen", self.model.chart_degree > 1
        needed = {"manifold": ["drift"] * frozen + ["chart"] * curved_chart,
                  "control": ["control" if frozen else "dynamics"]}.get(stage, [stage])
        missing = [name for name in needed if name not in solutions]
        if missing:
            kind = "controlled" if stage == "control" else "decay"
            raise ValueError(f"the {stage} stage found no data for {missing}: there are no {kind} runs among the "
                             "training runs; record some, or use manifold_data=all and calibration=joint")

    def encode_detected(self, segment: Segment) -> Tensor:
        """Reduced coordinates of the segment's samples from its long windows, (L - detection_delays, n)."""
        return delay_windows(segment.observation, self.detection_delays).flatten(1) @ self.detection_chart.T

    def _window(self, segment: Segment) -> Tensor:
        """The model's own windows, which are the newest samples of the long windows, flattened."""
        return delay_windows(segment.observation, self.detection_delays)[:, -(self.model.delays + 1):].flatten(1)

    def _core(self, segment: Segment, *arrays: Tensor) -> tuple[Tensor, ...]:
        return tuple(segment.core_rows(array, self.detection_delays) for array in arrays)

    def _tangent_space(self, segment: Segment) -> dict[str, Regression]:
        long_window = delay_windows(segment.observation, self.detection_delays).flatten(1)
        (rows,) = self._core(segment, long_window)
        return {"tangent_space": Regression(rows, rows[:, :0])}

    def _reparametrization(self, segment: Segment) -> dict[str, Regression]:
        z, window = self._core(segment, self.encode_detected(segment), self._window(segment))
        return {"reparametrization": Regression(self.nonlinear_features(z), window)}

    def _manifold(self, segment: Segment) -> dict[str, Regression]:
        model, n = self.model, self.model.state_dim
        z, window = self._core(segment, self.encode_detected(segment), self._window(segment))
        features = self.nonlinear_features(z)
        linear = model.chart[:, :model.window_dim]
        found = {}
        first = n if self.parametrization_fit == "tangent" else 0
        curved = model.window_dim > n and model.parametrization_degree > 1
        if (curved or self.reparametrized) and features.shape[1] > first:
            found["parametrization"] = Regression(features[:, first:], window - z @ linear)
        if model.chart_degree > 1:
            found["chart"] = Regression(model.structure.chart(window)[:, model.window_dim:], z - window @ linear.T)
        return found

    def _drift(self, segment: Segment) -> dict[str, Regression]:
        features, rate = self._rates(segment)
        return {"drift": Regression(features[:, :self._drift_columns], rate)}

    def _control(self, segment: Segment) -> dict[str, Regression]:
        features, rate = self._rates(segment)
        free = features[:, :self._drift_columns]
        return {"control": Regression(features[:, self._drift_columns:], rate - free @ self.model.drift_table.T)}

    def _dynamics(self, segment: Segment) -> dict[str, Regression]:
        features, rate = self._rates(segment)
        return {"dynamics": Regression(features, rate)}

    @property
    def _drift_columns(self) -> int:
        return self.model.drift_table.shape[1]

    def _rates(self, segment: Segment) -> tuple[Tensor, Tensor]:
        """Core rows of the regressors of the dynamics, at z and the input that belongs to it, and of dz/dt.

        z comes from the long detection windows for decays, and from the chart for controlled runs, as in closed loop.
        """
        if segment.kind == "decay":
            delays, z = self.detection_delays, self.encode_detected(segment)
        else:
            delays, z = self.model.delays, self.model.encode(delay_windows(segment.observation, self.model.delays))
        stencil = self.derivative
        align = stencil.held_input if self.input_alignment == "held" else stencil.sampled_input
        rate, felt = stencil(z, segment.timestep), align(segment.input[delays:])
        middle = z[stencil.half_width:stencil.half_width + len(rate)]
        z, rate, felt = (segment.core_rows(rows, delays + stencil.half_width) for rows in (middle, rate, felt))
        return self.model.structure.dynamics(torch.cat([z, felt], dim=1)), rate

    def _assign_tangent_space(self, solution: Solution) -> None:
        values, vectors = singular_values(solution.factor)
        self.singular_values.copy_(values)
        directions = vectors[:, :self.model.state_dim]
        self.detection_chart.copy_(directions.T)
        if not self.reparametrized:
            self._set_chart(directions)

    def _set_chart(self, directions: Tensor) -> None:
        """Set v = Vᵀ and the linear block of w to V, for orthonormal V (window, n)."""
        model = self.model
        model.chart.zero_()
        model.parametrization.zero_()
        model.chart[:, :model.window_dim] = directions.T
        model.parametrization[:, :model.state_dim] = directions

    def _assign_control(self, solutions: Mapping[str, Solution]) -> None:
        if self.calibration == "frozen":
            self.model.control_table.copy_(solutions["control"].coefficients)
            return
        coefficients = solutions["dynamics"].coefficients
        split = self._drift_columns
        self.model.drift_table.copy_(coefficients[:, :split])
        self.model.control_table.copy_(coefficients[:, split:])
