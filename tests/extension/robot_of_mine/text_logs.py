"""A reader of one's own: a folder of text logs, whose names say what each run is."""

from pathlib import Path

import numpy as np

from ssmr_torch.data.arrays import trajectories
from ssmr_torch.trajectory import TrajectoryDataset


def text_logs(path: str | Path) -> TrajectoryDataset:
    """Files decay*.txt, run*.txt and test*.txt with the rows "time | x y | three cables", in ms, mm and N."""
    found = {what: {} for what in ("decay", "run", "test")}
    for file in sorted(Path(path).glob("*.txt")):
        what = next((what for what in found if file.stem.startswith(what)), None)
        if what is None:
            raise ValueError(f"{file} is none of {', '.join(f'{what}*.txt' for what in found)}")
        rows = np.loadtxt(line.replace("|", " ") for line in file.open())
        found[what][file.stem] = rows[:, 0], rows[:, 1:3], rows[:, 3:]
    return trajectories(decays=found["decay"], controlled=found["run"], test=found["test"], output_names=["x", "y"],
                        input_names=["north", "south-west", "south-east"],
                        units={"time": "ms", "length": "mm", "input": "N"})
