"""Rules that choose the number of reduced coordinates from the singular values of the data."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ssmr_torch.data.windows import SegmentDataset, delay_windows
from ssmr_torch.fitting.streamed_least_squares import Factor, singular_values


def window_singular_values(trajectories: Sequence, delays: int, *, transient: float = 0.0,
                           rows: int = 1024) -> np.ndarray:
    """Singular values of all delay windows (paper, Eq. 4), ((n_d + 1) p,), m; read segment by segment."""
    total = None
    for segment in SegmentDataset(trajectories, before=delays, after=0, rows=rows, transient=transient):
        windows = segment.core_rows(delay_windows(segment.observation, delays).flatten(1), delays)
        factor = Factor.of(windows)
        total = factor if total is None else total.merged(factor)
    if total is None:
        raise ValueError("no trajectories were given; the tangent space needs decays, or controlled runs with "
                         "manifold_data=all")
    return singular_values(total)[0].numpy()


def captured_variance(values: np.ndarray) -> np.ndarray:
    """Share of the variance in the first k directions, Σ_{i≤k} σ_i² / Σ σ_i², for k = 1, 2, …"""
    return np.cumsum(values**2) / np.sum(values**2)


def dimension_by_variance(values: np.ndarray, share: float = 0.95) -> int:
    """Smallest even dimension whose directions capture at least this share of the variance (paper: 6 modes, > 95 %).

    Even, because a vibration mode takes two coordinates.
    """
    if not 0 < share < 1:
        raise ValueError(f"share is {share}; expected a number between 0 and 1")
    least = int(np.argmax(captured_variance(values) >= share)) + 1
    return min(least + least % 2, len(values))


def dimension_by_gap(values: np.ndarray, largest: int = 12) -> int:
    """Even dimension k ≤ `largest` after which the singular values drop most, argmax σ_k / σ_{k+1}.

    Raises ValueError with fewer than three singular values.
    """
    if len(values) < 3:
        raise ValueError(f"{len(values)} singular values; the rule 'gap' needs at least 3: use more delays or outputs")
    floor = values[0] * 1e-12
    candidates = np.arange(2, min(largest, len(values) - 1) + 1, 2)
    drops = np.maximum(values[candidates - 1], floor) / np.maximum(values[candidates], floor)
    return int(candidates[np.argmax(drops)])


def choose_dimension(rule: int | str, trajectories: Sequence, delays: int, transient: float = 0.0) -> int:
    """The dimension, given as a number or by the rule "variance", "variance:0.99" or "gap".

    Raises ValueError for another rule.
    """
    if isinstance(rule, int):
        return rule
    name, _, share = str(rule).partition(":")
    if name not in ("variance", "gap") or (name == "gap" and share):
        raise ValueError(f'state_dim is {rule!r}; expected an integer, "variance", "variance:0.99" or "gap"')
    values = window_singular_values(trajectories, delays, transient=transient)
    return dimension_by_gap(values) if name == "gap" else dimension_by_variance(values, float(share or 0.95))
