"""What is deployed: a directory that is complete, replays its reference, and needs no training libraries."""

import json
import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from ssmr_torch.deployment import artifact, whole_directory
from ssmr_torch.fitting.checkpoints import load_model
from ssmr_torch.models.monomials import count_monomials
from ssmr_torch.models.named_structures import spectral_submanifold
from ssmr_torch.models.polynomial import PolynomialModel

DATA = {"output_names": ["x", "y", "z"], "input_names": ["u1", "u2"], "rest": [0.1, 0.0, 1 / 3],
        "input_range": [[0.0, -1.0], [1.0, 2.0]]}


def tables(n=4, m=2, p=3, delays=2, chart=1, parametrization=2, dynamics=3, control=1, seed=0):
    rng = np.random.default_rng(seed)
    window = (delays + 1) * p
    frame = np.linalg.qr(rng.normal(size=(window, n))).Q
    w = 0.3 * rng.normal(size=(window, count_monomials(n, 1, parametrization)))
    w[:, :n] = frame
    v = 0.01 * rng.normal(size=(n, count_monomials(window, 1, chart)))
    v[:, :window] = frame.T
    return spectral_submanifold(
        chart=v, parametrization=w, drift=rng.normal(size=(n, count_monomials(n, 1, dynamics))),
        control=rng.normal(size=(n, m * (1 + count_monomials(n, 1, control)))), state_scale=np.full(n, 0.05),
        chart_degree=chart, parametrization_degree=parametrization, dynamics_degree=dynamics, control_degree=control,
        input_dim=m, output_dim=p, delays=delays, timestep=0.02, window_timestep=0.01, substeps=2)


MODELS = {"curved": tables(), "linear": tables(parametrization=1, dynamics=1, control=0),
          "without delays": tables(n=2, delays=0), "curved chart": tables(chart=2, control=2)}


@pytest.fixture
def saved(tmp_path):
    return artifact.save(tmp_path / "model", MODELS["curved"], **DATA, name="ours", input_unit="1",
                         provenance={"commit": "abc+"}, scores={"validation/rmse": 1e-4})


def card_of(directory):
    return json.loads((directory / "card.json").read_text())


def test_the_card_says_whether_the_manifold_is_curved(tmp_path):
    said = {}
    for name, model in MODELS.items():
        artifact.save(tmp_path / "model", model, **DATA)
        said[name] = card_of(tmp_path / "model")["geometry"]
    assert said["curved"].endswith("p = 9 > n = 4, parametrization of degree 2: a curved manifold")
    assert said["linear"].endswith("p = 9 > n = 4, parametrization of degree 1: a flat manifold")


@pytest.mark.parametrize("name", MODELS)
def test_the_loaded_model_has_the_same_tables_and_predicts_the_same(name, tmp_path):
    model = MODELS[name]
    loaded = artifact.load(artifact.save(tmp_path / "deep" / "model", model, **DATA)).model
    assert type(loaded) is PolynomialModel and loaded.plain() == model.plain()
    for table, array in model.arrays.items():
        np.testing.assert_array_equal(loaded.arrays[table], array)
    rng = np.random.default_rng(1)
    z, inputs = 0.02 * rng.normal(size=(5, model.state_dim)), rng.uniform(size=(5, 30, 2))
    window = 0.02 * rng.normal(size=(5, model.delays + 1, 3))
    np.testing.assert_allclose(loaded.states(z, inputs), model.states(z, inputs), rtol=1e-12)
    np.testing.assert_allclose(loaded.encode(window, None), model.encode(window, None), rtol=1e-12)
    for ours, theirs in zip(loaded.linearize(z, inputs[:, 0]), model.linearize(z, inputs[:, 0]), strict=True):
        np.testing.assert_allclose(ours, theirs, rtol=1e-12)


def test_the_card_says_what_the_model_is_in_plain_json(saved):
    card = card_of(saved)
    assert card["units"] == {"length": "m", "time": "s", "input": "1"}
    assert card["model"] == {"input_dim": 2, "output_dim": 3, "delays": 2, "timestep": 0.02, "window_timestep": 0.01,
                             "base_timestep": None, "substeps": 2, "coordinates": None, "reach": 1.0,
                             "state_dim": 4}
    assert card["class"] == "ssmr_torch.models.polynomial:PolynomialModel" and card["sampling_time"] == 0.01
    assert {key: card[key] for key in DATA} == DATA
    assert (card["format"], card["kind"], card["name"]) == (artifact.FORMAT, "polynomial", "ours")
    assert card["provenance"] == {"commit": "abc+"} and card["scores"] == {"validation/rmse": 1e-4}
    assert artifact.load(saved).card == card


def test_the_same_model_has_the_same_hash_in_every_process(tmp_path):
    program = (f"from ssmr_torch.deployment import artifact; model = artifact.load({str(tmp_path / 'first')!r}).model; "
               f"print(artifact.save({str(tmp_path / 'again')!r}, model, **{DATA!r}))")
    artifact.save(tmp_path / "first", MODELS["curved"], **DATA)
    for _ in range(3):
        subprocess.run([sys.executable, "-c", program], check=True, capture_output=True)
        assert card_of(tmp_path / "again")["sha256"] == card_of(tmp_path / "first")["sha256"]


def test_nothing_in_an_artifact_is_a_pickle(saved):
    assert sorted(path.name for path in saved.iterdir()) == ["card.json", "reference.safetensors",
                                                             "tables.safetensors"]
    for file in ("tables.safetensors", "reference.safetensors"):
        content = (saved / file).read_bytes()
        header = json.loads(content[8:8 + int.from_bytes(content[:8], "little")])
        arrays = [value for key, value in header.items() if key != "__metadata__"]
        assert all(value["dtype"] == "F64" for value in arrays)
        end = max(value["data_offsets"][1] for value in arrays)
        assert len(content) == 8 + int.from_bytes(content[:8], "little") + end


@pytest.mark.parametrize("name", MODELS)
def test_rounding_of_another_machine_is_accepted(name, tmp_path, rewrite):
    """Also of the constant term of a linear model, which is rounding altogether."""
    saved = artifact.save(tmp_path / "model", MODELS[name], **DATA)
    rng = np.random.default_rng(2)

    def round_differently(arrays):
        size = {key: np.abs(arrays[key]).max(initial=0.0) for key in arrays}
        size["c"] = size["following"]
        for key in ("encoded", "decoded", "following", "A", "B", "c"):
            arrays[key] = arrays[key] + 4e-16 * size[key] * rng.choice([-1, 1], arrays[key].shape)

    rewrite(saved, "reference.safetensors", arrays=round_differently)
    np.testing.assert_array_equal(artifact.load(saved).model.dynamics, MODELS[name].dynamics)


def test_a_setting_that_is_newer_than_the_artifact_gets_its_default(tmp_path, rewrite):
    at = artifact.save(tmp_path / "old", replace(MODELS["curved"], substeps=1), **DATA)

    rewrite(at, noted=lambda noted: noted["plain"].pop("substeps"))
    assert artifact.load(at).model.substeps == 1


@pytest.mark.parametrize("path", sorted((Path(__file__).parents[1] / "written_by_0_7").glob("*/")),
                         ids=lambda path: path.name)
def test_artifacts_and_checkpoints_of_earlier_versions_load_and_predict_what_they_did(path, tmp_path):
    """Each folder was written by version 0.7.1; loading replays what that version predicted."""
    loaded = artifact.load(path / "artifact")
    again = artifact.load(artifact.save(tmp_path / "again", loaded.model, **{key: loaded.card[key] for key in DATA}))
    batch = artifact.reference(path / "artifact")
    np.testing.assert_array_equal(again.model.step(batch["state"], batch["input"]),
                                  loaded.model.step(batch["state"], batch["input"]))
    assert again.card["format"] == artifact.FORMAT != loaded.card["format"]
    trained, card = load_model(path / "model.ckpt")
    assert card["output_names"] == loaded.card["output_names"]
    np.testing.assert_allclose(trained.reduced.numpy().step(batch["state"], batch["input"]), batch["following"],
                               rtol=1e-12, atol=1e-15)


def test_a_missing_artifact_is_refused_with_its_path(tmp_path):
    for path in (tmp_path / "absent", tmp_path):
        with pytest.raises(FileNotFoundError, match="no card.json.*ssmr export"):
            artifact.load(path)


def test_an_artifact_is_replaced_whole(saved):
    artifact.save(saved, MODELS["linear"], **DATA, name="newer")
    loaded = artifact.load(saved)
    assert loaded.card["name"] == "newer" and loaded.model.structure.dynamics.highest == 1
    assert [path.name for path in saved.parent.iterdir()] == [saved.name]


def test_files_that_do_not_belong_to_an_artifact_are_never_overwritten(saved, tmp_path):
    (saved / "notes.txt").write_text("mine")
    with pytest.raises(ValueError, match=r"exists and holds \['notes.txt'\], which do not belong to an artifact"):
        artifact.save(saved, MODELS["linear"], **DATA)
    assert (saved / "notes.txt").read_text() == "mine" and artifact.load(saved).card["name"] == "ours"
    file = tmp_path / "file"
    file.write_text("mine")
    with pytest.raises(ValueError, match="choose another directory"):
        artifact.save(file, MODELS["linear"], **DATA)
    assert file.read_text() == "mine"
    (tmp_path / "empty").mkdir()
    artifact.load(artifact.save(tmp_path / "empty", MODELS["linear"], **DATA))


def test_a_save_that_is_interrupted_leaves_the_old_artifact_as_it_was(saved, monkeypatch):
    def interrupted(*arguments):
        raise KeyboardInterrupt

    for place, step in ((artifact, "save_tables"), (artifact, "_predict"), (whole_directory, "_replace")):
        monkeypatch.setattr(place, step, interrupted)
        with pytest.raises(KeyboardInterrupt):
            artifact.save(saved, MODELS["linear"], **DATA)
        monkeypatch.undo()
        assert artifact.load(saved).card["name"] == "ours"
    artifact.save(saved, MODELS["linear"], **DATA)
    assert artifact.load(saved).model.structure.dynamics.highest == 1


@pytest.mark.parametrize(("change", "message"), [
    ({"output_names": ["x"]}, "1 output names and a rest of shape \\(3,\\) were given; the model has 3 outputs"),
    ({"rest": [0.0]}, "rest of shape \\(1,\\)"), ({"input_names": []}, "0 input names"),
    ({"input_range": [[0.0], [1.0]]}, "bounds of shape \\(2, 1\\) were given; the model has 2 inputs"),
    ({"input_range": [[0.0, 1.0], [1.0, 1.0]]}, "lowest below highest")])
def test_a_card_that_contradicts_the_model_is_refused_before_anything_is_written(tmp_path, change, message):
    with pytest.raises(ValueError, match=message):
        artifact.save(tmp_path / "model", MODELS["curved"], **(DATA | change))
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(("table", "value"), [("dynamics", np.nan), ("state_scale", np.inf)])
def test_a_model_that_was_never_fitted_is_refused(tmp_path, table, value):
    broken = replace(MODELS["curved"], **{table: np.full_like(getattr(MODELS["curved"], table), value)})
    with pytest.raises(ValueError, match=f"the table {table} is not finite; fit the model"):
        artifact.save(tmp_path / "model", broken, **DATA)
    assert not list(tmp_path.iterdir())


def test_models_are_told_apart_by_name_and_compared_on_the_same_outputs_only(saved):
    one = artifact.load(saved)
    assert list(artifact.by_name([one, one, one])) == ["ours", "ours 2", "ours 3"]
    assert artifact.common_outputs([one, one]) == ["x", "y", "z"]
    other = artifact.Artifact(one.model, one.card | {"output_names": ["x"]})
    with pytest.raises(ValueError, match=r"different outputs \[\['x', 'y', 'z'\], \['x'\]\]"):
        artifact.common_outputs([one, other])


@pytest.mark.parametrize(("change", "message"), [
    ({"output_names": ("x", "y", "tip")}, "outputs \\['x', 'y', 'z'\\], but this robot or data has \\['x'"),
    ({"input_names": ("u1",)}, "inputs"), ({"input_unit": "N"}, "input unit 1, but this robot or data has N")])
def test_a_plant_of_other_outputs_inputs_or_units_is_refused(saved, change, message):
    plant = {"output_names": ("x", "y", "z"), "input_names": ("u1", "u2"), "input_unit": "1"}
    artifact.check_source(artifact.load(saved), SimpleNamespace(**plant))
    with pytest.raises(ValueError, match=message):
        artifact.check_source(artifact.load(saved), SimpleNamespace(**(plant | change)))


def test_an_artifact_runs_where_no_training_library_is_installed(saved):
    program = f"""
import sys
for name in ("torch", "lightning", "hydra", "omegaconf", "wandb", "matplotlib", "sklearn"):
    sys.modules[name] = None
import numpy as np
from ssmr_torch.deployment import artifact
model = artifact.load({str(saved)!r}).model
print(model.step(np.full(4, 0.01), np.ones(2)).tolist())
"""
    output = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True).stdout
    expected = MODELS["curved"].step(np.full(4, 0.01), np.ones(2))
    np.testing.assert_allclose(json.loads(output), expected, rtol=1e-12)


def test_a_score_that_is_infinite_because_rollouts_diverge_is_stored_as_null(tmp_path):
    path = artifact.save(tmp_path / "model", MODELS["curved"], **DATA, scores={"test/rmse": float("inf")})
    assert artifact.load(path).card["scores"] == {"test/rmse": None}


def test_the_permissions_are_those_that_the_user_asks_for(tmp_path):
    for mask, folder, file in ((0o022, 0o755, 0o644), (0o077, 0o700, 0o600), (0o002, 0o775, 0o664)):
        before = os.umask(mask)
        try:
            path = artifact.save(tmp_path / "model", MODELS["curved"], **DATA)
            assert path.stat().st_mode & 0o777 == folder
            assert {each.stat().st_mode & 0o777 for each in path.iterdir()} == {file}
        finally:
            os.umask(before)


def test_of_several_processes_that_save_to_one_place_at_once_one_wins_whole(tmp_path):
    source = artifact.save(tmp_path / "source", MODELS["curved"], **DATA)
    program = """
import sys
from ssmr_torch.deployment import artifact
loaded = artifact.load(sys.argv[1])
keep = {key: loaded.card[key] for key in ("output_names", "input_names", "rest", "input_range")}
for number in range(8):
    artifact.save(sys.argv[2], loaded.model, name=sys.argv[3], **keep)
    artifact.load(sys.argv[2])  # never half of one and half of another, and never missing
"""
    artifact.save(tmp_path / "model", MODELS["curved"], **DATA)
    running = [subprocess.Popen([sys.executable, "-c", program, str(source), str(tmp_path / "model"), name],
                                stderr=subprocess.PIPE, text=True) for name in ("one", "two", "three")]
    ended = [(process.communicate()[1], process.returncode) for process in running]
    assert [code for _, code in ended] == [0, 0, 0], ended
    assert artifact.load(tmp_path / "model").card["name"] in ("one", "two", "three")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["model", "source"]


def test_where_directories_cannot_be_exchanged_in_one_step_they_are_replaced_all_the_same(saved, monkeypatch):
    monkeypatch.setattr(whole_directory, "_exchanged", lambda one, other: False)
    artifact.save(saved, MODELS["linear"], **DATA, name="newer")
    assert artifact.load(saved).card["name"] == "newer"
    assert [path.name for path in saved.parent.iterdir()] == [saved.name]


def test_an_artifact_behind_a_link_is_replaced_where_it_lies(saved, tmp_path):
    (tmp_path / "link").symlink_to(saved)
    artifact.save(tmp_path / "link", MODELS["linear"], **DATA, name="newer")
    assert (tmp_path / "link").is_symlink() and artifact.load(saved).card["name"] == "newer"
