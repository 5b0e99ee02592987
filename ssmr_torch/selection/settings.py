"""Settings of the selection of a slow-fast model; every setting has a default."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from ssmr_torch.checked_arguments import checked
from ssmr_torch.quantities import LENGTH, TEXT, TRUTH
from ssmr_torch.ranges import Anything, ByName, Each, Either, Number, OneOf, OrNone, Whole
from ssmr_torch.settings import Settings, non_negative, whole

PURPOSES = ("prediction", "control")
SYMMETRIES = ("find", "none")  # or a symmetry as a mapping


@checked(purpose=OneOf(*PURPOSES), scored=OrNone(Either(TEXT, Each(TEXT), said="a list of names of outputs")),
         noise=LENGTH, coordinates=OrNone(Either(TEXT, Each(TEXT), said="a list of names of coordinates")),
         team=Whole(1, 100), refine=TRUTH,
         symmetry=Either(OneOf(*SYMMETRIES), ByName(Anything()), said="find, none or a mapping"),
         minutes=Number(0.0, 1e5, "min"))
@dataclass(frozen=True)
class SelectionSettings(Settings):
    """Settings of the selection of a slow-fast model; `changed(name=value)` gives others.

    purpose: "prediction" scores by the errors over 50 ms, 200 ms and 1 s, and may average several models; "control"
        scores by 200 ms and 1 s, the lengths of a horizon and of a task, and takes one model, whose step is fast.
    scored: names of the outputs that matter; None: all.
    noise: m, standard deviation of the measurement noise in later use; the chart is then regressed on windows with
        that noise. 0: the noise of the recordings.
    coordinates: names of the output coordinates that are tried: "identity", "constant_curvature", or your own class as
        "module:Class"; None: all that suit the data.
    team: largest number of models that are averaged; 1 for control.
    refine: whether the best models are refined by Gauss-Newton steps on rollouts.
    symmetry: "find" looks in the data for turns of the outputs with a permutation of the inputs, and uses them; "none"
        uses none; a mapping states a known one, {"angle": 90, "axis": [0, 0, 1], "inputs": [...]}, see
        `ssmr_torch.symmetry_turns.stated`.
    minutes: CPU minutes after which no further specification is tried.

    Raises ValueError for a value out of range.
    """

    purpose: str = "prediction"
    scored: tuple[str, ...] | None = None
    noise: float = 0.0
    coordinates: tuple[str, ...] | None = None
    team: int = 4
    refine: bool = True
    symmetry: str | Mapping = "find"
    minutes: float = 2.0

    def __post_init__(self):
        for name, options in (("purpose", PURPOSES), ("symmetry", SYMMETRIES)):
            if name == "symmetry" and isinstance(self.symmetry, Mapping):
                continue
            if getattr(self, name) not in options:
                raise ValueError(f"{name} is {getattr(self, name)!r}; expected one of {options}")
        for name in ("scored", "coordinates"):
            value = getattr(self, name)
            self._set(name, None if value is None else (value,) if isinstance(value, str) else tuple(value))
        self._set("noise", non_negative("noise", self.noise, "m"))
        self._set("minutes", non_negative("minutes", self.minutes, "min"))
        self._set("team", whole("team", self.team, least=1))
