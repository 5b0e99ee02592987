"""An artifact that was damaged, forged or is of another version is refused, and the message says why."""

import hashlib
import json
import shutil
from pathlib import Path

import numpy as np
import pytest
from safetensors.numpy import load_file, save_file

from ssmr_torch.checksum import Damaged, sealed_json
from ssmr_torch.deployment import artifact

WRITTEN_BEFORE = Path(__file__).parents[1] / "written_by_0_7" / "SSMR" / "artifact"


@pytest.fixture
def saved(tmp_path):
    """The model that version 0.7 wrote, saved by this one."""
    old = artifact.load(WRITTEN_BEFORE)
    return artifact.save(tmp_path / "model", old.model, **{
        name: old.card[name] for name in ("output_names", "input_names", "rest", "input_range")})


@pytest.mark.parametrize("table", ["chart", "parametrization", "dynamics"])
def test_a_table_that_was_changed_is_refused_by_its_hash_and_if_that_is_forged_by_the_replay(saved, table, rewrite):
    def nudge(arrays):
        arrays[table] = arrays[table] + 1e-6 * np.abs(arrays[table]).max()

    original = (saved / "tables.safetensors").read_bytes()
    arrays = load_file(saved / "tables.safetensors")
    nudge(arrays)
    save_file(arrays, saved / "tables.safetensors")
    with pytest.raises(ValueError, match="tables.safetensors is missing or differs from the hash in the card"):
        artifact.load(saved)
    (saved / "tables.safetensors").write_bytes(original)
    artifact.load(saved)
    rewrite(saved, arrays=nudge)
    with pytest.raises(ValueError, match=r"stored reference prediction: \w+ differs by .* relative; at most 1e-09"):
        artifact.load(saved)


def test_a_table_that_became_nan_is_refused_by_the_replay(saved, rewrite):
    rewrite(saved, arrays=lambda arrays: arrays["dynamics"].__setitem__((0, 0), np.nan))
    with pytest.raises(ValueError, match="differs by nan"):
        artifact.load(saved)


@pytest.mark.parametrize("file", ["tables.safetensors", "reference.safetensors"])
@pytest.mark.parametrize("damage", ["missing", "truncated", "empty"])
def test_damaged_files_are_refused(saved, file, damage):
    content = (saved / file).read_bytes()
    (saved / file).unlink()
    if damage != "missing":
        (saved / file).write_bytes(content[:-8] if damage == "truncated" else b"")
    with pytest.raises(ValueError, match=f"{file} is missing or differs"):
        artifact.load(saved)
    card = json.loads((saved / "card.json").read_text())
    del card["sha256"][file]
    (saved / "card.json").write_text(sealed_json(card))
    with pytest.raises(ValueError, match=f"{file} is missing or differs"):
        artifact.load(saved)


@pytest.mark.parametrize(("text", "message"), [
    ("{not json", "not valid JSON"), ("", "not valid JSON"), ("[]", "not the card of an artifact"),
    ("{}", "it has no format, kind"), ('"text"', "not the card of an artifact"), (b"\xff{}", "not valid JSON")])
def test_a_file_that_is_not_a_card_is_refused(saved, text, message):
    (saved / "card.json").write_bytes(text if isinstance(text, bytes) else text.encode())
    with pytest.raises(ValueError, match=message):
        artifact.load(saved)


@pytest.mark.parametrize(("change", "value"), [
    ({"format": "ssmr_torch artifact 1"}, "ssmr_torch artifact 1"),
    ({"format": artifact.BEFORE, "kind": "neural"}, "neural")])
def test_another_format_is_refused_with_both_names(saved, change, value):
    (saved / "card.json").write_text(sealed_json(json.loads((saved / "card.json").read_text()) | change))
    with pytest.raises(ValueError, match=f"'{value}'.*reads '{artifact.FORMAT}', .*and '{artifact.BEFORE}' of"):
        artifact.load(saved)


@pytest.mark.parametrize(("named", "message"), [
    ("robot_of_mine:Model", "which is not installed here.*install its package"),
    ("json:JSONDecoder", "is not a model; export"), ("json", "is not a model; export")])
def test_a_model_whose_class_is_not_installed_or_not_a_model_is_refused(saved, named, message, rewrite):
    rewrite(saved, noted=lambda noted: noted.update({"class": named}))
    with pytest.raises(ValueError, match=message):
        artifact.load(saved)


@pytest.mark.parametrize("file", ["card.json", "tables.safetensors", "reference.safetensors"])
@pytest.mark.parametrize("version", ["now", "0.7"])
def test_a_changed_bit_or_a_missing_end_is_refused_in_one_sentence_even_with_a_forged_hash(saved, tmp_path, file,
                                                                                           version):
    directory, rng = tmp_path / "artifact", np.random.default_rng(0)
    shutil.copytree(saved if version == "now" else WRITTEN_BEFORE, directory)
    card, content = (directory / "card.json").read_bytes(), (directory / file).read_bytes()
    for trial in range(40):
        damaged = bytearray(content if trial % 4 else content[:rng.integers(len(content))])
        if trial % 4:
            damaged[rng.integers(min(len(content), 3000))] ^= 1 << rng.integers(8)
        (directory / "card.json").write_bytes(card)
        (directory / file).write_bytes(damaged)
        if file != "card.json":
            forged = json.loads(card)
            forged["sha256"][file] = hashlib.sha256(damaged).hexdigest()
            forged = sealed_json(forged) if "checksum" in forged else json.dumps(forged)
            (directory / "card.json").write_text(forged)
        try:
            artifact.load(directory)  # what changed may say nothing of the model, such as a name
        except ValueError as error:
            assert type(error) in (ValueError, Damaged) and str(directory) in str(error) and "\n" not in str(error)


def test_any_change_of_the_card_is_refused_and_so_is_a_card_whose_checksum_was_removed(saved):
    card = (saved / "card.json").read_text()
    for old, new in (('"delays": ', '"delays":  '), ('"timestep": 0', '"timestep": 1'), ("}\n", "}"), ('"N"', '"M"')):
        assert old in card
        (saved / "card.json").write_text(card.replace(old, new))
        with pytest.raises(Damaged, match="damaged or was edited: its text differs from its checksum"):
            artifact.load(saved)
    content = json.loads(card)
    del content["checksum"]
    (saved / "card.json").write_text(json.dumps(content, indent=2))
    with pytest.raises(Damaged, match="its format 'ssmr_torch artifact 4' has a checksum, which is missing"):
        artifact.load(saved)


@pytest.mark.parametrize("version", [artifact.WITHOUT_CHECKSUM, artifact.BEFORE])
def test_an_artifact_of_an_earlier_version_loads_and_the_log_says_that_it_has_no_checksum(saved, caplog, version):
    content = json.loads((saved / "card.json").read_text())
    del content["checksum"]
    (saved / "card.json").write_text(json.dumps(content | {"format": version}))
    directory = saved if version == artifact.WITHOUT_CHECKSUM else WRITTEN_BEFORE
    artifact.load(directory)
    assert [record.getMessage() for record in caplog.records] == [
        f"{directory / 'card.json'} carries no checksum ({version}); damage to it may go unseen until it is written "
        "again"]


def seal_again(directory, **changes):
    (directory / "card.json").write_text(sealed_json(json.loads((directory / "card.json").read_text()) | changes))


@pytest.mark.parametrize(("changes", "says"), [
    ({"rest": [0.0]}, r"has rest: \[0.0\], which does not fit a model of"), ({"rest": ["a"] * 3}, "has rest"),
    ({"output_names": [1, 2, 3]}, "has output_names"), ({"input_range": [[0.0], [-1.0]]}, "has input_range"),
    ({"units": {}}, "has units"), ({"sampling_time": -1.0}, "has sampling_time"),
    ({"scores": {"a": "b"}}, "has scores"), ({"provenance": [1]}, "has provenance"),
    ({"output_range": [[0, 1]]}, "has output_range")])
def test_a_card_whose_entries_do_not_fit_the_model_is_refused_by_name_even_with_a_right_checksum(saved, changes, says):
    seal_again(saved, **changes)
    with pytest.raises(ValueError, match=says):
        artifact.load(saved)


@pytest.mark.parametrize(("plain", "says"), [
    ({"substeps": 10 ** 9}, "substeps is 1000000000; expected .* at most 2000"),
    ({"substeps": 1.5}, "substeps is 1.5"), ({"delays": 10 ** 9}, "delays is 1e.09; expected at most 5000"),
    ({"delays": True}, "delays is True"), ({"timestep": 1e300}, "timestep 1e.300 s"),
    ({"structure": [[[[0]]]]}, "does not hold what"),
    ({"output_dim": 10 ** 12}, "output_dim is 1e.12; expected at most")])
def test_sizes_that_would_fill_the_memory_or_never_end_are_refused_at_once(saved, rewrite, plain, says):
    rewrite(saved, noted=lambda noted: noted["plain"].update(plain))
    with pytest.raises(ValueError, match=says):
        artifact.load(saved)


@pytest.mark.parametrize(("setting", "value"), [
    ("dynamics_degree", 50), ("dynamics_degree", 10 ** 9), ("chart_degree", 20), ("delays", 10 ** 9),
    ("substeps", 10 ** 9), ("control_degree", 40)])
def test_degrees_and_sizes_in_the_card_of_an_old_artifact_are_refused_at_once(tmp_path, setting, value):
    shutil.copytree(WRITTEN_BEFORE, tmp_path / "old")
    card = json.loads((tmp_path / "old" / "card.json").read_text())
    card["model"][setting] = value
    (tmp_path / "old" / "card.json").write_text(json.dumps(card))
    with pytest.raises(ValueError, match="does not hold what a model of the kind polynomial needs"):
        artifact.load(tmp_path / "old")


def test_a_monomial_with_too_many_divisors_is_refused_at_once(saved, rewrite):
    def many(noted):
        variables = noted["plain"]["structure"]["dynamics"][0]
        noted["plain"]["structure"]["dynamics"] = [30, [list(range(30))] if variables else []]

    rewrite(saved, noted=many)
    with pytest.raises(ValueError, match="more than 50000 divisors"):
        artifact.load(saved)


def test_a_class_that_was_not_written_for_this_package_is_not_imported_for_a_file(saved, rewrite, tmp_path,
                                                                                  monkeypatch):
    (tmp_path / "stranger.py").write_text("import pathlib\npathlib.Path(__file__).with_suffix('.ran').touch()\n"
                                          "class Model: pass\n")
    monkeypatch.syspath_prepend(tmp_path)
    for named in ("stranger:Model", "antigravity:Model", "ssmr_torch.wire.runner:main"):
        rewrite(saved, noted=lambda noted, named=named: noted.update({"class": named}))
        with pytest.raises(ValueError, match="was not written for ssmr_torch|is not installed here"):
            artifact.load(saved)
    assert not (tmp_path / "stranger.ran").exists()


def test_a_changed_program_in_an_artifact_is_refused_and_one_that_was_removed_is_not_missed(saved):
    artifact.add_files(saved, lambda copy: ((copy / "deployed").mkdir(), (copy / "deployed" / "a.c").write_text("1")))
    artifact.load(saved)
    (saved / "deployed" / "a.so").write_bytes(b"what a user compiled")
    artifact.load(saved)
    (saved / "deployed" / "a.c").write_text("2")
    with pytest.raises(ValueError, match="a.c differs from the hash in the card; .* remove the folder"):
        artifact.load(saved)
    shutil.rmtree(saved / "deployed")
    artifact.load(saved)
