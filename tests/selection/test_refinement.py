"""Gauss-Newton steps on rollouts: the gradient by differences, and a linear problem in closed form."""

import numpy as np
import pytest

from ssmr_torch.selection.closed_form import ALL, ClosedForm
from ssmr_torch.selection.refinement import Problem, _cost, _normal_equations, _weights, refine
from ssmr_torch.selection.specification import Specification


def problem_of(systems, horizon, features="configuration_affine", ridge=0.5, **more):
    """A model spoilt by a large ridge, and starts of so many steps."""
    samples = systems.samples(systems.configuration_affine)
    closed = ClosedForm(samples, Specification(memory=("shift", 1), features=features, **more))
    starts = samples.starts(samples.rows(horizon, decays=False)[::8], horizon)
    return Problem(closed.model(ridge), closed.charts[ALL].E, starts, [0, 1])


def test_sensitivities_are_those_by_central_differences(systems):
    problem = problem_of(systems, 10)
    model = problem.model
    weights, shape = _weights(problem, model), (2, len(model.structure.dynamics))
    gradient = _normal_equations(problem, model, weights)[1].reshape(shape)
    rng = np.random.default_rng(0)
    for _ in range(4):
        way = rng.normal(size=shape) * np.abs(model.dynamics[:2]).max() * 1e-6
        ahead, behind = (_cost(problem.errors(problem.changed(sign * way)), weights) for sign in (1, -1))
        assert (gradient * way).sum() == pytest.approx(-0.25 * (ahead - behind), rel=2e-3)


def test_one_step_ahead_the_refinement_reaches_the_least_squares_solution(systems):
    """Rollouts of one step are linear in the table."""
    problem = problem_of(systems, 1, features="bilinear", ridge=100.0)
    model, starts = problem.model, problem.starts
    z, measured = problem.begin(model)
    X, left = model.dynamics_regressors(z, starts.inputs[:, 0]), problem.errors(model)[:, 0]
    C = model.linearize_output(z).C[0, :, :len(problem.E)] @ problem.E
    best = np.linalg.lstsq(X / np.abs(X).max(0), left @ np.linalg.inv(C).T, rcond=None)[0]
    least = np.square(left - X / np.abs(X).max(0) @ best @ C.T).mean()
    before, after = (np.square(problem.errors(each)).mean() for each in (model, refine(problem, 1e-9)))
    assert before > 1.2 * least and after < 1.001 * least


def test_refinement_lowers_the_error_of_rollouts_and_a_strong_pull_keeps_the_closed_form(systems):
    problem = problem_of(systems, 25)
    before, free, held = (np.square(problem.errors(each)).mean()
                          for each in (problem.model, refine(problem, 1e-4), refine(problem, 1e6)))
    assert free < 0.1 * before and held == pytest.approx(before, rel=1e-2)


def test_an_exact_model_is_not_changed(systems):
    problem = problem_of(systems, 10, ridge=0.0)
    assert np.abs(refine(problem, 1e-4).dynamics - problem.model.dynamics).max() < 1e-6
