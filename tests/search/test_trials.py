"""A search by Optuna goes on where it was, after an end, after a kill, and beside another process."""

import subprocess
import sys
import textwrap
import time
from functools import partial

import pytest

optuna = pytest.importorskip("optuna", reason="needs pip install 'ssmr_torch[search]'")

from optuna.samplers import TPESampler  # noqa: E402
from optuna.trial import TrialState  # noqa: E402

from ssmr_torch.search.space import overrides_of, space_of  # noqa: E402
from ssmr_torch.search.trials import CPU, Search  # noqa: E402

SPACE = ["x=interval(-2.0, 3.0)", "n=range(1, 6)", "kind=choice(a, b)", "model=ssmr"]


def search(directory, arguments=SPACE, **options):
    return Search(directory, arguments, **{"direction": "minimize", "sampler": partial(TPESampler, seed=0)} | options)


def values(overrides):
    return dict(each.split("=") for each in overrides)


def bowl(seen):
    """A job that keeps what it was asked, with the least score at x = 1, n = 2."""
    def job(number, overrides):
        given = values(overrides)
        seen.append(given)
        return (float(given["x"]) - 1) ** 2 + (int(given["n"]) - 2) ** 2

    return job


def test_ranges_are_those_of_hydra():
    space, fixed = space_of(["a=range(1, 6)", "b=range(0.0, 1.0, 0.25)", "c=tag(log, interval(1e-3, 1.0))",
                             "d=choice(x, y)", "e=1,2", "f=interval(1.0, 2.0)", "f=3", "~g", "model=ssmr"])
    assert (space["a"].low, space["a"].high) == (1, 5)
    assert (space["b"].low, space["b"].high, space["b"].step) == (0.0, 0.75, 0.25)
    assert space["c"].log and space["d"].choices == ("x", "y") and space["e"].choices == (1, 2)
    assert list(fixed.values()) == ["f=3", "~g", "model=ssmr"] and set(space) == set("abcde")
    assert overrides_of({"d": None, "e": True}, {}) == ["d=null", "e=true"]


def test_a_search_finds_the_least_score_and_tries_nothing_more_than_it_was_asked_to(tmp_path):
    seen = []
    search(tmp_path).run(bowl(seen), trials=40)
    assert len(seen) == 40 and all(given["model"] == "ssmr" and 1 <= int(given["n"]) <= 5 for given in seen)
    assert search(tmp_path).study.best_value < 0.1
    search(tmp_path).run(bowl(seen), trials=40)
    assert len(seen) == 40


def test_interrupted_and_resumed_a_search_tries_what_it_would_have_tried_at_once(tmp_path):
    whole, parts = [], []
    search(tmp_path / "whole").run(bowl(whole), trials=20)

    def interrupted(number, overrides):
        if len(parts) == 13:
            raise KeyboardInterrupt
        return bowl(parts)(number, overrides)

    search(tmp_path / "parts").run(bowl(parts), trials=5)
    with pytest.raises(KeyboardInterrupt):
        search(tmp_path / "parts").run(interrupted, trials=20)
    search(tmp_path / "parts").run(bowl(parts), trials=20)
    assert parts == whole


KILLED = """
import sys, time
from functools import partial
from optuna.samplers import TPESampler
from ssmr_torch.search.trials import Search

def job(number, overrides):
    given = dict(each.split("=") for each in overrides)
    print(given, flush=True)
    if number == int(sys.argv[2]):
        time.sleep(60)
    return (float(given["x"]) - 1) ** 2 + (int(given["n"]) - 2) ** 2

Search(sys.argv[1], ["x=interval(-2.0, 3.0)", "n=range(1, 6)", "kind=choice(a, b)", "model=ssmr"],
       direction="minimize", sampler=partial(TPESampler, seed=0)).run(job, trials=int(sys.argv[3]))
"""


def started(directory, sleeping: int, trials: int):
    return subprocess.Popen([sys.executable, "-c", textwrap.dedent(KILLED), str(directory), str(sleeping), str(trials)],
                            stdout=subprocess.PIPE, text=True)


def wait_for_running(directory, number: int):
    until = time.monotonic() + 60
    while time.monotonic() < until:
        if (directory / "search.journal").exists():
            running = [trial.number for trial in search(directory).study.get_trials(False, (TrialState.RUNNING,))]
            if running == [number]:
                return
        time.sleep(0.1)
    raise AssertionError("the trial did not begin")


def test_the_trial_of_a_killed_process_is_tried_again_and_no_trial_stays_running(tmp_path):
    whole, again = [], []
    search(tmp_path / "whole").run(bowl(whole), trials=8)
    process = started(tmp_path / "killed", 3, 8)
    wait_for_running(tmp_path / "killed", 3)
    process.kill()
    process.communicate()
    search(tmp_path / "killed").run(bowl(again), trials=8)
    trials = search(tmp_path / "killed").study.get_trials(False)
    states = [trial.state.name for trial in trials]
    assert states == [*["COMPLETE"] * 3, "FAIL", *["COMPLETE"] * 5] and trials[4].user_attrs["again"] == 3
    assert again == whole[3:] and not list((tmp_path / "killed" / "workers").iterdir())


def test_another_process_shares_the_work_and_leaves_a_living_trial_alone(tmp_path):
    process = started(tmp_path, 0, 4)
    wait_for_running(tmp_path, 0)
    shared = []
    search(tmp_path).run(bowl(shared), trials=3)
    states = [trial.state for trial in search(tmp_path).study.get_trials(False)]
    process.kill()
    process.communicate()
    assert states == [TrialState.RUNNING, *[TrialState.COMPLETE] * 3] and len(shared) == 3


def test_other_arguments_are_refused_and_where_to_save_is_none_of_them(tmp_path):
    search(tmp_path)
    search(tmp_path, [*SPACE, "save_to=x.yaml"])
    with pytest.raises(SystemExit, match=r"was begun with \['model=ssmr'\], now it is \['model=edmd'\]"):
        search(tmp_path, [*SPACE[:-1], "model=edmd"])


def test_a_search_of_an_earlier_version_is_refused(tmp_path):
    (tmp_path / "study.db").touch()
    with pytest.raises(SystemExit, match="of version 0.10 or older"):
        search(tmp_path)


def test_minutes_are_those_of_the_cpu_and_no_trial_begins_after_them(tmp_path, capsys):
    def busy(number, overrides):
        until = time.process_time() + 0.1
        while time.process_time() < until:
            pass
        return 1.0

    search(tmp_path).run(busy, trials=9, minutes=0.15 / 60)
    finished = search(tmp_path).finished()
    assert len(finished) == 2 and all(0.08 <= trial.user_attrs[CPU] < 1 for trial in finished)
    assert "CPU minutes are over after 2 trials" in capsys.readouterr().out


def test_a_score_that_is_not_a_number_is_the_worst_and_an_error_ends_the_search(tmp_path):
    search(tmp_path / "nan").run(lambda number, overrides: float("nan"), trials=1)
    assert search(tmp_path / "nan").study.best_value == float("inf")

    def broken(number, overrides):
        raise RuntimeError("no such key")

    with pytest.raises(RuntimeError, match="no such key"):
        search(tmp_path / "broken").run(broken, trials=1)
    assert search(tmp_path / "broken").study.get_trials(False)[0].state is TrialState.FAIL


@pytest.mark.parametrize("end", [KeyboardInterrupt, SystemExit, OSError])
def test_an_interrupted_trial_is_told_as_failed_at_once_and_the_best_one_is_said(tmp_path, capsys, end):
    seen = []

    def interrupted(number, overrides):
        if len(seen) == 3:
            raise end
        return bowl(seen)(number, overrides)

    with pytest.raises(end):
        search(tmp_path).run(interrupted, trials=9)
    states = [trial.state for trial in search(tmp_path).study.get_trials(False)]
    assert states == [*3 * [TrialState.COMPLETE], TrialState.FAIL, TrialState.WAITING]
    assert "the best of 3 finished trials is number" in capsys.readouterr().out


def test_a_journal_that_a_full_disk_has_cut_is_mended(tmp_path):
    seen, journal = [], tmp_path / "search.journal"
    search(tmp_path).run(bowl(seen), trials=3)
    whole = journal.read_bytes()
    journal.write_bytes(whole + b'{"op_code": 4, "worker_id"')
    search(tmp_path).run(bowl(seen), trials=4)
    assert journal.read_bytes().startswith(whole) and len(seen) == 4


def test_the_lock_of_a_killed_process_does_not_keep_the_next_one_waiting(tmp_path):
    search(tmp_path).run(bowl([]), trials=1)
    (tmp_path / "search.journal.lock").unlink()
    (tmp_path / "search.journal.lock").symlink_to(tmp_path / "search.journal")  # as version 0.11 has left it
    begun = time.monotonic()
    search(tmp_path).run(bowl([]), trials=2)
    assert time.monotonic() - begun < 10
