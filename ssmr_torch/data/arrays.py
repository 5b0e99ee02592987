"""Trajectories from arrays or frames in memory, on the way that recordings in files take."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace

import numpy as np
import numpy.typing as npt

from ssmr_torch.data.assembly import assemble
from ssmr_torch.data.input_lag import with_lag
from ssmr_torch.data.sampling import SamplingRule
from ssmr_torch.data.units import Plausible, Units
from ssmr_torch.recording_clocks.clock_rules import ClockRules
from ssmr_torch.recording_clocks.seconds import clock_of
from ssmr_torch.recording_faults.copies import without_copies
from ssmr_torch.recording_faults.mending import compared, mended
from ssmr_torch.recording_faults.moving_decays import moving_decays
from ssmr_torch.recording_faults.recording import Recording, longest
from ssmr_torch.recording_faults.rules import FaultRules
from ssmr_torch.recording_files.table import Table
from ssmr_torch.trajectory import TrajectoryDataset

# Runs (t, y, u), or a mapping that names them.
Runs = Sequence[Sequence] | Mapping[str, Sequence]


def trajectories(*, decays: Runs = (), controlled: Runs = (), validation: Runs = (), test: Runs = (),
                 output_names: Sequence[str] | None = None, input_names: Sequence[str] | None = None,
                 units: Mapping[str, str] | None = None, rest: npt.ArrayLike | None = None,
                 timestep: float | None = None, missing: str = "bridge", faults: Mapping[str, str] | None = None,
                 minimum_length: int = 10, range: Sequence[float] = Plausible.displacement,
                 interval_range: Sequence[float] = Plausible.interval, largest_input: float | None = None,
                 stamps: str = "as_given", same_stamp: str = "refuse",
                 input_lag: str | float = "keep") -> TrajectoryDataset:
    """The dataset of runs that are arrays, or frames of pandas or polars.

    Each run is (t, y, u): times (T,), numbers or dates, or one number, the sampling time; displacements from rest,
    (T, p) or (T,); inputs (T, m) or (T,), u[k] held from sample k to k + 1, so that y[k] does not feel it yet. A decay
    may be (t, y): its inputs are zero. Frames bring the names of their columns.

    decays: runs back to rest without input. controlled: runs under inputs. Both are trained on. validation, test: runs
    that are not; those whose inputs never move count as decays. A mapping instead of a list names its runs.
    output_names, input_names: one per column (y1, … and u1, … by default); of a frame they choose the columns.
    units: of what is given, such as {"length": "mm", "input": "N", "time": "s"}; m, N and s by default, and input "1"
    for normalized commands. rest: (p,), absolute position of the origin of y, in the unit of length; zero by default.
    timestep: s, of the grid of irregular samples; None: their median interval. missing: of rows that are not finite,
    "bridge" (up to five, else cut), "split" (up to two) or "refuse". faults: rules as {"outliers": "cut"}, see
    `recording_faults.rules.FaultRules`. minimum_length: samples; shorter runs are left out. range, interval_range:
    smallest and largest plausible peak displacement, m, and sampling time, s; largest_input: of |u|, in N or 1. stamps:
    "even" spreads samples evenly. same_stamp: of samples of one time, "refuse" them, or keep the "first" or "last".
    input_lag: "keep", "remove", or s by which inputs stand late.

    Raises ValueError, with the run and the remedy, for lengths, names and units that do not fit, and for faults.

    >>> t = np.linspace(0.0, 2.0, 201)
    >>> swing = 8.0 * np.exp(-2.0 * t) * np.cos(9.0 * t)
    >>> trajectories(decays=[(t, swing, 0.0 * t)], test={"other": (0.01, 0.5 * swing, 0.0 * t)},
    ...              output_names=["tip"], input_names=["cable"], units={"length": "mm"})
    TrajectoryDataset: 2 runs, 402 samples, 0.01 s (100 Hz)
    ├─ runs
    │  ├─ decay, train: 1 run, 201 samples
    │  └─ decay, test: 1 run, 201 samples
    ├─ outputs: displacement from rest
    │  └─ tip: -4.07 … 8 mm
    ├─ inputs: held from sample to sample
    │  └─ cable: 0 … 0 N
    ...
    """
    measured = Units(**{"length": "m"} | _known_units(units))
    runs = _runs({"decays": decays, "controlled": controlled, "validation": validation, "test": test})
    output_names = _common("output", runs, [run.observation for run in runs], output_names)
    input_names = _common("input", runs, [run.input for run in runs], input_names)
    clock = ClockRules("t", measured.time, None, None, None, stamps, same_stamp, interval_range, tuple(output_names))
    recordings = [run.recording(output_names, input_names, measured, clock) for run in runs]
    rules, provenance = FaultRules.of(faults or {}, longest(recordings)), _provenance(recordings, measured)
    recordings = _without_faults(recordings, input_names, rules, missing, measured)
    origin = np.zeros(len(output_names)) if rest is None else measured.scale("length") * _vector(rest, output_names)
    plausible = Plausible((range[0], range[1]), (interval_range[0], interval_range[1]), largest_input)
    dataset = assemble(recordings, origin, output_names, input_names, measured,
                       SamplingRule("resample", timestep, minimum_length=minimum_length), provenance, plausible)
    return with_lag(without_copies(dataset, rules.copies), input_lag)


def _provenance(recordings: Sequence[Recording], units: Units) -> dict:
    return {"reader": "arrays", "sources": {each.name: _digest(each) for each in recordings}, "assumptions": [
        f"Lengths in {units.length}, inputs in {units.input}, time in {units.time}.",
        "Observations are displacements from rest.",
        "Each input is held until the next sample and acts after the observation of its row."]}


def _without_faults(recordings, input_names, rules: FaultRules, missing: str, units: Units) -> list[Recording]:
    found = mended(moving_decays(recordings, input_names, rules.moving_decays), rules, missing)
    return compared(found, np.zeros(found[0].observation.shape[1]), rules, units.scale("length"), units.length)


def _runs(given: Mapping) -> list[_Columns]:
    """All runs, each under a name of its own."""
    runs = [_Columns(name, part, *run) for part, of_part in given.items() for name, run in _named(part, of_part)]
    if not runs:
        raise ValueError("no runs were given; expected decays=[(t, y, u), …], controlled=[…], or both, and test=[…]")
    names = [run.name for run in runs]
    twice = sorted({name for name in names if names.count(name) > 1})
    if twice:
        raise ValueError(f"two runs are named {twice[0]!r}; give each a name of its own")
    return runs


class _Columns:
    """One run as it was given: times, and columns with their names where a frame brought them."""

    def __init__(self, name: str, part: str, time, observation, inputs=None):
        self.name, self.part = name, part
        self.observation = _table(observation, f"{name}: y")
        self.input = None if inputs is None else _table(inputs, f"{name}: u")
        if inputs is None and part in ("controlled", "validation"):
            raise ValueError(f"{name} has no inputs; expected (t, y, u)")
        self.time = np.asarray(time.to_numpy() if hasattr(time, "to_numpy") else time)

    def recording(self, output_names, input_names, units: Units, rules: ClockRules) -> Recording:
        """The run in SI units, its columns in the order of the names; raises ValueError where lengths differ."""
        y = self.observation[1]
        u = np.zeros((len(y), len(input_names))) if self.input is None else self.input[1]
        if len(y) == len(u) + 1:
            raise ValueError(f"{self.name} has {len(y)} observations and {len(u)} inputs; expected equally many: u[k] "
                             "is held from sample k to sample k + 1, so leave out the last observation, y[:-1], t[:-1]")
        y, u = (_chosen(table, array, names, self.name) for table, array, names in
                ((self.observation, y, output_names), (self.input, u, input_names)))
        if self.time.ndim == 0:
            rules = replace(rules, time=None, interval=units.scale("time") * float(self.time))
        clock = clock_of(self._as_table(rules, y, u), self.name, self.name, rules)
        y, u = units.scale("length") * y[clock.rows], units.scale("input") * u[clock.rows]
        still = len(u) and np.ptp(u[np.isfinite(u).all(axis=1)], axis=0).max(initial=0.0) == 0
        kind = "decay" if self.part == "decays" or (self.part in ("test", "validation") and still) else "controlled"
        split = self.part if self.part in ("test", "validation") else "train"
        return Recording(self.name, clock.time, y, u, kind, split, centred=True, rows=np.sort(clock.rows),
                         notes=clock.notes, output_names=tuple(output_names))

    def _as_table(self, rules: ClockRules, y: np.ndarray, u: np.ndarray) -> Table:
        """Times, outputs and inputs as a table, whose clock is read as those of files."""
        time = {} if rules.time is None else {"t": self.time.reshape(-1)}
        lengths = [len(each) for each in (*time.values(), y, u)]
        if len(set(lengths)) > 1:
            raise ValueError(f"{self.name}: {lengths[0]} times, {len(y)} observations and {len(u)} inputs; expected "
                             "equally many")
        columns = time | dict(zip(rules.outputs, y.T)) | {f"input {place}": each for place, each in enumerate(u.T)}
        return Table(columns, format="arrays")


def _named(part: str, runs) -> Iterable[tuple[str, tuple]]:
    """Name and (t, y, u) of each run; `decay 1`, … where they have none."""
    if not isinstance(runs, (Mapping, list, tuple)):
        raise ValueError(f"{part} is {type(runs).__name__}; expected a list of runs (t, y, u), or a mapping that names "
                         "them")
    numbered = {f"{part.removesuffix('s')} {place}": run for place, run in enumerate(runs, start=1)}
    for name, run in (runs if isinstance(runs, Mapping) else numbered).items():
        if not isinstance(run, (tuple, list)) or len(run) not in (2, 3):
            raise ValueError(f"{name} of {part} is no run; expected (t, y, u): times or a sampling time, observations "
                             "(T, p), inputs (T, m)")
        yield str(name), tuple(run)


def _table(given, what: str) -> tuple[tuple[str, ...] | None, np.ndarray]:
    """Names of the columns, None of an array, and the numbers (T, columns)."""
    names = tuple(str(name) for name in given.columns) if hasattr(given, "columns") else None
    try:
        array = np.asarray(given.to_numpy() if hasattr(given, "to_numpy") else given)
        if np.iscomplexobj(array):
            raise TypeError("it is complex")
        array = np.array(array, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise ValueError(f"{what} is not all numbers ({error}); leave out columns of text and dates") from error
    if array.ndim not in (1, 2):
        raise ValueError(f"{what} has shape {array.shape}; expected (T,) or (T, columns)")
    return names, array.reshape(len(array), -1)


def _common(what: str, runs, tables, names) -> tuple[str, ...]:
    """The names that all runs share: those asked for, those of frames, or numbers. Refuses runs that differ."""
    known = [(run.name, table) for run, table in zip(runs, tables) if table is not None]
    if names is None and not known:
        raise ValueError(f"no run has {what}s; give {what}_names, one for each {what} of the robot")
    first = next((columns for _, (columns, _) in known if columns is not None), None)
    if names is None:
        names = first or [f"{'y' if what == 'output' else 'u'}{place}"
                          for place in np.arange(known[0][1][1].shape[1]) + 1]
    names = (names,) if isinstance(names, str) else tuple(names)
    for run, (columns, array) in known:
        lacking = [] if columns is None else [name for name in names if name not in columns]
        if lacking:
            raise ValueError(f"{run} has no {what} columns {lacking}; its frame has {list(columns)}")
        if columns is None and array.shape[1] != len(names):
            raise ValueError(f"{run} has {array.shape[1]} {what}s; expected {len(names)}, {list(names)}: one column "
                             "for each, in every run")
    return names


def _chosen(table, array: np.ndarray, names: Sequence[str], run: str) -> np.ndarray:
    """The columns of these names, in this order."""
    if table is None or table[0] is None:
        return array
    return array[:, [table[0].index(name) for name in names]]


def _known_units(units: Mapping[str, str] | None) -> dict[str, str]:
    if not isinstance(units, Mapping | None):
        raise ValueError(f"units is {units!r}; expected a mapping, such as "
                         "{'length': 'mm', 'input': 'N', 'time': 's'}")
    return dict(units or {})


def _vector(rest, output_names: Sequence[str]) -> np.ndarray:
    vector = np.asarray(rest, dtype=np.float64)
    if vector.shape != (len(output_names),) or not np.isfinite(vector).all():
        raise ValueError(f"rest is {np.ndarray.tolist(vector)}; expected {len(output_names)} finite numbers, one for "
                         "each output")
    return vector


def _digest(recording: Recording) -> str:
    """SHA-256 of a run's numbers."""
    digest = hashlib.sha256()
    for array in (recording.time, recording.observation, recording.input):
        digest.update(np.ascontiguousarray(array).tobytes())
    return digest.hexdigest()
