"""Trained models that others published, read into our own form."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import scipy.io
from scipy.io.matlab import MatReadError

from ssmr_torch.models.monomials import count_monomials, graded
from ssmr_torch.models.named_structures import koopman, spectral_submanifold
from ssmr_torch.models.polynomial import PolynomialModel


def read_published_model(path: str | Path, *, output_names: Sequence[str], input_names: Sequence[str] | None = None,
                         rest: Sequence[float] | None = None, length_unit: float = 1e-3, input_unit: float = 1.0,
                         state_scale: float = 0.05) -> tuple[PolynomialModel, dict]:
    """An SSMR or a Koopman model, whichever the file holds, and what an artifact's card says of it.

    output_names, input_names: of the robot; None names the inputs u1, u2, … rest: absolute position at rest, m, which a
    Koopman model needs; an SSMR is about rest, and its card says 0 where None is given. input_range on the card: 0 to 1
    for an SSMR, whose inputs are normalized, and what the file tells of a Koopman model. Units, state_scale: as in
    `read_ssmr_model`. Raises what the two readers raise, and ValueError where a Koopman model lacks its rest.
    """
    with _expecting(path, "a published model: expected the struct py_data with model and params"):
        koopman = "A" in _stored(path)["model"]
    if koopman and rest is None:
        raise ValueError(f"{path} is a Koopman model, of absolute positions; give the rest of the robot in m, "
                         "rest=[3.5888e-3,0.2934e-3,195.6144e-3] for the simulated trunk")
    if koopman:
        tables = read_koopman_model(path, rest=rest, length_unit=length_unit, input_unit=input_unit)
        factor, offset = (_scale(path, "u", name) for name in ("factor", "offset"))
        input_range = input_unit * np.stack([offset - factor, offset + factor])
    else:
        tables = read_ssmr_model(path, length_unit=length_unit, input_unit=input_unit, state_scale=state_scale)
        input_range = np.array([[0.0], [1.0]]) * np.ones(tables.input_dim)
    numbered = [f"u{j + 1}" for j in range(tables.input_dim)]
    return tables, {
        "name": f"{'DMD' if koopman else 'SSMR'} (published)", "output_names": list(output_names),
        "input_names": numbered if input_names is None else list(input_names),
        "input_unit": "1" if input_unit == 1 else "N", "input_range": input_range.tolist(),
        "rest": [0.0] * tables.output_dim if rest is None else list(rest)}


def read_ssmr_model(path: str | Path, *, length_unit: float = 1e-3, input_unit: float = 1.0,
                    state_scale: float = 0.05, substeps: int = 1) -> PolynomialModel:
    """The SSMR model that the paper's authors store as MATLAB struct `py_data` with fields model and params.

    Their w_coeff, v_coeff, r_coeff multiply graded monomials as ours do; a coefficient of degree d in mm is
    multiplied by length_unit^(1-d) to be in m, B by length_unit / input_unit.
    length_unit, input_unit: their units in m and N (or 1 for normalized commands). state_scale: m, the range in
    which the model may be trusted, which the file does not tell.
    Raises FileNotFoundError, or ValueError when the file is not such a model.
    """
    with _expecting(path, "an SSMR model: expected the struct py_data with model (w_coeff, v_coeff, r_coeff, B, Ts) "
                          "and params (delays, output_dim)"):
        stored = _stored(path)
        model, params = stored["model"], stored["params"]
        w, v, r, B = (np.asarray(model[key], dtype=np.float64) for key in ("w_coeff", "v_coeff", "r_coeff", "B"))
        v, r = np.atleast_2d(v), np.atleast_2d(r)
        # MATLAB arrays of one column arrive as vectors
        w, B = (table[:, None] if table.ndim == 1 else table for table in (w, B))
        delays, outputs = int(params["delays"]), int(params["output_dim"])
        timestep = float(model["Ts"])
    n, window = len(r), len(w)
    if window != (delays + 1) * outputs or v.shape[0] != n or B.shape[0] != n:
        raise ValueError(f"{path}: w has {window} rows, v {v.shape[0]}, r {n}, B {B.shape[0]}, for {delays} delays of "
                         f"{outputs} outputs; expected {(delays + 1) * outputs}, n, n, n")
    degrees = {name: _degree(path, name, table.shape[1], variables)
               for name, table, variables in (("w", w, n), ("v", v, window), ("r", r, n))}
    to_metres = {name: length_unit ** (1.0 - graded(variables, 1, degrees[name]).exponents.sum(1))
                 for name, variables in (("w", n), ("v", window), ("r", n))}
    return spectral_submanifold(
        chart=v * to_metres["v"], parametrization=w * to_metres["w"], drift=r * to_metres["r"],
        control=B * length_unit / input_unit, state_scale=np.full(n, state_scale),
        chart_degree=degrees["v"], parametrization_degree=degrees["w"], dynamics_degree=degrees["r"],
        control_degree=0, input_dim=B.shape[1], output_dim=outputs, delays=delays, timestep=timestep,
        window_timestep=timestep, substeps=substeps)


def read_koopman_model(path: str | Path, *, rest: Sequence[float], length_unit: float = 1e-3,
                       input_unit: float = 1e-3) -> PolynomialModel:
    """The linear Koopman model, with its pregain, that the paper's authors store as MATLAB struct `py_data`.

    Theirs is x⁺ = A x + B v, v = G y' at rest, in scaled absolute coordinates x = [y'_k, …, y'_{k-n_d}],
    y' = (y - offset) / factor, v = (u - offset) / factor. Of the displacement from rest it is affine, so that our z is
    [1, (y - rest) / factor, …]; it predicts the same. G is taken as it stands in the file, which does not tell its set
    points: outputs that a task does not prescribe are to stay at rest.
    rest: absolute, m (p,). length_unit, input_unit: theirs in m and N (or 1 for normalized commands).
    Raises FileNotFoundError, or ValueError when the file is not such a model, lifts by more than delays, or disagrees
    with the rest.
    """
    with _expecting(path, "a Koopman model: expected the struct py_data with model (A, B, G) and params (n, m, delays, "
                          "Ts, obs_degree, inputInFeatures, scale)"):
        model, params = (_stored(path)[name] for name in ("model", "params"))
        p, m, delays, degree, lifted = (int(params[key]) for key in ("n", "m", "delays", "obs_degree",
                                                                     "inputInFeatures"))
        timestep = float(params["Ts"])
        A, B, G = (np.asarray(model[key], dtype=np.float64) for key in ("A", "B", "G"))
        factor, offset, u_factor, u_offset = (_scale(path, *name) for name in (
            ("y", "factor"), ("y", "offset"), ("u", "factor"), ("u", "offset")))
    size, rest = (delays + 1) * p, np.asarray(rest, dtype=np.float64)
    found = tuple(table.size for table in (A, B, G, factor, offset, u_factor, u_offset, rest))
    expected = (size * size, size * m, m * p, p, p, m, m, p)
    if degree != 1 or lifted or found != expected:
        raise ValueError(f"{path}: A, B, G, factor and offset of y and of u, and rest have {found} entries; {delays} "
                         f"delays of {p} outputs and {m} inputs need {expected}, with obs_degree 1 (it is {degree}) "
                         f"and inputInFeatures 0 (it is {lifted})")
    A, B, G = A.reshape(size, size), B.reshape(size, m), G.reshape(m, p)
    shift = np.tile((rest / length_unit - offset) / factor, delays + 1)
    affine = np.eye(1 + size)
    affine[1:] = np.column_stack([A @ shift - shift - B @ (u_offset / u_factor), A])
    pregain = np.column_stack([u_offset + u_factor * (G @ shift[:p]), u_factor[:, None] * G / (length_unit * factor)])
    return koopman(
        # their data fill -1 … 1 about the offset
        state_scale=np.r_[1.0, 1.0 + np.abs(shift)], scale=np.tile(length_unit * factor, delays + 1), A=affine,
        B=np.vstack([np.zeros(m), B / (input_unit * u_factor)]), N=np.zeros((0, 1 + size, 1 + size)),
        pregain=input_unit * pregain, set_points=np.eye(1 + p), degree=1, input_delays=0, constant=True, input_dim=m,
        output_dim=p, delays=delays, timestep=timestep, window_timestep=timestep, base_timestep=timestep)


@contextmanager
def _expecting(path: str | Path, what: str) -> Iterator[None]:
    try:
        yield
    except FileNotFoundError:
        raise
    # a foreign file: loadmat raises the last four, a field that is missing, of another shape or no number the others
    except (LookupError, TypeError, ValueError, OSError, NotImplementedError, MatReadError) as error:
        raise ValueError(f"{path} is not {what}; failed at {error}") from error


def _stored(path: str | Path) -> dict:
    if not Path(path).is_file():
        raise FileNotFoundError(f"no model file at {path}")
    return scipy.io.loadmat(path, simplify_cells=True)["py_data"]


def _scale(path: str | Path, signal: str, name: str) -> np.ndarray:
    return np.array(_stored(path)["params"]["scale"][f"{signal}_{name}"], dtype=np.float64).reshape(-1)


def _degree(path: str | Path, name: str, columns: int, variables: int) -> int:
    for degree in range(1, 10):
        if count_monomials(variables, 1, degree) == columns:
            return degree
    raise ValueError(f"{path}: {name} has {columns} columns, which no full polynomial of {variables} variables has")
