"""Models of every kind at their best, on a robot that some of them know exactly."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

import ssmr_torch as ssmr

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture(scope="module")
def found(data, dmd):
    return ssmr.compare(data, {"mine": dmd, "DMD": "dmd", "bilinear": "edmd_bilinear"}, starts=100, progress=False)


def test_a_baseline_at_its_best_is_exact_where_the_robot_is_of_its_kind(found):
    scores = found.groups["test"]
    assert set(scores) == {"mine", "DMD", "bilinear", "persistence", "constant velocity"}
    assert scores["DMD"]["1 s"].mean < 1e-6 < scores["persistence"]["1 s"].mean
    assert found.diverged("DMD") == 0 and found.share_of_reach("DMD", "test") < 1e-4


def test_a_model_that_is_given_is_taken_as_it_is(found, dmd):
    assert found.models["mine"] is dmd and "mine" not in found.chosen


def test_what_was_chosen_is_told_in_words_and_the_table_has_a_row_a_model(found):
    text = repr(found)
    assert "DMD: a window of" in text and "reach" in text and "persistence" in text
    header, *rows = found.rows("test")
    assert header[:5] == ["model", "50 ms", "100 ms", "200 ms", "1 s"] and len(rows) == 5
    assert found.markdown.count("| DMD |") == len(found.groups)


def test_a_model_is_behind_where_the_paired_bootstrap_says_so(found):
    late = found.behind("mine")["test"]
    best = found.standing("DMD")["test"] | found.standing("bilinear")["test"]
    assert set(late) <= set(best)
    assert all(found.standing("mine")["test"][label] == "" for label in late)


def test_baselines_are_saved_and_loaded_as_any_model(found, data, tmp_path):
    again = ssmr.load(found.models["bilinear"].save(tmp_path / "bilinear"))
    table = ssmr.score([again], data, horizons=[0.2], starts=50)
    assert table["bilinear"]["200 ms"].mean < 1e-6 and again.card["cost"]["fit_time"] > 0


@pytest.mark.parametrize(("models", "options", "error", "message"), [
    (["dnd"], {}, ValueError, "no kind of model 'dnd'; did you mean 'dmd'"),
    ([3], {}, TypeError, "3 is not a model; expected a name of conf/model"),
    (["dmd"], {"scored": ["w"]}, ValueError, "w")])
def test_what_cannot_be_compared_is_refused_before_any_work(data, models, options, error, message):
    with pytest.raises(error, match=message):
        ssmr.compare(data, models, **options)


def test_data_without_test_runs_are_refused(data):
    from dataclasses import replace

    training = replace(data, trajectories=data.select("train"))
    with pytest.raises(ValueError, match="0 test runs and 3 controlled training runs"):
        ssmr.compare(training, ["dmd"])


@pytest.mark.slow
def test_the_command_writes_tables_a_figure_and_the_models(data, tmp_path):
    data.save(tmp_path / "data.h5")
    done = subprocess.run([sys.executable, ROOT / "experiments" / "compare.py", f"data.path={tmp_path / 'data.h5'}",
                           "models=[dmd]", "starts=50", f"hydra.run.dir={tmp_path / 'run'}"], check=True,
                          capture_output=True, text=True, env=os.environ | {"OMP_NUM_THREADS": "1"})
    assert "DMD: a window of" in done.stdout
    stored = json.loads((tmp_path / "run" / "comparison.json").read_text())
    assert stored["groups"]["test"]["DMD"]["horizons"][0]["label"] == "50 ms" and stored["reach"] > 0
    assert "| DMD |" in (tmp_path / "run" / "comparison.md").read_text()
    assert (tmp_path / "run" / "comparison.svg").is_file() and (tmp_path / "run" / "models" / "DMD").is_dir()
