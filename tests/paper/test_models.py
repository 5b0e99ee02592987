"""Published models in our units predict what their own tables say in theirs."""

import numpy as np
import pytest
import scipy.io
from sklearn.preprocessing import PolynomialFeatures

from ssmr_torch.deployment import artifact
from ssmr_torch.paper.models import read_koopman_model, read_published_model, read_ssmr_model


def their_monomials(x, degree):
    return PolynomialFeatures(degree, include_bias=False).fit_transform(x)


def write(path, model=None, params=None, name="py_data"):
    rng = np.random.default_rng(0)
    tables = {"w_coeff": rng.normal(size=(6, 9)), "v_coeff": rng.normal(size=(3, 6)),
              "r_coeff": rng.normal(size=(3, 19)), "B": rng.normal(size=(3, 2)), "Ts": 0.02}
    sizes = {"delays": 1, "output_dim": 3}
    scipy.io.savemat(path, {name: {"model": tables | (model or {}), "params": sizes | (params or {})}})
    return path


def assert_same_predictions(path, length_unit, input_unit):
    """w, v, dz/dt in SI against the stored tables applied to the stored units by scikit-learn's polynomials."""
    stored = scipy.io.loadmat(path, simplify_cells=True)["py_data"]["model"]
    w, v, r = stored["w_coeff"], np.atleast_2d(stored["v_coeff"]), stored["r_coeff"]
    n, window = len(r), len(w)
    B = stored["B"].reshape(n, -1)
    degree = {name: next(d for d in range(1, 6) if their_monomials(np.ones((1, k)), d).shape[1] == table.shape[1])
              for name, table, k in (("w", w, n), ("v", v, window), ("r", r, n))}
    model = read_ssmr_model(path, length_unit=length_unit, input_unit=input_unit)
    rng = np.random.default_rng(1)
    z, y, u = 5 * rng.normal(size=(20, n)), 5 * rng.normal(size=(20, window)), rng.uniform(size=(20, B.shape[1]))
    metres, newtons = length_unit * z, input_unit * u
    windows = (length_unit * y).reshape(20, model.delays + 1, model.output_dim)
    decoded = their_monomials(z, degree["w"]) @ w.T
    np.testing.assert_allclose(model.window_form(metres), length_unit * decoded, rtol=1e-11)
    np.testing.assert_allclose(model.decode(metres), length_unit * decoded[:, -model.output_dim:], rtol=1e-11)
    np.testing.assert_allclose(model.encode(windows, None), length_unit * their_monomials(y, degree["v"]) @ v.T,
                               rtol=1e-10)
    np.testing.assert_allclose(model.rate(metres, newtons),
                               length_unit * (their_monomials(z, degree["r"]) @ r.T + u @ B.T), rtol=1e-11)
    assert model.timestep == model.window_timestep == stored["Ts"]


def test_the_published_diamond_model_predicts_in_metres_what_it_does_in_millimetres(measurements):
    assert_same_predictions(measurements("diamond_hardware/reference_model.mat"), 1e-3, 1.0)


@pytest.mark.parametrize(("length_unit", "input_unit"), [(1e-3, 1e-3), (1.0, 1.0), (1e-2, 0.5)])
@pytest.mark.parametrize("inputs", [1, 2])
def test_tables_are_converted_for_any_units_and_any_number_of_inputs(tmp_path, length_unit, input_unit, inputs):
    path = write(tmp_path / "model.mat", {"B": np.arange(1.0, 1 + 3 * inputs).reshape(3, inputs)})
    assert_same_predictions(path, length_unit, input_unit)


def test_the_trusted_range_and_the_substeps_are_those_asked_for(tmp_path):
    model = read_ssmr_model(write(tmp_path / "model.mat"), state_scale=0.03, substeps=4)
    np.testing.assert_array_equal(model.state_scale, np.full(3, 0.03))
    assert (model.substeps, model.delays, model.output_dim, model.input_dim) == (4, 1, 3, 2)
    structure = model.structure
    assert (structure.parametrization.highest, structure.chart.highest, structure.dynamics.highest) == (2, 1, 3)
    assert [row for row in structure.dynamics.factors if max(row) >= 3] == [(3,), (4,)]  # a constant input matrix


@pytest.mark.parametrize(("model", "params", "message"), [
    ({}, {"delays": 2}, "w has 6 rows, v 3, r 3, B 3, for 2 delays of 3 outputs; expected 9, n, n, n"),
    ({"B": np.ones((2, 3))}, {}, "B 2"), ({"v_coeff": np.ones((4, 6))}, {}, "v 4, r 3"),
    ({"r_coeff": np.ones((3, 10))}, {}, "r has 10 columns, which no full polynomial of 3 variables has"),
    ({"w_coeff": np.ones((6, 4))}, {}, "w has 4 columns"),
    ({"Ts": "fast"}, {}, "is not an SSMR model"), ({"B": {"odd": 1.0}}, {}, "is not an SSMR model")])
def test_tables_that_do_not_fit_together_are_refused_with_the_numbers(tmp_path, model, params, message):
    with pytest.raises(ValueError, match=message):
        read_ssmr_model(write(tmp_path / "model.mat", model, params))


def test_files_of_another_kind_are_refused(tmp_path):
    with pytest.raises(FileNotFoundError, match="no model file at .*absent.mat"):
        read_ssmr_model(tmp_path / "absent.mat")
    with pytest.raises(ValueError, match="expected the struct py_data.*failed at 'py_data'"):
        read_ssmr_model(write(tmp_path / "other.mat", name="other"))
    scipy.io.savemat(tmp_path / "flat.mat", {"py_data": np.ones(3)})
    scipy.io.savemat(tmp_path / "half.mat", {"py_data": {"model": {"w_coeff": np.ones((2, 2))}}})
    (tmp_path / "text.mat").write_text("w_coeff = [1 2 3]\n" * 20)
    (tmp_path / "empty.mat").write_bytes(b"")
    whole = write(tmp_path / "whole.mat").read_bytes()
    (tmp_path / "cut.mat").write_bytes(whole[:len(whole) // 2])
    for name in ("flat", "half", "text", "empty", "cut"):
        with pytest.raises(ValueError, match=f"{name}.mat is not an SSMR model: expected the struct py_data"):
            read_ssmr_model(tmp_path / f"{name}.mat")


REST = np.array([3.5888e-3, 0.2934e-3, 195.6144e-3])


def write_koopman(path, model=None, params=None, inputs=2):
    rng = np.random.default_rng(0)
    scale = {"y_factor": [80.0, 90.0, 50.0], "y_offset": [0.7, -6.7, 145.0],
             "u_factor": 300.0 + np.arange(inputs), "u_offset": 400.0 + np.arange(inputs)}
    tables = {"A": rng.normal(size=(6, 6)), "B": rng.normal(size=(6, inputs)), "G": rng.normal(size=(inputs, 3))}
    sizes = {"n": 3, "m": inputs, "delays": 1, "Ts": 0.02, "obs_degree": 1, "inputInFeatures": 0, "scale": scale}
    scipy.io.savemat(path, {"py_data": {"model": tables | (model or {}), "params": sizes | (params or {})}})
    return path


def assert_same_koopman_predictions(path):
    """Scaled absolute coordinates by their tables against displacements by ours: one step, read-out and pregain."""
    stored = scipy.io.loadmat(path, simplify_cells=True)["py_data"]
    scale = {name: np.reshape(value, -1) for name, value in stored["params"]["scale"].items()}
    A, G = stored["model"]["A"], stored["model"]["G"].reshape(-1, 3)
    B = stored["model"]["B"].reshape(6, -1)
    model = read_koopman_model(path, rest=REST)
    rng = np.random.default_rng(1)
    newest_last, u = 5e-3 * rng.normal(size=(20, 2, 3)), rng.uniform(0, 0.8, (20, model.input_dim))
    absolute = (1e3 * (newest_last + REST) - scale["y_offset"]) / scale["y_factor"]
    x, v = absolute[:, ::-1].reshape(20, 6), (1e3 * u - scale["u_offset"]) / scale["u_factor"]
    following = (x @ A.T + v @ B.T)[:, :3] * scale["y_factor"] + scale["y_offset"]
    z = model.encode(newest_last, np.zeros((20, 1, model.input_dim)))
    np.testing.assert_allclose(model.decode(z), newest_last[:, -1], rtol=0, atol=1e-15)
    np.testing.assert_allclose(model.decode(model.step(z, u)), 1e-3 * following - REST, rtol=0, atol=1e-13)
    expected = 1e-3 * (absolute[:, -1] @ G.T * scale["u_factor"] + scale["u_offset"])
    np.testing.assert_allclose(np.column_stack([np.ones(20), newest_last[:, -1]]) @ model.pregain.T, expected,
                               rtol=1e-11, atol=1e-12)
    assert (model.timestep, model.window_timestep, model.delays) == (0.02, 0.02, 1)


def test_the_published_trunk_model_of_absolute_positions_predicts_the_same_of_displacements(measurements):
    assert_same_koopman_predictions(measurements("trunk_simulated/reference_dmd_pregain.mat"))


@pytest.mark.parametrize("inputs", [1, 2])
def test_koopman_tables_are_converted_for_any_number_of_inputs(tmp_path, inputs):
    assert_same_koopman_predictions(write_koopman(tmp_path / "model.mat", inputs=inputs))


def test_either_kind_of_file_is_recognized_and_makes_an_artifact(tmp_path):
    koopman, names = write_koopman(tmp_path / "koopman.mat"), ("tip_x", "tip_y", "tip_z")
    for path, options, expected in (
            (koopman, {"rest": REST, "input_unit": 1e-3, "input_names": ["left", "right"]},
             {"name": "DMD (published)", "input_unit": "N", "input_names": ["left", "right"], "rest": REST.tolist()}),
            (write(tmp_path / "ssmr.mat"), {},
             {"name": "SSMR (published)", "input_unit": "1", "input_names": ["u1", "u2"], "rest": [0.0] * 3,
              "input_range": [[0.0] * 2, [1.0] * 2]})):
        tables, card = read_published_model(path, output_names=names, **options)
        assert expected.items() <= card.items()
        loaded = artifact.load(artifact.save(tmp_path / "artifact", tables, **card))
        assert type(loaded.model) is type(tables)
    _, card = read_published_model(koopman, output_names=names, rest=REST, input_unit=1e-3)
    np.testing.assert_allclose(card["input_range"], [[0.1, 0.1], [0.7, 0.702]])


@pytest.mark.parametrize(("model", "params", "message"), [
    ({}, {"obs_degree": 2}, r"with obs_degree 1 \(it is 2\)"), ({}, {"inputInFeatures": 1}, "inputInFeatures 0"),
    ({"A": np.eye(5)}, {}, r"have \(25, 12, 6, 3, 3, 2, 2, 3\) entries.*need \(36, 12, 6, 3, 3, 2, 2, 3\)"),
    ({"B": {"odd": 1.0}}, {}, "is not a Koopman model: expected the struct py_data"),
    ({}, {"scale": {}}, "is not a Koopman model.*failed at 'y_factor'")])
def test_koopman_files_that_do_not_fit_are_refused(tmp_path, model, params, message):
    with pytest.raises(ValueError, match=message):
        read_koopman_model(write_koopman(tmp_path / "model.mat", model, params), rest=REST)


def test_a_koopman_model_without_the_rest_it_needs_is_refused(tmp_path):
    path = write_koopman(tmp_path / "model.mat")
    with pytest.raises(ValueError, match="is a Koopman model, of absolute positions; give the rest"):
        read_published_model(path, output_names=("x", "y", "z"))
    with pytest.raises(ValueError, match="have .* 2\\) entries"):
        read_koopman_model(path, rest=[0.0, 0.0])
    with pytest.raises(ValueError, match="is not a published model"):
        read_published_model(write(tmp_path / "other.mat", name="other"), output_names=("x", "y", "z"))
