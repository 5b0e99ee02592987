"""Trained models that others published, read into our own form."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import scipy.io
from scipy.io.matlab import MatReadError

from ssmr_torch.models.koopman_tables import KoopmanTables
from ssmr_torch.models.monomials import Monomials, count_monomials
from ssmr_torch.models.polynomial_tables import PolynomialTables
from ssmr_torch.models.tables import ModelTables

UNREADABLE = (KeyError, ValueError, TypeError, IndexError, OSError, NotImplementedError, MatReadError)


def read_published_model(path: str | Path, *, output_names: Sequence[str], input_names: Sequence[str] | None = None,
                         rest: Sequence[float] | None = None, length_unit: float = 1e-3, input_unit: float = 1.0,
                         state_scale: float = 0.05) -> tuple[ModelTables, dict]:
    """A published SSMR or Koopman model, whichever the file holds, and the card of an artifact.

    output_names, input_names: of the robot; None names the inputs u1, u2, … rest: absolute position at rest, m, which a
    Koopman model needs; an SSMR is about rest, and None then says 0. The inputs of an SSMR run from 0 to 1, those of a
    Koopman model over the range that its file tells. Units and state_scale: as in `read_ssmr_model`.
    Raises as `read_ssmr_model` and `read_koopman_model` do.
    """
    if "A" not in _stored(path).get("model", {}):
        tables = read_ssmr_model(path, length_unit=length_unit, input_unit=input_unit, state_scale=state_scale)
        kind, rest = "SSMR", [0.0] * tables.output_dim if rest is None else rest
        bounds = np.array([np.zeros(tables.input_dim), np.full(tables.input_dim, input_unit)])
    elif rest is None:
        raise ValueError(f"{path} is a Koopman model of absolute positions; give rest, m, e.g. "
                         "rest=[3.5888e-3,0.2934e-3,195.6144e-3] for the simulated trunk")
    else:
        tables = read_koopman_model(path, rest=rest, length_unit=length_unit, input_unit=input_unit)
        kind, scale = "DMD", _stored(path)["params"]["scale"]
        bounds = input_unit * (np.reshape(scale["u_offset"], -1) + [[-1.0], [1.0]] * np.reshape(scale["u_factor"], -1))
    names = [f"u{j + 1}" for j in range(tables.input_dim)] if input_names is None else list(input_names)
    return tables, {"name": f"{kind} (published)", "output_names": list(output_names), "input_names": names,
                    "input_unit": "1" if input_unit == 1 else "N", "rest": list(rest), "input_range": bounds.tolist()}


def read_ssmr_model(path: str | Path, *, length_unit: float = 1e-3, input_unit: float = 1.0,
                    state_scale: float = 0.05, substeps: int = 1) -> PolynomialTables:
    """The SSMR model that the paper's authors store as MATLAB struct `py_data` with fields model and params.

    Their w_coeff, v_coeff, r_coeff multiply graded monomials as ours do; a coefficient of degree d in mm is
    multiplied by length_unit^(1-d) to be in m, B by length_unit / input_unit.
    length_unit, input_unit: their units in m and N (or 1 for normalized commands). state_scale: m, the range in
    which the model may be trusted, which the file does not tell.
    Raises FileNotFoundError, or ValueError when the file is not such a model.
    """
    path = Path(path)
    try:
        stored = _stored(path)
        model, params = stored["model"], stored["params"]
        w, v, r, B = (np.asarray(model[key], dtype=np.float64) for key in ("w_coeff", "v_coeff", "r_coeff", "B"))
        v, r = np.atleast_2d(v), np.atleast_2d(r)
        # MATLAB arrays of one column arrive as vectors
        w, B = (table[:, None] if table.ndim == 1 else table for table in (w, B))
        delays, outputs = int(params["delays"]), int(params["output_dim"])
        timestep = float(model["Ts"])
    except FileNotFoundError:
        raise
    except UNREADABLE as error:
        raise ValueError(f"{path} is not an SSMR model: expected the struct py_data with model (w_coeff, v_coeff, "
                         f"r_coeff, B, Ts) and params (delays, output_dim); failed at {error}") from error
    n, window = len(r), len(w)
    if window != (delays + 1) * outputs or v.shape[0] != n or B.shape[0] != n:
        raise ValueError(f"{path}: w has {window} rows, v {v.shape[0]}, r {n}, B {B.shape[0]}, for {delays} delays of "
                         f"{outputs} outputs; expected {(delays + 1) * outputs}, n, n, n")
    degrees = {name: _degree(path, name, table.shape[1], variables)
               for name, table, variables in (("w", w, n), ("v", v, window), ("r", r, n))}
    to_metres = {name: length_unit ** (1.0 - Monomials(variables, 1, degrees[name]).exponents.sum(1))
                 for name, variables in (("w", n), ("v", window), ("r", n))}
    return PolynomialTables(
        chart=v * to_metres["v"], parametrization=w * to_metres["w"], drift=r * to_metres["r"],
        control=B * length_unit / input_unit, state_scale=np.full(n, state_scale),
        chart_degree=degrees["v"], parametrization_degree=degrees["w"], dynamics_degree=degrees["r"],
        control_degree=0, input_dim=B.shape[1], output_dim=outputs, delays=delays, timestep=timestep,
        window_timestep=timestep, substeps=substeps)


def _degree(path: Path, name: str, columns: int, variables: int) -> int:
    for degree in range(1, 10):
        if count_monomials(variables, 1, degree) == columns:
            return degree
    raise ValueError(f"{path}: {name} has {columns} columns, which no full polynomial of {variables} variables has")
