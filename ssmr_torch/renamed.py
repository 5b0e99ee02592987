"""Names of earlier versions: what saved files call by them is found, what a user types is refused with the new name."""

from __future__ import annotations

from collections.abc import Iterable

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


# What a user of version 0.10 and older types. It is refused with the new name, for one version.
SINCE = "0.11"
COMMANDS = {"serve": "serve-controller"}
GROUPS = {"sweep": "search", "tuning": "search", "experiment": "robot", "launcher": "executor"}  # group → group
ROBOTS = {"hardware": "emulated_bench", "trunk_hardware": "real_trunk", "diamond_hardware": "real_diamond",
          "diamond_simulated": "authors_simulated_diamond"}
KINDS = {"koopman_lqr": "static_pregain", "ssmr_guarded": "ssmr_stability_guard"}  # of models
METHODS = KINDS | {"control_augmented": "ssmr_control_augmented"}
OPTIONS = {  # group, as it was called → option → option
    "model": KINDS,
    "sweep": KINDS | {"optuna": "own"},
    "tuning": {name: f"controller/{KINDS.get(name, name)}" for name in ("scp", "scp_observer", "koopman_lqr")},
    "experiment": ROBOTS,
    "robot": ROBOTS,
    "data": {name: new for name, new in ROBOTS.items() if name != "hardware"} | {
        "trunk_simulated": "authors_simulated_trunk"},
    "rig": {"hardware": "emulated_bench"},
    "fit": {"guarded": "stability_guard"},
    "controller": {"koopman_lqr": "static_pregain"} | {
        f"{robot}_{method}": f"{ROBOTS.get(robot, robot)}/{METHODS.get(method, method)}"
        for robot in ("trunk", "diamond", "hardware")
        for method in ("control_augmented", "dmd", "edmd", "koopman_lqr", "neural_ode", "ssmr", "sssr", "tpwl")
        if robot != "hardware" or method not in ("dmd", "neural_ode")},
    "hydra/sweeper": {"study": "search"},
    "launcher": {"basic": "local"},  # of reproduce
}


def kind_now(kind: str) -> str:
    """The kind of a model as it is called now, from one that an earlier version wrote."""
    return KINDS.get(kind, kind)


def argument_now(argument: str) -> str:
    """An argument of a command in the names of this version; as it is where nothing was renamed."""
    key, sign, given = argument.partition("=")
    mark, group = key[:len(key) - len(key.lstrip("+~"))], key.lstrip("+~")
    options = OPTIONS.get(group, {})
    return f"{mark}{GROUPS.get(group, group)}{sign}{','.join(options.get(each, each) for each in given.split(','))}"


def refuse_old_names(arguments: Iterable[str]) -> None:
    """Raises ValueError, with the new name, for the first argument in names of version 0.10 and older."""
    for argument in arguments:
        if argument.lstrip("+~").partition("=")[0] == "tuned":
            raise ValueError(f"{argument}: found settings are taken only when asked for since version {SINCE}; leave "
                             f"out {argument}, and add settings=found to take them")
        if argument_now(argument) != argument:
            raise ValueError(f"{argument} is {argument_now(argument)} since version {SINCE}")
