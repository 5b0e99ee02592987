"""Open-loop errors over the workspace (paper, Fig. 4 and 5)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ssmr_torch.configuration import built, plain
from ssmr_torch.data.starts import draw_starts, samples_within
from ssmr_torch.deployment import artifact
from ssmr_torch.evaluation.measured_rollouts import JoinedRuns
from ssmr_torch.evaluation.open_loop import HORIZONS, OpenLoopScore, compare_open_loop
from ssmr_torch.hdf5_file import new_hdf5
from ssmr_torch.provenance import provenance
from ssmr_torch.result_files import save_json


@dataclass(frozen=True, eq=False)
class OpenLoopMap:
    """scores: of all models and both baselines; position (S, q): outputs at each start, m; errors: by model, (S,) m,
    RMSE over the first horizon from that start, infinite where the rollout diverged.
    """

    scores: Mapping[str, OpenLoopScore]
    position: np.ndarray
    errors: Mapping[str, np.ndarray]


def map_open_loop(models: Mapping[str, object], runs: Sequence, *, outputs: Sequence[int], starts: int = 500,
                  seed: int = 0, horizons: Sequence[float] = HORIZONS) -> OpenLoopMap:
    """`compare_open_loop` with where each rollout of the first horizon started; arguments and errors are its.

    outputs: columns that are scored and whose position is kept.
    """
    runs = [run.read() for run in runs]
    scores = compare_open_loop(models, runs, horizons=horizons, starts=starts, seed=seed, outputs=outputs)
    joined = JoinedRuns.of(runs)
    margin = next(iter(scores.values())).margin
    span = samples_within(horizons[0], joined.timestep)
    owner, sample = draw_starts(joined.lengths, margin, span, starts, seed)
    position = joined.observation[joined.offsets[owner] + sample][:, list(outputs)]
    return OpenLoopMap(scores, position, {name: scores[name].horizons[0].errors for name in models})


def write_open_loop_map(config, path: Path, artifacts: Mapping[str, Path]) -> None:
    """PATH.h5 and PATH.json: errors and scores of those artifacts that there are.

    config: of `ssmr evaluate`. Raises ValueError where there are none.
    """
    loaded = {name: artifact.load(place) for name, place in artifacts.items() if place.is_dir()}
    if not loaded:
        raise ValueError(f"none of {', '.join(artifacts)} was trained")
    dataset = built(config.data).observing(artifact.common_outputs(list(loaded.values())))
    runs = dataset.select(config.split, config.kind)
    found = map_open_loop({name: each.model for name, each in loaded.items()}, runs,
                          outputs=dataset.columns(config.outputs), starts=config.starts, seed=config.seed,
                          horizons=list(config.horizons))
    size = 2 * found.position.nbytes * (1 + len(found.errors)) + 2 ** 20
    with new_hdf5(f"{path}.h5", size) as file:
        file["position"] = found.position
        for name, errors in found.errors.items():
            file[f"error/{name}"] = errors
    save_json(Path(f"{path}.json"), {
        "scores": {name: score.as_dict() for name, score in found.scores.items()},
        "test": ", ".join(run.name for run in runs), "provenance": provenance(plain(config, without=["artifact"]))})
