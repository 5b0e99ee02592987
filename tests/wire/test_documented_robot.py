"""The robot of docs/wire.md: it applies no old command, whatever pauses."""

import json
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from wire.one_clock import SAFE, SPAN, Telling

from ssmr_torch.wire.controller_end import ControllerEnd
from ssmr_torch.wire.link import ControllerLink
from ssmr_torch.wire.messages import RobotDescription
from ssmr_torch.wire.serving import serve

T = 0.02  # s, slow enough for a machine with other work
LISTING = (Path(__file__).parents[2] / "docs" / "wire.md").read_text().split("```python\n")[1].split("```")[0]


class Sleepy(Telling):
    """A controller that sleeps once, at one of its samples."""

    period = T

    def __init__(self, at, seconds):
        self.at, self.seconds = at, seconds
        super().__init__()

    def __call__(self, now, observation):
        if self.seconds and round(now / T) >= self.at and np.isfinite(observation).all():
            time.sleep(self.seconds)
            self.seconds = 0.0
        return super().__call__(now, observation)


@pytest.mark.parametrize("seconds", [0.1, pytest.param(0.7, marks=pytest.mark.slow)])
@pytest.mark.parametrize("whose", ["measure", "apply", "controller"])
def test_the_documented_robot_applies_no_old_command_after_a_pause(integrator, background, whose, seconds):
    left, applied, measured = {"measure": 0.0, "apply": 0.0} | {whose: seconds}, [], [0]
    begun = time.monotonic()

    def pause(where):
        if measured[0] == 15 and left[where]:
            time.sleep(left[where])
            left[where] = 0.0

    def measure():
        measured[0] += 1
        pause("measure")
        return np.array([0.0, time.monotonic() - begun])

    def apply(u):
        applied.append((time.monotonic() - begun, tuple(u)))
        pause("apply")

    robot = replace(RobotDescription.of(integrator), timestep=T, real_time=True)
    controller = Sleepy(15, seconds if whose == "controller" else 0.0)
    end = ControllerEnd(lambda robot: controller, duration=40 * T + seconds)
    with ControllerLink("tcp://127.0.0.1:*") as link:
        code = LISTING.replace("tcp://127.0.0.1:5555", link.endpoint).replace("poll(1000)", f"poll({500 * T:.0f})")
        names = {"DESCRIPTION": json.loads(robot.text), "TIMESTEP": T, "SAFE_INPUT": SAFE, "measure": measure,
                 "apply": apply}
        other = background(exec, code, names)
        serve(link, end, runs=1)
        other.join()
    names["socket"].close(0)
    ages = [when - u[1] * SPAN for when, u in applied if u != SAFE and u[0] == 0.6]
    assert len(ages) > 10 and max(ages) < T + 5e-3, "no command is older than a timestep"
    assert all(0.1 <= u[0] <= 1.0 and 0.0 <= u[1] <= 1.0 for _, u in applied) and applied[-1][1] == SAFE
    assert end.finished == 1 and any(u[0] == 0.6 for _, u in applied[-8:]), "the run goes on"
