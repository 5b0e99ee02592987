"""Writes the observer and the actuators of a designed controller as C99, beside the model's own file."""

from __future__ import annotations

import re
from typing import NamedTuple

import numpy as np

from ssmr_torch.control.actuator import Actuator
from ssmr_torch.control.disturbance_observer import BEYOND, FAR, PATIENCE, SETTLING, STRANGE, DisturbanceObserver
from ssmr_torch.control.outlier_gate import AT_FIRST, MEMORY, MOST_IN_A_ROW, SIGMAS
from ssmr_torch.deployment.c.c_text import comment, identifier, table
from ssmr_torch.deployment.c.controller_text import ACTUATORS, HEADER, OBSERVER
from ssmr_torch.models.base import Model
from ssmr_torch.targets import build


class CController(NamedTuple):
    """A C file and its header, NAME_controller.c and NAME_controller.h, and the objects that they were written from."""

    name: str
    source: str
    header: str
    observer: DisturbanceObserver
    actuator: Actuator


def write_controller(model: Model, card: dict, designed: dict) -> CController | None:
    """C text of the observer and actuators of an artifact's controller; None where the controller has another observer.

    Raises ValueError where the model's timestep differs from the controller's sampling time.
    """
    stated = designed["controller"].get("observer") or {}
    if stated.get("_target_") != f"{DisturbanceObserver.__module__}.{DisturbanceObserver.__name__}":
        return None
    if abs(model.timestep / designed["timestep"] - 1.0) > 1e-3:
        raise ValueError(f"the model has steps of {model.timestep:g} s, but its controller samples every "
                         f"{designed['timestep']:g} s; design the controller again, or leave c out of the formats")
    observer, actuator = build(stated, model), _actuator(designed)
    name = identifier(card["name"])
    about = f"{card['name']}: observer and actuators of the designed controller"
    source = (f"/* {comment(about)}; see {name}_controller.h. Written by ssmr_torch; do not edit. */\n"
              f"#include \"{name}_controller.h\"\n\n#include <math.h>\n\n" + _constants(model, observer, actuator)
              + _tables(observer, actuator) + OBSERVER + ACTUATORS)
    header = HEADER.format(title=comment(about), timestep=repr(designed["timestep"]), n=model.state_dim,
                           p=model.output_dim, m=model.input_dim, room=max(1, actuator.delay) * model.input_dim,
                           facts=comment(designed["facts"].get("tuned", "given settings")))
    return CController(name, _named(source, name), _named(header, name), observer, actuator)


def _actuator(designed: dict) -> Actuator:
    stated, (lower, upper) = designed["controller"].get("actuator"), np.array(designed["input_bounds"])
    return build(stated) if stated else Actuator(designed["timestep"], tuple((upper - lower).tolist()))


def _named(text: str, name: str) -> str:
    """Replace `NAME_` by the model's prefix, in capitals where capitals follow."""
    text = re.sub(r"\bNAME_(?=[A-Z])", f"{name.upper()}_", text)
    return text.replace("NAME_", f"{name}_").replace("NAME.h", f"{name}.h")


def _constants(model: Model, observer: DisturbanceObserver, actuator: Actuator) -> str:
    sizes = {"N": model.state_dim, "M": model.input_dim, "P": model.output_dim, "D": model.delays,
             "SETTLING": round(SETTLING / model.timestep), "STRANGE": STRANGE, "PATIENCE": PATIENCE,
             "MOST_IN_A_ROW": MOST_IN_A_ROW, "WATCHED": len(observer._watched), "DELAY": actuator.delay,
             "ROOM": max(actuator.delay, 1),
             "RUBS": int(actuator.rubs), "LIMITED": int(actuator.rate is not None)}
    numbers = {"SIGMAS_SQUARED": SIGMAS**2, "MEMORY": MEMORY, "AT_FIRST": AT_FIRST, "LOST": observer._lost,
               "LESS": float(np.exp(-actuator.friction)), "MORE": float(np.exp(actuator.friction)),
               "SHARE": actuator.share}
    return ("enum { " + ", ".join(f"{key} = {value}" for key, value in sizes.items()) + " };\n\n"
            + "".join(f"#define {key} {value!r}\n" for key, value in numbers.items()) + "\n")


def _tables(observer: DisturbanceObserver, actuator: Actuator) -> str:
    reach = np.where(np.isfinite(observer._range), observer._range, np.finfo(np.float64).max)
    stride = np.zeros(len(actuator.input_range)) if actuator.rate is None else actuator.stride
    with np.errstate(over="ignore"):
        beyond, far = (np.minimum(factor * reach, np.finfo(np.float64).max) for factor in (BEYOND, FAR))
    return "".join([
        table("gain", observer._gain, "[K_z; K_d]"), table("precision", observer._precision, "of the innovation"),
        table("limit", observer._limit, "of the disturbance, m"), table("range", reach, "of the states"),
        table("beyond", beyond, "which a state is outside"), table("far", far, "where none is"),
        table("watched", np.array(observer._watched, dtype=np.int64), "outputs that must not be mispredicted"),
        table("half", actuator._half, "of the play"), table("stride", stride, "the largest change per sample"),
        table("factor", actuator.factor, "gains"), table("shift", actuator.shift, "offsets")])
