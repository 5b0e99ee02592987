"""Least-squares fit of Koopman models in closed form: scale, transition of the lifted state, and static pregain."""

from __future__ import annotations

from collections.abc import Mapping

import torch
from torch import Tensor, nn

from ssmr_torch.checked_arguments import checked
from ssmr_torch.data.windows import Segment, delay_windows
from ssmr_torch.fitting.ssmr_least_squares import Regression
from ssmr_torch.fitting.streamed_least_squares import Solution
from ssmr_torch.models.koopman import Koopman
from ssmr_torch.periods import whole_multiple
from ssmr_torch.ranges import Each, OneOf

# of the largest input of a run
SAME_INPUT = 1e-9


class KoopmanLeastSquares(nn.Module):
    """The stages of the fit of a `Koopman` model. Each stage takes one pass over the data.

    scale: the root mean square of each observable, by which ζ is divided. It improves the conditioning and gives the
        ridge the same meaning for all observables. It does not change an unregularized fit, except by rounding.
    transition: regression of ψ(ζ_{k+1}), or of ζ_{k+1} only with relift, on [z, u, u ⊗ (z without its constant)], over
        all pairs of samples of one run that are one model step apart. Known rows are set without regression: the
        constant, and for degree 1 the delayed copies of y and u.
    pregain (if the model has one): regression of u on [1, y] over the set points: the last sample of each static run,
        and the last sample before each change of its input.
    If the model's timestep is a multiple of the sampling time, windows are spaced by the model's timestep, beginning at
    every sample. The input is then its mean over the step; an input that is held over the step keeps its value.
    kinds: kinds of runs for the transition. Raises ValueError in `assign` if the data had no rows for a stage.
    """

    names = ("scale", "transition", "pregain")

    @checked(kinds=Each(OneOf("decay", "controlled", "static"), 1, 3))
    def __init__(self, model: Koopman, *, kinds: tuple[str, ...] = ("decay", "controlled")):
        super().__init__()
        unknown = [kind for kind in kinds if kind not in ("decay", "controlled", "static")]
        if unknown or not kinds:
            raise ValueError(f"kinds is {list(kinds)}; expected one or more of decay, controlled, static")
        # not a submodule: the fit that contains this procedure also contains the model, and saves it only once
        self.__dict__["model"] = model
        self.kinds = tuple(kinds)
        self.stages = ("scale", "transition") + (("pregain",) if model.has_pregain else ())
        self.takes_static = model.has_pregain or "static" in kinds
        self.stride = 1

    def sampled_every(self, timestep: float) -> None:
        """Set the data's sampling time, s. Raises ValueError unless the model's timestep is a whole multiple of it."""
        self.stride = whole_multiple("the model's timestep", self.model.base_timestep, "the data's", timestep)

    @property
    def before(self) -> int:
        return self.model.delays * self.stride

    @property
    def after(self) -> int:
        return self.stride

    @torch.no_grad()
    def regressions(self, segment: Segment, stage: str) -> dict[str, Regression]:
        """Rows of a segment: transitions of observables, or set points for the stage "pregain"; {} if it has none."""
        if stage == "pregain":
            return self._pregain(segment) if segment.kind == "static" else {}
        if segment.kind not in self.kinds or len(segment.observation) <= self.before + self.after:
            return {}
        first = self.before
        windows, held = self.windows(segment)
        observables = self.model.observables(windows, held)
        if stage == "scale":
            (rows,) = self._core(segment, first, observables)
            return {"scale": Regression(rows, rows[:, :0])}
        z = self.model.lifting(observables / self.model.scale)
        now, following = z[:-self.stride], z[self.stride:, self.model.propagated]
        u = self._held(segment.input)[first:first + len(now)]
        now, u, following = self._core(segment, first, now, u, following)
        return {"transition": Regression(self._regressors(now, u), following)}

    @torch.no_grad()
    def assign(self, stage: str, solutions: Mapping[str, Solution]) -> None:
        """Write the solution of a stage into the model. Raises ValueError if the data had no rows for it."""
        if stage not in solutions:
            kinds = ("static",) if stage == "pregain" else self.kinds
            raise ValueError(f"the {stage} stage found no data: there are no {' or '.join(kinds)} runs among the "
                             "training runs; record some (excitation=static gives set points), or choose another model")
        model, solution = self.model, solutions[stage]
        if stage == "scale":
            rms = torch.linalg.vector_norm(solution.factor.triangle, dim=0) / max(solution.rows, 1) ** 0.5
            model.scale.copy_(torch.where(rms > 0, rms, torch.ones_like(rms)))
        elif stage == "pregain":
            size = 1 + model.output_dim
            model.pregain.copy_(solution.coefficients)
            model.set_points.copy_(solution.factor.triangle[:size, :size] / solution.rows**0.5)
        else:
            self._assign_transition(solution.coefficients.clone())

    def _assign_transition(self, coefficients: Tensor) -> None:
        model, size, m = self.model, self.model.state_dim, self.model.input_dim
        self._set_known_rows(coefficients)
        model.A.copy_(coefficients[:, :size])
        model.B.copy_(coefficients[:, size:size + m])
        if model.bilinear:
            first = int(model.constant)
            model.N.zero_()
            model.N[:, :, first:] = coefficients[:, size + m:].unflatten(1, (m, size - first)).transpose(0, 1)

    def _set_known_rows(self, coefficients: Tensor) -> None:
        """The constant stays 1; a delayed sample or input of the next step is a sample or input of this step."""
        model, p, m, linear = self.model, self.model.output_dim, self.model.input_dim, int(self.model.constant)
        first = linear - model.propagated.start
        if first:
            coefficients[0] = 0.0
            coefficients[0, 0] = 1.0
        scale, outputs = model.scale, (model.delays + 1) * p
        for row in range(p, len(scale)):
            newest_input = outputs <= row < outputs + m
            source = row - (p if row < outputs else m)
            coefficients[first + row] = 0.0
            if newest_input:
                coefficients[first + row, model.state_dim + row - outputs] = 1 / scale[row]
            else:
                coefficients[first + row, linear + source] = scale[source] / scale[row]

    def _regressors(self, z: Tensor, u: Tensor) -> Tensor:
        parts = [z, u]
        if self.model.bilinear:
            # u times the constant is u, which B already covers
            parts.append((u[:, :, None] * z[:, None, int(self.model.constant):]).flatten(1))
        return torch.cat(parts, dim=1)

    def windows(self, segment: Segment) -> tuple[Tensor, Tensor]:
        """Windows spaced by the model's step, and the inputs held within them, oldest first."""
        delays, reach = self.model.delays, self.before
        windows = delay_windows(segment.observation, reach)[:, ::self.stride]
        held = windows.new_zeros(len(windows), 0, self.model.input_dim)
        if delays:
            held = delay_windows(self._held(segment.input)[:len(windows) + reach - self.stride],
                                 reach - self.stride)[:, ::self.stride]
        return windows, held

    def _held(self, inputs: Tensor) -> Tensor:
        """Mean of the inputs over a step from each sample, (L - stride + 1, m)."""
        return delay_windows(inputs, self.stride - 1).mean(1)

    def _core(self, segment: Segment, first: int, *arrays: Tensor) -> tuple[Tensor, ...]:
        return tuple(segment.core_rows(array, first) for array in arrays)

    @staticmethod
    def _pregain(segment: Segment) -> dict[str, Regression]:
        """Set points: core samples after which the input changes or the run ends."""
        # recorded inputs differ by rounding; this is not a change
        changes = ((segment.input[1:] - segment.input[:-1]).abs() > SAME_INPUT * segment.input.abs().amax()).any(1)
        settled = torch.zeros(len(segment.input), dtype=torch.bool, device=changes.device)
        settled[:-1], settled[-1] = changes, True
        settled[:segment.core[0]] = False
        settled[segment.core[1]:] = False
        if not settled.any():
            return {}
        y = segment.observation[settled]
        return {"pregain": Regression(torch.cat([torch.ones_like(y[:, :1]), y], dim=1), segment.input[settled])}
