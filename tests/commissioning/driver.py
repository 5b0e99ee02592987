"""Commissions the robot that connects, by a stand-in for the design: python driver.py ADDRESS DIRECTORY."""

import json
import sys
from functools import partial
from pathlib import Path

import numpy as np

from ssmr_torch.collection.collect import ControlledRun, collect
from ssmr_torch.collection.excitation import Dithered, SmoothRandom
from ssmr_torch.commissioning.commission import commission
from ssmr_torch.commissioning.robot_card import RobotCard
from ssmr_torch.control.base import Command
from ssmr_torch.plants.remote_robot import RemotePlant

RUNS = (ControlledRun("smooth-train", Dithered(SmoothRandom(share=0.5)), 6.0, repeats=3),
        ControlledRun("smooth-test", SmoothRandom(share=0.5), 4.0, split="test"))
SHORT = partial(collect, decays=4, validation_decays=0, test_decays=1, decay_duration=1.0, controlled=RUNS,
                progress=False)


class Gains:
    """Cables that only pull, each by what the steps have shown that it moves."""

    period = 0.01

    def __init__(self, task, directory, outputs):
        answers = json.loads((directory / "steps.json").read_text())["answers"]
        self.task, columns = task, list(task.columns(outputs))
        self.gains = np.array([np.array(answer["moved_m"])[columns] / answer["size"] for answer in answers])

    def reset(self):
        pass

    def __call__(self, time, observation):
        pulls = self.gains @ self.task.reference(time)[0] / (self.gains ** 2).sum(axis=1)
        return Command(np.maximum(pulls, 0.0))


class Designed:
    """What a design gives and, once saved, an artifact."""

    report = "gains"

    def __init__(self, directory, outputs):
        self.directory, self.outputs = directory, outputs

    def save(self, folder):
        folder.mkdir(exist_ok=True)
        return folder

    def controller(self, task):
        return Gains(task, self.directory, self.outputs)


def main(address, directory):
    plant = RemotePlant(address)
    done = commission(plant, RobotCard(displacement_limit=0.05, rate_limit=2.0, tracked=["tip_x", "tip_y"]), directory,
                      excitation=SHORT, confirm="yes", laps=1, rest_duration=2.0,
                      design=lambda kind, data, task, bounds: Designed(directory, data.output_names),
                      load=lambda folder: Designed(directory, plant.output_names))
    plant.close()
    print(len(done), "steps")


if __name__ == "__main__":
    main(sys.argv[1], Path(sys.argv[2]))
