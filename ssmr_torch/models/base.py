"""What every reduced model offers: chart, parametrization, one step, linearization, rollout."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import NamedTuple, Self

import torch
from torch import Tensor, nn

from ssmr_torch.models.integrators import (
    DIVERGENCE_FACTOR,
    map_linearization,
    repeated_map,
    rk4_linearization,
    rk4_step,
    whole_multiple,
)
from ssmr_torch.models.tables import ModelTables


class Linearization(NamedTuple):
    """z⁺ ≈ A z + B u + c around the point of linearization; A (..., n, n), B (..., n, m), c (..., n)."""

    A: Tensor
    B: Tensor
    c: Tensor


class OutputLinearization(NamedTuple):
    """y ≈ C z + d around the point of linearization; C (..., p, n), d (..., p)."""

    C: Tensor
    d: Tensor


class Rollout(NamedTuple):
    """states (..., H+1, n) with the initial one; diverged_at (...): first diverged step, H+1 where none is."""

    states: Tensor
    diverged_at: Tensor


@torch.no_grad()
def fill(pairs) -> None:
    """Copy arrays into parameters or buffers, [(tensor, array), …]. Raises ValueError where a shape differs."""
    for tensor, array in pairs:
        if tuple(tensor.shape) != array.shape:
            raise ValueError(f"a table has shape {array.shape}; the declared sizes and degrees need "
                             f"{tuple(tensor.shape)}")
        tensor.copy_(torch.from_numpy(array.copy()))


class ReducedModel(nn.Module, ABC):
    """Discrete-time reduced model z⁺ = f(z, u), with chart z = v(window) and parametrization y = w(z).

    state_dim n, input_dim m, output_dim p (one sample), delays n_d; a window is the n_d + 1 newest samples, oldest
    first, `window_timestep` s apart, shape (..., n_d + 1, p), with the n_d inputs held between them (..., n_d, m).
    timestep: length of one `step` in s. Everything is float64 and SI.
    state_scale: (n,) largest |z_i| of the training data (infinite before a fit); a rollout whose norm exceeds
    `DIVERGENCE_FACTOR` times its norm has diverged.
    """

    def __init__(self, state_dim: int, input_dim: int, output_dim: int, delays: int,
                 timestep: float, window_timestep: float):
        super().__init__()
        sizes = {"state_dim": state_dim, "input_dim": input_dim, "output_dim": output_dim}
        for name, size in sizes.items():
            if int(size) != size or size < 1:
                raise ValueError(f"{name} is {size}; expected a positive integer")
        if delays < 0:
            raise ValueError(f"delays is {delays}; expected 0 or more (a window holds delays + 1 samples)")
        if not (timestep > 0 and window_timestep > 0):
            raise ValueError(f"timestep {timestep} s and window_timestep {window_timestep} s must be positive")
        self.state_dim, self.input_dim, self.output_dim = int(state_dim), int(input_dim), int(output_dim)
        self.delays = int(delays)
        self.timestep, self.window_timestep = float(timestep), float(window_timestep)
        self.register_buffer("state_scale", torch.full((self.state_dim,), torch.inf, dtype=torch.float64))

    @property
    def window_dim(self) -> int:
        """Number of values in a window, (n_d + 1) p."""
        return (self.delays + 1) * self.output_dim

    @property
    @abstractmethod
    def arguments(self) -> dict:
        """Constructor arguments, plain values: with the state dict they rebuild the model."""

    @abstractmethod
    def encode(self, window: Tensor, inputs: Tensor) -> Tensor:
        """Chart z = v(window): (..., n_d + 1, p), inputs (..., n_d, m) → (..., n)."""

    @abstractmethod
    def decode(self, z: Tensor) -> Tensor:
        """Newest sample of the parametrization y = w(z): (..., n) → (..., p)."""

    @abstractmethod
    def step(self, z: Tensor, u: Tensor) -> Tensor:
        """State one `timestep` later with u held: (..., n), (..., m) → (..., n)."""

    @abstractmethod
    def linearize(self, z: Tensor, u: Tensor) -> Linearization:
        """First-order expansion of `step`, batched over the leading dimensions."""

    @abstractmethod
    def linearize_output(self, z: Tensor) -> OutputLinearization:
        """First-order expansion of `decode`, batched over the leading dimensions."""

    @abstractmethod
    def tables(self) -> ModelTables:
        """The same model as NumPy arrays, for artifacts and controllers."""

    @classmethod
    @abstractmethod
    def from_tables(cls, tables: ModelTables) -> Self:
        """The Torch model with these tables."""

    def at_timestep(self, timestep: float) -> Self:
        """The same model with `step` covering another time in s; the spacing of the window stays."""
        return self.from_tables(self.tables().at_timestep(timestep))

    def rollout(self, z: Tensor, inputs: Tensor) -> Rollout:
        """States under inputs (..., H, m) held one timestep each, from z (..., n).

        A diverged rollout is frozen at its last state inside the bound, so that it stays finite.
        """
        bound = DIVERGENCE_FACTOR * torch.linalg.vector_norm(self.state_scale)
        horizon = inputs.shape[-2]
        states = [z]
        diverged_at = torch.full(z.shape[:-1], horizon + 1, dtype=torch.long, device=z.device)
        for k in range(horizon):
            following = self.step(z, inputs[..., k, :])
            norm = torch.linalg.vector_norm(following, dim=-1)
            left = ~(torch.isfinite(norm) & (norm <= bound))
            diverged_at = torch.where(left & (diverged_at > horizon), k + 1, diverged_at)
            z = torch.where((diverged_at <= horizon)[..., None], z, following)
            states.append(z)
        return Rollout(torch.stack(states, dim=-2), diverged_at)


class ContinuousTimeModel(ReducedModel):
    """dz/dt = drift(z) + control_field(z) u; `step` is the Runge-Kutta step of order four with the input held.

    substeps: integrator steps within one timestep.
    """

    def __init__(self, state_dim: int, input_dim: int, output_dim: int, delays: int,
                 timestep: float, window_timestep: float, substeps: int):
        super().__init__(state_dim, input_dim, output_dim, delays, timestep, window_timestep)
        if substeps < 1:
            raise ValueError(f"substeps is {substeps}; expected 1 or more")
        self.substeps = int(substeps)
        self.register_buffer("identity", torch.eye(self.state_dim, dtype=torch.float64), persistent=False)

    @abstractmethod
    def drift(self, z: Tensor) -> Tensor:
        """Reduced dynamics without input, (..., n) → (..., n), in state units per s."""

    @abstractmethod
    def control_field(self, z: Tensor) -> Tensor:
        """b_r(z): (..., n) → (..., n, m)."""

    @abstractmethod
    def rate_jacobian(self, z: Tensor, u: Tensor) -> Tensor:
        """∂/∂z of drift(z) + control_field(z) u, (..., n, n)."""

    def rate(self, z: Tensor, u: Tensor) -> Tensor:
        """dz/dt, (..., n)."""
        return self.drift(z) + (self.control_field(z) @ u[..., None])[..., 0]

    def step(self, z: Tensor, u: Tensor) -> Tensor:
        return rk4_step(lambda x: self.rate(x, u), z, self.timestep, self.substeps)

    def linearize(self, z: Tensor, u: Tensor) -> Linearization:
        following, A, B = rk4_linearization(
            lambda x: self.rate(x, u), lambda x: (self.rate_jacobian(x, u), self.control_field(x)),
            z, self.identity, self.timestep, self.substeps)
        c = following - (A @ z[..., None])[..., 0] - (B @ u[..., None])[..., 0]
        return Linearization(A, B, c)


class DiscreteTimeModel(ReducedModel):
    """z⁺ = advance(z, u), a map over base_timestep s; `step` is as many of them, with the input held, as fill timestep.

    base_timestep: s, what the model was or will be fitted at; None: the timestep. Raises ValueError where the timestep
    is no whole multiple of it.
    """

    def __init__(self, state_dim: int, input_dim: int, output_dim: int, delays: int,
                 timestep: float, window_timestep: float, base_timestep: float | None = None):
        super().__init__(state_dim, input_dim, output_dim, delays, timestep, window_timestep)
        self.base_timestep = float(timestep if base_timestep is None else base_timestep)
        self.repeats = whole_multiple(self.timestep, self.base_timestep)

    @abstractmethod
    def advance(self, z: Tensor, u: Tensor) -> Tensor:
        """State one base_timestep later with u held: (..., n), (..., m) → (..., n)."""

    @abstractmethod
    def advance_jacobians(self, z: Tensor, u: Tensor) -> tuple[Tensor, Tensor]:
        """∂z⁺/∂z (..., n, n) and ∂z⁺/∂u (..., n, m) of `advance`."""

    def advance_linearization(self, z: Tensor, u: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """`advance` and its Jacobians together."""
        return self.advance(z, u), *self.advance_jacobians(z, u)

    def step(self, z: Tensor, u: Tensor) -> Tensor:
        return repeated_map(lambda x: self.advance(x, u), z, self.repeats)

    def linearize(self, z: Tensor, u: Tensor) -> Linearization:
        following, A, B = map_linearization(lambda x: self.advance_linearization(x, u), z, self.repeats)
        c = following - (A @ z[..., None])[..., 0] - (B @ u[..., None])[..., 0]
        return Linearization(A, B, c)
