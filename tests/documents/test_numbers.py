"""Numbers of the documentation: their stores, the blocks of the pages, and what stands outside of a block."""

import json
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from ssmr_torch import __version__
from ssmr_torch.closed_loop.record import ClosedLoopRecord
from ssmr_torch.documents import pages, results, store
from ssmr_torch.documents.stray_numbers import stray_numbers

ROOT = Path(__file__).resolve().parents[2]
TABLE = store.Numbers(command=["ssmr evaluate artifact=DIR"], version="1.2.0", date="2026-11-30", seed=3,
                      columns=["model", "1 s (mm)"], rows=[["SSMR", 0.123456], ["SSSR", None]])
PAGE = "# A page\n\n<!-- numbers: scores -->\nold\n<!-- end -->\n\nThe error is 0.123 mm.\n"


@pytest.fixture
def house(tmp_path):
    """A repository with one page and one table."""
    (tmp_path / "docs" / "numbers").mkdir(parents=True)
    store.write(tmp_path / "docs" / "numbers" / "scores.json", TABLE)
    (tmp_path / "README.md").write_text("# A robot\n")
    (tmp_path / "docs" / "page.md").write_text(PAGE)
    return tmp_path


def test_the_tables_of_the_documentation_equal_their_stores_and_no_measured_number_stands_outside():
    assert pages.faults(ROOT) == []


def test_the_readme_is_short():
    assert len((ROOT / "README.md").read_text().split()) <= 2500


def test_a_table_is_written_with_three_digits_and_says_which_command_measured_it_when(house):
    assert "docs/page.md: a block differs from its store; `ssmr docs-numbers` writes it" in pages.faults(house)
    assert pages.render_pages(house) == [house / "docs" / "page.md"]
    text = (house / "docs" / "page.md").read_text()
    assert "| SSMR | 0.123 |\n| SSSR | – |" in text
    assert "Measured by `ssmr evaluate artifact=DIR`: version 1.2.0, 2026-11-30, seed 3." in text
    assert pages.render_pages(house) == [] and pages.faults(house) == []


def test_a_changed_number_in_a_table_is_a_fault(house):
    pages.render_pages(house)
    page = house / "docs" / "page.md"
    page.write_text(page.read_text().replace("| 0.123 |", "| 0.122 |"))
    assert "docs/page.md: a block differs from its store; `ssmr docs-numbers` writes it" in pages.faults(house)


def test_numbers_that_were_carried_over_are_named_so():
    assert "not measured again since" in store.Numbers(["make run"], "1.0.0", "2026-11-30", carried=True, columns=["n"],
                                                       rows=[[1]]).caption


@pytest.mark.parametrize(("text", "fault"), [
    ("<!-- numbers: scores -->\n", "the block scores has no <!-- end -->"),
    ("<!-- numbers: other -->\n<!-- end -->", "the block other has no docs/numbers/other.json")])
def test_a_block_without_end_or_store_is_refused_and_no_page_is_changed(house, text, fault):
    (house / "README.md").write_text(text)
    with pytest.raises(ValueError, match=re.escape(fault)):
        pages.render_pages(house)
    assert (house / "docs" / "page.md").read_text() == PAGE


def test_a_store_that_no_page_shows_is_a_fault(house):
    (house / "docs" / "page.md").write_text("nothing")
    assert pages.faults(house) == ["docs/numbers/scores.json is shown on no page"]


@pytest.mark.parametrize(("change", "message"), [
    ({"command": []}, "expected a list of the commands"), ({"command": "make run"}, "expected a list of the commands"),
    ({"date": "yesterday"}, "YYYY-MM-DD"), ({"rows": [["SSMR"]]}, "has 1 cells; there are 2 columns"),
    ({"rows": None}, "got both or neither"), ({"unit": "mm"}, "unknown keys unit")])
def test_a_store_without_origin_or_with_a_broken_table_is_refused_by_name(house, change, message):
    path = house / "docs" / "numbers" / "scores.json"
    path.write_text(json.dumps(json.loads(path.read_text()) | change))
    with pytest.raises(ValueError, match=f"scores.json: .*{message}"):
        store.read_all(house)


def test_a_store_reads_back_as_it_was_written(house):
    assert store.read_all(house) == {"scores": TABLE.__class__(**(vars(TABLE) | {"rows": [["SSMR", 0.12346],
                                                                                          ["SSSR", None]]}))}


@pytest.mark.parametrize("text", [
    "The error is 0.27 mm.", "It takes 3 s.", "SSMR is 2.9 times better.", "13 % diverge.",
    "| a | b |\n| SSMR | 0.42 |"])
def test_a_measured_number_outside_of_a_block_is_found(text):
    assert len(stray_numbers(text, {})) == 1


@pytest.mark.parametrize("text", [
    "n = 6, version 0.9.0, Fig. 3, 2026", "```sh\nssmr collect  # 3 s\n```\n", "`rig.delay=0.02 s`",
    "    printed 0.27 mm\n", "$h = 3 s$", "[a link](page-3 s)",
    "<!-- numbers: a -->\n| error (mm) |\n| --- |\n| 0.27 |\n<!-- end -->\nAn error of 0.27 mm."])
def test_code_formulas_counts_and_numbers_of_a_block_of_the_page_are_no_faults(text):
    assert stray_numbers(text, {}) == []


def test_a_setting_is_allowed_by_name_and_what_is_allowed_in_vain_is_found():
    assert stray_numbers("Every 20 ms.", {"settings": ["20 ms"]}) == []
    assert stray_numbers("Every 20 ms.", {}, everywhere=["20 ms"]) == []
    assert stray_numbers("Always.", {"settings": ["20 ms"]}) == [
        "20 ms: named in docs/numbers/allowed.yaml, but not on the page"]
    assert len(stray_numbers("20 ms", {"settings": ["20 ms"], "paper": ["20 ms"]})) == 1


def test_an_unknown_kind_of_allowed_number_is_refused(house):
    (house / "docs" / "numbers" / "allowed.yaml").write_text("docs/page.md:\n  measured: [3 s]\n")
    with pytest.raises(ValueError, match="the kind measured; the kinds are settings, definitions, paper, tested"):
        pages.faults(house)


ORIGIN = {"package": "ssmr_torch 1.3.0", "time": "2026-12-01T10:00:00+00:00", "configuration": {"seed": 4}}


def part(label, mean, diverged=0.0):
    return {"label": label, "mean": mean, "diverged": diverged}


def save(path, content):
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(content | {"provenance": ORIGIN}))


def test_scores_become_a_table_in_mm_with_the_share_that_diverged(house, tmp_path):
    scores = {"SSMR": {"horizons": [part("1 s", 0.002)]}, "EDMD": {"horizons": [part("1 s", None, 0.25)]}}
    save(tmp_path / "run" / "scores.json", {"scores": scores, "groups": {}})
    path = results.store_results(house, tmp_path / "run", "scores", None, [])
    found = store.read(path)
    assert found.columns == ["model", "1 s (mm)"] and found.rows == [["SSMR", 2.0], ["EDMD", "∞ (25 %)"]]
    assert (found.command, found.version, found.date, found.seed) == (TABLE.command, "1.3.0", "2026-12-01", 4)


def test_a_comparison_becomes_a_table_with_marks_for_each_group(tmp_path):
    scores = {"AUTO": {"horizons": [part("1 s", 0.002), part("full", 1.0)], "marks": {"1 s": "*"}},
              "DMD": {"horizons": [part("1 s", 0.004), part("full", 1.0)], "marks": {"1 s": ""}}}
    save(tmp_path / "comparison.json", {"groups": {"fast-test": scores, "decays": scores}, "reach": 0.04,
                                        "cpu": {"AUTO": 20.4, "DMD": None}})
    found = results.tables_of(tmp_path)
    assert list(found) == ["fast-test", "decays", "summary"]
    assert found["summary"].columns == ["test runs", "AUTO, 1 s (mm)", "best other, 1 s (mm)"]
    assert found["summary"].rows[0] == ["fast-test", "2 *", "4 DMD"]
    assert found["decays"].columns == ["model", "1 s (mm)", "diverged (%)", "of reach, 1 s (%)", "fit (CPU, s)"]
    assert found["decays"].rows == [["AUTO", "2 *", 0.0, 5.0, 20], ["DMD", "4", 0.0, 10.0, None]]


def test_the_report_of_a_choice_becomes_a_printed_text(house, tmp_path):
    save(tmp_path / "run" / "report.json", {"selection": {"found": ["Chosen: one.", "Refused: another."]}})
    path = results.store_results(house, tmp_path / "run", "report", None, ["ssmr train model=auto"])
    assert store.read(path).markdown().startswith("    Chosen: one.\n    Refused: another.\n\n*Measured by `ssmr train")


def test_an_infinite_error_is_stored_as_a_sign_that_json_has(house):
    path = house / "docs" / "numbers" / "scores.json"
    store.write(path, store.Numbers(["make run"], "1.0.0", "2026-11-30", columns=["n"], rows=[[np.inf], [0.1234567]]))
    assert "Infinity" not in path.read_text() and store.read(path).rows == [["∞"], [0.12346]]


def test_of_several_tables_one_is_chosen_by_name(house, tmp_path):
    scores = {"SSMR": {"horizons": [part("1 s", 0.002)]}}
    save(tmp_path / "run" / "scores.json", {"scores": scores, "groups": {"decays": scores}})
    with pytest.raises(ValueError, match="has the tables all, decays; choose one: table=NAME"):
        results.store_results(house, tmp_path / "run", "scores", None, [])
    assert results.store_results(house, tmp_path / "run", "scores", "decays", []).is_file()


def record(path, error, count=400):
    """A closed loop whose output is `error` m beside its reference."""
    path.mkdir(parents=True, exist_ok=True)
    reference, zeros = np.zeros((count, 1)), np.zeros(count, dtype=bool)
    ClosedLoopRecord(
        time=0.01 * np.arange(count), observation=reference + error, measurement=reference + error,
        input=np.zeros((count, 1)), reference=reference, solve_time=np.full(count, 1e-4), fallback=zeros,
        iterations=np.ones(count, dtype=int), statuses=("SOLVED",) * count, tracked=(0,), output_names=("x",),
        input_names=("u",), provenance=ORIGIN | {"model": "SSMR", "task": "circle", "period": 0.01},
    ).save(path / "record.h5")


def test_closed_loops_of_a_multirun_become_one_row_each(tmp_path):
    record(tmp_path / "0", 0.001)
    record(tmp_path / "1", 0.002)
    rows = results.tables_of(tmp_path)["loops"].rows
    assert [row[0] for row in rows] == ["SSMR", "SSMR"]
    assert [row[2] for row in rows] == pytest.approx([1.0, 2.0])


def test_a_run_of_make_becomes_one_row_for_each_model_with_its_letter(tmp_path):
    scores = {"SSMR": {"horizons": [part("1 s", 0.002)]}, "persistence": {"horizons": [part("1 s", 0.02)]}}
    save(tmp_path / "evaluate" / "scores.json", {"scores": scores, "groups": {}})
    record(tmp_path / "control" / "0", 0.001)
    found = results.tables_of(tmp_path)["run"]
    assert found.columns == ["model", "1 s (mm)", "letter, RMSE (mm)", "letter, ISE (mm²)"]
    assert found.rows[0][:3] == ["SSMR", 2.0, pytest.approx(1.0)] and found.rows[1] == ["persistence", 20.0, None, None]


def test_a_benchmark_becomes_its_rows(tmp_path):
    save(tmp_path / "step.json", {"rows": [{"N": 5, "median": 0.1}, {"N": 10, "failed": 1}]})
    assert results.tables_of(tmp_path)["step"][:2] == (["N", "median", "failed"], [[5, 0.1, None], [10, None, 1]])


def test_the_reproduction_becomes_a_row_for_each_task_and_for_each_horizon(tmp_path):
    lines = ["robot,method,task,period,ise,violation_ratio,max_violation,solve_p99,record",
             "trunk,SSMR,ASL,0.02,2e-6,0,0,1e-4,runs/0/record.h5", "trunk,SSMR,ASL,0.02,4e-6,0,0,1e-4,",
             "trunk,TPWL,ASL,0.02,9e-6,0,0,0.04,", "trunk,TPWL,ASL,0.06,5e-6,0,0,0.04,"]
    (tmp_path / "runs.csv").write_text("\n".join(lines))
    record(tmp_path / "runs" / "0", 0.001)
    save(tmp_path / "open_loop" / "trunk.json", {"scores": {"SSMR": {"horizons": [part("1 s", 0.002)]}}})
    found = results.tables_of(tmp_path)
    assert found["ise"].columns == ["robot: task", "SSMR", "TPWL"]
    assert found["ise"].rows[0] == ["trunk: ASL", pytest.approx(3.0), pytest.approx(9.0)]
    assert found["computing_time"].rows[0][1:] == pytest.approx([0.005, 2.0])
    assert found["open_loop"][:2] == (["robot, horizon", "SSMR"], [["trunk, 1 s", 2.0]])


def test_a_directory_without_results_and_new_numbers_without_a_command_are_refused(house, tmp_path):
    with pytest.raises(ValueError, match="has no results: expected the directory of make run"):
        results.tables_of(tmp_path)
    save(tmp_path / "run" / "scores.json", {"scores": {"SSMR": {"horizons": [part("1 s", 0.002)]}}, "groups": {}})
    with pytest.raises(ValueError, match="new.json is new: which commands made"):
        results.store_results(house, tmp_path / "run", "new", None, [])


def test_a_script_stores_its_tables_with_the_version_of_today(house):
    results.store_tables(house, {"scores": (["n"], [[1]])}, "python docs/tutorials/one.py")
    found = store.read_all(house)["scores"]
    assert found.version == __version__ and found.rows == [[1]] and not found.carried


def test_the_command_checks_the_documentation_and_says_where_it_must_be_started(tmp_path):
    ssmr = Path(sys.executable).with_name("ssmr")
    done = subprocess.run([ssmr, "docs-numbers", "check=true"], cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 0 and "every table equals its store" in done.stdout, done.stderr
    done = subprocess.run([ssmr, "docs-numbers", "check=true"], cwd=tmp_path, capture_output=True, text=True)
    assert done.returncode == 1 and "start the command in the folder that holds README.md" in done.stderr
    assert list(tmp_path.iterdir()) == []
