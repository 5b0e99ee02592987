"""The plan of the reproduction: what is needed and nothing else, in an order in which it can be done."""

from copy import deepcopy

import pytest

from ssmr_torch.paper.jobs import Job, Step, chosen, keys, plan, quoted, slower_runs, with_recordings

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
                  "bench": ["plant.stiffness_scale=0.9"],
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


def names(stages: dict[str, list[Job]]) -> list[list[str]]:
    return [[job.name for job in jobs] for jobs in stages.values()]


def flat(stages: dict[str, list[Job]]) -> list[Job]:
    return [job for jobs in stages.values() for job in jobs]


def test_an_open_loop_map_needs_the_data_and_all_models_of_its_robot_the_slow_ones_first():
    assert names(plan(SETTINGS, "map")) == [
        ["data/trunk"], ["models/trunk/neural ODE", "models/trunk/DMD", "models/trunk/SSMR"], ["open_loop/trunk"], []]


def test_the_delay_study_needs_one_closed_loop_and_its_model_alone():
    assert names(plan(SETTINGS, "delays")) == [
        ["data/trunk"], ["models/trunk/SSMR"], ["runs/letters/trunk/SSMR/S/0-20ms"], ["delays/trunk"]]
    assert plan(SETTINGS, "delays")["delays and slower runs"][0].steps[0].files["record"] == (
        "runs/letters/trunk/SSMR/S/0-20ms/record.h5")


def test_a_closed_loop_is_planned_once_where_the_delay_study_and_its_figure_want_it():
    runs = plan(SETTINGS, ["delays", "letters"])["open loop and runs"]
    assert len(runs) == len({job.name for job in runs}) == 2 * 3


def test_a_figure_brings_those_that_it_uses():
    assert chosen(SETTINGS, "pareto") == ["letters", "pareto"]
    assert names(plan(SETTINGS, "pareto")) == names(plan(SETTINGS, "letters"))


def recorded() -> dict:
    settings = deepcopy(SETTINGS)
    settings["robots"]["real"] = {"data": "real_diamond", "robot": "real_diamond", "methods": {"DMD": []}}
    settings["figures"]["map"]["open_loop"].append("real")
    settings["figures"]["table"]["models"].append("real")
    return settings


def test_recordings_are_trained_on_and_scored_where_they_are_and_nothing_is_collected():
    stages = plan(with_recordings(recorded(), "/a b"), "map")
    jobs = {job.name: job for job in flat(stages)}
    assert [job.name for job in stages["data"]] == ["data/trunk"]
    for name in ("models/real/DMD", "open_loop/real"):
        assert {"data=real_diamond", "data.path='/a b'"} <= set(jobs[name].steps[0].overrides)
        assert not jobs[name].steps[0].files
        assert not any("plant" in override for override in jobs[name].steps[0].overrides)


def test_without_a_folder_of_recordings_the_plan_is_that_of_the_other_robots():
    for settings in (recorded(), with_recordings(recorded(), None)):
        assert keys(flat(plan(settings)), as_given) == keys(flat(plan(SETTINGS)), as_given)


def test_every_seed_of_an_obstacle_figure_is_another_set_and_methods_left_out_are_not_run():
    runs = plan(SETTINGS, "obstacles")["open loop and runs"]
    assert [job.name.rsplit("/", 1)[1] for job in runs if job.about["method"] == "SSMR"] == [
        "0-20ms", "1-20ms", "2-20ms"]
    assert {job.about["method"] for job in runs} == {"SSMR", "neural ODE"}
    assert runs[-1].steps[0].overrides[-2:] == ("seed=2", "task.obstacles.seed=2")
    settings = deepcopy(SETTINGS)
    settings["figures"]["obstacles"]["tasks"]["margin"] = {
        "control": ["task=stanford_obstacles", "controller.margins=[1]"], "seeds": 2, "without": ["neural ODE"]}
    runs = plan(settings, "obstacles")["open loop and runs"]
    assert [job.name for job in runs[6:]] == [f"runs/obstacles/trunk/SSMR/margin/{seed}-20ms" for seed in range(2)]
    assert "controller.margins=[1]" in runs[6].steps[0].overrides


def test_the_bench_is_between_plant_and_controller_but_no_model_knows_of_it():
    stages = plan(SETTINGS, "hardware")
    (data,), (model,), (run, _), _ = stages.values()
    for job in (data, run):
        assert {"plant=diamond", "plant.mesh='a b\\'s.vtu'", "rig=emulated_bench", "plant.stiffness_scale=0.9"} <= set(
            job.steps[0].overrides)
    train, export = model.steps
    assert {"plant=diamond", "plant.mesh='a b\\'s.vtu'", "robot=emulated_bench", "model=ssmr", "fit=stability_guard",
            "logger=csv", "name='SSMR'"} == set(train.overrides)
    assert export.files == {"checkpoint": "./model.ckpt", "artifact": "./artifact"}
    assert "noise_std=0.0" in run.steps[0].overrides and "controller.period=0.02" in run.steps[0].overrides


def test_all_is_every_figure_and_each_job_comes_after_what_it_needs():
    everything = flat(plan(SETTINGS))
    assert len(everything) == 2 + 4 + (1 + 6 + 6 + 2) + 1
    assert list(keys(everything, as_given)) == [job.name for job in everything]


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


def as_given(entry: str, overrides) -> str:
    """A configuration that is its overrides."""
    return f"{entry} {' '.join(overrides)}"


def test_a_key_changes_with_what_comes_before_and_with_nothing_else():
    before = keys(flat(plan(SETTINGS)), as_given)
    changed = deepcopy(SETTINGS)
    changed["robots"]["bench"]["train"]["SSMR"] = ["fit=least_squares"]
    after = keys(flat(plan(changed)), as_given)
    assert {name for name in before if before[name] != after[name]} == {
        "models/bench/SSMR", "runs/hardware/bench/SSMR/eight/0-20ms", "runs/hardware/bench/SSMR/eight/1-20ms"}
    letters = keys(flat(plan(SETTINGS, "letters")), as_given)
    assert {name: before[name] for name in letters} == letters


def test_a_key_changes_with_a_configuration_and_so_do_those_after_it():
    jobs = flat(plan(SETTINGS))
    before = keys(jobs, as_given)
    after = keys(jobs, lambda entry, overrides: as_given(entry, overrides) + "new" * ("robot=trunk" in overrides))
    assert {name for name in before if before[name] != after[name]} == {
        job.name for job in jobs if "trunk" in job.name and not job.name.startswith("data/")}


def test_a_job_before_what_it_needs_is_refused():
    job = Job("run", "run/metrics.json", (Step("control"),), ("model",))
    with pytest.raises(ValueError, match="run needs model, which is not planned before it"):
        keys([job], as_given)


def p99(stages: dict[str, list[Job]], times: dict[str, list[float]]) -> list[str]:
    runs = [job for job in stages["open loop and runs"] if "period" in job.about]
    known = {}
    for method, seconds in times.items():
        known |= dict(zip([job.name for job in runs if job.about["method"] == method], seconds))
    return [job.name for job in slower_runs(SETTINGS, runs, known)]


def test_a_method_that_does_not_hold_its_period_is_run_again_at_the_shortest_multiple_that_it_holds():
    stages = plan(SETTINGS, "letters")
    assert p99(stages, {"SSMR": [0.020, 0.020], "neural ODE": [0.041, 0.043], "DMD": [0.001, 0.002]}) == [
        "runs/letters/trunk/neural ODE/S/0-60ms", "runs/letters/trunk/neural ODE/O/0-60ms"]
    again = slower_runs(SETTINGS, stages["open loop and runs"], {"runs/letters/trunk/DMD/S/0-20ms": 0.03})
    assert again[0].about["period"] == pytest.approx(0.04) and "controller.period=0.04" in again[0].steps[0].overrides


def test_one_run_slowed_down_by_other_load_is_no_reason_to_run_again():
    assert not p99(plan(SETTINGS, "obstacles"), {"SSMR": [0.05, 0.001, 0.03]})


@pytest.mark.parametrize("text", ["plain", "a b", "it's", "a,b={c}", "back\\slash"])
def test_a_quoted_text_is_that_text_to_hydra(text):
    from hydra.core.override_parser.overrides_parser import OverridesParser

    assert OverridesParser.create().parse_override(f"key={quoted(text)}").value() == text
