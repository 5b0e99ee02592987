"""Claims about solvers by their names: those of the package, those of qpsolvers, and anybody's."""

import sys

import numpy as np
import pytest

from ssmr_torch.control.mpc import ModelPredictiveController
from ssmr_torch.control.quadratic_program import QuadraticProgram
from ssmr_torch.control.solvers import solver_named, solver_names
from ssmr_torch.tasks.references import figure_eight

FOREIGN = '''
"""A solver of somebody else: projected gradient for programs without general rows."""

import numpy as np

from ssmr_torch.control.quadratic_program import QPSolution
from ssmr_torch.status import Status


class ProjectedGradient:
    def __init__(self, dim, rows, *, iterations=2000):
        self.dim, self.rows, self.iterations = dim, rows, iterations

    def reset(self):
        """Nothing is kept."""

    def solve(self, problem):
        x, step = np.clip(np.zeros(self.dim), problem.lower, problem.upper), 1 / np.linalg.eigvalsh(problem.H)[-1]
        for _ in range(self.iterations):
            x = np.clip(x - step * (problem.H @ x + problem.g), problem.lower, problem.upper)
        return QPSolution.judged(problem, x, -(problem.H @ x + problem.g), np.zeros(0), Status.SOLVED, 1, 1e-6)


class NoSolver:
    pass
'''
PROBLEM = QuadraticProgram(np.array([[3.0, 1.0], [1.0, 2.0]]), np.array([-6.0, 1.0]), -np.ones(2), np.ones(2))


@pytest.fixture
def elsewhere(tmp_path, monkeypatch):
    (tmp_path / "somebody").mkdir()
    (tmp_path / "somebody" / "solvers.py").write_text(FOREIGN)
    monkeypatch.syspath_prepend(tmp_path)
    yield "somebody.solvers"
    for name in [name for name in sys.modules if name.startswith("somebody")]:
        del sys.modules[name]


def test_every_solver_of_the_package_is_a_file_of_its_folder_and_gives_the_same_solution():
    assert solver_names() == ["daqp", "proxqp"]
    for name in [*solver_names(), "qpsolvers:quadprog"]:
        solution = solver_named(name, 2, 0).solve(PROBLEM)
        np.testing.assert_allclose(solution.x, [1.0, -1.0], atol=1e-6)
        assert solution.status.success


def test_a_solver_of_another_package_steers_by_its_path(elsewhere, trial):
    solution = solver_named(f"{elsewhere}:ProjectedGradient", 2, 0, iterations=100).solve(PROBLEM)
    np.testing.assert_allclose(solution.x, [1.0, -1.0], atol=1e-6)
    task, first = figure_eight(laps=1.0), 1e-3 * np.ones(6)
    ours, theirs = (ModelPredictiveController(trial.oscillators(), task, trial.BOUNDS, qp=qp, input_weight=3.6e4,
                                               step_budget=None)  # in Python it is slow
                    for qp in ("proxqp", f"{elsewhere}:ProjectedGradient"))
    assert type(theirs.solver).__name__ == "ProjectedGradient"
    np.testing.assert_allclose(theirs(0.5, first).input, ours(0.5, first).input, atol=1e-5)


@pytest.mark.parametrize(("name", "said"), [
    ("osqp", "expected daqp, proxqp, qpsolvers:NAME, such as qpsolvers:osqp, or your own package.module:Class"),
    ("qpsolvers:", "expected daqp, proxqp"), ("nowhere.at_all:Solver", "module nowhere does not exist; expected daqp"),
    ("qpsolvers:nonesuch", "solver 'nonesuch' is not installed; expected one of"),
    ("somebody.solvers:NoSolver", "somebody.solvers has no solver NoSolver, .* it has: ProjectedGradient"),
    ("somebody.solvers:Missing", "no solver Missing"),
])
def test_an_unknown_solver_is_refused_with_the_valid_names(elsewhere, name, said):
    with pytest.raises(ValueError, match=said):
        solver_named(name, 2, 0)


@pytest.mark.parametrize("name", ["daqp", "qpsolvers:osqp"])
def test_a_solver_whose_package_is_missing_says_what_to_install(name, monkeypatch):
    monkeypatch.setattr("ssmr_torch.extras.find_spec", lambda package: None)
    with pytest.raises(ModuleNotFoundError, match=r"is not installed: pip install 'ssmr_torch\[(daqp|qpsolvers)\]'"):
        solver_named(name, 2, 0)
