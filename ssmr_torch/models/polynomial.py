"""Polynomial reduced models: a chart, a parametrization and reduced dynamics, each a table times monomials."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar

import numpy as np

from ssmr_torch.models.arrays import Array, identity, like, namespace
from ssmr_torch.models.base import Linearization, Model, OutputLinearization, around, continuous, eigenvalues
from ssmr_torch.models.integrators import map_linearization, repeated_map, rk4_linearization, rk4_step
from ssmr_torch.models.monomials import Form, on_device
from ssmr_torch.models.output_coordinates import OutputCoordinates, coordinates_from_plain
from ssmr_torch.models.saturation import saturated
from ssmr_torch.models.sizes import check_steps
from ssmr_torch.models.structure import Structure, shape_in_words
from ssmr_torch.periods import whole_multiple


@dataclass(frozen=True, eq=False, kw_only=True)
class PolynomialModel(Model):
    """z = chart · ψ(ζ / window_scale),   y = last p rows of parametrization · φ_w(z),

        dz/dt = f(z, u)   or   z⁺ = z + base_timestep f(z, u)   or   z⁺ = f(z, u),   f = dynamics · φ(z, u),

    with the monomials ψ, φ_w, φ of the `Structure`. chart (n, ·), or (0, ·) if z is ψ itself; parametrization (·, ·)
    with p rows, or with all (n_d + 1) p rows of the window; dynamics (n, ·); window_scale: scale of ζ, (0,) for none.
    substeps: Runge-Kutta steps in a timestep. base_timestep: time in s of one map or Euler step; a timestep is a whole
    multiple of it. coordinates: output coordinates ξ = χ(y), which replace y in window and parametrization,
    y = χ⁻¹(w(z)); None: y itself. reach: nonlinear terms saturate beyond reach · state_scale. All float64, SI.
    Raises ValueError for tables that do not fit the structure, or a timestep that is not a whole multiple.
    """

    c_source: ClassVar[str] = "ssmr_torch.deployment.c.polynomial:polynomial"
    compiled: ClassVar[str] = "ssmr_torch.control.horizon_kernel:compiled_polynomial"
    batched: ClassVar[str] = "ssmr_torch.models.batch_kernel:CompiledBatch"

    structure: Structure
    chart: Array
    parametrization: Array
    dynamics: Array
    window_scale: Array = ()
    base_timestep: float | None = None
    substeps: int = 1
    coordinates: OutputCoordinates | None = None
    reach: float = 1.0

    def __post_init__(self):
        super().__post_init__()
        self.structure.check(self.state_dim, self.input_dim, self.latent_window + self.delays * self.input_dim,
                             {name: getattr(self, name).shape for name in ("chart", "parametrization", "dynamics")})
        rows, scaled, seen = len(self.parametrization), len(self.window_scale), len(self.structure.window_order)
        if rows not in (self.latent_dim, self.latent_window):
            raise ValueError(f"the parametrization has {rows} rows; expected {self.latent_dim} for the newest sample, "
                             f"or {self.latent_window} for the whole window")
        if not 0 < self.reach < np.inf:
            raise ValueError(f"reach is {self.reach}; expected a positive and finite number")
        if scaled not in (0, seen):
            raise ValueError(f"window_scale has {scaled} entries; expected {seen}, one for each input of the chart, "
                             "or none")
        check_steps("substeps", self.substeps)
        if not self.flow and self.base_timestep is None:
            object.__setattr__(self, "base_timestep", self.timestep)
        check_steps("the number of maps in one step", self.repeats)

    def plain(self) -> dict:
        coordinates = None if self.coordinates is None else self.coordinates.plain()
        return super().plain() | {"structure": self.structure.plain(), "coordinates": coordinates}

    @classmethod
    def from_plain(cls, arrays: dict[str, Array], plain: dict) -> PolynomialModel:
        return super().from_plain(arrays, plain | {"structure": Structure.from_plain(plain["structure"]),
                                                   "coordinates": coordinates_from_plain(plain.get("coordinates"))})

    @cached_property
    def latent_dim(self) -> int:
        """Number of values of one sample in the model's coordinates: p, or p' with output coordinates."""
        return self.output_dim if self.coordinates is None else self.coordinates.latent(self.output_dim)

    @property
    def latent_window(self) -> int:
        """Number of values in a window in the model's coordinates."""
        return (self.delays + 1) * self.latent_dim

    @property
    def flow(self) -> bool:
        return self.structure.scheme == "runge_kutta"

    @property
    def repeats(self) -> int:
        """Number of maps or Euler steps in one step."""
        if self.flow:
            return 1
        return whole_multiple("the step", self.timestep, "the timestep that this discrete-time model was fitted at",
                              self.base_timestep, "choose another period, or fit at a timestep that divides it")

    @property
    def affine(self) -> bool:
        structure = self.structure
        highest = max(structure.dynamics.highest, structure.parametrization.highest)
        straight = self.coordinates is None or self.coordinates.linear
        return highest <= 1 and straight and not structure.relift

    @property
    def takes_past_inputs(self) -> bool:
        return max(self.structure.window_order) >= self.latent_window

    @property
    def kind(self) -> str:
        return "polynomial"

    @property
    def geometry(self) -> str:
        seen, rows = super().geometry, len(self.parametrization)
        if self.coordinates is not None:
            seen += f"; in output coordinates: {self.coordinates.words}"
        if rows == self.latent_dim:
            return seen
        return f"{seen}; {shape_in_words(rows, self.state_dim, self.structure.parametrization.highest)}"

    @cached_property
    def constant_states(self) -> np.ndarray:
        """Whether each entry of the state is the constant 1, (n,)."""
        constant = np.array([not factors for factors in self.structure.chart.factors])
        return constant if not len(self.chart) else np.zeros(self.state_dim, dtype=bool)

    @cached_property
    def rates(self) -> np.ndarray:
        """Eigenvalues λ of the linear part of the reduced dynamics, in continuous time, (n,) 1/s."""
        if self.structure.relift:
            return super().rates
        values = eigenvalues(self.numpy().linear_part)
        if self.flow:
            return values
        h = self.base_timestep
        return continuous(1.0 + h * values if self.structure.scheme == "euler" else values, h)

    @cached_property
    def dynamics_form(self) -> Form:
        """f over (z, u)."""
        return Form(self.structure.dynamics, self.dynamics)

    @cached_property
    def output_form(self) -> Form:
        """w over z, only the rows of the newest sample, in the model's coordinates."""
        return Form(self.structure.parametrization, self.parametrization[-self.latent_dim:])

    @cached_property
    def window_form(self) -> Form:
        """w over z, all rows of the parametrization."""
        return Form(self.structure.parametrization, self.parametrization)

    @cached_property
    def edge(self) -> Array:
        """Edge of the range without saturation, (n,)."""
        bounded = (self.state_scale > 0) & self.structure.saturated
        return namespace(self.state_scale).where(bounded, self.reach * self.state_scale, np.inf)

    @cached_property
    def linear_part(self) -> Array:
        """∂f/∂z at rest, (·, n): the columns of the dynamics that multiply z alone."""
        needed, slopes = self.dynamics_form.slopes(0, self.state_dim)
        constant = slopes[:, np.flatnonzero(needed == 0)].sum(-1)  # 0 or 1 columns: 0 if no term is linear in z
        return constant.reshape(len(self.dynamics), self.state_dim)

    def encode(self, window: Array, inputs: Array | None = None) -> Array:
        regressors = self.chart_regressors(window, inputs)
        return regressors @ self.chart.T if len(self.chart) else regressors

    def chart_regressors(self, window: Array, inputs: Array | None = None) -> Array:
        """ψ(ζ / window_scale), (..., ·), such that encode = chart · regressors."""
        return self.structure.chart(self.observables(window, inputs))

    def observables(self, window: Array, inputs: Array | None = None) -> Array:
        """ζ / window_scale: (..., n_d + 1, p), (..., n_d, m) → (..., ·); needs inputs only if `takes_past_inputs`."""
        order, leading = self.structure.window_order, window.shape[:-2]
        seen = (window if self.coordinates is None else self.coordinates.forward(window)).reshape(*leading, -1)
        if self.takes_past_inputs:
            if inputs is None:
                raise ValueError(f"the chart of this model also needs the {self.delays} inputs held within the window; "
                                 f"give them as inputs of shape (…, {self.delays}, {self.input_dim})")
            seen = namespace(seen).concatenate([seen, inputs.reshape(*leading, -1)], -1)
        expected = self.latent_window + (self.delays * self.input_dim if self.takes_past_inputs else 0)
        if seen.shape[-1] != expected:
            raise ValueError(f"the window and its inputs hold {seen.shape[-1]} values; expected {expected}: "
                             f"{self.delays + 1} samples of {self.output_dim} outputs and, if the chart uses inputs, "
                             f"{self.delays} samples of {self.input_dim} inputs")
        if order != tuple(range(seen.shape[-1])):
            seen = seen[..., on_device(seen, np.array(order))]
        return seen / self.window_scale if len(self.window_scale) else seen

    def decode(self, z: Array) -> Array:
        xi = self.output_form(z)
        return xi if self.coordinates is None else self.coordinates.inverse(xi)

    def decode_window(self, z: Array) -> Array:
        """The whole window w(z), (..., n) → (..., n_d + 1, p). The parametrization must have all rows of a window."""
        found = self.window_form(z).reshape(*z.shape[:-1], -1, self.latent_dim)
        return found if self.coordinates is None else self.coordinates.inverse(found)

    def linearize_output(self, z: Array) -> OutputLinearization:
        form = self.output_form
        closure = form.monomials.multiplied_out(z)
        C, y = form.jacobian(closure, 0, self.state_dim), form.monomials.chosen(closure) @ form.table.T
        if self.coordinates is not None:
            C, y = self.coordinates.inverse_jacobian(y) @ C, self.coordinates.inverse(y)
        return OutputLinearization(C, y - (C @ z[..., None])[..., 0])

    def joint(self, z: Array, u: Array) -> tuple[Array, Array]:
        """(s(z), u), (..., n + m), and the slopes of s, (..., n)."""
        xp = namespace(z)
        within, slopes = saturated(z, self.edge, xp.tanh)
        return xp.concatenate([within, u], -1), slopes

    def dynamics_regressors(self, z: Array, u: Array) -> Array:
        """φ(z, u), (..., q), with s(z) in place of z in the nonlinear terms, such that f = dynamics · regressors."""
        xp = namespace(z)
        if not self.structure.saturated:
            return self.structure.dynamics(xp.concatenate([z, u], -1))
        seen = self.structure.dynamics(self.joint(z, u)[0])
        return xp.concatenate([seen, z], -1)[..., on_device(seen, self._beyond_linear)]

    def dynamics_rows(self, z: Array, u: Array) -> tuple[Array, Array, Array]:
        """f (·, M), `dynamics_regressors` (q, M) and ∂f/∂z (M, ·, n) at M points z (n, M), u (m, M)."""
        xp, monomials = namespace(z), self.structure.dynamics
        joint, slopes = self.joint(z.T, u.T) if self.structure.saturated else (xp.concatenate([z, u], 0).T, None)
        closure = monomials.rows(joint.T)
        regressors = monomials.chosen_rows(closure)
        if slopes is not None:
            regressors = xp.concatenate([regressors, z], 0)[on_device(z, self._beyond_linear)]
        needed, by_state = self.dynamics_form.slopes(0, self.state_dim)
        by_state = (closure[on_device(closure, needed)].T @ by_state.T).reshape(-1, len(self.dynamics), self.state_dim)
        return self.dynamics @ regressors, regressors, self._bent(by_state, slopes)

    @cached_property
    def _beyond_linear(self) -> np.ndarray:
        """Positions of the regressors in [φ, z]: the linear regressors are entries of z."""
        count = len(self.structure.dynamics)
        return np.array([count + row[0] if len(row) == 1 and row[0] < self.state_dim else k
                         for k, row in enumerate(self.structure.dynamics.factors)], dtype=np.int64)

    def rate(self, z: Array, u: Array) -> Array:
        """f(z, u), (..., ·): dz/dt of a flow."""
        return self.dynamics_regressors(z, u) @ self.dynamics.T

    def drift(self, z: Array) -> Array:
        """f(z, 0), the dynamics without input, (..., ·)."""
        return self.rate(z, self._without_input(z))

    def control_field(self, z: Array) -> Array:
        """∂f/∂u at u = 0, (..., ·, m)."""
        return self.rate_jacobians(z, self._without_input(z))[1]

    def _without_input(self, z: Array) -> Array:
        return namespace(z).zeros_like(z[..., :1]) + like(z, np.zeros(self.input_dim))

    def state_jacobian(self, z: Array, u: Array) -> Array:
        """∂f/∂z (..., ·, n)."""
        return self._by_state(*self._multiplied_out(z, u))

    def rate_jacobians(self, z: Array, u: Array) -> tuple[Array, Array]:
        """∂f/∂z (..., ·, n) and ∂f/∂u (..., ·, m)."""
        n, (closure, slopes) = self.state_dim, self._multiplied_out(z, u)
        return self._by_state(closure, slopes), self.dynamics_form.jacobian(closure, n, n + self.input_dim)

    def _multiplied_out(self, z: Array, u: Array) -> tuple[Array, Array | None]:
        """The closure of (s(z), u), and the slopes of s; None if nothing saturates."""
        joint, slopes = self.joint(z, u) if self.structure.saturated else (namespace(z).concatenate([z, u], -1), None)
        return self.structure.dynamics.multiplied_out(joint), slopes

    def _by_state(self, closure: Array, slopes: Array | None) -> Array:
        return self._bent(self.dynamics_form.jacobian(closure, 0, self.state_dim), slopes)

    def _bent(self, by_state: Array, slopes: Array | None) -> Array:
        """∂f/∂z, from ∂f/∂s = by_state and these slopes of s."""
        if slopes is None:
            return by_state
        slopes = slopes[..., None, :]
        return slopes * by_state + (1.0 - slopes) * self.linear_part

    def advance(self, z: Array, u: Array) -> Array:
        """State one base_timestep later, of a map or an Euler step, (..., n)."""
        found = self.rate(z, u)
        if self.structure.scheme == "euler":
            return z + self.base_timestep * found
        return self.structure.chart(found) if self.structure.relift else found

    def advance_linearization(self, z: Array, u: Array) -> tuple[Array, Array, Array]:
        """`advance`, and its Jacobians ∂z⁺/∂z (..., n, n) and ∂z⁺/∂u (..., n, m)."""
        F, G = self.rate_jacobians(z, u)
        if self.structure.scheme == "euler":
            h = self.base_timestep
            return self.advance(z, u), identity(z, self.state_dim) + h * F, h * G
        if self.structure.relift:
            lifted = self.structure.chart.jacobian(self.rate(z, u))
            F, G = lifted @ F, lifted @ G
        return self.advance(z, u), F, G

    def step(self, z: Array, u: Array) -> Array:
        if self.flow:
            return rk4_step(lambda x: self.rate(x, u), z, self.timestep, self.substeps)
        return repeated_map(lambda x: self.advance(x, u), z, self.repeats)

    def step_jacobians(self, z: Array, u: Array) -> tuple[Array, Array, Array]:
        """`step`, ∂z⁺/∂z (..., n, n) and ∂z⁺/∂u (..., n, m)."""
        if self.flow:
            return rk4_linearization(lambda x: self.rate(x, u), lambda x: self.rate_jacobians(x, u), z,
                                     identity(z, self.state_dim), self.timestep, self.substeps)
        return map_linearization(lambda x: self.advance_linearization(x, u), z, self.repeats)

    def linearize(self, z: Array, u: Array) -> Linearization:
        return around(*self.step_jacobians(z, u), z, u)


@dataclass(frozen=True, eq=False, kw_only=True)
class PregainModel(PolynomialModel):
    """A polynomial model with a static pregain, for the controller `static_pregain`.

    pregain G (m, 1 + p): u = G [1, y] at rest. set_points (1 + p, 1 + p): triangular factor of the mean of
    [1, y]ᵀ [1, y] over the set points from which G was fitted.
    """

    pregain: Array
    set_points: Array
