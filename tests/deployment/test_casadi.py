"""CasADi functions: they compute what the model computes, and CasADi differentiates them as we do."""

import numpy as np
import pytest

from ssmr_torch.deployment import artifact
from ssmr_torch.deployment.reference_batch import check, expected

casadi = pytest.importorskip("casadi", reason="casadi is not installed: pip install 'ssmr_torch[casadi]'")
from ssmr_torch.deployment import casadi_program  # noqa: E402

SWITCHED = ("TPWL", "TPWL, blended")
LARGE = 40  # states, from which steps of two maps, entry by entry, take more than a few seconds


def difference(model, batch, names, at):
    """Of what these functions of the model make of the batch, after they were stored; the largest, relative."""
    sought, outputs = expected(model, batch), {"z": "encode", "y": "decode", "next": "step", "A": "A", "B": "B"}
    compared = []
    for name, function in casadi_program.casadi_functions(model, names).items():
        casadi_program.save_function(function, at / f"{name}.casadi")
        found = casadi_program.run_function(at / f"{name}.casadi", batch)
        compared += [(output, value, sought[outputs[output]]) for output, value in found.items()]
    return check("casadi", compared)


def test_a_stored_function_computes_what_the_model_computes(name, artifacts, tmp_path):
    model, batch = artifact.load(artifacts(name)).model, artifact.reference(artifacts(name))
    names = ["encode", "decode", "step", "step_jacobians"][:4 if model.state_dim < LARGE else 2]
    if name in SWITCHED:
        with pytest.raises(ValueError, match="of a PiecewiseLinearModel has no CasADi form: its equations compare"):
            casadi_program.casadi_functions(model, names)
    else:
        assert difference(model, batch, names, tmp_path) <= 1e-13


@pytest.mark.slow
def test_a_stored_casadi_step_with_relifting_computes_what_the_model_computes(artifacts, tmp_path):
    loaded, batch = artifact.load(artifacts("EDMD, lifted anew")), artifact.reference(artifacts("EDMD, lifted anew"))
    assert difference(loaded.model, batch, ["step", "step_jacobians"], tmp_path) <= 1e-13


@pytest.mark.parametrize("kind", ["SSMR", "EDMD", "control-augmented, saturated", "of no name, euler", "neural ODE",
                                  "slow-fast, constant curvature"])
def test_casadis_derivatives_equal_the_models(kind, models):
    model = models[kind]().reduced.numpy()
    step = casadi_program.casadi_functions(model, ["step"])["step"]
    z, u = casadi.SX.sym("z", model.state_dim), casadi.SX.sym("u", model.input_dim)
    derivatives = casadi.Function("derivatives", [z, u], [casadi.jacobian(step(z, u), by) for by in (z, u)])
    rng = np.random.default_rng(0)
    for size in (0.5, 1.3):  # within the range of the training, and beyond, where a saturated model bends
        at = size * model.state_scale * rng.choice([-1.0, 1.0], model.state_dim), rng.uniform(size=model.input_dim)
        for found, ours in zip(derivatives(*at), model.linearize(*at)):
            np.testing.assert_allclose(found.full(), ours, rtol=1e-11, atol=1e-12)


@pytest.mark.parametrize("kind", ["slow-fast, constant curvature", "slow-fast, averaged coordinates"])
def test_casadis_derivatives_equal_the_models_in_output_coordinates(kind, models):
    model = models[kind]().reduced.numpy()
    decode = casadi_program.casadi_functions(model, ["decode"])["decode"]
    z = casadi.SX.sym("z", model.state_dim)
    slopes = casadi.Function("slopes", [z], [casadi.jacobian(decode(z), z)])
    for at in (np.zeros(model.state_dim), np.random.default_rng(0).normal(size=model.state_dim)):
        np.testing.assert_allclose(slopes(at).full(), model.linearize_output(at).C, rtol=1e-11, atol=1e-12)


def test_all_functions_take_and_give_names(models):
    functions = casadi_program.casadi_functions(models["SSMR"]().reduced.numpy())
    assert {name: (function.name_in(), function.name_out()) for name, function in functions.items()} == {
        "encode": (["window", "window_input"], ["z"]), "decode": (["state"], ["y"]),
        "step": (["state", "input"], ["next"]), "step_jacobians": (["state", "input"], ["next", "A", "B"])}
