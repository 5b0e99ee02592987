"""Figures of sweeps and studies show every job, the failed ones too."""

import numpy as np
import pytest

from ssmr_torch.evaluation import figures, study_figures


def job(model, score, parameters=100.0):
    return {"model": model, "validation/rmse": score, "parameters": parameters, "fit_time": 2.0, "step_time": 1e-4,
            "controlled_samples": 6000.0}


def point(model, at, error):
    return {"model": model, "noise": at, "50 ms": error, "200 ms": error, "1 s": error}


def delays(count, reparametrized, ratio):
    return {"delays": count, "reparametrized": reparametrized, "ratio": ratio, "error": 100.0 - ratio,
            "outputs": 1e-3 * PATH[-30:]}


PATH = np.linspace(1.0, 5.0, 50)[:, None] * np.ones(3)
JOBS = [job("SSMR", 1e-3), job("SSMR", 2e-3, 900.0), job("EDMD", None, 5000.0)]
POINTS = [point("SSMR", 0.0, 1e-3), point("SSMR", 1e-4, 2e-3), point("SSMR", 1e-4, 4e-3), point("DMD", 0.0, 3e-3),
          point("DMD", 1e-4, None), point("persistence", 0.0, 9e-3), point("persistence", 1e-4, 9e-3)]
FIGURES = {
    "ranking": lambda: study_figures.ranking(JOBS, "validation/rmse"),
    "trend": lambda: study_figures.trend(POINTS, "noise", "noise (m)"),
    "reconstruction": lambda: study_figures.reconstruction(
        [delays(4, False, 90.0), delays(20, False, 30.0), delays(20, True, 99.0)], 1e-3 * PATH, "xyz"),
}


@pytest.mark.parametrize("rows", [
    [job("SSMR", None)], [job("SSMR", float("inf")), job("EDMD", float("nan"))], [job("SSMR", 0.0)],
    [job("SSMR", 1e-3) | {"fit_time": 0.0, "controlled_samples": 0.0}]], ids=["lost", "infinite", "zero", "no cost"])
def test_a_sweep_of_which_no_job_has_a_place_on_a_logarithmic_axis_is_drawn(rows, tmp_path):
    ranking = figures.save(study_figures.ranking(rows, "validation/rmse"), tmp_path / "ranking.svg")
    lost = [point(row["model"], 1.0, row["validation/rmse"]) for row in rows]
    trend = figures.save(study_figures.trend(lost, "noise", "noise (m)"), tmp_path / "trend.svg")
    assert all(rows[0]["model"] in path.read_text() for path in (ranking, trend))


def line(axes, label):
    return next(drawn for drawn in axes.get_lines() if drawn.get_label() == label)


def crosses(axes):
    return [drawn for drawn in axes.get_lines() if drawn.get_marker() == "x"]


@pytest.mark.parametrize("name", FIGURES)
def test_every_axis_has_a_label_with_its_unit_and_no_legend_covers_the_data(name, tmp_path):
    figure = FIGURES[name]()
    assert figures.save(figure, tmp_path / "figure.png").stat().st_size > 5000
    for legend in figure.legends:
        assert not any(legend.get_window_extent().overlaps(axes.get_window_extent()) for axes in figure.axes)
    assert "(" in figure.axes[0].get_ylabel()
    if name != "reconstruction":
        assert all("(" in axes.get_xlabel() for axes in figure.axes)


def test_a_ranking_shows_each_job_over_each_cost_and_the_best_of_each_model_larger():
    parameters, _, step, _ = FIGURES["ranking"]().axes
    every, best = (drawn for drawn in parameters.get_lines() if drawn.get_marker() == "o")
    np.testing.assert_allclose(every.get_xydata(), [[100.0, 1.0], [900.0, 2.0]])
    np.testing.assert_allclose(best.get_xydata(), [[100.0, 1.0]])
    assert best.get_markersize() > every.get_markersize() and best.get_label() == "SSMR"
    np.testing.assert_allclose(next(iter(step.get_lines())).get_xdata(), 0.1)


def test_a_job_that_diverged_is_a_cross_at_the_upper_edge_of_every_panel():
    figure = FIGURES["ranking"]()
    for axes in figure.axes:
        cross, = crosses(axes)
        assert cross.get_ydata()[0] == 1.0 and cross.get_color() == figures.METHODS["EDMD"][0]
    assert figure.legends[0].get_texts()[-1].get_text() == "some or all diverge"


def test_a_score_that_is_no_length_has_no_unit():
    rows = [row | {"validation/relative": 0.1} for row in JOBS]
    assert study_figures.ranking(rows, "validation/relative").axes[0].get_ylabel() == "validation/relative (–)"


def test_a_trend_is_the_median_of_repeated_points_in_millimetres_with_the_band_that_they_span():
    axes = FIGURES["trend"]().axes[2]
    np.testing.assert_allclose(line(axes, "SSMR").get_xydata(), [[0.0, 1.0], [1e-4, 3.0]])
    band = axes.collections[[drawn.get_label() for drawn in axes.get_lines()].index("SSMR")]
    assert band.get_paths()[0].vertices[:, 1].max() == pytest.approx(4.0)


def test_a_line_breaks_and_is_crossed_where_a_model_diverges():
    figure = FIGURES["trend"]()
    for axes in figure.axes:
        assert np.isnan(line(axes, "DMD").get_ydata()[1])
        cross, = crosses(axes)
        np.testing.assert_allclose(cross.get_xdata(), [1e-4])
    assert line(figure.axes[0], "persistence").get_linestyle() == "--"


def test_any_number_of_models_can_be_told_apart_and_the_known_ones_keep_their_colours():
    names = ["SSMR", "NEURAL_ODE", *(f"model {number}" for number in range(16))]
    found = study_figures.looks(names)
    assert len(set(found.values())) == len(names)
    assert found["SSMR"][0] == figures.METHODS["SSMR"][0] and found["NEURAL_ODE"][0] == figures.METHODS["neural ODE"][0]


def test_the_delay_study_draws_the_ratio_the_error_and_the_path_of_the_longest_window():
    ratio, error, path = FIGURES["reconstruction"]().axes
    np.testing.assert_allclose(ratio.get_lines()[0].get_xydata(), [[4, 90.0], [20, 30.0]])
    np.testing.assert_allclose(error.get_lines()[0].get_ydata(), [10.0, 70.0])
    assert path.get_title() == "20 delays" and len(line(path, "measured").get_xdata()) == 30
    np.testing.assert_allclose(line(path, "reparametrized").get_xdata(), PATH[-30:, 0])
