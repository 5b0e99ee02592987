"""Recorded data are reproducible, start where they should and say where they came from."""

import json

import hydra
import numpy as np
import pytest

from ssmr_torch.collection.collect import ControlledRun, RecordingPlan, collect, record
from ssmr_torch.collection.excitation import (
    Dithered,
    Ramp,
    RandomOnOffRamp,
    RandomSteps,
    SetPoints,
    SmoothRandom,
    latin_hypercube_ramps,
    latin_hypercube_set_points,
)
from ssmr_torch.configuration import composed
from ssmr_torch.plants.slow_manifold import SlowManifold
from ssmr_torch.trajectory import TrajectoryDataset

RUNS = (ControlledRun("smooth", SmoothRandom(), 1.5, "train", repeats=2),
        ControlledRun("check", SmoothRandom(0.25), 1.0, "validation"),
        ControlledRun("static", SetPoints(((0.5, 0.0, 0.0, 0.0),)), 1.0, "test", kind="static"))


def small(**changes):
    settings = {"decays": 3, "validation_decays": 1, "test_decays": 1, "decay_duration": 1.0,
                "controlled": RUNS, "seed": 4, "progress": False} | changes
    return collect(SlowManifold(), **settings)


def by_name(dataset):
    return {trajectory.name: trajectory for trajectory in dataset}


def test_every_planned_trajectory_is_recorded_with_its_kind_split_and_length():
    dataset = small()
    assert len(dataset) == 5 + 4
    assert [len(dataset.select(split, "decay")) for split in ("train", "validation", "test")] == [3, 1, 1]
    assert [t.length for t in dataset.select(kind="controlled")] == [150, 150, 100]
    assert len(dataset.select("test", "static")) == 1
    assert len(by_name(dataset)) == len(dataset)


def test_a_decay_begins_at_its_release_without_input_and_away_from_rest():
    for decay in small().select(kind="decay"):
        assert decay.time[0] == 0.0
        np.testing.assert_array_equal(decay.input, 0.0)
        assert np.abs(decay.observation[0]).max() > 1e-3


def test_a_decay_replays_the_plant_from_rest_through_its_ramp():
    plant, ramp = SlowManifold(), latin_hypercube_ramps(3, 4, seed=1)[1]
    decay = record(plant, RecordingPlan("one", "decay", "train", ramp, 0.5, start=ramp.hold), seed=0)
    plant.reset()
    for u in ramp(np.random.default_rng(), 100, plant.timestep, plant.input_bounds):
        observation = plant.step(u)
    np.testing.assert_array_equal(decay.observation[0], observation)


def test_a_controlled_run_starts_at_rest_and_pairs_each_input_with_the_observation_before_it():
    plant = SlowManifold()
    for run in small().select(kind="controlled"):
        np.testing.assert_array_equal(run.observation[0], 0.0)
        plant.reset()
        replayed = [plant.step(u) for u in run.input[:-1]]
        np.testing.assert_array_equal(run.observation[1:], replayed)


def test_the_same_seed_gives_the_same_data_and_another_seed_other_data():
    first, second, other = small(), small(), small(seed=5)
    for a, b, c in zip(first, second, other, strict=True):
        np.testing.assert_array_equal(a.observation, b.observation)
        np.testing.assert_array_equal(a.input, b.input)
        if a.kind != "static":
            assert not np.array_equal(a.observation, c.observation)


def test_a_trajectory_does_not_depend_on_the_order_or_number_of_the_others():
    full = by_name(small(noise_std=1e-5))
    fewer = by_name(small(decays=2, controlled=RUNS[::-1][:2], noise_std=1e-5))
    assert set(fewer) < set(full)
    for name, trajectory in fewer.items():
        np.testing.assert_array_equal(trajectory.observation, full[name].observation)
        np.testing.assert_array_equal(trajectory.input, full[name].input)


def test_a_record_does_not_depend_on_what_the_plant_did_before():
    plan = RecordingPlan("one", "controlled", "train", SmoothRandom(), 0.5)
    plant = SlowManifold()
    first = record(plant, plan, seed=1)
    record(plant, RecordingPlan("two", "controlled", "train", SmoothRandom(), 0.3), seed=2)
    np.testing.assert_array_equal(record(plant, plan, seed=1).observation, first.observation)


def test_noise_is_white_of_the_given_size_and_leaves_inputs_and_plant_alone():
    clean, noisy = small(), small(noise_std=2e-5)
    noise = np.concatenate([n.observation - c.observation for n, c in zip(noisy, clean, strict=True)])
    for a, b in zip(clean, noisy, strict=True):
        np.testing.assert_array_equal(a.input, b.input)
    count = noise.size
    assert abs(noise.mean()) < 4 * 2e-5 / np.sqrt(count)
    assert noise.std() == pytest.approx(2e-5, rel=4 / np.sqrt(2 * count))
    correlation = np.mean(noise[1:] * noise[:-1]) / noise.var()
    assert abs(correlation) < 4 / np.sqrt(count)


def test_the_provenance_rebuilds_the_plant_and_survives_the_file(tmp_path):
    dataset = TrajectoryDataset.load(small(noise_std=1e-5).save(tmp_path / "data.h5"))
    provenance = dataset.provenance
    assert json.loads(json.dumps(provenance)) == provenance
    assert provenance["plant"]["class"] == "ssmr_torch.plants.slow_manifold.SlowManifold"
    assert SlowManifold(**provenance["plant"]["parameters"]).parameters == SlowManifold().parameters
    assert provenance["seed"] == 4
    assert [plan["name"] for plan in provenance["plans"]] == [t.name for t in dataset]
    assert provenance["plans"][-2]["excitation"] == {"class": "SmoothRandom", "knot_interval": 0.25,
                                                     "share": 1.0, "lowest": -0.3}


def test_designed_decays_are_recorded_one_by_one():
    dataset = small(decays=latin_hypercube_ramps(4, 4, seed=0), controlled=())
    assert len(dataset.select("train", "decay")) == 4


def test_static_set_points_are_held_one_after_the_other_to_the_end_of_the_last():
    points = latin_hypercube_set_points(5, 4, seed=0, share=0.5, hold=0.4)
    run, = small(decays=0, validation_decays=0, test_decays=0,
                 controlled=(ControlledRun("static", points, kind="static"),))
    assert run.kind == "static" and run.length == 5 * 40
    np.testing.assert_allclose(run.input[::40], 1.5 * np.array(points.levels))
    with pytest.raises(ValueError, match="SmoothRandom has no end of its own; give the run a duration"):
        ControlledRun("endless", SmoothRandom())
    with pytest.raises(ValueError, match="split is 'holdout'; expected one of train, validation, test"):
        ControlledRun("x", SmoothRandom(), 1.0, split="holdout")


@pytest.mark.parametrize("changes", [
    {"controlled": (RUNS[0], RUNS[0])}, {"decays": -1}, {"test_decays": -2}, {"release": SmoothRandom()},
    {"decays": [RandomOnOffRamp(), SmoothRandom()]}, {"decay_duration": 0.0}, {"noise_std": -1.0},
    {"controlled": (ControlledRun("x", Ramp((0.5, 0.2)), 1.0),)}, {"controlled": (ControlledRun("x", Ramp([0]), 1.0),)},
    {"decay_duration": 0.014}])
def test_an_impossible_plan_is_refused_before_the_plant_moves(changes):
    plant = SlowManifold()
    plant.step = lambda u: pytest.fail("the plant was moved")
    with pytest.raises(ValueError):
        collect(plant, **({"decays": 2, "controlled": RUNS, "progress": False} | changes))


def test_a_decay_whose_inputs_have_not_let_go_is_refused():
    plan = RecordingPlan("pulled", "decay", "train", SetPoints(((0.5, 0.0, 0.0, 0.0),)), 1.0, start=0.5)
    with pytest.raises(ValueError, match="expected the resting input"):
        record(SlowManifold(), plan, seed=0)


@pytest.mark.slow
def test_the_default_configuration_records_the_published_amount_and_two_tests_for_control():
    config = composed("collect", ["plant=slow_manifold", "excitation=default"])
    plant, recipe = hydra.utils.instantiate(config.plant), hydra.utils.instantiate(config.excitation)
    dataset = recipe(plant, progress=False)
    assert len(dataset.select("train", "decay")) == 40
    assert sum(t.length for t in dataset.select(kind="controlled")) == 8700 + 2000
    assert all(dataset.select(split, kind) for split in ("train", "validation", "test")
               for kind in ("decay", "controlled"))
    assert max(np.abs(t.observation[-1]).max() for t in dataset.select(kind="decay")) < 1e-4


def test_decays_of_a_plant_with_signed_inputs_begin_on_both_sides_and_have_no_input():
    ramps = latin_hypercube_ramps(6, 4, seed=0)
    plans = [RecordingPlan(f"d{k}", "decay", "train", ramp, 0.2, start=1.0) for k, ramp in enumerate(ramps)]
    plant = SlowManifold()
    signed = type("Signed", (), {"input_bounds": np.array([[-1.0] * 4, [1.0] * 4]), "timestep": plant.timestep,
                                 "input_unit": "1"})()
    signals = np.array([plan.signal(signed, seed=0) for plan in plans])
    np.testing.assert_array_equal(signals[:, 100:], 0.0)
    assert (signals[:, 99] > 0.2).any(axis=0).all() and (signals[:, 99] < -0.2).any(axis=0).all()


def test_what_is_dithered_is_told_by_its_whole_excitation():
    plans = [small(controlled=[ControlledRun("one", Dithered(inner), 0.5)]).provenance["plans"][-1]
             for inner in (SmoothRandom(share=0.5), RandomSteps(share=0.5))]
    assert [plan["excitation"]["class"] for plan in plans] == ["Dithered", "Dithered"]
    assert [plan["excitation"]["excitation"]["class"] for plan in plans] == ["SmoothRandom", "RandomSteps"]


def test_a_robot_with_a_neutral_input_of_its_own_is_excited_about_it_and_released_to_it():
    class Pretensioned(SlowManifold):
        neutral_input = np.array([0.3, 0.3, 0.0, 0.1])

    settings = {"decays": 2, "validation_decays": 0, "test_decays": 0, "decay_duration": 0.2, "progress": False}
    data = collect(Pretensioned(), **settings, controlled=[ControlledRun("smooth", SmoothRandom(share=0.4), 8.0)])
    for decay in data.select(kind="decay"):
        np.testing.assert_array_equal(decay.input, np.tile(Pretensioned.neutral_input, (20, 1)))
    low, high = data.select(kind="controlled")[0].extremes()[1]
    np.testing.assert_allclose(low, 0.6 * Pretensioned.neutral_input, atol=0.02)
    np.testing.assert_allclose(high, Pretensioned.neutral_input + 0.4 * (1.5 - Pretensioned.neutral_input), atol=0.15)
    assert data.provenance["plant"]["neutral_input"] == [0.3, 0.3, 0.0, 0.1]

    class Wrong(SlowManifold):
        neutral_input = np.array([0.0, 0.0, 0.0, 2.0])

    with pytest.raises(ValueError, match="neutral input of .* is .* expected 4 numbers between"):
        collect(Wrong(), **settings)
