"""The card with which a user describes recordings of their own."""

from __future__ import annotations

import difflib
from dataclasses import dataclass, field, fields
from pathlib import Path

import yaml

from ssmr_torch.data.recording import DISPLACEMENT_RANGE, UNITS_OF_LENGTH
from ssmr_torch.data.sampling import IRREGULAR

UNITS = {"length": UNITS_OF_LENGTH, "input": {"N": 1.0, "mN": 1e-3, "1": 1.0}, "time": {"s": 1.0, "ms": 1e-3}}
RESTS = ("last sample of decays", "median of resting samples")
SPLITS = ("train", "validation", "test")


@dataclass(frozen=True)
class Columns:
    """Names of the columns; without `time`, the card must give sampling_time."""

    observation: list
    input: list = field(default_factory=list)
    time: str | None = None
    run: str | None = None


@dataclass(frozen=True)
class Units:
    """Units of the file; everything becomes m, N and s. Input "1" stands for normalized commands."""

    length: str
    input: str = "N"
    time: str = "s"

    def __post_init__(self):
        for key, known in UNITS.items():
            value = str(getattr(self, key))
            if value not in known:
                raise ValueError(f"units.{key} is {value!r}; expected one of {list(known)}")
            object.__setattr__(self, key, value)

    def scale(self, key: str) -> float:
        return UNITS[key][getattr(self, key)]


@dataclass(frozen=True)
class Card:
    """What a reader must know of a user's files; the fields are the keys of the YAML file, see docs/data.md.

    rest: vector in the unit of length, "last sample of decays" or "median of resting samples".
    seams: "auto", or rows by run. decays: names of the runs that are decays. split: {test: [...], validation:
    [...]}.
    sampling_time: in units.time, for files without a column of time. range: smallest and largest plausible
    peak displacement, m. timestep: grid, s.
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
    range: list = field(default_factory=lambda: list(DISPLACEMENT_RANGE))

    def __post_init__(self):
        if not self.files or not self.columns.observation:
            raise ValueError("the card names no files or no observation columns; at least one of each is "
                             "needed")
        if (self.columns.time is None) == (self.sampling_time is None):
            raise ValueError("the card needs either columns.time or sampling_time, and not both")
        if isinstance(self.rest, str) and self.rest not in RESTS:
            raise ValueError(f"rest is {self.rest!r}; expected a vector, {' or '.join(map(repr, RESTS))}")
        if not isinstance(self.rest, str) and len(self.rest) != len(self.columns.observation):
            raise ValueError(f"rest has {len(self.rest)} entries for {len(self.columns.observation)} "
                             "observation columns")
        if isinstance(self.seams, str) and self.seams != "auto":
            raise ValueError(f"seams is {self.seams!r}; expected auto or rows by run, as {{run: [120, 400]}}")
        _refuse_unknown(self.split, SPLITS, "split")


def read_card(path: str | Path) -> Card:
    """The card in a YAML file.

    Raises FileNotFoundError, or ValueError for a key that is unknown (naming the nearest one) or missing, and
    for a value of the wrong kind.
    """
    path = Path(path)
    if not path.is_file():
        raise FileNotFoundError(f"no card at {path}; write one as docs/data.md shows")
    try:
        content = yaml.safe_load(path.read_text(encoding="utf-8"))
        return _build(Card, content, "the card", columns=Columns, units=Units)
    except (ValueError, yaml.YAMLError) as error:
        raise ValueError(f"{path.name}: {error}") from error


def _build(noun, content, where: str, **parts):
    if not isinstance(content, dict):
        raise ValueError(f"{where} is {type(content).__name__}; expected keys and values")
    _refuse_unknown(content, [f.name for f in fields(noun)], where)
    content = dict(content)
    for f in fields(noun):
        if f.name in parts and f.name in content:
            content[f.name] = _build(parts[f.name], content[f.name], f.name)
        elif f.name in content:
            content[f.name] = _typed(f.type, content[f.name], f"{f.name} of {where}")
    try:
        return noun(**content)
    except TypeError as error:
        raise ValueError(f"{where} is incomplete: {error}") from error


def _typed(annotation: str, value, where: str):
    if value is None and "None" in annotation:
        return None
    # YAML 1.1 reads 1e-2 (without a point) as text.
    if annotation.startswith(("float", "int")):
        try:
            return float(value) if annotation.startswith("float") else int(value)
        except (TypeError, ValueError):
            raise ValueError(f"{where} is {value!r}; expected a number") from None
    kinds = {"list": list, "str": (str, int), "dict": dict, "None": type(None)}
    if not any(isinstance(value, kinds[name]) for name in annotation.split(" | ")):
        raise ValueError(f"{where} is {value!r}; expected {annotation.replace(' | ', ' or ')}")
    return value


def _refuse_unknown(content, known, where: str) -> None:
    for key in content:
        if key not in known:
            nearest = difflib.get_close_matches(str(key), known, n=1, cutoff=0.0)
            raise ValueError(f"{where} has the unknown key {key!r}; did you mean {nearest[0]!r}? "
                             f"Known keys: {', '.join(known)}")
