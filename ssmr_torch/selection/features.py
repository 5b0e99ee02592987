"""The monomials of a slow-fast flow map: coefficients that depend on the configuration, and a velocity that enters
linearly, as in a semi-implicit step of the mechanics.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import combinations_with_replacement

LARGEST = 700  # monomials of a map; a regression of more takes seconds, and no five minutes of recordings determine it

Factors = tuple[int, ...]


def flow_monomials(kind: str, *, slow: int, leading: int, follows: int, memory: int, inputs: int,
                   pole: bool) -> tuple[list[Factors], list[Factors]]:
    """Linear monomials, the constant first, and those beyond, over (z, s, u): slow coordinates, memory, inputs.

    slow: n; leading: how many of the first z are q, which span the outputs; follows: how many of those after q may
    multiply q, the velocity; pole: the memory s acts in place of u, so that products are with s.
    Raises ValueError for more than `LARGEST` monomials.
    """
    z = list(range(slow))
    q, rest = z[:leading], z[leading:leading + follows]
    s, u = list(range(slow, slow + memory)), list(range(slow + memory, slow + memory + inputs))
    linear = [(), *((k,) for k in (*z, *u, *s))]
    beyond = list(dict.fromkeys(tuple(sorted(row)) for row in _beyond(kind, z, q, rest, s if pole else u)))
    if len(linear) + len(beyond) > LARGEST:
        raise ValueError(f"{len(linear) + len(beyond)} monomials of a {kind} flow map; {LARGEST} at most")
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
    if kind == "quadratic_map":  # EDMD of degree two, whose window is lifted anew at every step
        yield from pairs(z)
