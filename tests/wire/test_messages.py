"""The layout of the messages, and what is refused at the edge."""

import json
import struct
from dataclasses import replace

import numpy as np
import pytest

from ssmr_torch.control.base import Command
from ssmr_torch.status import Status
from ssmr_torch.wire.controller_end import code_of
from ssmr_torch.wire.messages import (
    HEADER,
    Code,
    Kind,
    Malformed,
    Message,
    RobotDescription,
    read_description,
    read_start,
    unpack,
)


def test_a_measurement_is_a_header_of_32_bytes_and_little_endian_numbers():
    data = Message(Kind.MEASUREMENT, run=7, sequence=2**40, time=1.5, values=np.array([1.0, -2.0])).pack()
    assert data == b"SSMR" + struct.pack("<BBHIIQd2d", 1, 4, 0, 7, 2, 2**40, 1.5, 1.0, -2.0)
    assert HEADER.size == 32 and len(data) == 48


@pytest.mark.parametrize("message", [
    Message(Kind.HELLO, text='{"name": "Rüssel"}'), Message(Kind.START, 5, text="{}"), Message(Kind.END, 5, 9),
    Message(Kind.REFUSE, status=Code.BUSY, text="busy"), Message(Kind.MEASUREMENT, 5, 3, 0.03, values=np.arange(6.0)),
    Message(Kind.COMMAND, 5, 3, 1e-3, Code.MISSED, np.array([0.1, 0.2, 0.3, 0.4])),
], ids=lambda message: message.kind.name)
def test_a_message_is_the_same_after_packing_and_unpacking(message):
    read = unpack(message.pack())
    for name in ("kind", "run", "sequence", "time", "status", "text"):
        assert getattr(read, name) == getattr(message, name)
    np.testing.assert_array_equal(read.values, message.values)


GOOD = Message(Kind.MEASUREMENT, 1, 2, 3.0, values=np.ones(2)).pack()


@pytest.mark.parametrize(("data", "what"), [
    (b"", "0 bytes; expected at least the header of 32"),
    (GOOD[:31], "31 bytes"),
    (GOOD[:-1], "count of 2; expected 48 bytes"),
    (GOOD + b"\0" * 8, "expected 48 bytes"),
    (b"HTTP" + GOOD[4:], "expected b'SSMR'"),
    (GOOD[:4] + b"\2" + GOOD[5:], "version 2; expected b'SSMR', version 1"),
    (GOOD[:5] + b"\x63" + GOOD[6:], "kind 99"),
    (GOOD[:12] + b"\xff\xff\xff\xff" + GOOD[16:], "a count of 4294967295"),
    (Message(Kind.MEASUREMENT, time=np.nan).pack(), "finite number of s"),
    (HEADER.pack(b"SSMR", 1, Kind.HELLO, 0, 0, 1, 0, 0.0) + b"\xff", "not UTF-8"),
])
def test_bytes_that_are_not_a_message_are_refused(data, what):
    with pytest.raises(Malformed, match=what.replace("(", r"\(")):
        unpack(data)


@pytest.mark.parametrize("status", [status for status in Status if not status.success])
def test_no_fallback_looks_like_an_intended_input(status):
    assert code_of(Command(np.zeros(1), fallback=status)) not in (Code.OK, Code.HELD, Code.MISSED)


def test_a_code_is_never_used_twice():
    assert len(set(Code)) == len(Code.__members__)


def test_a_robots_description_is_the_same_after_the_wire(integrator):
    description = RobotDescription.of(integrator, real_time=True)
    read = read_description(description.text)
    assert read.text == description.text and read.real_time and read.output_names == ("x", "y")
    np.testing.assert_array_equal(read.input_bounds, integrator.input_bounds)


@pytest.mark.parametrize(("change", "what"), [
    ({"rest": [0.0]}, "a rest of shape"), ({"rest": [0.0, "left"]}, "could not convert"),
    ({"input_bounds": [[1, 1], [0, 0]]}, "the lowest below the highest"), ({"timestep": 0}, "positive number of s"),
    ({"timestep": "fast"}, "positive number of s"), ({"length_unit": "mm"}, "measures in 'mm'; expected 'm'"),
    ({"rest": [0.0, float("nan")]}, "finite"), ({"colour": "red"}, "the keys"),
])
def test_an_impossible_description_is_refused(integrator, change, what):
    content = json.loads(RobotDescription.of(integrator).text) | change
    with pytest.raises(ValueError, match=what):
        read_description(json.dumps(content))


@pytest.mark.parametrize("text", ["", "[]", "{}", "{"])
def test_a_hello_without_a_description_is_refused(text):
    with pytest.raises(ValueError, match="a HELLO"):
        read_description(text)


def test_a_start_holds_a_seed_or_none():
    assert read_start('{"seed": 4}') == 4 and read_start('{"seed": null}') is None and read_start("{}") is None
    with pytest.raises(ValueError, match="the seed -1"):
        read_start('{"seed": -1}')


def test_a_description_of_another_length_unit_cannot_even_be_written(integrator):
    with pytest.raises(ValueError, match="convert the observation"):
        replace(RobotDescription.of(integrator), length_unit="mm")
