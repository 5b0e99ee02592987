"""The pieces of the benchmark of designed controllers: disturbed plants, what is drawn, what runs are judged by."""

import json
from types import SimpleNamespace

import numpy as np
import pytest

from ssmr_torch import configuration
from ssmr_torch.benchmarks import designed, planes, robots_under_test
from ssmr_torch.benchmarks.disturbed_plant import Disturbed
from ssmr_torch.benchmarks.loop_scores import measured
from ssmr_torch.control.designed import DesignedController
from ssmr_torch.data.arrays import trajectories
from ssmr_torch.plants.base import Plant
from ssmr_torch.plants.emulated_rig import Rig

OSCILLATORS = {"decays": 6, "validation_decays": 0, "test_decays": 0, "decay_duration": 1.0}


@pytest.fixture
def linear(trial):
    """A linear robot of three oscillators and four pulling inputs, 10 ms."""
    return trial.ModelPlant(trial.oscillators(degree=1, control_degree=0))


@pytest.fixture
def inputs():
    return np.random.default_rng(3).uniform(0.0, 0.6, (60, 4))


def driven(plant, inputs, seed=0):
    return np.array([plant.reset(seed), *(plant.step(u) for u in inputs)])


def test_undisturbed_it_is_the_plant_to_the_last_bit(linear, inputs):
    disturbed = Disturbed(linear)
    assert isinstance(disturbed, Plant)
    np.testing.assert_array_equal(driven(disturbed, inputs), driven(linear, inputs))


def test_delay_lag_gain_offset_and_play_act_as_their_equations_say(linear, inputs):
    disturbed = Disturbed(linear, delay=0.02, lag=0.03, gain=0.8, offset=0.1, play=0.05)
    found, share = driven(disturbed, inputs), np.exp(-1 / 3)
    changed = np.clip(inputs * [0.8, 1, 1, 1] + [0.06, 0, 0, 0], 0.0, 0.6)
    rest = np.array([0.06, 0.0, 0.0, 0.0])
    held, transmitted = rest, []
    for u in changed:
        held = np.clip(held, u - 0.03, u + 0.03)
        transmitted.append(held)
    lagged, applied = rest, []
    for u in [rest, rest, *transmitted[:-2]]:
        lagged = share * lagged + (1 - share) * u
        applied.append(lagged)
    np.testing.assert_allclose(found, driven(linear, np.array(applied)), atol=1e-15)


def test_it_goes_on_from_its_state_as_it_went_on_before(linear, inputs):
    disturbed = Disturbed(Rig(linear, noise_std=1e-4), delay=0.03, lag=0.02, play=0.1,
                                                 outlier=0.02, missing=0.3)
    driven(disturbed, inputs[:30], seed=5)
    state = disturbed.state
    after = [disturbed.step(u) for u in inputs[30:]]
    disturbed.reset(5, state)
    np.testing.assert_array_equal([disturbed.step(u) for u in inputs[30:]], after)


def test_outliers_come_once_a_second_and_gaps_as_often_as_told(linear):
    sensors = Disturbed(linear, outlier=0.02, missing=0.1)
    seen = driven(sensors, np.zeros((2000, 4)), seed=1)
    far = np.abs(seen) > 0.019
    missing = np.isnan(seen).all(axis=1)
    assert missing.mean() == pytest.approx(0.1, abs=0.02) and not missing[0]
    assert far.any(axis=1).sum() + missing[50::100].sum() == 20
    np.testing.assert_array_equal(np.abs(seen[far]), 0.02)
    np.testing.assert_array_equal(driven(sensors, np.zeros((2000, 4)), seed=1), seen)


def test_what_is_seen_counts_from_the_origin_that_was_recorded(linear):
    moved = Disturbed(linear, rest=linear.rest - 0.003)
    np.testing.assert_allclose(moved.reset(), 0.003)
    np.testing.assert_allclose(moved.displacement, 0.003)


@pytest.mark.parametrize("wrong", [{"delay": 0.015}, {"lag": -1.0}, {"missing": 1.0}, {"gain": np.nan}], ids=str)
def test_disturbances_that_make_no_sense_are_refused(linear, wrong):
    with pytest.raises(ValueError, match=next(iter(wrong))):
        Disturbed(linear, **wrong)


def recorded(places):
    """Decays that begin at these places (n, 2) of x and y, and one run over all of them; z = 20 x² all the while."""
    def curved(xy):
        return np.column_stack([xy, 20.0 * xy[:, 0]**2])

    back = np.linspace(1.0, 0.0, 30)[:, None]
    rows = np.repeat(places, 5, axis=0) + 1e-6 * np.arange(5 * len(places))[:, None]
    return trajectories(decays=[(0.01, curved(back * place), np.zeros((30, 1))) for place in places],
                        controlled=[(0.01, curved(rows), np.sin(np.arange(len(rows)))[:, None])])


def test_the_plane_is_the_widest_output_and_the_one_that_is_no_function_of_it():
    rng = np.random.default_rng(0)
    x, y = rng.uniform(-0.03, 0.03, 40), rng.uniform(-0.002, 0.002, 40)
    x[:2], y[:2] = [-0.03, 0.03], [-0.002, 0.002]
    plane = planes.plane_of(recorded(np.stack([x, y], axis=1)))
    assert plane.outputs == ("y1", "y2")
    np.testing.assert_allclose(plane.half, [0.03, 0.002], rtol=0.15)  # y leans on x by chance
    np.testing.assert_allclose(plane.centre, [x.sum() / 41, 0.0], atol=3e-4)
    with pytest.raises(ValueError, match="have 3 decays and 3 outputs; expected 4 decays"):
        planes.plane_of(recorded(np.stack([x, y], axis=1)[:3]))


def test_a_drawing_goes_from_rest_through_the_shape_and_stands_still_at_the_end():
    plane = planes.Plane(("x", "y"), (0.0, 0.0, 2.0), (0.001, 0.0), (0.02, 0.004), 0.025)
    for shape in planes.SHAPES:
        task = planes.drawing(plane, shape, lap=2.5, laps=2.0, share=0.4)
        time = np.linspace(0.0, task.duration, 4001)
        path = task.reference(time)
        np.testing.assert_allclose(path[0], 0.0, atol=1e-12)
        box = np.stack([path[:, 0] - 0.001, path[:, 1] - 2.0 * path[:, 0]**2], axis=1)[time > planes.LEAD]
        np.testing.assert_allclose(np.abs(box).max(axis=0), [0.008, 0.0016], rtol=1e-3, err_msg=shape)
        assert np.abs(np.diff(path, axis=0))[[0, -1]].max() < 1e-8
        np.testing.assert_allclose(path[-1], task.reference(planes.LEAD)[0], atol=1e-9)


def record_of(error, task, trial):
    time = 0.01 * np.arange(len(error))
    return SimpleNamespace(time=time, error=error, solve_time=np.full(len(error), 1e-3), reference=np.zeros_like(error),
                           observation=error, tracked=(0, 1), input=np.zeros((len(error), 1)),
                           fallback=np.zeros(len(error), dtype=bool),
                           violation=np.full(len(error), np.nan), provenance={"period": 0.01})


def test_a_loop_is_lost_when_it_is_far_beyond_the_static_floor_for_a_third_of_a_second(trial):
    task, controller = SimpleNamespace(duration=4.0, obstacles=()), SimpleNamespace(
        counts={"gated": 3}, fallbacks={}, input_bounds=np.array([[0.0], [1.0]]))
    error = np.full((401, 2), 1e-3 / np.sqrt(2))
    row = measured(record_of(error, task, trial), task, controller, 0.1, None)
    assert row["rmse"] == pytest.approx(1e-3) and not row["lost"] and row["counts"] == {"gated": 3}
    assert row["at a bound"] == 1.0
    error[200:229, 0] = 0.02
    assert not measured(record_of(error, task, trial), task, controller, 0.1, None)["lost"]
    error[200:231, 0] = 0.02
    assert measured(record_of(error, task, trial), task, controller, 0.1, None)["lost"]
    row = measured(record_of(error, task, trial), task, controller, 0.1, [0.02, 0.02, 0.02])
    assert not row["lost"] and row["within"] == 0.0 and row["rmse within"] is None
    assert measured(record_of(error, task, trial), task, controller, 0.1, [np.inf, 0.0, 0.0])["floor unknown"] == 1 / 3
    error[300:] = np.nan
    row = measured(record_of(error, task, trial), task, controller, 0.1, None)
    assert row["lost"] and row["rmse"] is None and "ise" not in row


@pytest.fixture
def miniature(trial, monkeypatch):
    """The benchmark with a linear robot and a design that knows it."""
    robots = robots_under_test
    model = trial.oscillators(degree=1, control_degree=0)

    class Linear(robots.Robot):
        def plant(self, condition, rest=None):
            plant = Rig(trial.ModelPlant(model), noise_std=1e-5)
            return plant if condition == robots.NOMINAL else robots.Disturbed(plant, rest=rest, **condition.changes)

        def record(self, plant):
            config = configuration.composed("collect", ["excitation=five_minutes"])
            config.excitation.update(OSCILLATORS | {"progress": False, "controlled": config.excitation.controlled[:1]})
            config.excitation.controlled[0].update(duration=4.0, repeats=2)
            return configuration.built(config.excitation)(plant)

        def tasks(self, plane):
            return [robots.drawing(plane, "circle", lap=1.0, laps=1.0, share=0.4)]

    robot = Linear("linear", (), (robots.Condition("late", changes={"delay": 0.01}, told=("not told", "designed")),))
    monkeypatch.setattr(designed, "ROBOTS", {"linear": robot})
    monkeypatch.setattr(designed, "robot_named", lambda name: robot)
    designs = []

    def design(kind, data, task, bounds, progress):
        designs.append(kind)
        facts = {"seconds": 1.0, "model": "the robot's own", "actuator": {}, "model_error": 0.0, "reach": 1.0,
                 "against_twin": {"as it is": None}, "designs": {"safe": 1, "count": 1, "judged_by": "margins"},
                 "weights": {"move": 1.0, "observer": [1.0]}}
        return (DesignedController(model, task, bounds, period=0.01, horizon=10, input_weight=0.01,
                                   output_names=data.output_names),
                SimpleNamespace(facts=facts, sentences=["Nothing was sought."]))

    monkeypatch.setattr(designed.ssmr, "design", design)
    monkeypatch.setattr(designed.ssmr, "rehearse", lambda controller: SimpleNamespace(
        floor=np.zeros(5), out_of_reach=0.0, static_ise=0.0, fastest=1.0, held={}, rmse=np.inf))
    return designed, designs


def test_every_row_is_made_once_and_a_page_and_the_worst_by_name_beside_it(miniature, tmp_path):
    designed, designs = miniature
    asked = {"folder": str(tmp_path), "robots": ["linear"], "parts": ["nominal", "disturbed"], "seeds": 1}
    *table, place, worst = designed.rows(**asked)
    assert len(table) == 3 and table[0]["robot"] == "linear" and not table[0]["lost"]
    assert table[0]["RMSE, % of reach"] < 2.0 and place.endswith("linear.md")
    rows = json.loads((tmp_path / "results.json").read_text())
    runs = [key for key in rows if key.split("/")[1] in ("nominal", "disturbed")]
    assert len(runs) == 3 and len(designs) == 2
    assert all(rows[key]["rmse"] < 0.02 * rows[key]["reach"] for key in runs if "/nominal/auto" in key)
    page = (tmp_path / "linear.md").read_text()
    assert "| auto | late | designed |" in page and "Nothing" not in page
    assert "worst nominal robot and task: linear, circle, 1 s a lap, 40 % by auto" in worst
    list(designed.rows(**asked))
    assert len(designs) == 2
    assert json.loads((tmp_path / "results.json").read_text()) == rows


def test_what_fails_is_a_row_with_its_reason_and_is_tried_again(miniature, tmp_path, monkeypatch):
    designed, _ = miniature
    works = designed.ssmr.design

    def fails(*given, **named):
        raise ValueError("the data cannot tell")

    asked = {"folder": str(tmp_path), "robots": ["linear"], "parts": ["nominal"], "seeds": 1}
    monkeypatch.setattr(designed.ssmr, "design", fails)
    list(designed.rows(**asked))
    assert "the data cannot tell" in (tmp_path / "linear.md").read_text()
    monkeypatch.setattr(designed.ssmr, "design", works)
    list(designed.rows(**asked))
    assert "cannot tell" not in (tmp_path / "linear.md").read_text()


@pytest.mark.parametrize("wrong", [{"robots": ["snake"]}, {"parts": ["all"]}], ids=str)
def test_robots_and_parts_that_are_none_are_refused_with_those_that_are(wrong):
    with pytest.raises(ValueError, match="unknown: (snake|all); robots are tendon_chain, .*parts nominal, far"):
        list(designed.rows(**wrong))
