"""Stencils for derivatives: their order, their smoothing, and the mean input of each difference."""

import numpy as np
import pytest
import torch
from scipy.ndimage import gaussian_filter1d
from scipy.signal import savgol_filter

from ssmr_torch.data.derivatives import Stencil, central_difference, gaussian, savitzky_golay

STENCILS = {"central 2": central_difference(2), "central 4": central_difference(4), "central 6": central_difference(),
            "central 8": central_difference(8), "Savitzky-Golay 9, 4": savitzky_golay(),
            "Savitzky-Golay 5, 1": savitzky_golay(5, 1), "Gaussian 1.5": gaussian(), "Gaussian 0.25": gaussian(0.25)}
EXACT_DEGREE = {"central 2": 2, "central 4": 4, "central 6": 6, "central 8": 8, "Savitzky-Golay 9, 4": 4,
                "Savitzky-Golay 5, 1": 2, "Gaussian 1.5": 2, "Gaussian 0.25": 2}


@pytest.fixture(params=STENCILS)
def stencil(request):
    return STENCILS[request.param]


def error(stencil, h):
    t = np.arange(0, 1, h)
    found = stencil(np.sin(7 * t + 0.3)[:, None], h)[:, 0]
    w = stencil.half_width
    return np.abs(found - 7 * np.cos(7 * t + 0.3)[w:-w]).max()


@pytest.mark.parametrize("order", [2, 4, 6, 8])
def test_central_differences_converge_with_their_order(order):
    coarse, fine = (error(central_difference(order), h) for h in (0.02, 0.01))
    assert np.log2(coarse / fine) == pytest.approx(order, abs=0.1)


def test_the_sixth_order_difference_has_the_known_weights():
    np.testing.assert_allclose(central_difference(6).weights,
                               [-1 / 60, 3 / 20, -3 / 4, 0, 3 / 4, -3 / 20, 1 / 60], rtol=1e-14, atol=1e-16)
    np.testing.assert_allclose(central_difference(2).weights, [-0.5, 0, 0.5], atol=1e-16)


@pytest.mark.parametrize("name", STENCILS)
def test_polynomials_are_differentiated_exactly_up_to_the_degree_of_the_stencil_and_no_further(name):
    stencil, h, exact = STENCILS[name], 0.1, EXACT_DEGREE[name]
    w = stencil.half_width
    t = h * np.arange(-3 * w, 3 * w + 1)
    for degree in range(exact + 2):
        found = stencil((t**degree)[:, None], h)[:, 0]
        expected = (degree * t ** max(degree - 1, 0))[w:-w]
        close = np.allclose(found, expected, rtol=1e-10, atol=1e-10 * np.abs(t).max() ** degree)
        assert close == (degree <= exact), (degree, np.abs(found - expected).max())


@pytest.mark.parametrize(("window", "degree"), [(9, 4), (5, 1), (7, 2), (11, 6), (3, 2)])
def test_savitzky_golay_is_that_of_scipy(window, degree):
    signal, h = np.random.default_rng(0).normal(size=(60, 3)), 0.02
    expected = savgol_filter(signal, window, degree, deriv=1, delta=h, axis=0)[window // 2:-(window // 2)]
    np.testing.assert_allclose(savitzky_golay(window, degree)(signal, h), expected, rtol=1e-10, atol=1e-9)


def test_the_gaussian_derivative_is_that_of_scipy_but_for_its_factor_on_a_ramp():
    signal, h, width = np.random.default_rng(0).normal(size=(60, 2)), 0.02, 2.0
    stencil = gaussian(width)
    w = stencil.half_width
    filtered = gaussian_filter1d(signal, width, axis=0, order=1)[w:-w] / h
    found = stencil(signal, h)
    np.testing.assert_allclose(found / filtered, np.full_like(found, (found / filtered)[0, 0]), rtol=1e-9)
    assert (found / filtered)[0, 0] == pytest.approx(1, abs=5e-3)


def test_lines_are_differentiated_exactly(stencil):
    line = 3.0 - 2.5 * 0.05 * np.arange(80)[:, None]
    np.testing.assert_allclose(stencil(line, 0.05), -2.5, rtol=1e-12)


def test_the_held_input_is_the_weighted_mean_that_belongs_to_the_difference(stencil):
    """dz/dt = u with u held between samples: the difference of z is the felt input, for any u."""
    rng = np.random.default_rng(1)
    inputs, h = rng.normal(size=(90, 3)), 0.013
    z = np.concatenate([np.zeros((1, 3)), h * np.cumsum(inputs, axis=0)])[:-1]
    np.testing.assert_allclose(stencil.held_input(inputs), stencil(z, h), rtol=0, atol=1e-12)


def test_the_mean_input_is_centred_at_the_sample_and_a_constant_input_is_unchanged(stencil):
    inputs = np.zeros((4 * stencil.half_width + 1, 1))
    inputs[2 * stencil.half_width] = 1.0
    felt = stencil.held_input(inputs)[:, 0]
    assert felt.sum() == pytest.approx(1, abs=1e-12)
    assert felt @ (np.arange(len(felt)) - stencil.half_width) == pytest.approx(0.5, abs=1e-10)
    np.testing.assert_allclose(stencil.held_input(np.full((50, 2), 0.7)), 0.7, rtol=1e-12)


def test_difference_held_and_sampled_input_belong_to_the_same_samples(stencil):
    w, t = stencil.half_width, np.arange(60.0)[:, None]
    np.testing.assert_array_equal(stencil.sampled_input(t), t[w:-w])
    assert len(stencil(t, 1.0)) == len(stencil.held_input(t)) == 60 - 2 * w
    np.testing.assert_allclose(stencil.held_input(t), t[w:-w] - 0.5, rtol=0, atol=1e-9)


def test_a_signal_shorter_than_the_stencil_gives_no_rows(stencil):
    for length in range(2 * stencil.half_width + 2):
        rows = max(length - 2 * stencil.half_width, 0)
        signal = np.ones((length, 2))
        for found in (stencil(signal, 0.1), stencil.held_input(signal), stencil.sampled_input(signal)):
            assert found.shape == (rows, 2)


def test_arrays_and_tensors_give_the_same(stencil):
    signal = np.random.default_rng(2).normal(size=(50, 2))
    tensor = torch.from_numpy(signal)
    np.testing.assert_allclose(stencil(tensor, 0.1).numpy(), stencil(signal, 0.1), rtol=1e-13)
    np.testing.assert_allclose(stencil.held_input(tensor).numpy(), stencil.held_input(signal), rtol=1e-13)


def test_smoothing_differences_pass_less_noise_than_central_ones_by_the_norm_of_their_weights():
    noise, h = np.random.default_rng(3).normal(size=(200_000, 1)), 0.01
    passed = {}
    for name, stencil in STENCILS.items():
        passed[name] = stencil(noise, h).std() * h
        assert passed[name] == pytest.approx(np.linalg.norm(stencil.weights), rel=0.02)
    assert passed["Savitzky-Golay 9, 4"] < 0.5 * passed["central 6"]
    assert passed["Gaussian 1.5"] < 0.25 * passed["central 6"]
    assert passed["central 2"] < passed["central 4"] < passed["central 6"] < passed["central 8"]


@pytest.mark.parametrize(("build", "message"), [
    (lambda: central_difference(3), "order 3; expected an even order of at least 2"),
    (lambda: central_difference(0), "order is 0; expected"),
    (lambda: savitzky_golay(8, 2), "window 8 and degree 2; expected an odd window"),
    (lambda: savitzky_golay(5, 5), "1 ≤ degree < window"), (lambda: savitzky_golay(5, 0), "degree is 0; expected"),
    (lambda: gaussian(0.1), r"width is 0\.1; expected"),
    (lambda: gaussian(float("nan")), "width is nan; expected"),
    (lambda: gaussian(float("inf")), "width is inf; expected"),
    (lambda: Stencil((1.0, 2.0)), "2 weights; expected an odd number of at least 3"),
    (lambda: Stencil((1.0,)), "1 weights"),
    (lambda: Stencil((-1.0, 0.0, 1.0)), "derivative of a ramp of slope 1 is 2; expected 0 and 1"),
    (lambda: Stencil((-0.5, 0.1, 0.5)), "sum of the weights is 0.1"),
    (lambda: Stencil((float("nan"),) * 3), "sum of the weights is nan")])
def test_an_invalid_stencil_is_refused_with_the_numbers(build, message):
    with pytest.raises(ValueError, match=message):
        build()
