"""Data sheets are documentation: the examples run, and every object prints itself as a tree and as a table."""

import doctest
from importlib import import_module

import numpy as np
import pytest

import ssmr_torch as ssmr
from ssmr_torch.data_sheet import DataSheet, html, text

EXAMPLES = ("data_sheet", "run", "trajectory", "data.arrays", "face", "fitting.fit", "evaluation.score_table",
            "trained_model", "tasks.references", "plants.slow_manifold", "control.mpc_settings")


def swinging(seconds=8.0, seed=0):
    """An oscillator with two outputs and one input: what the examples call `data`."""
    rng, t = np.random.default_rng(seed), np.arange(0.0, seconds, 0.01)
    A = np.array([[1.0, 0.01], [-1.0, 0.97]])

    def run(x, inputs):
        outputs = []
        for u in inputs:
            outputs.append(x * [1.0, 0.1])
            x = A @ x + [0.0, 0.2 * u]
        return t, np.array(outputs), inputs

    still = np.zeros(len(t))
    driven = [np.repeat(rng.uniform(-0.2, 0.2, len(t) // 20), 20) for _ in range(3)]
    return ssmr.trajectories(decays=[run(np.array([0.02, 0.0]), still), run(np.array([0.0, 0.2]), still)],
                             controlled=[run(np.zeros(2), u) for u in driven[:2]],
                             test=[run(np.zeros(2), driven[2])], output_names=["x", "v"], input_names=["u"])


@pytest.fixture(scope="module")
def data():
    return swinging()


@pytest.fixture(scope="module")
def model(data):
    return ssmr.fit(data, "dmd", progress=False)


@pytest.mark.parametrize("name", EXAMPLES)
def test_the_examples_of_the_documentation_are_true(name, data, model):
    done = doctest.testmod(import_module(f"ssmr_torch.{name}"), optionflags=doctest.ELLIPSIS,
                           extraglobs={"data": data, "model": model})
    assert done.attempted and not done.failed


@pytest.fixture(scope="module")
def objects(data, model):
    plant, task = ssmr.plants.SlowManifold(), ssmr.tasks.path([0.0, 1.0], [[0.0], [0.001]], outputs=["x"])
    controller = ssmr.ModelPredictiveController(model, task, [[-1.0], [1.0]], output_names=model.output_names)
    return {"dataset": data, "trajectory": data[0], "trained model": model, "model": model.reduced, "plant": plant,
            "task": task, "controller": controller, "score": ssmr.score(model, data, starts=10)}


@pytest.mark.parametrize(("name", "said"), [
    ("dataset", ["5 runs, 4000 samples, 0.01 s (100 Hz)", "decay, train: 2 runs", "u: -0.1", "from: arrays"]),
    ("trajectory", ["Trajectory 'decay 1': 800 samples, 7.99 s", "decay, train"]),
    ("trained model", ["TrainedModel DMD:", "delays = 1", "margin", "test/rmse", "trained on: 2 decays", "made by: "]),
    ("model", ["1 inputs, 2 outputs", "geometry", "margin"]),
    ("plant", ["SlowManifold 'slow manifold'", "cable_+x: 0 … 1.5 N"]),
    ("task", ["Task 'path': 1 s", "x: 0 … 1 mm", "obstacles: none"]),
    ("controller", ["'path' with proxqp", "every 0.02 s (50 Hz), over 5", "u1: -1 … 1"]),
    ("score", ["persistence", "mean / median RMSE in mm over n = 10"])])
def test_every_object_prints_itself_and_is_a_table_in_a_notebook(objects, name, said):
    printed, table = repr(objects[name]), objects[name]._repr_html_()
    assert all(each in printed for each in said), printed
    assert table.startswith("<table>") and table.endswith("</table>") and len(printed.splitlines()) <= 40


def test_what_a_sheet_says_is_escaped_in_a_notebook():
    assert "<script>" not in html("<script>", {"<script>": "<script>"})
    assert text("t", {"a": {"b": "1"}, "c": "2"}) == "t\n├─ a\n│  └─ b: 1\n└─ c: 2"


def test_a_dataclass_with_a_sheet_prints_that_and_not_its_fields():
    from dataclasses import dataclass

    @dataclass
    class Spring(DataSheet):
        stiffness: float

        def data_sheet(self):
            return "Spring", {"stiffness": f"{self.stiffness:g} N/m"}

    assert repr(Spring(2.0)) == "Spring\n└─ stiffness: 2 N/m"
