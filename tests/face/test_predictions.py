"""What a trained model predicts, and its scores."""

from pathlib import Path

import numpy as np
import pytest
from linear_robot import DT, HOLD, linear_robot, started

import ssmr_torch as ssmr

ROOT = Path(__file__).resolve().parents[2]


def test_a_linear_robot_is_predicted_exactly(data, dmd):
    window, inputs, past, measured = started(data, dmd, 5, 100)
    np.testing.assert_allclose(dmd.predict(window, inputs, past), measured, rtol=0, atol=1e-9)


def test_windows_and_inputs_are_broadcast(data, dmd):
    window, inputs, past, _ = started(data, dmd, 5, 30)
    many = dmd.predict(np.stack([window, 0 * window]), inputs, past)
    assert many.shape == (2, 30, 3)
    np.testing.assert_allclose(many[0], dmd.predict(window, inputs, past), rtol=1e-12)


def test_a_model_at_twice_the_sampling_time_predicts_every_sample(data):
    """At its own steps as stepped by hand under the mean of two inputs, halfway in between."""
    model = ssmr.fit(data, "dmd", timestep=2 * DT, progress=False)
    assert model.timestep == pytest.approx(2 * DT) and model.sampling_time == pytest.approx(DT)
    window, inputs, past, measured = started(data, model, 2 * HOLD, 41)
    found = model.predict(window, inputs, past)
    z, outputs = model.reduced.encode(window, past), [window[-1]]
    for k in range(0, 42, 2):
        z = model.reduced.step(z, 0.5 * (inputs[k] + inputs[min(k + 1, 40)]))
        outputs.append(model.reduced.decode(z))
    np.testing.assert_allclose(found[1::2], outputs[1:21], rtol=0, atol=1e-12)
    np.testing.assert_allclose(found[::2], 0.5 * (np.array(outputs[:-1]) + outputs[1:]), rtol=0, atol=1e-12)
    assert found.shape == (41, 3) and np.abs(found - measured).max() < 1e-3


def test_a_model_finer_than_the_recordings_is_asked_for_their_step(data):
    """A model in continuous time, whose artifact says that its recordings are twice as slow as its window."""
    model = ssmr.fit(data, "sssr", state_dim=4, progress=False)
    slower = ssmr.TrainedModel(model.reduced, model.card | {"sampling_time": 2 * DT})
    window, inputs, _, _ = started(data, model, 5, 10)
    every_other = model.predict(window, np.repeat(inputs, 2, axis=0))[1::2]
    np.testing.assert_allclose(slower.predict(window, inputs), every_other, rtol=0, atol=1e-7)


@pytest.mark.parametrize(("arguments", "message"), [
    ({"window": np.zeros((1, 3))}, r"window has shape \(1, 3\); expected \(…, 2, 3\): samples of x, y, z, 0.01 s"),
    ({"inputs": np.zeros((5, 3))}, r"inputs has shape \(5, 3\); expected \(…, H, 2\): left, right, held 0.01 s each"),
    ({"inputs": np.zeros((0, 2))}, "inputs has shape"),
    ({"past_inputs": np.zeros((2, 2))}, r"past_inputs has shape \(2, 2\); expected \(…, 1, 2\)"),
    ({"past_inputs": None}, r"the chart of this model needs the inputs .* give past_inputs \(…, 1, 2\)"),
    ({"window": np.zeros((3, 2, 3)), "inputs": np.zeros((2, 5, 2))}, r"the leading shapes \[\(3,\), \(2,\)"),
    ({"window": np.full((2, 3), np.nan)}, "window contains numbers that are not finite"),
])
def test_arrays_of_another_shape_are_refused_with_what_is_expected(dmd, arguments, message):
    given = {"window": np.zeros((2, 3)), "inputs": np.zeros((4, 2)), "past_inputs": np.zeros((1, 2))} | arguments
    with pytest.raises(ValueError, match=message):
        dmd.predict(**given)


def test_a_model_whose_chart_sees_outputs_alone_needs_no_past_inputs(data):
    model = ssmr.fit(data, "sssr", state_dim=4, progress=False)
    window, inputs, past, _ = started(data, model, 5, 20)
    assert (model.predict(window, inputs) == model.predict(window, inputs, past)).all()


def test_persistence_is_scored_as_by_hand(data, dmd):
    table = ssmr.score(dmd, data, horizons=[0.2], starts=10**6)
    y, margin = data.select("test")[0].observation, table["persistence"].margin
    errors = [np.sqrt(((y[k + 1:k + 21] - y[k]) ** 2).sum(axis=1).mean()) for k in range(margin, len(y) - 20)]
    found = table["persistence"]["200 ms"]
    assert found.mean == pytest.approx(np.mean(errors), rel=1e-12) and len(found.errors) == len(errors)
    assert list(table) == ["DMD", "persistence", "constant velocity"] and table["DMD"]["full"].mean < 1e-9


def test_a_model_of_coarse_steps_is_scored_by_what_it_predicts_at_every_sample(data):
    model = ssmr.fit(data, "dmd", timestep=0.05, progress=False)
    found = ssmr.score(model, data, horizons=[0.23], starts=30)["DMD"]["230 ms"]
    run, delays, apart = data.select("test")[0], model.delays, round(model.window_timestep / model.sampling_time)
    errors = []
    for start in found.sample:
        seen = start + apart * np.arange(-delays, 1)
        past = np.array([run.input[k:k + apart].mean(axis=0) for k in seen[:-1]]).reshape(delays, -1)
        predicted = model.predict(run.observation[seen], run.input[start:start + 23], past)
        errors.append(np.sqrt(((predicted - run.observation[start + 1:start + 24]) ** 2).sum(axis=1).mean()))
    np.testing.assert_allclose(found.errors, errors, rtol=1e-9)


def test_runs_of_several_kinds_are_printed_apart_with_and_without_noise(data, dmd):
    table = ssmr.score(dmd, data, split=None, kind=None, starts=40, noise=1e-3, horizons=[0.1])
    assert {"decays", "all controlled"} <= set(table.groups) and "decays" in repr(table)
    assert len(table["DMD"]["100 ms"].errors) == 40 == len(table.groups["decays"]["DMD"]["100 ms"].errors)
    assert table["DMD"].noisy["100 ms"].mean > 1e-4 > table["DMD"]["100 ms"].mean and "DMD, noise 1 mm" in repr(table)
    assert table._repr_html_().count("<table>") == len(table.groups)
    better = table.difference("DMD", "persistence", "100 ms")
    assert better.low <= better.mean <= better.high < 0


def test_several_models_are_scored_from_the_same_starts(data, dmd):
    table = ssmr.score({"one": dmd, "two": dmd}, data, starts=20)
    assert (table["one"]["1 s"].errors == table["two"]["1 s"].errors).all() and len(table) == 4
    assert "<td>persistence</td>" in table._repr_html_() and "RMSE in mm" in repr(table)


@pytest.mark.parametrize("given", ["trajectories.h5", [], None])
def test_what_is_no_dataset_or_no_model_is_refused_by_name(data, dmd, given):
    with pytest.raises(TypeError, match="expected a TrajectoryDataset, which read, load and"):
        ssmr.score(dmd, given)
    with pytest.raises(TypeError, match="expected a TrajectoryDataset, which read, load and"):
        ssmr.fit(given, "dmd", progress=False)
    with pytest.raises(TypeError, match="is not a model; expected the result of fit or load"):
        ssmr.score({"one": dmd, "other": given}, data)


def test_data_without_test_runs_or_of_another_robot_are_refused(data, dmd):
    with pytest.raises(ValueError, match="no run of split='validation' to score; they have"):
        ssmr.score(dmd, data, split="validation")
    other = ssmr.trajectories(**linear_robot(), output_names=["x", "y", "z"], units={"length": "mm"})
    with pytest.raises(ValueError, match="inputs"):
        ssmr.score(dmd, other)
