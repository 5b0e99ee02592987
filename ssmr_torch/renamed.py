"""Names of earlier versions: what saved files call by them is found, what a user types is refused with the new name."""

from __future__ import annotations

# Modules that files of version 0.10 and older name under `_target_`.
MODULES = {
    "ssmr_torch.control.estimation": "ssmr_torch.control.chart_estimator",
    "ssmr_torch.control.formulation": "ssmr_torch.control.problem_from_settings",
    "ssmr_torch.control.gate": "ssmr_torch.control.outlier_gate",
    "ssmr_torch.control.lqr": "ssmr_torch.control.static_pregain",
    "ssmr_torch.control.clock": "ssmr_torch.control.sampling",
    "ssmr_torch.control.measurement": "ssmr_torch.control.sampling",
    "ssmr_torch.control.observers": "ssmr_torch.control.kalman_observers",
    "ssmr_torch.control.problem": "ssmr_torch.control.tracking_problem",
    "ssmr_torch.control.qp": "ssmr_torch.control.quadratic_program",
    "ssmr_torch.control.settings": "ssmr_torch.control.mpc_settings",
}
# Names that have moved alone: what asks for the old one is told the new one, what a saved file names is found.
NAMES = {
    "ssmr_torch.tasks.pacman": "ssmr_torch.paper.tasks.pacman",
    "ssmr_torch.tasks.symbols.pacman": "ssmr_torch.paper.tasks.pacman",
}


def current(target: str) -> str:
    """The dotted path of a class or function as it is now, from one that an earlier version wrote."""
    module, _, name = target.rpartition(".")
    if target in NAMES:
        return NAMES[target]
    return f"{MODULES.get(module, module)}.{name}"
