"""What the controller's end does with messages that are late, repeated, reordered, missing or malformed."""

import numpy as np
import pytest
from wire.in_words import Echo, H, Talk

from ssmr_torch.control.base import Command
from ssmr_torch.status import Status
from ssmr_torch.wire.controller_end import ControllerEnd, code_of
from ssmr_torch.wire.messages import Code, Kind, Message, RobotDescription, unpack


def test_a_measurement_is_answered_with_the_input_of_its_number(paced, echo):
    answer, = paced.measure(1, at=H)
    assert (answer.kind, answer.sequence, answer.run, answer.status) == (Kind.COMMAND, 1, paced.run, Code.OK)
    np.testing.assert_array_equal(answer.values, [1.0, 1.0])
    assert echo.seen == [(0.0, (0.0, 0.0)), (H, (1.0, 1.0))] and answer.time >= 0 and not paced.end.counts


def test_only_differences_of_time_stamps_matter(end, hello, echo):
    talk = Talk(end, hello(real_time=True))
    for k in range(3):
        talk.measure(k, at=1e6 + k * H, stamp=-1e3 + k * H)
    assert [time for time, _ in echo.seen] == [0.0, 0.01, 0.02] and not end.counts


def test_a_time_stamp_off_by_more_than_half_a_timestep_is_counted_and_used(paced, echo):
    paced.measure(1, at=H, stamp=50.0 + 1.6 * H)
    assert paced.end.counts == {"irregular": 1} and echo.seen[-1] == (H, (1.0, 1.0))


def test_nothing_is_missing_before_its_deadline(paced):
    assert paced.end.due() == pytest.approx(1.5 * H)
    assert paced.tick(1.49 * H) == [] and not paced.end.counts


def test_a_missing_measurement_is_answered_at_the_deadline_as_a_blind_controller_would(paced, echo):
    answer, = paced.tick(1.51 * H)
    assert (answer.sequence, answer.status) == (1, Code.MISSED)
    np.testing.assert_array_equal(answer.values, [0.5, 0.5])
    time, observation = echo.seen[-1]
    assert time == H and np.isnan(observation).all() and paced.end.counts == {"missing": 1}
    answer, = paced.measure(2, at=2 * H)
    assert answer.status == Code.OK


def test_a_late_measurement_is_dropped_and_counted(paced, echo):
    paced.tick(1.51 * H)
    assert paced.measure(1, at=1.8 * H) == [] and len(echo.seen) == 2
    assert paced.end.counts == {"missing": 1, "late": 1}
    # The way has become longer, so the next one is waited for as much longer.
    assert paced.end.due() == pytest.approx(3.3 * H)
    answer, = paced.measure(2, at=2.9 * H)
    assert answer.sequence == 2 and paced.end.counts["late"] == 1


def test_a_repeated_measurement_is_answered_again_without_asking_the_controller(paced, echo):
    first, = paced.measure(1, at=H)
    again, = paced.measure(1, at=1.1 * H)
    assert again.pack() == first.pack() and len(echo.seen) == 2 and paced.end.counts == {"repeated": 1}
    assert paced.measure(0, at=1.2 * H) == [] and paced.end.counts == {"repeated": 2}


def test_reordered_measurements_leave_a_gap_and_the_older_one_is_dropped(paced, echo):
    answer, = paced.measure(2, at=1.2 * H)
    assert answer.sequence == 2 and [time for time, _ in echo.seen] == [0.0, 0.01, 0.02]
    assert np.isnan(echo.seen[1][1]).all() and paced.end.counts == {"missing": 1}
    assert paced.measure(1, at=1.3 * H) == [] and paced.end.counts == {"missing": 1, "reordered": 1}


def test_too_many_missing_measurements_end_the_run(paced, echo):
    goodbye, = paced.measure(500, at=H)
    assert goodbye.kind is Kind.END and not paced.end.running and echo.resets == 2


@pytest.mark.parametrize("change", [{"values": [1.0]}, {"values": [1.0, 2.0, 3.0]}, {"stamp": 50.0},
                                    {"stamp": 49.0}], ids=["too short", "too long", "same stamp", "earlier stamp"])
def test_an_impossible_measurement_is_dropped_and_counted(paced, echo, change):
    assert paced.measure(1, at=H, **change) == []
    assert paced.end.counts == {"malformed": 1} and len(echo.seen) == 1
    answer, = paced.measure(1, at=1.1 * H)
    assert answer.status == Code.OK


@pytest.mark.parametrize("data", [b"", b"hello", b"\0" * 32, Message(Kind.START).pack(), Message(Kind.COMMAND).pack(),
                                  Message(Kind.MEASUREMENT).pack()[:-1]])
def test_bytes_that_are_not_a_message_of_a_robot_are_dropped_and_counted(paced, data):
    assert paced.end.receive(paced.peer, data, H) == [] and paced.end.counts == {"malformed": 1}
    assert paced.end.running


def test_a_measurement_with_nan_is_answered_at_once_as_missing(paced, echo):
    answer, = paced.measure(1, at=H, values=[0.3, np.nan])
    assert answer.status == Code.MISSED and np.isnan(echo.seen[-1][1]).all()
    assert paced.end.counts == {"not_finite": 1}


def test_random_bytes_never_raise_and_never_reach_the_controller(paced, echo):
    rng = np.random.default_rng(0)
    good = Message(Kind.MEASUREMENT, paced.run, 1, 50.01, values=np.ones(2)).pack()
    for _ in range(2000):
        spoiled = bytearray(good[:rng.integers(0, 49)])
        for place in rng.integers(0, max(len(spoiled), 1), 3)[:len(spoiled)]:
            spoiled[place] = rng.integers(256)
        paced.end.receive(b"stranger", bytes(spoiled)[:47], H)
    assert len(echo.seen) == 1 and paced.end.counts["malformed"] == 2000


def test_a_dead_robot_in_real_time_resets_the_controller_which_then_takes_the_next(paced, echo, hello):
    sent = [message for k in range(1, 20) for message in paced.tick((k + 0.51) * H)]
    assert [message.kind for message in sent] == [Kind.COMMAND] * 9 + [Kind.END]
    assert not paced.end.running and echo.resets == 2 and paced.end.due() == np.inf
    assert paced.end.counts == {"missing": 9, "lost_robots": 1} and paced.end.finished == 0
    Talk(paced.end, hello(), peer=b"another", at=1.0)
    assert paced.end.running


def test_a_robot_in_lock_step_is_waited_for_until_its_patience_ends(end, hello):
    talk = Talk(end, hello())
    talk.measure(0, at=0.0)
    assert talk.tick(9.9) == [] and end.due() == 10.0
    goodbye, = talk.tick(10.0)
    assert goodbye.kind is Kind.END and not end.running


def test_a_message_of_another_run_gets_a_reply_that_says_so(paced, echo):
    goodbye, = paced.measure(1, at=H, run=paced.run + 1)
    assert (goodbye.kind, goodbye.run, goodbye.status) == (Kind.END, paced.run + 1, Code.OTHER)
    assert "HELLO" in goodbye.text and paced.end.counts == {"foreign": 1} and len(echo.seen) == 1


def test_a_second_robot_is_told_that_the_controller_is_busy(paced, hello):
    (peer, refusal), = paced.end.receive(b"second", hello(name="second"), H)
    assert (peer, refusal.kind, refusal.status) == (b"second", Kind.REFUSE, Code.BUSY)
    assert "busy with the robot 'integrator'" in refusal.text and paced.end.running


def test_a_hello_repeated_before_the_first_measurement_begins_no_other_run(end, hello, echo):
    talk = Talk(end, hello())
    assert Talk(end, hello()).run == talk.run and echo.resets == 1
    talk.measure(0, at=0.0)
    assert Talk(end, hello()).run != talk.run and echo.resets == 3 and end.counts == {"lost_robots": 1}


def test_a_robot_that_the_controller_cannot_take_is_refused_with_the_reason(hello):
    def build(robot):
        raise ValueError("the model was trained with outputs ['a'], but this robot has ['x', 'y']")

    end = ControllerEnd(build)
    for data, what in ((hello(), "outputs ['a'], but this"), (Message(Kind.HELLO, text="{}").pack(), "the keys")):
        (_, refusal), = end.receive(b"robot", data, 0.0)
        assert refusal.kind is Kind.REFUSE and refusal.status == Code.OK and what in refusal.text
    assert end.counts == {"refused": 2} and not end.running


def test_a_task_that_is_done_ends_the_run_without_a_last_command(echo, hello):
    end = ControllerEnd(lambda robot: echo, duration=0.025)
    talk = Talk(end, hello())
    kinds = [message.kind for k in range(4) for message in talk.measure(k, at=0.0)]
    assert kinds == [Kind.COMMAND] * 3 + [Kind.END] and end.finished == 1 and len(end.samples) == 4


def test_the_robot_may_end_a_run(paced):
    data = Message(Kind.END, paced.run, status=Code.OTHER, text="the robot stops").pack()
    assert paced.end.receive(paced.peer, data, H) == [] and paced.end.finished == 0
    assert not paced.end.running


def test_the_last_plan_goes_on_where_measurements_are_missing_and_then_the_safe_input(build, plant):
    end = ControllerEnd(build, timeout=1.0)
    text, rng = RobotDescription.of(plant, real_time=True).text, np.random.default_rng(0)
    (_, start), = end.receive(b"robot", Message(Kind.HELLO, text=text).pack(), 0.0)
    for k in range(41):
        sent = Message(Kind.MEASUREMENT, start.run, k, k * H, values=rng.uniform(-1e-4, 1e-4, 6)).pack()
        end.receive(b"robot", sent, k * H)
    plan = end.samples[40].command.plan
    answers = [end.tick((41 + k) * H + 0.6 * H)[0].message for k in range(14)]
    assert {answer.status for answer in answers} == {Code.MISSED}
    for k in range(9):  # samples 41 … 49; a plan of five steps of two samples begins at 40
        np.testing.assert_array_equal(answers[k].values, plan.inputs[(k + 1) // 2])
    for answer in answers[9:]:
        np.testing.assert_array_equal(answer.values, np.zeros(4))


def test_settings_out_of_range_are_refused():
    with pytest.raises(ValueError, match="positive timeout and patience"):
        ControllerEnd(Echo, timeout=0.0)
    with pytest.raises(ValueError, match="deadline is -1"):
        ControllerEnd(Echo, deadline=-1)


def test_the_status_of_a_command_tells_its_kind():
    assert code_of(Command(np.zeros(1))) is Code.OK
    assert code_of(Command(np.zeros(1), held=True)) is Code.HELD
    assert code_of(Command(np.zeros(1), fallback=Status.OUT_OF_RANGE)) is Code.OUT_OF_RANGE
    assert unpack(Message(Kind.COMMAND, status=Code.OUT_OF_RANGE).pack()).status == 11
