"""Commands that are interrupted at a random moment, and started again, give what they would have given at once."""

import pytest

from ssmr_torch.faults import interrupted_work
from ssmr_torch.faults.interrupted_products import unreadable, without_times


def test_half_written_files_are_found(tmp_path):
    (tmp_path / "model.ckpt").write_bytes(b"half")
    assert "model.ckpt cannot be read" in unreadable(tmp_path)
    (tmp_path / "model.ckpt").rename(tmp_path / ".model.ckpt.0123456789ab.part")
    assert "is left" in unreadable(tmp_path) and not unreadable(tmp_path, leftovers=True)


def test_only_what_the_clock_decides_is_left_out_of_a_comparison():
    assert without_times({"rmse": 1.0, "fit_time": 2.0, "said": ["best of 3 forms in 4 s of CPU"]}) == {
        "rmse": 1.0, "said": ["best of 3 forms "]}


@pytest.mark.slow
def test_a_collection_survives_a_signal_a_kill_and_a_full_disk(monkeypatch):
    monkeypatch.setattr(interrupted_work, "PRELOADED", ("hydra", "ssmr_torch.collection.collect"))
    rows = interrupted_work.interruptions(["collect"], 1, seed=4, ways=("SIGKILL", "SIGTERM", "full disk"))
    assert [row["outcome"] for row in rows] == 3 * ["survived"], rows
