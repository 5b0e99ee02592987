"""A shared key: only those who have it take part, copies of old frames do nothing, and the key is shown nowhere."""

import logging
import pickle

import numpy as np
import pytest
from wire.test_over_the_wire import Constant, remote

from ssmr_torch.plants.remote_robot import RemotePlant
from ssmr_torch.wire import runner
from ssmr_torch.wire.controller_end import ControllerEnd
from ssmr_torch.wire.link import ControllerLink, RobotLink
from ssmr_torch.wire.messages import Kind, Message, unpack
from ssmr_torch.wire.robot_end import RobotEnd
from ssmr_torch.wire.seal import TAG, VARIABLE, Seal, read_key
from ssmr_torch.wire.serving import serve

KEY = b"a secret of the two ends"


@pytest.fixture
def key_file(tmp_path):
    path = tmp_path / "wire.key"
    path.write_bytes(KEY + b"\n")
    return path


def frame(message):
    return Seal(KEY, "robot", "controller").sealed(message.pack())


def test_a_signed_frame_is_the_message_with_version_2_and_an_hmac_after_it():
    import hashlib
    import hmac

    message = Message(Kind.MEASUREMENT, 7, 3, 1.5, values=np.ones(2)).pack()
    signed = frame(Message(Kind.MEASUREMENT, 7, 3, 1.5, values=np.ones(2)))
    assert signed[:-TAG] == message[:4] + b"\2" + message[5:]
    assert signed[-TAG:] == hmac.new(KEY, b"robot" + signed[:-TAG], hashlib.sha256).digest()


def test_a_frame_is_not_accepted_by_the_end_that_sent_it_nor_with_another_key():
    signed = frame(Message(Kind.END, 7))
    assert Seal(KEY, "controller", "robot").opened(signed) == Message(Kind.END, 7).pack()
    assert Seal(KEY, "robot", "controller").opened(signed) is None
    assert Seal(KEY + b".", "controller", "robot").opened(signed) is None


@pytest.mark.parametrize("real_time", [False, True])
def test_with_the_same_key_a_run_goes_through_and_strangers_are_dropped_and_counted(integrator, background, real_time):
    end = ControllerEnd(lambda robot: Constant(), duration=0.2, timeout=20.0)
    with ControllerLink("tcp://127.0.0.1:*", KEY) as link, RobotLink(link.endpoint, KEY) as robots, \
            RobotLink(link.endpoint) as stranger, RobotLink(link.endpoint, b"another key of 26 bytes...") as other:
        for each in (stranger, other):
            for _ in range(5):
                each.send(Message(Kind.HELLO, text="{}"))
        robot = RobotEnd(integrator, robots, real_time=real_time, timeout=20.0)
        run = background(robot.drive, 1, wait=20.0)
        serve(link, end, runs=1)
        run.join()
        assert stranger.receive(0.0) is None and other.receive(0.0) is None
    assert end.finished == 1 and end.counts["unauthenticated"] == 10 and not end.counts["refused"]
    assert tuple(integrator.applied[-2]) == (0.4, 0.6) and not robot.counts["unauthenticated"]


@pytest.mark.parametrize("keys", [(KEY, None), (None, KEY), (KEY, KEY + b"2")])
def test_without_the_same_key_the_robot_finds_no_controller(integrator, background, keys):
    end, stop = ControllerEnd(lambda robot: Constant()), []
    with ControllerLink("tcp://127.0.0.1:*", keys[0]) as link, RobotLink(link.endpoint, keys[1]) as robots:
        serving = background(serve, link, end, stop=lambda: bool(stop))
        robot = RobotEnd(integrator, robots)
        with pytest.raises(TimeoutError, match="and the key"):
            robot.drive(wait=0.3)
        stop.append(True)
        serving.join()
    assert end.finished == 0 and (end.counts + robot.counts)["unauthenticated" if keys[0] else "malformed"] > 0


class Recorder:
    """A link that keeps what went through it."""

    def __init__(self, link):
        self.link, self.seal, self.frames = link, link.seal, []

    def send(self, message):
        self.frames.append(self.seal.sealed(message.pack()))
        return self.link.send(message)

    def receive(self, timeout):
        return self.link.receive(timeout)


def test_copies_of_every_frame_of_an_earlier_run_do_nothing(integrator, background):
    """Whoever listened sends all frames of the first run again: before, and during the second."""
    end = ControllerEnd(lambda robot: Constant(), duration=0.3)
    with ControllerLink("tcp://127.0.0.1:*", KEY) as link, RobotLink(link.endpoint, KEY) as robots:
        recorder, applied = Recorder(robots), []
        first = background(RobotEnd(integrator, recorder).drive, 1, wait=20.0)
        serve(link, end, runs=1)
        first.join()
        before, seen = len(integrator.applied), len(end.samples)
        for peer in (b"robot", b"thief"):
            replies = [reply.message for signed in recorder.frames
                       for reply in end.receive(peer, link.seal.opened(signed), 100.0)]
            assert {reply.kind for reply in replies} <= {Kind.END} and not end.running
        second = background(RobotEnd(integrator, robots).drive, 1, wait=20.0)

        class Thieving:
            endpoint, seal, counts = link.endpoint, link.seal, None
            send = staticmethod(link.send)

            def receive(self, timeout):
                applied.append(len(applied))
                if len(applied) % 3 == 0:
                    return b"thief", link.seal.opened(recorder.frames[len(applied) // 3 % len(recorder.frames)])
                return link.receive(timeout)

        serve(Thieving(), end, runs=2)
        second.join()
    assert end.finished == 2 and len(end.samples) == seen and len(integrator.applied) == 2 * before
    assert {tuple(u) for u in integrator.applied} == {(0.4, 0.6), (0.1, 0.0)}


def test_a_remote_plant_takes_the_key_from_a_file(integrator, background, key_file, monkeypatch):
    monkeypatch.setenv(VARIABLE, "the wrong key of the environment")
    monkeypatch.setattr("wire.test_over_the_wire.RobotLink", lambda endpoint: RobotLink(endpoint, KEY))
    elsewhere, robot = remote(integrator, background, key_file=str(key_file))
    np.testing.assert_allclose(elsewhere.step([1.0, 1.0]), [1e-3, 1e-3])
    assert elsewhere.parameters["key_file"] == str(key_file) and KEY.decode() not in repr(vars(elsewhere))
    elsewhere.close()
    robot.join()


def test_a_key_comes_from_the_file_else_from_the_environment_else_there_is_none(key_file, monkeypatch):
    monkeypatch.delenv(VARIABLE, raising=False)
    assert read_key() is None and read_key(key_file) == KEY
    monkeypatch.setenv(VARIABLE, "sixteen bytes or more")
    assert read_key() == b"sixteen bytes or more" and read_key(key_file) == KEY


def test_a_key_that_is_too_short_or_missing_is_refused_without_showing_it(tmp_path, monkeypatch, capsys):
    (tmp_path / "short.key").write_text("hunter2\n")
    with pytest.raises(ValueError, match="has 7 bytes; expected 16 to 4096") as refusal:
        read_key(tmp_path / "short.key")
    monkeypatch.setenv(VARIABLE, "hunter2")
    with pytest.raises(ValueError, match=f"in {VARIABLE} has 7 bytes"):
        read_key()
    assert "hunter2" not in str(refusal.value)
    with pytest.raises(FileNotFoundError, match="no key at .*nowhere"):
        RemotePlant("tcp://127.0.0.1:*", wait=0.01, key_file=str(tmp_path / "nowhere"))
    (tmp_path / "long.key").write_bytes(b"x" * 10**6)
    with pytest.raises(ValueError, match="expected 16 to 4096"):
        read_key(tmp_path / "long.key")
    assert runner.main([]) == 1 and "hunter2" not in capsys.readouterr().err


def test_a_key_is_neither_shown_nor_stored(caplog):
    seal = Seal(KEY, "robot", "controller")
    assert KEY.decode() not in repr(seal)
    with pytest.raises(TypeError, match="not copied or stored"):
        pickle.dumps(seal)
    with caplog.at_level(logging.DEBUG), ControllerLink("tcp://127.0.0.1:*", KEY) as link, \
            RobotLink(link.endpoint) as stranger:
        stranger.send(Message(Kind.HELLO, text="{}"))
        assert link.receive(0.5) is None and link.counts == {"unauthenticated": 1}
    assert "same key" in caplog.text and KEY.decode() not in caplog.text


def test_an_end_without_a_key_says_what_a_signed_frame_needs():
    with pytest.raises(ValueError, match="version 2; .* give this end the other's key"):
        unpack(frame(Message(Kind.END, 7)))
