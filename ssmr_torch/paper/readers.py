"""Readers of the recordings that the paper's authors published; each returns a dataset in SI units, measured from rest.

The keyword arguments are the keys of the data configurations. What a reader assumed is written to the provenance of the
dataset and to the log.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from ssmr_torch.checked_arguments import checked
from ssmr_torch.data.assembly import assemble, fingerprint, rest_at_end
from ssmr_torch.data.matlab_reader import read_koopman_struct, read_ssmlearn_cells, read_vector
from ssmr_torch.data.run_boundaries import check_seams, find_seams
from ssmr_torch.data.sampling import IRREGULAR, SamplingRule
from ssmr_torch.data.units import Units
from ssmr_torch.quantities import COUNT, PATH, SHARE, TEXT, TIMESTEP, TRUTH
from ssmr_torch.ranges import Each, Number, OneOf, OrNone, Text, Whole
from ssmr_torch.recording_faults.recording import Recording
from ssmr_torch.recording_files.reading import read_tables
from ssmr_torch.trajectory import TrajectoryDataset

__all__ = ["real_diamond", "authors_simulated_diamond", "real_trunk", "authors_simulated_trunk"]

AXES = ("x", "y", "z")
TIP = tuple(f"tip_{axis}" for axis in AXES)
ELBOWS_AND_TIP = tuple(f"elbow{i}_{axis}" for i in (1, 2, 3, 4) for axis in AXES) + TIP
MARKERS = tuple(f"marker{i}_{axis}" for i in (1, 2, 3) for axis in AXES)
DIAMOND_SEAM, TRUNK_SEAM = 3686, 1106
SET_POINT = 10      # samples kept of each set point
HOLD = 100          # samples for which an input must be held to be a set point
TRUNK_COLUMNS = tuple(f"{axis}{i}" for i in (1, 2, 3) for axis in AXES)
RELEASED = 0.05     # share of its way that a trunk has moved once it is released
HELD = "Each input is held until the next sample and acts after the observation of its row."


@checked(path=PATH, train=Each(TEXT, 0), test=Each(TEXT, 0), manual_decays=TRUTH, disturbed_decays=Each(COUNT, 0),
         decay_rest=TEXT, rest=OrNone(Each(Number(-1e3, 1e3, "m"), 1, 1000)), timestep=TIMESTEP,
         missing=Text("refuse or split"), minimum_length=Whole(2, 1_000_000))
def real_trunk(path: str | Path, *, train: Sequence[str] = ("controlled_1",),
                   test: Sequence[str] = ("controlled_2",), manual_decays: bool = False,
                   disturbed_decays: Sequence[int] = (7,), decay_rest: str = "own",
                   rest: Sequence[float] | None = None, timestep: float = 0.01, missing: str = "refuse",
                   minimum_length: int = 100) -> TrajectoryDataset:
    """A cable-driven trunk with three markers (marker3 is the tip) and six normalized inputs; CSV files in m.

    Decays: the samples before the release, where a hand or the motors hold the robot, are cut. Friction lets
    every decay end elsewhere, so `decay_rest="own"` measures each from its own end, "common" from the rest
    position.
    rest: absolute, m (9,); None takes the median end of the decays. disturbed_decays: manual decays to leave
    out. Controlled runs have one more observation than inputs; observation k is before input k, and the last
    is dropped.
    """
    folder = _folder(path)
    if decay_rest not in ("own", "common"):
        raise ValueError(f"decay_rest is {decay_rest!r}; expected 'own' or 'common'")
    sources = [folder / "observations_circle_decay_200g.csv"]
    decays = _trunk_decays(sources[0], timestep, "circle")
    if manual_decays:
        sources.append(folder / "observations_manual_decay_200g.csv")
        disturbed = [f"manual_{number}" for number in disturbed_decays]
        decays += [d for d in _trunk_decays(sources[1], timestep, "manual") if d.name not in disturbed]
    ends = _ends([d for d in decays if len(d.time) >= minimum_length], minimum_length)
    rest = np.median(ends, axis=0) if rest is None else _vector(rest, len(MARKERS))
    if decay_rest == "own":
        decays = [replace(d, observation=d.observation - end, centred=True)
                  for d, end in zip(decays, _ends(decays, 0))]
    controlled = []
    for run, split in [*((run, "train") for run in train), *((run, "test") for run in test)]:
        recording, files = _trunk_controlled(folder, run, split, timestep)
        controlled.append(recording)
        sources += files
    rule = SamplingRule("refuse", timestep, missing=missing, minimum_length=minimum_length)
    assumptions = _trunk_assumptions(controlled, ends, rest, decay_rest)
    return assemble(decays + controlled, rest, MARKERS, _inputs(6), Units(length="m", input="1"), rule,
                    _provenance("real_trunk", sources, assumptions))


def _trunk_assumptions(controlled: list[Recording], ends: np.ndarray, rest: np.ndarray,
                       decay_rest: str) -> list[str]:
    apart = 1e3 * max((np.linalg.norm(r.observation[0, -3:] - rest[-3:]) for r in controlled), default=0.0)
    spread = 1e3 * np.linalg.norm(ends[:, -3:] - np.median(ends[:, -3:], axis=0), axis=1)
    return [
        "Lengths in m, inputs normalized, 100 Hz. Decays begin at their release and have zero input.",
        f"The tips end up to {spread.max():.3g} mm (median {np.median(spread):.3g} mm) from their median; "
        f"decays are measured from {'their own end' if decay_rest == 'own' else 'the rest position'}.",
        f"The controlled runs start up to {apart:.3g} mm from the rest position (tip) and never rest again; "
        "they are measured from it.",
        "Observation k of a controlled run is before input k; the last observation is dropped."]


@checked(path=PATH, decays=TEXT, controlled=OrNone(TEXT), outputs=TEXT, test_decays=Each(COUNT, 0), train_share=SHARE,
         rest=OrNone(Each(Number(-1e3, 1e3, "m"), 1, 1000)), sampling=TEXT, timestep=TIMESTEP,
         irregularity=Number(0.0, 10.0), missing=Text("refuse or split"), minimum_length=Whole(2, 1_000_000))
def real_diamond(path: str | Path, *, decays: str = "decays.mat",
                     controlled: str | None = "controlled_2022.mat", outputs: str = "tip",
                     test_decays: Sequence[int] = (5, 15, 21, 32, 38), train_share: float = 0.5,
                     rest: Sequence[float] | None = None, sampling: str = "resample",
                     timestep: float = 0.01, irregularity: float = IRREGULAR,
                     missing: str = "refuse", minimum_length: int = 50) -> TrajectoryDataset:
    """A diamond robot with four normalized inputs; MATLAB files in mm, sampled with jitter.

    Decays (numbers from 1) come centred, fast transient cut. The first `train_share` of the controlled run is
    for training, the rest for test. outputs: "tip" or "elbows_and_tip" (four elbows, then the tip).
    rest: absolute position in the controlled run, m (p,); None takes the median over its last second.
    """
    folder = _folder(path)
    if outputs not in ("tip", "elbows_and_tip"):
        raise ValueError(f"outputs is {outputs!r}; expected 'tip' or 'elbows_and_tip'")
    if not 0 < train_share <= 1:
        raise ValueError(f"train_share is {train_share}; expected 0 < share ≤ 1")
    names = TIP if outputs == "tip" else ELBOWS_AND_TIP
    recordings = _decays(folder / decays, 1e-3, 4, names, test_decays)
    sources = [folder / decays]
    assumptions = ["Lengths in mm, inputs normalized.", "Decays are centred and have zero input.", HELD]
    if controlled is None:
        rest = np.zeros(len(names)) if rest is None else _vector(rest, len(names))
        assumptions.append("Without a controlled run the absolute rest position is not known; given or zero.")
    else:
        run = _koopman(folder / controlled, 1e-3, 1.0, names)
        rest = (rest_at_end(run.time, run.observation, run.input, run.name) if rest is None
                else _vector(rest, len(names)))
        apart = 1e3 * np.linalg.norm(run.observation[0] - rest)
        assumptions += [
            f"The controlled run is measured from {np.round(1e3 * rest, 4).tolist()} mm, by default the "
            f"median of its last second at rest; its first sample is {apart:.3g} mm away from there.",
            f"Its resting command is {run.input.min(axis=0).tolist()}, not zero; commands are kept as "
            "recorded."]
        recordings += _share(run, train_share, minimum_length)
        sources.append(folder / controlled)
    rule = SamplingRule(sampling, timestep, irregularity, missing, minimum_length)
    return assemble(recordings, rest, names, _inputs(4), Units(length="mm", input="1"), rule,
                    _provenance("real_diamond", sources, assumptions))


@checked(path=PATH, splits=Each(OneOf("train", "validation", "test"), 1, 10), test_decays=Each(COUNT, 0), static=TRUTH,
         missing=Text("refuse or split"))
def authors_simulated_diamond(path: str | Path, *, splits: Sequence[str] = ("train", "test"),
                      test_decays: Sequence[int] = (), static: bool = True,
                      missing: str = "refuse") -> TrajectoryDataset:
    """A finite-element diamond with four cables; MATLAB files in mm and mN, 100 Hz.

    The controlled file glues two runs, the second from row 3686 on; `splits` says what each is for. Decays
    (numbers from 1) come centred. static: add the set points, each the last tenth of a second of a held
    input.
    """
    folder = _folder(path)
    run = _koopman(folder / "controlled.mat", 1e-3, 1e-3, TIP)
    recordings = _decays(folder / "decays.mat", 1e-3, 4, TIP, test_decays)
    rest = 1e-3 * _vector(read_vector(folder / "decays.mat", "y_eq"), 3)
    return _simulated(folder, "authors_simulated_diamond", run, DIAMOND_SEAM, splits, recordings, rest, static,
                      missing)


@checked(path=PATH, rest=Each(Number(-1e3, 1e3, "m"), 1, 1000),
         splits=Each(OneOf("train", "validation", "test"), 1, 10), static=TRUTH,
         missing=Text("refuse or split"))
def authors_simulated_trunk(path: str | Path, *, rest: Sequence[float] = (3.5888e-3, 0.2934e-3, 195.6144e-3),
                    splits: Sequence[str] = ("test", "train"), static: bool = True,
                    missing: str = "refuse") -> TrajectoryDataset:
    """A finite-element trunk with four long and four short cables; MATLAB files in mm and mN, 100 Hz.

    The controlled file glues two runs, the second from row 1106 on; `splits` says what each is for. There are
    no decays. rest: absolute, m (3,). static: add the set points, each the last tenth of a second of a held
    input.
    """
    folder = _folder(path)
    run = _koopman(folder / "controlled.mat", 1e-3, 1e-3, TIP)
    return _simulated(folder, "authors_simulated_trunk", run, TRUNK_SEAM, splits, [], _vector(rest, 3), static,
                      missing)


def _simulated(folder, reader, run, seam, splits, recordings, rest, static, missing) -> TrajectoryDataset:
    if len(splits) != 2:
        raise ValueError(f"splits is {list(splits)}; expected one entry for each of the 2 runs")
    check_seams(find_seams(run.observation), [seam], run.name)
    recordings = [*recordings, _part(run, 0, seam, splits[0], "first"),
                  _part(run, seam, None, splits[1], "second")]
    sources = [folder / "controlled.mat"] + ([folder / "decays.mat"] if reader == "authors_simulated_diamond" else [])
    assumptions = ["Lengths in mm, inputs in mN, 100 Hz.", HELD, f"A second run begins at row {seam}.",
                   f"The first sample is {1e3 * np.linalg.norm(run.observation[0] - rest):.3g} mm from rest."]
    if static:
        points = _set_points(_koopman(folder / "static.mat", 1e-3, 1e-3, TIP))
        recordings += points
        sources.append(folder / "static.mat")
        assumptions.append(f"{len(points)} set points, the last {SET_POINT} samples of each input held for "
                           "1 s or more.")
    rule = SamplingRule("refuse", 0.01, missing=missing, minimum_length=SET_POINT)
    return assemble(recordings, rest, TIP, _inputs(run.input.shape[1]), Units(length="mm", input="mN"), rule,
                    _provenance(reader, sources, assumptions))


def _inputs(count: int) -> list[str]:
    return [f"u{number}" for number in range(1, count + 1)]


def _provenance(reader: str, sources: list[Path], assumptions: list[str]) -> dict:
    return {"reader": reader, "sources": fingerprint(*sources), "assumptions": assumptions}


def _folder(path: str | Path) -> Path:
    path = Path(path)
    if not path.is_dir():
        raise FileNotFoundError(f"no directory {path}; give the one that holds the files of this robot")
    return path


def _vector(values, length: int) -> np.ndarray:
    vector = np.asarray(values, dtype=np.float64)
    if vector.shape != (length,) or not np.isfinite(vector).all():
        raise ValueError(f"rest is {np.ndarray.tolist(vector)}; expected {length} finite numbers in m")
    return vector


def _koopman(path: Path, length: float, force: float, names: Sequence[str]) -> Recording:
    fields = read_koopman_struct(path)
    if fields["y"].shape[1] < len(names):
        raise ValueError(f"{path.name} has {fields['y'].shape[1]} outputs; {len(names)} are asked for, "
                         f"{list(names)}")
    # The tip comes last when there are elbows or velocities before it.
    observation = fields["y"][:, -len(names):]
    return Recording(path.stem, fields["t"], length * observation, force * fields["u"])


def _part(run: Recording, start: int, stop: int | None, split: str, name: str) -> Recording:
    rows = slice(start, stop)
    return replace(run, name=f"{run.name}_{name}", rows=None, time=run.time[rows], observation=run.observation[rows],
                   input=run.input[rows], split=split, seams=())


def _share(run: Recording, train_share: float, minimum_length: int) -> list[Recording]:
    row = int(round(train_share * len(run.time)))
    found = find_seams(run.observation)
    check_seams(found, [], run.name)
    if min(row, len(run.time) - row) < minimum_length:
        return [replace(run, seams=())]
    return [_part(run, 0, row, "train", "first"), _part(run, row, None, "test", "last")]


def _decays(path: Path, length: float, inputs: int, names: Sequence[str],
            test: Sequence[int]) -> list[Recording]:
    cells = read_ssmlearn_cells(path)
    wrong = [number for number in test if not 1 <= number <= len(cells)]
    if wrong:
        raise ValueError(f"{path.name} has {len(cells)} decays; test_decays names {wrong}, counted from 1")
    if min(y.shape[1] for _, y in cells) < len(names):
        raise ValueError(f"{path.name} has {cells[0][1].shape[1]} outputs; {len(names)} are asked for, "
                         f"{list(names)}")
    return [Recording(f"decay_{number}", time, length * y[:, -len(names):], np.zeros((len(time), inputs)),
                      "decay", "test" if number in test else "train", True, ())
            for number, (time, y) in enumerate(cells, start=1)]


def _set_points(run: Recording) -> list[Recording]:
    changes = np.flatnonzero((np.diff(run.input, axis=0) != 0).any(axis=1)) + 1
    edges = np.r_[0, changes, len(run.time)]
    held = [(start, stop) for start, stop in zip(edges[:-1], edges[1:]) if stop - start >= HOLD]
    return [replace(_part(run, stop - SET_POINT, stop, "train", f"{index}"), kind="static")
            for index, (_, stop) in enumerate(held)]


def _trunk_decays(path: Path, timestep: float, label: str) -> list[Recording]:
    (table,) = read_tables(path)
    positions, numbers = table.numbers(TRUNK_COLUMNS, path.name), table.numbers(["ID"], path.name)[:, 0]
    decays = []
    for number in np.unique(numbers):
        y = positions[numbers == number]
        moved = np.linalg.norm(y - y[0], axis=1)
        # Until then a hand or the motors hold the robot.
        release = int(np.argmax(moved > RELEASED * moved[-1])) if moved[-1] > 0 else 0
        y = y[release:]
        decays.append(Recording(f"{label}_{number:g}", timestep * np.arange(len(y)), y, np.zeros((len(y), 6)),
                                "decay", "train", False, ()))
    return decays


def _ends(decays: list[Recording], minimum_length: int) -> np.ndarray:
    """Where each decay ends, (N, p) m."""
    if not decays:
        raise ValueError(f"no decay has {minimum_length} samples; lower minimum_length")
    return np.array([np.median(decay.observation[-10:], axis=0) for decay in decays])


def _trunk_controlled(folder: Path, run: str, split: str, timestep: float) -> tuple[Recording, list[Path]]:
    paths = [folder / f"observations_{run}.csv", folder / f"control_inputs_{run}.csv"]
    if run == "beta_controlled":
        paths[0] = folder / "observations_beta_controlled_200g.csv"
    y, u = (read_tables(path)[0].numbers(names, path.name) for path, names in zip(paths, (TRUNK_COLUMNS, _inputs(6))))
    if len(y) != len(u) + 1:
        raise ValueError(f"{paths[0].name} has {len(y)} rows and {paths[1].name} {len(u)}; expected one "
                         "observation more than inputs")
    return Recording(run, timestep * np.arange(len(u)), y[:-1], u, "controlled", split), paths
