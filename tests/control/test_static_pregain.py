"""Static pregain with a linear-quadratic regulator."""

import numpy as np
import pytest
from scipy.linalg import solve_discrete_are
from scipy.optimize import minimize

from ssmr_torch.closed_loop.simulation import simulate
from ssmr_torch.control.static_pregain import STATE_WEIGHT, StaticPregainController, completion, regulator_gain
from ssmr_torch.models.named_structures import koopman
from ssmr_torch.models.torch_model import FixedModel
from ssmr_torch.status import Status
from ssmr_torch.tasks.references import figure_eight

BOUNDS = np.array([[-40.0, -40.0], [40.0, 40.0]])
TASK = figure_eight(tracked=("tip_x", "tip_y"), amplitude=0.01, angular_speed=0.2, laps=0.5)
NAMES = ("tip_x", "tip_y")


def damped_masses(**changes):
    """ÿ = −25 y − 3 ẏ + 0.01 u by semi-implicit Euler steps of 0.01 s, as a linear model of [y_k, y_{k-1}]."""
    h, k, d, b = 0.01, 25.0, 3.0, 0.01
    I, Z = np.eye(2), np.zeros((2, 2))
    A = np.block([[(2 - h * d - h * h * k) * I, (h * d - 1) * I], [I, Z]])
    options = {"scale": np.ones(4), "A": A, "B": np.vstack([h * h * b * I, Z]), "N": np.zeros((0, 4, 4)),
               "pregain": np.hstack([np.ones((2, 1)), k / b * I]), "set_points": np.eye(3),
               "degree": 1, "input_delays": 0, "constant": False,
               "state_scale": np.full(4, 0.05), "input_dim": 2, "output_dim": 2, "delays": 1, "timestep": 0.01,
               "window_timestep": 0.01, "base_timestep": 0.01}
    return koopman(**options | changes)


def three_masses(set_points):
    """The same two masses, and a third output that rests."""
    two = damped_masses()
    A, B = np.zeros((6, 6)), np.zeros((6, 2))
    A[np.ix_([0, 1, 3, 4], [0, 1, 3, 4])], B[[0, 1, 3, 4]] = two.dynamics[:, :4], two.dynamics[:, 4:]
    return damped_masses(scale=np.ones(6), A=A, B=B, N=np.zeros((0, 6, 6)), state_scale=np.full(6, 0.05), output_dim=3,
                         pregain=np.hstack([two.pregain, [[50.0], [-20.0]]]), set_points=set_points)


class Plant:
    """The model itself as the robot."""

    name, timestep, output_names, input_names, input_unit = "masses", 0.01, NAMES, ("a", "b"), "N"
    input_bounds = BOUNDS

    def __init__(self, model):
        self.model = model

    def reset(self, seed=0):
        self.z = np.zeros(4)
        return self.displacement

    def step(self, u):
        self.z = self.model.advance(self.z, u)
        return self.displacement

    @property
    def displacement(self):
        return self.model.decode(self.z)


def random_system(seed=0):
    rng = np.random.default_rng(seed)
    A, B = rng.normal(size=(5, 5)), rng.normal(size=(5, 2))
    return A / np.abs(np.linalg.eigvals(A)).max() * 1.1, B, np.diag(rng.uniform(0.5, 2, 5)), 0.3 * np.eye(2)


def test_the_stationary_gain_is_scipys_and_the_recursion_converges_to_it():
    A, B, Q, R = random_system()
    P = solve_discrete_are(A, B, Q + STATE_WEIGHT * np.abs(Q).max() * np.eye(5), R)
    expected = np.linalg.solve(R + B.T @ P @ B, B.T @ P @ A)
    np.testing.assert_allclose(regulator_gain(A, B, Q, R), expected, rtol=1e-10)
    np.testing.assert_allclose(regulator_gain(A, B, Q, R, horizon=200), expected, rtol=1e-8)


def test_the_first_input_of_the_finite_horizon_minimizes_the_cost_over_it():
    A, B, Q, R = random_system(1)
    z0 = np.arange(1.0, 6.0)
    Q_used = Q + STATE_WEIGHT * np.abs(Q).max() * np.eye(5)

    def cost(v):
        z, total = z0, 0.0
        for u in v.reshape(4, 2):
            total += z @ Q_used @ z + u @ R @ u
            z = A @ z + B @ u
        return total + z @ Q_used @ z

    best = minimize(cost, np.zeros(8), method="BFGS", options={"gtol": 1e-9}).x.reshape(4, 2)
    np.testing.assert_allclose(-regulator_gain(A, B, Q, R, horizon=4) @ z0, best[0], rtol=1e-4, atol=1e-5)


def test_at_rest_on_the_reference_the_input_is_the_pregain_alone():
    task = figure_eight(tracked=NAMES, amplitude=0.01, angular_speed=1.0, laps=1.0)
    controller = StaticPregainController(damped_masses(), task, BOUNDS, output_names=NAMES)
    there = task.reference(np.array([0.0]))[0]
    np.testing.assert_allclose(controller(0.0, there).input, 1 + 2500 * there, atol=1e-9)


def test_it_follows_a_slow_figure_eight_and_counts_nothing():
    controller = StaticPregainController(damped_masses(), TASK, BOUNDS, output_names=NAMES)
    record = simulate(Plant(damped_masses()), controller, TASK)
    assert np.abs(record.error[100:]).max() < 1e-3 and not controller.fallbacks


def test_a_measurement_that_is_not_finite_gives_the_safe_input_and_is_counted():
    controller = StaticPregainController(damped_masses(), TASK, BOUNDS, output_names=NAMES, safe_input=[1.0, 2.0])
    command = controller(0.0, np.array([np.nan, 0.0]))
    assert command.fallback is Status.NOT_FINITE and command.input.tolist() == [1.0, 2.0]
    assert controller.fallbacks[Status.NOT_FINITE] == 1
    for k in range(1, 6):
        command = controller(0.01 * k, np.zeros(2))
    assert command.fallback is None


def test_outputs_that_the_task_leaves_free_are_those_of_set_points_on_average_and_never_the_measured_ones():
    """Over set points y2 = 3 + 2 y1 (mm): the pregain sees that, whatever y2 is measured."""
    task = figure_eight(tracked=("tip_x", "tip_y"), amplitude=0.01, angular_speed=1.0, laps=1.0)
    rng = np.random.default_rng(0)
    y = 0.01 * rng.normal(size=(40, 2))
    points = np.column_stack([np.ones(40), y, 3e-3 + y @ [2.0, -1.0]])
    completed = points[:, :3] @ completion(np.linalg.qr(points).R, [0, 1])
    np.testing.assert_allclose(completed, points[:, 1:], atol=1e-12)
    model = three_masses(np.linalg.qr(points).R)
    there = np.r_[task.reference(np.array([0.0]))[0], 0.0]
    for measured in (0.0, 0.02):
        controller = StaticPregainController(model, task, BOUNDS, output_names=(*NAMES, "tip_z"), input_weight=1e30)
        there[2] = measured
        expected = model.pregain @ np.r_[1.0, there[:2], 3e-3 + there[:2] @ [2.0, -1.0]]
        np.testing.assert_allclose(controller(0.0, there).input, expected, rtol=1e-9)


def test_a_constant_among_the_states_changes_no_input():
    linear = damped_masses()
    affine = damped_masses(A=np.block([[np.eye(1), np.zeros((1, 4))], [np.zeros((4, 1)), linear.dynamics[:, :4]]]),
                           B=np.vstack([np.zeros(2), linear.dynamics[:, 4:]]), N=np.zeros((0, 5, 5)), constant=True,
                           state_scale=np.r_[1.0, linear.state_scale])
    one, other = (StaticPregainController(model, TASK, BOUNDS, output_names=NAMES) for model in (linear, affine))
    for k, measured in enumerate(0.01 * np.random.default_rng(0).uniform(-1, 1, (20, 2))):
        np.testing.assert_allclose(one(0.01 * k, measured).input, other(0.01 * k, measured).input, rtol=1e-9)


@pytest.mark.parametrize("changes", [{"pregain": np.zeros((0, 3))}, {"N": np.zeros((2, 4, 4))}])
def test_a_model_without_pregain_or_with_bilinear_terms_is_refused(changes):
    with pytest.raises(ValueError, match="train one with model=static_pregain"):
        StaticPregainController(damped_masses(**changes), TASK, BOUNDS, output_names=NAMES)


def test_impossible_settings_are_refused():
    with pytest.raises(ValueError, match="expected a whole multiple"):
        StaticPregainController(damped_masses(), TASK, BOUNDS, output_names=NAMES, period=0.015)
    with pytest.raises(ValueError, match="safe_input is"):
        StaticPregainController(damped_masses(), TASK, BOUNDS, output_names=NAMES, safe_input=[99.0, 0.0])
    with pytest.raises(ValueError, match="horizon is 0"):
        regulator_gain(*random_system(), horizon=0)


def test_a_torch_module_steers_as_its_model_does():
    model = damped_masses()
    ours, theirs = (StaticPregainController(each, TASK, BOUNDS, output_names=NAMES) for each in
                    (FixedModel(model), model))
    np.testing.assert_array_equal(ours(0.0, np.full(2, 1e-3)).input, theirs(0.0, np.full(2, 1e-3)).input)
