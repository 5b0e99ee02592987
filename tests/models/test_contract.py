"""Claims that every reduced model must fulfil. Add a new model by one line in MODELS."""

import copy
import io
import pickle
from dataclasses import replace

import numpy as np
import pytest
import torch

from ssmr_torch.deployment import artifact
from ssmr_torch.models.batch_rollout import BatchRollout, batch_of
from ssmr_torch.models.control_augmented import ControlAugmentedSSMR
from ssmr_torch.models.integrators import DIVERGENCE_FACTOR
from ssmr_torch.models.koopman import Koopman
from ssmr_torch.models.monomials import Monomials, graded
from ssmr_torch.models.neural_ode import NeuralODE
from ssmr_torch.models.output_coordinates import ConstantCurvature, Identity, Mixture
from ssmr_torch.models.polynomial import PolynomialModel
from ssmr_torch.models.ssmr import SSMR
from ssmr_torch.models.structure import Structure
from ssmr_torch.models.torch_model import FixedModel, PolynomialTorchModel, TrainablePolynomial
from ssmr_torch.models.tpwl import TPWL


def random_ssmr(**options):
    """A stable polynomial model with an orthogonal chart, small nonlinearities, and a known training range."""
    degrees = {"parametrization_degree": 1, "dynamics_degree": 1} | options
    model = SSMR(6, 4, 3, timestep=0.02, window_timestep=0.01, substeps=2, **degrees)
    generator = torch.Generator().manual_seed(1)
    with torch.no_grad():
        for table in model.parameters():
            table.copy_(0.05 * torch.randn(table.shape, generator=generator, dtype=torch.float64))
        frame = torch.linalg.qr(torch.randn(model.window_dim, 6, generator=generator, dtype=torch.float64)).Q
        model.chart[:, :model.window_dim] = frame.T
        model.parametrization[:, :6] = frame
        complement = torch.eye(model.window_dim, dtype=torch.float64) - frame @ frame.T
        model.parametrization[:, 6:] = complement @ model.parametrization[:, 6:]
        blocks = torch.block_diag(*(torch.tensor([[-1.0, w], [-w, -1.0]]) for w in (9.0, 11.0, 14.0))).double()
        model.drift_table[:, :6] = blocks
        model.state_scale.fill_(1.0)
    return model


def random_control_augmented(**options):
    """A stable joint map of state and input, with small nonlinearities and a chart that sees the inputs."""
    options = {"input_degree": None, "saturated": False} | options
    model = ControlAugmentedSSMR(6, 4, 3, base_timestep=0.01, timestep=0.02, window_timestep=0.01, **options)
    generator = torch.Generator().manual_seed(1)
    with torch.no_grad():
        for table in model.parameters():
            table.copy_(0.05 * torch.randn(table.shape, generator=generator, dtype=torch.float64))
        model.chart += torch.eye(*model.chart.shape, dtype=torch.float64)
        blocks = torch.block_diag(*(torch.tensor([[-2.0, w], [-w, -2.0]]) for w in (9.0, 11.0, 14.0))).double()
        model.dynamics_table[:, :6] = blocks
        model.state_scale.fill_(1.0)
    return model


def random_koopman(**options):
    """A stable lifted model with a known scale."""
    model = Koopman(4, 3, base_timestep=0.01, timestep=0.02, window_timestep=0.01, **options)
    generator = torch.Generator().manual_seed(1)
    with torch.no_grad():
        for table in model.parameters():
            table.copy_(0.3 / model.state_dim * torch.randn(table.shape, generator=generator, dtype=torch.float64))
        model.A += 0.9 * torch.eye(model.state_dim, dtype=torch.float64)[model.propagated]
        model.scale.copy_(0.5 + torch.rand(model.scale.shape, generator=generator, dtype=torch.float64))
        model.state_scale.fill_(1.0)
    return model


def random_neural_ode(**options):
    """A network of order one beside slow linear dynamics; the parametrization reads the chart's newest sample back."""
    torch.manual_seed(1)
    model = NeuralODE(6, 4, 3, 1, timestep=0.02, window_timestep=0.01, **options)
    with torch.no_grad():
        for table in (model.last, model.linear, model.control):
            table.copy_(0.3 * torch.randn(table.shape, dtype=torch.float64))
        frame = torch.linalg.qr(torch.randn(6, 6, dtype=torch.float64)).Q
        model.chart.copy_(frame.T)
        model.parametrization.copy_(frame[-3:])
        model.state_scale.copy_(1.0 + torch.arange(6) / 6)
    return model


def random_tpwl(**options):
    """Stable maps at scattered points, and a filter that trusts its model and its measurements alike."""
    model = TPWL(4, 3, 4, modes=3, points=5, base_timestep=0.01, timestep=0.02, window_timestep=0.01, **options)
    generator = torch.Generator().manual_seed(1)
    with torch.no_grad():
        for table in (model.A, model.B, model.c, model.points, model.C, model.mean):
            table.copy_(0.1 * torch.randn(table.shape, generator=generator, dtype=torch.float64))
        model.A += 0.8 * torch.eye(6, dtype=torch.float64)
        model.points *= 3.0
        model.covariance.copy_(torch.eye(6, dtype=torch.float64))
        model.process.copy_(0.1 * torch.eye(6, dtype=torch.float64))
        model.measurement.copy_(0.1 * torch.eye(3, dtype=torch.float64))
        model.state_scale.fill_(1.0)
    return model


ARC = ConstantCurvature(((0.2, -0.1, 0.9),))
AVERAGED = Mixture((ARC, Identity(3)), (0.6, 0.4), 3)


def random_slow_fast(coordinates):
    """A stable saturated map of six slow coordinates and the two newest inputs, a shift register, bilinear in both; the
    nonlinear terms saturate from twice the range of the training.
    """
    n, m, p, delays = 14, 4, 3, 3
    latent = coordinates.latent(p)
    width = (delays + 1) * latent
    terms = [*((k,) for k in range(n + m)), *graded(6, 2, 2).factors, *((i, n + j) for i in range(6) for j in range(m))]
    order = tuple(range(width + delays * m))
    structure = Structure(graded(len(order), 1, 1), order, graded(n, 1, 2), Monomials(n + m, terms), "map",
                          saturated=True)
    rng = np.random.default_rng(1)
    chart, dynamics = np.zeros((n, len(order))), np.zeros((n, len(terms)))
    chart[:6, :width] = np.linalg.qr(rng.normal(size=(width, 6))).Q.T
    chart[6:, width + m:] = np.eye(2 * m)[[*range(m, 2 * m), *range(m)]]  # the newest first
    dynamics[:6] = 0.02 * rng.normal(size=(6, len(terms)))
    dynamics[:6, :6] += 0.9 * np.eye(6)
    dynamics[6:10, n:n + m], dynamics[10:, 6:10] = np.eye(m), np.eye(m)
    parametrization = 0.02 * rng.normal(size=(latent, len(structure.parametrization)))
    parametrization[:, :6] += 0.5 * np.linalg.qr(rng.normal(size=(6, latent))).Q.T
    return TrainablePolynomial.of(PolynomialModel(
        structure=structure, chart=chart, parametrization=parametrization, dynamics=dynamics, state_scale=np.ones(n),
        input_dim=m, output_dim=p, delays=delays, timestep=0.02, window_timestep=0.01, base_timestep=0.01,
        coordinates=coordinates, reach=2.0))


MODELS = {
    "slow-fast, constant curvature": lambda: random_slow_fast(ARC),
    "slow-fast, averaged coordinates": lambda: random_slow_fast(AVERAGED),
    "TPWL": lambda: random_tpwl(),
    "TPWL, blended": lambda: random_tpwl(width=0.3),
    "neural ODE": lambda: random_neural_ode(width=16),
    "neural ODE, three hidden layers": lambda: random_neural_ode(width=8, depth=3, substeps=2),
    "DMD": lambda: random_koopman(),
    "EDMD": lambda: random_koopman(degree=2),
    "EDMD, lifted anew": lambda: random_koopman(degree=2, bilinear=True, relift=True),
    "EDMD, bilinear": lambda: random_koopman(degree=2, bilinear=True, delays=2),
    "Koopman static pregain": lambda: random_koopman(input_delays=0, constant=False, pregain=True),
    "control-augmented": lambda: random_control_augmented(delays=2, parametrization_degree=2),
    "control-augmented, cubic, affine in the input": lambda: random_control_augmented(
        delays=3, dynamics_degree=3, input_degree=1),
    "control-augmented, saturated": lambda: random_control_augmented(delays=2, dynamics_degree=3, saturated=True),
    "control-augmented, linear in the state": lambda: random_control_augmented(
        delays=2, state_degree=1, saturated=True),
    "SSSR": lambda: random_ssmr(delays=1),
    "SSMR": lambda: random_ssmr(delays=3, parametrization_degree=3, dynamics_degree=3, control_degree=1),
    "SSMR, constant input matrix": lambda: random_ssmr(delays=2, dynamics_degree=2, control_degree=0),
    "SSMR, quadratic control field": lambda: random_ssmr(delays=2, dynamics_degree=3, control_degree=2),
}


@pytest.fixture(params=MODELS)
def model(request):
    return MODELS[request.param]()


@pytest.fixture
def batch(model):
    generator = torch.Generator().manual_seed(2)
    z = 0.3 * torch.randn(7, model.state_dim, generator=generator, dtype=torch.float64)
    return z, torch.rand(7, model.input_dim, generator=generator, dtype=torch.float64)


def test_a_batch_gives_what_its_members_give(model, batch):
    z, u = batch
    for together, single in ((model.step(z, u), torch.stack([model.step(a, b) for a, b in zip(z, u)])),
                             (model.decode(z), torch.stack([model.decode(a) for a in z])),
                             (model.linearize(z, u).A, torch.stack([model.linearize(a, b).A for a, b in zip(z, u)]))):
        torch.testing.assert_close(together, single, rtol=1e-12, atol=1e-14)


def test_the_linearization_equals_automatic_differentiation(model, batch):
    z, u = batch
    expected_A, expected_B = torch.func.vmap(torch.func.jacfwd(model.step, (0, 1)))(z, u)
    A, B, c = model.linearize(z, u)
    torch.testing.assert_close(A, expected_A, rtol=1e-11, atol=1e-12)
    torch.testing.assert_close(B, expected_B, rtol=1e-11, atol=1e-12)
    torch.testing.assert_close((A @ z[..., None] + B @ u[..., None])[..., 0] + c, model.step(z, u), rtol=1e-12,
                               atol=1e-13)
    C, d = model.linearize_output(z)
    torch.testing.assert_close(C, torch.func.vmap(torch.func.jacfwd(model.decode))(z), rtol=1e-11, atol=1e-12)
    torch.testing.assert_close((C @ z[..., None])[..., 0] + d, model.decode(z), rtol=1e-12, atol=1e-13)


def test_the_linearization_equals_central_differences(model, batch):
    z, u = (tensor[0].detach() for tensor in batch)
    A, B, _ = model.linearize(z, u)
    for matrix, point, at in ((A, z, lambda v: model.step(v, u)), (B, u, lambda v: model.step(z, v))):
        for j, direction in enumerate(torch.eye(len(point), dtype=torch.float64)):
            difference = (at(point + 1e-5 * direction) - at(point - 1e-5 * direction)) / 2e-5
            torch.testing.assert_close(matrix[:, j], difference, rtol=1e-7, atol=1e-8)


def windows_on_the_manifold(model, z):
    """Windows, and the inputs held between their samples, that the model can represent exactly."""
    inputs = torch.rand(len(z), model.delays, model.input_dim, dtype=torch.float64)
    if isinstance(model, SSMR):
        return model.reduced.decode_window(z), inputs
    if isinstance(model, TrainablePolynomial):
        return window_and_inputs(model, z)
    if isinstance(model, TPWL):  # what its filter expects: the model's own motion from the mean of its states
        expected = model.at_timestep(model.window_timestep).rollout(model.mean.expand(len(z), -1), inputs).states
        return model.decode(expected), inputs
    if isinstance(model, PolynomialTorchModel):  # the smallest window with chart z and newest sample w(z)
        newest = torch.eye(model.window_dim, dtype=torch.float64)[-model.output_dim:]
        seen = z - inputs.flatten(1) @ model.chart[:, model.window_dim:].T
        rows = torch.cat([model.chart[:, :model.window_dim], newest])
        window = torch.cat([seen, model.decode(z)], dim=1) @ torch.linalg.pinv(rows).T
        return window.unflatten(1, (model.delays + 1, model.output_dim)), inputs
    return 0.3 * torch.randn(len(z), model.delays + 1, model.output_dim, dtype=torch.float64), inputs


def window_and_inputs(model, z):
    """Small windows with the inputs held within them, whose chart is z and whose newest sample w(z), by Newton."""
    window, inputs = (torch.zeros(model.delays + 1, model.output_dim, dtype=torch.float64),
                      torch.zeros(model.delays, model.input_dim, dtype=torch.float64))
    sizes = [window.numel(), inputs.numel()]

    def apart(x, z):
        seen, held = (part.view(like.shape) for part, like in zip(x.split(sizes), (window, inputs)))
        return torch.cat([model.encode(seen, held) - z, seen[-1] - model.decode(z)])

    x = torch.zeros(len(z), sum(sizes), dtype=torch.float64)
    for _ in range(10):
        slopes = torch.func.vmap(torch.func.jacfwd(apart))(x, z).detach()
        x = x - (torch.linalg.pinv(slopes) @ torch.func.vmap(apart)(x, z).detach()[..., None])[..., 0]
    seen, held = x.split(sizes, dim=1)
    return seen.unflatten(1, window.shape), held.unflatten(1, inputs.shape)


def test_decoding_inverts_encoding_on_the_manifold(model, batch):
    window, inputs = windows_on_the_manifold(model, batch[0])
    z = model.encode(window, inputs)
    assert z.shape == batch[0].shape
    torch.testing.assert_close(model.decode(z), window[:, -1], rtol=1e-12, atol=1e-12)
    if isinstance(model, PolynomialTorchModel):
        torch.testing.assert_close(z, batch[0], rtol=1e-12, atol=1e-12)


def test_a_rollout_is_repeated_steps(model, batch):
    z, _ = batch
    inputs = 0.5 * torch.rand(7, 12, model.input_dim, dtype=torch.float64)
    states, diverged_at = model.rollout(z, inputs)
    for k in range(12):
        z = model.step(z, inputs[:, k])
        torch.testing.assert_close(states[:, k + 1], z, rtol=0, atol=0)
    assert (diverged_at == 13).all()


def test_a_diverging_rollout_is_reported_and_stays_finite(model, batch):
    z, u = batch
    inputs = u[:, None].repeat(1, 5, 1)
    far = 2 * DIVERGENCE_FACTOR * torch.linalg.vector_norm(model.state_scale) / torch.linalg.vector_norm(z[0])
    start = torch.cat([far * z[:1], z[1:]])
    states, diverged_at = model.rollout(start, inputs)
    assert diverged_at[0] == 1 and (diverged_at[1:] == 6).all()
    assert states.isfinite().all()


def test_a_batch_rolls_out_as_its_members_do_and_diverges_where_they_do(model, batch):
    z, u = (part.numpy() for part in batch)
    reduced, rng = model.reduced.numpy(), np.random.default_rng(3)
    inputs, lengths = 0.5 * rng.random((7, 12, model.input_dim)), np.array([12, 3, 0, 12, 7, 1, 12])
    bound = (1 + 1e-6) * np.median(np.linalg.norm(reduced.rollout(z, inputs).states[:, 6:], axis=-1))
    for options in ({}, {"lengths": lengths}, {"bound": bound}, {"lengths": lengths, "bound": bound}):
        reference, compiled = BatchRollout(model), batch_of(model)
        expected, found = reduced.rollout(z, inputs, **options), compiled.rollout(z, inputs, **options)
        np.testing.assert_array_equal(found.diverged_at, expected.diverged_at)
        np.testing.assert_allclose(found.states, expected.states, rtol=1e-12, atol=1e-13)
        within = np.arange(12) < options.get("lengths", np.full(7, 12))[:, None]
        np.testing.assert_allclose(compiled.outputs(z, inputs, **options)[within],
                                   reference.outputs(z, inputs, **options)[within], rtol=1e-11, atol=1e-13)
        np.testing.assert_array_equal(compiled.diverged(z, inputs, **options),
                                      reference.diverged(z, inputs, **options))
    assert compiled.diverged(z, inputs, bound=bound).any()


def test_the_state_dict_and_the_arguments_rebuild_the_model(model, batch):
    file = io.BytesIO()
    torch.save({"arguments": model.arguments, "state": model.state_dict()}, file)
    file.seek(0)
    stored = torch.load(file, weights_only=True)
    again = type(model)(**stored["arguments"])
    again.load_state_dict(stored["state"])
    torch.testing.assert_close(again.step(*batch), model.step(*batch), rtol=0, atol=0)


def predictions(model, z, u, window, inputs):
    """What the same model with arrays of Torch and of NumPy must agree on."""
    return [model.encode(window, inputs), model.decode(z), model.step(z, u), *model.linearize(z, u),
            *model.linearize_output(z)]


def test_the_exported_model_predicts_what_the_torch_model_predicts(model, batch, tmp_path):
    z, u = batch
    window, inputs = windows_on_the_manifold(model, z)
    outputs, inputs_ = ([str(j) for j in range(size)] for size in (model.output_dim, model.input_dim))
    artifact.save(tmp_path / "model", model.reduced.numpy(), output_names=outputs, input_names=inputs_,
                  rest=[0.0] * model.output_dim, input_range=[[0.0] * model.input_dim, [1.0] * model.input_dim])
    tables = artifact.load(tmp_path / "model").model
    arrays = predictions(tables, *(tensor.detach().numpy() for tensor in (z, u, window, inputs)))
    for array, tensor in zip(arrays, predictions(model, z, u, window, inputs)):
        np.testing.assert_allclose(array, tensor.detach().numpy(), rtol=1e-12, atol=1e-13)
    again = FixedModel(tables)
    torch.testing.assert_close(again.step(z, u), model.step(z, u), rtol=1e-12, atol=1e-13)


def test_the_rates_are_those_of_the_step_linearized_at_rest(model):
    reduced = model.reduced.numpy()
    factors = np.linalg.eigvals(reduced.linearize(np.zeros(model.state_dim), np.zeros(model.input_dim)).A)
    size, angle = np.exp(reduced.timestep * reduced.rates.real), reduced.timestep * reduced.rates.imag
    distances = np.abs((size * np.exp(1j * angle))[:, None] - factors)
    assert max(distances.min(0).max(), distances.min(1).max()) <= 1e-5  # what a Runge-Kutta step leaves


def test_a_copied_or_unpickled_model_has_read_only_arrays(model, batch):
    reduced = model.reduced.numpy()
    expected = reduced.linearize(*(array.numpy() for array in batch))
    for again in (copy.deepcopy(reduced), pickle.loads(pickle.dumps(reduced))):
        for found, sought in zip(again.linearize(*(array.numpy() for array in batch)), expected):
            np.testing.assert_array_equal(found, sought)
        assert not any(array.flags.writeable for array in again.arrays.values())


def test_a_window_or_an_input_of_another_size_is_refused(model, batch):
    z, u = batch
    window, inputs = windows_on_the_manifold(model, z)
    with pytest.raises((ValueError, RuntimeError)):
        model.encode(torch.cat([window, window], -2), torch.cat([inputs, inputs], -2))
    with pytest.raises((ValueError, RuntimeError)):  # of ours, or of a product of Torch
        model.step(z, torch.cat([u, u], -1))


@pytest.mark.parametrize("timestep", [-0.01, 0.0, np.nan, np.inf])
def test_a_time_that_is_not_positive_and_finite_is_refused(model, timestep):
    with pytest.raises(ValueError, match="must be positive and finite"):
        model.reduced.at_timestep(timestep)


def test_another_timestep_keeps_the_precision(model):
    double = 2 * model.timestep
    assert copy.deepcopy(model).float().at_timestep(double).state_scale.dtype == torch.float32


def test_another_timestep_is_the_same_flow(model, batch):
    z, u = batch
    if model.reduced.flow:
        halves = model.at_timestep(model.timestep / 2)
        torch.testing.assert_close(halves.step(halves.step(z, u), u), model.step(z, u), rtol=1e-3, atol=1e-6)
        assert halves.window_timestep == model.window_timestep
        return
    double = model.at_timestep(2 * model.timestep)
    torch.testing.assert_close(double.step(z, u), model.step(model.step(z, u), u), rtol=1e-12, atol=1e-14)
    assert double.window_timestep == model.window_timestep
    with pytest.raises(ValueError, match="whole multiple"):
        model.at_timestep(1.37 * model.timestep)


@pytest.mark.parametrize(("change", "message"), [
    ({"state_dim": 0}, "state_dim is 0; expected"), ({"delays": -1}, "delays is -1"),
    ({"timestep": 0.0}, "timestep is 0.0 s"),
    ({"state_dim": 7}, "fewer than the 7 reduced coordinates; use at least 2 delays"),
    ({"dynamics_degree": 0}, "dynamics_degree is 0; expected"), ({"control_degree": -1}, "control_degree is -1"),
    ({"substeps": 0}, "substeps is 0; expected")])
def test_impossible_sizes_are_refused_with_the_numbers(change, message):
    with pytest.raises(ValueError, match=message):
        SSMR(**({"state_dim": 6, "input_dim": 4, "output_dim": 3, "delays": 1} | change))


@pytest.mark.parametrize(("scheme", "factors", "rate"), [
    ("runge_kutta", [(1,)], 0.0), ("euler", [(1, 1, 1)], 0.0), ("map", [(), (1,)], -np.inf), ("map", [], -np.inf),
    ("runge_kutta", [(0,)], 0.5), ("euler", [(0,), (0, 0)], np.log(1.005) / 0.01), ("map", [(0,)], np.log(0.5) / 0.01)])
def test_a_model_with_one_state_has_the_rate_of_its_linear_term(scheme, factors, rate):
    structure = Structure(graded(1, 1, 1), (0,), graded(1, 1, 1), Monomials(2, factors), scheme)
    one = PolynomialModel(structure=structure, chart=np.ones((1, 1)), parametrization=np.ones((1, 1)),
                          dynamics=np.full((1, len(factors)), 0.5), state_scale=np.ones(1), input_dim=1, output_dim=1,
                          delays=0, timestep=0.01, window_timestep=0.01)
    np.testing.assert_allclose(one.rates, [rate], rtol=1e-12)
    assert repr(one)


@pytest.mark.parametrize(("change", "message"), [
    ({"parametrization": np.ones((2, 6))}, "2 rows; expected 3 for the newest sample, or 6 for the whole window"),
    ({"window_scale": np.ones(2)}, "2 entries; expected 6"), ({"substeps": 0}, "0; expected a whole number")])
def test_tables_that_do_not_fit_the_window_are_refused_with_both_numbers(change, message):
    with pytest.raises(ValueError, match=message):
        replace(random_ssmr(delays=1).reduced.numpy(), **change)


@pytest.mark.parametrize("model", [NeuralODE(2, 1, 1, 3), SSMR(2, 1, 1, 3), Koopman(1, 1), TPWL(1, 1)])
def test_a_model_that_was_not_fitted_yet_prints_itself(model):
    assert "stability" in repr(model.reduced.numpy())


def test_only_a_state_that_is_the_lifted_window_can_be_lifted_again():
    model = random_control_augmented().reduced.numpy()
    with pytest.raises(ValueError, match="relift with a chart of 6 rows"):
        replace(model, structure=model.structure._replace(scheme="map", relift=True))


def test_a_chart_that_needs_inputs_refuses_a_window_without_them():
    model = random_control_augmented()
    with pytest.raises(ValueError, match="inputs held within the window; give them"):
        model.encode(torch.zeros(model.delays + 1, model.output_dim, dtype=torch.float64))
