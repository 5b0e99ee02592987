"""Properties that hold for any input: readers, cards and messages give what was written, or refuse; nothing else."""

import json
import string
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import yaml
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from ssmr_torch.data.card_file import read_card
from ssmr_torch.data.recording_card import PAGE, RecordingCard
from ssmr_torch.faults.damaged_files import DAMAGES, content_of
from ssmr_torch.faults.outcome import REFUSALS, refusal_faults
from ssmr_torch.recording_files.reading import read_tables
from ssmr_torch.trajectory import Trajectory, TrajectoryDataset
from ssmr_torch.wire.messages import HEADER, Kind, Malformed, Message, read_description, unpack

QUICK = settings(max_examples=25, deadline=None, suppress_health_check=[HealthCheck.too_slow], derandomize=True)
NAMES = st.lists(st.text(string.ascii_letters, min_size=1, max_size=8).filter(lambda name: name.lower() not in (
    "nan", "inf", "infinity", "na", "null", "none", "s", "m", "n", "mm", "cm")), min_size=2, max_size=5, unique=True)
NUMBERS = st.floats(allow_nan=False, allow_infinity=False, width=64).filter(lambda number: abs(number) < 1e300)
DIALECTS = [(",", "."), (";", "."), (";", ","), ("\t", "."), ("\t", ",")]


def read_bytes(content: bytes, name: str):
    """The tables of a file, or the message of its refusal."""
    with TemporaryDirectory() as folder:
        path = Path(folder, name)
        path.write_bytes(content)
        try:
            return read_tables(path)
        except (*REFUSALS, ModuleNotFoundError) as refusal:
            assert refusal_faults(str(refusal)) == ""
            return str(refusal)


@QUICK
@given(NAMES, st.integers(3, 12), st.sampled_from(DIALECTS), st.sampled_from(["utf-8", "utf-8-sig", "utf-16"]),
       st.sampled_from(["\n", "\r\n"]), st.booleans(), st.data())
def test_numbers_come_back_from_text_of_any_dialect_to_the_last_bit(names, rows, dialect, encoding, newline, ends,
                                                                    data):
    table = data.draw(st.lists(st.lists(NUMBERS, min_size=len(names), max_size=len(names)), min_size=rows,
                               max_size=rows))
    delimiter, decimal = dialect
    lines = [delimiter.join(names), *(delimiter.join(repr(value).replace(".", decimal) for value in row)
                                      for row in table)]
    found = read_bytes((newline.join(lines) + newline * ends).encode(encoding), "m.csv")
    assert not isinstance(found, str), found
    columns = found[0].columns
    assert list(columns) == names
    for place, name in enumerate(names):
        kept = len(columns[name])  # a last line without its end may be incomplete
        assert kept == rows or not ends and kept == rows - 1
        np.testing.assert_array_equal(columns[name], [row[place] for row in table][:kept])


@QUICK
@given(st.binary(max_size=400),
       st.sampled_from(["m.csv", "m.h5", "m.mat", "m.npz", "m.parquet", "m.c3d", "m.tsv", "m.db3"]))
def test_any_bytes_are_read_as_tables_or_refused_in_few_words(content, name):
    read_bytes(content, name)


@QUICK
@given(st.sampled_from([b"\x89HDF\r\n\x1a\n", b"PK\x03\x04", b"PAR1", b"SQLite format 3\0", b"\x93NUMPY\x01\0",
                        b"MATLAB 5.0 MAT-file", b"\x02\x50", b"Format Version,1.23,", b"NO_OF_FRAMES\t",
                        b"Trajectories\n100\n",
                        b"\x89MCAP0\r\n"]), st.binary(max_size=600))
def test_bytes_behind_the_first_ones_of_a_format_are_read_or_refused(first, rest):
    read_bytes(first + rest, "m.csv")


VALUES = st.recursive(st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=8),
                      lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=8), inner,
                                                                                  max_size=4),
                      max_leaves=8)
KEYS = st.sampled_from([*RecordingCard.model_fields, "file", "colums"])
SOUND = {"files": ["m.csv"], "columns": {"time": "t", "observation": ["x"], "input": ["u"]}, "units": {"length": "mm"},
         "rest": [0.0]}


@QUICK
@given(st.dictionaries(KEYS, VALUES, min_size=1, max_size=3))
def test_a_card_of_any_values_is_a_card_or_is_refused_in_few_words(values):
    with TemporaryDirectory() as folder:
        path = Path(folder, "card.yaml")
        path.write_text(yaml.safe_dump(SOUND | values, allow_unicode=True), encoding="utf-8")
        try:
            assert read_card(path, RecordingCard, PAGE).files
        except REFUSALS as refusal:
            assert refusal_faults(str(refusal)) == "" or len(json.dumps(values, default=str)) > 200


@QUICK
@given(st.text(max_size=200) | st.binary(max_size=200))
def test_a_card_of_any_text_is_refused_in_few_words(text):
    with TemporaryDirectory() as folder:
        path = Path(folder, "card.yaml")
        path.write_bytes(text if isinstance(text, bytes) else text.encode("utf-8", "surrogatepass"))
        try:
            read_card(path, RecordingCard, PAGE)
        except REFUSALS as refusal:
            assert refusal_faults(str(refusal)) == ""
        else:
            raise AssertionError("no random text is a card")


@QUICK
@given(st.sampled_from([Kind.MEASUREMENT, Kind.COMMAND]), st.integers(0, 2**32 - 1), st.integers(0, 2**64 - 1),
       st.floats(allow_nan=False, allow_infinity=False), st.lists(st.floats(), max_size=20))
def test_a_message_comes_back_as_it_was_sent(kind, run, sequence, time, values):
    found = unpack(Message(kind, run, sequence, time, values=np.array(values)).pack())
    assert (found.kind, found.run, found.sequence, found.time) == (kind, run, sequence, time)
    np.testing.assert_array_equal(found.values, values)


@QUICK
@given(st.binary(max_size=300), st.integers(0, 9), st.integers(0, 2**32 - 1))
def test_any_frame_is_a_message_or_malformed(body, kind, count):
    for frame in (body, HEADER.pack(b"SSMR", 1, kind, 0, 0, count, 0, 0.0) + body):
        try:
            unpack(frame)
        except Malformed as refusal:
            assert refusal_faults(str(refusal)) == ""


@QUICK
@given(VALUES.map(lambda value: json.dumps(value)) | st.text(max_size=300))
def test_a_description_of_any_text_is_refused(text):
    try:
        read_description(text)
    except ValueError as refusal:
        assert str(refusal)
    else:
        raise AssertionError("no random text describes a robot")


@QUICK
@given(st.sampled_from(list(DAMAGES)), st.integers(0, 2**32 - 1))
def test_damaged_trajectories_are_refused_or_load_as_what_they_were(damage, seed):
    times = 0.01 * np.arange(30)
    run = Trajectory(times, np.sin(times)[:, None], np.cos(times)[:, None], name="r")
    with TemporaryDirectory() as folder:
        path = Path(folder, "t.h5")
        TrajectoryDataset([run], np.zeros(1), ["x"], ["u"]).save(path)
        path.write_bytes(bytes(DAMAGES[damage](bytearray(path.read_bytes()), np.random.default_rng(seed))))
        try:
            loaded = TrajectoryDataset.load(path)[0].read()
        except REFUSALS:
            return
    assert content_of([loaded.time, loaded.observation, loaded.input, loaded.name]) == content_of(
        [run.time, run.observation, run.input, run.name])
