"""Reduced models as Torch modules: for Lightning, torch.func, torch.compile, torch.export or a user's own loss."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import replace
from inspect import signature
from typing import ClassVar, Self

import numpy as np
import torch
from torch import Tensor, nn

from ssmr_torch.models.base import Linearization, Model, OutputLinearization, Rollout
from ssmr_torch.models.polynomial import PolynomialModel
from ssmr_torch.models.sizes import check_sizes
from ssmr_torch.models.structure import Structure


@torch.no_grad()
def fill(pairs) -> None:
    """Copy arrays into parameters or buffers, pairs (tensor, array). Raises ValueError if two shapes differ."""
    for tensor, array in pairs:
        if tuple(tensor.shape) != tuple(array.shape):
            raise ValueError(f"a table has shape {tuple(array.shape)}; the declared sizes and degrees need "
                             f"{tuple(tensor.shape)}")
        tensor.copy_(torch.as_tensor(array))


def table(*shape: int) -> nn.Parameter:
    """A table of coefficients as a parameter; zero until a fit fills it."""
    return nn.Parameter(torch.zeros(shape, dtype=torch.float64))


class TorchModel(nn.Module, ABC):
    """A Torch module whose parameters are the arrays of a `Model`. `reduced` builds that model, which does the
    mathematics.

    tables: for each table of a polynomial model, the parameters that form it side by side; empty for other models.

    A subclass declares its parameters and returns the `Model` on them as `reduced`. The arguments of its constructor
    are also attributes of the same names, with plain values: together with the state dict they rebuild the module.
    Sizes, delays and timesteps as in `Model`; window_timestep None: the timestep.
    given: arguments that a training takes from the data, unless a configuration sets them.
    Raises ValueError for sizes that are not positive whole numbers, or times that are not positive.
    """

    given: ClassVar[tuple[str, ...]] = ("input_dim", "output_dim", "timestep", "window_timestep")

    tables: ClassVar[dict[str, tuple[str, ...]]] = {}

    def __init__(self, state_dim: int, input_dim: int, output_dim: int, delays: int, timestep: float,
                 window_timestep: float | None):
        super().__init__()
        window_timestep = timestep if window_timestep is None else window_timestep
        check_sizes(state_dim, input_dim, output_dim, delays, timestep, window_timestep)
        self.state_dim, self.input_dim, self.output_dim = int(state_dim), int(input_dim), int(output_dim)
        self.delays = int(delays)
        self.timestep, self.window_timestep = float(timestep), float(window_timestep)
        self.register_buffer("state_scale", torch.full((self.state_dim,), torch.inf, dtype=torch.float64))

    @property
    @abstractmethod
    def reduced(self) -> Model:
        """The `Model` on this module's parameters; gradients flow through it.

        Every call makes a new one, because a model caches values that it derives from its arrays. Do not use it after a
        parameter has changed.
        """

    @property
    def sizes(self) -> dict:
        """The arguments that every `Model` takes in addition to its own arrays."""
        return {"state_scale": self.state_scale, "input_dim": self.input_dim, "output_dim": self.output_dim,
                "delays": self.delays, "timestep": self.timestep, "window_timestep": self.window_timestep}

    @property
    def window_dim(self) -> int:
        """Number of values in a window, (n_d + 1) p."""
        return (self.delays + 1) * self.output_dim

    @property
    def arguments(self) -> dict:
        """Constructor arguments as plain values; together with the state dict they rebuild the module."""
        return {name: getattr(self, name) for name in signature(type(self)).parameters}

    def forward(self, window: Tensor, window_inputs: Tensor, inputs: Tensor) -> Tensor:
        """Outputs (..., H, p) at the ends of the next H steps under inputs (..., H, m); see `encode` for the window."""
        model = self.reduced
        return model.decode(model.states(model.encode(window, window_inputs), inputs)[..., 1:, :])

    def encode(self, window: Tensor, inputs: Tensor | None = None) -> Tensor:
        """Chart z = v(window): (..., n_d + 1, p), inputs held between its samples (..., n_d, m) → (..., n)."""
        return self.reduced.encode(window, inputs)

    def decode(self, z: Tensor) -> Tensor:
        """Newest sample of the parametrization y = w(z): (..., n) → (..., p)."""
        return self.reduced.decode(z)

    def step(self, z: Tensor, u: Tensor) -> Tensor:
        """State one `timestep` later with u held: (..., n), (..., m) → (..., n)."""
        return self.reduced.step(z, u)

    def linearize(self, z: Tensor, u: Tensor) -> Linearization:
        """First-order expansion of `step`, batched over the leading dimensions."""
        return self.reduced.linearize(z, u)

    def linearize_output(self, z: Tensor) -> OutputLinearization:
        """First-order expansion of `decode`, batched over the leading dimensions."""
        return self.reduced.linearize_output(z)

    def rollout(self, z: Tensor, inputs: Tensor) -> Rollout:
        """States under inputs (..., H, m) held one timestep each, from z (..., n), and where they diverged."""
        return self.reduced.rollout(z, inputs)

    def begin(self, chart: Tensor, parametrization: Tensor, A: Tensor, B: Tensor) -> None:
        """Take the values of a fitted linear model, from which the gradient training starts (fit=from_linear):

            z = chart · [ŷ, û],   y = parametrization · z,   A z + B u is dz/dt for a flow, z⁺ for a map.

        chart (n, (n_d + 1) p + n_d m), parametrization (p, n), A (n, n), B (n, m). Called within torch.no_grad().
        """
        raise ValueError(f"{type(self).__name__} cannot start from a linear model, because it has no method `begin`; "
                         "write that method, or choose another fit")

    def scales(self) -> dict[str, Tensor]:
        """Step size of each coefficient, by parameter name: the optimizer works on θ / scale. Parameters that are not
        named are already of order one.
        """
        return {}

    def at_timestep(self, timestep: float) -> Self:
        """The same model on the same device with another length of `step`, s; the window's spacing stays."""
        again = type(self)(**(self.arguments | {"timestep": float(timestep)})).to(self.state_scale)
        again.load_state_dict(self.state_dict())
        _ = again.reduced  # raises an error if timestep is not a whole multiple of base_timestep
        return again


class PolynomialTorchModel(TorchModel):
    """A `PolynomialModel` as a Torch module.

    A subclass sets `structure` in its constructor, and one parameter for each name in `tables`. tables: for each table
    of the model, the parameters that form it side by side. The trained coefficients and their sensitivities follow from
    it. `substeps` is for flows, `base_timestep` for maps and Euler steps.
    """

    tables = {
        "chart": ("chart",), "parametrization": ("parametrization",), "dynamics": ("dynamics",)}
    structure: Structure
    substeps: int = 1
    base_timestep: float | None = None

    @property
    def reduced(self) -> PolynomialModel:
        return PolynomialModel(structure=self.structure, substeps=self.substeps, base_timestep=self.base_timestep,
                               **{name: self._joined(parts) for name, parts in self.tables.items()}, **self.sizes)

    def at_timestep(self, timestep: float) -> Self:
        if self.structure.scheme != "runge_kutta" and "base_timestep" not in self.arguments:
            raise ValueError(f"{type(self).__name__} cannot change its timestep: its constructor has no argument "
                             "base_timestep, the time that one map or Euler step covers; add that argument")
        return super().at_timestep(timestep)

    @torch.no_grad()
    def scales(self) -> dict[str, Tensor]:
        """s_ij = (size of row i) / (size of monomial j) at the edge of the training data and for inputs of 1.

        The size of row i is Σ_j |θ_ij| |monomial_j|, but at least a thousandth of the largest row's size. A step of
        relative size ε then changes the row by about ε of its value.
        """
        edge = self.state_scale
        values = {"parametrization": self.structure.parametrization(edge),
                  "dynamics": self.structure.dynamics(torch.cat([edge, edge.new_ones(self.input_dim)]))}
        found = {}
        for form, monomials in values.items():
            parts = [getattr(self, name) for name in self.tables[form]]
            for name, part, sizes in zip(self.tables[form], parts, monomials.split([len(each.T) for each in parts])):
                row = (part.abs() * sizes).sum(1, keepdim=True)
                row = torch.maximum(row, 1e-3 * row.max()).clamp_min(1e-300)
                found[name] = row / sizes.clamp_min(1e-300)
        return found

    def _joined(self, parts: tuple[str, ...]) -> Tensor:
        found = [getattr(self, part) for part in parts]
        return found[0] if len(found) == 1 else torch.cat(found, dim=-1)


class TrainablePolynomial(PolynomialTorchModel):
    """A `PolynomialModel` of any structure, for example a fitted or averaged one, with its tables as parameters.

    plain: the result of the model's `plain()`. shapes: shape of each of its arrays, by name. `of(model)` makes the
    module with the values of a model. Raises the errors of `PolynomialModel` if plain and shapes do not fit together.
    """

    def __init__(self, plain: dict, shapes: dict):
        model = PolynomialModel.from_plain({name: np.zeros(shape) for name, shape in shapes.items()}, plain)
        super().__init__(model.state_dim, model.input_dim, model.output_dim, model.delays, model.timestep,
                         model.window_timestep)
        self.plain, self.shapes, self.model, self.structure = plain, shapes, model, model.structure
        for name in ("chart", "parametrization", "dynamics"):
            setattr(self, name, table(*shapes[name]))
        self.register_buffer("window_scale", torch.ones(shapes["window_scale"], dtype=torch.float64))

    @classmethod
    def of(cls, model: PolynomialModel) -> Self:
        """A module with the structure and the values of a model."""
        made = cls(model.plain(), {name: list(array.shape) for name, array in model.arrays.items()})
        fill((getattr(made, name), np.array(array)) for name, array in model.numpy().arrays.items())
        return made

    @property
    def reduced(self) -> PolynomialModel:
        return replace(self.model, **{name: getattr(self, name) for name in self.model.array_names()})

    def at_timestep(self, timestep: float) -> Self:
        again = type(self)(self.plain | {"timestep": float(timestep)}, self.shapes).to(self.state_scale)
        again.load_state_dict(self.state_dict())
        return again


class FixedModel(TorchModel):
    """A `Model` that is not trained any more, as a Torch module; its arrays are buffers."""

    def __init__(self, model: Model):
        super().__init__(model.state_dim, model.input_dim, model.output_dim, model.delays, model.timestep,
                         model.window_timestep)
        self.model = model
        for name, array in model.arrays.items():
            tensor = torch.tensor(array, dtype=torch.float64)
            if tensor.numel():
                self.register_buffer(name, tensor)
            else:  # torch.export cannot store an empty registered buffer
                setattr(self, name, tensor)

    @property
    def reduced(self) -> Model:
        return replace(self.model, **{name: getattr(self, name) for name in self.model.array_names()})

    def at_timestep(self, timestep: float) -> Self:
        return type(self)(self.reduced.numpy().at_timestep(timestep))


def check_degrees(**degrees: int) -> None:
    """Raises ValueError for a degree or another number that is not whole, or below 1."""
    for name, degree in degrees.items():
        if int(degree) != degree or degree < 1:
            raise ValueError(f"{name} is {degree}; expected a whole number, 1 or more")
