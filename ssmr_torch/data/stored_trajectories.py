"""Trajectories as the package stores them: one `.h5` file, or several of the same robot."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from ssmr_torch.checked_arguments import checked
from ssmr_torch.data.assembly import fingerprint
from ssmr_torch.quantities import PATH
from ssmr_torch.ranges import Each, Either
from ssmr_torch.trajectory import TrajectoryDataset


@checked(path=Either(PATH, Each(PATH), said="the path of a file, or a list of paths"))
def stored(path: str | Path | Sequence[str | Path]) -> TrajectoryDataset:
    """The dataset in a file written by `TrajectoryDataset.save`, or in several files of one robot, without conversion.

    It adds the SHA-256 of the file to the provenance as "stored", and those of further files as "joined". Raises
    FileNotFoundError, or ValueError for a file of another kind, a truncated file, or files whose outputs, inputs, input
    unit or rest differ.
    """
    paths = [path] if isinstance(path, (str, Path)) else list(path)
    datasets = [TrajectoryDataset.load(each) for each in paths]
    for other, name in zip(datasets, paths):
        for what in ("output_names", "input_names", "input_unit", "rest"):
            one, two = getattr(datasets[0], what), getattr(other, what)
            if not (np.allclose(one, two, rtol=0, atol=1e-6) if what == "rest" else one == two):
                raise ValueError(f"{paths[0]} and {name} differ in {what}: {one} and {two}; "
                                 "join only files of one robot")
    provenance = datasets[0].provenance | {"stored": fingerprint(paths[0])}
    if len(paths) > 1:
        provenance["joined"] = [fingerprint(each) for each in paths[1:]]
    return replace(datasets[0], trajectories=tuple(run for dataset in datasets for run in dataset),
                   provenance=provenance)
