"""What opens a notebook: recordings by a card, whatever lies under a path, and a controller on a plant."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

from ssmr_torch.lazy import found

if TYPE_CHECKING:
    from ssmr_torch.closed_loop.record import ClosedLoopRecord
    from ssmr_torch.control.base import Controller
    from ssmr_torch.plants.base import Plant
    from ssmr_torch.recording_checks.report import RecordingsReport
    from ssmr_torch.tasks.references import Task
    from ssmr_torch.trained_model import TrainedModel
    from ssmr_torch.trajectory import TrajectoryDataset

EXPECTED = ("an artifact (a folder with card.json, of ssmr export or model.save), or an .h5 file of trajectories (ssmr "
            "collect, data.save) or of a closed loop (record.save)")
READERS = {"ssmr_torch trajectories": "ssmr_torch.data.stored_trajectories:stored",
           "ssmr_torch closed loop": "ssmr_torch.closed_loop.record:ClosedLoopRecord"}
ADVICE = {".ckpt": "a checkpoint: ssmr export checkpoint=FILE makes an artifact of it",
          ".yaml": "a card perhaps: ssmr_torch.read(FILE) reads recordings by a card"}


def read(card: str | Path) -> TrajectoryDataset:
    """Recordings of one's own, as a YAML card beside them describes them; `data=custom data.card=FILE` of a command.

    The card names files (of any format in docs/recording_files.md), columns, units, rest position, decays and splits;
    see docs/data.md. What is read is in SI units, observations (T, p) are displacements from rest in m, inputs (T, m)
    are held from sample to sample.
    Raises FileNotFoundError, and ValueError for a wrong card or recordings that do not fit it; the message says which
    key or row.

    >>> read("robot.yaml")
    Traceback (most recent call last):
        ...
    FileNotFoundError: no card at robot.yaml; write one as docs/data.md shows
    """
    return found("ssmr_torch.data.card_reader:custom")(card)


def check(data: TrajectoryDataset) -> RecordingsReport:
    """What recordings lack, before any fit: decays, range of amplitude and speed, dither, held-out runs, noise,
    sampling, delay, friction, drift, the neutral input, each with a number and a remedy. As `ssmr check` does.

    data: of `read`, `load` or `trajectories`. The report prints itself, `report["delay"].numbers` are plain values in
    SI units, `report.figures(DIRECTORY)` draws what was found. Nothing is changed, and no file is written.
    Raises TypeError for what is no dataset.

    >>> import numpy as np, ssmr_torch
    >>> t = np.arange(0.0, 3.0, 0.01)
    >>> swing = 8.0 * np.exp(-2.0 * t) * np.cos(9.0 * t)
    >>> report = check(ssmr_torch.trajectories(decays=[(t, swing, 0.0 * t)], units={"length": "mm"}))
    >>> print(report["decays"].said)
    1 decay; in its last tenth it moves by at most 0.44 % of its size. Its end is 0.019 mm from rest.
    """
    return found("ssmr_torch.recording_checks.report:check")(data)


def load(path: str | Path) -> TrajectoryDataset | TrainedModel | ClosedLoopRecord:
    """What lies under a path, by what is found there, not by its name.

    An artifact gives a `TrainedModel`, whose reference prediction is replayed first (≤ 1e-9 relative); a file of
    trajectories a `TrajectoryDataset`, whose samples stay on disk until they are asked for; a file of a closed loop a
    `ClosedLoopRecord`.
    Raises FileNotFoundError where nothing is, ValueError for what is none of these, saying what was found.

    >>> load("nowhere")
    Traceback (most recent call last):
        ...
    FileNotFoundError: nothing at nowhere; expected an artifact (a folder with card.json, of ssmr export or ...
    """
    path = Path(path)
    if path.is_dir():
        if (path / "card.json").is_file():
            return found("ssmr_torch.trained_model:TrainedModel").load(path)
        inside = sorted(each.name for each in path.iterdir())
        within = "; its folder artifact is one" if (path / "artifact" / "card.json").is_file() else ""
        raise ValueError(f"{path} is a folder with {inside[:5] or 'nothing'}{within}; expected {EXPECTED}")
    if not path.is_file():
        raise FileNotFoundError(f"nothing at {path}; expected {EXPECTED}")
    said = found("ssmr_torch.trajectory:format_of")(path)
    for format, reader in READERS.items():
        if said.startswith(format):
            reader = found(reader)
            return getattr(reader, "load", reader)(path)
    advice = ADVICE.get(path.suffix, f"no file of this package{f', but of format {said!r}' if said else ''}")
    raise ValueError(f"{path} is {advice}; expected {EXPECTED}")


def simulate(plant: Plant, controller: Controller, task: Task, *, noise: float = 0.0, seed: int = 0,
             progress: bool = True, provenance: dict[str, object] | None = None,
             watch: Callable[..., None] | None = None) -> ClosedLoopRecord:
    """Let a controller steer a plant through a task, from rest; a bar shows where that takes more than a few seconds.

    plant: one of `ssmr_torch.plants`. controller: called as controller(time s, observation (p,) m) once per sample of
    the plant, such as `ModelPredictiveController`. task: one of `ssmr_torch.tasks`, in m over s.
    noise: standard deviation of the measurement noise on every output, m, on top of what the plant's own sensors add.
    seed: fixes this noise and the plant's randomness. provenance: plain values that the record keeps. watch: called
    once per sample, see `closed_loop.simulate`.
    Returns a `ClosedLoopRecord`. Raises ValueError when the control period is no multiple of the plant's timestep.

    >>> import numpy as np, ssmr_torch
    >>> from ssmr_torch.control.base import Command
    >>> class Still:                       # any object with a period, reset() and a call is a controller
    ...     period = 0.02
    ...     def reset(self): pass
    ...     def __call__(self, time, observation): return Command(np.zeros(4))
    >>> task = ssmr_torch.tasks.path([0.0, 0.1], [[0.0], [0.01]], outputs=["tip_x"])
    >>> simulate(ssmr_torch.plants.SlowManifold(), Still(), task)
    ClosedLoopRecord of 'path': 0.1 s
    ├─ tracked: tip_x; RMSE 5.92 mm, at most 10 mm
    ├─ samples: 11, 0.01 s (100 Hz)
    ├─ control: Still, 0.02 s (50 Hz)
    ├─ fallbacks: 0 of 11 decisions
    ├─ inputs
    │  ├─ cable_+x: 0 … 0 N
    │  ├─ cable_-x: 0 … 0 N
    │  ├─ cable_+y: 0 … 0 N
    │  └─ cable_-y: 0 … 0 N
    ├─ noise: 0 mm, seed 0
    ├─ from: plant slow manifold
    └─ made by: ssmr_torch ...
    """
    origin = found("ssmr_torch.provenance:provenance")() | (provenance or {})
    return found("ssmr_torch.closed_loop.simulation:simulate")(plant, controller, task, seed=seed, noise_std=noise,
                                                    progress=progress, provenance=origin, watch=watch)
