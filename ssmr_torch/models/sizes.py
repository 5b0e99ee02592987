"""How large a model may be, checked before anything of these sizes is made."""

from __future__ import annotations

import numpy as np

# The largest sizes that a model may have: what lies above them fills the memory or never ends.
LARGEST = {"state_dim": 20_000, "input_dim": 1_000, "output_dim": 20_000, "delays": 5_000}
MOST_STEPS = 2_000  # maps, or Runge-Kutta steps, within one step of a model
LONGEST_STEP = 1e6  # s


def check_sizes(state_dim: int, input_dim: int, output_dim: int, delays: int, timestep: float,
                window_timestep: float) -> None:
    """Check the sizes and times (s) of a model. Raises ValueError for those that no model can have, see `Model`."""
    for name, size in (("state_dim", state_dim), ("input_dim", input_dim), ("output_dim", output_dim)):
        if not (_is_number(size) and int(size) == size and size >= 1):
            raise ValueError(f"{name} is {size!r:.40}; expected a positive integer")
    if not (_is_number(delays) and int(delays) == delays and delays >= 0):
        raise ValueError(f"delays is {delays!r:.40}; expected a whole number, 0 or more (a window holds delays + 1 "
                         "samples)")
    for name, size in zip(LARGEST, (state_dim, input_dim, output_dim, delays)):
        if size > LARGEST[name]:
            raise ValueError(f"{name} is {size:g}; expected at most {LARGEST[name]}")
    if (delays + 1) * output_dim > 10 * LARGEST["output_dim"]:
        raise ValueError(f"a window of {delays + 1:g} samples of {output_dim:g} outputs; expected at most "
                         f"{10 * LARGEST['output_dim']} values in it: fewer delays")
    times = timestep, window_timestep
    if not all(_is_number(time) and 0 < time < np.inf for time in times):
        raise ValueError(f"timestep {timestep} s and window_timestep {window_timestep} s must be positive and finite")
    if max(times) > LONGEST_STEP:
        raise ValueError(f"timestep {timestep} s and window_timestep {window_timestep} s; expected at most "
                         f"{LONGEST_STEP:g} s")


def check_steps(name: str, count: int) -> None:
    """Raises ValueError unless a number of maps or Runge-Kutta steps within one step is whole, from 1 to `MOST_STEPS`.
    """
    if not (_is_number(count) and int(count) == count and 1 <= count <= MOST_STEPS):
        raise ValueError(f"{name} is {count!r:.40}; expected a whole number, 1 or more, and at most {MOST_STEPS}")


def _is_number(value: object) -> bool:
    return isinstance(value, (int, float, np.integer, np.floating)) and not isinstance(value, bool) and \
        abs(value) < np.inf
