"""The robots of designed.py: how each is recorded, what it draws, and what is changed about it afterwards."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from types import MappingProxyType

from ssmr_torch import configuration
from ssmr_torch.benchmarks.disturbed_plant import Disturbed
from ssmr_torch.benchmarks.planes import Plane, drawing, plane_of
from ssmr_torch.plants.base import Plant
from ssmr_torch.tasks.references import Task
from ssmr_torch.trajectory import TrajectoryDataset

SLOW, FAST = (10.0, 1.0), (2.5, 4.0)     # s a lap, laps
USUAL, FAR = 0.4, (0.7, 1.0)             # of the static reach
NOT_TOLD, TOLD = "not told", ("not told", "readjusted", "designed")


@dataclass(frozen=True)
class Condition:
    """overrides: of the configuration, beside the robot's own.   changes: of `Disturbed`.   told: the ways in which a
    controller may know of it.   note: what a reader must know.
    """

    name: str
    overrides: tuple[str, ...] = ()
    changes: Mapping = field(default_factory=dict, hash=False)
    told: tuple[str, ...] = (NOT_TOLD,)
    note: str = ""


NOMINAL = Condition("nominal")


@dataclass(frozen=True)
class Robot:
    """overrides: of conf/collect.yaml and conf/control.yaml: plant and rig.   conditions: see `Condition`."""

    name: str
    overrides: tuple[str, ...]
    conditions: tuple[Condition, ...]

    def plant(self, condition: Condition, rest=None) -> Plant:
        """The robot on its rig under a condition; rest (p,) m: origin of the displacements, that of the nominal one."""
        config = configuration.composed("collect", [*self.overrides, *condition.overrides])
        plant = configuration.built(config.rig)(configuration.built(config.plant))
        return plant if condition == NOMINAL else Disturbed(plant, rest=rest, **condition.changes)

    def record(self, plant: Plant) -> TrajectoryDataset:
        """Five minutes, in this process."""
        config = configuration.composed("collect", [*self.overrides, "excitation=five_minutes"])
        config.excitation.progress = False
        return configuration.built(config.excitation)(plant)

    def observed(self, data: TrajectoryDataset) -> TrajectoryDataset:
        """What the controller sees of it."""
        return data

    def plane(self, data: TrajectoryDataset) -> Plane:
        return plane_of(data)

    def tasks(self, plane: Plane) -> list[Task]:
        """Three shapes, slow and fast, within reach."""
        return self._drawn(plane, [USUAL])

    def far(self, plane: Plane) -> list[Task]:
        """The same, further than can be held at rest."""
        return self._drawn(plane, FAR)

    def _drawn(self, plane: Plane, shares: Sequence[float]) -> list[Task]:
        return [drawing(plane, shape, lap=lap, laps=laps, share=share) for share in shares
                for shape in ("circle", "eight", "letter") for lap, laps in (SLOW, FAST)]

    def operation(self, plane: Plane) -> Task:
        """13 s of fast motion, as by which a controller is readjusted."""
        return drawing(plane, "letter", lap=FAST[0], laps=FAST[1], share=USUAL)

    def disturbances(self) -> list[tuple[Condition, str]]:
        """Conditions, each with the ways in which a controller may know of it."""
        return [(condition, told) for condition in self.conditions for told in condition.told]


class EmulatedBench(Robot):
    """The diamond on the emulated bench, seen at its tip, under the tasks of conf/task."""

    OUTPUTS = ("tip_x", "tip_y", "tip_z")
    TASKS = ("slow_eight", "slow_circle", "stanford_obstacles")

    def observed(self, data: TrajectoryDataset) -> TrajectoryDataset:
        return data.observing(list(self.OUTPUTS))

    def tasks(self, plane: Plane) -> list[Task]:
        return [configuration.built(configuration.composed("control", [f"task={name}", "artifact=none"]).task)
                for name in self.TASKS]

    def far(self, plane: Plane) -> list[Task]:
        return []


def _foreign(name: str, noise: float, payload: Condition) -> Robot:
    conditions = (
        Condition("20 ms delay and 20 ms lag", changes={"delay": 0.02, "lag": 0.02}, told=TOLD),
        Condition("one input at 80 %", changes={"gain": 0.8}, told=TOLD),
        Condition("play of 5 %", changes={"play": 0.025}, told=TOLD, note="half of its width is 2.5 % of the range"),
        payload,
        Condition("outliers", changes={"outlier": 0.02}, note="20 mm in every output, once a second"),
        Condition("10 % missing", changes={"missing": 0.1}),
        Condition("noise × 3", overrides=(f"rig.noise_std={3 * noise:g}",)))
    return Robot(name, (f"plant={name}", f"rig.noise_std={noise:g}"), conditions)


def _loaded(kilograms: float, *, at: float | None = None) -> Condition:
    """A payload, and what the plant is told: that much at the tip, or, where it carries one anyway, `at` in all."""
    value = kilograms if at is None else at
    return Condition("payload", overrides=(f"plant.payload={value:g}",), note=f"{1e3 * kilograms:g} g more at the tip")


OFFSET = Condition("payload", changes={"offset": 0.05},
                   note="the plant has none: an offset of the first input by 5 % of its range in its place")

EMULATED_BENCH = EmulatedBench(
    "emulated_bench", ("plant=diamond", "rig=emulated_bench", "plant.young=157.5e3", "rig.outputs=[tip_x,tip_y,tip_z]"),
    (Condition("+ 20 ms delay", changes={"delay": 0.02}), Condition("+ 20 ms lag", changes={"lag": 0.02}),
     Condition("friction × 2", overrides=("rig.cable_friction=0.2",)),
     Condition("payload 20 g", overrides=("plant.payload=0.02",)),
     Condition("payload 50 g", overrides=("plant.payload=0.05",)),
     Condition("stiffness + 30 %", overrides=("plant.stiffness_scale=1.3",)),
     Condition("stiffness − 30 %", overrides=("plant.stiffness_scale=0.7",)),
     Condition("one cable at 70 %", changes={"gain": 0.7}),
     Condition("noise × 3", overrides=("rig.noise_std=1.5e-4",))))

ROBOTS: Mapping[str, Robot] = MappingProxyType({robot.name: robot for robot in (
    _foreign("tendon_chain", 3e-5, _loaded(0.003)), _foreign("cosserat_rod", 3e-5, _loaded(0.007)),
    _foreign("pressure_arm", 5e-5, OFFSET), _foreign("isupport", 3e-5, OFFSET),
    _foreign("planar_hsa", 3e-5, _loaded(0.05, at=0.55)), EMULATED_BENCH)})


def robot_named(name: str) -> Robot:
    """Raises KeyError for a name that is none."""
    return ROBOTS[name]
