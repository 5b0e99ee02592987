"""The oscillators of the benchmark, and plants made of them."""

import importlib.util
from pathlib import Path

import pytest

BENCHMARK = Path(__file__).parents[2] / "experiments" / "benchmarks" / "control_step.py"


@pytest.fixture(scope="session")
def bench():
    """The benchmark as a module: `oscillators`, `perturbed`, `TablesPlant`, `BOUNDS`, `measure`."""
    spec = importlib.util.spec_from_file_location("control_step", BENCHMARK)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module
