"""Scores by groups of runs: runs of one kind are scored together, and different kinds separately.

Decays, smooth inputs and inputs of an MPC make different demands on a model. A mean over all runs would mainly show the
kind that was recorded most.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

from ssmr_torch.data.starts import samples_within
from ssmr_torch.evaluation.horizon_scores import OpenLoopScore
from ssmr_torch.evaluation.open_loop import HORIZONS, common_margin, compare_open_loop

COUNTER = re.compile(r"[\s_\-.#]*\d+$")
ALL_OF_A_KIND = {"decay": "decays", "static": "static"}
FIRST = ("controlled", "decay", "static")


@dataclass(frozen=True)
class GroupedScores:
    """scores: scores of all models and both baselines over all controlled runs, or over the decays if there are none.

    groups: the same by group of runs, see `group_of`, and "all controlled" if there are several groups of them. sizes:
    number of runs in each group; size: number of runs in `scores`. left_out: kinds of runs that are shorter than every
    horizon.
    """

    scores: Mapping[str, OpenLoopScore]
    groups: Mapping[str, Mapping[str, OpenLoopScore]]
    sizes: Mapping[str, int]
    size: int
    left_out: tuple[str, ...] = ()


def group_of(run) -> str:
    """Group of a run: "decays", "static", or for a controlled run its name without the number at its end.

    >>> from types import SimpleNamespace as Run
    >>> print(*(group_of(Run(kind=kind, name=name)) for kind, name in (
    ...     ("decay", "release-3"), ("controlled", "fast-test-1"), ("controlled", "fast-test-2"), ("controlled", "7"))))
    decays fast-test fast-test controlled
    """
    return ALL_OF_A_KIND.get(run.kind) or COUNTER.sub("", run.name or "") or run.kind


def compare_groups(models: Mapping[str, object], runs: Iterable, *, horizons: Sequence[float] = HORIZONS,
                   margin: int | None = None, **options) -> GroupedScores:
    """`compare_open_loop` over the controlled runs and, separately, over the decays; then split into groups.

    Each kind of runs has its own starts, as many as requested; a group has the starts that lie in its runs.
    Options and errors are those of `compare_open_loop`. The first kind must be long enough for every horizon; for other
    kinds, horizons that are too long are left out.
    """
    runs = [run.read() for run in runs]
    needed = common_margin(models, runs)
    margin = needed if margin is None else margin
    first, groups, sizes, left_out = None, {}, {}, []
    for kind in sorted({run.kind for run in runs}, key=FIRST.index):
        chosen = [run for run in runs if run.kind == kind]
        held = [seconds for seconds in horizons if first is None or any(
            run.length > margin + samples_within(seconds, run.timestep) for run in chosen)]
        if not held and first is not None:
            left_out.append(kind)
            continue
        found = compare_open_loop(models, chosen, horizons=held, margin=margin, **options)
        first = first or (found, len(chosen))
        parts = _split(found, chosen)
        if len(parts) > 1:
            parts[f"all {kind}"] = (found, len(chosen))
        groups |= {name: scores for name, (scores, _) in parts.items()}
        sizes |= {name: size for name, (_, size) in parts.items()}
    return GroupedScores(first[0], groups, sizes, first[1], tuple(left_out))


def _split(scores: Mapping[str, OpenLoopScore], runs: Sequence) -> dict[str, tuple[dict[str, OpenLoopScore], int]]:
    """The scores and the number of runs of each group that contains a start."""
    members: dict[str, list[int]] = {}
    for number, run in enumerate(runs):
        members.setdefault(group_of(run), []).append(number)
    parts = {group: ({name: score.of_runs(numbers) for name, score in scores.items()}, len(numbers))
             for group, numbers in members.items()}
    return {group: part for group, part in parts.items() if all(score.horizons for score in part[0].values())}
