"""An artifact that was damaged, forged or is of another version is refused, and the message says why."""

import hashlib
import json
import shutil
from pathlib import Path

import numpy as np
import pytest
from safetensors.numpy import load_file, save_file

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
    (saved / "card.json").write_text(json.dumps(card))
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
    (saved / "card.json").write_text(json.dumps(json.loads((saved / "card.json").read_text()) | change))
    with pytest.raises(ValueError, match=f"'{value}'.*reads '{artifact.FORMAT}', and '{artifact.BEFORE}' of"):
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
            (directory / "card.json").write_text(json.dumps(forged))
        try:
            artifact.load(directory)  # what changed may say nothing of the model, such as a name
        except ValueError as error:
            assert type(error) is ValueError and str(directory) in str(error) and "\n" not in str(error)
