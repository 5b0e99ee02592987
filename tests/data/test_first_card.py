"""`ssmr read`: what is in files, and a first card that loads where its guesses suffice."""

import sys

import h5py
import numpy as np
import pytest
import yaml

from ssmr_torch import command
from ssmr_torch.data.card_reader import custom
from ssmr_torch.data.column_roles import roles
from ssmr_torch.data.file_contents import contents
from ssmr_torch.data.first_card import first_card
from ssmr_torch.recording_files.table import Table

T = 0.01 * np.arange(300)
SWING = 12 * np.exp(-2 * T)[:, None] * np.cos(9 * T[:, None] + np.arange(3)) + [5, -3, 120]
STEPS = np.repeat(np.random.default_rng(0).uniform(-1, 1, (25, 2)), 12, axis=0)


def driven(steps):
    return np.cumsum(steps @ [[1, 2, 0.5], [-1, 1, 0.5]], axis=0) / 3 + [5, -3, 120]


DRIVEN = driven(STEPS)


def write(path, header, *columns, fmt="%.8g"):
    np.savetxt(path, np.column_stack(columns), delimiter=",", header=header, comments="", fmt=fmt)


def robot(folder, header="t,x,y,z,u1,u2", scale=1.0, clock=1.0):
    write(folder / "release_1.csv", header, clock * T, scale * SWING, 0 * STEPS)
    write(folder / "release_2.csv", header, clock * T, scale * (2 * np.array([5, -3, 120]) - SWING), 0 * STEPS)
    for name, steps in (("inputs", STEPS), ("check", STEPS[::-1])):
        write(folder / f"{name}.csv", header, clock * T, scale * driven(steps), steps)
    return [folder / f"{name}.csv" for name in ("release_1", "release_2", "inputs", "check")]


@pytest.mark.parametrize(("header", "scale", "clock", "units"), [
    ("t,x,y,z,u1,u2", 1.0, 1.0, {"length": "mm", "input": "1", "time": "s"}),
    ("time [ms],tip_x,tip_y,tip_z,cmd_1,cmd_2", 1.0, 1000.0, {"length": "mm", "input": "1", "time": "ms"}),
    ("stamp,px,py,pz,valve1,valve2", 1e-3, 1e3, {"length": "m", "input": "1", "time": "ms"}),
    ("Time (s),X (mm),Y (mm),Z (mm),p1 [N],p2 [N]", 1.0, 1.0, {"length": "mm", "input": "N", "time": "s"})])
def test_the_first_card_of_a_robots_recordings_loads_and_says_what_was_guessed(header, scale, clock, units, tmp_path):
    found = contents(robot(tmp_path, header, scale, clock), tmp_path)
    text = first_card(found, tmp_path)
    card = yaml.safe_load(text)
    names = header.split(",")
    assert card["columns"] == {"time": names[0], "observation": names[1:4], "input": names[4:]}
    assert card["units"] == units and card["decays"] == ["release_1", "release_2"]
    assert card["split"] == {"test": ["check"]} and card["rest"] == "last sample of decays"
    assert card["files"] == [path.name for path in found.files] and text.count("# a guess: ") >= 4
    (tmp_path / "card.yaml").write_text(text)
    dataset = custom(tmp_path / "card.yaml")
    assert [(run.kind, run.split) for run in dataset] == [("decay", "train")] * 2 + [("controlled", "train"),
                                                                                     ("controlled", "test")]
    np.testing.assert_allclose(1e3 * dataset.rest, SWING[-1], atol=0.2)


def test_what_is_in_a_file_is_said_with_ranges_rates_missing_cells_and_what_is_odd(tmp_path):
    table = np.column_stack([T, SWING, 0 * T, STEPS])
    table[10:15, 1] = np.nan
    table[40, 3] = 0
    table[:, 2] = 7
    write(tmp_path / "a.csv", "t,x [mm],y,z,spare,u1,u2", table)
    (tmp_path / "b.csv").write_bytes(b"PK\x03\x04")
    said = repr(contents([tmp_path / "a.csv", tmp_path / "b.csv"], tmp_path))
    for sentence in ("2 files, 1 runs", "format: CSV, a.csv", "300, 0.01 s (100 Hz) by the column 't'",
                     "mm, 5 cells missing", "y: always 7", "spare: always 0", "y never moves",
                     "z is exactly 0 in 1 rows", "b.csv: cannot be read: b.csv is a ZIP archive"):
        assert sentence in said, sentence


def test_runs_within_a_file_are_listed_each_and_a_column_of_whole_steps_is_taken_for_frames(tmp_path):
    with h5py.File(tmp_path / "session.h5", "w") as file:
        for run, (y, u) in {"r1": (SWING, 0 * STEPS), "r2": (DRIVEN, STEPS), "r3": (DRIVEN, STEPS)}.items():
            file[f"{run}/t"], file[f"{run}/p"], file[f"{run}/c"] = np.arange(300), y, u
    found = contents(["session.h5"], tmp_path)
    card = yaml.safe_load(first_card(found, tmp_path))
    assert list(found.runs) == ["session:r1", "session:r2", "session:r3"] and card["decays"] == ["session:r1"]
    assert card["columns"] == {"frame": "t", "observation": ["p_0", "p_1", "p_2"], "input": ["c_0", "c_1"]}
    assert card["rate"] == 100 and "CORRECT IT: frames in 1 s" in first_card(found, tmp_path)


def test_inputs_without_a_telling_name_are_known_by_being_held():
    found = roles(Table({"t": T, "a": SWING[:, 0], "b": SWING[:, 1], "k1": STEPS[:, 0], "k2": STEPS[:, 1]}))
    assert found.input == ["k1", "k2"] and found.observation == ["a", "b"]
    assert found.unsure == ("input", "observation")


def test_stamps_in_nanoseconds_are_known_by_their_steps():
    stamps = 1_700_000_000_000_000_000 + 10_000_000 * np.arange(300)
    found = roles(Table({"stamp": stamps, "x": SWING[:, 0], "u": STEPS[:, 0]}))
    assert found.unit == "ns" and found.seconds[-1] == pytest.approx(2.99)


def test_files_without_a_key_are_those_of_the_command_and_options_stay():
    assert command.with_files("read", ["a b.csv", "it's.csv", "card=c.yaml", "--cfg", "job"]) == [
        "card=c.yaml", "--cfg", "job", r"files=['a b.csv','it\'s.csv']"]
    assert command.with_files("train", ["a.csv"]) == ["a.csv"] and command.with_files("read", []) == []


def test_the_command_prints_what_it_found_and_never_overwrites_a_card(tmp_path, monkeypatch, capsys):
    robot(tmp_path)
    monkeypatch.chdir(tmp_path)
    for expected in ("the card loads 4 runs", None):
        monkeypatch.setattr(sys, "argv", ["ssmr", "read", "*.csv", "card=card.yaml", f"hydra.run.dir={tmp_path}/out"])
        if expected is None:
            with pytest.raises(SystemExit, match="card.yaml is there already .*; give another place"):
                command.main()
        else:
            assert command.main() == 0
            assert expected in (printed := capsys.readouterr().out) and "columns: {time: t" in printed
            assert (tmp_path / "out" / "contents.txt").is_file()


def test_topics_of_a_rosbag_with_two_rates_are_paired_by_the_first_card(tmp_path):
    pytest.importorskip("rosbags")
    from rosbags.rosbag2 import StoragePlugin, Writer
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS2_HUMBLE)
    kinds = store.types
    layout = kinds["std_msgs/msg/MultiArrayLayout"]([], 0)
    for name, positions, inputs in (("release", SWING, 0 * STEPS), ("inputs", DRIVEN, STEPS)):
        with Writer(tmp_path / name, version=9, storage_plugin=StoragePlugin.SQLITE3) as writer:
            tip = writer.add_connection("/tip", "geometry_msgs/msg/PointStamped", typestore=store)
            cmd = writer.add_connection("/cmd", "std_msgs/msg/Float64MultiArray", typestore=store)
            for k, (position, levels) in enumerate(zip(1e-3 * positions, inputs)):
                stamp = 1_700_000_000_000_000_000 + 10_000_000 * k
                header = kinds["std_msgs/msg/Header"](kinds["builtin_interfaces/msg/Time"](*divmod(stamp, 10**9)), "")
                point = kinds["geometry_msgs/msg/PointStamped"](header, kinds["geometry_msgs/msg/Point"](*position))
                writer.write(tip, stamp + 2_000_000, store.serialize_cdr(point, tip.msgtype))
                if k % 2 == 0:
                    array = kinds["std_msgs/msg/Float64MultiArray"](layout, levels.copy())
                    writer.write(cmd, stamp, store.serialize_cdr(array, cmd.msgtype))
    found = contents(["release", "inputs"], tmp_path)
    (tmp_path / "card.yaml").write_text(first_card(found, tmp_path))
    dataset = custom(tmp_path / "card.yaml")
    assert dataset.input_names == ("cmd/data/0", "cmd/data/1") and dataset.timestep == pytest.approx(0.01)
    np.testing.assert_allclose(dataset[1].input[:-2], STEPS[:-2][:len(dataset[1].input) - 2], atol=1e-12)
    np.testing.assert_allclose(dataset[1].observation, 1e-3 * DRIVEN[:dataset[1].length] - dataset.rest, atol=1e-9)
