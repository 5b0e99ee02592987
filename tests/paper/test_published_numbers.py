"""The paper's numbers are in SI units and belong together."""

import numpy as np

from ssmr_torch.paper.published_numbers import FIGURES, METHODS, OPEN_LOOP, OURS, TABLE_1, TRACKING


def test_open_loop_errors_are_those_of_the_captions_in_metres():
    assert OPEN_LOOP["diamond"]["SSMR"] == 0.492e-3 and OPEN_LOOP["trunk"]["DMD"] == 4.24e-3
    assert min(OPEN_LOOP["diamond"], key=OPEN_LOOP["diamond"].get) == "TPWL"
    assert min(OPEN_LOOP["trunk"], key=OPEN_LOOP["trunk"].get) == "SSMR"
    np.testing.assert_allclose(OPEN_LOOP["diamond"]["DMD"] / OPEN_LOOP["diamond"]["SSMR"], 6.3, atol=0.05)


def test_ssmr_is_printed_with_the_lowest_dimension_on_every_robot():
    for models in TABLE_1.values():
        assert models["SSMR"].dimension == min(model.dimension for model in models.values()) == 6
    assert (TABLE_1["trunk"]["EDMD"].dimension, TABLE_1["trunk"]["EDMD"].transitions) == (120, 7111)
    assert TABLE_1["emulated_bench"]["static pregain"].others == 291


def test_every_method_and_robot_of_the_paper_has_a_name_that_a_reproduction_uses():
    named = {name for table in (TABLE_1, OPEN_LOOP, TRACKING) for row in table.values() for name in row}
    assert named <= set(METHODS) and set(OURS) <= set(METHODS)
    assert all(set(paper.methods) <= set(METHODS) and paper.protocol.endswith(".") for paper in FIGURES.values())
    assert list(FIGURES) == ["table1", *(f"fig{number}" for number in range(3, 13))]
