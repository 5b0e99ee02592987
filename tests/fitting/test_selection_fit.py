"""`fit(data)`: the choice of a slow-fast model from the data, its refusals, and the files that it writes."""

import re
import warnings
from dataclasses import replace
from functools import partial

import numpy as np
import pytest

import ssmr_torch as ssmr
from ssmr_torch.models.slow_fast import SlowFast
from ssmr_torch.selection.specification import Specification
from ssmr_torch.selection.team import choose_team
from ssmr_torch.trained_model import OutsideTraining

FORMS = (Specification(memory=("shift", 1)), Specification(features="configuration_affine", ridge=1e-6),
         Specification(delays=2, memory=("shift", 2)), Specification(memory=("pole", 0.67), features="bilinear"),
         Specification(chart="predictive", states=6, delays=8, memory=("shift", 1)))


def robot(seed, seconds, timestep=0.02, outputs=3, inputs=2, released=False, gain=1.0):
    """A marker on a beam that bends two ways, whose third coordinate goes with the square; y in mm, held inputs."""
    rng, steps, fine = np.random.default_rng(seed), max(2, round(seconds / timestep)), 10
    hold = max(1, round(0.2 / timestep))
    u = np.repeat(rng.uniform(-0.2, 1.0, (steps // hold + 1, inputs)), hold, axis=0)[:steps] * (not released)
    q, v = (rng.uniform(-8, 8, 2) if released else np.zeros(2)), np.zeros(2)
    drive, y = np.array([[1.0, 0.2], [-0.3, 1.0]])[:, :inputs], []
    for now in u:
        y.append([q[0], q[1], -0.02 * (q @ q) - 0.3 * q[0]][:outputs])
        for _ in range(fine):
            v = v + timestep / fine * (1500.0 * gain * drive @ now - np.array([150.0, 220.0]) * q
                                       - 0.4 * q ** 3 - 6.0 * v)
            q = q + timestep / fine * v
    return timestep, np.array(y), u


def recorded(decays=2, runs=3, seconds=6.0, change=lambda run: run, **more):
    """As `trajectories` takes them, the last run for the test; change: of a run (timestep, y, u)."""
    of = [change(robot(seed, seconds, **more)) for seed in range(runs)]
    return {"decays": [robot(50 + k, max(seconds, 3.0), released=True, **more) for k in range(decays)],
            "controlled": of[:-1], "test": of[-1:], "units": {"length": "mm", "input": "1"}}


def among_few(began, trial, *, decays, minutes=0.0, say=lambda line: None):
    began.append(trial)
    for each in FORMS:
        trial(each if decays else replace(each, decays=False))


@pytest.fixture
def few(monkeypatch):
    """A selection among a few forms, which takes a second, and the trials that began."""
    began = []
    monkeypatch.setattr("ssmr_torch.selection.choose.search", partial(among_few, began))
    return began


@pytest.fixture(scope="module")
def data():
    return ssmr.trajectories(**recorded())


def fitted(data, **options):
    return ssmr.fit(data, progress=False, **{"symmetry": "none", "refine": False} | options)


@pytest.fixture(scope="module")
def model(data):
    """One of few forms, for tests of what is done with it."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("ssmr_torch.selection.choose.search", partial(among_few, []))
        return fitted(data)


def start(model, data, horizon=40, at=30):
    run = data.select("test")[0]
    window = run.observation[at - model.delays:at + 1]
    return (window, run.input[at:at + horizon], run.input[at - model.delays:at],
            run.observation[at + 1:at + 1 + horizon])


def test_without_a_kind_a_slow_fast_model_is_chosen_and_predicts_new_runs(model, data):
    assert isinstance(model.module, SlowFast) and model.name == "AUTO"
    window, inputs, past, measured = start(model, data)
    assert np.abs(model.predict(window, inputs, past) - measured).max() < 0.05 * np.ptp(measured, axis=0).max()
    said = " ".join(model.report["selection"]["found"])
    assert "Chosen for prediction among" in said and "Error on held-out parts" in said
    assert model.report["selection"]["facts"]["members"]


def test_the_same_data_give_the_same_choice_to_the_last_bit(few, data):
    one, two = (fitted(data, refine=True, symmetry="find") for _ in range(2))
    facts = [dict(model.report["selection"]["facts"]) for model in (one, two)]
    for each in facts:
        each.pop("cpu")
    assert facts[0] == facts[1]
    assert all((one.module.state_dict()[name] == value).all() for name, value in two.module.state_dict().items())


def test_a_fit_without_progress_prints_nothing_and_keeps_the_random_state(few, data, capfd):
    np.random.seed(3)
    before = np.random.get_state()[1].copy()
    fitted(data)
    said = capfd.readouterr()
    assert not said.out and not said.err and (np.random.get_state()[1] == before).all()


def test_an_artifact_of_a_chosen_model_predicts_the_same(model, data, tmp_path):
    model.save(tmp_path / "artifact")
    again = ssmr.load(tmp_path / "artifact")
    window, inputs, past, _ = start(model, data)
    np.testing.assert_array_equal(again.predict(window, inputs, past), model.predict(window, inputs, past))
    assert again.output_names == model.output_names and again.scores == model.scores
    np.testing.assert_array_equal(again.card["output_range"], model.card["output_range"])


def test_a_checkpoint_of_a_chosen_model_holds_its_structure(few, data, tmp_path):
    from ssmr_torch.fitting.checkpoints import load_model

    model = fitted(data, directory=tmp_path / "run")
    again, _ = load_model(tmp_path / "run" / "model.ckpt")
    window, inputs, past, _ = start(model, data)
    one, other = (each.reduced.numpy() for each in (again, model.module))
    np.testing.assert_array_equal(one.encode(window, past), other.encode(window, past))
    assert one.structure.plain() == other.structure.plain() and one.reach == other.reach


def test_the_c_code_of_a_chosen_model_computes_the_same(model, data, tmp_path):
    from ssmr_torch.deployment.c.compiled_library import CLibrary, compile_library, compiler

    if compiler() is None:
        pytest.skip("no C compiler")
    model.export(tmp_path / "artifact", "c")
    [source] = (tmp_path / "artifact" / "deployed").rglob("*.c")
    compile_library(source, tmp_path / "model.so")
    library = CLibrary(tmp_path / "model.so", source.stem, model.reduced)
    window, inputs, past, _ = (array[None] for array in start(model, data, horizon=1))
    z = model.reduced.encode(window, past)
    np.testing.assert_allclose(library.encode(window, past), z, rtol=0, atol=1e-12 * np.abs(z).max())
    np.testing.assert_allclose(library.step(z, inputs[:, 0]), model.reduced.step(z, inputs[:, 0]), rtol=0,
                               atol=1e-12 * np.abs(z).max())


def test_a_model_for_control_is_one_and_a_team_is_as_large_as_allowed(few, data, monkeypatch):
    asked = []

    def noted(trial, pool, largest):
        asked.append(largest)
        return choose_team(trial, pool, largest)

    monkeypatch.setattr("ssmr_torch.selection.choose.choose_team", noted)
    sizes = [len(fitted(data, **options).report["selection"]["facts"]["members"])
             for options in ({}, {"team": 2}, {"purpose": "control"})]
    assert asked == [4, 2, 1] and sizes[2] == 1 and all(size <= most for size, most in zip(sizes, asked))


def test_outputs_that_are_scored_are_those_of_the_trial(few, data):
    fitted(data, scored=["y3"])
    assert few[0].samples.targets == [2]


def test_a_stated_noise_gives_a_chart_for_this_noise(few, model, data):
    filtered = fitted(data, noise=2e-4)
    window, inputs, past, measured = start(filtered, data)
    errors, rng = [], np.random.default_rng(0)
    for each in (model, filtered):
        warnings.simplefilter("ignore", OutsideTraining)
        noisy = [each.predict(window[-each.delays - 1:] + 2e-4 * rng.normal(size=(each.delays + 1, 3)), inputs,
                              past[len(past) - each.delays:]) for _ in range(30)]
        errors.append(np.sqrt(np.square(np.array(noisy) - measured).mean()))
    assert errors[1] < 0.8 * errors[0]


@pytest.mark.parametrize(("options", "error", "says"), [
    ({"scored": ["tip"]}, ValueError, r"scored names \['tip'\], .* outputs are \['y1', 'y2', 'y3'\]"),
    ({"purpose": "fun"}, ValueError, "purpose is 'fun'; expected"),
    ({"team": 0}, ValueError, "team is 0"), ({"noise": -1e-3}, ValueError, "noise is -0.001"),
    ({"symmetry": "some"}, ValueError, "symmetry is 'some'"), ({"minutes": -1}, ValueError, "minutes is -1"),
    ({"coordinates": ["polar"]}, ValueError, "output coordinates 'polar' are not possible"),
    ({"teams": 2}, TypeError, "no option teams; did you mean .*team")])
def test_settings_that_make_no_sense_are_refused_before_any_search(few, data, options, error, says):
    with pytest.raises(error, match=says):
        fitted(data, **options)
    assert not few


def constant(run):
    return run[0], run[1], np.full_like(run[2], 0.5)


def lost(run):
    return run[0], run[1] * [1, 1, 0], run[2]


def copied(run):
    return run[0], run[1][:, [0, 1, 0]], run[2]


def two_samples(run):
    return run[0], run[1][100:102], run[2][100:102]


def alike(run):
    return robot(0, 6.0)


@pytest.mark.parametrize(("given", "says"), [
    ({"change": constant}, "inputs that never change.*leave these columns out or record runs that use them"),
    ({"change": lost, "decays": 0}, "y3 never moves in any run.*leave it out"),
    ({"change": copied, "decays": 0}, "output y3 is a copy of y1.*leave it out"),
    ({"change": alike, "decays": 0}, "the test run .* are those of the training run .*record another run"),
    ({"change": two_samples, "decays": 0}, "has 2 samples; a start needs 20 before and 50 after it.*longer runs"),
])
def test_recordings_without_information_are_refused_with_the_remedy(few, given, says):
    with pytest.raises(ValueError, match=says):
        fitted(ssmr.trajectories(**recorded(**given), minimum_length=2))
    assert not few


def test_one_run_only_is_refused(few):
    with pytest.raises(ValueError, match="is the only run.*record a second one"):
        fitted(ssmr.trajectories(controlled=[robot(0, 6.0)], units={"length": "mm", "input": "1"}))
    assert not few


def test_decays_alone_are_refused(few):
    given = recorded()
    with pytest.raises(ValueError, match="inputs that never change|no controlled training runs"):
        fitted(ssmr.trajectories(decays=given["decays"], test=given["test"], units=given["units"]))
    assert not few


@pytest.mark.parametrize("given", [{"runs": 4, "seconds": 4.0}, {"runs": 3, "seconds": 2.0, "decays": 0},
                                   {"timestep": 0.05}, {"timestep": 0.2, "seconds": 30.0},
                                   {"timestep": 0.002, "seconds": 3.0}, {"outputs": 1}, {"outputs": 2}, {"decays": 0},
                                   {"inputs": 1}], ids=str)
def test_few_data_other_samplings_and_other_sizes_are_fitted(few, given):
    data = ssmr.trajectories(**recorded(**given))
    model = fitted(data)
    window, inputs, past, measured = start(model, data, horizon=20)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", OutsideTraining)
        found = model.predict(window, inputs, past)
    assert np.abs(found - measured).max() < 0.5 * np.ptp(data.select("test")[0].observation, axis=0).max()


@pytest.mark.slow
@pytest.mark.parametrize("given", [{"runs": 4, "seconds": 4.0}, {"timestep": 0.002, "seconds": 3.0}, {"outputs": 2}],
                         ids=str)
def test_with_symmetries_and_refinement_they_are_fitted_too(few, given):
    data = ssmr.trajectories(**recorded(**given))
    model = fitted(data, symmetry="find", refine=True)
    assert model.scores["test/rmse"] < 0.5 * model.scores["test/rmse_persistence"]


@pytest.mark.slow
def test_the_whole_selection_beats_persistence_and_finds_the_same_again(data):
    one, two = (ssmr.fit(data, progress=False) for _ in range(2))
    assert one.report["selection"]["facts"]["members"] == two.report["selection"]["facts"]["members"]
    assert all((one.module.state_dict()[name] == value).all() for name, value in two.module.state_dict().items())
    assert one.scores["test/rmse"] < 0.05 * one.scores["test/rmse_persistence"]


@pytest.mark.parametrize("seconds", [0.3, 0.5, 0.8])
def test_training_runs_that_are_too_short_are_refused_with_what_they_need(few, seconds):
    given = recorded(runs=2, seconds=seconds, decays=0) | {"test": [robot(9, 6.0)]}
    with pytest.raises(ValueError, match="are too short: .* 21 samples; record more runs, or runs longer"):
        fitted(ssmr.trajectories(**given))
    assert not few


def test_test_runs_that_are_too_short_to_score_are_refused_before_any_search(few):
    with pytest.raises(ValueError, match="71 in all; take shorter horizons, or longer runs"):
        fitted(ssmr.trajectories(**recorded() | {"test": [robot(9, 1.0)]}))
    assert not few


def test_a_timestep_of_two_samples_uses_every_second_sample(few, data):
    model = fitted(data, timestep=0.04)
    assert model.timestep == model.window_timestep == 0.04 and len(few[0].samples.controlled[0][0]) == 150
    run, at = data.select("test")[0], 60
    u = run.input[:300].reshape(150, 2, 2).mean(axis=1)
    window = run.observation[at - 2 * model.delays:at + 1:2]
    z = model.reduced.encode(window, u[at // 2 - model.delays:at // 2])
    z = model.reduced.step(z, u[at // 2])
    assert np.abs(model.reduced.decode(z) - run.observation[at + 2]).max() < 0.02 * np.ptp(run.observation)


def test_a_timestep_that_is_no_multiple_of_the_recordings_is_refused(few, data):
    with pytest.raises(ValueError, match="whole multiple|multiple of it"):
        fitted(data, timestep=0.03)
    assert not few


def test_leaving_the_training_range_gives_one_warning_per_call(model, data):
    window, inputs, past, _ = start(model, data, horizon=20)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        model.predict(window, inputs, past)
    with pytest.warns(OutsideTraining) as said:
        found = model.predict(window, 4.0 * np.tile(inputs, (20, 1)), past)
    assert np.isfinite(found).all() and len(said) == 2
    inside, outside = (str(each.message) for each in said)
    assert re.match(r"inputs leave the training range: u[12] is between .* not reliable", inside)
    assert re.match(r"outputs leave the training range: y[123] is between .* mm", outside)
