"""Trained models that others published, read into our own form."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import scipy.io
from scipy.io.matlab import MatReadError

from ssmr_torch.models.monomials import Monomials, count_monomials
from ssmr_torch.models.polynomial_tables import PolynomialTables


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
    if not path.is_file():
        raise FileNotFoundError(f"no model file at {path}")
    try:
        stored = scipy.io.loadmat(path, simplify_cells=True)["py_data"]
        model, params = stored["model"], stored["params"]
        w, v, r, B = (np.asarray(model[key], dtype=np.float64) for key in ("w_coeff", "v_coeff", "r_coeff", "B"))
        v, r = np.atleast_2d(v), np.atleast_2d(r)
        # MATLAB arrays of one column arrive as vectors
        w, B = (table[:, None] if table.ndim == 1 else table for table in (w, B))
        delays, outputs = int(params["delays"]), int(params["output_dim"])
        timestep = float(model["Ts"])
    except (KeyError, ValueError, TypeError, IndexError, OSError, NotImplementedError, MatReadError) as error:
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
