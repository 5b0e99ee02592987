"""Strangers, second robots, repeated requests, and robots that come back: whom the controller's end listens to."""

import logging

import numpy as np
import pytest
from wire.in_words import Echo, H, Talk

from ssmr_torch.closed_loop.wire_record import without_holes
from ssmr_torch.wire.controller_end import GIVES_WAY, ControllerEnd
from ssmr_torch.wire.messages import Code, Kind, Message


def request(hello, number):
    data = bytearray(hello)
    data[16:24] = number.to_bytes(8, "little")
    return bytes(data)


def test_an_end_from_another_connection_does_not_end_the_run(paced):
    goodbye = Message(Kind.END, paced.run).pack()
    assert paced.end.receive(b"stranger", goodbye, 0.5 * H) == [] and paced.end.running
    assert paced.end.counts == {"foreign": 1} and paced.end.finished == 0
    assert paced.end.receive(paced.peer, goodbye, 0.6 * H) == [] and not paced.end.running


def test_a_measurement_from_another_connection_is_dropped_while_the_robot_is_heard(paced, echo):
    data = Message(Kind.MEASUREMENT, paced.run, 1, 60.0, values=np.ones(2)).pack()
    assert paced.end.receive(b"stranger", data, 0.9 * H) == [] and len(echo.seen) == 1
    answer, = paced.measure(1, at=H)
    assert answer.status == Code.OK and paced.end.counts == {"foreign": 1}


def test_the_robot_may_go_on_over_a_new_connection_when_the_old_one_is_silent(paced):
    data = Message(Kind.MEASUREMENT, paced.run, 1, 50.01, values=np.ones(2)).pack()
    (peer, answer), = paced.end.receive(b"robot again", data, 1.6 * H)
    assert peer == b"robot again" and answer.kind is Kind.COMMAND


def test_numbers_of_runs_cannot_be_guessed_from_the_last_one(end, hello):
    runs = [Talk(end, request(hello(), k + 1), peer=bytes([k]), at=100.0 * k).run
            for k in range(20) if end.tick(100.0 * k) is not None]
    assert len(set(runs)) == 20 and len({later - run for run, later in zip(runs, runs[1:])}) > 15


def test_a_robot_that_does_not_begin_gives_way_to_another_one(end, hello):
    Talk(end, hello())
    for at, kind in ((1.0, Kind.REFUSE), (GIVES_WAY - 0.1, Kind.REFUSE), (GIVES_WAY, Kind.START)):
        (_, answer), = end.receive(b"second", hello(name="second"), at)
        assert answer.kind is kind
    assert end.description.name == "second" and end.counts == {"foreign": 2, "lost_robots": 1}


def test_a_robot_in_lock_step_that_was_killed_is_taken_again_before_patience_ends(end, hello):
    Talk(end, hello()).measure(0, at=0.0)
    for data, at, kind in ((hello(), 4.9, Kind.REFUSE), (hello(name="other"), 5.1, Kind.REFUSE),
                           (hello(), 5.2, Kind.START)):
        (_, answer), = end.receive(b"again", data, at)
        assert answer.kind is kind


def test_a_copy_of_the_hello_that_began_a_run_does_nothing(end, hello):
    data = request(hello(real_time=True), 77)
    talk = Talk(end, data)
    (_, start), = end.receive(talk.peer, data, 0.001)
    assert start.kind is Kind.START and start.sequence == 77 and start.run == talk.run
    talk.measure(0, at=0.0)
    for peer in (talk.peer, b"stranger"):
        assert end.receive(peer, data, H) == []
    answer, = talk.measure(1, at=H)
    assert answer.status == Code.OK and end.counts == {"repeated": 2}
    talk.tick(1.0)
    assert end.receive(b"stranger", data, 1.1) == [], "nor does it after the run"


def test_the_end_of_a_finished_run_is_repeated_where_it_was_lost(echo, hello):
    end = ControllerEnd(lambda robot: echo, duration=0.015)
    talk = Talk(end, hello())
    for k in range(2):
        talk.measure(k, at=0.0)
    first, = talk.measure(2, at=0.0)
    again, = talk.measure(2, at=0.5)
    assert first.kind is Kind.END and first.status == Code.OK and again.pack() == first.pack()
    assert end.counts == {"repeated": 1} and end.finished == 1


def silent(talk):
    """The robot is not heard any more; the messages that it gets."""
    return [message for k in range(1, 20) for message in talk.tick((k + 0.51) * H)]


def test_a_silent_robot_is_told_that_the_run_is_suspended_and_the_run_goes_on_with_it(paced, echo):
    goodbye = silent(paced)[-1]
    assert goodbye.kind is Kind.END and goodbye.status == Code.SUSPENDED and not paced.end.running
    assert paced.end.due() == np.inf and echo.resets == 2
    answer, = paced.measure(300, at=3.0)
    assert answer.kind is Kind.COMMAND and (answer.run, answer.sequence, answer.status) == (paced.run, 300, Code.OK)
    assert echo.seen[-1] == (3.0, (300.0, 300.0)) and paced.end.running
    assert paced.end.counts == {"missing": 299, "lost_robots": 1, "resumed": 1}
    assert [sample.time for sample in paced.end.samples][-1] == 3.0 and len(paced.end.samples) == 11


def test_old_messages_of_a_suspended_run_do_not_resume_it(paced):
    silent(paced)
    for number in (0, 3, 9):
        assert paced.measure(number, at=0.5) == []
    assert not paced.end.running


def test_a_suspended_run_is_over_when_patience_ends_or_another_robot_begins(paced, hello):
    silent(paced)
    goodbye, = paced.measure(1100, at=11.0)
    assert goodbye.kind is Kind.END and goodbye.status == Code.OTHER and not paced.end.running
    Talk(paced.end, hello(name="second"), peer=b"second", at=11.5)
    goodbye, = paced.measure(1200, at=12.0)
    assert goodbye.kind is Kind.END and paced.end.description.name == "second"


@pytest.mark.parametrize("stamped", [True, False], ids=["true stamps", "stamps of the numbers"])
@pytest.mark.parametrize("pause", [0.03, 0.09])
def test_a_robot_that_pauses_and_does_not_skip_numbers_is_answered_soon(end, hello, echo, stamped, pause):
    talk, at, unanswered = Talk(end, hello(real_time=True)), 0.0, []
    for k in range(60):
        at += H + (pause if k == 30 else 0.0)
        for tick in np.arange(at - pause, at, 1e-3):
            talk.tick(tick)
        answers = talk.measure(k, at=at, stamp=at if stamped else None)
        if [answer.status for answer in answers if answer.sequence == k] != [Code.OK]:
            unanswered.append(k)
    assert unanswered in ([], [30], [30, 31]) and len(unanswered) <= (0 if stamped else 2)
    assert echo.seen[-1][0] == pytest.approx(59 * H + pause, abs=1.01 * H), "time went on"


def test_of_many_measurements_that_wait_only_the_newest_is_used(paced, echo):
    waiting = [(paced.peer, Message(Kind.MEASUREMENT, paced.run, k, 50 + k * H, values=np.full(2, float(k))).pack())
               for k in range(1, 301)]
    (_, answer), = paced.end.receive_all(waiting, 3.0)
    assert (answer.sequence, answer.status) == (300, Code.OK) and len(echo.seen) == 2
    assert paced.end.counts == {"outdated": 299, "missing": 299}


def test_two_that_wait_are_both_used(paced, echo):
    waiting = [(paced.peer, Message(Kind.MEASUREMENT, paced.run, k, 50 + k * H, values=np.ones(2)).pack())
               for k in (1, 2)]
    assert [reply.message.sequence for reply in paced.end.receive_all(waiting, 2 * H)] == [1, 2]
    assert not paced.end.counts


def test_when_the_controller_itself_was_held_up_it_does_not_ask_for_each_sample_that_is_over(paced, echo):
    answer, = paced.tick(0.0951)
    assert (answer.sequence, answer.status) == (9, Code.MISSED) and len(echo.seen) == 2
    assert paced.end.counts == {"missing": 9}


@pytest.mark.parametrize("error", [ZeroDivisionError("0"), OverflowError("inf"), MemoryError(), KeyError("x")])
def test_whatever_fails_for_a_description_only_refuses_the_robot(hello, error):
    def build(robot):
        raise error

    (_, refusal), = ControllerEnd(build).receive(b"robot", hello(), 0.0)
    assert refusal.kind is Kind.REFUSE and type(error).__name__ in refusal.text


def test_two_thousand_refusals_leave_six_lines_in_the_log(hello, caplog):
    end = ControllerEnd(lambda robot: Echo())
    with caplog.at_level(logging.INFO):
        for _ in range(2000):
            end.receive(b"stranger", Message(Kind.HELLO, text="{}").pack(), 0.0)
            end.receive(b"stranger", b"garbage", 0.0)
    assert len(caplog.records) == 2 * 6 and end.counts == {"refused": 2000, "malformed": 2000}


def test_the_record_of_a_suspended_run_has_every_sample_of_it(paced, trial):
    silent(paced)
    for k in range(300, 320):
        paced.measure(k, at=k * H)
    filled = without_holes(paced.end)
    np.testing.assert_allclose([sample.time for sample in filled], H * np.arange(320))
    assert np.isnan(filled[200].observation).all() and filled[200].command.held
    np.testing.assert_array_equal(filled[200].command.input, [0.1, 0.0])
