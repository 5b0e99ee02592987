"""What the robot's end never applies: old commands, those beyond its bounds, and those of somebody else."""

import logging
import os
import signal
import threading
import time

import numpy as np
import pytest
from wire.test_robot_end import RUN, SAFE, H, command, controller

from ssmr_torch.wire.messages import Code, Kind, Message
from ssmr_torch.wire.robot_end import RobotEnd
from ssmr_torch.wire.stopping import ended_by_signals


def paused_once(link, integrator, seconds, at):
    """The robot's process stands still for so long while it waits for the answer to measurement `at`."""
    receive, done = link.receive, []

    def slow(timeout):
        sent = link.of_kind(Kind.MEASUREMENT)
        if sent and sent[-1].sequence == at and not done:
            done.append(True)
            link.clock.now += seconds
        return receive(timeout)

    link.receive = slow


@pytest.mark.parametrize("seconds", [0.015, 0.03, 0.3, 3.0])
def test_after_a_pause_no_command_from_before_it_is_applied(fake_robot, integrator, seconds):
    def say(message):
        return [(1e-3, command(message, [0.1 + 1e-3 * (message.sequence % 800), 0.5]))]

    robot, link = fake_robot(controller(last=330, say=say), integrator, real_time=True)
    applied, step = [], integrator.step
    integrator.step = lambda u: (applied.append((link.clock.now, tuple(u))), step(u))[1]
    paused_once(link, integrator, seconds, at=4)
    robot.drive()
    begun = link.of_kind(Kind.MEASUREMENT)[0].time
    woken = begun + 4 * H + seconds
    for when, u in applied:
        if u != tuple(SAFE) and when > begun:
            number = round((u[0] - 0.1) / 1e-3)
            assert when - begun - number * H <= (H if when > woken + 2 * H else 0.2 + 2 * H)
    first = next(u for when, u in applied if when >= woken)
    assert (first == tuple(SAFE)) == (seconds > 0.2), "its first action is the safe input"
    assert robot.counts["overruns"] == 1 and robot.counts["lost_controllers"] == (seconds > 0.2)
    resumed = next(when for when, u in applied if when >= woken and u[0] - 0.1 >= 1e-3 * (4 + seconds / H))
    assert resumed - woken <= 3 * H


def test_the_safe_input_comes_within_a_timestep_of_the_timeout_and_the_run_goes_on(fake_robot, integrator):
    def say(message):
        return [] if 10 <= message.sequence < 60 else [(1e-3, command(message))]

    robot, link = fake_robot(controller(last=80, say=say), integrator, real_time=True, timeout=0.1)
    applied, step = [], integrator.step
    integrator.step = lambda u: (applied.append((link.clock.now, tuple(u))), step(u))[1]
    robot.drive()
    begun = link.of_kind(Kind.MEASUREMENT)[0].time
    safe = [when - begun for when, u in applied if u == tuple(SAFE) and begun < when < begun + 0.79]
    heard = 9 * H + 1e-3
    assert heard + 0.1 < safe[0] <= heard + 0.1 + H and safe[-1] == pytest.approx(59.5 * H) and len(safe) == 41
    assert len(link.of_kind(Kind.HELLO)) == 1 and robot.counts == {"missed": 10, "lost_controllers": 1}


@pytest.mark.parametrize("values", [[0.4, 1.5], [0.0, 0.5], [np.inf, 0.5], [1e300, 0.5], [0.4, -1e-3]])
def test_a_command_beyond_the_bounds_is_dropped(fake_robot, integrator, values):
    robot, _ = fake_robot(controller(say=lambda m: [(1e-3, command(m, values))]), integrator, real_time=True)
    robot.drive()
    assert robot.counts["malformed"] == 5 and {tuple(u) for u in integrator.applied} == {tuple(SAFE)}


def test_an_input_beyond_a_bound_by_rounding_is_clipped(fake_robot, integrator):
    robot, _ = fake_robot(controller(say=lambda m: [(1e-3, command(m, [0.1 - 1e-9, 1 + 1e-9]))]), integrator)
    robot.drive()
    assert tuple(integrator.applied[-2]) == (0.1, 1.0) and not robot.counts


def test_a_start_of_an_earlier_request_or_run_begins_nothing(fake_robot, integrator):
    strays = [Message(Kind.START, RUN + 1, 5, text="{}"), Message(Kind.START, RUN, text="{}")]
    robot, link = fake_robot(controller(say=lambda m: [(5e-4, strays[0]), (6e-4, strays[1]), (1e-3, command(m))]),
                             integrator)
    link.answer = lambda message, usual=link.answer: [
        (delay, Message(Kind.START, RUN, message.sequence, text="{}")) if reply.kind is Kind.START and
        message.kind is Kind.HELLO else (delay, reply) for delay, reply in usual(message)]
    robot.drive()
    assert {message.run for message in link.of_kind(Kind.MEASUREMENT)} == {RUN} and robot.counts == {"repeated": 5}


def test_a_refusal_of_an_earlier_request_is_not_believed(fake_robot, integrator):
    usual = controller()

    def answer(message):
        more = [(5e-4, Message(Kind.REFUSE, sequence=5, text="no"))] if message.kind is Kind.HELLO else []
        return more + usual(message)

    fake_robot(answer, integrator)[0].drive()
    assert integrator.applied


def test_a_suspended_run_leaves_the_robot_at_its_safe_input_until_the_next_command(fake_robot, integrator):
    def say(message):
        if message.sequence == 3:
            return [(1e-3, Message(Kind.END, RUN, 4, status=Code.SUSPENDED))]
        old = [(2e-3, Message(Kind.END, RUN, 2, status=Code.SUSPENDED))] if message.sequence == 5 else []
        return [(1e-3, command(message)), *old]

    robot, link = fake_robot(controller(last=8, say=say), integrator, real_time=True)
    robot.drive()
    assert [tuple(u) == tuple(SAFE) for u in integrator.applied[-9:]] == [False] * 3 + [True] + [False] * 4 + [True]
    assert len(link.of_kind(Kind.HELLO)) == 1 and robot.counts["lost_controllers"] == 1


def test_when_patience_ends_the_robot_looks_for_a_controller_again(fake_robot, integrator):
    robot, link = fake_robot(controller(say=lambda m: [(1e-3, command(m))] if m.sequence < 3 else []), integrator,
                             real_time=True, patience=2.0)
    link.answer = lambda message, usual=link.answer: [] if len(link.of_kind(Kind.HELLO)) > 1 else (
        [] if message.sequence >= 3 and message.kind is Kind.MEASUREMENT else usual(message))
    with pytest.raises(TimeoutError, match="check the address and the key"):
        robot.drive(wait=1.0)
    last = link.of_kind(Kind.MEASUREMENT)[-1]
    assert last.sequence == pytest.approx(202, abs=1) and robot.counts["lost_controllers"] == 1


def test_garbage_leaves_a_short_log(fake_robot, integrator, caplog):
    answers = controller(last=50, say=lambda m: [(1e-4, b"garbage")] * 20 + [(1e-3, command(m))])
    robot, _ = fake_robot(answers, integrator)
    with caplog.at_level(logging.INFO):
        robot.drive()
    assert robot.counts == {"malformed": 1000} and len(caplog.records) < 10


def test_a_description_that_does_not_fit_into_a_hello_is_refused_at_once(integrator):
    integrator.output_names = tuple(f"{k:04d}" + "n" * 90 for k in range(700))
    integrator.rest = np.zeros(700)
    with pytest.raises(ValueError, match="expected 65536 at most: observe fewer outputs"):
        RobotEnd(integrator, None)


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGHUP, signal.SIGINT])
def test_a_signal_lets_the_robot_apply_its_safe_input_and_say_goodbye(fake_robot, integrator, number):
    def say(message):
        if message.sequence == 3:
            os.kill(os.getpid(), number)
        return [(1e-3, command(message))]

    robot, link = fake_robot(controller(say=say), integrator)
    with pytest.raises(KeyboardInterrupt if number == signal.SIGINT else SystemExit) as ended:
        robot.drive()
    assert number == signal.SIGINT or ended.value.code == 128 + number
    goodbye, = link.of_kind(Kind.END)
    assert goodbye.status == Code.OTHER and tuple(integrator.applied[-1]) == tuple(SAFE)
    assert signal.getsignal(number) in (signal.SIG_DFL, signal.default_int_handler)


def test_a_second_signal_does_not_interrupt_the_goodbye():
    said = []
    with pytest.raises(SystemExit), ended_by_signals():
        try:
            os.kill(os.getpid(), signal.SIGTERM)
            time.sleep(1.0)
        finally:
            os.kill(os.getpid(), signal.SIGTERM)
            os.kill(os.getpid(), signal.SIGINT)
            time.sleep(0.01)
            said.append("goodbye")
    assert said == ["goodbye"]


def test_signals_of_somebody_else_and_of_other_threads_are_left_alone():
    mine, seen = lambda *_: None, []
    before = signal.signal(signal.SIGTERM, mine)
    try:
        with ended_by_signals():
            assert signal.getsignal(signal.SIGTERM) is mine

        def elsewhere():
            with ended_by_signals():
                seen.append(signal.getsignal(signal.SIGHUP))

        thread = threading.Thread(target=elsewhere)
        thread.start()
        thread.join()
    finally:
        signal.signal(signal.SIGTERM, before)
    assert seen == [signal.SIG_DFL]
