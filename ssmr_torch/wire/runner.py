"""Serve a controller over the wire without Torch, Hydra or SciPy.

    python -m ssmr_torch.wire.runner ARTIFACT --settings FILE

Without settings it is the controller that ssmr design put into the artifact, with the task of the design. The settings
are JSON: `controller` and `task`, each with the class or function under `_target_` and its arguments.
ssmr serve-controller writes them to settings.json. Without a `controller` it is the artifact's. Needs numpy, numba,
safetensors, proxsuite and pyzmq.
"""

from __future__ import annotations

import argparse
import json
import logging
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np

from ssmr_torch.defaults import keyword_defaults
from ssmr_torch.deployment import artifact
from ssmr_torch.extras import remedy
from ssmr_torch.lazy import found
from ssmr_torch.settings import non_negative
from ssmr_torch.targets import build

log = logging.getLogger(__name__)

REST_TOLERANCE = 1e-3  # m
DESIGNED = {"_target_": "ssmr_torch.control.designed.designed_controller"}
DEFAULT = {"controller": {"_target_": "ssmr_torch.control.mpc.ModelPredictiveController"},
           "task": {"_target_": "ssmr_torch.tasks.references.figure_eight", "tracked": ["tip_x", "tip_y"]}}


def made_of(loaded: artifact.Artifact, target: str):
    """What a controller of this `_target_` is made of: the whole artifact where it carries it, else the model."""
    return loaded if target == DESIGNED["_target_"] else loaded.model


def controller_for(loaded: artifact.Artifact, make: Callable, rest_tolerance: float = REST_TOLERANCE) -> Callable:
    """What a `ControllerEnd` builds controllers with: RobotDescription → controller, the same one for the same robot.

    make(model, input_bounds, timestep=…, output_names=…) → controller, which itself refuses a timestep that does not
    fit.   rest_tolerance: m.   Raises ValueError for a robot that the model was not trained on, saying both sides.
    """
    known, rest_tolerance = {}, non_negative("rest_tolerance", rest_tolerance, "m")

    def controller(robot):
        artifact.check_source(loaded, robot)
        trained = np.array(loaded.card["rest"])
        if trained.shape != robot.rest.shape or np.abs(trained - robot.rest).max() > rest_tolerance:
            raise ValueError(f"the model was trained with the rest {trained.tolist()} m, the robot's is "
                             f"{robot.rest.tolist()} m, and {1e3 * rest_tolerance:g} mm are allowed; "
                             "measure from the same origin, or raise rest_tolerance")
        key = robot.timestep, robot.input_bounds.tobytes()
        if key not in known:
            known[key] = make(loaded.model, robot.input_bounds, timestep=robot.timestep,
                              output_names=robot.output_names)
        return known[key]

    return controller


def prepare(loaded: artifact.Artifact, build: Callable) -> None:
    """Build the controller for a robot like that of the training, so that the first one need not wait for compilers."""
    from ssmr_torch.wire.messages import RobotDescription

    card = loaded.card
    try:
        build(RobotDescription("as trained", card["output_names"], card["input_names"], loaded.model.window_timestep,
                               card["rest"], card["input_range"], card["units"]["input"]))
    except ValueError as error:
        log.warning("no controller for a robot like that of the training: %s; perhaps the one that comes fits", error)


def main(arguments: list[str] | None = None) -> int:
    """The command line; returns the exit status. Bad input ends in one message."""
    options = _parser().parse_args(arguments)
    logging.basicConfig(level=logging.INFO, format="%(message)s")
    if options.print_settings:
        print(json.dumps({part: chosen | keyword_defaults(chosen["_target_"]) | chosen
                          for part, chosen in DEFAULT.items()}, indent=2))
        return 0
    try:
        _serve(options)
    except (ValueError, OSError, ImportError) as error:
        if isinstance(error, ImportError) and remedy(error) is None:
            raise
        print(f"runner: {remedy(error) or error}", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        return 130
    return 0


def _serve(options) -> None:
    from ssmr_torch.wire.controller_end import ControllerEnd
    from ssmr_torch.wire.link import ControllerLink
    from ssmr_torch.wire.serving import serve

    if options.artifact is None:
        raise ValueError("give the directory of an artifact, such as ssmr export writes")
    loaded, settings = artifact.load(options.artifact), _settings(options.settings)
    chosen = settings.get("controller") or DESIGNED
    if settings.get("task"):
        task = build(settings["task"], packages=options.package)
    else:
        task = found("ssmr_torch.control.designed:own_task")(loaded)
    source = made_of(loaded, chosen.get("_target_"))
    make = controller_for(loaded, lambda model, bounds, **more: build(
        chosen, source, task, bounds, packages=options.package, **more), options.rest_tolerance)
    end = ControllerEnd(make, duration=task.duration, deadline=options.deadline, timeout=options.timeout,
                        patience=options.patience)
    with ControllerLink(options.bind) as link:
        prepare(loaded, make)
        print(f"{loaded.card['name']} waits for a robot at {link.endpoint}", flush=True)
        serve(link, end, runs=options.runs, done=lambda end: print(f"run {end.finished}: {len(end.samples)} samples, "
                                                                   f"{dict(end.counts)}", flush=True))


def _settings(path: str | None) -> dict:
    if path is None:
        return {}
    try:
        settings = json.loads(Path(path).read_text())
    except json.JSONDecodeError as error:
        raise ValueError(f"{path} is not JSON ({error}); --print-settings shows what is expected") from error
    if not isinstance(settings, dict) or not settings or not settings.keys() <= DEFAULT.keys():
        raise ValueError(f"{path} must be a JSON object with {' and '.join(DEFAULT)}, or one of them; --print-settings "
                         "shows one")
    return settings


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="python -m ssmr_torch.wire.runner", description=__doc__.splitlines()[0])
    parser.add_argument("artifact", nargs="?", help="directory of the artifact")
    parser.add_argument("--settings", help="JSON file with controller and task; what it does not name is the "
                        "artifact's, of ssmr design")
    parser.add_argument("--print-settings", action="store_true", help="print settings with all defaults and end")
    parser.add_argument("--package", action="append", default=[], metavar="NAME", help="package of your own whose "
                        "controllers, observers, tasks and solvers the settings may name; may be repeated")
    parser.add_argument("--bind", default="tcp://*:5555", help="address to wait at (default %(default)s)")
    parser.add_argument("--runs", type=int, default=None, help="end after so many runs (default: never)")
    parser.add_argument("--deadline", type=float, default=None,
                        help="s after a measurement was due when it is missing (default: half a timestep)")
    parser.add_argument("--timeout", type=float, default=0.5, help="s of silence of a real-time robot that is gone")
    parser.add_argument("--patience", type=float, default=60.0, help="s of silence of a lock-step robot that is gone")
    parser.add_argument("--rest-tolerance", type=float, default=REST_TOLERANCE, help="m (default %(default)s)")
    return parser


if __name__ == "__main__":
    sys.exit(main())
