"""The directory of a run is that of one command, until its process ends, however it ends."""

import subprocess
import sys

import pytest

from ssmr_torch.run_directory import DirectoryInUse, alone_in, lock, release

HOLDS = """
import sys, time
from ssmr_torch.run_directory import lock
print(lock(sys.argv[1], shared=sys.argv[2] == "shared"), flush=True)
time.sleep(60)
"""


@pytest.fixture
def other():
    """A process that has a directory."""
    processes = []

    def start(directory, how=""):
        process = subprocess.Popen([sys.executable, "-c", HOLDS, directory, how], stdout=subprocess.PIPE,
                                   stderr=subprocess.PIPE, text=True)
        processes.append(process)
        return process, process.stdout.readline().strip()

    yield start
    for process in processes:
        process.kill()
        process.communicate()
    release()


def test_a_second_command_is_refused_with_the_name_of_the_directory_until_the_first_was_killed(tmp_path, other):
    process, taken = other(tmp_path / "run")
    assert taken == "True"
    with pytest.raises(DirectoryInUse, match=f"{tmp_path / 'run'} is the directory of another command"):
        lock(tmp_path / "run")
    process.kill()
    process.communicate()
    assert lock(tmp_path / "run") and not list((tmp_path / "run").iterdir())


def test_the_processes_of_a_search_share_a_directory_and_leave_no_other_command_in(tmp_path, other):
    other(tmp_path, "shared")
    assert lock(tmp_path, shared=True)
    release(tmp_path)
    with pytest.raises(DirectoryInUse):
        lock(tmp_path)


def test_a_directory_is_taken_once_by_a_process_and_given_back_by_who_took_it(tmp_path, other):
    with alone_in(tmp_path):
        with alone_in(tmp_path):
            pass
        assert other(tmp_path)[1] == ""
    assert other(tmp_path)[1] == "True"


def test_what_a_killed_command_had_not_finished_is_removed(tmp_path):
    (tmp_path / ".model.ckpt.0123456789ab.part").write_bytes(b"half")
    (tmp_path / "model.ckpt").write_bytes(b"whole")
    (tmp_path / ".artifact.x0123456.part" / "new").mkdir(parents=True)
    with alone_in(tmp_path):
        assert [path.name for path in tmp_path.iterdir()] == ["model.ckpt"]


def test_further_processes_of_a_distributed_training_take_nothing(tmp_path, monkeypatch):
    monkeypatch.setenv("LOCAL_RANK", "1")
    assert not lock(tmp_path / "run") and not (tmp_path / "run").exists()


def test_a_file_locks_a_folder_that_the_file_system_cannot_lock(tmp_path, monkeypatch, other):
    import errno
    import fcntl
    import os
    import stat

    flock = fcntl.flock

    def as_on_nfs(handle, how):
        if stat.S_ISDIR(os.fstat(handle).st_mode):
            raise OSError(errno.EBADF, "bad file descriptor")
        flock(handle, how)

    monkeypatch.setattr(fcntl, "flock", as_on_nfs)
    with alone_in(tmp_path):
        assert (tmp_path / ".lock").exists()
