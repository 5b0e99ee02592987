"""Every run below a directory appears in the report, with its own numbers."""

import json
import subprocess
import sys

import numpy as np
import pytest

from ssmr_torch.closed_loop.record import ClosedLoopRecord
from ssmr_torch.evaluation import figures
from ssmr_torch.evaluation.metrics import closed_loop_metrics
from ssmr_torch.evaluation.open_loop import compare_open_loop
from ssmr_torch.models.named_structures import spectral_submanifold
from ssmr_torch.report.html_page import Picture, Table, write_report
from ssmr_torch.report.run_sections import (
    closed_loop_section,
    collect_sections,
    open_loop_section,
    prediction_figures,
    training_figures,
    training_section,
)
from ssmr_torch.trajectory import Trajectory

TIME = 0.01 * np.arange(151)
HELD = np.arange(len(TIME)) % 2 == 1


def record_of(seed=0, tracked=2, error=1e-3, **changes):
    """A robot 2 or 3 outputs of which are tracked with an error of 1 mm and a hundredth of it as noise."""
    rng = np.random.default_rng(seed)
    reference = 0.01 * np.sin(TIME[:, None] + np.arange(tracked))
    observation = reference + error * (1 + 0.01 * rng.standard_normal((len(TIME), tracked)))
    provenance = {"task": "circle", "plant": "Trunk", "noise_std": 3e-5, "period": 0.02, "seed": seed, "model": "SSMR",
                  "input_bounds": [[0.0, 0.0], [1.0, 1.0]]} | changes
    return ClosedLoopRecord(
        time=TIME, reference=reference, observation=observation, measurement=observation,
        input=rng.uniform(0, 1, (len(TIME), 2)), fallback=np.arange(len(TIME)) < seed,
        solve_time=np.where(HELD, np.nan, rng.uniform(1e-3, 2e-3, len(TIME))), iterations=np.where(HELD, 0, 1),
        statuses=[""] * len(TIME), tracked=range(tracked), output_names="xyz"[:tracked], input_names=("left", "right"),
        provenance=provenance)


def saved(directory, *records):
    for index, record in enumerate(records):
        record.save(directory / f"{index:02}" / "record.h5")
    return directory


def parts_of(section, kind):
    return [part for part in section.parts if isinstance(part, kind)]


def written(path, content):
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(content))
    return path


def expected_row(record):
    values = closed_loop_metrics(record)
    return [1e6 * values["ise"], 1e3 * values["rmse"], 1e3 * values["max_error"], 1e3 * values["solve_time_median"],
            1e3 * values["solve_time_p99"], values["fallbacks"]]


def test_every_run_of_one_model_has_a_row_with_its_seed_and_the_numbers_of_the_metrics(tmp_path):
    records = [record_of(seed) for seed in range(3)]
    section, = collect_sections(saved(tmp_path, *records))
    table, = parts_of(section, Table)
    assert table.header[:2] == ["model", "seed"]
    assert [row[:2] for row in table.rows] == [["SSMR", 0], ["SSMR 2", 1], ["SSMR 3", 2]]
    for row, record in zip(table.rows, records):
        assert row[2:] == expected_row(record)


def test_runs_of_one_seed_are_told_apart_by_their_model_alone(tmp_path):
    records = [record_of(model=model) for model in ("SSMR", "EDMD", "SSMR")]
    table, = parts_of(closed_loop_section(records), Table)
    assert [row[0] for row in table.rows] == ["SSMR", "EDMD", "SSMR 2"]
    assert "seed" not in table.header


@pytest.mark.parametrize("change", [{"task": "figure eight"}, {"plant": "Diamond"}, {"noise_std": 0.0},
                                    {"period": 0.04}, {"configuration": {"plant": {"observe": "state"}}},
                                    {"configuration": {"rig": {"sensor_delay": 0.02}}}])
def test_runs_that_do_not_compare_get_sections_of_their_own(change, tmp_path):
    records = [record_of(0), record_of(1, **change), record_of(2)]
    sections = collect_sections(saved(tmp_path, *records))
    rows = [[row[0] for row in parts_of(section, Table)[0].rows] for section in sections]
    assert rows == [["SSMR", "SSMR 2"], ["SSMR"]]
    with pytest.raises(ValueError, match="3 records with 2 different settings"):
        closed_loop_section(records)


def test_a_rig_is_described_by_what_is_on_and_one_that_is_off_changes_nothing():
    off = {"_target_": "ssmr_torch.plants.emulated_rig.rig", "_partial_": True, "noise_std": 0.0, "sensor_delay": 0.0,
           "dropped": "held", "rate_limit": None}
    plant = {"_target_": "trunk", "observe": "tip"}
    section = closed_loop_section([record_of(configuration={"plant": plant}),
                                   record_of(configuration={"plant": plant, "rig": off})])
    assert parts_of(section, Table)[-1].rows == [["observe", "tip"]]
    on = off | {"sensor_delay": 0.02, "rate_limit": 10.0}
    section = closed_loop_section([record_of(configuration={"plant": plant, "rig": on})])
    assert parts_of(section, Table)[-1].rows == [["observe", "tip"], ["rig sensor_delay", "0.02"],
                                                 ["rig rate_limit", "10.0"]]


def test_the_picture_of_the_robot_beside_a_record_is_shown_first(tmp_path):
    first = saved(tmp_path, record_of(0), record_of(1))
    drawing = figures.singular_values(np.array([2.0, 1.0]), 1)
    figures.save(drawing, sorted(first.rglob("record.h5"))[1].with_name("robot.svg"))
    pictures = parts_of(collect_sections(first)[0], Picture)
    assert "path of its tip so far" in pictures[0].caption and pictures[0].figure.name == "robot.svg"


def test_the_eigenvalues_of_the_plant_are_drawn_with_those_of_the_fit_as_far_as_these_reach():
    report = {"closed_form": {"state_dim": 2, "singular_values": None, "eigenvalues": [[-1.0, 10.0], [-1.0, -10.0]]}}
    axes = training_figures(report, [[-1.1, 10.2], [-1.1, -10.2], [-90.0, 0.0]])["eigenvalues"].axes[0]
    plant = next(line for line in axes.get_lines() if line.get_label() == "plant")
    np.testing.assert_allclose(plant.get_ydata(), [10.2, -10.2])


@pytest.mark.parametrize("runs", [6, 7])
def test_a_figure_shows_six_runs_and_the_text_says_when_there_are_more(runs):
    section = closed_loop_section([record_of(seed, model="mine") for seed in range(runs)])
    plane = parts_of(section, Picture)[0].figure.axes[0]
    assert len(plane.get_lines()) == 6 + 1
    assert len(parts_of(section, Table)[0].rows) == runs
    said = "The figures show the first 6 of 7 runs." in section.parts
    assert said == (runs == 7)


@pytest.mark.parametrize("tracked", [1, 2, 3])
def test_any_number_of_outputs_can_be_tracked(tracked, tmp_path):
    section, = collect_sections(saved(tmp_path, record_of(tracked=tracked)))
    path, inputs, times = parts_of(section, Picture)
    assert len(path.figure.axes) == tracked  # of two outputs the plane and the error, else one each
    assert "reference" in [line.get_label() for line in path.figure.axes[0].get_lines()]
    assert write_report(tmp_path, "report", [section]).is_file()


def test_a_run_that_broke_off_keeps_its_row_and_the_text_says_why():
    whole, broken = record_of(0), record_of(1)
    broken.observation[100:] = np.nan
    section = closed_loop_section([whole, broken])
    first, second = parts_of(section, Table)[0].rows
    assert first[2:] == expected_row(whole) and second == ["SSMR 2", 1, *[None] * 5, 1]
    assert any("SSMR 2 has no errors: 51 of 151 tracking errors are" in part for part in parts_of(section, str))
    assert "SSMR 2" not in [line.get_label() for line in parts_of(section, Picture)[0].figure.axes[0].get_lines()]
    assert not parts_of(closed_loop_section([broken]), Picture)


def test_a_directory_without_results_is_refused(tmp_path):
    with pytest.raises(ValueError, match="nothing to report below"):
        collect_sections(tmp_path)


def horizon(label, mean, diverged=0.0):
    return {"label": label, "starts": 40, "mean": mean, "diverged": diverged}


def test_open_loop_errors_are_shown_in_millimetres_and_diverged_ones_left_out(tmp_path):
    path = written(tmp_path / "scores.json", {
        "scores": {"SSMR": {"horizons": [horizon("50 ms", 1e-4), horizon("full", 2e-3)]},
                   "EDMD": {"horizons": [horizon("50 ms", 5e-4), horizon("full", None, 0.25)]},
                   "persistence": {"horizons": None}},
        "provenance": {"configuration": {"split": None}}})
    section = open_loop_section(path)
    table, = parts_of(section, Table)
    assert table.header == ["model", "50 ms (mm)", "full (mm)", "diverged (%)"]
    assert table.rows[0] == ["SSMR", pytest.approx(0.1), pytest.approx(2.0), 0.0]
    assert table.rows[1] == ["EDMD", pytest.approx(0.5), None, 25.0]
    assert table.rows[2] == ["persistence", None, None, None]
    assert "on the whole set" in section.parts[0] and not parts_of(section, Picture)


def test_groups_of_runs_have_tables_of_their_own_with_marks_and_rows_for_the_noise_of_the_loop(tmp_path):
    scored = {"horizons": [horizon("1 s", 1e-3) | {"nmte": 0.05}], "marks": {"1 s": "="}, "noise": 0.0,
              "noisy": {"horizons": [horizon("1 s", 2e-3) | {"nmte": 0.1}], "marks": {"1 s": "*"}, "noise": 3e-5}}
    path = written(tmp_path / "scores.json", {"scores": {"SSMR": scored}, "groups": {"fast": {"SSMR": scored},
                                                                                     "decays": {"SSMR": scored}}})
    fast, decays = parts_of(open_loop_section(path), Table)
    assert fast.caption.startswith("fast: ") and decays.caption.startswith("decays: ")
    assert fast.header == ["model", "1 s (mm)", "NMTE, 1 s (%)", "diverged (%)"]
    assert fast.rows == [["SSMR", "1 =", 5.0, 0.0], ["SSMR, noise 0.03 mm", "2 *", 10.0, 0.0]]


def fit_report(**changes):
    regression = {"rows": 100, "features": 9, "condition": 12.0, "ridge": 0.0, "relative_residual": 0.05}
    return {"regressions": {"drift": regression}, "trajectories": {"decay": 4, "controlled": 2},
            "eigenvalues": [[-1.0, 2.0], [-1.0, -2.0]], "singular_values": [4.0, 2.0, 1.0, 0.0], "state_dim": 2,
            "warnings": ["few decays."]} | changes


def test_a_training_report_shows_scores_regressions_and_warnings(tmp_path):
    section = training_section(written(tmp_path / "report.json", {
        "closed_form": fit_report(), "provenance": {"name": "SSSR"},
        "scores": {"validation/rmse": 2e-4, "validation/diverged": 0.0, "test/rmse": None, "test/diverged": 0.5}}))
    assert section.heading == "Training: SSSR"
    assert section.parts[:2] == ["Open-loop error over the validation horizon: validation 0.2 mm; "
                                 "test not finite (50 % of the rollouts diverged).", "Warning: few decays."]
    assert section.parts[2].rows == [["closed form: drift", 100, 9, 12.0, 0.0, 5.0]]


@pytest.mark.parametrize("trajectories, count", [({"decay": 4, "controlled": 2}, "4 decays"),
                                                 ({"decay": 0, "controlled": 3}, "3 controlled runs"),
                                                 ({"controlled": 1}, "1 controlled runs")])
def test_the_captions_of_a_fit_name_the_runs_that_it_rests_on(trajectories, count, tmp_path):
    report = {"closed_form": fit_report(trajectories=trajectories)}
    for name, figure in training_figures(report).items():
        figure.savefig(tmp_path / f"{name}.svg")
    section = training_section(written(tmp_path / "report.json", report | {"provenance": {"name": "SSMR"}}))
    assert [picture.count for picture in parts_of(section, Picture)] == [count, count]


@pytest.mark.parametrize("scores", [None, {}, {"validation/rmse": None}])
@pytest.mark.parametrize("fit", [{"regressions": {}, "warnings": []}, {"regressions": None}, {}])
def test_a_fit_that_found_little_is_reported_all_the_same(fit, scores, tmp_path):
    written(tmp_path / "job" / "report.json", {"refinement": fit, "scores": scores, "provenance": None})
    section, = collect_sections(tmp_path)
    assert section.heading == "Training: job" and len(section.parts) == 1
    assert ("not finite" if scores else "none scored") in section.parts[0]


def test_training_figures_show_the_positive_singular_values_and_all_spectra():
    drawn = training_figures({"closed_form": fit_report(), "refinement": {"eigenvalues": [[-3.0, 0.0]]}})
    spectrum = drawn["singular_values"].axes[0].get_lines()[0]
    np.testing.assert_allclose(spectrum.get_ydata(), [1.0, 0.5, 0.25])
    lines = {line.get_label(): line for line in drawn["eigenvalues"].axes[0].get_lines()}
    np.testing.assert_array_equal(lines["closed form"].get_ydata(), [2.0, -2.0])
    np.testing.assert_array_equal(lines["refinement"].get_xdata(), [-3.0])


@pytest.mark.parametrize("fit", [{}, {"eigenvalues": [], "singular_values": [], "state_dim": 2},
                                 {"singular_values": [1.0], "state_dim": 1},
                                 {"singular_values": [1.0, 0.5, 0.0], "state_dim": 3}])
def test_training_figures_leave_out_what_was_not_found(fit):
    assert training_figures({"closed_form": fit}) == {}


def decaying(rate, delays=1):
    """dy/dt = −rate y + u on two outputs; of the window the newest sample counts."""
    return spectral_submanifold(
        chart=np.hstack([np.zeros((2, 2 * delays)), np.eye(2)]), parametrization=np.vstack([np.eye(2)] * (delays + 1)),
        drift=-rate * np.eye(2), control=np.eye(2), state_scale=np.full(2, 0.1), chart_degree=1,
        parametrization_degree=1, dynamics_degree=1, control_degree=0, input_dim=2, output_dim=2, delays=delays,
        timestep=0.01, window_timestep=0.01, substeps=1)


def run_of(length, kind):
    time = 0.01 * np.arange(length)
    return Trajectory(time, 0.02 * np.exp(-time)[:, None] * [1.0, -1.0], np.zeros((length, 2)), kind, "test")


RUNS = [run_of(300, "decay"), run_of(200, "controlled"), run_of(120, "controlled")]


def test_prediction_figures_compare_all_models_from_one_start_of_the_longest_controlled_run():
    """The exact model reproduces e^{−t}, whatever window it was given."""
    models = {"SSMR": decaying(1.0), "EDMD": decaying(2.0, delays=5)}
    scores = compare_open_loop(models, RUNS, horizons=[0.05, 0.2], starts=20)
    drawn = prediction_figures(models, scores, RUNS, ("x", "y"), [1], shown=1.0)
    axes, = drawn["prediction"].axes
    lines = {line.get_label(): line for line in axes.get_lines()}
    assert axes.get_ylabel() == "y (mm)" and set(lines) == {"measured", "SSMR", "EDMD"}
    for name, rate in (("SSMR", 1.0), ("EDMD", 2.0)):
        time = lines[name].get_xdata()
        np.testing.assert_allclose([time[0], time[-1]], [0.06, 1.05])
        np.testing.assert_allclose(lines[name].get_ydata(), -20 * np.exp(-0.05 - rate * (time - 0.05)), rtol=1e-8)
    curves = {line.get_label(): line for line in drawn["error_over_horizon"].axes[0].get_lines()}
    assert set(curves) == {"SSMR", "EDMD", "persistence", "constant velocity"}
    np.testing.assert_allclose(curves["EDMD"].get_xdata(), [0.05, 0.2])
    np.testing.assert_allclose(curves["EDMD"].get_ydata(), [1e3 * part.mean for part in scores["EDMD"].horizons[:2]])


def test_of_more_than_six_models_the_first_six_are_drawn_and_the_text_says_so(tmp_path):
    models = {f"model {index}": decaying(1.0 + index) for index in range(8)}
    scores = compare_open_loop(models, RUNS, horizons=[0.05], starts=20)
    for name, figure in prediction_figures(models, scores, RUNS, ("x", "y"), [0]).items():
        figure.savefig(tmp_path / f"{name}.svg")
        assert len([line for line in figure.axes[0].get_lines() if line.get_label().startswith("model")]) == 6
    stored = {"scores": {name: score.as_dict() for name, score in scores.items()}, "provenance": {}}
    section = open_loop_section(written(tmp_path / "scores.json", stored))
    assert "The figures show the first 6 of 8 models." in section.parts
    assert len(parts_of(section, Table)[0].rows) == 8 + 2
    assert [picture.count for picture in parts_of(section, Picture)] == ["20 starts", "1 run"]


def test_a_report_is_made_without_torch():
    code = "import sys; sys.modules['torch'] = None; import ssmr_torch.report.run_sections"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
