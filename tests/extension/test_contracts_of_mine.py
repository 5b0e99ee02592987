"""What the package's own models, plants and controllers promise, held against those of the foreign package.

A contract suite is a module of tests that ask for fixtures; whoever has fixtures of these names can run it.
"""

import importlib.util
from pathlib import Path

import pytest
import torch
from robot_of_mine.integral_control import IntegralController
from robot_of_mine.sprung_mass import SprungMass
from robot_of_mine.squares_and_products import SquaresAndProducts

TESTS = Path(__file__).resolve().parents[1]


def contract(room: str):
    """tests/ROOM/test_contract.py as a module."""
    spec = importlib.util.spec_from_file_location(f"contract_of_{room}", TESTS / room / "test_contract.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


MODELS, PLANTS, CONTROLLERS = (contract(room) for room in ("models", "plants", "control"))
CONTROLLERS.CONTROLLERS["integral"] = lambda trial: IntegralController(trial.oscillators(), CONTROLLERS.SLOW,
                                                                       trial.BOUNDS)


def small_model() -> SquaresAndProducts:
    """A stable map with small nonlinear terms and a chart that sees the inputs."""
    model = SquaresAndProducts(6, 4, 3, 2, timestep=0.02, base_timestep=0.01, window_timestep=0.01)
    generator = torch.Generator().manual_seed(1)
    with torch.no_grad():
        for table in model.parameters():
            table.copy_(0.03 * torch.randn(table.shape, generator=generator, dtype=torch.float64))
        model.chart += torch.eye(*model.chart.shape, dtype=torch.float64)
        model.dynamics[:, :6] += 0.8 * torch.eye(6, dtype=torch.float64)
        model.state_scale.fill_(1.0)
    return model


@pytest.fixture
def model():
    return small_model()


batch = MODELS.batch


@pytest.fixture
def plant():
    return SprungMass()


@pytest.fixture
def ideal():
    return SprungMass()


@pytest.fixture(params=["integral"])
def controller(request, trial):
    return CONTROLLERS.CONTROLLERS[request.param](trial)


OF_OURS_ALONE = ("test_impossible_sizes_are_refused_with_the_numbers",)  # of the SSMR, whatever the model
globals().update({name: test for suite in (MODELS, PLANTS, CONTROLLERS) for name, test in vars(suite).items()
                  if name.startswith("test_") and name not in OF_OURS_ALONE})
