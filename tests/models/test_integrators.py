import numpy as np

from ssmr_torch.models.integrators import rk4_linearization, rk4_step


def pendulum(z):
    return np.stack([z[..., 1], -np.sin(z[..., 0]) - 0.2 * z[..., 1]], axis=-1)


def test_the_runge_kutta_step_has_order_four():
    z = np.array([1.0, 0.3])
    exact = rk4_step(pendulum, z, 1.0, substeps=4096)
    errors = [np.linalg.norm(rk4_step(pendulum, z, 1.0, substeps) - exact) for substeps in (4, 8, 16, 32)]
    orders = np.log2(np.array(errors[:-1]) / errors[1:])
    assert np.all(np.abs(orders - 4) < 0.2), orders


def test_the_sensitivities_are_the_derivatives_of_the_step_itself():
    F, G = np.array([[0.0, 1.0], [-4.0, -0.3]]), np.array([[0.0], [2.0]])
    u = np.array([0.7])
    z = np.array([0.4, -0.2])
    following, A, B = rk4_linearization(lambda x: x @ F.T + G @ u, lambda x: (F, G), z, np.eye(2), 0.1, substeps=3)
    step = lambda x, v: rk4_step(lambda s: s @ F.T + G @ v, x, 0.1, substeps=3)  # noqa: E731
    np.testing.assert_allclose(following, step(z, u), rtol=1e-15)
    difference_A = np.stack([step(z + e, u) - step(z, u) for e in np.eye(2)], axis=1)
    np.testing.assert_allclose(A, difference_A, atol=1e-14)
    np.testing.assert_allclose(B[:, 0], step(z, u + 1) - step(z, u), atol=1e-14)
