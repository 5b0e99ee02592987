"""Check that one period is a whole multiple of another, with one tolerance and one message for the whole package."""

from __future__ import annotations

# Relative tolerance, because sampling times of recordings are not known more accurately.
TOLERANCE = 1e-3
# Tolerance as a share of the base period. For large ratios the relative tolerance would also accept the next multiple.
NEAREST = 0.1


def whole_multiple(what: str, period: float, of: str, base: float, remedy: str = "change one of the two") -> int:
    """The ratio period / base (both in s) as a positive integer, if it is one within `TOLERANCE` and `NEAREST`.

    what, of: names of the two periods in the message; remedy: what the user can do. Raises ValueError with both numbers
    if the ratio is not a positive whole number, or if a period is not positive and finite.
    """
    ratio = period / base if base > 0 and period > 0 else float("nan")
    multiple = round(ratio) if 0 < ratio < 1e15 else 0
    if multiple < 1 or not abs(ratio - multiple) <= min(TOLERANCE * multiple, NEAREST):
        raise ValueError(f"{what} is {period:.6g} s, which is {ratio:.6g} times {of}, {base:.6g} s; expected a whole "
                         f"multiple: {remedy}")
    return multiple


def whole_steps(name: str, time: float, timestep: float) -> int:
    """Number of measurements, `timestep` s apart, in `time` s. Raises ValueError unless that is a whole number."""
    return whole_multiple(name, time, "the timestep of the measurements", timestep)
