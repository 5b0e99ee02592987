"""Slow-fast model: a slow state on a manifold that moves with the input, and a fast state that only decays."""

from __future__ import annotations

import torch

from ssmr_torch.checked_arguments import checked
from ssmr_torch.models.monomials import Monomials
from ssmr_torch.models.output_coordinates import coordinates_from_plain
from ssmr_torch.models.polynomial import PolynomialModel
from ssmr_torch.models.structure import Structure
from ssmr_torch.models.torch_model import PolynomialTorchModel, TorchModel, table
from ssmr_torch.quantities import DELAYS, MODEL_TIMESTEP, TIMESTEP
from ssmr_torch.ranges import Number, OrNone


class SlowFast(PolynomialTorchModel):
    """Reduced dynamics on a non-autonomous spectral submanifold [Haller and Kaundinya 2024], as a map over one sample:

        x = [z, s, f],   z = V [1, ξ window, past inputs],   s: past inputs, or the state of an actuator,
        z⁺ = L z + E Θ φ(z, s, u),   s⁺ = R s + B u,   f⁺ = Λ f,   y = χ⁻¹(Ψ ψ(z, s) + C f),

    with output coordinates ξ = χ(y), which may be the identity. φ holds monomials in which the velocity enters
    linearly, times powers of the configuration. Beyond `reach` times the training range they saturate, see
    `saturation`. A team of models is one such model with the states of all its members.

    structure: a `Structure` as plain values. coordinates: `OutputCoordinates` as plain values. Both are None until a
    fit chooses them from the data, see `ssmr_torch.selection`. chart (n, ·), parametrization (p', ·), dynamics_table
    (n, ·), window_scale (·,).
    """

    given = (*TorchModel.given, "structure", "coordinates", "reach")
    tables = {"chart": ("chart",), "parametrization": ("parametrization",), "dynamics": ("dynamics_table",)}

    @checked(delays=DELAYS, timestep=MODEL_TIMESTEP, window_timestep=OrNone(TIMESTEP), base_timestep=OrNone(TIMESTEP),
             reach=Number(1e-6, 1e6))
    def __init__(self, input_dim: int, output_dim: int, delays: int = 20, *, structure: dict | None = None,
                 coordinates: dict | None = None, reach: float = 2.0, timestep: float = 0.01,
                 window_timestep: float | None = None, base_timestep: float | None = None):
        found = _unfitted(input_dim, output_dim, delays) if structure is None else Structure.from_plain(structure)
        super().__init__(found.parametrization.variables, input_dim, output_dim, delays, timestep, window_timestep)
        self.base_timestep = self.timestep if base_timestep is None else float(base_timestep)
        self._resize(found, coordinates, reach)
        _ = self.reduced  # raises an error if timestep is not a whole multiple of base_timestep

    def _resize(self, structure: Structure, coordinates: dict | None, reach: float) -> None:
        chi = coordinates_from_plain(coordinates)
        latent = self.output_dim if chi is None else chi.latent(self.output_dim)
        self.structure, self.state_dim = structure, structure.parametrization.variables
        self.output_coordinates, self.reach = chi, float(reach)
        self.chart = table(self.state_dim, len(structure.chart))
        self.parametrization = table(latent, len(structure.parametrization))
        self.dynamics_table = table(self.state_dim, len(structure.dynamics))
        self.register_buffer("window_scale", torch.ones(len(structure.window_order), dtype=torch.float64))
        self.register_buffer("state_scale", torch.full((self.state_dim,), torch.inf, dtype=torch.float64))

    @torch.no_grad()
    def take(self, model: PolynomialModel) -> None:
        """Take over the structure and the tables of a model that has the same inputs, outputs and timesteps."""
        self.delays = model.delays
        self._resize(model.structure, None if model.coordinates is None else model.coordinates.plain(), model.reach)
        for name, array in (("chart", model.chart), ("parametrization", model.parametrization),
                            ("dynamics_table", model.dynamics), ("window_scale", model.window_scale),
                            ("state_scale", model.state_scale)):
            getattr(self, name).copy_(torch.tensor(array))

    @property
    def coordinates(self) -> dict | None:
        """The output coordinates as plain values."""
        return None if self.output_coordinates is None else self.output_coordinates.plain()

    @property
    def arguments(self) -> dict:
        return super().arguments | {"structure": self.structure.plain()}

    @property
    def reduced(self) -> PolynomialModel:
        return PolynomialModel(structure=self.structure, base_timestep=self.base_timestep, reach=self.reach,
                               coordinates=self.output_coordinates, window_scale=self.window_scale,
                               **{name: self._joined(parts) for name, parts in self.tables.items()}, **self.sizes)


def _unfitted(input_dim: int, output_dim: int, delays: int) -> Structure:
    """Structure before a fit: persistence, where z is the newest sample and stays."""
    p, m = output_dim, input_dim
    newest = tuple(range(delays * p, (delays + 1) * p))
    linear = Monomials(p, [(k,) for k in range(p)])
    return Structure(linear, newest, linear, Monomials(p + m, [(k,) for k in range(p + m)]), "map", saturated=True)
