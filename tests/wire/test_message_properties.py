"""Properties of messages, of descriptions and of signatures, for any content."""

import json

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ssmr_torch.wire import limits
from ssmr_torch.wire.messages import Kind, Malformed, Message, RobotDescription, read_description, read_start, unpack
from ssmr_torch.wire.seal import Seal

KEY = b"0123456789abcdef"
TEXTS, VALUES = (Kind.HELLO, Kind.START, Kind.REFUSE, Kind.END), (Kind.MEASUREMENT, Kind.COMMAND)
fields = {"run": st.integers(0, 2**32 - 1), "sequence": st.integers(0, 2**64 - 1), "status": st.integers(0, 2**16 - 1),
          "time": st.floats(allow_nan=False, allow_infinity=False)}
messages = st.one_of(
    st.builds(Message, st.sampled_from(TEXTS), text=st.text(max_size=200), **fields),
    st.builds(Message, st.sampled_from(VALUES), values=st.lists(st.floats(), max_size=20).map(np.array), **fields))
plain = st.recursive(st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=5),
                     lambda part: st.lists(part, max_size=4) | st.dictionaries(st.text(max_size=5), part, max_size=4),
                     max_leaves=10)
KEYS = ("name", "output_names", "input_names", "timestep", "rest", "input_bounds", "input_unit", "real_time")


@given(messages)
def test_every_message_is_the_same_after_packing_and_unpacking(message):
    read = unpack(message.pack())
    for name in ("kind", "run", "sequence", "time", "status", "text"):
        assert getattr(read, name) == getattr(message, name)
    np.testing.assert_array_equal(read.values, message.values)


@given(st.one_of(st.binary(max_size=200), st.binary(max_size=60).map(lambda rest: b"SSMR\1" + rest)))
def test_bytes_are_a_message_or_malformed_and_nothing_else(data):
    try:
        assert unpack(data).pack() == data
    except Malformed as error:
        assert 0 < len(str(error)) < 300


@given(messages, st.integers(0), st.integers(1, 255))
def test_a_changed_byte_of_a_signed_frame_is_noticed(message, place, change):
    frame = bytearray(Seal(KEY, "robot", "controller").sealed(message.pack()))
    assert Seal(KEY, "controller", "robot").opened(bytes(frame)) == message.pack()
    frame[place % len(frame)] ^= change
    assert Seal(KEY, "controller", "robot").opened(bytes(frame)) is None


@given(st.binary(max_size=150))
def test_bytes_without_a_signature_are_not_opened(data):
    assert Seal(KEY, "controller", "robot").opened(data) is None


@settings(max_examples=300)
@given(st.one_of(st.text(max_size=50), plain.map(json.dumps),
                 st.dictionaries(st.sampled_from(KEYS), plain).map(json.dumps)))
def test_a_text_is_a_description_or_refused_in_a_short_sentence(text):
    for read in (read_description, read_start):
        try:
            read(text)
        except ValueError as error:
            assert 0 < len(str(error)) < 700


@pytest.fixture
def content(integrator):
    return json.loads(RobotDescription.of(integrator).text)


@pytest.mark.parametrize(("part", "value", "what"), [
    ("timestep", 1e-9, "1e-09; expected a positive number of s, from 0.0001 to 60"), ("timestep", 1e300, "1e\\+300"),
    ("timestep", True, "True"), ("timestep", 10**400, "0000"),
    ("output_names", "xy", "'xy'; expected a list of names"), ("output_names", ["x", "x"], "'x' twice"),
    ("output_names", ["x", "y\n"], "printable characters"), ("output_names", ["x", "\ud800"], "printable characters"),
    ("output_names", ["x", ""], "1 to 100"), ("output_names", ["x", "y" * 101], "1 to 100"),
    ("output_names", [1, 2], "1;"),
    ("output_names", [str(k) for k in range(1025)], "1025 output_names; expected 1024 at most"),
    ("input_names", [str(k) for k in range(257)], "257 input_names; expected 256 at most"),
    ("rest", [10**400, 0], "cannot be read as numbers"), ("rest", [1e10, 0], "finite numbers of 1e\\+09 at most"),
    ("rest", {"x": 1}, "cannot be read as numbers"), ("name", "\x1b[2J", "printable"), ("name", 5, "printable"),
    ("input_unit", ["N"], "printable"), ("real_time", "false", "expected true or false"),
    ("length_unit", "m" * 5000, "expected 'm'"), ("rest", [[[0.0]]], "nested too deeply"),
])
def test_a_description_beyond_the_limits_is_refused_before_anything_is_built(content, part, value, what):
    with pytest.raises(ValueError, match=what) as refusal:
        read_description(json.dumps(content | {part: value}))
    assert len(str(refusal.value)) < 500


@pytest.mark.parametrize("text", ["[" * 60000, '{"name":' * 8000, '{"timestep": 1e400}', '{"rest": NaN}', "9" * 5000,
                                  '{"name": 1, "name": 2}', "\ud800"])
def test_a_text_that_would_break_a_parser_is_refused(text):
    with pytest.raises(ValueError, match="HELLO"):
        read_description(text)


def test_a_number_that_is_too_large_for_a_double_is_refused(content):
    with pytest.raises(ValueError, match="timestep is inf"):
        read_description(json.dumps(content).replace("0.01", "1e400"))


def test_a_text_of_the_other_end_is_shown_in_one_short_line():
    assert limits.legible("a\nb\x1b[2J") == "a?b?[2J"
    assert limits.legible("x" * 10**6) == "x" * 200 + "… (1000000 characters)"
