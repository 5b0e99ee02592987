"""Claims about quadratic programs and their solvers."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import nnls

from ssmr_torch.control.qpsolvers_adapter import QPSolvers
from ssmr_torch.control.quadratic_program import QPSolution, QuadraticProgram
from ssmr_torch.control.solvers.proxqp import PROXQP_STATUS, ProxQP, proxqp
from ssmr_torch.status import Status

D, ROWS = 8, 5


def random_problem(rng, rows=0, equal=False):
    """A strictly convex problem with a feasible point, in which about half of the bounds are active."""
    G = rng.standard_normal((2 * D, D))
    inside = rng.uniform(-1, 1, D)
    box = inside - rng.uniform(0, 1, D), inside + rng.uniform(0, 1, D)
    arguments = G.T @ G + np.eye(D), 10 * rng.standard_normal(D), *box
    if not rows:
        return QuadraticProgram(*arguments)
    C = rng.standard_normal((rows, D))
    row_lower = C @ inside - rng.uniform(0, 0.5, rows)
    row_upper = row_lower + (0.5 + rng.uniform(0, 0.5, rows))
    return QuadraticProgram(*arguments, C, row_lower, row_upper)


def dual_by_nnls(problem):
    """The same problem as a least-distance problem solved by non-negative least squares [Lawson & Hanson, ch.
    23].
    """
    I = np.eye(problem.dim)
    G, h = np.vstack([I, -I]), np.concatenate([problem.lower, -problem.upper])
    if problem.C is not None:
        G = np.vstack([G, problem.C, -problem.C])
        h = np.concatenate([h, problem.row_lower, -problem.row_upper])
    L = np.linalg.cholesky(problem.H)
    start = -np.linalg.solve(problem.H, problem.g)
    E = np.vstack([np.linalg.solve(L, G.T), h - G @ start])
    f = np.zeros(problem.dim + 1)
    f[-1] = 1.0
    r = E @ nnls(E, f, maxiter=1000)[0] - f
    return start + np.linalg.solve(L.T, -r[:-1] / r[-1])


def kkt_error(problem, solution):
    """Largest violation of stationarity, feasibility, sign and complementarity."""
    x, w, z = solution.x, solution.box_multipliers, solution.row_multipliers
    values, low, high, multipliers = x, problem.lower, problem.upper, w
    stationarity = problem.H @ x + problem.g + w
    if problem.C is not None:
        stationarity = stationarity + problem.C.T @ z
        values, multipliers = np.concatenate([x, problem.C @ x]), np.concatenate([w, z])
        low = np.concatenate([low, problem.row_lower])
        high = np.concatenate([high, problem.row_upper])
    complementarity = np.where(multipliers > 0, multipliers * (high - values), -multipliers * (values - low))
    return max(np.abs(stationarity).max(), (low - values).max(), (values - high).max(),
               np.abs(complementarity).max())


@pytest.mark.parametrize("rows", [0, ROWS])
def test_the_solution_is_that_of_an_independent_method_for_hundreds_of_problems(rows):
    rng, solver = np.random.default_rng(0), ProxQP(D, rows, tolerance=1e-9)
    active = 0
    for _ in range(200):
        problem = random_problem(rng, rows)
        solution = solver.solve(problem)
        assert solution.status is Status.SOLVED
        np.testing.assert_allclose(solution.x, dual_by_nnls(problem), atol=1e-7)
        assert kkt_error(problem, solution) < 1e-6
        active += (np.abs(solution.box_multipliers) > 1e-6).sum()
    assert active > 200


@pytest.mark.parametrize("rows", [0, ROWS])
def test_qpsolvers_gives_the_same_solution_and_multipliers(rows):
    rng, solver = np.random.default_rng(1), ProxQP(D, rows, tolerance=1e-9)
    other = QPSolvers("proxqp", tolerance=1e-6, eps_abs=1e-9, eps_rel=0.0)
    for _ in range(20):
        problem = random_problem(rng, rows)
        ours, theirs = solver.solve(problem), other.solve(problem)
        assert theirs.status is Status.SOLVED
        np.testing.assert_allclose(ours.x, theirs.x, atol=1e-7)
        np.testing.assert_allclose(ours.box_multipliers, theirs.box_multipliers, atol=1e-6)
        np.testing.assert_allclose(ours.row_multipliers, theirs.row_multipliers, atol=1e-6)


def test_the_residuals_are_those_of_the_problem():
    problem = random_problem(np.random.default_rng(2), ROWS)
    x, w, z = np.full(D, 3.0), np.zeros(D), np.full(ROWS, 0.1)
    solution = QPSolution.judged(problem, x, w, z, Status.ITERATION_LIMIT, 1, 1e-6)
    Cx = problem.C @ x
    assert solution.primal_residual == pytest.approx(
        max((x - problem.upper).max(), (problem.lower - x).max(), (Cx - problem.row_upper).max(),
            (problem.row_lower - Cx).max()))
    assert solution.dual_residual == pytest.approx(np.abs(problem.H @ x + problem.g + problem.C.T @ z).max())
    assert solution.gap == pytest.approx(abs(x @ problem.H @ x + problem.g @ x + problem.row_upper @ z))


def test_a_solution_with_large_residuals_is_not_a_success():
    problem = random_problem(np.random.default_rng(3))
    claim = (problem.lower.copy(), np.zeros(D), np.zeros(0), Status.SOLVED, 1, 1e-6)
    assert QPSolution.judged(problem, *claim).status is Status.RESIDUAL_TOO_LARGE


def test_every_status_of_proxqp_has_a_meaning_and_only_solved_is_success():
    assert set(PROXQP_STATUS) == set(proxqp.QPSolverOutput)
    assert [theirs for theirs, ours in PROXQP_STATUS.items() if ours.success] == [proxqp.PROXQP_SOLVED]
    assert PROXQP_STATUS[proxqp.PROXQP_SOLVED_CLOSEST_PRIMAL_FEASIBLE] is Status.CLOSEST_FEASIBLE
    assert len(set(PROXQP_STATUS.values())) == len(PROXQP_STATUS)


BOX = -np.ones(2), np.ones(2)
FREE = np.full(2, -np.inf), np.full(2, np.inf)
ROW = np.ones((1, 2)), np.array([-np.inf]), np.array([1.0])
DEFECTIVE = {
    "rows beyond the box": (Status.PRIMAL_INFEASIBLE, np.eye(2), np.ones(2), *BOX, ROW[0], np.array([5.0]),
                            np.array([6.0])),
    "crossed box": (Status.PRIMAL_INFEASIBLE, np.eye(2), np.ones(2), BOX[1], BOX[0], *ROW),
    "crossed rows": (Status.PRIMAL_INFEASIBLE, np.eye(2), np.ones(2), *BOX, ROW[0], np.array([1.0]),
                     np.array([0.0])),
    "unbounded": (Status.DUAL_INFEASIBLE, np.zeros((2, 2)), np.ones(2), *FREE, *ROW),
    "not convex": (Status.DUAL_INFEASIBLE, np.diag([1.0, -1.0]), np.ones(2), *BOX, *ROW),
    "NaN in the cost": (Status.NOT_FINITE, np.eye(2), np.array([np.nan, 0.0]), *BOX, *ROW),
    "infinite cost": (Status.NOT_FINITE, np.diag([1.0, np.inf]), np.ones(2), *BOX, *ROW),
    "NaN in a bound": (Status.NOT_FINITE, np.eye(2), np.ones(2), np.array([np.nan, -1.0]), BOX[1], *ROW),
    "NaN in the rows": (Status.NOT_FINITE, np.eye(2), np.ones(2), *BOX, ROW[0] * np.nan, *ROW[1:]),
}


@pytest.mark.parametrize("make", [lambda: ProxQP(2, 1), lambda: QPSolvers("proxqp", eps_abs=1e-9)],
                         ids=["ProxQP", "qpsolvers"])
@pytest.mark.parametrize("case", DEFECTIVE)
def test_a_problem_without_a_solution_gets_the_status_that_says_why(case, make):
    solver = make()
    status, *arguments = DEFECTIVE[case]
    problem = QuadraticProgram(*arguments)
    assert solver.solve(problem).status is status
    sound = QuadraticProgram(np.eye(2), np.array([-3.0, -1.0]), *BOX, *ROW)
    np.testing.assert_allclose(solver.solve(sound).x, [1.0, 0.0], atol=1e-5)


def test_the_iteration_limit_has_its_own_status():
    problem = random_problem(np.random.default_rng(4), ROWS)
    assert ProxQP(D, ROWS, tolerance=1e-12, max_iterations=1).solve(problem).status is Status.ITERATION_LIMIT


def test_no_multiplier_of_the_wrong_sign_passes_on_a_bound_at_zero():
    """There the gap cannot see it: the multiplier times the bound is zero whatever its sign."""
    rng, solver = np.random.default_rng(8), ProxQP(D)
    for _ in range(300):
        G = rng.standard_normal((3, D))
        problem = QuadraticProgram(30 * G.T @ G + 2 * np.eye(D), 5 * rng.standard_normal(D), np.zeros(D),
                                   np.ones(D))
        solution = solver.solve(problem)
        assert solution.status is Status.SOLVED
        assert kkt_error(problem, solution) < 1e-4


def test_infinite_bounds_are_absent():
    problem = QuadraticProgram(np.eye(2), np.array([-3.0, 1.0]), *FREE, *ROW)
    solution = ProxQP(2, 1, tolerance=1e-9).solve(problem)
    np.testing.assert_allclose(solution.x, [2.5, -1.5], atol=1e-8)
    np.testing.assert_allclose(solution.row_multipliers, [0.5], atol=1e-8)


def test_the_workspace_forgets_on_reset():
    rng, solver = np.random.default_rng(5), ProxQP(D, ROWS)
    problems = [random_problem(rng, ROWS) for _ in range(4)]
    first = [solver.solve(problem).x for problem in problems]
    solver.reset()
    np.testing.assert_allclose(first, [solver.solve(problem).x for problem in problems], rtol=0, atol=1e-12)


def test_a_warm_start_needs_fewer_iterations_and_gives_the_same_solution():
    problem = random_problem(np.random.default_rng(6), ROWS)
    warm, cold = ProxQP(D, ROWS, tolerance=1e-9, warm=True), ProxQP(D, ROWS, tolerance=1e-9, warm=False)
    for solver in (warm, cold):
        solver.solve(problem)
    near = replace(problem, g=problem.g + 1e-3)
    ours, theirs = warm.solve(near), cold.solve(near)
    assert ours.iterations < theirs.iterations
    np.testing.assert_allclose(ours.x, theirs.x, atol=1e-8)


def test_a_workspace_that_advances_starts_where_the_same_variables_ended():
    """Here the next program is the last one with its variables and rows in another order."""
    rng, solvers = np.random.default_rng(9), [ProxQP(D, ROWS, tolerance=1e-9) for _ in range(2)]
    problem, variables, rows = random_problem(rng, ROWS), rng.permutation(D), rng.permutation(ROWS)
    moved = QuadraticProgram(problem.H[np.ix_(variables, variables)], problem.g[variables], problem.lower[variables],
                             problem.upper[variables], problem.C[np.ix_(rows, variables)], problem.row_lower[rows],
                             problem.row_upper[rows])
    solvers[0].advance(variables, rows)  # nothing to start from: nothing happens
    first = [solver.solve(problem) for solver in solvers][0]
    solvers[0].advance(variables, rows)
    advanced, left = [solver.solve(moved) for solver in solvers]
    assert advanced.iterations <= 2 < left.iterations
    for solution in (advanced, left):
        np.testing.assert_allclose(solution.x, first.x[variables], atol=1e-8)


def test_the_arrays_of_the_problem_are_left_alone():
    problem = random_problem(np.random.default_rng(7), ROWS)
    before = [array.copy() for array in problem._parts()]
    ProxQP(D, ROWS).solve(problem)
    for array, copy in zip(problem._parts(), before):
        np.testing.assert_array_equal(array, copy)


def test_shapes_that_disagree_are_refused():
    with pytest.raises(ValueError, match="expected"):
        QuadraticProgram(np.eye(2), np.ones(3), np.ones(2), np.ones(2))
    with pytest.raises(ValueError, match="missing"):
        QuadraticProgram(np.eye(2), np.ones(2), *BOX, ROW[0])
    with pytest.raises(ValueError, match="as in this workspace"):
        ProxQP(3).solve(QuadraticProgram(np.eye(2), np.ones(2), *BOX))
    with pytest.raises(ValueError, match="not installed"):
        QPSolvers("no such solver")
