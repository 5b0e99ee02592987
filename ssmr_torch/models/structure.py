"""`Structure` of a polynomial model: the monomials of its chart, parametrization and dynamics, and its scheme."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

from ssmr_torch.models.monomials import Monomials

SCHEMES = ("runge_kutta", "euler", "map")


class Structure(NamedTuple):
    """The monomials over which the tables of a `PolynomialModel` stand. It holds only integers and strings.

    chart: monomials of ζ, the entries `window_order` of [ŷ, û]: the window and the inputs held within it, flattened
    oldest first. parametrization: monomials of z. dynamics: monomials of (z, u).
    scheme: what the dynamics give. "runge_kutta": dz/dt, and a step is of order four with the input held; "euler":
    (z⁺ − z) / base_timestep; "map": z⁺ after base_timestep.
    saturated: the terms of the dynamics that are not linear in z take s(z), see `saturation`; its edge is
    `state_scale`. relift: the map gives only ζ, and the chart's monomials are computed from it again at every step, z⁺
    = ψ(f(z, u)).
    """

    chart: Monomials
    window_order: tuple[int, ...]
    parametrization: Monomials
    dynamics: Monomials
    scheme: str = "map"
    saturated: bool = False
    relift: bool = False

    def plain(self) -> dict:
        """Plain values for JSON; monomials as their number of variables and their factors."""
        found = self._asdict()
        return found | {name: [each.variables, each.factors] for name, each in found.items()
                        if isinstance(each, Monomials)}

    @classmethod
    def from_plain(cls, plain: dict) -> Structure:
        """The structure that `plain` described. Raises ValueError or TypeError for values that describe none."""
        monomials = {name: Monomials(*plain[name]) for name in ("chart", "parametrization", "dynamics")}
        return cls(**(plain | monomials | {"window_order": tuple(plain["window_order"])}))

    def check(self, state_dim: int, input_dim: int, seen: int, shapes: Mapping[str, tuple[int, ...]]) -> None:
        """Check that a model of these sizes can have this structure.

        seen: number of entries of [ŷ, û]. shapes: shapes of the tables by name. Raises ValueError if it cannot.
        """
        n, lifted = state_dim, shapes["chart"][0] == 0
        if self.scheme not in SCHEMES:
            raise ValueError(f"scheme is {self.scheme!r}; expected one of {SCHEMES}")
        if self.relift and self.scheme != "map":
            raise ValueError(f"scheme is {self.scheme!r} with relift; only the scheme 'map' supports re-lifting")
        if self.relift and not lifted:
            raise ValueError(f"relift with a chart of {shapes['chart'][0]} rows; expected 0 rows, because with "
                             "re-lifting the state consists of the chart's monomials themselves")
        order = self.window_order
        if self.chart.variables != len(order) or not all(0 <= k < seen for k in order):
            raise ValueError(f"the chart has {self.chart.variables} variables, window_order has {len(order)} entries "
                             f"from {min(order, default=0)} to {max(order, default=0)}; expected one entry for each "
                             f"variable, from 0 to {seen - 1}: a window and its inputs have {seen} values")
        if (self.dynamics.variables, self.parametrization.variables) != (n + input_dim, n):
            raise ValueError(f"the dynamics have {self.dynamics.variables} variables and the parametrization "
                             f"{self.parametrization.variables}; expected n + m = {n + input_dim} and n = {n}")
        if lifted and len(self.chart) != n:
            raise ValueError(f"state_scale has {n} entries; expected {len(self.chart)}, because z consists of the "
                             f"{len(self.chart)} monomials of the chart")
        expected = {"chart": (0 if lifted else n, len(self.chart)),
                    "dynamics": (self.chart.variables if self.relift else n, len(self.dynamics)),
                    "parametrization": (shapes["parametrization"][0], len(self.parametrization))}
        for name, shape in expected.items():
            if tuple(shapes[name]) != shape:
                raise ValueError(f"the table {name} has shape {tuple(shapes[name])}; {n} states and the structure need "
                                 f"{shape}")


def shape_in_words(rows: int, state_dim: int, degree: int) -> str:
    """A sentence about the manifold that a parametrization of a whole window, with these rows and degree, describes."""
    if rows == state_dim:
        return f"p = n = {rows}: the parametrization is linear, all nonlinearity is in the dynamics"
    kind = "a flat manifold" if degree == 1 else "a curved manifold"
    return f"p = {rows} > n = {state_dim}, parametrization of degree {degree}: {kind}"
