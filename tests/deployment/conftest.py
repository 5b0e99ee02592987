"""The models of the contract suite as artifacts, and one compiled library of each."""

import importlib.util
from pathlib import Path

import pytest
import torch

from ssmr_torch import artifact
from ssmr_torch.deployment.c_library import CLibrary, compile_library, compiler
from ssmr_torch.deployment.c_source import write_c
from ssmr_torch.models.control_augmented import ControlAugmentedSSMR
from ssmr_torch.models.koopman import Koopman
from ssmr_torch.models.neural_ode import NeuralODE
from ssmr_torch.models.ssmr import SSMR
from ssmr_torch.models.tpwl import TPWL

CONTRACT = Path(__file__).resolve().parents[1] / "models" / "test_contract.py"


def _contract():
    spec = importlib.util.spec_from_file_location("model_contract", CONTRACT)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module.MODELS


MODELS = _contract()


def save(directory, tables, name="SSMR (ours)"):
    m, p = tables.input_dim, tables.output_dim
    return artifact.save(directory, tables, name=name, output_names=[f"y{j}" for j in range(p)],
                         input_names=[f"u{j}" for j in range(m)], rest=[0.1] * p, input_range=[[0.0] * m, [1.0] * m])


def filled(model):
    """Small random tables, in a model as small as it can be."""
    generator = torch.Generator().manual_seed(1)
    with torch.no_grad():
        for table in model.parameters():
            table.copy_(0.1 * torch.randn(table.shape, generator=generator, dtype=torch.float64))
        model.state_scale.fill_(1.0)
    return model


SMALLEST = {
    "one state": lambda: SSMR(1, 1, 1, 0, control_degree=0),
    "no delays, curved chart": lambda: SSMR(3, 1, 3, 0, chart_degree=2, control_degree=3),
    "control-augmented without delays": lambda: ControlAugmentedSSMR(2, 1, 2, 0, dynamics_degree=1),
    "no delays, no constant, lifted anew": lambda: Koopman(2, 2, 0, input_delays=0, degree=3, constant=False,
                                                           bilinear=True, relift=True, base_timestep=0.005),
    "bilinear, no constant": lambda: Koopman(2, 3, 1, constant=False, bilinear=True, base_timestep=0.005),
    "one hidden layer": lambda: NeuralODE(2, 1, 2, 0, width=5, depth=1),
    "one point": lambda: TPWL(1, 1, 0),
}
MODELS |= {name: lambda make=make: filled(make()) for name, make in SMALLEST.items()}


@pytest.fixture(params=MODELS)
def name(request):
    """A key of the contract's MODELS."""
    return request.param


@pytest.fixture(scope="session")
def artifacts(tmp_path_factory):
    """name → directory of that model's artifact, each written once."""
    written = {}

    def write(name: str) -> Path:
        if name not in written:
            written[name] = save(tmp_path_factory.mktemp("artifact") / "artifact", MODELS[name]().tables())
        return written[name]

    return write


@pytest.fixture
def saved(tmp_path):
    """A small model's artifact, for tests that change it."""
    return save(tmp_path / "artifact", MODELS["DMD"]().tables())


@pytest.fixture(scope="session")
def compiled(artifacts, tmp_path_factory):
    """name → (library, tables, reference batch, what the compiler said, folder), each compiled once."""
    if compiler() is None:
        pytest.skip("no C compiler is at hand (cc, gcc, clang, or the one that CC names)")
    built = {}

    def build(name: str):
        if name not in built:
            loaded, batch = artifact.load(artifacts(name)), artifact.reference(artifacts(name))
            at = tmp_path_factory.mktemp("c")
            prefix, source, header = write_c(loaded.model, loaded.card)
            (at / f"{prefix}.c").write_text(source)
            (at / f"{prefix}.h").write_text(header)
            said = compile_library(at / f"{prefix}.c", at / "model.so")
            built[name] = CLibrary(at / "model.so", prefix, loaded.model), loaded.model, batch, said, at
        return built[name]

    return build
