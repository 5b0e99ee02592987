"""Monomials of the flow map of a slow-fast model.

The coefficients depend on the configuration, and the velocity enters linearly, as in a semi-implicit step of mechanics.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import combinations_with_replacement

LARGEST = 700  # monomials of a map; with more, a regression takes seconds, and five minutes of data do not determine it

Factors = tuple[int, ...]


def flow_monomials(kind: str, *, slow: int, leading: int, follows: int, memory: int, inputs: int,
                   pole: bool) -> tuple[list[Factors], list[Factors]]:
    """Linear monomials, the constant first, and nonlinear monomials over (z, s, u): slow coordinates, memory, inputs.

    slow: n. leading: number of first coordinates q of z, which span the outputs. follows: number of coordinates after
    q, the velocity, which may multiply q. pole: the memory s acts in place of u, so that products contain s.
    Raises ValueError for more than `LARGEST` monomials.
    """
    z = list(range(slow))
    q, rest = z[:leading], z[leading:leading + follows]
    s, u = list(range(slow, slow + memory)), list(range(slow + memory, slow + memory + inputs))
    linear = [(), *((k,) for k in (*z, *u, *s))]
    beyond = list(dict.fromkeys(tuple(sorted(row)) for row in _beyond(kind, z, q, rest, s if pole else u)))
    if len(linear) + len(beyond) > LARGEST:
        raise ValueError(f"{len(linear) + len(beyond)} monomials in a {kind} flow map; at most {LARGEST} are possible")
    return linear, beyond


def _beyond(kind: str, z: list[int], q: list[int], rest: list[int], acting: list[int]) -> Iterator[Factors]:
    def pairs(of, degree=2):
        return combinations_with_replacement(of, degree)

    if kind in ("bilinear", "quadratic", "leading_cubic"):
        yield from ((a, b) for a in z for b in acting)
    if kind == "leading_bilinear":
        yield from ((a, b) for a in q for b in acting)
    if kind in ("quadratic", "leading_cubic"):
        yield from pairs(q)
    if kind == "quadratic":
        yield from ((a, b) for a in q for b in rest)
    if kind in ("configuration_affine", "cubic"):
        yield from pairs(q + acting)
        yield from ((a, b) for a in rest for b in q + acting)
        yield from ((a, b, c) for a, b in pairs(q) for c in acting)
    if kind in ("cubic", "leading_cubic"):
        yield from pairs(q, 3)
    if kind == "full_quadratic":
        yield from pairs(z + acting)
    if kind == "quadratic_map":  # EDMD of degree 2 with re-lifting at every step
        yield from pairs(z)
