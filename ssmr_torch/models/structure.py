"""The structure of a polynomial model: which monomials it is made of, and how its forms follow each other."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

from ssmr_torch.models.monomials import Monomials

SCHEMES = ("runge_kutta", "euler", "map")


class Structure(NamedTuple):
    """Integers and words only; the tables of a `PolynomialModel` are over these monomials.

    chart: over ζ, entries `window_order` of [ŷ, û], the window and the inputs held within it, flattened oldest first.
    parametrization: over z. dynamics: over (z, u).
    scheme: "runge_kutta", the dynamics are dz/dt, and a step is of order four with the input held; "euler", they are
    (z⁺ − z) / base_timestep; "map", they are z⁺ after base_timestep.
    saturated: terms of the dynamics beyond those linear in z see s(z), see `saturation`, with `state_scale` as edge.
    relift: the map gives ζ alone, which the chart's monomials lift anew, z⁺ = ψ(f(z, u)).
    """

    chart: Monomials
    window_order: tuple[int, ...]
    parametrization: Monomials
    dynamics: Monomials
    scheme: str = "map"
    saturated: bool = False
    relift: bool = False

    def plain(self) -> dict:
        """As JSON has it: monomials as their number of variables and their factors."""
        found = self._asdict()
        return found | {name: [each.variables, each.factors] for name, each in found.items()
                        if isinstance(each, Monomials)}

    @classmethod
    def from_plain(cls, plain: dict) -> Structure:
        """What `plain` gave. Raises ValueError or TypeError where it is none."""
        monomials = {name: Monomials(*plain[name]) for name in ("chart", "parametrization", "dynamics")}
        return cls(**(plain | monomials | {"window_order": tuple(plain["window_order"])}))

    def check(self, state_dim: int, input_dim: int, seen: int, shapes: Mapping[str, tuple[int, ...]]) -> None:
        """Whether a model of these sizes can have this structure; seen: entries of [ŷ, û]; shapes: of its tables.

        Raises ValueError, with both numbers, where it cannot.
        """
        n, lifted = state_dim, shapes["chart"][0] == 0
        if self.scheme not in SCHEMES:
            raise ValueError(f"scheme is {self.scheme!r}; expected one of {SCHEMES}")
        if self.relift and self.scheme != "map":
            raise ValueError(f"scheme is {self.scheme!r} with relift; only a map's observables are lifted anew")
        if self.relift and not lifted:
            raise ValueError(f"relift with a chart of {shapes['chart'][0]} rows; a state that is lifted anew is the "
                             "chart's monomials themselves, without a table (0 rows)")
        order = self.window_order
        if self.chart.variables != len(order) or not all(0 <= k < seen for k in order):
            raise ValueError(f"the chart has {self.chart.variables} variables, window_order {len(order)} entries from "
                             f"{min(order, default=0)} to {max(order, default=0)}; expected as many, of the {seen} "
                             "values in a window and its inputs")
        if (self.dynamics.variables, self.parametrization.variables) != (n + input_dim, n):
            raise ValueError(f"the dynamics have {self.dynamics.variables} variables and the parametrization "
                             f"{self.parametrization.variables}; expected n + m = {n + input_dim} and n = {n}")
        if lifted and len(self.chart) != n:
            raise ValueError(f"z is the chart's monomials themselves, {len(self.chart)} of them; state_scale has {n}")
        expected = {"chart": (0 if lifted else n, len(self.chart)),
                    "dynamics": (self.chart.variables if self.relift else n, len(self.dynamics)),
                    "parametrization": (shapes["parametrization"][0], len(self.parametrization))}
        for name, shape in expected.items():
            if tuple(shapes[name]) != shape:
                raise ValueError(f"the table {name} has shape {tuple(shapes[name])}; {n} states and the structure need "
                                 f"{shape}")


def shape_in_words(rows: int, state_dim: int, degree: int) -> str:
    """Of a parametrization of a whole window, with so many rows, of this degree: what manifold it is."""
    if rows == state_dim:
        return f"p = n = {rows}: the parametrization is linear, all nonlinearity sits in the dynamics"
    kind = "a flat manifold" if degree == 1 else "a curved manifold"
    return f"p = {rows} > n = {state_dim}, parametrization of degree {degree}: {kind}"
