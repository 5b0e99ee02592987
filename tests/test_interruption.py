"""A signal ends a command in order: one message, the status of a shell, and nothing that is half written."""

import os
import signal
import subprocess
import sys
import time

import pytest

WORK = """
import sys, time, weakref, signal
from ssmr_torch.interruption import END, Interrupted, ended_in_order
{before}
with ended_in_order("train"):
    END.limit = {limit}
    print("ready", flush=True)
    {work}
print("went on", flush=True)
"""
WAITS = "time.sleep(60)"
SWALLOWS = """
    try:
        time.sleep(60)
    except BaseException:
        print("caught", flush=True)
"""
CALLS_BACK = """
    import ctypes
    def waits():
        begun = time.monotonic()
        while time.monotonic() - begun < 1:
            time.sleep(0.01)
        return 0
    ctypes.CFUNCTYPE(ctypes.c_int)(waits)()
    time.sleep(60)
"""


def started(work, before="", limit=10.0):
    process = subprocess.Popen([sys.executable, "-c", WORK.format(work=work, before=before, limit=limit)], text=True,
                               stdout=subprocess.PIPE, stderr=subprocess.PIPE, start_new_session=True)
    assert process.stdout.readline() == "ready\n"
    return process


@pytest.mark.parametrize(("number", "name"), [(signal.SIGINT, "Ctrl-C"), (signal.SIGTERM, "SIGTERM"),
                                              (signal.SIGHUP, "SIGHUP")])
@pytest.mark.parametrize("work", [WAITS, SWALLOWS, CALLS_BACK], ids=["waits", "swallows", "in a callback"])
def test_a_signal_ends_a_command_with_its_status_and_one_message(number, name, work):
    process = started(work)
    process.send_signal(number)
    said, complained = process.communicate(timeout=20)
    assert process.returncode == 128 + number and "went on" not in said
    assert complained == f"train: ended by {name}; the same command starts again\n"


def test_a_signal_that_comes_twice_at_once_is_one():
    process = started("""
    try:
        print("in it", flush=True)
        time.sleep(60)
    finally:
        time.sleep(0.3)
        print("tidied", flush=True)
""")
    assert process.stdout.readline() == "in it\n"
    process.send_signal(signal.SIGTERM)
    time.sleep(0.1)
    process.send_signal(signal.SIGTERM)
    said, complained = process.communicate(timeout=20)
    assert "tidied" in said and process.returncode == 143 and complained.count("ended by") == 1


def test_an_end_that_takes_too_long_is_forced():
    process = started("""
    while True:
        try:
            time.sleep(60)
        except Interrupted:
            pass
""", limit=0.5)
    process.send_signal(signal.SIGTERM)
    begun = time.monotonic()
    _, complained = process.communicate(timeout=20)
    assert process.returncode == 143 and time.monotonic() - begun < 10 and "ended by SIGTERM" in complained


def test_a_signal_that_is_ignored_stays_so():
    process = started("time.sleep(0.5)", before="signal.signal(signal.SIGHUP, signal.SIG_IGN)")
    process.send_signal(signal.SIGHUP)
    said, complained = process.communicate(timeout=20)
    assert process.returncode == 0 and "went on" in said and complained == ""


def test_a_process_ends_with_the_one_that_it_belongs_to():
    code = """
import os, subprocess, sys, time
code = ("import os, time; from ssmr_torch.interruption import belong_to; belong_to(os.getppid()); "
        "print('ready', flush=True); time.sleep(60)")
child = subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE)
child.stdout.readline()
print(child.pid, flush=True)
time.sleep(60)
"""
    process = subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True)
    child = int(process.stdout.readline())
    process.kill()
    process.wait()
    process.stdout.close()
    deadline = time.monotonic() + 10
    while time.monotonic() < deadline and _lives(child):
        time.sleep(0.05)
    assert not _lives(child)


def _lives(number):
    try:
        with open(f"/proc/{number}/stat") as file:
            return file.read().rpartition(")")[2].split()[0] != "Z"
    except FileNotFoundError:
        return False


def test_handlers_are_as_before_when_the_command_has_ended():
    from ssmr_torch.interruption import Interrupted, ended_in_order

    before = [signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)]
    with pytest.raises(SystemExit) as ended, ended_in_order("train"), ended_in_order("inner"):
        os.kill(os.getpid(), signal.SIGTERM)
        time.sleep(1)
    assert ended.value.code == 143 and issubclass(Interrupted, KeyboardInterrupt)
    assert [signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)] == before


def test_a_program_that_goes_on_after_the_command_is_not_ended_and_a_hanging_end_is():
    code = """
import os, signal, sys, threading, time
from ssmr_torch.interruption import END, ended_in_order
try:
    with ended_in_order("train"):
        END.limit = 0.5
        os.kill(os.getpid(), signal.SIGTERM)
        time.sleep(1)
except SystemExit as end:
    status = end.code
if sys.argv[1] == "program":
    time.sleep(1.5)
    sys.exit(5)
threading.Thread(target=time.sleep, args=(60,)).start()
sys.exit(status)
"""
    for how, expected in (("program", 5), ("hangs", 143)):
        done = subprocess.run([sys.executable, "-c", code, how], capture_output=True, timeout=20)
        assert done.returncode == expected, done.stderr
