"""Figures show what they are given, in the unit on the axis."""

import subprocess
import sys

import numpy as np
import pytest

from ssmr_torch.evaluation import figures

TIME = 0.02 * np.arange(200)
CIRCLE = 0.01 * np.stack([np.cos(TIME), np.sin(TIME)], axis=1)


def line_of(axes, label):
    return next(line for line in axes.get_lines() if line.get_label() == label)


FIGURES = {
    "singular_values": lambda: figures.singular_values(0.5 ** np.arange(8), 3),
    "eigenvalues": lambda: figures.eigenvalues({"SSMR": np.array([-1 + 2j, -1 - 2j])}, np.array([-1 + 2j])),
    "prediction": lambda: figures.prediction(TIME, CIRCLE, {"SSMR": (TIME, 1.1 * CIRCLE)}, ("x", "y")),
    "error_over_horizon": lambda: figures.error_over_horizon([0.05, 1.0], {"SSMR": [1e-4, 1e-3]}),
    "tracking": lambda: figures.tracking(TIME, CIRCLE, {"SSMR": 1.1 * CIRCLE}, ("x", "y"), [[0, 0, 2e-3]]),
    "inputs": lambda: figures.inputs(TIME, {"SSMR": np.ones((200, 5))}, [[0.0] * 5, [2.0] * 5], "abcde"),
    "solve_times": lambda: figures.solve_times({"SSMR": np.full(50, 1e-3), "EDMD": np.full(50, 5e-3)}, 0.02),
    "ise_bars": lambda: figures.ise_bars({"circle": {"SSMR": 1e-6, "EDMD": np.inf}}),
}


@pytest.mark.parametrize("name", FIGURES)
def test_every_figure_is_saved_in_every_format_without_leftovers(name, tmp_path):
    figure = FIGURES[name]()
    for suffix, magic in ((".svg", b"<?xml"), (".pdf", b"%PDF"), (".png", b"\x89PNG")):
        path = figures.save(figure, tmp_path / "new" / (name + suffix))
        assert path.read_bytes().startswith(magic)
    assert len(list((tmp_path / "new").iterdir())) == 3


@pytest.mark.parametrize("name", FIGURES)
def test_every_quantitative_axis_has_a_label_with_its_unit(name):
    for axes in FIGURES[name]().axes:
        leftmost = axes.axison and axes.get_subplotspec().is_first_col()
        if name == "solve_times":
            assert "(ms)" in axes.get_xlabel()
        elif leftmost:
            assert "(" in axes.get_ylabel()


@pytest.mark.parametrize("name", FIGURES)
def test_no_legend_covers_the_data(name):
    figure = FIGURES[name]()
    figure.draw_without_rendering()
    for legend in figure.legends:
        box = legend.get_window_extent()
        assert not any(box.overlaps(axes.get_window_extent()) for axes in figure.axes if axes.axison)


def test_the_same_figure_gives_the_same_file(tmp_path):
    first = figures.save(FIGURES["tracking"](), tmp_path / "one.svg").read_bytes()
    assert figures.save(FIGURES["tracking"](), tmp_path / "two.svg").read_bytes() == first


def test_a_method_has_one_colour_and_no_two_methods_share_it():
    alone, among_others = figures.colours(["EDMD"]), figures.colours(["mine", "SSMR", "EDMD", "yours"])
    assert alone["EDMD"] == among_others["EDMD"]
    methods = [name for name in figures.METHODS if name not in ("reference", "measured")]
    everything = figures.colours([*methods, "reference", *"abcdef"])
    assert len(set(everything.values())) == len(everything)
    with pytest.raises(ValueError, match="7 methods"):
        figures.colours("abcdefg")


def test_a_method_keeps_its_look_however_its_name_is_written():
    assert figures.look("SSMR_CONTROL_AUGMENTED") == figures.look("ssmr control augmented") != figures.look("SSMR")
    assert figures.look("NEURAL_ODE") == figures.METHODS["neural ODE"] and figures.look("mine") is None


def test_a_dozen_models_are_all_named_inside_the_figure():
    names = [name for name in figures.METHODS if name not in ("reference", "measured")]
    figure = figures.error_over_horizon(np.array([0.05, 0.2]), {name.upper(): np.array([1e-4, 1e-3]) for name in names})
    figure.draw_without_rendering()
    box = figure.legends[0].get_window_extent()
    assert [text.get_text() for text in figure.legends[0].get_texts()] == [name.upper() for name in names]
    assert box.x0 >= 0 and box.y0 >= 0 and box.x1 <= figure.bbox.x1 and box.y1 <= figure.bbox.y1
    assert not box.overlaps(figure.axes[0].get_window_extent())


def test_lengths_are_drawn_in_millimetres_and_times_in_milliseconds():
    tracking = FIGURES["tracking"]()
    plane, error = tracking.axes
    np.testing.assert_allclose(line_of(plane, "SSMR").get_xdata(), 11.0 * np.cos(TIME))
    np.testing.assert_allclose(line_of(error, "SSMR").get_ydata(), 1.0)
    assert plane.patches[0].radius == 2.0
    solve = FIGURES["solve_times"]().axes[0]
    np.testing.assert_allclose(line_of(solve, "control period, 20 ms").get_xdata(), 20.0)
    bars = FIGURES["ise_bars"]().axes[0]
    assert bars.patches[0].get_height() == pytest.approx(1.0)


def test_the_variance_left_out_and_the_gap_are_those_of_the_singular_values():
    """Singular values 2^{-i}: n modes leave out (4^{-n} − 4^{-K}) / (1 − 4^{-K}), and every gap is 2."""
    _, remainder, gaps = FIGURES["singular_values"]().axes
    modes = np.arange(1, 8)
    expected = 100 * (4.0 ** -modes - 4.0 ** -8) / (1 - 4.0 ** -8)
    np.testing.assert_allclose(remainder.get_lines()[0].get_ydata(), expected, rtol=1e-12)
    np.testing.assert_allclose([bar.get_height() for bar in gaps.patches], 2.0)
    assert f"{100 - expected[2]:.4g} %" in remainder.get_title()


def test_the_curve_of_a_model_ends_with_a_cross_where_it_diverges():
    horizons = np.array([0.05, 0.2, 1.0])
    axes = figures.error_over_horizon(horizons, {"DMD": np.array([1e-4, 2e-4, np.inf])}).axes[0]
    curve, cross = axes.get_lines()
    np.testing.assert_allclose(curve.get_xdata(), horizons[:2])
    assert curve.get_label() == "DMD (× diverges)" and cross.get_marker() == "x"


def test_a_diverging_prediction_does_not_stretch_the_axis():
    growing = CIRCLE * np.exp(20 * TIME)[:, None]
    figure = figures.prediction(TIME, CIRCLE, {"DMD": (TIME, growing)}, ("x", "y"))
    assert max(axes.get_ylim()[1] for axes in figure.axes) < 20.0


def test_a_failed_run_is_marked_instead_of_left_out():
    axes = FIGURES["ise_bars"]().axes[0]
    mark, = axes.texts
    low, high = axes.get_xlim()
    assert mark.get_text() == "failed" and low < mark.xy[0] < high


def test_bad_input_is_refused_before_anything_is_drawn():
    with pytest.raises(ValueError, match="descending"):
        figures.singular_values(np.array([1.0, 2.0, 0.5]), 1)
    with pytest.raises(ValueError, match="3 names"):
        figures.prediction(TIME, CIRCLE, {}, ("x", "y", "z"))
    with pytest.raises(ValueError, match=".svg"):
        figures.save(FIGURES["tracking"](), "figure.jpg")


def test_drawing_leaves_the_callers_style_alone_and_needs_no_screen_library():
    code = ("import sys, matplotlib; before = matplotlib.rcParams.copy(); "
            "from ssmr_torch.evaluation import figures; figures.eigenvalues({'SSMR': [1j]}); "
            "assert matplotlib.rcParams.copy() == before; sys.exit('matplotlib.pyplot' in sys.modules)")
    assert subprocess.run([sys.executable, "-c", code]).returncode == 0
