"""Torch programs and ONNX graphs: they compute what the model computes, in float64, for any batch size."""

import json

import numpy as np
import pytest
import torch

from ssmr_torch.deployment import artifact, torch_program
from ssmr_torch.deployment.reference_batch import check, expected
from ssmr_torch.models import kalman

NAMES = ("encode", "decode", "step", "step_jacobians")
# one of each kind and of what may go wrong in each; the slow ones differ from these in degrees or sizes
UNROLLED = [pytest.param(kind, marks=pytest.mark.slow) for kind in (
    "TPWL", "TPWL, blended", "neural ODE", "SSSR", "SSMR, constant input matrix", "SSMR, quadratic control field",
    "EDMD, lifted anew", "slow-fast, constant curvature", "slow-fast, averaged coordinates")]
SMALLEST = [pytest.param(kind, marks=pytest.mark.slow) for kind in ("one state", "one hidden layer")]
KINDS = [*UNROLLED, *SMALLEST, "DMD", "EDMD, bilinear", "control-augmented", "one point",
         "control-augmented without delays"]


@pytest.fixture(scope="module")
def exported(artifacts):
    """kind → (artifact, reference batch, programs), each exported once."""
    done = {}

    def export(kind):
        if kind not in done:
            loaded, batch = artifact.load(artifacts(kind)), artifact.reference(artifacts(kind))
            done[kind] = loaded, batch, torch_program.programs(loaded.model, batch)
        return done[kind]

    return export


def compare(model, batch, found):
    sought = expected(model, batch)
    named = {"z": "encode", "y": "decode", "next": "step", "A": "A", "B": "B"}
    return check("form", [(output, value, sought[named[output]]) for output, value in found.items()])


@pytest.mark.parametrize("kind", KINDS)
def test_a_stored_torch_program_computes_what_the_model_computes_for_any_batch(kind, exported, tmp_path):
    loaded, batch, programs = exported(kind)
    assert tuple(programs) == NAMES
    for name, program in programs.items():
        path = tmp_path / f"{name}.pt2"
        torch_program.save_program(program, path, loaded.card)
        parts = [{key: array[rows] for key, array in batch.items()} for rows in (slice(0, 1), slice(0, 5), slice(None))]
        for part, found in zip(parts, torch_program.run_program(path, name, *parts)):
            assert compare(loaded.model, part, found) <= 1e-13


def test_a_stored_torch_program_carries_the_card(exported, tmp_path):
    loaded, _, programs = exported("DMD")
    torch_program.save_program(programs["decode"], tmp_path / "decode.pt2", loaded.card)
    files = {"card.json": ""}
    torch.export.load(tmp_path / "decode.pt2", extra_files=files)
    assert json.loads(files["card.json"]) == loaded.card


@pytest.mark.parametrize("kind", [*UNROLLED, "DMD", "EDMD, bilinear", "control-augmented"])
def test_an_onnx_graph_computes_what_the_model_computes_and_is_double_everywhere(kind, exported, tmp_path):
    onnx = pytest.importorskip("onnx", reason="the extra onnx is not installed")
    pytest.importorskip("onnxscript", reason="the extra onnx is not installed")
    from ssmr_torch.deployment import onnx_program

    loaded, batch, programs = exported(kind)
    for name in ("encode", "decode", "step_jacobians"):
        path = tmp_path / f"{name}.onnx"
        torch_program.save_onnx(programs[name], path, name)
        onnx_program.finish(path, loaded.card)
        for rows in (slice(0, 1), slice(None)):
            part = {key: array[rows] for key, array in batch.items()}
            assert compare(loaded.model, part, onnx_program.run_graph(path, part)) <= 1e-13
        graph = onnx.load(path)
        assert not onnx_program.narrow_floats(graph)
        assert {value.type.tensor_type.elem_type for value in (*graph.graph.input, *graph.graph.output)} == {
            onnx.TensorProto.DOUBLE}
        assert graph.graph.output[0].type.tensor_type.shape.dim[0].dim_param == "batch"
        assert json.loads({each.key: each.value for each in graph.metadata_props}["card"]) == loaded.card


def test_a_graph_with_a_narrow_float_is_refused_by_name(tmp_path):
    onnx = pytest.importorskip("onnx", reason="the extra onnx is not installed")
    pytest.importorskip("onnxruntime", reason="the extra onnx is not installed")
    from ssmr_torch.deployment import onnx_program

    make = onnx.helper
    value = make.make_tensor_value_info("z", onnx.TensorProto.DOUBLE, ["batch", 2])
    out = make.make_tensor_value_info("y", onnx.TensorProto.DOUBLE, ["batch", 2])
    graph = make.make_graph([make.make_node("Cast", ["z"], ["low"], "to_float", to=onnx.TensorProto.FLOAT),
                             make.make_node("Cast", ["low"], ["y"], "back", to=onnx.TensorProto.DOUBLE)], "g", [value],
                            [out])
    onnx.save(make.make_model(graph), tmp_path / "step.onnx")
    with pytest.raises(ValueError, match="step.onnx holds .*low.* with less than 64 bits"):
        onnx_program.finish(tmp_path / "step.onnx", {})


def test_elimination_solves_what_the_library_solves():
    generator = torch.Generator().manual_seed(0)
    root = torch.randn(7, 4, 4, generator=generator, dtype=torch.float64)
    S, X = root @ root.mT + torch.eye(4), torch.randn(7, 4, 6, generator=generator, dtype=torch.float64)
    torch.testing.assert_close(kalman.solve(S, X), torch.linalg.solve(S, X), rtol=1e-12, atol=1e-13)


def test_a_model_family_of_another_package_has_programs_from_its_linearization_alone(foreign, tmp_path):
    rng = np.random.default_rng(0)
    batch = {"state": rng.normal(size=(5, 2)), "input": rng.normal(size=(5, 2)), "window": rng.normal(size=(5, 2, 2)),
             "window_input": rng.normal(size=(5, 1, 2))}
    for name, program in torch_program.programs(foreign, batch).items():
        torch_program.save_program(program, tmp_path / f"{name}.pt2", {})
        assert compare(foreign, batch, torch_program.run_program(tmp_path / f"{name}.pt2", name, batch)[0]) <= 1e-15


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["SSMR", "EDMD, lifted anew", "control-augmented, saturated", "neural ODE"])
def test_a_compiled_step_is_the_step(kind, models):
    model = models[kind]()
    generator = torch.Generator().manual_seed(0)
    z = 1.5 * torch.randn(7, model.state_dim, generator=generator, dtype=torch.float64)
    u = torch.rand(7, model.input_dim, generator=generator, dtype=torch.float64)
    torch.testing.assert_close(torch.compile(model.step)(z, u), model.step(z, u), rtol=1e-12, atol=1e-13)


def test_numbers_in_arithmetic_are_double_constants():
    x = torch.full((2,), 3.0, dtype=torch.float64)
    with torch_program.DoubleConstants():
        results = (0.1 * x, x * 0.1, x + 0.1, 0.1 - x, x / 0.3, 1.0 / x)
    for found, sought in zip(results, (0.1 * x, x * 0.1, x + 0.1, 0.1 - x, x / 0.3, 1.0 / x)):
        assert found.dtype == torch.float64
        np.testing.assert_array_equal(found.numpy(), sought.numpy())
