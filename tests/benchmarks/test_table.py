"""The command `ssmr benchmark`: its list, its refusals, and the table that it prints and keeps."""

import csv
import inspect
import json
import subprocess
import sys
from pathlib import Path

import pytest

from ssmr_torch.benchmarks import catalogue
from ssmr_torch.benchmarks.table import BenchmarkFailed, lines_of, tabulate
from ssmr_torch.lazy import found

SSMR = Path(sys.executable).with_name("ssmr")
ROOT = Path(__file__).resolve().parents[2]


def ssmr(*arguments, cwd):
    return subprocess.run([SSMR, "benchmark", *arguments], cwd=cwd, capture_output=True, text=True)


def test_without_a_name_the_command_lists_every_benchmark_with_a_sentence(tmp_path):
    done = ssmr(cwd=tmp_path)
    assert done.returncode == 0
    for name in catalogue.NAMES:
        [line] = [line for line in done.stdout.splitlines() if line.startswith(f"  {name} ")]
        assert line.endswith(".") and len(line.split()) > 6
    assert not (tmp_path / "outputs").exists()


def test_an_unknown_benchmark_is_refused_with_the_list_and_the_nearest_one(tmp_path):
    done = ssmr("stp", cwd=tmp_path)
    assert done.returncode == 1 and "no benchmark 'stp'; did you mean step?" in done.stderr
    assert ", ".join(catalogue.NAMES) in done.stderr


@pytest.mark.parametrize("name", catalogue.NAMES)
def test_every_benchmark_has_rows_whose_settings_the_command_knows(name):
    rows = found(f"ssmr_torch.benchmarks.{name}:rows")
    assert set(catalogue.settings_of(name)) == set(inspect.signature(rows).parameters)


def test_a_misspelled_setting_is_refused_before_any_work(tmp_path):
    done = ssmr("step", "lap=1", cwd=tmp_path)
    assert done.returncode == 1 and "lap is no setting of this command; did you mean laps?" in done.stderr


def test_the_command_prints_a_table_and_keeps_it_as_csv_and_json(tmp_path):
    done = ssmr("step", "horizons=[3]", "laps=0.7", "hydra.run.dir=out", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    machine, head, row, path = done.stdout.splitlines()
    assert "cores" in machine and "OMP_NUM_THREADS=1" in machine and "CPU median, ms" in head and row.split()[0] == "3"
    assert path.endswith("out/step.json")
    kept = json.loads((tmp_path / "out" / "step.json").read_text())
    assert kept["settings"] == {"horizons": [3], "laps": 0.7} and kept["rows"][0]["N"] == 3
    assert kept["failed"] is None and set(kept["load"]) == {"before", "after"}
    assert kept["provenance"]["configuration"]["laps"] == 0.7 and "numpy" in kept["machine"]["versions"]
    with open(tmp_path / "out" / "step.csv", newline="") as file:
        [stored] = csv.DictReader(file)
    assert stored["N"] == "3" and float(stored["RMSE, mm"]) == kept["rows"][0]["RMSE, mm"]


def test_what_was_measured_before_a_failure_is_kept_with_its_reason(tmp_path):
    def rows():
        yield {"steps": 10}
        yield "a remark"
        raise BenchmarkFailed("too slow by 3 ms")

    with pytest.raises(BenchmarkFailed, match="too slow by 3 ms"):
        tabulate("mine", rows(), {}, tmp_path, {}, say=lambda line: None)
    kept = json.loads((tmp_path / "mine.json").read_text())
    assert kept["rows"] == [{"steps": 10}] and kept["remarks"] == ["a remark"]
    assert kept["failed"] == "too slow by 3 ms"


def test_a_table_repeats_its_header_where_the_columns_change():
    first = {"N": 3, "ratio": 1.0}
    assert len(lines_of([first])) == 2 and len(lines_of([first, first])) == 1
    assert len(lines_of([first, {"size": "N = 3"}])) == 2


def test_make_benchmark_runs_benchmarks_that_exist():
    [line] = [line for line in (ROOT / "Makefile").read_text().splitlines() if "ssmr benchmark" in line]
    named = line.split(" in ")[1].split(";")[0].split()
    assert len(named) == 8 and set(named) <= set(catalogue.NAMES)
