"""The models of the contract suite as artifacts, and one compiled library of each."""

import importlib.util
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
import torch

from ssmr_torch.deployment import artifact
from ssmr_torch.deployment.c.compiled_library import CLibrary, compile_library, compiler
from ssmr_torch.deployment.c.model_source import write_c
from ssmr_torch.models.arrays import Array, identity, namespace
from ssmr_torch.models.base import Model, OutputLinearization, around
from ssmr_torch.models.control_augmented import ControlAugmentedSSMR
from ssmr_torch.models.koopman import Koopman
from ssmr_torch.models.monomials import Monomials, graded
from ssmr_torch.models.neural_ode import NeuralODE
from ssmr_torch.models.polynomial import PolynomialModel
from ssmr_torch.models.ssmr import SSMR
from ssmr_torch.models.structure import SCHEMES, Structure
from ssmr_torch.models.tpwl import TPWL

CONTRACT = Path(__file__).resolve().parents[1] / "models" / "test_contract.py"


def _contract():
    spec = importlib.util.spec_from_file_location("model_contract", CONTRACT)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module.MODELS


MODELS = _contract()


def save(directory, model, name="SSMR (ours)"):
    m, p = model.input_dim, model.output_dim
    return artifact.save(directory, model, name=name, output_names=[f"y{j}" for j in range(p)],
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
    "one state": lambda: SSMR(1, 1, 1, 0, parametrization_degree=1, dynamics_degree=1, control_degree=0),
    "no delays, curved chart": lambda: SSMR(3, 1, 3, 0, parametrization_degree=1, dynamics_degree=1, chart_degree=2,
                                            control_degree=3),
    "control-augmented without delays": lambda: ControlAugmentedSSMR(2, 1, 2, 0, dynamics_degree=1, saturated=False),
    "no delays, no constant, lifted anew": lambda: Koopman(2, 2, 0, input_delays=0, degree=3, constant=False,
                                                           bilinear=True, relift=True, base_timestep=0.005),
    "bilinear, no constant": lambda: Koopman(2, 3, 1, constant=False, bilinear=True, base_timestep=0.005),
    "one hidden layer": lambda: NeuralODE(2, 1, 2, 0, width=5, depth=1),
    "one point": lambda: TPWL(1, 1, 0),
}
MODELS |= {name: lambda make=make: filled(make()) for name, make in SMALLEST.items()}


def of_no_name(scheme, relift=False):
    """A polynomial model of a structure that none of ours has: products of inputs, an input that is missing, a chart of
    some values of the window and of the input, scaled, and constants everywhere.
    """
    n, m, p = (14 if relift else 3), 2, 2
    structure = Structure(
        chart=graded(4, 1, 2), window_order=(5, 1, 0, 3), parametrization=graded(n, 0, 2),
        dynamics=Monomials(n + m, [(), (0,), (1,), (2,), (0, 0), (0, 1, 2), (n,), (n, n), (n, n, n), (0, n), (1, 1, n),
                                   (0, 1, n, n)]),
        scheme=scheme, saturated=True, relift=relift)
    rng, rows = np.random.default_rng(1), 4 if relift else n
    return PolynomialModel(
        structure=structure, chart=rng.normal(size=(0 if relift else n, 14)), window_scale=0.5 + rng.uniform(size=4),
        parametrization=rng.normal(size=(p, len(structure.parametrization))), state_scale=0.2 + rng.uniform(size=n),
        dynamics=0.2 * rng.normal(size=(rows, len(structure.dynamics))), input_dim=m, output_dim=p, delays=1,
        timestep=0.02, window_timestep=0.01, base_timestep=None if scheme == "runge_kutta" else 0.01, substeps=2)


def of_few_terms():
    """A map of two states without any linear term, whose products with the input are fewer than four."""
    structure = Structure(graded(2, 1, 1), (0, 1), Monomials(2, [(), (0, 0)]),
                          Monomials(3, [(0, 0), (0, 2), (1, 2), (2, 2)]), "map")
    rng = np.random.default_rng(1)
    return PolynomialModel(structure=structure, chart=np.eye(2), parametrization=rng.normal(size=(2, 2)),
                           dynamics=0.5 * rng.normal(size=(2, 4)), state_scale=np.ones(2), input_dim=1, output_dim=2,
                           delays=0, timestep=0.01, window_timestep=0.01)


MODELS["of few terms"] = of_few_terms
MODELS |= {f"of no name, {scheme}": lambda scheme=scheme: of_no_name(scheme) for scheme in SCHEMES}
MODELS["of no name, lifted anew"] = lambda: of_no_name("map", relift=True)


@dataclass(frozen=True, eq=False, kw_only=True)
class Foreign(Model):
    """z⁺ = gain tanh(z) + u, y = z: a family from elsewhere, with the abstract functions alone."""

    gain: Array

    def encode(self, window, inputs):
        return window[..., -1, :]

    def decode(self, z):
        return 1.0 * z

    def step(self, z, u):
        return self.gain * namespace(z).tanh(z) + u

    def linearize(self, z, u):
        following, slope = self.step(z, u), self.gain * (1.0 - namespace(z).tanh(z) ** 2)
        A = slope[..., None] * identity(z, self.state_dim)
        return around(following, A, identity(z, self.input_dim) + 0.0 * A, z, u)

    def linearize_output(self, z):
        C = identity(z, self.output_dim) + 0.0 * z[..., None]
        return OutputLinearization(C, 0.0 * z)


@pytest.fixture
def foreign():
    return Foreign(gain=np.array([0.9, 0.8]), state_scale=np.ones(2), input_dim=2, output_dim=2, delays=1,
                   timestep=0.01, window_timestep=0.01)


@pytest.fixture(params=MODELS)
def name(request):
    """A key of the contract's MODELS."""
    return request.param


@pytest.fixture
def models():
    """name → function that makes that model; those of the contract suite, and others."""
    return MODELS


@pytest.fixture(scope="session")
def artifacts(tmp_path_factory):
    """name → directory of that model's artifact, each written once."""
    written = {}

    def write(name: str) -> Path:
        if name not in written:
            written[name] = save(tmp_path_factory.mktemp("artifact") / "artifact", MODELS[name]().reduced.numpy())
        return written[name]

    return write


@pytest.fixture
def saved(tmp_path):
    """A small model's artifact, for tests that change it."""
    return save(tmp_path / "artifact", MODELS["DMD"]().reduced.numpy())


@pytest.fixture(scope="session")
def compiled(artifacts, tmp_path_factory):
    """name → (library, model, reference batch, what the compiler said, folder), each compiled once."""
    if compiler() is None:
        pytest.skip("no C compiler was found (cc, gcc, clang, or the program in the variable CC)")
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
