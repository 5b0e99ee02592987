"""Periods that must be whole multiples of each other: one check, one tolerance, one message."""

from __future__ import annotations

# Relative: sampling times of recordings are known no better.
TOLERANCE = 1e-3
# Of a base period: where a thousandth of the period is more than that, the next multiple would do as well.
NEAREST = 0.1


def whole_multiple(what: str, period: float, of: str, base: float, remedy: str = "change one of the two") -> int:
    """period / base, both in s, as the positive integer that it is within `TOLERANCE` and `NEAREST`.

    what, of: names of the two in the message; remedy: what the user can do. Raises ValueError with both numbers where
    the ratio is no positive whole number, or a period is not positive and finite.
    """
    ratio = period / base if base > 0 and period > 0 else float("nan")
    multiple = round(ratio) if 0 < ratio < 1e15 else 0
    if multiple < 1 or not abs(ratio - multiple) <= min(TOLERANCE * multiple, NEAREST):
        raise ValueError(f"{what} is {period:.6g} s and {of} {base:.6g} s, {ratio:.6g} times; expected a whole "
                         f"multiple: {remedy}")
    return multiple


def whole_steps(name: str, time: float, timestep: float) -> int:
    """How many measurements `timestep` s apart `time` s take. Raises ValueError when that is no whole number."""
    return whole_multiple(name, time, "the timestep of the measurements", timestep)
