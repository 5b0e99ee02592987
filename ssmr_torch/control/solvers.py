"""Solvers of quadratic programs by their names."""

from __future__ import annotations


def solver_named(name: str, dim: int, rows: int, **options):
    """The solver of this name for programs of dim variables and `rows` general rows: proxqp, daqp, or qpsolvers:NAME.

    options: of its constructor. Raises ValueError for another name, ImportError where it is not installed.
    """
    if name == "proxqp":
        from ssmr_torch.control.proxqp import ProxQP

        return ProxQP(dim, rows, **options)
    if name == "daqp":
        from ssmr_torch.control.daqp import DAQP

        return DAQP(dim, rows, **options)
    if name.startswith("qpsolvers:"):
        from ssmr_torch.control.any_qp import QPSolvers

        return QPSolvers(name.removeprefix("qpsolvers:"), **options)
    raise ValueError(f"qp is {name!r}; expected proxqp, daqp or qpsolvers:NAME, such as qpsolvers:osqp")
