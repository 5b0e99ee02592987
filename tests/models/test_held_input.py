"""Claims about the split of a form into a polynomial in z for a held input."""

import numpy as np
import pytest

from ssmr_torch.models.held_input import Split, split
from ssmr_torch.models.monomials import Form, Monomials


def any_form(seed: int) -> tuple[Form, int]:
    """A form of random monomials of up to degree four in one to three states and inputs each, and its states."""
    rng = np.random.default_rng(seed)
    n, m = rng.integers(1, 4, 2)
    rows = {tuple(sorted(rng.integers(0, n + m, rng.integers(0, 5)).tolist())) for _ in range(rng.integers(0, 9))}
    monomials = Monomials(int(n + m), [row for row in rows if seed % 3 or len(row) != 1])  # some have no linear ones
    return Form(monomials, rng.normal(size=(rng.integers(1, 4), len(monomials)))), int(n)


def held(free: np.ndarray, runs: np.ndarray, fields: np.ndarray, powers: np.ndarray) -> np.ndarray:
    """The table over the closure of z while u, whose closure is powers, is held."""
    table = free.copy()
    for place, first, count, offset in runs:
        table[:, first:first + count] += powers[place] * fields[:, offset:offset + count]
    return table


def by_input(parts: Split, powers: np.ndarray, inputs: int) -> np.ndarray:
    """The tables of ∂f/∂u_j, (m, rows, columns_u)."""
    tables = np.zeros((inputs, len(parts.free), parts.columns_u))
    for place, factor, j, first, count, offset in parts.runs_u:
        tables[j][:, first:first + count] += factor * powers[place] * parts.fields[:, offset:offset + count]
    return tables


@pytest.mark.parametrize("seed", range(60))
def test_a_split_form_and_its_derivatives_equal_the_form(seed):
    form, n = any_form(seed)
    x = np.random.default_rng(seed).normal(size=form.monomials.variables)
    parts, closure = split(form, n), form.monomials.multiplied_out(x)
    states, powers = parts.states.multiplied_out(x[:n]), parts.inputs.multiplied_out(x[n:])

    def seen(table):
        return table @ states[:table.shape[-1]]

    for found, expected in (
            (seen(held(parts.free, parts.runs, parts.fields, powers)), form(x)),
            (seen(held(parts.free_z, parts.runs_z, parts.fields_z, powers)).reshape(-1, n),
             form.jacobian(closure, 0, n)),
            (seen(by_input(parts, powers, len(x) - n)).T, form.jacobian(closure, n, len(x)))):
        np.testing.assert_allclose(found, expected, rtol=1e-12, atol=1e-12)
