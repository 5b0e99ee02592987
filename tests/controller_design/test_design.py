"""Claims about `ssmr.design`: what it tracks, that it repeats itself, its units, what it refuses, and its report."""

import json
from dataclasses import replace

import numpy as np
import pytest
from conftest import DELAY, LAG, OF_SENSOR
from oscillators import MIXED, PULL, SIGNED, H, Oscillators, recordings

import ssmr_torch as ssmr
from ssmr_torch.closed_loop.simulation import simulate
from ssmr_torch.control.actuator import Actuator
from ssmr_torch.control.mpc import ModelPredictiveController
from ssmr_torch.trajectory import Trajectory

KINDS = ("ssmr", "sssr", "dmd", "edmd_bilinear", "ssmr_control_augmented")


def tracking_rms(record, settled=1.0):
    return float(np.sqrt(np.square(record.error[record.time >= settled]).sum(1).mean()))


def known(bounds=SIGNED, scale=1.0):
    return Actuator(H, tuple((scale * np.ptp(bounds, axis=0)).tolist()), delay=DELAY, lag=LAG)


def test_the_designed_controller_tracks_within_the_noise_where_the_default_one_does_not(designed, robot, task):
    controller, report = designed
    record = simulate(robot, controller, task, seed=7)
    plain = ModelPredictiveController(controller.model, task, robot.input_bounds, period=H, timestep=H,
                                      output_names=robot.output_names)
    assert tracking_rms(record) < 5 * np.sqrt(2) * OF_SENSOR
    assert tracking_rms(simulate(robot, plain, task, seed=7)) > 5 * tracking_rms(record)
    assert not record.fallback.any()
    assert not controller.counts["gated"] and not controller.counts["restarted"]


def test_delay_and_lag_are_those_of_the_robot_and_the_predicted_error_is_that_of_the_loop(designed, robot, task):
    controller, report = designed
    actuator = controller.actuator.actuator
    assert (actuator.delay, actuator.lag, actuator.rubs, actuator.rate) == (DELAY, LAG, False, None)
    reached = tracking_rms(simulate(robot, controller, task, seed=3)) / report.recordings.reach
    assert 0.3 * reached < report.search.best.predicted < 3 * reached
    assert report.noises.sensor * report.recordings.reach == pytest.approx(OF_SENSOR, rel=0.25)


def test_the_result_unpacks_and_names_its_parts(designed):
    controller, report = designed
    assert designed.controller is controller and designed.report is report


def commands(controller, robot, task):
    return simulate(robot, controller, task, seed=5).input


def spoiled(data, value):
    """The dataset with test runs that hold nothing but this value."""
    return replace(data, trajectories=tuple(
        Trajectory(run.time, np.full_like(run.observation, value), np.full_like(run.input, value), run.kind, run.split,
                   run.name) if run.split == "test" else run for run in data))


def test_the_same_recordings_give_the_same_controller_to_the_last_bit_whatever_the_test_runs_hold(
        short_design, designed, robot, data, task):
    assert data.select("test")
    again = short_design(robot, spoiled(data, 1e9), task)
    assert {**again.report.facts, "seconds": 0} == {**designed.report.facts, "seconds": 0}
    for name in ("chart", "parametrization", "dynamics"):
        np.testing.assert_array_equal(getattr(again.controller.model, name), getattr(designed.controller.model, name))
    np.testing.assert_array_equal(commands(again.controller, robot, task), commands(designed.controller, robot, task))


def test_inputs_in_another_unit_give_the_same_commands_in_that_unit(short_design, designed, robot, data, task):
    scale = 0.02
    other = Oscillators(of_sensor=robot.of_sensor, of_inputs=0.002, delay=DELAY, lag=LAG, scale=scale)
    of_other = replace(data, trajectories=tuple(
        Trajectory(run.time, run.observation, scale * run.input, run.kind, run.split, run.name) for run in data))
    scaled = short_design(other, of_other, task)
    for asked in ("weights", "designs", "model"):
        assert scaled.report.facts[asked] == designed.report.facts[asked]
    np.testing.assert_allclose(commands(scaled.controller, other, task) / scale,
                               commands(designed.controller, robot, task), rtol=0, atol=1e-4)


@pytest.mark.parametrize("bounds", [PULL, MIXED], ids=["pull", "mixed"])
def test_robots_with_pulling_inputs_and_with_mixed_inputs_are_tracked_equally_well(short_design, task, bounds):
    robot = Oscillators(bounds, of_sensor=OF_SENSOR, of_inputs=0.002, delay=DELAY, lag=LAG, cubic=50.0)
    controller, _ = short_design(robot, recordings(robot, runs=4, seconds=12.0), task, identified=known(bounds))
    record = simulate(robot, controller, task, seed=2)
    assert tracking_rms(record) < 10 * np.sqrt(2) * OF_SENSOR and not record.fallback.any()
    assert (record.input >= bounds[0]).all() and (record.input <= bounds[1]).all()


def test_a_load_from_the_start_is_approached_and_tracked_without_steady_error(designed):
    """The robot hangs half of its reach away; after the approach of two seconds nothing of that is left."""
    controller, report = designed
    hangs = np.zeros(6)
    hangs[:2] = 0.5 * report.recordings.reach * np.array([0.6, -0.8])
    loaded = Oscillators(of_sensor=OF_SENSOR, of_inputs=0.002, delay=DELAY, lag=LAG, hangs=hangs)
    still = ssmr.tasks.path([0.0, 8.0], [[0.0, 0.0], [0.0, 0.0]], ["x", "y"])
    small = ssmr.tasks.circle(0.003, 2.0, laps=2, tracked=("x", "y"))
    for path in (small, still):
        record = simulate(loaded, controller.changed(path), path, seed=1)
        assert not record.fallback.any() and tracking_rms(record, 3.0) < 10 * OF_SENSOR
        assert np.linalg.norm(record.error[0]) == pytest.approx(0.5 * report.recordings.reach, rel=0.05)
    late = record.time > 4.0
    assert np.abs(record.error[late].mean(0)).max() < 2 * OF_SENSOR
    moved = np.linalg.norm(record.error, axis=1)
    assert moved[record.time < 0.5].min() > 0.2 * moved[0]     # at the pace of the approach, not at once


def test_a_known_actuator_is_used_without_change(short_design, robot, data, task):
    with pytest.raises(ValueError, match=r"the actuator has 3 inputs and steps of 0.02 s; expected 2 inputs and 0.02"):
        short_design(robot, data, task, identified=Actuator(H, (1.0, 1.0, 1.0)))
    with pytest.raises(ValueError, match=r"steps of 0.01 s; expected 2 inputs and 0.02 s"):
        short_design(robot, data, task, identified=Actuator(0.01, (2.0, 2.0)))


def only(data, keep, change=lambda run: run):
    return replace(data, trajectories=tuple(change(run) for run in data if keep(run)))


def test_data_that_are_not_a_dataset_are_refused(robot, task):
    with pytest.raises(TypeError, match="data is a list; expected a TrajectoryDataset"):
        ssmr.design("auto", [1, 2], task, robot.input_bounds)


def test_recordings_without_a_controlled_run_are_refused(robot, data, task):
    with pytest.raises(ValueError, match="the data have no controlled run to train on"):
        ssmr.design("auto", only(data, lambda run: run.kind == "decay"), task, robot.input_bounds)


def test_recordings_too_short_to_hold_any_out_are_refused_with_both_lengths(robot, data, task):
    def begun(run):
        return Trajectory(run.time[:100], run.observation[:100], run.input[:100], run.kind, run.split, run.name)

    with pytest.raises(ValueError, match=r"2 s of controlled runs can be held out; expected 3 s or more"):
        ssmr.design("auto", only(data, lambda run: True, begun), task, robot.input_bounds)


def test_an_input_that_never_moves_is_named(robot, data, task):
    def constant(run):
        return Trajectory(run.time, run.observation, run.input * [1.0, 0.0] + [0.0, 0.3], run.kind, run.split, run.name)

    with pytest.raises(ValueError, match="the inputs u2 never change in the controlled runs"):
        ssmr.design("auto", only(data, lambda run: True, constant), task, robot.input_bounds)


def test_bounds_in_another_unit_are_refused_with_both_ranges(robot, data, task):
    with pytest.raises(ValueError, match=r"recorded inputs u1, u2 go from .* outside of the bounds \[\[-0.02, -0.02\], "
                                         r"\[0.02, 0.02\]\]; give bounds in the unit of the recordings"):
        ssmr.design("auto", data, task, 0.02 * robot.input_bounds)


@pytest.mark.parametrize("bounds", [[[-1, -1, -1], [1, 1, 1]], [[-1, 1], [1, 1]], [[-1, -1], [1, np.inf]]], ids=str)
def test_impossible_bounds_are_refused_with_what_is_expected(robot, data, task, bounds):
    with pytest.raises(ValueError, match=r"bounds are .*; expected \(2, 2\) finite numbers"):
        ssmr.design("auto", data, task, bounds)


def test_a_task_that_tracks_an_unknown_output_is_refused_with_the_names(robot, data):
    task = ssmr.tasks.circle(0.01, tracked=("x", "elbow"))
    with pytest.raises(ValueError, match=r"tracks 'elbow'; the outputs are .*'rate_z'"):
        ssmr.design("auto", data, task, robot.input_bounds)


def test_the_report_says_in_words_and_in_plain_values_what_was_found(designed):
    report = designed.report
    text, facts = "\n".join(report.sentences), json.loads(json.dumps(report.facts, allow_nan=False))
    assert "delay 40 ms, lag 40 ms" in text and "The noise of the sensors is 0.0" in text
    assert facts["actuator"]["delay"] == DELAY and facts["designs"]["count"] >= facts["designs"]["safe"] > 0
    assert set(facts["against_twin"]) == set(report.search.best.against_twin)
    assert "delay 40 ms" in repr(report) and "against the twin" in repr(report)


def test_the_report_is_written_with_its_figures(designed, tmp_path):
    folder = designed.report.save(tmp_path / "design")
    pictures = {"actuator.png", "model.png", "innovations.png", "sensitivity.png", "twin.png"}
    assert {path.name for path in folder.iterdir()} == pictures | {"design.json", "design.md"}
    assert all((folder / name).read_bytes().startswith(b"\x89PNG") for name in pictures)
    text = (folder / "design.md").read_text()
    assert all(f"({name})" in text for name in pictures)
    assert json.loads((folder / "design.json").read_text())["task"] == "circle"


def test_a_report_without_figures_is_words_alone(designed, tmp_path):
    folder = designed.report.save(tmp_path, figures=False)
    assert {path.name for path in folder.iterdir()} == {"design.json", "design.md"}


def test_a_design_of_an_actuator_that_was_known_has_no_profile_of_it(designed, tmp_path):
    known_one = replace(designed.report, identification=replace(designed.report.identification, by_delay={}, by_lag={},
                                                                by_friction={}, error=np.nan, plain=np.nan))
    assert not (known_one.save(tmp_path) / "actuator.png").exists()
    assert json.loads((tmp_path / "design.json").read_text())["actuator_error"] is None


def test_obstacles_of_a_later_task_are_tightened_by_the_errors_on_the_held_out_runs(designed, task):
    obstacle = ssmr.tasks.obstacles.Circle((0.05, 0.05), 0.002)
    later = designed.controller.changed(replace(task, obstacles=(obstacle,)))
    margins = later.problem.constraints.margins
    assert margins.shape == (later.settings.horizon,) and (margins > 0).all() and (np.diff(margins) >= 0).all()


def test_a_model_that_does_not_tell_its_kind_is_refused_where_it_would_have_to_be_fitted_again(
        designed, robot, data, task, tmp_path):
    model = ssmr.load(designed.save(tmp_path / "artifact"))
    with pytest.raises(ValueError, match="its card does not tell its kind"):
        ssmr.design(model, data, task, robot.input_bounds, identified=known())


@pytest.mark.slow
def test_a_model_by_another_name_is_fitted_again_by_its_kind(short_design, robot, data, task):
    mine = ssmr.fit(data, "dmd", name="mine", progress=False)
    _, report = short_design(robot, data, task, model=mine, identified=known())
    assert report.model.words.startswith("DMD")


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_every_kind_of_model_can_be_designed_on(short_design, robot, data, task, kind):
    """Where the model predicts, the robot is tracked; where it does not, it is not lost either."""
    controller, report = short_design(robot, data, task, model=kind, identified=known())
    record = simulate(robot, controller, task, seed=4)
    allowed = 0.02 if report.model.error < 0.02 else 0.25
    assert not record.fallback.any() and tracking_rms(record) < allowed * report.recordings.reach
    assert report.model.words.lower().startswith(kind)


@pytest.mark.slow
def test_a_design_of_full_length_is_as_good_as_a_short_one(robot, data, task, designed):
    controller, _ = ssmr.design("auto", data, task, robot.input_bounds, progress=False)
    errors = [tracking_rms(simulate(robot, each, task, seed=7)) for each in (controller, designed.controller)]
    assert errors[0] < 1.5 * errors[1]
