"""A verdict follows from the numbers, and its sentence holds those that decided."""

import math

import pytest

from ssmr_torch.paper.published_numbers import FIGURES
from ssmr_torch.paper.verdicts import Results, Run, judge, loops, pareto_front, tally


def run(figure, method, ise, *, robot="trunk", task="ASL", seed=0, period=0.02, solve=1e-3, inside=0.0, depth=0.0,
        rmse=1e-4):
    return Run(figure, robot, method, task, seed, period, solve <= period, 1e-6 * ise, rmse, rmse, inside, depth,
               solve, solve, 0, "record.h5")


def scores(**errors):
    """Methods with errors in mm over 50 ms and 1 s; None where a rollout diverged."""
    return {name: {label: {"mean": None if value is None else 1e-3 * value, "starts": 500}
                   for label, value in zip(("50 ms", "1 s"), pair)} for name, pair in errors.items()}


def delays(own, reparametrized):
    return [{"delays": count, "reparametrized": new, "ratio": ratio, "error": 1.0} for new, ratios in
            ((False, own), (True, reparametrized)) for count, ratio in zip((4, 10, 20), ratios)]


def model(method, dimension, robot="trunk"):
    return {"robot": robot, "method": method, "state_dim": dimension}


@pytest.mark.parametrize(("dmd", "ssmr", "verdict"), [(0.2, 0.1, "better"), (1.0, 0.6, "reproduced"),
                                                      (0.05, 0.1, "refuted"), (0.5, None, "refuted")])
def test_the_diamonds_open_loop_is_judged_by_ssmr_and_sssr_below_dmd_and_edmd(dmd, ssmr, verdict):
    found = judge("fig4", Results(open_loop={"diamond": scores(SSMR=(ssmr, 1.0), SSSR=(0.08, 1.2), DMD=(dmd, 3.0),
                                                                EDMD=(None, None), TPWL=(0.01, 0.5))}))
    assert found.verdict == verdict and f"DMD {dmd:.3g} mm" in found.reason and "500 starts" in found.reason
    assert "EDMD ∞" in found.reason and "the best baseline (TPWL) 0.5 mm" in found.reason


def test_the_trunks_open_loop_is_refuted_by_tpwl_too():
    errors = {"SSMR": (0.3, 1.0), "SSSR": (0.5, 1.0), "DMD": (0.6, 1.0)}
    assert judge("fig5", Results(open_loop={"trunk": scores(**errors)})).verdict == "better"
    found = judge("fig5", Results(open_loop={"trunk": scores(**errors, TPWL=(0.2, 1.0))}))
    assert found.verdict == "refuted" and "SSMR (0.3 mm) is not below TPWL (0.2 mm)" in found.reason


def test_tracking_is_judged_by_the_mean_of_all_runs_and_tells_the_factor_to_the_best_baseline():
    runs = [run("fig7", "SSMR", 1.0), run("fig7", "SSMR", 3.0, seed=1), run("fig7", "SSSR", 5.0),
            run("fig7", "DMD", 6.0), run("fig7", "EDMD", 40.0), run("fig7", "control-augmented SSMR", 1.0)]
    found = judge("fig7", Results(runs))
    assert found.verdict == "better"  # ASL with 0.1 mm, published 0.55
    for text in ("1 of 1 tasks", "SSMR 2 mm²", "DMD 3 times", "SSSR 2.5 times", "n = 1 to 2 runs each",
                 "RMSE 0.1 mm (published about 0.55 mm)", "control-augmented SSMR 0.5 times"):
        assert text in found.reason
    worse = [run("fig7", "SSMR", 1.0, rmse=1e-3), run("fig7", "DMD", 2.0)]
    assert judge("fig7", Results(worse)).verdict == "reproduced"


def test_one_task_in_which_another_tracks_better_refutes_a_failed_run_does_too():
    good = [run("fig6", name, ise, robot="diamond", task="slow") for name, ise in (("SSMR", 1.0), ("DMD", 2.0))]
    bad = [run("fig6", name, ise, robot="diamond", task="fast") for name, ise in (("SSMR", 3.0), ("DMD", 2.0))]
    assert judge("fig6", Results(good)).verdict == "reproduced"
    found = judge("fig6", Results(good + bad))
    assert found.verdict == "refuted" and "1 of 2 tasks" in found.reason and "DMD 0.667 times" in found.reason
    assert judge("fig6", Results([*good, run("fig6", "SSMR", math.inf, robot="diamond", task="slow", seed=1)])
                 ).verdict == "refuted"


def test_a_method_that_the_paper_does_not_have_changes_no_verdict():
    runs = [run("fig7", "SSMR", 2.0), run("fig7", "DMD", 4.0), run("fig7", "neural ODE", 1.0)]
    found = judge("fig7", Results(runs))
    assert found.verdict == "better" and "neural ODE 0.5 times" in found.reason


def test_on_the_bench_both_ssmr_and_sssr_must_be_below_the_baselines():
    def bench(sssr):
        return [run("fig11", name, ise, robot="emulated_bench", task="circle") for name, ise in
                (("SSMR", 1.0), ("SSSR", sssr), ("static pregain", 3.0))]
    assert judge("fig11", Results(bench(2.0))).verdict == "reproduced"
    assert judge("fig11", Results(bench(4.0))).verdict == "refuted"


def test_in_simulation_methods_are_compared_at_the_period_of_ssmr_and_on_the_bench_at_one_that_each_holds():
    def twice(figure):
        return [run(figure, "SSMR", 1.0), run(figure, "TPWL", 2.0, solve=0.03),
                run(figure, "TPWL", 9.0, solve=0.03, period=0.04)]
    periods = {figure: loops(figure, twice(figure))["trunk", "ASL"]["TPWL"][0].period for figure in ("fig7", "fig11")}
    assert periods == {"fig7": 0.02, "fig11": 0.04}


def test_the_front_holds_what_no_other_beats_in_both():
    points = {"a": (1.0, 3.0), "b": (2.0, 2.0), "c": (2.0, 2.5), "d": (3.0, 1.0), "e": (0.5, math.inf)}
    assert pareto_front(points) == {"a", "b", "d"}


@pytest.mark.parametrize(("sssr", "verdict"), [(0.5e-3, "better"), (3e-3, "refuted")])
def test_ssmr_and_sssr_on_every_front_is_what_is_judged_of_accuracy_and_time(sssr, verdict):
    runs = [run("fig7", "SSMR", 1.0, solve=2e-3), run("fig7", "SSSR", 2.0, solve=sssr),
            run("fig7", "TPWL", 4.0, solve=0.03)]
    found = judge("fig8", Results(runs))
    assert found.verdict == verdict and "with TPWL" in found.reason and "2 ms (published about 8 ms)" in found.reason


def test_among_obstacles_error_time_inside_and_depth_must_all_be_lowest():
    def among(depth):
        return [run("fig9", "SSMR", 1.0, inside=0.01, depth=1e-4), run("fig9", "EDMD", 2.0, inside=0.02, depth=depth)]
    assert judge("fig9", Results(among(2e-4))).verdict == "reproduced"
    found = judge("fig9", Results(among(5e-5)))
    assert found.verdict == "refuted"
    assert "lowest in 2 of 3" in found.reason and "0.1 mm against 0.05 mm" in found.reason
    margin = run("fig9", "SSMR", 3.0, task="with a margin")
    found = judge("fig9", Results([*among(2e-4), margin]))
    assert found.verdict == "reproduced" and found.reason.endswith(
        "; with a margin, n = 1: ISE of SSMR 3 mm², time inside 0 %, depth 0 mm.")
    never = [run("fig12", "SSMR", 1.0), run("fig12", "TPWL", 2.0)]
    assert judge("fig12", Results(never)).verdict == "reproduced"


def test_delays_shrink_what_is_not_reparametrized():
    assert judge("fig3", Results(delays={"diamond": delays((95, 70, 40), (98, 97, 96))})).verdict == "reproduced"
    found = judge("fig3", Results(delays={"diamond": delays((95, 94, 93), (98, 90, 70))}))
    assert found.verdict == "refuted" and "from 95 to 93 %" in found.reason and "70 and 98 %" in found.reason


def test_the_dimension_is_judged_on_every_robot():
    trunk = [model("SSMR", 8), model("DMD", 45), model("static pregain", 6)]
    assert judge("table1", Results(models=trunk)).verdict == "reproduced"
    found = judge("table1", Results(models=[*trunk, model("SSMR", 12, "emulated_bench"),
                                            model("EDMD", 66, "emulated_bench"),
                                            model("static pregain", 6, "emulated_bench")]))
    assert found.verdict == "refuted" and "emulated_bench 12 against 6 of static pregain" in found.reason


@pytest.mark.parametrize("figure", ["fig6", "fig7", "fig8", "fig9", "fig11", "fig12"])
def test_ssmr_beside_sssr_alone_is_not_judged_as_a_baseline_is_missing(figure):
    verdict, reason = judge(figure, Results([run(figure, "SSMR", 1.0), run(figure, "SSSR", 2.0)]))
    assert verdict == "not judged" and "a baseline" in reason


@pytest.mark.parametrize("figure", FIGURES)
def test_without_data_nothing_is_judged_and_the_reason_names_what_is_missing(figure):
    verdict, reason = judge(figure, Results())
    assert verdict == "not judged" and ("missing" in reason or figure == "fig10")
    assert reason.count(". ") == 0 and reason.endswith(".")


def test_means_are_over_all_runs_and_loads_over_their_periods():
    found = tally([run("fig7", "SSMR", 1.0, solve=2e-3), run("fig7", "SSMR", 3.0, solve=4e-3, seed=1)])
    assert (found.n, found.ise) == (2, pytest.approx(2e-6)) and found.load == pytest.approx(0.15)
    with pytest.raises(ValueError, match="fig2"):
        judge("fig2", Results())
