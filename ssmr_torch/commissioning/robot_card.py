"""The robot card: what a robot may do, and what it must never do."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import numpy as np
from pydantic import AfterValidator, Field, FiniteFloat

from ssmr_torch.collection.excitation import neutral_input
from ssmr_torch.data.card_file import Card, not_as_described, read_card
from ssmr_torch.plants.base import Plant

PAGE = "docs/commissioning.md"
SETTLED = 3.0  # s under a neutral input that differs from the one at the robot's own rest
LIMITS = ("displacement_limit", "rate_limit", "blind_limit", "ramp")  # may change during a commissioning


def _two_or_none(outputs: list[str]) -> list[str]:
    if outputs and (len(outputs) != 2 or len(set(outputs)) != 2):
        raise not_as_described()
    return outputs


class RobotCard(Card):
    """What a person states about a robot before it moves. The fields are the keys of the YAML file, see
    docs/commissioning.md.

    displacement_limit: m, of every output.   rate_limit: m/s, of every output. Beyond one of them everything stops.
    blind_limit: s without a measurement, after which everything stops.   ramp: s, from any input back to the neutral
    one.
    name, outputs, inputs: the names that the robot must send; empty: any names.
    bounds: (2, m), within the bounds of the robot; None: the robot's.   neutral: (m,), the input under which the robot
    is left alone; None: the robot's own neutral input, or the admissible one nearest to zero.
    settle: s under the neutral input before a run; None: 0 where it is the input at the robot's own rest, else 3.
    tracked: two outputs in which the circles lie; empty: those that reach furthest to all sides.
    expected: input → output that it must move, with its sign, such as {left: +tip_x}; empty: as the names say, if they
    do.
    Raises ValueError for impossible numbers.
    """

    displacement_limit: FiniteFloat = Field(gt=0, description="a positive, finite number in m")
    rate_limit: FiniteFloat = Field(gt=0, description="a positive, finite number in m/s")
    name: str = Field("", description="text")
    outputs: list[str] = Field([], description="a list of names")
    inputs: list[str] = Field([], description="a list of names")
    bounds: list | None = Field(None, description="two rows of numbers, lowest and highest, one for each input")
    neutral: list | None = Field(None, description="a list of numbers, one for each input")
    tracked: Annotated[list[str], AfterValidator(_two_or_none)] = Field(
        [], description="two different outputs, or none")
    expected: dict[str, str] = Field({}, description="inputs with the signed output that each moves, as {left: +tip_x}")
    blind_limit: FiniteFloat = Field(0.25, gt=0, description="a positive, finite number in s")
    ramp: FiniteFloat = Field(1.0, ge=0, description="a finite number in s, 0 or more")
    settle: FiniteFloat | None = Field(None, ge=0, description="a finite number in s, 0 or more")

    @property
    def range(self) -> np.ndarray:
        """The bounds (2, m) as an array; only for a card from `fitted`."""
        return np.array(self.bounds, dtype=np.float64)

    @property
    def rest(self) -> np.ndarray:
        """The neutral input (m,) as an array; only for a card from `fitted`."""
        return np.array(self.neutral, dtype=np.float64)


def read_robot_card(path: str | Path) -> RobotCard:
    """The robot card in a YAML file. Raises as `card_file.read_card`."""
    return read_card(path, RobotCard, PAGE)


def fitted(card: RobotCard, plant: Plant) -> RobotCard:
    """The card, completed with the values of the robot.

    Raises ValueError where card and robot disagree: in names, in bounds wider than the robot's, in a neutral input out
    of bounds, and in tracked or expected outputs that do not exist.
    """
    for what, said, has in (("name", card.name and [card.name], [plant.name]),
                            ("outputs", card.outputs, plant.output_names), ("inputs", card.inputs, plant.input_names)):
        if said and list(said) != list(has):
            raise ValueError(f"the card has the {what} {list(said)}, but the robot has {list(has)}; expected the same, "
                             "in this order: correct the card, or start the right robot")
    bounds = _bounds(card, plant)
    neutral = _neutral(card, plant, bounds)
    away = np.abs(neutral - neutral_input(plant)).max() > 0
    settle = card.settle if card.settle is not None else SETTLED if away else 0.0
    _refuse_unknown("tracked", card.tracked, plant.output_names)
    _refuse_unknown("expected, its keys,", card.expected, plant.input_names)
    for value in card.expected.values():
        if not isinstance(value, str) or value[:1] not in ("+", "-"):
            raise ValueError(f"expected names the output {value!r}; it needs a sign, such as +{plant.output_names[0]}")
    _refuse_unknown("expected, its outputs,", [value[1:] for value in card.expected.values()], plant.output_names)
    return card.changed(name=plant.name, outputs=list(plant.output_names), inputs=list(plant.input_names),
                        bounds=bounds.tolist(), neutral=neutral.tolist(), settle=float(settle))


def changed_keys(before: RobotCard, now: RobotCard) -> list[str]:
    """The entries in which two fitted cards differ, without the limits: they decide what was measured."""
    one, other = before.model_dump(), now.model_dump()
    return [f"{key} was {one[key]}, now it is {other[key]}" for key in one
            if key not in LIMITS and one[key] != other[key]]


def _bounds(card: RobotCard, plant: Plant) -> np.ndarray:
    own = np.asarray(plant.input_bounds, dtype=np.float64)
    if card.bounds is None:
        return own
    bounds = _array("bounds", card.bounds, own.shape, f"two rows of {own.shape[1]} numbers, lowest and highest")
    if not (bounds[0] < bounds[1]).all() or (bounds[0] < own[0]).any() or (bounds[1] > own[1]).any():
        raise ValueError(f"the card's bounds are {bounds.tolist()}; expected the lowest below the highest, within "
                         f"those of the robot, {own.tolist()}")
    return bounds


def _neutral(card: RobotCard, plant: Plant, bounds: np.ndarray) -> np.ndarray:
    if card.neutral is None:
        return np.clip(neutral_input(plant), bounds[0], bounds[1])
    neutral = _array("neutral", card.neutral, bounds[0].shape, f"{bounds.shape[1]} numbers, one for each input")
    if not ((bounds[0] <= neutral) & (neutral <= bounds[1])).all():
        raise ValueError(f"the neutral input is {neutral.tolist()}; expected numbers between {bounds[0].tolist()} and "
                         f"{bounds[1].tolist()}")
    return neutral


def _array(key: str, values, shape: tuple, expected: str) -> np.ndarray:
    try:
        array = np.array(values, dtype=np.float64)
    except (TypeError, ValueError):
        array = np.empty(0)
    if array.shape != shape or not np.isfinite(array).all():
        raise ValueError(f"the card's {key} is {values!r}; expected {expected}")
    return array


def _refuse_unknown(key: str, given: Sequence, known: Sequence[str]) -> None:
    unknown = [name for name in given if name not in known]
    if unknown:
        raise ValueError(f"{key} names {unknown}; the robot has {list(known)}")
