"""A model as CasADi functions, for acados, do-mpc or your own program. Its equations are evaluated on symbols."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

import casadi
import numpy as np

from ssmr_torch.deployment.reference_batch import SIGNATURES, Signature
from ssmr_torch.models.base import Model

MATRICES = ("A", "B")  # the results that are matrices and not vectors


def casadi_functions(model: Model, names: Iterable[str] = tuple(SIGNATURES)) -> dict[str, casadi.Function]:
    """CasADi functions of a model, by name; in SI units. Only those in `names` are made.

    encode (window (n_d + 1, p), window_input (n_d, m)) → z (n,); decode (state (n,)) → y (p,); step (state, input
    (m,)) → next (n,); step_jacobians (state, input) → next, A (n, n), B (n, m).
    They are flat expressions of casadi.SX for one window or state, so that CasADi can differentiate, map and compile
    them. Raises ValueError for a model whose equations compare numbers, such as a switched one.
    """
    shapes = {"window": (model.delays + 1, model.output_dim), "window_input": (model.delays, model.input_dim),
              "state": (model.state_dim,), "input": (model.input_dim,)}
    symbols = {name: casadi.SX.sym(name, *shape) for name, shape in shapes.items()}
    arrays = {name: _array(symbols[name], shape) for name, shape in shapes.items()}
    return {name: _function(model, name, SIGNATURES[name], symbols, arrays) for name in names}


def _function(model: Model, name: str, signature: Signature, symbols: dict[str, casadi.SX],
              arrays: dict[str, np.ndarray]) -> casadi.Function:
    try:
        found = getattr(model, name)(*(arrays[key] for key in signature.inputs))
    except Exception as error:  # NumPy may raise anything where symbols are compared
        raise ValueError(f"{name} of a {type(model).__name__} has no CasADi form: its equations compare numbers, which "
                         f"symbols do not have ({error}); leave casadi out of the formats") from error
    results = [_expression(array) for array in (found if isinstance(found, tuple) else (found,))]
    return casadi.Function(name, [symbols[key] for key in signature.inputs], casadi.cse(results),
                           list(signature.inputs), list(signature.outputs))


def _array(symbols: casadi.SX, shape: tuple[int, ...]) -> np.ndarray:
    """Symbols as an array of objects. NumPy adds and multiplies such entries one by one."""
    array = np.empty(shape, dtype=object)
    for index in np.ndindex(*shape):
        array[index] = symbols[index if len(shape) > 1 else index[0]]
    return array


def _expression(array: np.ndarray) -> casadi.SX:
    """An array (n,) or (n, m) of expressions and plain numbers as one CasADi expression."""
    columns = 1 if array.ndim == 1 else array.shape[1]
    return casadi.reshape(casadi.vertcat(*array.ravel(order="F")), len(array), columns)


def save_function(function: casadi.Function, path: Path) -> None:
    """Write a file that `casadi.Function.load` reads, in Python, C++ or MATLAB."""
    function.save(str(path))


def run_function(path: Path, batch: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """The outputs of a stored function for each member of a batch, by name."""
    function, found = casadi.Function.load(str(path)), []
    inputs, outputs = function.name_in(), function.name_out()
    for members in zip(*(batch[name] for name in inputs)):
        values = function.call([casadi.DM(member) for member in members])
        found.append([value.full() if name in MATRICES else value.full()[:, 0] for name, value in zip(outputs, values)])
    return {name: np.stack(each) for name, each in zip(outputs, zip(*found))}
