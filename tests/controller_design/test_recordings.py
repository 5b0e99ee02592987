"""Claims about recordings as a design sees them: what is held out, units, and how far commands are trusted."""

from dataclasses import replace

import numpy as np
import pytest
from conftest import DELAY, LAG
from oscillators import Actuators, H

from ssmr_torch.control.actuator import Actuator
from ssmr_torch.controller_design.recordings import held_out, recordings_of


@pytest.fixture(scope="module")
def recorded(robot, data):
    return recordings_of(data, (0, 1), robot.input_bounds)


def test_every_fourth_controlled_run_is_held_out_and_no_test_run_is_there(recorded, data):
    [held] = held_out(data)
    controlled = [run for run in data if run.kind == "controlled" and run.split == "train"]
    assert held.name == controlled[3].name and len(recorded.held) == 1
    assert len(recorded.train) == 3 + len(data.select(kind="decay"))
    assert recorded.minutes == pytest.approx(sum(run.length for run in data if run.split != "test") * H / 60)


def test_runs_for_validation_are_held_out_where_there_are_any(robot, data):
    runs = list(data)
    first = next(k for k, run in enumerate(runs) if run.kind == "controlled")
    runs[first] = replace(runs[first], split="validation")
    recorded = recordings_of(replace(data, trajectories=tuple(runs)), (0, 1), robot.input_bounds)
    np.testing.assert_array_equal(recorded.held[0].observation, runs[first].observation)
    assert len(recorded.held) == 1 and len(recorded.controlled) == 3


def test_the_reach_is_the_largest_displacement_of_the_tracked_outputs(recorded, data):
    assert recorded.reach == max(np.linalg.norm(run.observation[:, :2], axis=1).max()
                                 for run in data if run.split != "test")


def test_acting_inputs_are_those_of_the_robots_own_actuators(recorded):
    acted = recorded.under(Actuator(H, tuple(recorded.input_range.tolist()), delay=DELAY, lag=LAG))
    commands = recorded.held[0].input
    act = Actuators(recorded.bounds, commands[0], DELAY, LAG)
    np.testing.assert_allclose(acted.held[0].input, [act(command) for command in commands], rtol=0, atol=1e-12)
    np.testing.assert_array_equal(acted.held[0].observation, recorded.held[0].observation)
