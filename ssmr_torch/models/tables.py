"""Reduced models as plain arrays: what an artifact stores and a controller runs, without Torch."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, fields, replace
from typing import Self

import numpy as np

from ssmr_torch.models.integrators import map_linearization, repeated_map, whole_multiple


@dataclass(frozen=True, eq=False, kw_only=True)
class ModelTables(ABC):
    """The NumPy twin of a `ReducedModel`: its coefficient tables (float64, SI, read-only) and its constants.

    Array fields are annotated `np.ndarray`, all other fields hold plain values; artifacts store exactly these.
    state_scale (n,), input_dim, output_dim, delays, timestep, window_timestep: as in `ReducedModel`.
    """

    state_scale: np.ndarray
    input_dim: int
    output_dim: int
    delays: int
    timestep: float
    window_timestep: float

    def __post_init__(self):
        for name in self.array_names():
            array = np.array(getattr(self, name), dtype=np.float64)
            array.setflags(write=False)
            object.__setattr__(self, name, array)

    @classmethod
    def array_names(cls) -> tuple[str, ...]:
        """Names of the fields that are arrays."""
        return tuple(field.name for field in fields(cls) if field.type in ("np.ndarray", np.ndarray))

    @classmethod
    def scalar_names(cls) -> tuple[str, ...]:
        """Names of the fields that are plain values."""
        return tuple(field.name for field in fields(cls) if field.name not in cls.array_names())

    @property
    def state_dim(self) -> int:
        """n"""
        return len(self.state_scale)

    @property
    def affine(self) -> bool:
        """Whether z⁺ is affine in (z, u), and y in z, everywhere: a controller then condenses once for all."""
        return False

    @property
    def geometry(self) -> str:
        """What the model card says of the chart and the parametrization."""
        return (f"{self.state_dim} states from windows of {self.delays + 1} samples of {self.output_dim} outputs, "
                f"{self.window_timestep:g} s apart")

    @abstractmethod
    def encode(self, window: np.ndarray, inputs: np.ndarray) -> np.ndarray:
        """Chart z = v(window): (..., n_d + 1, p), inputs held between its samples (..., n_d, m) → (..., n)."""

    @abstractmethod
    def decode(self, z: np.ndarray) -> np.ndarray:
        """Newest sample of w(z): (..., n) → (..., p)."""

    @abstractmethod
    def step(self, z: np.ndarray, u: np.ndarray) -> np.ndarray:
        """State one timestep later with u held, (..., n), (..., m) → (..., n)."""

    @abstractmethod
    def linearize(self, z: np.ndarray, u: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """A (..., n, n), B (..., n, m), c (..., n) of z⁺ ≈ A z + B u + c."""

    @abstractmethod
    def linearize_output(self, z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """C (..., p, n), d (..., p) of y ≈ C z + d."""

    def rollout(self, z: np.ndarray, inputs: np.ndarray) -> np.ndarray:
        """States (..., H + 1, n) from z (..., n) under inputs (..., H, m) held one timestep each."""
        states = [z]
        for k in range(inputs.shape[-2]):
            states.append(self.step(states[-1], inputs[..., k, :]))
        return np.stack(states, axis=-2)

    def at_timestep(self, timestep: float) -> Self:
        """The same model with `step` covering another time in s; the spacing of the window stays."""
        return replace(self, timestep=float(timestep))


@dataclass(frozen=True, eq=False, kw_only=True)
class DiscreteTimeTables(ModelTables):
    """The NumPy twin of a `DiscreteTimeModel`: `advance` covers base_timestep s, `step` a whole multiple of it.

    Raises ValueError where the timestep is no whole multiple.
    """

    base_timestep: float

    def __post_init__(self):
        super().__post_init__()
        whole_multiple(self.timestep, self.base_timestep)

    @property
    def repeats(self) -> int:
        """Applications of `advance` in one step."""
        return whole_multiple(self.timestep, self.base_timestep)

    @abstractmethod
    def advance(self, z: np.ndarray, u: np.ndarray) -> np.ndarray:
        """State one base_timestep later, (..., n)."""

    @abstractmethod
    def advance_jacobians(self, z: np.ndarray, u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """∂z⁺/∂z (..., n, n) and ∂z⁺/∂u (..., n, m) of `advance`."""

    def advance_linearization(self, z: np.ndarray, u: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """`advance` and its Jacobians together."""
        return self.advance(z, u), *self.advance_jacobians(z, u)

    def step(self, z: np.ndarray, u: np.ndarray) -> np.ndarray:
        return repeated_map(lambda x: self.advance(x, u), z, self.repeats)

    def linearize(self, z: np.ndarray, u: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        following, A, B = map_linearization(lambda x: self.advance_linearization(x, u), z, self.repeats)
        return A, B, following - (A @ z[..., None])[..., 0] - (B @ u[..., None])[..., 0]
