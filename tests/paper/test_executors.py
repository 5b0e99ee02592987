"""What every executor promises: results and errors come back, and nothing is left when it is closed."""

import os
import time

import pytest

from ssmr_torch.configuration import built, composed

EXECUTORS = {"local": [], "joblib": [], "ray": [], "submitit": ["executor.cluster=local"]}
BROUGHT_BY = {"joblib": "joblib", "ray": "ray", "submitit": "submitit"}


@pytest.fixture(params=EXECUTORS)
def executor(request, tmp_path):
    name = request.param
    if name in BROUGHT_BY:
        pytest.importorskip(BROUGHT_BY[name])
    folder = [f"executor.folder={tmp_path}"] if name == "submitit" else []
    node = composed("reproduce", [f"executor={name}", "workers=2", *EXECUTORS[name], *folder]).executor
    with built(node) as made:
        yield made


@pytest.mark.slow
def test_results_come_from_another_process_and_workers_are_as_many_as_asked_for(executor):
    assert executor.workers == 2
    found = [executor.submit(divmod, 17 + each, 5) for each in range(3)]
    assert [each.result() for each in found] == [divmod(17 + each, 5) for each in range(3)]
    assert executor.submit(os.getpid).result() != os.getpid()


@pytest.mark.slow
def test_an_error_comes_back_and_the_next_job_is_done(executor):
    with pytest.raises(Exception, match="division|modulo|ZeroDivision"):
        executor.submit(divmod, 1, 0).result()
    assert executor.submit(divmod, 7, 5).result() == (1, 2)


@pytest.mark.slow
def test_a_process_that_dies_raises_and_the_next_job_is_done(executor):
    with pytest.raises(Exception, match=r".+"):
        executor.submit(os._exit, 3).result()
    assert executor.submit(divmod, 7, 5).result() == (1, 2)


@pytest.mark.slow
def test_leaving_it_ends_what_still_runs(executor):
    pid = executor.submit(os.getpid).result()
    executor.submit(time.sleep, 300)
    time.sleep(1)
    begun = time.monotonic()
    executor.__exit__()
    assert time.monotonic() - begun < 60
    until = time.monotonic() + 10
    while os.path.exists(f"/proc/{pid}") and time.monotonic() < until:
        time.sleep(0.1)
    assert not os.path.exists(f"/proc/{pid}")


def test_a_cluster_that_submitit_does_not_know_is_refused(tmp_path):
    pytest.importorskip("submitit")
    node = composed("reproduce", ["executor=submitit", "executor.cluster=moon", f"executor.folder={tmp_path}"]).executor
    with pytest.raises(Exception, match="executor.cluster is 'moon'; expected slurm or local"):
        built(node)
