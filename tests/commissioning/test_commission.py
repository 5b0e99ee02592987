"""The sequence: whole, declined, killed, stopped, and on robots with signed, pulling and biased inputs."""

import dataclasses
import json
import os
import signal

import numpy as np
import pytest

from ssmr_torch import command
from ssmr_torch.checksum import sealed_json
from ssmr_torch.closed_loop.record import ClosedLoopRecord
from ssmr_torch.commissioning.commission import STEPS
from ssmr_torch.commissioning.safety_guard import SafetyStop
from ssmr_torch.commissioning.steps import measure_steps
from ssmr_torch.trajectory import TrajectoryDataset

FILES = ("card.yaml", "noise.json", "noise.h5", "steps.json", "steps.h5", "trajectories.h5", "check.txt", "artifact",
         "design.txt", "slow_circle.h5", "fast_circle.h5", "commissioning.md", "progress.json")


def test_a_robot_goes_from_its_card_to_a_fast_circle_and_all_is_recorded(bring_up, robot, monkeypatch):
    monkeypatch.undo()  # the true check
    plant = robot(delay=2)
    assert bring_up(plant) == list(STEPS)
    assert {path.name for path in bring_up.directory.iterdir()} >= set(FILES)
    assert not list(bring_up.directory.rglob("*.part")) and not (bring_up.directory / "collected").exists()
    report = (bring_up.directory / "commissioning.md").read_text()
    assert "8 of 8 steps" in report and "| left |" in report and "RMSE" in report
    answers = json.loads((bring_up.directory / "steps.json").read_text())["answers"]
    assert [answer["delay_s"] for answer in answers] == pytest.approx([0.02, 0.02], abs=0.011)
    record = ClosedLoopRecord.load(bring_up.directory / "slow_circle.h5")
    assert np.sqrt((record.error ** 2).sum(axis=1).mean()) < 1e-3
    np.testing.assert_array_equal(plant.commands[-1], 0.0)
    # each step is shown with what comes next before it is confirmed
    assert [step for step, *_ in bring_up.seen] == list(STEPS)
    for (_, text, _), following in zip(bring_up.seen, STEPS[1:]):
        assert "Next step, " in text and "It stops beyond 50 mm" in text or following in ("check", "design")


def test_a_declined_step_is_measured_again_and_a_confirmed_step_is_not(bring_up, robot):
    plant = robot()
    assert bring_up(plant, lambda step, *_: step != "steps") == ["card", "noise"]
    before = (bring_up.directory / "noise.json").stat().st_mtime_ns
    bring_up.seen.clear()
    assert bring_up(plant) == list(STEPS)
    assert [step for step, *_ in bring_up.seen][:2] == ["noise", "steps"]  # the first asks before anything moves
    assert (bring_up.directory / "noise.json").stat().st_mtime_ns == before


def test_nothing_moves_when_the_person_does_not_want_to_continue(bring_up, robot):
    plant = robot()
    bring_up(plant, lambda step, *_: step != "steps")
    plant.commands.clear()
    assert bring_up(plant, lambda *_: False) == ["card", "noise"]
    assert plant.commands == []


def test_a_kill_during_the_recordings_loses_no_finished_run(bring_up, robot):
    class Killed(BaseException):
        pass

    plant, steps = robot(), robot.step

    def dies(input):
        if len(list(bring_up.directory.glob("collected/*/recorded/*.h5"))) == 3:
            raise Killed
        return steps(plant, input)

    plant.step = dies
    with pytest.raises(Killed):
        bring_up(plant)
    kept = {path: path.stat().st_mtime_ns for path in bring_up.directory.glob("collected/*/recorded/*.h5")}
    plant.step = lambda input: steps(plant, input)
    plant.commands.clear()
    assert bring_up(plant, lambda step, *_: step != "check") == list(STEPS[:4])
    assert len(kept) == 3 and len(plant.commands) < 1800  # of 2300 without what was kept
    assert len(TrajectoryDataset.load(bring_up.directory / "trajectories.h5")) == 6


def test_declined_recordings_are_set_aside_and_recorded_again(bring_up, robot):
    plant = robot()
    bring_up(plant, lambda step, *_: step != "collection")
    assert [path.name for path in bring_up.directory.glob("*trajectories.h5")] == ["declined-1-trajectories.h5"]
    assert bring_up(plant) == list(STEPS)


def test_a_stop_in_the_recordings_keeps_the_run_marked_and_goes_on_with_smaller_inputs(bring_up, robot, card):
    assert bring_up(robot(), card=card(rate_limit=0.16)) == list(STEPS)
    stop, = [text for step, text, _ in bring_up.seen if "75 % of the input range" in text and step == "collection"][:1]
    assert "rate_limit of 0.16 m/s" in stop
    kept = TrajectoryDataset.load(bring_up.directory / "stopped" / "collection-1.h5")
    assert "rate_limit" in kept.provenance["stopped"] and kept[0].name.endswith("stopped")
    np.testing.assert_array_equal(kept[0].read().input[-1], 0.0)
    data = TrajectoryDataset.load(bring_up.directory / "trajectories.h5")
    assert data.provenance["share"] < 1 and data.provenance["stops"][0]["kept"] == "collection-1.h5"
    bounds = []
    bring_up_again = bring_up.directory / "progress.json"
    entries = json.loads(bring_up_again.read_text())
    entries["confirmed"] = entries["confirmed"][:5]
    bring_up_again.write_text(sealed_json(entries))

    def design(kind, data, task, within):
        bounds.append(within)
        raise ValueError("enough")

    with pytest.raises(ValueError, match="enough"):
        bring_up(robot(), card=card(rate_limit=0.16), design=design)
    np.testing.assert_allclose(bounds[0], data.provenance["share"] * np.array([[-1, -1], [1, 1]]))


def test_a_diverging_loop_is_stopped_and_led_back_and_not_confirmed(bring_up, robot, card):
    class Wild:
        period = 0.01

        def reset(self):
            pass

        def __call__(self, time, observation):
            from ssmr_torch.control.base import Command
            return Command(np.array([1.0, 1.0]))

    plant = robot()
    limits = card(displacement_limit=0.022)
    with pytest.raises(SafetyStop, match="displacement_limit of 22 mm"):
        bring_up(plant, card=limits, controller=lambda *_: Wild())
    np.testing.assert_array_equal(plant.commands[-1], 0.0)
    assert np.abs(np.diff(plant.commands[-90:], axis=0)).max() < 0.011  # by a ramp of 1 s
    assert TrajectoryDataset.load(bring_up.directory / "stopped" / "slow_circle-1.h5").provenance["stopped"]
    assert json.loads((bring_up.directory / "progress.json").read_text())["confirmed"][-1]["step"] == "design"


@pytest.mark.parametrize("what", [{"bounds": (0.0, 1.0)}, {"bounds": (-1.0, 1.0)}, {"bounds": (-0.2, 1.0)}], ids=str)
def test_runs_begin_and_end_at_the_neutral_input_for_pulling_signed_and_mixed_inputs(bring_up, robot, what):
    plant = robot(**what)
    bring_up(plant, lambda step, *_: step != "collection")
    data = TrajectoryDataset.load(bring_up.directory / "declined-1-trajectories.h5")
    for decay in data.select(kind="decay"):
        np.testing.assert_array_equal(decay.read().input, 0.0)
    low, high = data.extremes()[1]
    assert (high > 0.2).all() and ((low < -0.05).all() if what["bounds"][0] else (low == 0).all())


def test_decays_end_and_all_steps_start_at_the_cards_neutral_input(bring_up, robot, card):
    plant = robot(bounds=(0.0, 1.0))
    bring_up(plant, lambda step, *_: step != "collection", card=card(neutral=[0.25, 0.1], settle=1.0))
    data = TrajectoryDataset.load(bring_up.directory / "declined-1-trajectories.h5")
    assert data.provenance["neutral_input"] == [0.25, 0.1]
    for decay in data.select(kind="decay"):
        np.testing.assert_array_equal(decay.read().input, np.tile([0.25, 0.1], (100, 1)))
    low, high = data.extremes()[1]
    assert (low < [0.2, 0.05]).all() and (high > [0.4, 0.3]).all()
    assert "from zero under the neutral input" in bring_up.seen[1][2][0]


def test_another_card_is_refused_in_the_same_directory_but_other_limits_are_not(bring_up, robot, card):
    bring_up(robot(), lambda step, *_: step != "steps")
    with pytest.raises(ValueError, match="neutral was .* now it is"):
        bring_up(robot(), card=card(neutral=[0.1, 0.0]))
    assert bring_up(robot(), lambda *_: False, card=card(displacement_limit=0.04)) == ["card", "noise"]


def test_recordings_that_no_commissioning_made_are_refused(bring_up, robot):
    bring_up(robot(), lambda step, *_: step != "collection")
    data = TrajectoryDataset.load(bring_up.directory / "declined-1-trajectories.h5")
    dataclasses.replace(data, provenance={"source": "simulation"}).save(bring_up.directory / "trajectories.h5")
    with pytest.raises(ValueError, match="comes from 'simulation'; expected the recordings of this commissioning"):
        bring_up(robot())


def test_yes_does_not_agree_to_swapped_channels(bring_up, robot, capsys, card, tmp_path):
    from ssmr_torch.commissioning.commission import commission

    done = commission(robot(((0, 1), (1, 0))), card(), tmp_path / "other", confirm="yes", rest_duration=1.0,
                      figures=False)
    assert done == ["card", "noise"]
    assert "left and right are swapped: left moves +y, right moves +x" in capsys.readouterr().out


def test_without_a_terminal_one_sentence_says_what_to_do(robot, card, tmp_path, monkeypatch):
    from ssmr_torch.commissioning.commission import commission

    def nobody(prompt):
        raise EOFError

    monkeypatch.setattr("builtins.input", nobody)
    with pytest.raises(ValueError, match="there is no terminal for the answer"):
        commission(robot(), card(), tmp_path / "other")


def test_a_guarded_robot_gives_the_same_observations_as_the_robot(robot, card):
    from ssmr_torch.commissioning.robot_card import fitted
    from ssmr_torch.commissioning.safety_guard import GuardedPlant

    plant = robot()
    left, right = measure_steps(GuardedPlant(plant, fitted(card(), plant)), np.full(3, 2e-5))
    assert left.output in ("x", "z") and right.output == "y" and left.loudness > 30


def test_a_terminated_run_leads_the_robot_back_to_its_neutral_input(bring_up, robot):
    class Terminated(robot):
        told = False

        def step(self, input):
            if len(self.commands) == 230 and not self.told:
                self.told = True
                os.kill(os.getpid(), signal.SIGTERM)
            return super().step(input)

    before, plant = signal.getsignal(signal.SIGTERM), Terminated()
    with pytest.raises(SystemExit):
        bring_up(plant)
    assert signal.getsignal(signal.SIGTERM) is before
    assert np.abs(plant.commands[229]).max() > 0 and np.abs(plant.commands[-1]).max() == 0
    assert len(plant.commands) > 320


def test_the_command_shows_each_step_and_says_how_to_go_on(tmp_path, monkeypatch, capsys):
    (tmp_path / "robot.yaml").write_text("displacement_limit: 0.05\nrate_limit: 2.0\nexpected: {cable_+x: -tip_x}\n")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("sys.argv", ["ssmr", "commission", "plant=slow_manifold", "card=robot.yaml", "confirm=yes",
                                     "settings.rest_duration=1", "hydra.run.dir=commissioning"])
    assert command.main() == 0
    said = capsys.readouterr().out
    assert "cable_+x is reversed: it moves +tip_x, expected -tip_x" in said
    assert "2 of 8 steps are confirmed; the same command with hydra.run.dir=" in said
    assert all((tmp_path / "commissioning" / name).is_file() for name in ("commissioning.md", "steps.svg"))
