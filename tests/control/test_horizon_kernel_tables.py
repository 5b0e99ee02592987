"""Claims about the tables of the compiled kernel."""

from functools import partial

import numpy as np
import pytest

from ssmr_torch.control import horizon_kernel as kernel
from ssmr_torch.control import horizon_kernel_tables as kernel_tables
from ssmr_torch.models.monomials import Monomials
from ssmr_torch.models.polynomial import PolynomialModel
from ssmr_torch.models.structure import SCHEMES, Structure


def any_model(seed: int, scheme: str) -> PolynomialModel:
    """One to three states and inputs, random monomials of up to degree three, with the constant in some; saturated in
    some, and then in some with an entry of the state that the training never moved.
    """
    rng = np.random.default_rng(seed)
    n, m, p, delays = (int(size) for size in (*rng.integers(1, 4, 3), rng.integers(0, 2)))

    def monomials(variables: int, count: int) -> Monomials:
        rows = {tuple(sorted(rng.integers(0, variables, rng.integers(0, 4)).tolist())) for _ in range(count)}
        return Monomials(variables, sorted(rows))

    chart = monomials((delays + 1) * p, 4)
    structure = Structure(chart, tuple(range((delays + 1) * p)), monomials(n, 4), monomials(n + m, 8), scheme,
                          saturated=seed % 2 == 0)
    table = partial(rng.uniform, -0.5, 0.5)
    return PolynomialModel(
        structure=structure, chart=table(size=(n, len(chart))),
        parametrization=table(size=(p, len(structure.parametrization))),
        dynamics=table(size=(n, len(structure.dynamics))), state_scale=np.where(rng.random(n) < 0.3, 0.0, 0.2),
        input_dim=m, output_dim=p, delays=delays, timestep=0.02, window_timestep=0.02, substeps=2,
        base_timestep=None if scheme == "runge_kutta" else 0.01)


@pytest.mark.parametrize("scheme", SCHEMES)
@pytest.mark.parametrize("seed", range(20))
def test_folded_and_joint_tables_give_the_steps_and_the_jacobians_of_the_model(seed, scheme, monkeypatch):
    model, rng = any_model(seed, scheme), np.random.default_rng(seed)
    z, u = 0.5 * rng.normal(size=model.state_dim), rng.normal(size=(3, model.input_dim))
    states = model.states(z, u)
    expected = (states, model.decode(states[1:]), *model.linearize(states[:-1], u)[:2],
                model.linearize_output(states[1:]).C)
    for scattered in (-1e9, 1e9):
        monkeypatch.setattr(kernel_tables, "SCATTERED", scattered)
        tables = kernel_tables.tables_of(model)
        for found, sought in zip(kernel.linearize(z, u, tuple(tables)), expected):
            np.testing.assert_allclose(found, sought, rtol=1e-11, atol=1e-12)
        for found, sought in zip(kernel.rollout(z, u, tuple(tables)), expected):
            np.testing.assert_allclose(found, sought, rtol=1e-11, atol=1e-12)


def test_both_kinds_of_tables_are_chosen_where_they_cost_less(monkeypatch):
    """Which the claim above needs: a model whose input is folded in, and the same with the joint tables."""
    model = any_model(1, "runge_kutta")
    found = []
    for scattered in (-1e9, 1e9):
        monkeypatch.setattr(kernel_tables, "SCATTERED", scattered)
        found.append(kernel_tables.tables_of(model).variables)
    assert found == [model.state_dim, model.state_dim + model.input_dim]
