"""Compiling C files to a shared library, and calling its functions on NumPy arrays."""

from __future__ import annotations

import ctypes
import os
import shutil
import subprocess
import threading
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np

from ssmr_torch.models.base import Model

FLAGS = ("-std=c99", "-O2", "-Wall", "-Wextra", "-Wpedantic")
# The scratch memory of a model lies on the stack. A model of some 200 states needs 35 MB, more than a process has by
# itself. Memory that is not used is not taken.
STACK = 256 * 2**20  # bytes


def compiler() -> str | None:
    """Path of the C compiler: the environment variable CC, else cc, gcc or clang; None where there is none."""
    names = (os.environ.get("CC") or "cc", "cc", "gcc", "clang")
    return next((path for path in map(shutil.which, names) if path), None)


def compile_library(source: Path, library: Path, flags: tuple[str, ...] = FLAGS, *others: Path) -> str:
    """Compile NAME.c, and other files with it, to a shared library. Returns the compiler's messages. Raises ValueError
    where compiling fails.
    """
    sources = map(str, (source, *others))
    done = subprocess.run([compiler(), *flags, "-shared", "-fPIC", "-o", str(library), *sources, "-lm"],
                          capture_output=True, encoding="utf-8", errors="replace")
    if done.returncode:
        raise ValueError(f"{compiler()} cannot compile {source.name}:\n{done.stderr[:2000]}")
    return done.stderr


def with_large_stack(function: Callable, *arguments):
    """function(*arguments), a C function, called in a thread that has `STACK` bytes of stack. Raises what it raises."""
    before = threading.stack_size(STACK)
    try:
        with ThreadPoolExecutor(1) as thread:
            return thread.submit(function, *arguments).result()
    finally:
        threading.stack_size(before)


class CLibrary:
    """The functions of a compiled model, with the shapes of `Model`. Batched functions loop over the batch.

    name: the prefix of the functions.   model: the model from which the C file was written; it gives the sizes.
    """

    def __init__(self, library: Path, name: str, model: Model):
        self._functions, self._name, self.model = ctypes.CDLL(str(library.resolve())), name, model

    def raw(self, function: str):
        """NAME_function as a `ctypes` function: it takes pointers to doubles; `horizon` takes an int before them."""
        found = getattr(self._functions, f"{self._name}_{function}")
        found.restype = None
        return found

    def call(self, function: str, arguments, shapes, before: tuple = ()) -> list[np.ndarray]:
        """Call NAME_function(*before, *arguments, *outputs) and return the outputs, which have these shapes."""
        inputs = [np.ascontiguousarray(array, dtype=np.float64) for array in arguments]
        outputs = [np.full(shape, np.nan) for shape in shapes]
        pointers = [array.ctypes.data_as(ctypes.c_void_p) for array in (*inputs, *outputs)]
        with_large_stack(self.raw(function), *(ctypes.c_int(value) for value in before), *pointers)
        return outputs

    def encode(self, window: np.ndarray, inputs: np.ndarray) -> np.ndarray:
        """(batch, n_d + 1, p), (batch, n_d, m) → (batch, n)."""
        return np.stack([self.call("encode", pair, [(self.model.state_dim,)])[0] for pair in zip(window, inputs)])

    def decode(self, z: np.ndarray) -> np.ndarray:
        """(batch, n) → (batch, p)."""
        return np.stack([self.call("decode", [each], [(self.model.output_dim,)])[0] for each in z])

    def decode_jacobian(self, z: np.ndarray) -> list[np.ndarray]:
        """(batch, n) → y (batch, p), C (batch, p, n)."""
        p, n = self.model.output_dim, self.model.state_dim
        return _stacked(self.call("decode_jacobian", [each], [(p,), (p, n)]) for each in z)

    def step(self, z: np.ndarray, u: np.ndarray) -> np.ndarray:
        """(batch, n), (batch, m) → (batch, n)."""
        return np.stack([self.call("step", pair, [(self.model.state_dim,)])[0] for pair in zip(z, u)])

    def step_jacobians(self, z: np.ndarray, u: np.ndarray) -> list[np.ndarray]:
        """(batch, n), (batch, m) → next (batch, n), A (batch, n, n), B (batch, n, m)."""
        n, m = self.model.state_dim, self.model.input_dim
        return _stacked(self.call("step_jacobians", pair, [(n,), (n, n), (n, m)]) for pair in zip(z, u))

    def horizon(self, z: np.ndarray, inputs: np.ndarray) -> list[np.ndarray]:
        """(n,), (H, m) → states (H + 1, n), A (H, n, n), B (H, n, m), outputs (H + 1, p), C (H + 1, p, n)."""
        n, m, p, steps = self.model.state_dim, self.model.input_dim, self.model.output_dim, len(inputs)
        shapes = [(steps + 1, n), (steps, n, n), (steps, n, m), (steps + 1, p), (steps + 1, p, n)]
        return self.call("horizon", [z, inputs], shapes, before=(steps,))


def _stacked(results) -> list[np.ndarray]:
    return [np.stack(arrays) for arrays in zip(*results)]
