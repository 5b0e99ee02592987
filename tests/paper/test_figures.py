"""Figures in the paper's kinds show every method and run, what failed too, in the unit on the axis."""

import math

import numpy as np
import pytest

from ssmr_torch.evaluation import figures
from ssmr_torch.paper.closed_loop_figures import (
    obstacle_boxes,
    obstacle_paths,
    pareto,
    relative_ise_bars,
)
from ssmr_torch.paper.error_distribution_figures import error_boxes
from ssmr_torch.paper.error_map_figures import error_maps
from ssmr_torch.paper.figure_panels import plain
from ssmr_torch.paper.path_figures import tracked_paths

EIGHT = ("SSMR", "SSSR", "control-augmented SSMR", "DMD", "EDMD", "static pregain", "TPWL", "neural ODE")
RNG = np.random.default_rng(0)
POSITION = RNG.uniform(-0.02, 0.02, (500, 3))
ERRORS = {name: 1e-5 * 3.0 ** k * RNG.lognormal(size=500) for k, name in enumerate(EIGHT)}
ERRORS["EDMD"][::50] = math.inf
TIME = np.linspace(0.0, 6.0, 601)
PATH = 0.015 * np.stack([np.sin(TIME), np.sin(2 * TIME)], axis=1)
ISE = {"slow": {name: [1e-5 * (k + 1.0), 1e-5 * (k + 2.0)] for k, name in enumerate(EIGHT)},
       "fast": {name: [2e-5 * 10.0 ** k] for k, name in enumerate(EIGHT)}}
TASKS = {task: [{"method": name, "ise": 1e-5 * (k + 1), "load": 2.0 ** -k, "load_p99": 2.0 ** (1 - k), "front": k < 3}
                for k, name in enumerate(EIGHT)] for task in ("slow", "fast")}
RUNS = {name: {"reference": PATH, "path": 1.01 * PATH, "obstacles": [[0.015, 0.0, 0.004], [0.03, 0.03, 0.006]],
               "note": "ISE 1 mm²"} for name in EIGHT}
STATISTICS = {name: {"ise": 1e-5 * RNG.lognormal(size=30), "violation_ratio": RNG.uniform(0, 0.02, 30),
                     "max_violation": RNG.uniform(0, 1e-3, 30)} for name in EIGHT}
FIGURES = {
    "error_maps": lambda: error_maps(POSITION, ERRORS),
    "error_boxes": lambda: error_boxes(ERRORS),
    "tracked_paths": lambda: tracked_paths(PATH, dict.fromkeys(EIGHT, [1.01 * PATH, 0.9 * PATH]), ("x", "y"),
                                           dict.fromkeys(EIGHT, "RMSE 0.1 mm")),
    "relative_ise_bars": lambda: relative_ise_bars(ISE),
    "pareto": lambda: pareto(TASKS),
    "obstacle_paths": lambda: obstacle_paths(RUNS, ("x", "y")),
    "obstacle_boxes": lambda: obstacle_boxes(STATISTICS),
}


def panels_of(figure):
    return [axes for axes in figure.axes if axes.get_label() != "<colorbar>"]


@pytest.mark.parametrize("name", FIGURES)
def test_eight_methods_fit_the_papers_width_without_overlap_in_a_small_file(name, tmp_path):
    figure = FIGURES[name]()
    assert figure.get_figwidth() <= figures.WIDTH
    assert figures.save(figure, tmp_path / "figure.svg").stat().st_size < 300_000
    figure.draw_without_rendering()
    around = figure.bbox.padded(2.0)
    for axes in figure.axes:
        box = axes.get_tightbbox()
        assert around.x0 <= box.x0 and box.x1 <= around.x1 and around.y0 <= box.y0 and box.y1 <= around.y1
    titles = [axes.title.get_window_extent() for axes in figure.axes if axes.get_title()]
    assert not any(one.overlaps(other) for i, one in enumerate(titles) for other in titles[:i])
    for legend in figure.legends:
        assert not any(legend.get_window_extent().overlaps(axes.get_window_extent()) for axes in figure.axes)


@pytest.mark.parametrize("name", FIGURES)
def test_outer_axes_have_labels_with_their_unit(name):
    labels = [label for axes in FIGURES[name]().axes for label in (axes.get_xlabel(), axes.get_ylabel()) if label]
    assert labels and all("(" in label for label in labels)


def test_the_names_that_tables_use_have_the_colours_of_their_methods():
    assert figures.look("control-augmented SSMR") == figures.look("SSMR_CONTROL_AUGMENTED")
    assert figures.look("static pregain") == figures.look("KOOPMAN_LQR")
    assert len(set(figures.colours(EIGHT).values())) == len(EIGHT)


def test_error_maps_share_one_scale_in_millimetres_and_cross_out_what_diverged():
    drawn = panels_of(FIGURES["error_maps"]())
    limits = {axes.collections[0].get_clim() for axes in drawn}
    finite = 1e3 * np.concatenate([error[np.isfinite(error)] for error in ERRORS.values()])
    assert len(limits) == 1
    np.testing.assert_allclose(limits.pop(), np.quantile(finite, [0.01, 0.99]))
    edmd = drawn[EIGHT.index("EDMD")]
    crosses = next(line for line in edmd.get_lines() if line.get_marker() == "x")
    np.testing.assert_allclose(crosses.get_xydata(), 1e3 * POSITION[::50, :2])
    assert len(edmd.collections[0].get_offsets()) == 490
    assert "2 % diverged" in [text.get_text() for text in edmd.texts]


def test_errors_that_belong_to_other_starts_are_refused():
    with pytest.raises(ValueError, match=r"\(3,\).*500 starts"):
        error_maps(POSITION, {"SSMR": np.ones(3)})


def test_the_median_of_all_starts_stands_beside_its_box():
    texts = [text.get_text() for text in FIGURES["error_boxes"]().axes[0].texts]
    assert texts[0] == f"{1e3 * np.median(ERRORS['SSMR']):.3g} mm"
    assert texts[4] == f"{1e3 * np.median(ERRORS['EDMD']):.3g} mm, 2 % diverged"
    assert error_boxes({"DMD": np.array([1e-3, math.inf, math.inf])}).axes[0].texts[0].get_text().startswith("∞ mm")


def test_the_first_path_is_bold_and_all_are_in_millimetres_below_the_reference():
    axes = FIGURES["tracked_paths"]().axes[0]
    other, best, reference = axes.get_lines()
    assert best.get_linewidth() > other.get_linewidth() and reference.get_color() == "black"
    np.testing.assert_allclose(reference.get_xydata()[-1], 1e3 * PATH[-1])
    np.testing.assert_allclose(best.get_xydata()[0], 1.01e3 * PATH[0])


def test_bars_are_the_mean_over_the_mean_of_ssmr_and_a_single_run_has_no_interval():
    """ISEs 1, 2 of SSMR and 2, 3 of SSSR: (2.5 / 1.5 − 1) · 100 %."""
    slow, fast = FIGURES["relative_ise_bars"]().axes
    np.testing.assert_allclose([bar.get_width() for bar in slow.patches[:2]], [0.0, 200 / 3], atol=1e-9)
    np.testing.assert_allclose([bar.get_width() for bar in fast.patches[:3]], [0.0, 900, 9900], atol=1e-9)
    assert [text.get_text() for text in fast.texts[:3]] == ["0 %", "+900 %", "+9\u2009900 %"]
    interval = [line for line in slow.get_lines() if line.get_marker() == "|"]
    assert len(interval) == len(EIGHT) and not [line for line in fast.get_lines() if line.get_marker() == "|"]
    np.testing.assert_allclose(interval[1].get_xdata(), [100 / 3, 100])


def test_a_failed_run_is_told_and_leaves_no_mean():
    axes = relative_ise_bars({"slow": {"SSMR": [1e-5, 1e-5], "DMD": [2e-5, math.inf]}}).axes[0]
    assert axes.texts[1].get_text() == "1 of 2 failed" and len(axes.patches) == 1
    with pytest.raises(ValueError, match="no run of SSMR.*'slow'"):
        relative_ise_bars({"slow": {"DMD": [1e-5]}})


def test_the_front_is_joined_and_ringed_and_the_real_time_line_is_at_one():
    axes = FIGURES["pareto"]().axes[0]
    joined, *points, limit = axes.get_lines()
    np.testing.assert_allclose(joined.get_xydata(), [[0.25, 30.0], [0.5, 20.0], [1.0, 10.0]])
    np.testing.assert_allclose(limit.get_xdata(), 1.0)
    ringed = {point.get_label() for point in points if point.get_markeredgecolor() == "black"}
    assert ringed == set(EIGHT[:3])


def test_samples_inside_an_obstacle_are_marked_and_only_these():
    axes = FIGURES["obstacle_paths"]().axes[0]
    assert [patch.radius for patch in axes.patches] == [4.0, 6.0]
    inside = axes.get_lines()[-1].get_xydata()
    path = 1.01e3 * PATH
    expected = np.linalg.norm(path - [15.0, 0.0], axis=1) < 4.0
    np.testing.assert_array_equal(np.isfinite(inside[:, 0]), expected)
    np.testing.assert_allclose(inside[expected], path[expected])


def test_boxes_among_obstacles_tell_medians_in_square_millimetres_percent_and_millimetres():
    axes = FIGURES["obstacle_boxes"]().axes
    for panel, (key, factor) in zip(axes, (("ise", 1e6), ("violation_ratio", 100.0), ("max_violation", 1e3))):
        assert panel.texts[0].get_text() == plain(factor * np.median(STATISTICS["SSMR"][key]))


def test_runs_that_never_touch_an_obstacle_are_drawn():
    never = {"SSMR": {"ise": np.array([1e-5]), "violation_ratio": np.zeros(1), "max_violation": np.zeros(1)}}
    assert [axes.texts[0].get_text() for axes in obstacle_boxes(never).axes] == ["10", "0", "0"]
