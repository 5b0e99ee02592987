"""TPWL against the finite-element robot that it linearizes: a small arm of silicone."""

from functools import partial
from itertools import permutations
from types import SimpleNamespace

import lightning
import numpy as np
import pytest
import torch

from ssmr_torch.collection.collect import ControlledRun, collect
from ssmr_torch.collection.excitation import SmoothRandom
from ssmr_torch.data.datamodule import TrajectoryDataModule
from ssmr_torch.data.windows import SegmentDataset
from ssmr_torch.fitting import plant_replay as replay
from ssmr_torch.fitting.plant_replay import Projection, linearized_step
from ssmr_torch.fitting.tpwl import PlantLinearization, TPWLFit, check_plant, proper_orthogonal_modes
from ssmr_torch.fitting.training import load_model, train
from ssmr_torch.models.tpwl import TPWL
from ssmr_torch.plants.finite_element.cables import Cables
from ssmr_torch.plants.finite_element.mesh import TetrahedralMesh
from ssmr_torch.plants.finite_element.robot import FiniteElementRobot
from ssmr_torch.plants.finite_element.structure import Mechanics
from ssmr_torch.plants.slow_manifold import SlowManifold
from ssmr_torch.trajectory import Trajectory, TrajectoryDataset

TRAINER = partial(lightning.Trainer, accelerator="cpu", devices=1, use_distributed_sampler=False,
                  enable_model_summary=False, enable_progress_bar=False)
MODULE = partial(TrajectoryDataModule, transient=0.0, validation_share=0.1, rows=64, validation_horizon=0.1, starts=20)
QUIET = {"progress": False}

pytestmark = pytest.mark.filterwarnings("ignore::UserWarning:lightning", "ignore:.*LeafSpec")


def arm(law="corotational", scheme="backward_euler", timestep=0.01):
    """A square arm of 20 nodes, 60 mm long, clamped at its base; two cables along its sides."""
    corners = np.array([[x, y, z] for z in range(5) for y in range(2) for x in range(2)])
    number = {tuple(corner): index for index, corner in enumerate(corners)}
    tetrahedra = []
    for z in range(4):
        for axes in permutations(range(3)):
            path = np.vstack([[0, 0, z], np.cumsum(np.eye(3, dtype=int)[list(axes)], axis=0) + [0, 0, z]])
            nodes = [number[tuple(corner)] for corner in path]
            odd = np.linalg.det(np.eye(3)[list(axes)]) < 0
            tetrahedra.append([nodes[1], nodes[0], *nodes[2:]] if odd else nodes)
    mesh = TetrahedralMesh((corners - [0.5, 0.5, 0]) * [0.02, 0.02, 0.015], np.array(tetrahedra))
    heights = np.linspace(0.01, 0.06, 4)
    cables = Cables(mesh, [[0.008, 0.0, -0.01], [0.0, 0.008, -0.01]],
                    [np.column_stack([np.tile(side, (4, 1)), heights]) for side in ([0.008, 0.0], [0.0, 0.008])])
    silicone = Mechanics(young=60e3, poisson=0.45, mass=0.03, mass_damping=1.0, stiffness_damping=0.01,
                         gravity=(0.0, 0.0, -9.81), law=law)
    return FiniteElementRobot("arm", mesh, cables, silicone, np.arange(4), {"tip": 16, "middle": 8}, ("+x", "+y"),
                              (0.0, 1.0), timestep, scheme, "superlu")


@pytest.fixture(scope="module")
def plant():
    return arm()


@pytest.fixture(scope="module")
def dataset(plant):
    """One second of training, half a second of validation and test, and a decay."""
    runs = [ControlledRun(split, SmoothRandom(0.2), duration, split=split)
            for split, duration in (("train", 1.0), ("validation", 0.5), ("test", 0.5))]
    return collect(plant, decays=1, validation_decays=0, test_decays=0, decay_duration=0.5, controlled=runs,
                   progress=False)


def full_state(plant, displacement, velocity):
    sparsity = plant.structure.sparsity
    positions = sparsity.scatter(sparsity.gather(plant.resting) + displacement, plant.resting)
    return np.concatenate([positions.ravel(), velocity])


def moved(plant):
    """Displacement and velocity (N,) of the free degrees of freedom, now."""
    sparsity = plant.structure.sparsity
    return sparsity.gather(plant.positions - plant.resting), plant.state[plant.positions.size:][:sparsity.size]


def replayed(plant, dataset, **options):
    """The procedure after the training run, without a trainer."""
    runs = dataset.select("train")
    procedure = PlantLinearization(plant, **QUIET | options)
    procedure.begin(plant.output_names)
    for segment in SegmentDataset(runs, before=0, after=0, rows=64):
        procedure.note(segment)
    return procedure


def as_model(plant, tables, **options):
    model = TPWL(2, 6, timestep=plant.timestep, **options)
    fit = TPWLFit(model)
    fit._take(dict(tables))
    return model


def test_at_its_point_the_linearized_step_is_the_plants_step_whatever_velocity_and_input(plant):
    rng = np.random.default_rng(0)
    size = plant.structure.sparsity.size
    plant.settle([0.6, 0.2])
    displacement = moved(plant)[0]
    A, B, c = linearized_step(plant, Projection.of(plant, displacement, np.array([0.6, 0.2]), np.eye(size)))
    for _ in range(3):
        velocity, u = 0.05 * rng.normal(size=size), rng.uniform(0, 1, 2)
        plant.reset(state=full_state(plant, displacement, velocity))
        plant.step(u)
        expected = np.concatenate(moved(plant))
        np.testing.assert_allclose(A @ np.concatenate([displacement, velocity]) + B @ u + c, expected, rtol=0,
                                   atol=1e-11 * np.abs(expected).max())


def test_at_an_equilibrium_the_linearized_step_is_the_derivative_of_the_plants_step(plant):
    u = np.array([0.7, 0.3])
    plant.settle(u)
    displacement = moved(plant)[0]
    size = len(displacement)
    A, B, _ = linearized_step(plant, Projection.of(plant, displacement, u, np.eye(size)))

    def step(x, input):
        plant.reset(state=full_state(plant, x[:size], x[size:]))
        plant.step(input)
        return np.concatenate(moved(plant))

    x, e = np.concatenate([displacement, np.zeros(size)]), 1e-6
    for j in np.random.default_rng(1).choice(2 * size, 12, replace=False):
        direction = e * np.eye(2 * size)[j]
        difference = (step(x + direction, u) - step(x - direction, u)) / (2 * e)
        np.testing.assert_allclose(A[:, j], difference, rtol=0, atol=1e-6 * np.abs(difference).max())
    for j in range(2):
        difference = (step(x, u + e * np.eye(2)[j]) - step(x, u - e * np.eye(2)[j])) / (2 * e)
        np.testing.assert_allclose(B[:, j], difference, rtol=0, atol=1e-6 * np.abs(difference).max())


@pytest.mark.parametrize(("law", "scheme"), [("corotational", "backward_euler"),
                                             ("neo_hookean", "generalized_alpha")])
def test_at_rest_the_full_map_has_the_plants_slowest_eigenvalues(law, scheme):
    plant = arm(law, scheme)
    size = plant.structure.sparsity.size
    A, _, _ = linearized_step(plant, Projection.of(plant, np.zeros(size), np.zeros(2), np.eye(size)))
    found = np.log(np.linalg.eigvals(A).astype(complex)) / plant.timestep
    for expected in plant.eigenvalues[:6]:
        assert np.abs(found - expected).min() < 1e-6 * np.abs(expected)


def test_in_any_basis_an_equilibrium_of_the_plant_is_one_of_its_linearized_step(plant):
    u = np.array([0.4, 0.9])
    plant.settle(u)
    displacement = moved(plant)[0]
    basis = np.linalg.qr(np.random.default_rng(2).normal(size=(len(displacement), 3))).Q
    A, B, c = linearized_step(plant, Projection.of(plant, displacement, u, basis))
    z = np.concatenate([basis.T @ displacement, np.zeros(3)])
    np.testing.assert_allclose(A @ z + B @ u + c, z, rtol=0, atol=1e-9 * np.abs(z).max())


def test_the_modes_are_orthonormal_and_as_many_as_the_variance_asks_for():
    rng = np.random.default_rng(3)
    left, right = np.linalg.qr(rng.normal(size=(30, 4))).Q, np.linalg.qr(rng.normal(size=(12, 4))).Q
    snapshots = left @ np.diag([10.0, 3.0, 1.0, 0.1]) @ right.T
    decomposition = np.linalg.svd(snapshots, full_matrices=False)[1:]
    for rule, size in ((2, 2), ("variance:0.9", 1), ("variance:0.95", 2), ("variance:0.999", 3),
                       ("variance:0.99995", 4)):
        basis, captured = proper_orthogonal_modes(*decomposition, rule)
        assert basis.shape == (12, size)
        np.testing.assert_allclose(basis.T @ basis, np.eye(size), atol=1e-13)
        np.testing.assert_allclose(basis @ (basis.T @ right[:, :size]), right[:, :size], atol=1e-12)
        np.testing.assert_allclose(captured[:3], np.cumsum([100, 9, 1]) / 110.01, rtol=1e-12)
    with pytest.raises(ValueError, match="modes is 5, but the snapshots span only 4 directions"):
        proper_orthogonal_modes(*decomposition, 5)


@pytest.mark.parametrize(("modes", "error"), [(8, 1e-3), (25, 1e-6), (46, 1e-9)])
def test_with_a_point_at_every_snapshot_the_training_run_is_replayed_up_to_the_modes(plant, dataset, modes, error):
    procedure = replayed(plant, dataset, tolerance=0.0, points=100, modes=modes)
    model = as_model(plant, procedure.tables())
    run = dataset.select("train", "controlled")[0]
    outputs = model.decode(model.rollout(torch.zeros(model.state_dim, dtype=torch.float64),
                                         torch.from_numpy(run.input.copy())).states).detach().numpy()[:-1]
    assert model.count == 100 and procedure.replay_error < 1e-10
    assert np.abs(outputs - run.observation).max() < error * np.abs(run.observation).max()


def test_each_point_is_where_the_model_before_it_was_worst_and_the_errors_fall(plant, dataset):
    few, many = (replayed(plant, dataset, modes=8, points=points).tables() for points in (5, 40))
    np.testing.assert_allclose(many["points"][:5], few["points"], atol=1e-15)
    assert np.trace(many["process"]) < 0.3 * np.trace(few["process"])
    stopped = replayed(plant, dataset, modes=8, points=100, tolerance=0.2).tables()
    assert len(stopped["points"]) < 20


def test_memory_is_bounded_by_the_snapshots_asked_for(plant, dataset):
    run = dataset.select("train", "controlled")[0].read()
    found = replay.Replay(plant, [run.input], 30)
    assert found.snapshots.displacement.shape == (25, plant.structure.sparsity.size)
    assert replayed(plant, dataset, snapshots=30, points=10, modes=5).tables()["C"].shape == (6, 10)
    np.testing.assert_allclose(found.outputs, run.observation, rtol=0, atol=1e-12)


def test_the_outputs_are_the_plants_and_the_filter_expects_what_the_modes_cannot_show(plant, dataset):
    procedure = replayed(plant, dataset, modes=8, points=20, measurement_noise=1e-4)
    tables = procedure.tables()
    snapshots = replay.Replay(plant, [dataset.select("train", "controlled")[0].input], 1200).snapshots
    z = np.concatenate([procedure.basis.T @ snapshots.displacement[40], np.zeros(8)])
    seen, unseen = tables["C"] @ z + tables["d"], np.sqrt(np.diag(tables["measurement"]))
    assert (unseen >= 1e-4).all() and (np.abs(seen - snapshots.output[40]) < 10 * unseen).all()


def test_data_may_show_fewer_outputs_than_the_plant_has_in_another_order(plant, dataset):
    names = ("middle_z", "tip_x")
    part = PlantLinearization(plant, modes=8, points=20, **QUIET)
    part.begin(names)
    for segment in SegmentDataset(dataset.observing(names).select("train"), before=0, after=0, rows=64):
        part.note(segment)
    found, whole = part.tables(), replayed(plant, dataset, modes=8, points=20).tables()
    columns = [plant.output_names.index(name) for name in names]
    assert part.replay_error < 1e-10
    for table in ("C", "d"):
        np.testing.assert_array_equal(found[table], whole[table][columns])


def test_a_robot_with_parameters_is_replayed_once_for_all_settings_of_the_fit(dataset, monkeypatch):
    driven = []
    monkeypatch.setattr(FiniteElementRobot, "reset", lambda robot: driven.append(robot))
    monkeypatch.setattr(replay, "_latest", {})
    expected = [replayed(arm(), dataset, modes=modes, points=20).tables() for modes in (12, 8)]
    del driven[:]
    for parameters, runs in (({}, 1), ({}, 1), ({"young": 1e5}, 2)):
        for modes, tables in zip((12, 8), expected):
            plant = arm()
            plant.parameters = parameters
            found = replayed(plant, dataset, modes=modes, points=20).tables()
            for name, table in tables.items():
                scale = np.abs(table).max() + 1e-300
                np.testing.assert_allclose(found[name] / scale, table / scale, rtol=0, atol=1e-12, err_msg=name)
        assert len(driven) == runs


@pytest.fixture(scope="module")
def trained(plant, dataset, tmp_path_factory):
    directory = tmp_path_factory.mktemp("tpwl")
    options = {"model": partial(TPWL, delays=4), "module": MODULE, "trainer": TRAINER, "directory": directory,
               "fits": {"linearization": partial(TPWLFit, plant=plant, modes=8, points=60, **QUIET)}}
    return train(dataset, **options), options


def test_training_gives_a_model_that_predicts_new_motions_of_the_plant(dataset, trained):
    training, _ = trained
    size = np.sqrt((dataset.select("test")[0].observation ** 2).sum(1).mean())
    assert training.scores["test/rmse"] < 0.05 * size and training.scores["test/diverged"] == 0
    assert training.model.state_dim == 16 and training.report["linearization"]["warnings"] == []


def test_the_checkpoint_holds_the_sizes_that_the_fit_found(dataset, trained):
    training, options = trained
    model, _ = load_model(training.checkpoint)
    z, u = torch.zeros(16, dtype=torch.float64), torch.ones(2, dtype=torch.float64)
    torch.testing.assert_close(model.step(z, u), training.model.step(z, u), rtol=0, atol=0)
    again = train(dataset, resume=True, **options)
    torch.testing.assert_close(again.model.step(z, u), training.model.step(z, u), rtol=0, atol=0)


def test_data_of_another_robot_give_a_remark(plant, dataset, tmp_path):
    larger = [Trajectory(run.time, 1.2 * run.observation, run.input, run.kind, run.split, run.name) for run in dataset]
    other = TrajectoryDataset(larger, dataset.rest, dataset.output_names, dataset.input_names)
    fits = {"linearization": partial(TPWLFit, plant=plant, modes=4, points=5, **QUIET)}
    training = train(other, model=partial(TPWL, delays=2), module=MODULE, trainer=TRAINER, directory=tmp_path,
                     fits=fits)
    assert "outputs of the plant differ by 16.7 %" in training.report["linearization"]["warnings"][-1]


def test_a_plant_that_is_not_that_of_the_data_is_refused(plant):
    card = {"output_names": list(plant.output_names), "input_names": list(plant.input_names), "input_unit": "N",
            "input_range": [[0.0, 0.0], [1.0, 1.0]]}
    model = SimpleNamespace(base_timestep=0.01)
    check_plant(plant, card | {"input_names": ["u1", "u2"]}, model)
    for given, changed, step, message in (
            (None, {}, 0.01, "name the plant of the data, for example plant=trunk"),
            (SlowManifold(), {}, 0.01, "is a SlowManifold; TPWL needs a finite-element robot"),
            (plant, {"output_names": ["tip_x", "elbow_x"]}, 0.01, r"have the outputs \['elbow_x'\], but the plant"),
            (plant, {"input_names": ["a"]}, 0.01, r"data have the inputs \['a'\] in N, but the plant .* in N"),
            (plant, {"input_unit": "1"}, 0.01, "data have the inputs .* in 1, but the plant .* in N"),
            (plant, {}, 0.02, "base timestep is 0.02 s, but the plant's timestep is 0.01 s"),
            (plant, {"input_range": [[0.0, 0.0], [1.0, 4.2]]}, 0.01, "reach 4.2 N, but the bound of the plant is 1 N")):
        with pytest.raises(ValueError, match=message):
            check_plant(given, card | changed, SimpleNamespace(base_timestep=step))


def test_data_without_controlled_runs_or_a_plant_are_refused_through_training(plant, dataset, tmp_path):
    options = {"model": partial(TPWL, delays=2), "module": MODULE, "trainer": TRAINER, "directory": tmp_path}
    with pytest.raises(ValueError, match="name the plant of the data"):
        train(dataset, fits={"linearization": TPWLFit}, **options)
    decay = dataset.select("train", "decay")[0].read()
    varied = Trajectory(decay.time, decay.observation, decay.input + np.linspace(0, 1e-3, len(decay.time))[:, None],
                        "decay")
    decays = TrajectoryDataset([varied], dataset.rest, dataset.output_names, dataset.input_names)
    with pytest.raises(ValueError, match="no controlled training runs"):
        train(decays, fits={"linearization": partial(TPWLFit, plant=plant)}, **options)


@pytest.mark.parametrize(("options", "message"), [
    ({"modes": 0}, "modes is 0"), ({"modes": "gap"}, 'modes is \'gap\'; expected a number, or a rule'),
    ({"points": 0}, "points is 0; expected"), ({"points": 10, "snapshots": 5}, "10 points out of 5 snapshots"),
    ({"blend": -1.0}, "blend is -1.0; expected"), ({"measurement_noise": 0.0}, "measurement_noise is 0.0; expected")])
def test_impossible_options_are_refused_with_the_numbers(options, message):
    with pytest.raises(ValueError, match=message):
        PlantLinearization(None, **options)
