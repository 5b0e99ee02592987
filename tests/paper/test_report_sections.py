"""The report of a reproduction shows every run that it left, in the paper's order, and says what is missing."""

import csv
import json
import math

import h5py
import numpy as np
import pytest

from ssmr_torch.closed_loop.record import ClosedLoopRecord
from ssmr_torch.evaluation import figures
from ssmr_torch.paper.published_numbers import FIGURES
from ssmr_torch.paper.report_sections import read_results, report_sections
from ssmr_torch.report.html_page import Picture, Table, write_report
from ssmr_torch.tasks.obstacles import random_circles

METHODS = ("SSMR", "SSSR", "DMD", "EDMD", "static pregain", "TPWL", "neural ODE", "control-augmented SSMR")
RUN_COLUMNS = ("figure", "robot", "method", "task", "seed", "period", "real_time", "ise", "rmse", "max_error",
               "violation_ratio", "max_violation", "solve_median", "solve_p99", "fallbacks", "record")
MODEL_COLUMNS = ("robot", "method", "state_dim", "parameters", "decays", "controlled_samples", "fit_time", "timestep",
                 "delays", "command")
LOOPS = (("fig6", "diamond", "slow figure eight", 1), ("fig6", "diamond", "fast figure eight", 1),
         ("fig7", "trunk", "ASL", 1), ("fig7", "trunk", "Pacman", 1), ("fig9", "trunk", "ETH among obstacles", 4),
         ("fig11", "emulated_bench", "figure eight", 3), ("fig11", "emulated_bench", "circle", 3),
         ("fig12", "emulated_bench", "S among obstacles", 3))
TIME = 0.01 * np.arange(301)


def record_of(error, obstacles, rng):
    reference = 0.015 * np.stack([-np.sin(2.1 * TIME), np.sin(4.2 * TIME)], axis=1)
    wiggle = error * np.stack([np.sin(7 * TIME + rng.uniform(0, 6)), np.cos(5 * TIME)], axis=1)
    observation = np.column_stack([reference + wiggle, np.zeros(len(TIME))])
    return ClosedLoopRecord(
        time=TIME, reference=reference, observation=observation, measurement=observation,
        input=np.zeros((len(TIME), 4)), fallback=np.zeros(len(TIME), dtype=bool),
        solve_time=np.full(len(TIME), 1e-3), iterations=np.ones(len(TIME)),
        statuses=[""] * len(TIME), tracked=(0, 1), output_names=("tip_x", "tip_y", "tip_z"), input_names="abcd",
        provenance={"configuration": {"task": {"obstacles": obstacles}}})


def obstacles_of(task, seed):
    if task.startswith("ETH"):
        return {"_target_": "ssmr_torch.tasks.obstacles.random_circles", "seed": seed, "count": 20, "reach": 0.03}
    return [{"_target_": "…Circle", "center": [0.001, -0.005], "radius": 0.0015}] if "obstacles" in task else None


def write_loops(directory, methods=METHODS, loops=LOOPS):
    """Method k has k + 1 times the error of SSMR and as many times its solve time of 1 ms; TPWL takes 25 ms, and on
    the bench runs again at 40 ms.
    """
    rng, rows = np.random.default_rng(0), []
    for figure, robot, task, seeds in loops:
        for k, method in enumerate(methods):
            for seed in range(seeds):
                late = method == "TPWL"
                for period in (0.02, 0.04) if late and robot == "emulated_bench" else (0.02,):
                    error = 1e-4 * (k + 1) * (1 + 0.1 * seed)
                    at = f"runs/{figure}/{robot}/{method}/{task}/{seed}-{1e3 * period:g}ms/record.h5"
                    record_of(error, obstacles_of(task, seed), rng).save(directory / at)
                    solve = 0.025 if late else 1e-3 * (k + 1)
                    among = "obstacles" in task
                    rows.append([figure, robot, method, task, seed, period, "true" if solve <= period else "false",
                                 200 * error ** 2, error, 1.5 * error, 0.01 * k if among else "",
                                 1e-4 * k if among else "", 0.5 * solve, solve, 0, at])
    write_csv(directory / "runs.csv", RUN_COLUMNS, rows)


def write_csv(path, header, rows):
    path.parent.mkdir(parents=True, exist_ok=True)
    with open(path, "w", newline="") as file:
        csv.writer(file).writerows([header, *rows])


def write_models(directory, methods=METHODS):
    rows = [[robot, method, 6 + 5 * k, 400 * (k + 1), 40, 8700, 0.5, 0.01, 1, "Best of 40 trials"]
            for robot in ("trunk", "diamond", "emulated_bench") for k, method in enumerate(methods)]
    write_csv(directory / "models.csv", MODEL_COLUMNS, rows)


def write_open_loop(directory, robot, methods=METHODS, starts=500):
    rng = np.random.default_rng(1)
    every = [*methods, "persistence", "constant velocity"]
    errors = {name: 2e-5 * (k + 1) * rng.lognormal(0, 0.5, starts) for k, name in enumerate(every)}
    errors["EDMD"][::25] = math.inf

    def part(label, error):
        finite = error.mean() if np.isfinite(error).all() else None
        return {"label": label, "starts": starts, "mean": finite, "median": float(np.median(error)),
                "diverged": float(np.isinf(error).mean())}
    scores = {name: {"horizons": [part("50 ms", error), part("200 ms", 4 * error), part("1 s", 9 * error),
                                  part("full", 20 * error)]} for name, error in errors.items()}
    path = directory / "open_loop" / f"{robot}.json"
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps({"scores": scores, "test": "fast-test-0"}))
    with h5py.File(path.with_suffix(".h5"), "w") as file:
        file["position"] = rng.uniform(-0.02, 0.02, (starts, 3))
        for name in methods:
            file[f"error/{name}"] = errors[name]


def write_delays(directory, robot="diamond"):
    rows = [{"delays": count, "reparametrized": new, "ratio": 98.0 if new else 100 - 2 * count, "error": 2.0 * count}
            for count in (4, 10, 15, 20) for new in (False, True)]
    path = directory / "delays" / robot / "delays.json"
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps({"rows": rows}))
    figures.save(figures.singular_values(np.array([2.0, 1.0]), 1), path.with_suffix(".svg"))


def write_everything(directory):
    write_loops(directory)
    write_models(directory)
    write_delays(directory)
    for robot in ("diamond", "trunk"):
        write_open_loop(directory, robot)
    return directory


def parts_of(section, kind):
    return [part for part in section.parts if isinstance(part, kind)]


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    directory = write_everything(tmp_path_factory.mktemp("whole"))
    return directory, report_sections(directory, list(FIGURES))


def row_of(table, *start):
    return next(row for row in table.rows if list(row[:len(start)]) == list(start))


def test_every_table_and_figure_has_a_section_in_the_papers_order_and_a_verdict(whole):
    directory, sections = whole
    assert [section.heading for section in sections] == ["What came out", *(paper.title for paper in FIGURES.values())]
    assert all(section.parts[-1].startswith("Verdict: ") for section in sections[1:])
    assert write_report(directory, "Reproduction", sections).stat().st_size > 100_000


def test_each_drawing_is_saved_small_and_its_caption_tells_how_many_in_which_unit(whole):
    directory, sections = whole
    pictures = [part for section in sections for part in parts_of(section, Picture)]
    drawn = {path.name for path in (directory / "figures").iterdir()}
    assert {"fig4-map.svg", "fig4-boxes.svg", "fig5-map.svg", "fig6-relative.svg", "fig6-slow-figure-eight.svg",
            "fig7-ASL.svg", "fig8-pareto.svg", "fig9-ETH-among-obstacles.svg", "fig9-boxes.svg", "fig11-circle.svg",
            "fig12-boxes.svg"} <= drawn
    assert len(drawn) == len(pictures) - 1  # the delay study drew its own
    assert all(path.stat().st_size < 300_000 for path in (directory / "figures").iterdir())
    assert all(any(digit.isdigit() for digit in picture.count) and picture.unit for picture in pictures)


def test_the_summary_has_the_ise_of_every_method_its_ratio_to_ssmr_violations_and_solve_time(whole):
    table = parts_of(whole[1][0], Table)[1]
    *start, inside, depth, load = row_of(table, "trunk", "ASL", "DMD")[3:]
    np.testing.assert_allclose([*start, load], [1, 20.0, 18.0, 9.0, 0.15])
    assert inside is None and depth is None
    ratio, inside, depth, load = row_of(table, "trunk", "ETH among obstacles", "EDMD")[6:]
    np.testing.assert_allclose([ratio, inside, depth, load], [16.0, 3.0, 0.3, 0.2])
    assert len(table.rows) == len(METHODS) * len(LOOPS)


def test_verdicts_of_the_summary_and_of_the_sections_are_the_same(whole):
    table = parts_of(whole[1][0], Table)[0]
    for section, (name, _, verdict, reason) in zip(whole[1][1:], table.rows):
        assert section.heading == FIGURES[name].title and section.parts[-1] == f"Verdict: {verdict}. {reason}"
    assert row_of(table, "fig7")[2] == "better" and row_of(table, "fig10")[2] == "not judged"


def test_open_loop_errors_stand_beside_the_published_ones_and_a_diverged_mean_is_infinite(whole):
    section = next(section for section in whole[1] if section.heading == FIGURES["fig4"].title)
    table, = parts_of(section, Table)
    assert [row[0] for row in table.rows][-2:] == ["persistence", "constant velocity"]
    ssmr, edmd = row_of(table, "SSMR"), row_of(table, "EDMD")
    assert ssmr[5] == pytest.approx(0.492) and row_of(table, "persistence")[5] is None
    assert math.isinf(edmd[1]) and math.isfinite(edmd[4]) and edmd[6] == pytest.approx(4.0)
    assert ssmr[2] == pytest.approx(4 * ssmr[1])


def test_on_the_bench_a_method_that_is_too_late_is_shown_at_the_period_that_it_holds(whole):
    section = next(section for section in whole[1] if section.heading == FIGURES["fig10"].title)
    table, = parts_of(section, Table)
    assert row_of(table, "circle", "TPWL")[2:] == [40.0, 3] and row_of(table, "circle", "SSMR")[2:] == [20.0, 3]


def test_among_obstacles_all_methods_are_drawn_in_the_one_run_in_which_ssmr_has_its_median_ise(whole, monkeypatch):
    drawn = {}
    monkeypatch.setattr("ssmr_torch.paper.closed_loop_figures.obstacle_paths",
                        lambda runs, names: drawn.update(runs) or figures.panels(2, 2)[0])
    report_sections(whole[0], ["fig9"])
    expected = [[*circle.center, circle.radius] for circle in random_circles(1, 20, 0.03)]
    assert set(drawn) == set(METHODS)
    for run in drawn.values():
        np.testing.assert_allclose(run["obstacles"], expected)
    drawn.clear()
    report_sections(whole[0], ["fig12"])
    np.testing.assert_allclose(drawn["TPWL"]["obstacles"], [[0.001, -0.005, 0.0015]])


def test_what_has_no_data_is_left_out_with_a_sentence(tmp_path):
    write_open_loop(tmp_path, "trunk", ("SSMR", "EDMD"))
    sections = report_sections(tmp_path, ["table1", "fig5", "fig9"])
    assert [section.heading for section in sections] == ["What came out", FIGURES["fig5"].title]
    assert "Left out, as their data are missing: table1, fig9." in sections[0].parts
    verdicts = parts_of(sections[0], Table)[0]
    assert [row[2] for row in verdicts.rows] == ["not judged", "better", "not judged"]
    empty, = report_sections(tmp_path / "nothing", ["fig6"])
    assert len(parts_of(empty, Table)) == 1


def test_a_run_without_a_number_failed_and_is_infinite(tmp_path):
    write_loops(tmp_path, ("SSMR", "DMD"), [("fig7", "trunk", "ASL", 2)])
    with open(tmp_path / "runs.csv") as file:
        header, *rows = list(csv.reader(file))
    rows[2][header.index("ise")] = rows[2][header.index("rmse")] = ""
    write_csv(tmp_path / "runs.csv", header, rows)
    assert math.isinf(read_results(tmp_path).runs[2].ise) and math.isnan(read_results(tmp_path).runs[2].max_violation)
    section = report_sections(tmp_path, ["fig7"])[1]
    ise, low = row_of(parts_of(section, Table)[0], "ASL", "DMD")[3:5]
    assert math.isinf(ise) and low is None
    assert "∞ (a run failed)" in section.parts[-1]


def test_an_unknown_figure_is_refused(tmp_path):
    with pytest.raises(ValueError, match=r"\['fig2'\].*table1"):
        report_sections(tmp_path, ["fig6", "fig2"])
