"""The PARDISO solver through MKL's C interface, analysed once, on one thread. No other file uses MKL."""

from __future__ import annotations

import ctypes
import sys
from ctypes.util import find_library
from pathlib import Path

import numpy as np

from ssmr_torch.plants.finite_element.sparsity import Sparsity

SYMMETRIC_INDEFINITE = -2
ANALYSE, FACTORIZE_AND_SOLVE, RELEASE = 11, 23, -1


class Pardiso:
    """Solves A x = b by L D Lᵀ of the upper triangle. Raises ValueError without MKL, or when MKL reports an error."""

    def __init__(self, sparsity: Sparsity):
        self.sparsity = sparsity
        self._start()

    def _start(self) -> None:
        self._library = _library()
        sparsity, n = self.sparsity, self.sparsity.size
        column = np.repeat(np.arange(n), np.diff(sparsity.indptr))
        self._kept = np.flatnonzero(sparsity.indices >= column)  # lower triangle by columns = upper by rows
        self._rows = np.concatenate([[0], np.cumsum(np.bincount(column[self._kept], minlength=n))]).astype(np.int32)
        self._columns = sparsity.indices[self._kept].astype(np.int32)
        self._handle, self._options = np.zeros(64, dtype=np.int64), np.zeros(64, dtype=np.int32)
        # Options: own settings, serial minimum degree, no iterative refinement, pivots perturbed by 1e-13, 0-based.
        self._options[[0, 1, 7, 9, 34]] = 1, 2, 0, 13, 1
        self._x = np.empty(n)
        data = np.zeros(len(sparsity.indices))
        data[sparsity.diagonal] = 1.0
        self._call(ANALYSE, data[self._kept], self._x)

    def solve(self, data: np.ndarray, right: np.ndarray) -> np.ndarray:
        """x (n,) with A x = right. Raises ValueError when the factorization fails."""
        self._call(FACTORIZE_AND_SOLVE, np.ascontiguousarray(data[self._kept]), np.ascontiguousarray(right))
        return self._x.copy()

    def _call(self, phase: int, data: np.ndarray, right: np.ndarray) -> None:
        integer, error = (lambda value: ctypes.byref(ctypes.c_int32(value))), ctypes.c_int32(0)
        unused = np.zeros(1, dtype=np.int32)
        before = self._library.MKL_Set_Num_Threads_Local(1)
        self._library.pardiso(_pointer(self._handle), integer(1), integer(1), integer(SYMMETRIC_INDEFINITE),
                              integer(phase), integer(self.sparsity.size), _pointer(data), _pointer(self._rows),
                              _pointer(self._columns), _pointer(unused), integer(1), _pointer(self._options),
                              integer(0), _pointer(right), _pointer(self._x), ctypes.byref(error))
        self._library.MKL_Set_Num_Threads_Local(before)
        if error.value:
            raise ValueError(f"PARDISO failed in phase {phase} with error {error.value}; see the list in MKL's manual")

    def __getstate__(self) -> dict:
        return {"sparsity": self.sparsity}

    def __setstate__(self, state: dict) -> None:
        self.sparsity = state["sparsity"]
        self._start()

    def __del__(self):
        if getattr(self, "_handle", None) is not None and self._handle.any():
            self._call(RELEASE, self._x, self._x)


def _pointer(array: np.ndarray):
    return array.ctypes.data_as(ctypes.c_void_p)


def _library() -> ctypes.CDLL:
    folders = [Path(sys.prefix, "lib"), Path(sys.prefix, "Library", "bin")]
    files = [str(file) for folder in folders for pattern in ("libmkl_rt.so*", "mkl_rt*.dll", "libmkl_rt*.dylib")
             for file in sorted(folder.glob(pattern))]
    for name in [*files, find_library("mkl_rt")]:
        if name:
            return ctypes.CDLL(name)
    raise ValueError("linear_solver=pardiso needs Intel's MKL, which is not installed; "
                     "pip install 'ssmr_torch[pardiso]' or choose linear_solver=block_ldl")
