"""A known robot with its card, a short excitation, and stand-ins for what takes long: design and a person."""

import json
import sys
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from ssmr_torch.collection.collect import ControlledRun, collect
from ssmr_torch.collection.excitation import Dithered, SmoothRandom
from ssmr_torch.commissioning.commission import commission
from ssmr_torch.commissioning.robot_card import RobotCard
from ssmr_torch.control.base import Command

sys.path.append(str(Path(__file__).parent))

from known_robot import A, B, C, KnownRobot  # noqa: E402

RUNS = (ControlledRun("smooth-train", Dithered(SmoothRandom(share=0.5)), 6.0, repeats=2),
        ControlledRun("smooth-test", SmoothRandom(share=0.5), 4.0, split="test"))
SHORT = partial(collect, decays=2, validation_decays=0, test_decays=1, decay_duration=1.0, controlled=RUNS,
                progress=False)


class Designed:
    """What a design gives, as far as it is saved and shown; `Loaded` is what of it is loaded."""

    report = "a report"

    def __init__(self, bounds, make):
        self.bounds, self.make = bounds, make

    def save(self, folder):
        Path(folder).mkdir(exist_ok=True)
        (Path(folder) / "card.json").write_text(json.dumps(self.bounds.tolist()))
        return Path(folder)


class Loaded:
    def __init__(self, folder, make):
        self.bounds, self.make = np.array(json.loads((Path(folder) / "card.json").read_text())), make

    def controller(self, task):
        return self.make(task, self.bounds)


class Inverse:
    """The input that would hold the reference at rest, of a robot whose gain is known."""

    period = 0.01

    def __init__(self, task, bounds):
        self.task, self.bounds = task, bounds
        self.gain = (-C @ np.linalg.solve(A, B))[list(task.columns(KnownRobot.output_names))]

    def reset(self):
        pass

    def __call__(self, time, observation):
        return Command(np.clip(np.linalg.solve(self.gain, self.task.reference(time)[0]), *self.bounds))


@pytest.fixture
def robot():
    return KnownRobot


@pytest.fixture
def card():
    """The card of the known robot, with changes."""
    return lambda **changes: RobotCard(**{"displacement_limit": 0.05, "rate_limit": 2.0, "tracked": ["x", "y"],
                                          "expected": {"left": "+x", "right": "+y"}} | changes)


class Checked:
    """What a check of recordings says where there is nothing to say; the true one takes seconds."""

    findings = ()


@pytest.fixture
def bring_up(tmp_path, card, monkeypatch):
    """commission(robot) with what is short, in a directory that stays the same; the steps shown are in `seen`."""
    monkeypatch.setattr("ssmr_torch.face.check", lambda data: Checked())

    def call(plant, confirm=None, **changes):
        def agree(step, text, faults):
            call.seen.append((step, text, list(faults)))
            return confirm(step, text, faults) if confirm else True

        make = changes.pop("controller", Inverse)
        settings = {"excitation": SHORT, "rest_duration": 1.0, "laps": 1, "slow_lap": 6.0, "fast_lap": 3.0,
                    "figures": False, "design": lambda kind, data, task, bounds: Designed(bounds, make),
                    "load": lambda folder: Loaded(folder, make)} | changes
        return commission(plant, settings.pop("card", card()), tmp_path / "commissioning", confirm=agree, **settings)

    call.seen, call.directory = [], tmp_path / "commissioning"
    return call
