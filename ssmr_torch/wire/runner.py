"""Serve a controller over the wire without Torch, Hydra or SciPy.

    python -m ssmr_torch.wire.runner ARTIFACT --settings FILE

Without settings it runs the controller that ssmr design stored in the artifact, with the task of the design. The
settings are JSON: `controller` and `task`, each with its class or function under `_target_`, and with its arguments.
Without `controller` they use that of the artifact. ssmr serve-controller writes such a file, settings.json. The runner
needs numpy, numba, safetensors, proxsuite and pyzmq.
"""

from __future__ import annotations

import argparse
import json
import logging
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np

from ssmr_torch.defaults_of_signatures import keyword_defaults
from ssmr_torch.deployment import artifact
from ssmr_torch.extras import remedy
from ssmr_torch.lazy import found
from ssmr_torch.quiet_libraries import print_anything
from ssmr_torch.settings import non_negative
from ssmr_torch.targets import build

log = logging.getLogger(__name__)

REST_TOLERANCE = 1e-3  # m
REMEMBERED = 2  # controllers: that of the training, and that of the last robot
DESIGNED = {"_target_": "ssmr_torch.control.designed.designed_controller"}
DEFAULT = {"controller": {"_target_": "ssmr_torch.control.mpc.ModelPredictiveController"},
           "task": {"_target_": "ssmr_torch.tasks.references.figure_eight", "tracked": ["tip_x", "tip_y"]}}


def made_of(loaded: artifact.Artifact, target: str):
    """The first argument of a controller with this `_target_`: the artifact if it stores one, else its model."""
    return loaded if target == DESIGNED["_target_"] else loaded.model


def controller_for(loaded: artifact.Artifact, make: Callable, rest_tolerance: float = REST_TOLERANCE) -> Callable:
    """The `build` of a `ControllerEnd`: RobotDescription → controller. The last `REMEMBERED` robots get the same
    controller again.

    make(model, input_bounds, timestep=…, output_names=…) → controller; it refuses a wrong timestep itself.
    rest_tolerance: m.   Raises ValueError, with both sides, for a robot that the model was not trained on.
    """
    known, rest_tolerance = {}, non_negative("rest_tolerance", rest_tolerance, "m")

    def controller(robot):
        artifact.check_source(loaded, robot)
        trained = np.array(loaded.card["rest"])
        if trained.shape != robot.rest.shape or np.abs(trained - robot.rest).max() > rest_tolerance:
            raise ValueError(f"the model was trained with the rest {trained.tolist()} m, but the robot's rest is "
                             f"{robot.rest.tolist()} m; at most {1e3 * rest_tolerance:g} mm of difference is allowed. "
                             "Measure from the same origin, or raise rest_tolerance")
        key = robot.timestep, robot.input_bounds.tobytes()
        made = known.pop(key, None)
        if made is None:
            made = make(loaded.model, robot.input_bounds, timestep=robot.timestep, output_names=robot.output_names)
        elif not np.array_equal(getattr(made, "input_bounds", robot.input_bounds), robot.input_bounds):
            made.input_bounds = robot.input_bounds  # they were changed during the last run
        known[key] = made
        while len(known) > REMEMBERED:
            del known[next(iter(known))]
        return made

    return controller


def prepare(loaded: artifact.Artifact, build: Callable) -> None:
    """Build the controller for a robot like that of the training, so that the first robot does not wait for compilers.
    """
    from ssmr_torch.wire.messages import RobotDescription

    card = loaded.card
    try:
        build(RobotDescription("as trained", card["output_names"], card["input_names"], loaded.model.window_timestep,
                               card["rest"], card["input_range"], card["units"]["input"]))
    except ValueError as error:
        log.warning("no controller could be built for a robot like that of the training: %s; another robot may fit",
                    error)


def main(arguments: list[str] | None = None) -> int:
    """The command line. Returns the exit status; wrong input ends with one message."""
    print_anything()
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
    from ssmr_torch.wire.seal import read_key
    from ssmr_torch.wire.serving import serve

    if options.artifact is None:
        raise ValueError("the artifact is missing; give its directory, as ssmr export writes it")
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
    with ControllerLink(options.bind, read_key(options.key_file)) as link:
        prepare(loaded, make)
        print(f"{loaded.card['name']} waits for a robot at {link.endpoint}", flush=True)
        serve(link, end, runs=options.runs, done=lambda end: print(f"run {end.finished}: {len(end.samples)} samples, "
                                                                   f"{dict(end.counts)}", flush=True))


def _settings(path: str | None) -> dict:
    if path is None:
        return {}
    try:
        settings = json.loads(Path(path).read_text(encoding="utf-8"))
    except json.JSONDecodeError as error:
        raise ValueError(f"{path} is not JSON ({error}); --print-settings shows what is expected") from error
    if not isinstance(settings, dict) or not settings or not settings.keys() <= DEFAULT.keys():
        raise ValueError(f"{path} is not a JSON object with {' and '.join(DEFAULT)}, or one of them; --print-settings "
                         "shows an example")
    return settings


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="python -m ssmr_torch.wire.runner", description=__doc__.splitlines()[0])
    parser.add_argument("artifact", nargs="?", help="directory of the artifact")
    parser.add_argument("--settings", help="JSON file with controller and task; what is missing in it is taken from "
                        "the artifact, where ssmr design stored it")
    parser.add_argument("--print-settings", action="store_true", help="print the settings with all defaults, and exit")
    parser.add_argument("--package", action="append", default=[], metavar="NAME", help="your own package with "
                        "controllers, observers, tasks or solvers for the settings; may be repeated")
    parser.add_argument("--bind", default="tcp://*:5555", help="address to wait at (default %(default)s)")
    parser.add_argument("--runs", type=int, default=None, help="number of runs after which to exit (default: no limit)")
    parser.add_argument("--deadline", type=float, default=None,
                        help="s after its due time, when a measurement counts as missing (default: half a timestep)")
    parser.add_argument("--timeout", type=float, default=0.5, help="s of silence until a real-time robot is gone")
    parser.add_argument("--patience", type=float, default=60.0, help="s of silence until a lock-step robot is gone")
    parser.add_argument("--key-file", help="file with the key that the robot has as well; then every message is signed "
                        "(default: the environment variable SSMR_TORCH_WIRE_KEY, else no signatures)")
    parser.add_argument("--rest-tolerance", type=float, default=REST_TOLERANCE, help="m (default %(default)s)")
    return parser


if __name__ == "__main__":
    sys.exit(main())
