"""Claims about the face of the package: what it costs, its ten statements, files and tasks."""

import ast
import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from linear_robot import DT, started, write_card

import ssmr_torch as ssmr

ROOT = Path(__file__).resolve().parents[2]
HEAVY = ("numpy", "torch", "lightning", "hydra", "omegaconf", "numba", "scipy", "h5py", "yaml", "tqdm", "safetensors",
         "matplotlib", "pandas")


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


README = (ROOT / "README.md").read_text(encoding="utf-8")
NOTEBOOK = README.partition("```python\n")[2].partition("```")[0]


@pytest.mark.parametrize("fit", [pytest.param("ssmr.fit(data)", marks=pytest.mark.slow), 'ssmr.fit(data, "ssmr")'])
def test_read_fit_predict_score_and_save_take_one_import_and_ten_statements(fit, tmp_path, monkeypatch, capsys):
    statements = ast.parse(NOTEBOOK).body
    assert len(statements) <= 10 and sum(isinstance(each, ast.Import) for each in statements) == 1
    write_card(tmp_path)
    monkeypatch.chdir(tmp_path)
    done = {}
    assert NOTEBOOK.count("ssmr.fit(data)") == 1
    exec(NOTEBOOK.replace("ssmr.fit(data)", fit), done)
    error = np.linalg.norm(done["prediction"] - done["run"].observation[done["d"] + 1:done["d"] + 101], axis=1)
    assert error.shape == (100,) and error.max() < 5e-3 and "persistence" in capsys.readouterr().out
    assert (tmp_path / "artifact" / "card.json").is_file() and not (tmp_path / "outputs").exists()


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
    with pytest.raises(ValueError, match="no formats were given by name; expected one or more"):
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


def test_a_path_of_ones_own_is_followed_and_held_at_its_end():
    task = ssmr.tasks.path([0.5, 1.0], [[0.0, 0.0], [0.02, -0.01]], outputs=["tip_x", "tip_y"])
    np.testing.assert_allclose(task.reference([0.0, 0.75, 9.0]), [[0.0, 0.0], [0.01, -0.005], [0.02, -0.01]])
    assert task.tracked == ("tip_x", "tip_y") and task.duration == 1.0


@pytest.mark.parametrize(("times", "points", "message"), [
    ([0.0, 1.0], [[0.0], [0.0]], r"points of shape \(2, 1\) for 2 outputs .* expected \(T,\) and \(T, 2\)"),
    ([0.0, 0.0], [[0.0, 0.0]] * 2, "expected two or more, increasing"),
    ([0.0, np.nan], [[0.0, 0.0]] * 2, "not finite")])
def test_paths_that_cannot_be_are_refused(times, points, message):
    with pytest.raises(ValueError, match=message):
        ssmr.tasks.path(times, points, outputs=["x", "y"])


@pytest.mark.parametrize("namespace", [ssmr.plants, ssmr.tasks])
def test_plants_and_tasks_list_what_exists(namespace):
    assert dir(namespace) == sorted(namespace.__all__) and all(getattr(namespace, name) for name in dir(namespace))
