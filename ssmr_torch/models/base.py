"""`Model`, the base class of all reduced models: chart, parametrization, step, linearization and rollout.

It is written once for arrays of NumPy and of Torch.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from contextlib import nullcontext
from dataclasses import dataclass, fields, replace
from functools import cached_property
from numbers import Number
from typing import Any, ClassVar, NamedTuple, Self

import numpy as np

from ssmr_torch import data_sheet as sheet
from ssmr_torch.data_sheet import DataSheet
from ssmr_torch.models.arrays import Array, namespace
from ssmr_torch.models.integrators import DIVERGENCE_FACTOR
from ssmr_torch.models.sizes import check_sizes


class Linearization(NamedTuple):
    """z⁺ ≈ A z + B u + c around the point of linearization; A (..., n, n), B (..., n, m), c (..., n)."""

    A: Array
    B: Array
    c: Array


class OutputLinearization(NamedTuple):
    """y ≈ C z + d around the point of linearization; C (..., p, n), d (..., p)."""

    C: Array
    d: Array


class Rollout(NamedTuple):
    """states (..., H+1, n), the initial state first; diverged_at (...): first diverged step, H+1 if no step diverged.
    """

    states: Array
    diverged_at: Array


@dataclass(frozen=True, eq=False, kw_only=True)
class Model(DataSheet, ABC):
    """Discrete-time reduced model z⁺ = f(z, u), with chart z = v(window) and parametrization y = w(z).

    A model consists of arrays and constants and needs no Torch. An artifact stores it, and a controller runs it. Fields
    annotated `Array` are arrays: read-only float64 NumPy arrays, or Torch tensors; with tensors, all methods take and
    return tensors. All other fields hold structure or plain values. A new kind of model adds its arrays and the five
    abstract methods; it needs nothing else.

    state_scale: (n,) largest |z_i| of the training data, infinite before a fit. input_dim m, output_dim p (one sample).
    delays n_d: a window is the n_d + 1 newest samples, oldest first, `window_timestep` s apart, (..., n_d + 1, p),
    with the n_d inputs held between them (..., n_d, m). timestep: length of one `step` in s. Everything is SI.

    c_source, compiled, batched: each names a function as "module:function".
        c_source writes the model in C. None: the model cannot be written in C.
        compiled returns the compiled horizon of a controller. None: the controller calls `linearize`.
        batched returns a compiled `BatchRollout`, for many rollouts at once. None: they go through `rollout`.

    Raises ValueError for sizes that are not positive whole numbers, or times that are not positive and finite.
    """

    c_source: ClassVar[str | None] = None
    compiled: ClassVar[str | None] = None
    batched: ClassVar[str | None] = None

    state_scale: Array
    input_dim: int
    output_dim: int
    delays: int
    timestep: float
    window_timestep: float

    def __post_init__(self):
        for name in self.array_names():
            object.__setattr__(self, name, _fixed(getattr(self, name)))
        check_sizes(self.state_dim, self.input_dim, self.output_dim, self.delays, self.timestep, self.window_timestep)

    @classmethod
    def array_names(cls) -> tuple[str, ...]:
        """Names of the fields that are arrays."""
        return tuple(field.name for field in fields(cls) if field.type in ("Array", Array))

    @classmethod
    def plain_names(cls) -> tuple[str, ...]:
        """Names of the fields that are structure or plain values."""
        return tuple(field.name for field in fields(cls) if field.name not in cls.array_names())

    def plain(self) -> dict:
        """Structure and plain values as JSON values; `from_plain(arrays, plain)` returns the same model."""
        values = {name: getattr(self, name) for name in self.plain_names()}
        return {name: value.item() if isinstance(value, np.generic) else value for name, value in values.items()}

    @classmethod
    def from_plain(cls, arrays: dict[str, Array], plain: dict) -> Self:
        """The model with these arrays and the values that `plain` returned."""
        return cls(**arrays, **plain)

    @property
    def arrays(self) -> dict[str, Array]:
        """The arrays by name."""
        return {name: getattr(self, name) for name in self.array_names()}

    def __reduce__(self):
        # copying and unpickling call the constructor: the arrays are read-only again, and no cached value is copied
        return _made, (type(self), {field.name: getattr(self, field.name) for field in fields(self)})

    def with_arrays(self, change) -> Self:
        """The same model with change(array) in place of each array."""
        return replace(self, **{name: change(array) for name, array in self.arrays.items()})

    def numpy(self) -> Self:
        """The same model with NumPy arrays."""
        return self.with_arrays(lambda array: array if isinstance(array, np.ndarray) else array.detach().cpu().numpy())

    @property
    def reduced(self) -> Self:
        """This model itself. A Torch module and the result of `fit` return their model under the same name."""
        return self

    @property
    def state_dim(self) -> int:
        """n"""
        return len(self.state_scale)

    @property
    def window_dim(self) -> int:
        """Number of values in a window, (n_d + 1) p."""
        return (self.delays + 1) * self.output_dim

    @property
    def affine(self) -> bool:
        """Whether z⁺ is affine in (z, u), and y in z, everywhere. A controller then condenses its problem only once."""
        return False

    @property
    def flow(self) -> bool:
        """Whether the dynamics are in continuous time: a step may then cover any time."""
        return False

    @property
    def takes_past_inputs(self) -> bool:
        """Whether the chart uses the inputs held within the window."""
        return True

    @property
    def kind(self) -> str:
        """Name of this kind of model on a model card."""
        return type(self).__name__

    @property
    def geometry(self) -> str:
        """Text on a model card about the chart and the parametrization."""
        return (f"{self.state_dim} states from windows of {self.delays + 1} samples of {self.output_dim} outputs, "
                f"{self.window_timestep:g} s apart")

    def data_sheet(self) -> tuple[str, dict]:
        return f"{type(self).__name__}: {self.state_dim} states, {self.input_dim} inputs, {self.output_dim} outputs", {
            "geometry": self.geometry, "step": sheet.period(self.timestep), "stability": sheet.stability(self.rates)}

    @cached_property
    def rates(self) -> np.ndarray:
        """Eigenvalues λ (n,), 1/s, of the dynamics linearized at z = 0, u = 0; e^{λ timestep} are the eigenvalues of A.
        """
        with np.errstate(invalid="ignore"):  # state_scale is infinite before a fit
            A = self.numpy().linearize(np.zeros(self.state_dim), np.zeros(self.input_dim)).A
        return continuous(eigenvalues(A), self.timestep)

    @abstractmethod
    def encode(self, window: Array, inputs: Array) -> Array:
        """Chart z = v(window): (..., n_d + 1, p), inputs held between its samples (..., n_d, m) → (..., n)."""

    @abstractmethod
    def decode(self, z: Array) -> Array:
        """Newest sample of the parametrization y = w(z): (..., n) → (..., p)."""

    @abstractmethod
    def step(self, z: Array, u: Array) -> Array:
        """State one `timestep` later with u held: (..., n), (..., m) → (..., n)."""

    @abstractmethod
    def linearize(self, z: Array, u: Array) -> Linearization:
        """First-order expansion of `step`, batched over the leading dimensions."""

    def step_jacobians(self, z: Array, u: Array) -> tuple[Array, Array, Array]:
        """`step`, ∂z⁺/∂z (..., n, n) and ∂z⁺/∂u (..., n, m); a model that computes them together overrides this."""
        A, B, _ = self.linearize(z, u)
        return self.step(z, u), A, B

    @abstractmethod
    def linearize_output(self, z: Array) -> OutputLinearization:
        """First-order expansion of `decode`, batched over the leading dimensions."""

    def at_timestep(self, timestep: float) -> Self:
        """The same model with another length of `step`, in s; the time between the samples of the window stays."""
        return replace(self, timestep=float(timestep))

    def states(self, z: Array, inputs: Array) -> Array:
        """States (..., H + 1, n) from z (..., n) under inputs (..., H, m) held one timestep each."""
        found = [z]
        for k in range(inputs.shape[-2]):
            found.append(self.step(found[-1], inputs[..., k, :]))
        return namespace(z).stack(found, -2)

    def rollout(self, z: Array, inputs: Array, *, lengths: Array | None = None, bound: float | None = None) -> Rollout:
        """`states`, and the step at which each rollout diverged: the first one with ‖z‖ > bound.

        A diverged rollout keeps its last state inside the bound, so that all states stay finite.
        bound: None means `DIVERGENCE_FACTOR` ‖state_scale‖.
        lengths (...): steps after which each rollout ends; it then keeps its last state, and its diverged_at is its
        length + 1. None means the whole horizon H.
        `batch_rollout.batch_of` is faster for many rollouts at once.
        """
        xp, horizon = namespace(z), inputs.shape[-2]
        if bound is None:
            bound = self.divergence_bound
        found, steps = [z], xp.zeros_like(z[..., 0])
        inside = xp.ones_like(z[..., 0]) > 0
        with np.errstate(over="ignore", invalid="ignore") if xp is np else nullcontext():
            for k in range(horizon):
                following = self.step(z, inputs[..., k, :])
                inside = inside & (_norm(xp, following) <= bound)
                if lengths is not None:
                    inside = inside & (lengths > k)
                steps = steps + inside
                z = xp.where(inside[..., None], following, z)
                found.append(z)
        whole = (steps + 1.0).astype(np.int64) if xp is np else (steps + 1.0).long()
        return Rollout(xp.stack(found, -2), whole)

    @property
    def divergence_bound(self) -> Array:
        """‖z‖ beyond which a rollout has diverged, `DIVERGENCE_FACTOR` ‖state_scale‖."""
        return DIVERGENCE_FACTOR * _norm(namespace(self.state_scale), self.state_scale)


def around(following: Array, A: Array, B: Array, z: Array, u: Array) -> Linearization:
    """The linearization with z⁺ = following at (z, u) and these Jacobians."""
    return Linearization(A, B, following - (A @ z[..., None])[..., 0] - (B @ u[..., None])[..., 0])


def _made(family: type[Model], values: dict) -> Model:
    return family(**values)


def eigenvalues(matrix: np.ndarray) -> np.ndarray:
    """Eigenvalues (n,), complex, of a matrix (n, n); NaN if the matrix is not finite."""
    finite = np.isfinite(matrix).all()
    return np.linalg.eigvals(matrix).astype(complex) if finite else np.full(len(matrix), complex("nan"))


def continuous(factors: np.ndarray, time: float) -> np.ndarray:
    """Rates λ, 1/s, with e^{λ time} = factors, for a time in s; −∞ for a factor of zero."""
    with np.errstate(divide="ignore"):
        return np.log(np.abs(factors)) / time + 1j * (np.angle(factors) / time)


def _norm(xp, z: Array) -> Array:
    return xp.sqrt((z * z).sum(-1))


def _fixed(array: Any) -> Any:
    """A tensor unchanged; a NumPy array or a number as a read-only float64 array that owns its data."""
    if not isinstance(array, (np.ndarray, Sequence, Number)):
        return array
    if isinstance(array, np.ndarray) and array.dtype == np.float64:
        if array.flags.owndata and not array.flags.writeable:
            return array
    array = np.array(array, dtype=np.float64)
    array.setflags(write=False)
    return array
