"""Claims about the linear closed loop: it is the loop that runs, with its margins and its errors."""

from functools import partial

import numpy as np
import pytest
from conftest import H
from oscillators import Actuators, Oscillators

import ssmr_torch as ssmr
from ssmr_torch.control.disturbance_observer import DisturbanceObserver
from ssmr_torch.controller_design.linear_loop import Point
from ssmr_torch.controller_design.noises import Noises

DELAY, LAG = 2, 0.04
STILL = ssmr.tasks.path([0.0, 100.0], [[0.0, 0.0], [0.0, 0.0]], ["x", "y"])
PLAIN = {"huber": None, "approach": 0.0, "input_target": (0.0, 0.0), "posture_weight": None, "frozen_after": 0}


@pytest.fixture(scope="module")
def case(exact):
    return exact(Oscillators(), delay=DELAY, lag=LAG, move=40.0)


@pytest.fixture(scope="module")
def point(case):
    model = case.model
    return Point(model, case.actuator, np.zeros(model.state_dim), np.zeros(2), case.likelihood.free,
                 case.recordings.reach, case.recordings.input_range, case.recordings.tracked)


class Told:
    """An estimator that is told the state and the disturbance."""

    def reset(self):
        self.z, self.d = np.zeros(6), np.zeros(6)

    def measure(self, observation, last_input):
        pass

    def state(self):
        return self.z.copy(), None, self.d.copy()


def after_random_steps(case, rng, steps=4):
    """[s, d, v_{−1}] in the point's units after some steps of the controller, and its next v_0."""
    told, span, reach, rest = Told(), case.recordings.input_range, case.recordings.reach, at_rest(case.model)
    controller = case.controller(STILL, observer=lambda model, input_range: told, **PLAIN)
    actuators = Actuators(case.recordings.bounds, np.zeros(2), DELAY, LAG)
    last = np.zeros(2)
    for k in range(steps + 1):
        told.z, told.d = rest + 4e-4 * rng.standard_normal(6) * case.model.state_scale, 5e-6 * rng.standard_normal(6)
        before = np.concatenate([told.z, actuators.acts / span, np.ravel(actuators.late / span), told.d / reach,
                                 last / span])
        last = controller(k * H, np.zeros(6)).input
        actuators(last)
    assert np.abs(last).max() < 0.99 and not controller.fallbacks
    return before, last / span


def test_the_gain_is_the_first_input_of_the_program_that_runs(case, point, rng):
    """Two random states, of which the difference is looked at: the gain knows no offsets."""
    (one, v_one), (other, v_other) = after_random_steps(case, rng), after_random_steps(case, rng)
    assert np.abs(v_one - v_other).max() > 0.01
    np.testing.assert_allclose(point.gain(case.weights) @ (one - other), v_one - v_other, rtol=0, atol=1e-6)


def at_rest(model):
    return model.encode(np.zeros((1, 6)), np.zeros((0, 2)))


def kicked(case, kick, samples, extra=0, gain=1.0):
    """Outputs (samples, 6) of the model as the robot under the controller, kicked after the first measurement."""
    n, reach = case.model.state_dim, case.recordings.reach
    whole = case.likelihood.whole_gain(case.observer)
    whole[:n] /= reach
    watch = partial(DisturbanceObserver, gain=whole, covariance=1e6 * np.eye(6), limit=1e3, lost=1e3)
    controller = case.controller(STILL, observer=watch, **PLAIN)
    actuators = Actuators(case.recordings.bounds, np.zeros(2), DELAY + extra, LAG)
    z, outputs = at_rest(case.model) + kick, []
    for k in range(samples):
        y = case.model.decode(z)
        command = controller(k * H, y if k else np.zeros(6)).input
        outputs.append(y)
        z = case.model.step(z, gain * actuators(command))
    assert not controller.fallbacks and not controller.counts["gated"]
    return np.array(outputs)


@pytest.mark.parametrize("extra, gain", [(0, 1.0), (2, 1.0), (0, 0.5), (0, 2.0)],
                         ids=["as it is", "delayed", "halved", "doubled"])
def test_the_matrix_of_the_loop_is_the_loop_that_runs_sample_by_sample(case, point, rng, extra, gain):
    """Every mode that the kick excites shows, so that its eigenvalues are those of the loop."""
    kick = 0.02 * rng.standard_normal(6) * case.model.state_scale
    seen = kicked(case, kick, 120, extra, gain)
    loop, C, _, _ = point.loop(case.observer, case.weights, extra=extra, gain=gain)
    x, said = np.zeros(len(loop)), []
    x[:6] = kick
    for _ in seen:
        said.append(C @ x[:C.shape[1]] * case.recordings.reach)
        x = loop @ x
    np.testing.assert_allclose(seen, said, rtol=0, atol=2e-5 * np.abs(seen).max())


def test_the_margins_are_the_spectral_radii_of_those_loops(case, point):
    margins = point.margins(case.observer, case.weights, extra=2)
    for value, changed in zip(margins.values, ({}, {"extra": 2}, {"gain": 0.5}, {"gain": 2.0})):
        loop, *_ = point.loop(case.observer, case.weights, **changed)
        assert value == pytest.approx(np.abs(np.linalg.eigvals(loop)).max(), rel=1e-9)
    assert margins.nominal < 1.0


def test_a_loop_with_a_margin_above_one_diverges_and_one_below_does_not(case, point, rng):
    kick = 1e-5 * rng.standard_normal(6) * case.model.state_scale
    radius = {extra: point.margins(case.observer, case.weights, extra).delayed for extra in (2, 12)}
    assert radius[2] < 1.0 < 1.02 < radius[12]
    calm, wild = (np.abs(kicked(case, kick, 120, extra)) for extra in (2, 12))
    assert calm[-20:].max() < calm[:20].max() and wild[-20:].max() > 3 * wild[:20].max()


def test_an_unstable_loop_has_no_other_margins(case, point):
    backwards = type(case.observer)(-case.observer.gain, case.observer.covariance, case.observer.process,
                                    case.observer.sensor)
    margins = point.margins(backwards, case.weights, extra=2)
    assert margins.nominal >= 1.0 and margins.values[1:] == (np.inf,) * 4 and margins.shortfall(2.0) == np.inf
    assert point.predicted_variance(backwards, case.observer, case.weights) == np.inf


def test_the_sensitivity_is_what_the_loop_makes_of_a_wave_on_the_outputs(case, point):
    """Measured y + e^{iωk} in one direction: the outputs with it, once the loop has settled."""
    omega = 0.5
    [peak] = point.sensitivity(case.observer, case.weights, np.array([omega]))
    loop, C, K, watch = point.loop(case.observer, case.weights)
    answers = []
    for column in case.recordings.tracked:
        x, wave = np.zeros(len(loop), complex), np.eye(6)[column]
        for k in range(3000):
            x = loop @ x
            x[watch] += K @ wave * np.exp(1j * omega * (k + 1))
        answers.append((C @ x[:C.shape[1]] * np.exp(-1j * omega * 3000) + wave)[list(case.recordings.tracked)])
    assert peak == pytest.approx(np.linalg.norm(np.array(answers).T, 2), rel=1e-6)


def test_the_predicted_error_is_that_of_many_loops_with_these_noises(case, point, rng):
    """300 loops with random noises, written out from robot, filter and gain."""
    truth = case.likelihood.observer(Noises(0.02, 3e-3, 3e-4, 1e-3))
    A, B, C, K, gain = point.A, point.B, point.C, case.observer.gain, point.gain(case.weights)
    n, N, tracked = point.n, len(A), list(case.recordings.tracked)
    spread = {name: np.linalg.cholesky(matrix + 1e-30 * np.eye(len(matrix)))
              for name, matrix in (("process", truth.process), ("sensor", truth.sensor))}
    count, squares = 300, []
    x, z, d, dz, last = (np.zeros((count, size)) for size in (N, N, 6, 6, 2))
    for k in range(1000):
        last = np.hstack([z, dz, last]) @ gain.T
        w = rng.standard_normal((count, n + 6)) @ spread["process"].T
        x, d = x @ A.T + last @ B.T, d + w[:, n:]
        x[:, :n] += w[:, :n]
        z = z @ A.T + last @ B.T
        e = x @ C.T + d + rng.standard_normal((count, 6)) @ spread["sensor"].T - z @ C.T - dz
        z[:, :n] += e @ K[:n].T
        dz = dz + e @ K[n:].T
        if k >= 600:
            squares.append(np.square((x @ C.T + d)[:, tracked]).sum(1).mean())
    assert point.predicted_variance(case.observer, truth, case.weights) == pytest.approx(np.mean(squares), rel=0.1)
