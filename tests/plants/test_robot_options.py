"""What a finite-element robot makes of the options that it is given, and which it refuses."""

import json

import numpy as np
import pytest

from ssmr_torch.plants.diamond import Diamond
from ssmr_torch.plants.trunk import Trunk


def test_a_number_of_numpy_is_a_plain_parameter_too():
    parameters = Trunk(mesh="trunk_coarse", markers={"tip": np.int64(240)}).parameters
    assert json.loads(json.dumps(parameters))["markers"] == {"tip": 240}


def test_the_origin_tells_meshes_apart():
    coarse, loaded, fine = (Trunk(mesh="trunk_coarse"), Trunk(mesh="trunk_coarse", payload=0.001), Trunk())
    assert loaded.origin == coarse.origin
    assert len(coarse.origin["sha256"]) == 64 and coarse.origin["sha256"] != fine.origin["sha256"]
    assert len(coarse.positions) == coarse.origin["nodes"] < fine.origin["nodes"]


def test_a_marker_with_the_value_none_is_left_out():
    robot = Trunk(mesh="trunk_coarse", markers={"tip": (0.0, 0.0, 0.195), "middle": None, "upper": (0.0, 0.0, 0.065)})
    assert robot.output_names == ("tip_x", "tip_y", "tip_z", "upper_x", "upper_y", "upper_z")


@pytest.mark.parametrize(("changes", "match"), [
    ({"scheme": "bdf2", "law": "corotational"}, "use backward_euler with corotational"),
    ({"scheme": "backward_euler", "law": "neo_hookean"}, "use backward_euler with corotational"),
    ({"scheme": "euler"}, "scheme is 'euler'; expected one of"),
    ({"linear_solver": "cholmod"}, "expected one of"),
    ({"law": "hookean"}, "expected one of"),
    ({"stiffness": 1.0}, "unknown \\['stiffness'\\]; expected some of"),
    ({"timestep": 0.0}, "timestep is 0.0 s; expected"),
    ({"timestep": np.nan}, "timestep is nan s; expected"),
    ({"markers": {}}, "no markers"),
    ({"markers": {"tip": None}}, "no markers"),
    ({"markers": {"tip": 10**6}}, "marker 'tip' is 1000000; expected a node's number from 0 to"),
    ({"markers": {"tip": -1}}, "marker 'tip' is -1"),
    ({"markers": {"tip": 1.5}}, "marker 'tip' is 1.5; expected a node's number"),
    ({"markers": {"tip": (0.0, 0.1)}}, "marker 'tip' has shape"),
    ({"markers": {"tip": (0.0, 0.1, np.nan)}}, "marker 'tip' is .* expected 3 finite"),
    ({"input_bounds": (-0.1, 1.0)}, "cables only pull"),
    ({"input_bounds": (1.0, 0.0)}, "the lowest below the highest"),
    ({"input_bounds": (0.0, np.inf)}, r"input_bounds\[1\] is inf; expected"),
    ({"input_bounds": np.zeros((2, 3))}, "expected \\(2,\\) or \\(2, "),
    ({"poisson": 0.5}, r"poisson is 0\.5; expected"),
    ({"payload": -1.0}, r"payload is -1\.0 kg; expected"),
    ({"length_unit": "inch"}, "expected one of"),
], ids=str)
def test_impossible_options_are_refused(changes, match):
    for kind, mesh in ((Trunk, "trunk_coarse"), (Diamond, "diamond_coarse")):
        with pytest.raises(ValueError, match=match):
            kind(**{"mesh": mesh, **changes})


@pytest.mark.parametrize("kind", [Diamond, Trunk])
def test_a_mesh_in_another_unit_is_refused_with_advice(kind):
    with pytest.raises(ValueError, match="check the unit"):
        kind(mesh=f"{kind.__name__.lower()}_coarse", length_unit="m")


def test_a_missing_mesh_is_refused():
    for kind in (Trunk, Diamond):
        with pytest.raises(FileNotFoundError, match="no mesh file at"):
            kind(mesh="elephant")
