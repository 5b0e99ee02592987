"""Delay windows, segments of long trajectories for closed-form fits, and rollouts for gradient fits."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from torch import Tensor
from torch.utils.data import Dataset


def delay_windows(samples, delays: int):
    """Samples (T, p) → windows (T - n_d, n_d + 1, p), oldest sample first; window k ends at sample n_d + k.

    It takes NumPy arrays and Torch tensors. Raises ValueError if T ≤ n_d.
    """
    if len(samples) <= delays:
        raise ValueError(f"{len(samples)} samples; a window of {delays} delays needs at least {delays + 1}")
    if isinstance(samples, np.ndarray):
        return np.lib.stride_tricks.sliding_window_view(samples, delays + 1, axis=0).swapaxes(1, 2)
    return samples.unfold(0, delays + 1, 1).transpose(1, 2)


@dataclass(frozen=True)
class Segment:
    """A part of one trajectory: core samples, which belong only to this segment, and context around them.

    observation (L, p), input (L, m); samples core[0] ≤ i < core[1] of these L are the core.
    trajectory, index: position of the trajectory in its dataset and of the segment in its trajectory.
    """

    observation: Tensor
    input: Tensor
    timestep: float
    core: tuple[int, int]
    kind: str
    trajectory: int
    index: int

    def to(self, device) -> Segment:
        return replace(self, observation=self.observation.to(device), input=self.input.to(device))

    def core_rows(self, rows, first: int):
        """The rows that belong to core samples; row r of `rows` belongs to sample first + r."""
        return rows[max(self.core[0] - first, 0):max(self.core[1] - first, 0)]


@dataclass(frozen=True)
class SegmentPlan:
    """Position of a segment in its trajectory: samples start ≤ k < stop are read, core[0] ≤ k < core[1] are its core.
    """

    trajectory: int
    index: int
    start: int
    stop: int
    core: tuple[int, int]


class SegmentDataset(Dataset):
    """Trajectories cut into segments of at most `rows` core samples; each sample is core in exactly one segment.

    before, after: number of context samples that a row needs on either side (delays and derivative stencil).
    transient: s cut from the start of every decay. Only one segment is in memory at a time.
    Raises ValueError if a trajectory is shorter than its transient and one window, or if rows < 1.
    """

    def __init__(self, trajectories: Sequence, *, before: int, after: int, rows: int = 1024, transient: float = 0.0):
        if rows < 1:
            raise ValueError(f"rows is {rows}; expected at least 1 core sample per segment")
        self.trajectories = tuple(trajectories)
        self.plans: list[SegmentPlan] = []
        for number, trajectory in enumerate(self.trajectories):
            first = round(transient / trajectory.timestep) if trajectory.kind == "decay" else 0
            if first + before + after >= trajectory.length:
                raise ValueError(f"trajectory {trajectory.name or number!r} has {trajectory.length} samples; "
                                 f"a transient of {first} samples and {before + after} samples of context leave none; "
                                 "use a shorter transient or fewer delays, or leave this trajectory out")
            # the first segment has no context before it, but must contain one whole window
            shortest = first + before + after + 1
            for index, start in enumerate(range(first, trajectory.length, rows)):
                stop = min(start + rows, trajectory.length)
                end = min(max(stop + after, shortest), trajectory.length)
                self.plans.append(SegmentPlan(number, index, max(start - before, first), end, (start, stop)))

    def __len__(self) -> int:
        return len(self.plans)

    def __getitem__(self, item: int) -> Segment:
        plan = self.plans[item]
        trajectory = self.trajectories[plan.trajectory]
        observation, inputs = trajectory.slice(plan.start, plan.stop)
        core = (plan.core[0] - plan.start, plan.core[1] - plan.start)
        return Segment(_tensor(observation), _tensor(inputs), trajectory.timestep, core, trajectory.kind,
                       plan.trajectory, plan.index)


class SegmentShare(Dataset):
    """The part of the segments for one process. Each segment is in exactly one part, and all parts are equally long.

    Processes of a distributed run step together. A shorter part therefore ends with a segment without core samples.
    """

    def __init__(self, segments: SegmentDataset, rank: int, processes: int):
        self.segments, self.rank, self.processes = segments, rank, processes

    def __len__(self) -> int:
        return -(-len(self.segments) // self.processes)

    def __getitem__(self, item: int) -> Segment:
        position = self.rank + item * self.processes
        if position < len(self.segments):
            return self.segments[position]
        return replace(self.segments[self.rank], core=(0, 0))


@dataclass(frozen=True)
class RolloutBatch:
    """Windows (N, n_d + 1, p) with inputs (N, n_d, m), and the next H samples: inputs (N, H, m), outputs (N, H, p)."""

    window: Tensor
    window_inputs: Tensor
    inputs: Tensor
    outputs: Tensor

    def to(self, device) -> RolloutBatch:
        return RolloutBatch(*(getattr(self, name).to(device) for name in self.__dataclass_fields__))


class RolloutDataset(Dataset):
    """Random starts in trajectories, each with its window and the next H samples; no rollout crosses a run boundary.

    sampling: number of samples per model step. Windows and outputs are spaced by it, and each input is the mean over a
    step. delays, horizon: in model steps.
    starts: number of starts, drawn uniformly from all possible ones; None: all of them, `stride` samples apart.
    Raises ValueError if no trajectory is long enough.
    """

    def __init__(self, trajectories: Sequence, *, delays: int, horizon: int, starts: int | None = None,
                 stride: int = 1, seed: int = 0, transient: float = 0.0, sampling: int = 1):
        self.trajectories, self.delays, self.horizon, self.sampling = tuple(trajectories), delays, horizon, sampling
        before, after = delays * sampling, horizon * sampling
        admissible = []
        for number, trajectory in enumerate(self.trajectories):
            first = round(transient / trajectory.timestep) if trajectory.kind == "decay" else 0
            newest = np.arange(first + before, trajectory.length - after, stride)
            admissible.append(np.stack([np.full_like(newest, number), newest], axis=1))
        everything = np.concatenate(admissible) if admissible else np.zeros((0, 2), dtype=np.int64)
        if not len(everything):
            longest = max((t.length for t in self.trajectories), default=0)
            apart = f", {sampling} samples apart," if sampling > 1 else ""
            raise ValueError(f"all runs are too short: {delays} delays and a horizon of {horizon} samples{apart} need "
                             f"{before + after + 1} samples, but the longest of {len(self.trajectories)} trajectories "
                             f"has {longest}; use a shorter horizon or fewer delays")
        if starts is not None and starts < len(everything):
            everything = everything[np.random.default_rng(seed).choice(len(everything), starts, replace=False)]
        self.starts = everything

    def __len__(self) -> int:
        return len(self.starts)

    def __getitem__(self, item: int) -> RolloutBatch:
        number, newest = self.starts[item]
        d, h, s = self.delays, self.horizon, self.sampling
        observation, inputs = self.trajectories[number].slice(newest - d * s, newest + h * s + 1)
        observation, inputs = _tensor(observation)[::s], _tensor(inputs)[:-1].unflatten(0, (d + h, s)).mean(1)
        return RolloutBatch(observation[:d + 1], inputs[:d], inputs[d:], observation[d + 1:])


def stack_rollouts(items: list[RolloutBatch]) -> RolloutBatch:
    """One batch from single starts."""
    return RolloutBatch(*(torch.stack([getattr(item, name) for item in items])
                          for name in RolloutBatch.__dataclass_fields__))


def _tensor(array: np.ndarray) -> Tensor:
    return torch.from_numpy(np.array(array, dtype=np.float64))
