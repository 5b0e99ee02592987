"""Solvers of quadratic programs by name: each file in this folder has one `Workspace`."""

from __future__ import annotations

from importlib import import_module
from pkgutil import iter_modules

from ssmr_torch.control.quadratic_program import Workspace
from ssmr_torch.extras import BROUGHT_BY, require

OTHERS = "qpsolvers:NAME, such as qpsolvers:osqp, or your own package.module:Class"


def solver_names() -> list[str]:
    """Names of the solvers in this folder."""
    return sorted(module.name for module in iter_modules(__path__))


def solver_named(name: str, dim: int, rows: int, **options):
    """The solver with this name, for programs of dim variables and `rows` general rows.

    name: a file in this folder, qpsolvers:NAME, or package.module:Class. Such a class has `solve(QuadraticProgram)` →
    `QPSolution` and `reset()`, and may have `advance` as in `ProxQP` and a `deadline` as in `Workspace`; it is called
    with (dim, rows, **options).
    options: of its constructor. Raises ValueError for another name, ImportError where it is not installed.
    """
    module, separator, chosen = name.partition(":")
    if module in BROUGHT_BY:
        require(module)
    if not separator and name in solver_names():
        found = vars(import_module(f"{__name__}.{name}")).values()
        solver = next(each for each in found if isinstance(each, type) and issubclass(each, Workspace)
                      and each is not Workspace)
        return solver(dim, rows, **options)
    if module == "qpsolvers" and chosen:
        from ssmr_torch.control.qpsolvers_adapter import QPSolvers

        return QPSolvers(chosen, **options)
    if module and chosen:
        return _foreign(module, chosen)(dim, rows, **options)
    raise ValueError(f"qp is {name!r}; expected {', '.join(solver_names())}, {OTHERS}")


def _foreign(module: str, name: str):
    """A solver class of another package. Raises ValueError with the names that exist there."""
    try:
        place = import_module(module)
    except ModuleNotFoundError as error:
        raise ValueError(f"qp is '{module}:{name}', but the module {error.name} does not exist; expected "
                         f"{', '.join(solver_names())}, {OTHERS}") from error
    if not callable(getattr(getattr(place, name, None), "solve", None)):
        there = [each for each, value in vars(place).items() if callable(getattr(value, "solve", None))]
        raise ValueError(f"{module} has no solver {name}, a class with solve(QuadraticProgram) and reset(); it has: "
                         f"{', '.join(there) or 'none'}")
    return getattr(place, name)
