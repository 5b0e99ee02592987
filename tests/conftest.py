"""Seeds, one thread, and where the real measurements are."""

import os
from pathlib import Path

import pytest
import torch

MEASUREMENTS = Path(os.environ.get("SSMR_TORCH_DATA", Path(__file__).resolve().parents[2] / "shared" / "data"))


@pytest.fixture(autouse=True)
def reproducible():
    torch.manual_seed(0)
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(threads)


@pytest.fixture
def measurements():
    """Path of a real data file or folder; the test is skipped where the data are not at hand."""

    def locate(name: str) -> Path:
        path = MEASUREMENTS / name
        if not path.exists():
            pytest.skip(f"the real measurements {name} are not at hand (set SSMR_TORCH_DATA to their folder)")
        return path

    return locate
