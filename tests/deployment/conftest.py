"""The models of the contract suite as artifacts, and one compiled library of each."""

import importlib.util
from pathlib import Path

import pytest

from ssmr_torch import artifact
from ssmr_torch.deployment.c_library import CLibrary, compile_library, compiler
from ssmr_torch.deployment.c_source import write_c

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
