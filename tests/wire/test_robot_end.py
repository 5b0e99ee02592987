"""What the robot's end does when commands are late, repeated, malformed or do not come at all."""

import numpy as np
import pytest

from ssmr_torch.wire.messages import Code, Kind, Message
from ssmr_torch.wire.robot_end import RobotEnd

RUN, H = 9, 0.01
SAFE = [0.1, 0.0]


def command(to, values=(0.4, 0.6), **changes):
    return Message(Kind.COMMAND, **({"run": to.run, "sequence": to.sequence, "values": np.array(values)} | changes))


def controller(last=5, say=lambda message: [(1e-3, command(message))], end=True):
    """Starts one run, answers its measurements as `say` does, and ends it at the last."""

    def answer(message):
        if message.kind is Kind.HELLO:
            return [(1e-3, Message(Kind.START, RUN, text='{"seed": 4}'))]
        if message.kind is Kind.MEASUREMENT and message.sequence < last:
            return say(message)
        return [(1e-3, Message(Kind.END, RUN, text="the task is done"))] if end and message.kind is not Kind.END else []

    return answer


@pytest.mark.parametrize("real_time", [False, True])
def test_every_measurement_is_sent_once_and_every_command_applied_once(fake_robot, integrator, real_time):
    robot, link = fake_robot(controller(), integrator, real_time=real_time)
    robot.drive()
    assert integrator.resets[-1] == 4 and not robot.counts
    sent = link.of_kind(Kind.MEASUREMENT)
    assert [message.sequence for message in sent] == list(range(6))
    np.testing.assert_allclose(np.diff([message.time for message in sent]), H)
    np.testing.assert_array_equal(integrator.applied[-6:], [[0.4, 0.6]] * 5 + [SAFE])


def test_in_real_time_a_step_takes_a_timestep_and_in_lock_step_as_long_as_the_answer(fake_robot, integrator):
    for real_time, duration in ((True, 5 * H), (False, 5 * 1e-3)):
        robot, link = fake_robot(controller(), integrator, real_time=real_time)
        robot.drive()
        assert link.clock.now - 100.0 == pytest.approx(duration + 2e-3, abs=1e-6)


def test_in_lock_step_an_unanswered_measurement_is_sent_again(fake_robot, integrator):
    heard = []

    def deaf_at_first(message):
        heard.append(message.sequence)
        return [(1e-3, command(message))] if heard.count(message.sequence) == 2 else []

    robot, link = fake_robot(controller(2, deaf_at_first), integrator)
    robot.drive()
    assert heard == [0, 0, 1, 1] and not robot.counts and len(integrator.applied) == 3


def test_a_repeated_command_is_applied_once_and_counted(fake_robot, integrator):
    robot, _ = fake_robot(controller(say=lambda m: [(1e-3, command(m)), (2e-3, command(m))]), integrator,
                          real_time=True)
    robot.drive()
    assert robot.counts == {"repeated": 5} and [tuple(u) for u in integrator.applied].count((0.4, 0.6)) == 5


def test_a_late_command_is_used_in_the_next_step_if_no_newer_one_comes(fake_robot, integrator):
    delays = {2: 8e-3, 3: 30e-3}

    def say(message):
        return [(delays.get(message.sequence, 1e-3), command(message, [0.1 * message.sequence + 0.1, 0.5]))]

    robot, _ = fake_robot(controller(say=say), integrator, real_time=True)
    robot.drive()
    np.testing.assert_allclose(np.array(integrator.applied[-6:-1])[:, 0], [0.1, 0.2, 0.2, 0.3, 0.5])
    assert robot.counts == {"missed": 2, "late": 1}


def test_a_command_later_than_its_step_is_dropped_and_the_last_input_held(fake_robot, integrator):
    def late_at_two(message):
        return [(12e-3 if message.sequence == 2 else 1e-3, command(message, [0.1 * message.sequence + 0.1, 0.5]))]

    robot, _ = fake_robot(controller(say=late_at_two), integrator, real_time=True)
    robot.drive()
    assert robot.counts == {"missed": 1, "late": 1}
    np.testing.assert_allclose(np.array(integrator.applied[-6:-1])[:, 0], [0.1, 0.2, 0.2, 0.4, 0.5])


@pytest.mark.parametrize(("spoil", "count"), [
    (lambda m: b"nonsense", "malformed"), (lambda m: command(m, [0.1]), "malformed"),
    (lambda m: command(m, [np.nan, 0.1]), "malformed"), (lambda m: command(m, run=RUN + 1), "foreign"),
    (lambda m: command(m, sequence=m.sequence + 1), "late"),
], ids=["no message", "too few inputs", "NaN", "another run", "another number"])
def test_a_command_that_does_not_fit_is_dropped_and_counted(fake_robot, integrator, spoil, count):
    def say(message):
        return [(1e-3, spoil(message) if message.sequence == 2 else command(message)), (2e-3, command(message))]

    robot, _ = fake_robot(controller(say=say), integrator)
    robot.drive()
    assert robot.counts[count] == 1 and not robot.counts["missed"]
    np.testing.assert_array_equal(integrator.applied[-6:-1], [[0.4, 0.6]] * 5)


@pytest.mark.parametrize("real_time", [False, True])
def test_when_the_controller_dies_the_safe_input_is_applied_and_another_is_waited_for(fake_robot, integrator,
                                                                                      real_time):
    state = {"alive": True}

    def answer(message):
        if message.kind is Kind.MEASUREMENT and message.sequence == 3 and message.run == RUN:
            state["alive"] = False
        if message.kind is Kind.HELLO:
            state["alive"] = True
            return [(0.1, Message(Kind.START, RUN + len(integrator.resets), text="{}"))]
        if not state["alive"]:
            return []
        if message.sequence == 6:
            return [(1e-3, Message(Kind.END, message.run))]
        return [(1e-3, command(message))]

    integrator.resets.clear()
    robot, link = fake_robot(answer, integrator, real_time=real_time, timeout=0.05, patience=2.0)
    robot.drive()
    assert robot.counts["lost_controllers"] == 1 and len(integrator.resets) == 2
    assert len(link.of_kind(Kind.HELLO)) == 2
    applied = [tuple(u) for u in integrator.applied]
    commanded = [k for k, u in enumerate(applied) if u == (0.4, 0.6)]
    between = applied[next(k for k, u in enumerate(applied) if u == tuple(SAFE) and k > commanded[0]):]
    assert between.count(tuple(SAFE)) >= (10 if real_time else 2)
    assert applied[-1] == tuple(SAFE) and len(commanded) >= 3 + 6


def test_in_real_time_the_last_input_is_held_until_the_timeout(fake_robot, integrator):
    say = controller(3, end=False)
    robot, _ = fake_robot(say, integrator, real_time=True, timeout=0.05)
    with pytest.raises(TimeoutError):
        _drive_once(robot)
    applied = [tuple(u) for u in integrator.applied]
    held = applied.count((0.4, 0.6)) - 3
    assert 3 <= held <= 6 and robot.counts["missed"] == held + 1 and robot.counts["lost_controllers"] == 1


def _drive_once(robot):
    """A controller that never comes back: it is heard no more once the run is lost."""
    answer = robot.link.answer
    robot.link.answer = lambda m: [] if robot.counts["lost_controllers"] else answer(m)
    robot.drive(wait=0.5)


def test_before_any_controller_came_the_robot_is_under_the_safe_input(fake_robot, integrator):
    robot, link = fake_robot(lambda message: [], integrator, real_time=True)
    with pytest.raises(TimeoutError, match="no controller answered within 1 s"):
        robot.drive(wait=1.0)
    assert {tuple(u) for u in integrator.applied} == {tuple(SAFE)} and len(integrator.applied) > 90
    assert len(link.of_kind(Kind.HELLO)) in (2, 3)


def test_a_refusal_ends_it_with_the_controllers_reason(fake_robot, integrator):
    robot, _ = fake_robot(lambda m: [(1e-3, Message(Kind.REFUSE, text="trained with ['a'], but this robot has ['x']"))],
                          integrator)
    with pytest.raises(ConnectionError, match=r"refused this robot: trained with \['a'\], but this robot has \['x'\]"):
        robot.drive()


def test_a_busy_controller_is_asked_again(fake_robot, integrator):
    usual, asked = controller(), []

    def answer(message):
        if message.kind is Kind.HELLO:
            asked.append(message)
            if len(asked) < 3:
                return [(1e-3, Message(Kind.REFUSE, status=Code.BUSY, text="busy"))]
        return usual(message)

    robot, _ = fake_robot(answer, integrator)
    robot.drive()
    assert robot.counts == {"busy": 2} and len(asked) == 3


def test_a_start_during_a_run_begins_another_one(fake_robot, integrator):
    def say(message):
        return [(1e-3, Message(Kind.START, RUN + 1, text='{"seed": 8}') if (message.run, message.sequence) == (RUN, 2)
                 else command(message))]

    def answer(message):
        if message.kind is Kind.MEASUREMENT and message.run == RUN + 1 and message.sequence == 4:
            return [(1e-3, Message(Kind.END, RUN + 1))]
        return controller(say=say, last=9)(message)

    robot, link = fake_robot(answer, integrator)
    robot.drive()
    assert integrator.resets[-2:] == [4, 8]
    assert [m.sequence for m in link.of_kind(Kind.MEASUREMENT)] == [0, 1, 2, 0, 1, 2, 3, 4]


def test_an_end_of_another_run_is_ignored(fake_robot, integrator):
    stray = Message(Kind.END, RUN - 1)
    robot, _ = fake_robot(controller(say=lambda m: [(5e-4, stray), (1e-3, command(m))]), integrator)
    robot.drive()
    assert len(integrator.applied) == 6


def test_a_step_that_takes_too_long_is_counted_and_not_caught_up(fake_robot, integrator):
    robot, link = fake_robot(controller(), integrator, real_time=True)
    step = integrator.step

    def slow(u):
        link.clock.now += 3.5 * H if len(link.of_kind(Kind.MEASUREMENT)) == 2 else 0.0
        return step(u)

    integrator.step = slow
    robot.drive()
    assert robot.counts == {"overruns": 1}
    sent = link.of_kind(Kind.MEASUREMENT)
    assert [message.sequence for message in sent] == [0, 1, 5], "a number gives the time"
    stamps = np.diff([message.time for message in sent])
    assert stamps.min() == pytest.approx(H) and stamps.max() == pytest.approx(4.0 * H)


def test_an_error_of_the_robot_tells_the_controller(fake_robot, integrator):
    robot, link = fake_robot(controller(), integrator)
    step, calls = integrator.step, []

    def fragile(u):
        calls.append(u)
        if len(calls) == 2:
            raise RuntimeError("a cable broke")
        return step(u)

    integrator.step = fragile
    with pytest.raises(RuntimeError, match="cable"):
        robot.drive()
    goodbye, = link.of_kind(Kind.END)
    assert goodbye.run == RUN and goodbye.status == Code.OTHER
    np.testing.assert_array_equal(integrator.applied[-1], SAFE)


def test_settings_out_of_range_are_refused(integrator):
    for settings in ({"timeout": 0.0}, {"answer_within": 2.0}, {"safe_input": [0.0, 0.0]}, {"safe_input": [0.2]}):
        with pytest.raises(ValueError, match="expected|numbers between"):
            RobotEnd(integrator, None, **settings)
