"""The card with which a user describes recordings of their own."""

from __future__ import annotations

import difflib
from dataclasses import MISSING, dataclass, field, fields
from pathlib import Path

import numpy as np
import yaml

from ssmr_torch.data.sampling import IRREGULAR
from ssmr_torch.data.units import Plausible, Units
from ssmr_torch.trajectory import SPLITS
from ssmr_torch.turns import stated

RESTS = ("last sample of decays", "median of resting samples")
KINDS = {"list": (list, "a list"), "str": ((str, int), "text"), "dict": (dict, "keys and values")}


@dataclass(frozen=True)
class Columns:
    """Names of the columns, each once; without `time`, the card must give sampling_time."""

    observation: list
    input: list = field(default_factory=list)
    time: str | None = None
    run: str | None = None

    def __post_init__(self):
        for key in ("observation", "input"):
            names = getattr(self, key)
            if not names or not all(isinstance(name, str) for name in names):
                zeros = "; recordings of decays only need columns of zeros, one for each input of the robot"
                raise ValueError(f"columns.{key} is {names!r}; training needs at least one {key} column, named as in "
                                 f"the files{zeros if key == 'input' else ''}")
        named = [*self.observation, *self.input, *filter(None, (self.time, self.run))]
        twice = sorted({name for name in named if named.count(name) > 1})
        if twice:
            raise ValueError(f"columns names {twice} twice, observation {self.observation} and input {self.input}; "
                             "expected each column once")


@dataclass(frozen=True)
class RecordingCard:
    """What a reader must know of a user's files; the fields are the keys of the YAML file, see docs/data.md.

    rest: vector in the unit of length, "last sample of decays" or "median of resting samples".
    seams: "auto", or rows by run. decays: names of the runs that are decays. split: {test: [...], validation:
    [...]}.
    sampling_time: in units.time, for files without a column of time. timestep: grid, s.
    range, interval_range, largest_input: what is plausible (`Plausible`), m, s, and N or 1.
    symmetry: {angle, axis, inputs} of a turn under which the robot stays the same, see `ssmr_torch.turns.stated`.
    """

    files: list
    columns: Columns
    units: Units
    rest: list | str
    decays: list = field(default_factory=list)
    centred: list = field(default_factory=list)
    split: dict = field(default_factory=dict)
    seams: dict | str = "auto"
    sampling_time: float | None = None
    timestep: float | None = None
    sampling: str = "resample"
    irregularity: float = IRREGULAR
    missing: str = "refuse"
    minimum_length: int = 10
    range: list = field(default_factory=lambda: list(Plausible.displacement))
    interval_range: list = field(default_factory=lambda: list(Plausible.interval))
    largest_input: float | None = None
    symmetry: dict = field(default_factory=dict)

    def __post_init__(self):
        if not self.files or not all(isinstance(name, str) for name in self.files):
            raise ValueError(f"files is {self.files!r}; expected the names of one file or more")
        if isinstance(self.seams, str) and self.seams != "auto":
            raise ValueError(f"seams is {self.seams!r}; expected auto or rows by run, as {{run: [120, 400]}}")
        _refuse_unknown(self.split, SPLITS, "split")
        for split, runs in self.split.items():
            if not isinstance(runs, list):
                raise ValueError(f"split.{split} is {runs!r}; expected a list of runs, as [{runs}]")
        self._check_rest()
        self._check_plausible()
        self._check_clock()
        if self.symmetry:
            stated(self.symmetry, self.columns.input, len(self.columns.observation))

    def _check_rest(self):
        if isinstance(self.rest, str):
            if self.rest not in RESTS:
                raise ValueError(f"rest is {self.rest!r}; expected a vector, {' or '.join(map(repr, RESTS))}")
            return
        count = len(self.columns.observation)
        object.__setattr__(self, "rest", _numbers(
            self.rest, count, "rest", f"{count} numbers in {self.units.length}, one for each observation column"))

    def _check_plausible(self):
        for key, unit in (("range", "m"), ("interval_range", "s")):
            expected = f"two numbers in {unit}, [smallest, largest]"
            bounds = _numbers(getattr(self, key), 2, key, expected)
            if not 0 <= bounds[0] < bounds[1]:
                raise ValueError(f"{key} is {bounds}; expected {expected}")
            object.__setattr__(self, key, bounds)
        if self.largest_input is not None and not self.largest_input > 0:
            raise ValueError(f"largest_input is {self.largest_input}; expected a positive number in N or 1")

    def _check_clock(self):
        if (self.columns.time is None) == (self.sampling_time is None):
            raise ValueError("the card needs either columns.time or sampling_time, and not both")
        if self.sampling_time is not None and not self.sampling_time > 0:
            raise ValueError(f"sampling_time is {self.sampling_time} {self.units.time}; it must be positive")
        shortest, longest = self.interval_range
        if self.timestep is not None and not shortest <= self.timestep <= longest:
            raise ValueError(f"timestep is {self.timestep:g} s; expected seconds, between {shortest:g} and {longest:g} "
                             "(interval_range)")


def read_recording_card(path: str | Path) -> RecordingCard:
    """The card in a YAML file.

    Raises FileNotFoundError, or ValueError for a file that is not YAML (naming the line), a key that is unknown
    (naming the nearest one) or missing, and a value of the wrong kind.
    """
    return described(path, RecordingCard, "docs/data.md", columns=Columns, units=Units)


def described(path: str | Path, noun, page: str, **parts):
    """The dataclass `noun` whose fields are the keys of a YAML file; `parts`: fields that are dataclasses themselves.

    page: where the keys are explained. Raises as `read_recording_card`.
    """
    path = Path(path)
    if not path.is_file():
        raise FileNotFoundError(f"no card at {path}; write one as {page} shows")
    try:
        content = yaml.safe_load(path.read_text(encoding="utf-8"))
        return _build(noun, content, "the card", **parts)
    except yaml.MarkedYAMLError as error:
        line = f"line {error.problem_mark.line + 1}: " if error.problem_mark else ""
        raise ValueError(f"{path.name}: {line}{error.problem or error.context}; expected YAML") from error
    except UnicodeDecodeError as error:
        raise ValueError(f"{path.name} is not text; expected a card, in YAML, as {page} shows; ssmr_torch.load "
                         "opens files of this package") from error
    except (ValueError, yaml.YAMLError) as error:
        raise ValueError(f"{path.name}: {' '.join(str(error).split())}") from error


def _build(noun, content, where: str, **parts):
    if not isinstance(content, dict):
        raise ValueError(f"{where} is {type(content).__name__}; expected keys and values")
    known = {f.name: f for f in fields(noun)}
    _refuse_unknown(content, list(known), where)
    needed = [name for name, f in known.items() if f.default is MISSING and f.default_factory is MISSING]
    missing = [name for name in needed if name not in content]
    if missing:
        raise ValueError(f"{where} lacks the key {' and '.join(missing)}; it needs {', '.join(needed)}")
    return noun(**{name: _build(parts[name], value, name) if name in parts
                   else _typed(known[name].type, value, f"{name} of {where}") for name, value in content.items()})


def _typed(annotation: str, value, where: str):
    if value is None and "None" in annotation:
        return None
    # YAML 1.1 reads 1e-2 (without a point) as text.
    if annotation.startswith(("float", "int")):
        try:
            return float(value) if annotation.startswith("float") else int(value)
        except (TypeError, ValueError):
            raise ValueError(f"{where} is {value!r}; expected a number") from None
    kinds = [KINDS[name] for name in annotation.split(" | ") if name != "None"]
    if not any(isinstance(value, kind) for kind, _ in kinds):
        raise ValueError(f"{where} is {value!r}; expected {' or '.join(word for _, word in kinds)}")
    return value


def _numbers(values, count: int, key: str, expected: str) -> list[float]:
    try:
        numbers = [float(value) for value in values]
    except (TypeError, ValueError):
        numbers = []
    if len(numbers) != count or not np.isfinite(numbers).all():
        raise ValueError(f"{key} is {values!r}; expected {expected}")
    return numbers


def _refuse_unknown(content, known, where: str) -> None:
    for key in content:
        if key not in known:
            nearest = difflib.get_close_matches(str(key), known, n=1, cutoff=0.0)
            raise ValueError(f"{where} has the unknown key {key!r}; did you mean {nearest[0]!r}? "
                             f"Known keys: {', '.join(known)}")
