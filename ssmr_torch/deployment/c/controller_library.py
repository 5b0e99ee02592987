"""Runs the compiled observer and actuators of a designed controller, and compares them with the Python ones."""

from __future__ import annotations

import ctypes
from functools import partial

import numpy as np

from ssmr_torch.control.actuator import ActuatorState
from ssmr_torch.deployment.c.compiled_library import with_large_stack
from ssmr_torch.deployment.c.controller import CController


class CompiledController:
    """The compiled functions as an object with the methods `observe` and `apply`, like the Python ones.

    library: with NAME.c and NAME_controller.c in it.
    """

    def __init__(self, library: ctypes.CDLL, written: CController):
        self.model, m = written.observer.model, len(written.actuator.input_range)
        n, p = self.model.state_dim, self.model.output_dim

        class Observer(ctypes.Structure):
            _fields_ = [("z", ctypes.c_double * n), ("d", ctypes.c_double * p), ("scale", ctypes.c_double),
                        *((name, ctypes.c_int) for name in ("shut", "strange", "begun", "unloaded", "gap"))]

        class Actuators(ctypes.Structure):
            _fields_ = [(name, ctypes.c_double * m) for name in ("transmitted", "limited", "lagged")] + [
                ("queue", ctypes.c_double * (m * max(1, written.actuator.delay))), ("oldest", ctypes.c_int)]

        self.observer, self.actuators, self.acting = Observer(), Actuators(), np.zeros(m)
        self._call = lambda name: partial(with_large_stack, getattr(library, f"{written.name}_{name}"))
        self._call("observe_reset")(ctypes.byref(self.observer))

    def observe(self, y: np.ndarray, acting: np.ndarray) -> tuple[np.ndarray, np.ndarray, int]:
        """State z (n,), disturbance d (p,), and the return code."""
        said = self._call("observe")(ctypes.byref(self.observer), *map(_pointer, (y, acting)))
        return np.array(self.observer.z), np.array(self.observer.d), said

    def forget(self) -> None:
        """Tell the observer that there was a gap in time."""
        self._call("observe_forget")(ctypes.byref(self.observer))

    def restart(self, z: np.ndarray) -> None:
        """Set the state (n,), which comes from a chart."""
        self._call("observe_restart")(ctypes.byref(self.observer), _pointer(z))

    def rest_at(self, command: np.ndarray) -> None:
        """Set the actuators to the state that they reach under a constant command (m,)."""
        self._call("actuator_rest")(ctypes.byref(self.actuators), _pointer(command), _pointer(self.acting))

    def apply(self, command: np.ndarray) -> None:
        """Give the command (m,) of this sample. `acting` is then the input that acts until the next sample."""
        self._call("actuator")(ctypes.byref(self.actuators), _pointer(command), _pointer(self.acting))


def _pointer(array: np.ndarray):
    return np.ascontiguousarray(array, dtype=np.float64).ctypes.data_as(ctypes.c_void_p)


def differences(compiled: CompiledController, written: CController, steps: int = 200) -> tuple[float, float]:
    """The largest differences from the Python observer and actuators, relative to the largest entry. Both get the same
    seeded commands, and measurements of the model with noise, a missing sample and an outlier.
    """
    rng, model, own = np.random.default_rng(0), written.observer.model, ActuatorState(written.actuator)
    span, noise = np.array(written.actuator.input_range), np.sqrt(np.diag(np.linalg.inv(written.observer._precision)))
    observer = written.observer
    command = np.zeros(len(span))
    own.rest_at(command), compiled.rest_at(command), observer.reset()
    z, _ = observer.rest(own.acting)
    states, acting = [], []
    for k in range(steps):
        y = model.decode(z) + noise * rng.standard_normal(model.output_dim)
        y = y + 1e3 * noise if k == steps // 2 else np.full(model.output_dim, np.nan) if k == steps // 3 else y
        observer.measure(y, own.acting)
        found, d, _ = compiled.observe(y, compiled.acting)
        states.append([*(np.concatenate(pair) for pair in ((found, d), observer.state()[::2]))])
        command = np.clip(command + 0.02 * span * rng.standard_normal(len(span)), -0.2 * span, 0.2 * span)
        own.apply(command), compiled.apply(command)
        acting.append([compiled.acting.copy(), own.acting])
        z = model.step(z, own.acting)
    return tuple(float(np.abs(ours - theirs).max() / max(np.abs(theirs).max(), 1e-300))
                 for ours, theirs in (np.array(each).swapaxes(0, 1) for each in (states, acting)))
