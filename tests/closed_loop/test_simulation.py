"""Claims about closed-loop simulation and its record, on a plant whose answer is known."""

import h5py
import numpy as np
import pytest

from ssmr_torch import checksum
from ssmr_torch.closed_loop.record import ClosedLoopRecord
from ssmr_torch.closed_loop.simulation import simulate
from ssmr_torch.control.base import Command
from ssmr_torch.control.mpc import ModelPredictiveController
from ssmr_torch.models.named_structures import spectral_submanifold
from ssmr_torch.plants.emulated_rig import Rig
from ssmr_torch.status import Status
from ssmr_torch.tasks.references import Task


def integrator(gain=1.0):
    """dz/dt = gain u on the output itself; of a window with one delay the newest sample counts."""
    return spectral_submanifold(
        chart=np.hstack([np.zeros((2, 2)), np.eye(2)]), parametrization=np.vstack([np.eye(2)] * 2),
        drift=np.zeros((2, 2)), control=gain * np.eye(2), state_scale=np.full(2, 0.1), chart_degree=1,
        parametrization_degree=1, dynamics_degree=1, control_degree=0, input_dim=2, output_dim=2, delays=1,
        timestep=0.01, window_timestep=0.01, substeps=1)


class Plant:
    """y⁺ = y + gain · timestep · u."""

    name, timestep, input_unit = "integrator", 0.01, "N"
    input_bounds = np.array([[-1.0, -1.0], [1.0, 1.0]])
    output_names, input_names, rest = ("x", "y"), ("left", "right"), np.zeros(2)

    def __init__(self, gain=1.0):
        self.model = integrator(gain)
        self.received = []
        self.reset()

    def reset(self, seed=None, state=None):
        self.state = np.zeros(2) if state is None else np.array(state)
        self.received.clear()
        return self.state

    @property
    def displacement(self):
        return self.state

    def step(self, input):
        self.received.append(input.copy())
        self.state = self.model.step(self.state, np.clip(input, *self.input_bounds))
        return self.state


class Proportional:
    """u = 2 (reference − measurement), with a fallback at one sample."""

    period = 0.01

    def __init__(self, task):
        self.task, self.times = task, []

    def reset(self):
        self.times = []

    def __call__(self, time, observation):
        self.times.append(time)
        u = 2.0 * (self.task.reference(time)[0] - observation)
        return Command(u, fallback=Status.OUT_OF_RANGE if len(self.times) == 4 else None)


TASK = Task("set point", 0.5, ("x", "y"), lambda time: np.tile([0.02, -0.01], (len(time), 1)))


def test_the_loop_closes_with_the_known_convergence_rate():
    """u = 2 e on an integrator: e decays by 1 − 2 · 0.01 per sample."""
    plant, controller = Plant(), Proportional(TASK)
    record = simulate(plant, controller, TASK)
    decay = (1 - 0.02) ** np.arange(51)
    np.testing.assert_allclose(record.error, -decay[:, None] * [[0.02, -0.01]], rtol=0, atol=1e-15)
    np.testing.assert_array_equal(controller.times, record.time)
    np.testing.assert_array_equal(plant.received, record.input[:-1])


def test_an_observation_is_recorded_before_its_input_acts():
    record = simulate(Plant(), Proportional(TASK), TASK)
    np.testing.assert_allclose(np.diff(record.observation, axis=0), 0.01 * record.input[:-1], atol=1e-15)


def test_fallbacks_and_their_reasons_are_recorded():
    record = simulate(Plant(), Proportional(TASK), TASK)
    assert np.flatnonzero(record.fallback).tolist() == [3]
    assert record.statuses[3] == "OUT_OF_RANGE" and set(record.statuses) == {"", "OUT_OF_RANGE"}


def test_noise_reaches_the_controller_and_not_the_recorded_position_and_is_fixed_by_the_seed():
    records = [simulate(Plant(), Proportional(TASK), TASK, seed=seed, noise_std=1e-3) for seed in (0, 0, 1)]
    noise = records[0].measurement - records[0].observation
    assert noise.std() == pytest.approx(1e-3, rel=0.2)
    np.testing.assert_array_equal(records[0].observation, records[1].observation)
    assert np.abs(records[0].observation - records[2].observation).max() > 0
    moved = np.diff(records[0].observation, axis=0)
    np.testing.assert_allclose(moved, 0.01 * records[0].input[:-1], rtol=0, atol=1e-15)


def test_a_record_holds_the_true_position_beside_the_late_measurement():
    plant, controller = Rig(Plant(), sensor_delay=0.03), Proportional(TASK)
    record = simulate(plant, controller, TASK)
    np.testing.assert_array_equal(record.measurement[3:], record.observation[:-3])
    np.testing.assert_array_equal(record.measurement[:3], 0.0)
    np.testing.assert_allclose(record.input, 2.0 * (record.reference - record.measurement), rtol=0, atol=1e-15)
    np.testing.assert_allclose(np.diff(record.observation, axis=0), 0.01 * record.input[:-1], rtol=0, atol=1e-15)
    assert record.provenance["plant"] == "integrator on a rig"


def test_the_noise_of_the_rig_and_of_the_simulation_add_up_and_are_independent():
    task = Task("long", 20.0, ("x", "y"), TASK.reference)
    record = simulate(Rig(Plant(), noise_std=1e-3), Proportional(task), task, noise_std=1e-3)
    noise = record.measurement - record.observation
    assert noise.std() == pytest.approx(np.sqrt(2) * 1e-3, abs=4 * np.sqrt(2) * 1e-3 / np.sqrt(2 * noise.size))


def test_commands_are_recorded_as_given_and_not_as_the_actuators_apply_them():
    plant = Rig(Plant(), actuator_lag=0.05, rate_limit=0.3)
    record = simulate(plant, Proportional(TASK), TASK)
    np.testing.assert_allclose(record.input, -2.0 * record.error, rtol=0, atol=1e-15)
    np.testing.assert_array_equal(np.diff(record.observation, axis=0)[0], 0.01 * plant.plant.received[0])
    assert np.abs(plant.plant.received[0]).max() <= 0.3 * 0.01 * (1 - np.exp(-0.2)) + 1e-15


def test_a_missing_sample_is_recorded_and_makes_the_controller_fall_back():
    plant = Rig(Plant(), drop_probability=0.05, dropped="missing")
    controller = ModelPredictiveController(integrator(), TASK, Plant.input_bounds, output_names=Plant.output_names)
    record = simulate(plant, controller, TASK)
    missing = np.isnan(record.measurement).any(axis=1)
    planned = ~np.isnan(record.solve_time)
    assert missing.any() and np.isfinite(record.observation).all()
    np.testing.assert_array_equal(record.fallback[planned], missing[planned])  # not for what the window still holds
    assert {record.statuses[k] for k in np.flatnonzero(record.fallback)} == {"NOT_FINITE"}


def test_model_predictive_control_reaches_the_set_point_of_a_mismatched_plant():
    task = Task("set point", 1.0, ("y",), lambda time: np.full((len(time), 1), 0.02))
    controller = ModelPredictiveController(integrator(), task, Plant.input_bounds,
                                           output_names=Plant.output_names)
    record = simulate(Plant(gain=0.9), controller, task)
    assert record.tracked == (1,)
    assert abs(record.error[-1, 0]) < 1e-5
    np.testing.assert_allclose(record.observation[:, 0], 0.0, atol=1e-12)
    held = np.isnan(record.solve_time)
    np.testing.assert_array_equal(held, np.arange(101) % 2 == 1)
    assert (record.iterations[~held] >= 1).all() and (record.iterations[held] == 0).all()
    assert {status for status, h in zip(record.statuses, held) if not h} <= {"SOLVED", "ITERATION_LIMIT"}


def test_a_record_is_the_same_after_saving_and_loading(tmp_path):
    record = simulate(Plant(), Proportional(TASK), TASK, noise_std=1e-4, provenance={"commit": "abc"})
    loaded = ClosedLoopRecord.load(record.save(tmp_path / "deep" / "run.h5"))
    for name, value in vars(record).items():
        if isinstance(value, np.ndarray):
            np.testing.assert_array_equal(getattr(loaded, name), value)
        else:
            assert getattr(loaded, name) == value
    assert loaded.provenance["commit"] == "abc" and loaded.provenance["task"] == "set point"
    assert loaded.provenance["plant"] == "integrator"
    assert [path.name for path in (tmp_path / "deep").iterdir()] == ["run.h5"]


def test_another_file_is_refused(tmp_path):
    with pytest.raises(FileNotFoundError, match="no closed-loop record"):
        ClosedLoopRecord.load(tmp_path / "none.h5")
    with h5py.File(tmp_path / "other.h5", "w") as file:
        file["time"] = [0.0]
    with pytest.raises(ValueError, match="format None"):
        ClosedLoopRecord.load(tmp_path / "other.h5")


def test_a_record_without_its_checksum_is_refused_and_one_of_an_earlier_version_is_read(tmp_path, caplog):
    record = simulate(Plant(), Proportional(TASK), TASK)
    path = record.save(tmp_path / "run.h5")
    path.write_bytes(path.read_bytes()[:-checksum.LENGTH])
    with pytest.raises(checksum.Damaged, match="has a checksum, which is missing"):
        ClosedLoopRecord.load(path)
    with h5py.File(path, "a") as file:
        file.attrs["card"] = file.attrs["card"].replace("closed loop 2", "closed loop 1")
        del file["violation"]  # as records of version 0.8 were
    np.testing.assert_array_equal(ClosedLoopRecord.load(path).observation, record.observation)
    assert f"{path} carries no checksum" in caplog.text
    for change, says in ((lambda file: file["time"].__setitem__(3, np.nan), "time is not finite"),
                         (lambda file: file["time"].__setitem__(3, 0.0), "time does not increase"),
                         (lambda file: file.pop("input"), "input"),
                         (lambda file: file.__setitem__("input", h5py.ExternalLink("a.h5", "u")), "another file")):
        with h5py.File(path, "a") as file:
            kept = file["time"][:]
            change(file)
        with pytest.raises(ValueError, match=says):
            ClosedLoopRecord.load(path)
        with h5py.File(path, "a") as file:
            file["time"][:] = kept


@pytest.mark.parametrize("which", ["plant", "controller", "task"])
def test_a_wrong_plant_controller_or_task_is_refused_with_the_missing_attributes(which):
    given = {"plant": Plant(), "controller": Proportional(TASK), "task": TASK} | {which: "trunk"}
    with pytest.raises(TypeError, match=f"the {which} is a str, which has no .*; expected a {which}"):
        simulate(*given.values())


def test_a_control_period_that_is_no_multiple_of_the_timestep_is_refused():
    controller = Proportional(TASK)
    controller.period = 0.015
    with pytest.raises(ValueError, match="0.015 s, which is 1.5 times the plant's timestep, 0.01 s"):
        simulate(Plant(), controller, TASK)
    with pytest.raises(ValueError, match="noise_std"):
        simulate(Plant(), Proportional(TASK), TASK, noise_std=-1.0)
