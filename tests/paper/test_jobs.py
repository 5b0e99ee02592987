"""The plan of the reproduction: what is needed and nothing else, in an order in which it can be done."""

from copy import deepcopy

import pytest

from ssmr_torch.paper.jobs import Job, chosen, plan, quoted, slower_runs

SETTINGS = {
    "name": "test",
    "models": {"SSMR": "ssmr", "DMD": "dmd", "neural ODE": "neural_ode"},
    "training": ["logger=csv"],
    "train": {"neural ODE": ["fit.training.minutes=1"]},
    "control": ["picture=false"],
    "robots": {
        "trunk": {"plant": "trunk_coarse", "mesh": None, "rig": "ideal", "excitation": "trunk", "robot": "trunk",
                  "methods": {"SSMR": ["controller=scp_trunk"], "neural ODE": ["controller=scp"], "DMD": []}},
        "bench": {"plant": "diamond", "mesh": "a b's.vtu", "rig": "emulated_bench",
                  "unmodelled": ["plant.stiffness_scale=0.9"],
                  "excitation": "diamond", "robot": "emulated_bench", "control": ["noise_std=0.0"],
                  "methods": {"SSMR": ["controller=scp"]}, "train": {"SSMR": ["fit=stability_guard"]}}},
    "figures": {
        "table": {"models": ["trunk", "bench"]},
        "delays": {"delays": "trunk", "record": {"figure": "letters", "method": "SSMR", "task": "S"}},
        "map": {"open_loop": ["trunk"]},
        "letters": {"robot": "trunk", "seeds": 1, "tasks": {"S": ["task=letter"], "O": ["task=letter", "task.text=O"]}},
        "obstacles": {"robot": "trunk", "seeds": 3, "seeded": ["task.obstacles.seed"], "without": ["DMD"],
                      "tasks": {"S": ["task=stanford_obstacles"]}},
        "pareto": {"uses": ["letters"]},
        "hardware": {"robot": "bench", "seeds": 2, "tasks": {"eight": ["task=figure_eight"]}}},
}


def names(jobs: list[Job]) -> list[str]:
    return [job.name for job in jobs]


def runs(figures) -> list[Job]:
    return [job for job in plan(SETTINGS, figures).jobs if "period" in job.about]


def test_an_open_loop_map_needs_the_data_and_all_models_of_its_robot_the_slow_ones_first():
    assert names(plan(SETTINGS, "map").jobs) == [
        "data/trunk", "models/trunk/neural ODE", "models/trunk/DMD", "models/trunk/SSMR", "open_loop/trunk"]


def test_the_delay_study_needs_one_closed_loop_and_its_model_alone():
    jobs = plan(SETTINGS, "delays").jobs
    assert names(jobs) == ["data/trunk", "models/trunk/SSMR", "runs/letters/trunk/SSMR/S/0-20ms", "delays/trunk"]
    assert jobs[-1].steps[0].files["record"] == "runs/letters/trunk/SSMR/S/0-20ms/record.h5"


def test_a_closed_loop_is_planned_once_where_the_delay_study_and_its_figure_want_it():
    found = names(runs(["delays", "letters"]))
    assert len(found) == len(set(found)) == 2 * 3


def test_a_figure_brings_those_that_it_uses():
    assert chosen(SETTINGS, "pareto") == ["letters", "pareto"]
    assert names(plan(SETTINGS, "pareto").jobs) == names(plan(SETTINGS, "letters").jobs)


def recorded() -> dict:
    settings = deepcopy(SETTINGS)
    settings["robots"]["real"] = {"data": "real_diamond", "robot": "real_diamond", "methods": {"DMD": []}}
    settings["figures"]["map"]["open_loop"].append("real")
    settings["figures"]["table"]["models"].append("real")
    return settings


def test_recordings_are_trained_on_and_scored_where_they_are_and_nothing_is_collected(tmp_path):
    jobs = {job.name: job for job in plan(recorded(), "map", str(tmp_path)).jobs}
    assert [name for name in jobs if name.startswith("data/")] == ["data/trunk"]
    for name in ("models/real/DMD", "open_loop/real"):
        assert {"data=real_diamond", f"data.path='{tmp_path}'"} <= set(jobs[name].steps[0].overrides)
        assert not jobs[name].steps[0].files
        assert not any("plant" in override for override in jobs[name].steps[0].overrides)


def test_without_a_folder_of_recordings_the_plan_is_that_of_the_other_robots():
    assert plan(recorded()).jobs == plan(SETTINGS).jobs


def test_every_seed_of_an_obstacle_figure_is_another_set_and_methods_left_out_are_not_run():
    every = runs("obstacles")
    assert [job.name.rsplit("/", 1)[1] for job in every if job.about["method"] == "SSMR"] == [
        "0-20ms", "1-20ms", "2-20ms"]
    assert {job.about["method"] for job in every} == {"SSMR", "neural ODE"}
    assert every[-1].steps[0].overrides[-2:] == ("seed=2", "task.obstacles.seed=2")
    settings = deepcopy(SETTINGS)
    settings["figures"]["obstacles"]["tasks"]["margin"] = {
        "control": ["task=stanford_obstacles", "controller.margins=[1]"], "seeds": 2, "without": ["neural ODE"]}
    margin = [job for job in plan(settings, "obstacles").jobs if job.about.get("task") == "margin"]
    assert names(margin) == [f"runs/obstacles/trunk/SSMR/margin/{seed}-20ms" for seed in range(2)]
    assert "controller.margins=[1]" in margin[0].steps[0].overrides


def test_the_bench_is_between_plant_and_controller_but_no_model_knows_of_it():
    data, model, run, _ = plan(SETTINGS, "hardware").jobs
    for job in (data, run):
        assert {"plant=diamond", "plant.mesh='a b\\'s.vtu'", "rig=emulated_bench", "plant.stiffness_scale=0.9"} <= set(
            job.steps[0].overrides)
    train, export = model.steps
    assert {"plant=diamond", "plant.mesh='a b\\'s.vtu'", "robot=emulated_bench", "model=ssmr", "fit=stability_guard",
            "logger=csv", "name='SSMR'"} == set(train.overrides)
    assert export.files == {"checkpoint": "./model.ckpt", "artifact": "./artifact"}
    assert "noise_std=0.0" in run.steps[0].overrides and "controller.period=0.02" in run.steps[0].overrides


def test_all_is_every_figure_and_each_job_comes_after_what_it_needs():
    everything = plan(SETTINGS).jobs
    assert len(everything) == 2 + 4 + (1 + 6 + 6 + 2) + 1
    before: set[str] = set()
    for job in everything:
        assert before.issuperset(job.needs)
        before.add(job.name)


def test_scores_of_the_open_loop_alone_are_made_of_those_models_that_there_are():
    assert names([job for job in plan(SETTINGS).jobs if job.partial]) == ["open_loop/trunk"]


@pytest.mark.parametrize(("figures", "message"), [("fig13", "figures is 'fig13'; expected all or some of table"),
                                                     ([], "expected all or some of")])
def test_a_figure_that_is_not_there_is_refused(figures, message):
    with pytest.raises(ValueError, match=message):
        plan(SETTINGS, figures)


def test_a_method_without_a_model_and_a_figure_without_its_robot_are_refused():
    wrong = deepcopy(SETTINGS)
    wrong["robots"]["bench"]["methods"]["TPWL"] = []
    with pytest.raises(ValueError, match="bench compares 'TPWL'; the models are SSMR, DMD, neural ODE"):
        plan(wrong)
    wrong = deepcopy(SETTINGS)
    wrong["figures"]["letters"]["robot"] = "snake"
    with pytest.raises(ValueError, match="no robot 'snake'; the settings have trunk, bench"):
        plan(wrong)


def p99(figure: str, times: dict[str, list[float]]) -> list[str]:
    known = {}
    for method, seconds in times.items():
        known |= dict(zip([job.name for job in runs(figure) if job.about["method"] == method], seconds))
    return names(slower_runs(SETTINGS, runs(figure), known))


def test_a_method_that_does_not_hold_its_period_is_run_again_at_the_shortest_multiple_that_it_holds():
    assert p99("letters", {"SSMR": [0.020, 0.020], "neural ODE": [0.041, 0.043], "DMD": [0.001, 0.002]}) == [
        "runs/letters/trunk/neural ODE/S/0-60ms", "runs/letters/trunk/neural ODE/O/0-60ms"]
    again = slower_runs(SETTINGS, runs("letters"), {"runs/letters/trunk/DMD/S/0-20ms": 0.03})
    assert again[0].about["period"] == pytest.approx(0.04) and "controller.period=0.04" in again[0].steps[0].overrides


def test_one_run_slowed_down_by_other_load_is_no_reason_to_run_again():
    assert not p99("obstacles", {"SSMR": [0.05, 0.001, 0.03]})


@pytest.mark.parametrize("text", ["plain", "a b", "it's", "a,b={c}", "back\\slash"])
def test_a_quoted_text_is_that_text_to_hydra(text):
    from hydra.core.override_parser.overrides_parser import OverridesParser

    assert OverridesParser.create().parse_override(f"key={quoted(text)}").value() == text
