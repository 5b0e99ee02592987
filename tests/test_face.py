"""Claims about the face of the package, on an exactly linear robot."""

import ast
import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from scipy.linalg import expm

import ssmr_torch as ssmr
from ssmr_torch.fitting.options import dotted

ROOT = Path(__file__).resolve().parents[1]
DT, HOLD = 0.01, 12  # s, samples that an input is held
HEAVY = ("numpy", "torch", "lightning", "hydra", "omegaconf", "numba", "scipy", "h5py", "yaml", "tqdm", "safetensors",
         "matplotlib", "pandas")


def linear_run(inputs, x):
    """A run of dx/dt = A x + B u, y = C x in mm, exact at the samples.

    Four states and three outputs: two samples and the input between them determine the state, so that DMD is exact.
    """
    A = np.zeros((4, 4))
    A[:2, :2], A[2:, 2:] = [[-1.5, 12.5], [-12.5, -1.5]], [[-1.8, 15.0], [-15.0, -1.8]]
    B = np.array([[30.0, 5.0], [10.0, -20.0], [-8.0, 40.0], [25.0, 12.0]])
    C = np.array([[1.0, 0.2, 0.3, -0.1], [-0.2, 0.9, 0.1, 0.6], [0.25, -0.3, 0.2, 0.1]])
    step = expm(DT * np.block([[A, B], [np.zeros((2, 6))]]))

    outputs = []
    for u in inputs:
        outputs.append(C @ x)
        x = step[:4, :4] @ x + step[:4, 4:] @ u
    return DT, np.array(outputs), inputs


def linear_robot(seed=0):
    """Six decays and four runs under held inputs."""
    rng = np.random.default_rng(seed)
    decays = [linear_run(np.zeros((300, 2)), 12.0 * rng.normal(size=4)) for _ in range(6)]
    controlled = [linear_run(np.repeat(2.0 * rng.uniform(-1, 1, (70, 2)), HOLD, axis=0), np.zeros(4)) for _ in range(4)]
    return {"decays": decays, "controlled": controlled[:3], "test": controlled[3:]}


NAMES = {"output_names": ("x", "y", "z"), "input_names": ("left", "right")}
MILLIMETRES = {"units": {"length": "mm", "input": "1", "time": "s"}}


@pytest.fixture(scope="module")
def data():
    return ssmr.trajectories(**linear_robot(), **NAMES, **MILLIMETRES)


@pytest.fixture(scope="module")
def dmd(data):
    return ssmr.fit(data, "dmd", progress=False)


def started(data, model, start, horizon):
    """Window, inputs and past inputs at a sample of the test run, and what was measured after it."""
    run, reach = data.select("test")[0], round(model.window_timestep / DT)
    rows = start - reach * np.arange(model.delays, -1, -1)
    past = np.stack([run.input[row:row + reach].mean(axis=0) for row in rows[:-1]])
    return run.observation[rows], run.input[start:start + horizon], past, run.observation[start + 1:start + 1 + horizon]


# ---------------------------------------------------------------------------------------------------- what it costs


def modules_after(code, folder=None):
    names = json.dumps(HEAVY)
    code = f"import sys, json\n{code}\nprint(json.dumps([name for name in {names} if name in sys.modules]))"
    return json.loads(subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True,
                                     cwd=folder).stdout)


def test_importing_the_package_loads_nothing_heavy_and_shows_the_whole_face():
    assert modules_after("import ssmr_torch; assert set(ssmr_torch.__all__) <= set(dir(ssmr_torch))") == []


def test_loading_an_artifact_loads_numpy_and_safetensors_alone(dmd, tmp_path):
    dmd.save(tmp_path / "artifact")
    code = "import ssmr_torch; ssmr_torch.load('artifact').predict([[0.0] * 3] * 2, [[0.0] * 2], [[0.0] * 2])"
    assert modules_after(code, tmp_path) == ["numpy", "safetensors"]


@pytest.mark.parametrize("name", ssmr.__all__)
def test_every_name_of_the_face_is_there_and_says_what_it_is(name):
    assert getattr(ssmr, name).__doc__.strip()


def test_a_name_that_is_none_is_refused_with_those_that_are():
    with pytest.raises(AttributeError, match="no 'fitt'; it has .*fit, load"):
        _ = ssmr.fitt


# ---------------------------------------------------------------------------------------------------- ten statements

README = (ROOT / "README.md").read_text(encoding="utf-8")
NOTEBOOK = README.partition("```python\n")[2].partition("```")[0]


def write_card(folder):
    """Files of `linear_robot` in mm, to the last digit, and their card."""
    runs = linear_robot()
    names = {part: [f"{part[0]}{number}" for number in range(len(of_part))] for part, of_part in runs.items()}
    for part, of_part in runs.items():
        for name, (dt, y, u) in zip(names[part], of_part):
            np.savetxt(folder / f"{name}.csv", np.c_[dt * np.arange(len(y)), y, u], delimiter=",", comments="",
                       header="t,x,y,z,left,right", fmt="%.17g")
    (folder / "robot.yaml").write_text(f"""
files: {[f'{name}.csv' for part in names.values() for name in part]}
columns: {{time: t, observation: ["x", "y", "z"], input: [left, right]}}
units: {{length: mm, input: "1", time: s}}
rest: [0, 0, 0]
decays: {names['decays']}
split: {{test: {names['test']}}}
""")
    return {part: dict(zip(names[part], of_part)) for part, of_part in runs.items()}


def test_read_fit_predict_score_and_save_take_one_import_and_ten_statements(tmp_path, monkeypatch, capsys):
    statements = ast.parse(NOTEBOOK).body
    assert len(statements) <= 10 and sum(isinstance(each, ast.Import) for each in statements) == 1
    write_card(tmp_path)
    monkeypatch.chdir(tmp_path)
    done = {}
    exec(NOTEBOOK, done)
    error = np.linalg.norm(done["prediction"] - done["run"].observation[2:102], axis=1)
    assert error.shape == (100,) and error.max() < 5e-3 and "persistence" in capsys.readouterr().out
    assert (tmp_path / "artifact" / "card.json").is_file() and not (tmp_path / "outputs").exists()


# ---------------------------------------------------------------------------------------------------- data in memory


class Frame:
    """What pandas and polars have in common, as far as it is needed."""

    def __init__(self, table, columns):
        self.table, self.columns = table, list(columns)

    def to_numpy(self):
        return self.table


def same(one, other):
    assert one.output_names == other.output_names and one.input_names == other.input_names
    assert one.input_unit == other.input_unit and (one.rest == other.rest).all() and len(one) == len(other)
    for left, right in zip(one, other):
        assert (left.kind, left.split, left.name) == (right.kind, right.split, right.name)
        for name in ("time", "observation", "input"):
            assert np.array_equal(getattr(left, name), getattr(right, name))


def frames(runs, make):
    """The same runs with y and u as frames, whose columns stand in another order."""
    def of(dt, y, u):
        return dt * np.arange(len(y)), make(y[:, ::-1], NAMES["output_names"][::-1]), make(u, NAMES["input_names"])

    return {part: {name: of(*run) for name, run in of_part.items()} for part, of_part in runs.items()}


def test_arrays_frames_and_a_card_give_the_same_dataset(tmp_path):
    runs = write_card(tmp_path)
    by_card = ssmr.read(tmp_path / "robot.yaml")
    same(by_card, ssmr.trajectories(**runs, **NAMES, **MILLIMETRES))
    same(by_card, ssmr.trajectories(**frames(runs, Frame), output_names=["x", "y", "z"], **MILLIMETRES))


def test_frames_of_pandas_bring_their_names(tmp_path):
    pandas = pytest.importorskip("pandas")
    runs = linear_robot()
    named = {part: {f"{part.removesuffix('s')} {number}": run for number, run in enumerate(of_part, start=1)}
             for part, of_part in runs.items()}
    found = ssmr.trajectories(**frames(named, lambda table, columns: pandas.DataFrame(table, columns=columns)),
                              **MILLIMETRES)
    assert found.output_names == ("z", "y", "x") and found.input_names == NAMES["input_names"]
    same(found.observing(["x", "y", "z"]), ssmr.trajectories(**runs, **NAMES, **MILLIMETRES))


def test_a_decay_needs_no_inputs_and_a_run_one_number_for_its_clock():
    t = DT * np.arange(200)
    swing = 0.01 * np.exp(-3 * t) * np.cos(10 * t)
    found = ssmr.trajectories(decays=[(t, swing)], controlled=[(DT, swing, t)])
    assert found[0].input.shape == (200, 1) and not found[0].input.any()
    np.testing.assert_allclose(found[1].time, t, rtol=0, atol=1e-12)
    assert [run.kind for run in found] == ["decay", "controlled"] and found.output_names == ("y1",)


def spoilt(change):
    runs = linear_robot()
    change(runs)
    return {**NAMES, **MILLIMETRES, **runs}


def one_longer(runs):
    dt, y, u = runs["controlled"][0]
    runs["controlled"][0] = dt, y, u[:-1]


def moving_decay(runs):
    runs["decays"].append(runs["controlled"][0])


def absolute(runs):
    runs["decays"] = [(dt, y + [5.0, -3.0, 120.0], u) for dt, y, u in runs["decays"]]


def cut_short(runs):
    runs["controlled"] = [(dt, y[:, :2], u) for dt, y, u in runs["controlled"]]


@pytest.mark.parametrize(("change", "message"), [
    (one_longer, r"controlled 1 has 840 observations and 839 inputs; expected equally many: u\[k\] is held"),
    (moving_decay, "decay 7 is a decay, but its input left changes by 3.*; list it under controlled"),
    (absolute, r"decays end 120 mm from zero.*y is the displacement from rest: subtract the rest position, \[4\.95"),
    (cut_short, r"controlled 1 has 2 outputs; expected 3, \['x', 'y', 'z'\]"),
    (lambda runs: runs.update(units={"length": "m"}), "read in m; expected between 0.001 and 2 m: .* like cm or mm"),
    (lambda runs: runs.update(units="mm"), "units is 'mm'; expected a mapping, such as {'length': 'mm'"),
    (lambda runs: runs.update(output_names=["x", "y", "x"]), "two outputs are named 'x'"),
    (lambda runs: runs.update(decays=[(DT, np.ones((50, 3), dtype=complex), np.zeros((50, 2)))]),
     "decay 1: y is not all numbers .*complex"),
    (lambda runs: runs.update(units={"lenght": "m"}), "unknown key 'lenght'; expected length, input, time"),
    (lambda runs: runs.update(output_names=["x", "y"]), "decay 1 has 3 outputs; expected 2"),
    (lambda runs: runs.update(decays=[(DT,)]), r"decay 1 of decays is no run; expected \(t, y, u\)"),
    (lambda runs: runs.update(decays=[], controlled=[], test=[]), r"no runs were given; expected decays=\["),
    (lambda runs: runs.update(controlled={"decay 1": runs["controlled"][0]}), "two runs are named 'decay 1'"),
])
def test_recordings_that_cannot_be_are_refused_with_the_remedy(change, message):
    with pytest.raises(ValueError, match=message):
        ssmr.trajectories(**spoilt(change))


def test_decays_that_stop_before_they_rest_are_said(caplog):
    runs = linear_robot()
    runs["decays"] = [(dt, np.abs(y[:120]) + 2.0, u[:120]) for dt, y, u in runs["decays"]]
    ssmr.trajectories(**runs, **NAMES, **MILLIMETRES)
    assert "y is the displacement from rest: record them longer" in caplog.text


# ---------------------------------------------------------------------------------------------------- fits


def test_a_fit_equals_the_command_to_the_last_bit(data, tmp_path):
    """`fit(data, "ssmr", …)` against experiments/train.py with the same settings."""
    import torch

    from ssmr_torch.fitting.checkpoints import load_model

    stored = ssmr.load(data.save(tmp_path / "data.h5"))
    model = ssmr.fit(stored, "ssmr", state_dim=4, transient=0.05, progress=False)
    subprocess.run([sys.executable, ROOT / "experiments" / "train.py", f"data.path={tmp_path / 'data.h5'}",
                    "model=ssmr", "model.state_dim=4", "module.transient=0.05", "logger=csv", "figures=false",
                    f"hydra.run.dir={tmp_path / 'run'}"], check=True, capture_output=True,
                   env=os.environ | {"OMP_NUM_THREADS": str(torch.get_num_threads())})  # sums are split by threads
    trained, card = load_model(tmp_path / "run" / "model.ckpt")
    found = model.module.state_dict()
    assert all(torch.equal(value, found[name]) for name, value in trained.state_dict().items())
    assert card["scores"] == model.card["scores"] and card["name"] == model.name == "SSMR"


def test_a_fit_leaves_the_random_numbers_of_a_notebook_alone_and_writes_nothing(data, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    np.random.seed(7)
    expected = np.random.default_rng(7), np.random.get_state()[1].copy()
    ssmr.fit(data, "dmd", progress=False)
    assert (np.random.get_state()[1] == expected[1]).all() and not list(tmp_path.iterdir())


def test_a_directory_keeps_what_the_command_keeps(data, tmp_path):
    ssmr.fit(data, "dmd", progress=False, directory=tmp_path / "run")
    assert (tmp_path / "run" / "model.ckpt").is_file() and (tmp_path / "run" / "checkpoints" / "closed_form").is_dir()


def test_without_a_kind_it_is_said_which_was_taken(data, capsys):
    model = ssmr.fit(data, state_dim=4)
    assert 'fitting "ssmr"' in capsys.readouterr().out and model.name == "SSMR"


@pytest.mark.parametrize(("kind", "options", "error", "message"), [
    ("smr", {}, ValueError, "no kind of model 'smr'; did you mean 'ssmr'"),
    ("ssmr", {"derivative": "gausian"}, ValueError, "no derivative 'gausian'; did you mean 'gaussian'"),
    ("ssmr", {"ridge": {"dynamic": 0.1}, "state_dim": 4}, ValueError, r"ridge names \[.dynamic.\]; the regr"),
    ("ssmr", {"state_dims": 4}, TypeError, "no option state_dims; did you mean model.state_dim"),
    ("ssmr", {"fit.closed_form.rige": 0.0}, TypeError, "no fit.closed_form.rige; did you mean fit.closed_form.ridge"),
])
def test_options_that_do_not_exist_are_refused_with_the_nearest(data, kind, options, error, message):
    with pytest.raises(error, match=message):
        ssmr.fit(data, kind, progress=False, **options)


def test_a_ridge_may_be_given_for_one_regression_as_on_the_command_line(data):
    model = ssmr.fit(data, "ssmr", state_dim=4, ridge={"dynamics": 0.1}, progress=False)
    ridge = model.card["provenance"]["training"]["configuration"]["fit"]["closed_form"]["ridge"]
    assert ridge["dynamics"] == 0.1 and len(ridge["default"]) > 1


def test_one_output_may_be_named_without_a_list(data):
    assert data.observing("y").output_names == ("y",) and data.columns("y") == [1]


def test_a_controller_takes_the_models_names_and_refuses_others(dmd):
    task, bounds = ssmr.tasks.path([0.0, 0.1], [[0.0], [0.001]], outputs=["y"]), [[-1.0, -1.0], [1.0, 1.0]]
    controller = ssmr.ModelPredictiveController(dmd, task, bounds)
    assert controller.task.columns(dmd.output_names) == (1,)
    for names in (["x", "y"], ["y", "x", "z"]):
        with pytest.raises(ValueError, match="the model has 3 outputs, .*: name these, in this order"):
            ssmr.ModelPredictiveController(dmd, task, bounds, output_names=names)
    with pytest.raises(TypeError, match="settings a dict; expected a model, .* and PredictiveControlSettings"):
        ssmr.ModelPredictiveController(dmd, task, bounds, {"horizon": 3})
    with pytest.raises(TypeError, match="model is a str"):
        ssmr.ModelPredictiveController("artifact", task, bounds)


def test_an_option_of_two_steps_is_refused_with_both_names():
    configuration = {"outputs": None, "model": {"delays": 1}, "module": {"starts": 500},
                     "fit": {"closed_form": {"folds": 5}, "refinement": {"starts": 64, "_target_": "a.b"}}}
    assert dotted({"folds": 3, "fit.refinement.starts": 8}, configuration) == {
        "fit.closed_form.folds": 3, "fit.refinement.starts": 8}
    with pytest.raises(TypeError, match="starts may be module.starts or fit.refinement.starts; say which"):
        dotted({"starts": 3}, configuration)


# ---------------------------------------------------------------------------------------------------- predictions


def test_a_linear_robot_is_predicted_exactly(data, dmd):
    window, inputs, past, measured = started(data, dmd, 5, 100)
    np.testing.assert_allclose(dmd.predict(window, inputs, past), measured, rtol=0, atol=1e-9)


def test_windows_and_inputs_are_broadcast(data, dmd):
    window, inputs, past, _ = started(data, dmd, 5, 30)
    many = dmd.predict(np.stack([window, 0 * window]), inputs, past)
    assert many.shape == (2, 30, 3)
    np.testing.assert_allclose(many[0], dmd.predict(window, inputs, past), rtol=1e-12)


def test_a_model_at_twice_the_sampling_time_predicts_every_sample(data):
    """At its own steps as stepped by hand under the mean of two inputs, halfway in between."""
    model = ssmr.fit(data, "dmd", timestep=2 * DT, progress=False)
    assert model.timestep == pytest.approx(2 * DT) and model.sampling_time == pytest.approx(DT)
    window, inputs, past, measured = started(data, model, 2 * HOLD, 41)
    found = model.predict(window, inputs, past)
    z, outputs = model.reduced.encode(window, past), [window[-1]]
    for k in range(0, 42, 2):
        z = model.reduced.step(z, 0.5 * (inputs[k] + inputs[min(k + 1, 40)]))
        outputs.append(model.reduced.decode(z))
    np.testing.assert_allclose(found[1::2], outputs[1:21], rtol=0, atol=1e-12)
    np.testing.assert_allclose(found[::2], 0.5 * (np.array(outputs[:-1]) + outputs[1:]), rtol=0, atol=1e-12)
    assert found.shape == (41, 3) and np.abs(found - measured).max() < 1e-3


def test_a_model_finer_than_the_recordings_is_asked_for_their_step(data):
    """A model in continuous time, whose artifact says that its recordings are twice as slow as its window."""
    model = ssmr.fit(data, "sssr", state_dim=4, progress=False)
    slower = ssmr.TrainedModel(model.reduced, model.card | {"sampling_time": 2 * DT})
    window, inputs, _, _ = started(data, model, 5, 10)
    every_other = model.predict(window, np.repeat(inputs, 2, axis=0))[1::2]
    np.testing.assert_allclose(slower.predict(window, inputs), every_other, rtol=0, atol=1e-7)


@pytest.mark.parametrize(("arguments", "message"), [
    ({"window": np.zeros((1, 3))}, r"window has shape \(1, 3\); expected \(…, 2, 3\): samples of x, y, z, 0.01 s"),
    ({"inputs": np.zeros((5, 3))}, r"inputs has shape \(5, 3\); expected \(…, H, 2\): left, right, held 0.01 s each"),
    ({"inputs": np.zeros((0, 2))}, "inputs has shape"),
    ({"past_inputs": np.zeros((2, 2))}, r"past_inputs has shape \(2, 2\); expected \(…, 1, 2\)"),
    ({"past_inputs": None}, r"the chart of this model sees the inputs .* give past_inputs \(…, 1, 2\)"),
    ({"window": np.zeros((3, 2, 3)), "inputs": np.zeros((2, 5, 2))}, r"batches of \[\(3,\), \(2,\)"),
    ({"window": np.full((2, 3), np.nan)}, "window holds numbers that are not finite"),
])
def test_arrays_of_another_shape_are_refused_with_what_is_expected(dmd, arguments, message):
    given = {"window": np.zeros((2, 3)), "inputs": np.zeros((4, 2)), "past_inputs": np.zeros((1, 2))} | arguments
    with pytest.raises(ValueError, match=message):
        dmd.predict(**given)


def test_a_model_whose_chart_sees_outputs_alone_needs_no_past_inputs(data):
    model = ssmr.fit(data, "sssr", state_dim=4, progress=False)
    window, inputs, past, _ = started(data, model, 5, 20)
    assert (model.predict(window, inputs) == model.predict(window, inputs, past)).all()


# ---------------------------------------------------------------------------------------------------- scores


def test_persistence_is_scored_as_by_hand(data, dmd):
    table = ssmr.score(dmd, data, horizons=[0.2], starts=10**6)
    y, margin = data.select("test")[0].observation, table["persistence"].margin
    errors = [np.sqrt(((y[k + 1:k + 21] - y[k]) ** 2).sum(axis=1).mean()) for k in range(margin, len(y) - 20)]
    found = table["persistence"]["200 ms"]
    assert found.mean == pytest.approx(np.mean(errors), rel=1e-12) and len(found.errors) == len(errors)
    assert list(table) == ["DMD", "persistence", "constant velocity"] and table["DMD"]["full"].mean < 1e-9


def test_several_models_are_scored_from_the_same_starts(data, dmd):
    table = ssmr.score({"one": dmd, "two": dmd}, data, starts=20)
    assert (table["one"]["1 s"].errors == table["two"]["1 s"].errors).all() and len(table) == 4
    assert "<td>persistence</td>" in table._repr_html_() and "RMSE in mm" in repr(table)


@pytest.mark.parametrize("given", ["trajectories.h5", [], None])
def test_what_is_no_dataset_or_no_model_is_refused_by_name(data, dmd, given):
    with pytest.raises(TypeError, match="expected a TrajectoryDataset, which read, load and"):
        ssmr.score(dmd, given)
    with pytest.raises(TypeError, match="expected a TrajectoryDataset, which read, load and"):
        ssmr.fit(given, "dmd", progress=False)
    with pytest.raises(TypeError, match="is no model; expected what fit or load returns"):
        ssmr.score({"one": dmd, "other": given}, data)


def test_data_without_test_runs_or_of_another_robot_are_refused(data, dmd):
    with pytest.raises(ValueError, match="no run of split='validation' to score on, only"):
        ssmr.score(dmd, data, split="validation")
    other = ssmr.trajectories(**linear_robot(), output_names=["x", "y", "z"], units={"length": "mm"})
    with pytest.raises(ValueError, match="inputs"):
        ssmr.score(dmd, other)


# ---------------------------------------------------------------------------------------------------- files


def test_a_saved_model_predicts_the_same_and_keeps_its_card(data, dmd, tmp_path):
    loaded = ssmr.load(dmd.save(tmp_path / "artifact"))
    given = started(data, dmd, 5, 50)[:3]
    assert (loaded.predict(*given) == dmd.predict(*given)).all()
    for name in ("name", "output_names", "input_names", "input_unit", "sampling_time", "scores", "delays"):
        assert getattr(loaded, name) == getattr(dmd, name), name
    assert loaded.module is None and dmd.module is not None and not loaded.report and dmd.report
    again = ssmr.load(loaded.save(tmp_path / "again"))
    assert again.card["provenance"] == loaded.card["provenance"]


def test_a_model_is_exported_with_its_artifact_or_not_at_all(dmd, tmp_path):
    with pytest.raises(ValueError, match="no format"):
        dmd.export(tmp_path / "artifact", "fortran")
    with pytest.raises(ValueError, match="not by name; expected some of them"):
        dmd.export(tmp_path / "artifact", ["c", "onnx"])
    assert not (tmp_path / "artifact").exists()
    dmd.export(tmp_path / "artifact", "c")
    assert list((tmp_path / "artifact" / "deployed").glob("*.c")) and ssmr.load(tmp_path / "artifact").name == "DMD"


def test_a_path_is_loaded_by_what_is_found_there(data, tmp_path):
    path = data.save(tmp_path / "any.name")
    assert isinstance(ssmr.load(path), ssmr.TrajectoryDataset)
    task = ssmr.tasks.path([0.0, 0.1], [[0.0], [0.01]], outputs=["tip_x"])

    class Still:
        period = DT
        reset = staticmethod(lambda: None)

        def __call__(self, time, observation):
            from ssmr_torch.control.base import Command

            return Command(np.zeros(4))

    record = ssmr.simulate(ssmr.plants.SlowManifold(), Still(), task, noise=1e-4, seed=3)
    loaded = ssmr.load(record.save(tmp_path / "record.h5"))
    assert isinstance(loaded, ssmr.ClosedLoopRecord) and loaded.provenance["noise_std"] == 1e-4


@pytest.mark.parametrize(("name", "content", "message"), [
    ("model.ckpt", b"PK", "a checkpoint: ssmr export checkpoint=FILE"), ("robot.yaml", b"files: []", "a card perhaps"),
    ("table.csv", b"t,x", "no file of this package; expected an artifact")])
def test_what_is_none_of_these_is_refused_with_what_it_is(tmp_path, name, content, message):
    (tmp_path / name).write_bytes(content)
    with pytest.raises(ValueError, match=message):
        ssmr.load(tmp_path / name)
    with pytest.raises(ValueError, match=rf"is a folder with \['{name}'\]; expected"):
        ssmr.load(tmp_path)
    with pytest.raises(FileNotFoundError, match="nothing at"):
        ssmr.load(tmp_path / "nowhere")


# ---------------------------------------------------------------------------------------------------- tasks


def test_a_path_of_ones_own_is_followed_and_held_at_its_end():
    task = ssmr.tasks.path([0.5, 1.0], [[0.0, 0.0], [0.02, -0.01]], outputs=["tip_x", "tip_y"])
    np.testing.assert_allclose(task.reference([0.0, 0.75, 9.0]), [[0.0, 0.0], [0.01, -0.005], [0.02, -0.01]])
    assert task.tracked == ("tip_x", "tip_y") and task.duration == 1.0


@pytest.mark.parametrize(("times", "points", "message"), [
    ([0.0, 1.0], [[0.0], [0.0]], r"points of shape \(2, 1\) for 2 outputs .* expected \(T,\) and \(T, 2\)"),
    ([0.0, 0.0], [[0.0, 0.0]] * 2, "expected two or more that increase"),
    ([0.0, np.nan], [[0.0, 0.0]] * 2, "not finite")])
def test_paths_that_cannot_be_are_refused(times, points, message):
    with pytest.raises(ValueError, match=message):
        ssmr.tasks.path(times, points, outputs=["x", "y"])


@pytest.mark.parametrize("namespace", [ssmr.plants, ssmr.tasks])
def test_plants_and_tasks_list_what_exists(namespace):
    assert dir(namespace) == sorted(namespace.__all__) and all(getattr(namespace, name) for name in dir(namespace))
