"""The recording card: what a user says of their files."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal, Self

import numpy as np
from pydantic import (
    AfterValidator,
    BeforeValidator,
    Field,
    FiniteFloat,
    ValidationInfo,
    field_validator,
    model_validator,
)

from ssmr_torch.data.card_file import Card, not_as_described, read_card, refuse_unknown
from ssmr_torch.data.sampling import IRREGULAR
from ssmr_torch.data.units import Plausible, Units
from ssmr_torch.recording_clocks.clock_rules import SAME_STAMP, STAMPS, ClockRules
from ssmr_torch.recording_clocks.time_units import TIME_UNITS
from ssmr_torch.recording_faults.rules import CHOICES, MISSING, FaultRules
from ssmr_torch.symmetry_turns import stated
from ssmr_torch.trajectory import SPLITS

RESTS = ("last sample of decays", "median of resting samples")
PAGE = "docs/data.md"
LAGS = ("keep", "remove")
LARGEST_LAG = 10.0  # s


def _rising(bounds: list[float]) -> list[float]:
    if not 0 <= bounds[0] < bounds[1]:
        raise not_as_described()
    return bounds


Span = Annotated[list[FiniteFloat], Field(min_length=2, max_length=2), AfterValidator(_rising)]


def _name(given: object) -> object:
    """The name of a run; YAML reads 7 as a number, of which the text is known, and 1.10 as another, of which it is not.
    """
    if isinstance(given, bool | float) or given is None:
        raise ValueError(f"a run is named {given!r}, which YAML does not read as text; write the name in quotes, as "
                         f"\"{given}\"")
    return str(given) if isinstance(given, int) else given


Name = Annotated[str, BeforeValidator(_name)]


def _lag(given: object) -> object:
    if given in LAGS:
        return given
    if isinstance(given, bool):
        raise not_as_described()
    try:
        seconds = float(given)
    except (TypeError, ValueError):
        raise not_as_described() from None
    if not abs(seconds) <= LARGEST_LAG:
        raise not_as_described()
    return seconds


def _clock(given: object) -> object:
    if given == "auto":
        return given
    if isinstance(given, bool):
        raise not_as_described()
    try:
        value = float(given)
    except (TypeError, ValueError):
        raise not_as_described() from None
    if not np.isfinite(value):
        raise not_as_described()
    return value


class Columns(Card):
    """Names of the columns, each once; without `time` or `frame`, the card must give sampling_time.

    time: stamps; two names are seconds and nanoseconds, or a date and a time of day. frame: numbers of frames, of which
    the card's `rate` pass in 1 s. input_time: stamps of the inputs in a file of their own; `time` by default.
    """

    part: ClassVar[str] = "columns"

    observation: list[str] = Field(min_length=1, description="the names of one observation column or more, as in the "
                                                             "files; training needs them")
    input: list[str] = Field([], min_length=1, validate_default=True, description=(
        "the names of one input column or more, as in the files; training needs them, and recordings of decays only "
        "need columns of zeros, one for each input of the robot"))
    time: str | list[str] | None = Field(None, description="the name of a column, or two")
    frame: str | None = Field(None, description="the name of a column")
    input_time: str | list[str] | None = Field(None, description="the name of a column, or two")
    run: str | None = Field(None, description="the name of a column")

    @model_validator(mode="after")
    def _each_once(self) -> Self:
        named = [*self.observation, *self.input, *self.clock, *filter(None, (self.run,))]
        twice = sorted({name for name in named if named.count(name) > 1})
        if twice:
            raise ValueError(f"columns names {twice} twice, observation {self.observation} and input {self.input}; "
                             "expected each column once")
        return self


    @field_validator("time", "input_time")
    @classmethod
    def _two_at_most(cls, names):
        if isinstance(names, list) and len(names) not in (1, 2):
            raise not_as_described()
        return names[0] if isinstance(names, list) and len(names) == 1 else names

    @property
    def clock(self) -> list[str]:
        """Names of the columns of time or frame numbers."""
        times = [self.time] if isinstance(self.time, str) else list(self.time or ())
        return [*times, *filter(None, (self.frame,))]


class Pair(Card):
    """Two files of one run, each with a clock of its own: outputs in one, inputs in the other."""

    part: ClassVar[str] = "pairs"

    outputs: str = Field(description="the name of a file")
    inputs: str = Field(description="the name of a file")


class RecordingCard(Card):
    """What a reader must know of a user's files; the fields are the keys of the YAML file, see docs/data.md.

    rest: vector in the unit of length, "last sample of decays" or "median of resting samples".
    seams: "auto", or rows by run. decays: names of the runs that are decays. split: {test: [...], validation:
    [...]}.
    sampling_time: in units.time, for files without a column of time. rate: frames in 1 s. timestep: grid, s.
    missing: what to do with empty cells, `recording_faults.missing_rows`. faults: what to do about each other kind of
    fault, `recording_faults.rules.FaultRules`.
    pairs: files with the outputs and with the inputs of a run. clock_offset, clock_drift: s and ppm, of the inputs'
    clock, or "auto". stamps, same_stamp: see `ssmr_torch.recording_clocks.clock_rules`. input_lag: "keep", "remove",
    or s by which all inputs stand late.
    range, interval_range, largest_input: what is plausible (`Plausible`), m, s, and N or 1.
    symmetry: {angle, axis, inputs} of a turn under which the robot stays the same,
    see `ssmr_torch.symmetry_turns.stated`.
    """

    files: list[str] = Field(description="the names of one file or more, or patterns such as '*.csv'")
    columns: Columns = Field(description="keys and values, as {observation: [x, y], input: [u]}")
    units: Units = Field(description="keys and values, as {length: mm}")
    rest: list | str = Field(description="a vector, " + " or ".join(map(repr, RESTS)))
    decays: list[Name] = Field([], description="a list of runs")
    centred: list[Name] = Field([], description="a list of runs")
    split: dict[str, list[Name]] = Field({}, description="keys and values, as {test: [check]}")
    seams: dict[Name, list[int]] | Literal["auto"] = Field("auto", description="auto or rows by run, as "
                                                                               "{run: [120, 400]}")
    pairs: list[Pair] = Field([], description="a list such as [{outputs: camera.csv, inputs: commands.csv}]")
    sampling_time: FiniteFloat | None = Field(None, gt=0, description="a positive number in units.time")
    rate: FiniteFloat | None = Field(None, gt=0, description="a positive number of frames per second")
    stamps: str = Field("as_given", description="as_given or even")
    same_stamp: str = Field("refuse", description="refuse, first or last")
    clock_offset: Any = Field(0.0, description="auto, or a number of s that is added to the stamps of the inputs")
    clock_drift: Any = Field(0.0, description="auto, or a number of ppm by which the clock of the inputs runs slow")
    input_lag: Any = Field("keep", description=f"keep, remove, or s between {-LARGEST_LAG:g} and {LARGEST_LAG:g}")
    timestep: FiniteFloat | None = Field(None, description="a number of s")
    sampling: str = Field("resample", description="resample or refuse")
    irregularity: FiniteFloat = Field(IRREGULAR, description="a number")
    missing: str = Field("bridge", description="bridge, split or refuse")
    faults: dict[str, str] = Field({}, description="keys and values, as {outliers: cut}")
    minimum_length: int = Field(10, description="a whole number")
    range: Span = Field(list(Plausible.displacement), description="two numbers in m, [smallest, largest]")
    interval_range: Span = Field(list(Plausible.interval), description="two numbers in s, [smallest, largest]")
    largest_input: FiniteFloat | None = Field(None, gt=0, description="a positive number in N or 1")
    symmetry: dict = Field({}, description="keys and values, as {angle: 90, axis: [0, 0, 1], inputs: [b, a]}")

    @field_validator("missing")
    @classmethod
    def _known_missing(cls, missing):
        if missing not in MISSING:
            raise not_as_described()
        return missing

    @field_validator("faults")
    @classmethod
    def _known_faults(cls, faults):
        refuse_unknown("faults", faults, CHOICES)
        FaultRules.of(faults)
        return faults
    @model_validator(mode="before")
    @classmethod
    def _pairs_are_files(cls, content):
        return {"files": [], **content} if isinstance(content, dict) and content.get("pairs") else content

    @field_validator("split", mode="before")
    @classmethod
    def _known_splits(cls, split):
        if not isinstance(split, dict):
            return split
        refuse_unknown("split", split, SPLITS)
        for name, runs in split.items():
            if not isinstance(runs, list):
                raise ValueError(f"split.{name} is {runs!r}; expected a list of runs, as [{runs}]")
        return split

    @field_validator("stamps", "same_stamp")
    @classmethod
    def _known_rule(cls, rule, info: ValidationInfo):
        if rule not in {"stamps": STAMPS, "same_stamp": SAME_STAMP}[info.field_name]:
            raise not_as_described()
        return rule

    @field_validator("clock_offset", "clock_drift", "input_lag")
    @classmethod
    def _number_or_rule(cls, given, info: ValidationInfo):
        return (_lag if info.field_name == "input_lag" else _clock)(given)

    @field_validator("rest")
    @classmethod
    def _known_rest(cls, rest, info: ValidationInfo):
        if isinstance(rest, str):
            if rest not in RESTS:
                raise not_as_described()
            return rest
        if not {"columns", "units"} <= info.data.keys():
            return rest
        count = len(info.data["columns"].observation)
        try:
            numbers = [float(value) for value in rest]
        except (TypeError, ValueError):
            numbers = []
        if len(numbers) != count or not np.isfinite(numbers).all():
            raise ValueError(f"rest is {rest!r}; expected {count} numbers in {info.data['units'].length}, one for each "
                             "observation column")
        return numbers

    @model_validator(mode="after")
    def _one_split_each(self) -> Self:
        for key, names in {"decays": self.decays, "centred": self.centred,
                           "split": [name for runs in self.split.values() for name in runs]}.items():
            twice = sorted({name for name in names if names.count(name) > 1})
            if twice:
                where = [f"{key}.{split}" for split, runs in self.split.items() if twice[0] in runs] if key == "split" \
                    else [key]
                raise ValueError(f"{key} names the run {twice[0]!r} twice, in {' and '.join(where)}; expected each run "
                                 "once")
        return self

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        if not self.files and not self.pairs:
            raise ValueError(f"files is {self.files!r}; expected "
                             f"{type(self).model_fields['files'].description}, or pairs")
        clocks = {"columns.time": self.columns.time, "columns.frame": self.columns.frame,
                  "sampling_time": self.sampling_time}
        given = [key for key, value in clocks.items() if value is not None]
        if len(given) > 1:
            raise ValueError(f"the card gives {' and '.join(given)}; expected one of them, and not both")
        if self.rate is not None and self.columns.frame is None:
            raise ValueError("the card gives rate without columns.frame; expected the column of frame numbers, or "
                             f"sampling_time: {1 / self.rate / TIME_UNITS[self.units.time]:.6g}")
        if self.pairs and self.columns.input_time is None and self.columns.time is None:
            raise ValueError("pairs need columns.input_time, or columns.time where both files call it the same")
        shortest, longest = self.interval_range
        if self.timestep is not None and not shortest <= self.timestep <= longest:
            raise ValueError(f"timestep is {self.timestep:g} s; expected seconds, between {shortest:g} and {longest:g} "
                             "(interval_range)")
        if self.symmetry:
            stated(self.symmetry, self.columns.input, len(self.columns.observation))
        return self


    def clock_rules(self) -> ClockRules:
        """Where the clocks of the runs stand, and what to do with their faults."""
        columns = self.columns
        interval = None if self.sampling_time is None else self.sampling_time * self.units.scale("time")
        return ClockRules(columns.time if isinstance(columns.time, str | None) else tuple(columns.time),
                          self.units.time, interval, columns.frame, self.rate, self.stamps, self.same_stamp,
                          self.interval_range, tuple(columns.observation), tuple(columns.input))


def read_recording_card(path: str | Path) -> RecordingCard:
    """The recording card in a YAML file. Raises as `card_file.read_card`."""
    return read_card(path, RecordingCard, PAGE)
