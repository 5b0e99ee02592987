"""No damage to a file of ours goes unseen; `python tests/flipped_files.py 10000` does the same 10,000 times a file."""

import os

import pytest
from flipped_files import WRITTEN_BEFORE, outcomes, written_files

FLIPS = int(os.environ.get("SSMR_TORCH_FLIPS", 60))  # of each file


@pytest.fixture(scope="module")
def written(tmp_path_factory):
    return written_files(tmp_path_factory.mktemp("written"))


@pytest.mark.parametrize("kind", [
    "artifact: card.json", "artifact: tables.safetensors", "artifact: reference.safetensors",
    "artifact: controller.json", "artifact: deployed/model.c", "checkpoint", "copy of a checkpoint", "trajectories",
    "closed-loop record", "results", "found settings"])
def test_a_damaged_file_is_refused_or_what_it_says_is_unchanged_or_the_log_says_so(written, kind):
    found, bad = outcomes(written[kind], FLIPS)
    assert not bad and found["wrong"] == found["traceback"] == 0, (found, bad[:3])
    if kind != "found settings":  # a table that a person may edit
        assert found["refused"] == FLIPS


def test_what_earlier_versions_wrote_has_no_checksum_and_is_read(caplog):
    from ssmr_torch.deployment import artifact
    from ssmr_torch.fitting.checkpoints import load_model

    artifact.load(WRITTEN_BEFORE / "artifact")
    load_model(WRITTEN_BEFORE / "model.ckpt")
    assert [record.getMessage().split(";")[0] for record in caplog.records] == [
        f"{WRITTEN_BEFORE / 'artifact' / 'card.json'} carries no checksum (ssmr_torch artifact 2)",
        f"{WRITTEN_BEFORE / 'model.ckpt'} carries no checksum (ssmr_torch checkpoint 1)"]
