"""The linear robot's data, and a model that is exact on them."""

import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parent))

from linear_robot import MILLIMETRES, NAMES, linear_robot  # noqa: E402

import ssmr_torch as ssmr  # noqa: E402


@pytest.fixture(scope="session")
def data():
    return ssmr.trajectories(**linear_robot(), **NAMES, **MILLIMETRES)


@pytest.fixture(scope="session")
def dmd(data):
    return ssmr.fit(data, "dmd", progress=False)
