"""The foreign package is found as a user's own is: its folder stands on the path, here and in other processes."""

import os
import sys
from pathlib import Path

import pytest

HERE = Path(__file__).resolve().parent
if str(HERE) not in sys.path:
    sys.path.insert(0, str(HERE))


@pytest.fixture(scope="session")
def config_dir():
    return HERE / "robot_of_mine" / "conf"


@pytest.fixture(scope="session")
def environment():
    """Of a process in which `import robot_of_mine` works."""
    return os.environ | {"PYTHONPATH": str(HERE), "OMP_NUM_THREADS": "1"}
