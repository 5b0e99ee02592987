"""Files as measurement systems and programs write them: each is read as the run m, or refused with the remedy."""

import h5py
import numpy as np
import pytest
import scipy.io
import yaml
from recordings_of_rigs.base_set import base_set, small

from ssmr_torch.data.card_reader import custom

K = np.arange(20)
T, X, U = K / 100, np.c_[5 + 0.1 * K, -3 + 0.0 * K, 120 + 0.0 * K], np.c_[0.01 * K, 0.0 * K]
HEADER = "t,x,y,z,u1,u2"
ROWS = [f"{k / 100:g},{5 + 0.1 * k:g},-3,120,{0.01 * k:g},0" for k in range(20)]
CARD = {"columns": {"time": "t", "observation": ["x", "y", "z"], "input": ["u1", "u2"]},
        "units": {"length": "mm", "input": "1", "time": "s"}, "rest": [5, -3, 120]}


def holds_m(dataset, count: int = 20) -> None:
    run, = dataset
    assert run.length == count and run.timestep == pytest.approx(0.01, rel=1e-6)
    np.testing.assert_allclose(1e3 * run.observation[-1], [1.9, 0, 0], atol=1e-9)


def read(folder, content: bytes, name: str = "m.csv", **card):
    (folder / name).write_bytes(content)
    (folder / "card.yaml").write_text(yaml.safe_dump({"files": [name]} | CARD | card))
    return custom(folder / "card.yaml")


def lines(*rows: str) -> bytes:
    return ("\n".join(rows) + "\n").encode()


with_column = [f"{row},world" for row in ROWS]
DIALECTS = {
    "an unused column of text": lines(HEADER + ",frame_id", *with_column),
    "Windows-1252": "\n".join([HEADER + ",T [°C]", *(f"{row},20" for row in ROWS), ""]).encode("cp1252"),
    "UTF-16": "\n".join([HEADER, *ROWS, ""]).encode("utf-16"),
    "a first line of comment with commas": lines("# rig: A, date: 1 March", HEADER, *ROWS),
    "a row of units": lines(HEADER, "s,mm,mm,mm,1,1", *ROWS),
    "sep=;": lines("sep=;", *(row.replace(",", ";") for row in (HEADER, *ROWS))),
    "a comma at the end of each row": lines(HEADER, *(f"{row}," for row in ROWS)),
    "quoted names with blanks": lines('"t", "x", "y", "z", "u1", "u2"', *ROWS),
    "a last line of comment": lines(HEADER, *ROWS, "# end"),
    "a line of blanks": lines(HEADER, *ROWS[:7], "   ", *ROWS[7:]),
    "semicolons, and a name with commas": lines(HEADER.replace(",", ";") + ";a,b,c,d,e,f,g,h", *(
        row.replace(",", ";") + ";1" for row in ROWS)),
    "decimal commas": lines(HEADER.replace(",", ";"), *(row.replace(",", ";").replace(".", ",") for row in ROWS)),
    "tabs": lines(*(row.replace(",", "\t") for row in (HEADER, *ROWS))),
    "CRLF": "\r\n".join([HEADER, *ROWS, ""]).encode(),
    "a byte order mark": b"\xef\xbb\xbf" + lines(HEADER, *ROWS),
    "no newline at the end": "\n".join([HEADER, *ROWS]).encode(),
}


@pytest.mark.parametrize("dialect", DIALECTS)
def test_every_dialect_of_text_is_read_as_m(tmp_path, dialect):
    holds_m(read(tmp_path, DIALECTS[dialect]))


@pytest.mark.parametrize("token", ["-nan(ind)", "1.#QNAN", "#N/A", "None", "-", "", "NaN", "null", "nan"])
def test_tokens_for_a_missing_value_leave_a_bridge_or_two_pieces(tmp_path, token):
    rows = [row if place != 10 else row.replace(",-3,", f",{token},") for place, row in enumerate(ROWS)]
    dataset = read(tmp_path, lines(HEADER, *rows), missing="split", minimum_length=2)
    assert [run.length for run in dataset] in ([10, 9], [20])
    assert 1e3 * dataset[-1].observation[-1, 0] == pytest.approx(1.9, abs=1e-9)


def test_a_single_empty_row_leaves_twenty_samples(tmp_path):
    rows = [row if place != 10 else "0.1,,,,0.1,0" for place, row in enumerate(ROWS)]
    holds_m(read(tmp_path, lines(HEADER, *rows), missing="split"))


def test_units_of_the_file_are_compared_with_the_card(tmp_path):
    with pytest.raises(ValueError, match=r"cm.*mm"):
        read(tmp_path, lines(HEADER, "s,cm,cm,cm,1,1", *ROWS))


def test_a_row_that_was_cut_inside_its_last_number_is_dropped_and_said(tmp_path):
    rig = base_set(tmp_path)
    run = rig.runs["d1"]
    rows = [f"{t:.6g},{u[0]:.6g},{u[1]:.6g},{y[0]:.6g},{y[1]:.6g},{y[2]:.6g}" for t, y, u in zip(run.t, run.y, run.u)]
    rows[-1] = rows[-1].rsplit(",", 1)[0] + ",11"
    rig.runs = {"d1": run, "c1": rig.runs["c1"], "test": rig.runs["test"]}
    run.text = "\n".join(["t,u1,u2,x,y,z", *rows])
    rig.card |= {"decays": ["d1"], "rest": "last sample of decays"}
    data = rig.read()
    assert 1e3 * data.rest[2] == pytest.approx(120.0, abs=0.1)
    assert any("d1" in text and "299" in text for text in rig.said), rig.said


def test_a_controlled_run_that_was_cut_inside_its_last_input_loses_that_row(tmp_path):
    rig = base_set(tmp_path)
    run = rig.runs["c1"]
    run.u[-1] = [0.5, 1.2595]
    rows = [",".join(f"{value:.6g}" for value in row) for row in np.c_[run.t, run.y, run.u]]
    rows[-1] = rows[-1].rsplit(",", 1)[0] + ",1"
    run.text = "\n".join(["t,x,y,z,u1,u2", *rows])
    rig.runs = {name: rig.runs[name] for name in ("d1", "c1", "test")}
    rig.card["decays"] = ["d1"]
    data = rig.read()
    assert next(each for each in data if each.name == "c1").length == 1499
    assert any("c1" in text and "1499" in text for text in rig.said), rig.said


MOTIVE = lines(
    "Format Version,1.23,Take Name,m,Capture Frame Rate,100.000000,Export Frame Rate,100.000000,Rotation Type,"
    "Quaternion,Total Frames in Take,20,Total Exported Frames,20,Length Units,Millimeters,Coordinate Space,Global", "",
    ",,Marker,Marker,Marker", ",,tip,tip,tip", ",,1,1,1", ",,Position,Position,Position", "Frame,Time (Seconds),X,Y,Z",
    *(f"{k},{k / 100:.6f},{5 + 0.1 * k:.6f},-3.000000,120.000000" for k in range(20)))
QUALISYS = lines("NO_OF_FRAMES\t20", "NO_OF_CAMERAS\t8", "NO_OF_MARKERS\t1", "FREQUENCY\t100", "NO_OF_ANALOG\t0",
                 "ANALOG_FREQUENCY\t0", "DESCRIPTION\t--", "TIME_STAMP\t2024-03-01, 10:00:00", "DATA_INCLUDED\t3D",
                 "MARKER_NAMES\ttip", *(f"{5 + 0.1 * k:.3f}\t-3.000\t120.000" for k in range(20)))
VICON = lines("Trajectories", "100", ",,s:tip,,", "Frame,Sub Frame,X,Y,Z", ",,mm,mm,mm",
              *(f"{k + 1},0,{5 + 0.1 * k:.6g},-3,120" for k in range(20)))


@pytest.mark.parametrize(("content", "name"), [(MOTIVE, "m.csv"), (QUALISYS, "m.tsv"), (VICON, "m.csv")])
def test_exports_of_motion_capture_are_read_with_their_names(tmp_path, content, name):
    commands = lines("t,u1,u2", *(f"{k / 100:g},{0.01 * k:g},0" for k in range(20)))
    (tmp_path / "u.csv").write_bytes(commands)
    from ssmr_torch.recording_files.reading import read_tables

    (tmp_path / name).write_bytes(content)
    table, = read_tables(tmp_path / name)
    assert table.interval == pytest.approx(0.01)
    np.testing.assert_allclose(table.numbers(["tip_X", "tip_Y", "tip_Z"], name), X, atol=1e-6)
    assert {table.units.get(f"tip_{axis}") for axis in "XYZ"} == {"mm"}


def in_hdf5(path, **datasets):
    with h5py.File(path, "w") as file:
        for key, value in datasets.items():
            file[key] = value


HDF5_CARD = {"columns": {"time": "t", "observation": ["p_0", "p_1", "p_2"], "input": ["c_0", "c_1"]}}


def from_file(folder, name: str, **card):
    (folder / "card.yaml").write_text(yaml.safe_dump({"files": [name]} | CARD | card))
    return custom(folder / "card.yaml")


def test_groups_of_an_hdf5_file_are_runs(tmp_path):
    in_hdf5(tmp_path / "m.h5", **{f"{run}/{key}": value for run in ("r1", "r2") for key, value in
                                  (("t", T), ("p", X), ("c", U))})
    dataset = from_file(tmp_path, "m.h5", **HDF5_CARD)
    assert len(dataset) == 2 and [run.name.split(":")[-1].split("/")[-1] for run in dataset] == ["r1", "r2"]


def test_a_compound_table_in_hdf5_is_read(tmp_path):
    table = np.zeros(20, dtype=[(name, "f8") for name in HEADER.split(",")])
    for name, column in zip(HEADER.split(","), np.c_[T, X, U].T):
        table[name] = column
    in_hdf5(tmp_path / "m.h5", table=table)
    holds_m(from_file(tmp_path, "m.h5"))


def test_scaled_whole_numbers_in_hdf5_are_scaled(tmp_path):
    in_hdf5(tmp_path / "m.h5", t=T, p=np.round(100 * X).astype("i2"), c=U)
    with h5py.File(tmp_path / "m.h5", "a") as file:
        file["p"].attrs["scale_factor"] = 0.01
    holds_m(from_file(tmp_path, "m.h5", **HDF5_CARD))


def test_units_in_hdf5_are_compared_with_the_card(tmp_path):
    in_hdf5(tmp_path / "m.h5", t=T, p=X / 10, c=U)
    with h5py.File(tmp_path / "m.h5", "a") as file:
        file["p"].attrs["units"] = "cm"
    with pytest.raises(ValueError, match=r"cm.*mm"):
        from_file(tmp_path, "m.h5", **HDF5_CARD)


def test_hdf5_is_known_by_its_content(tmp_path):
    in_hdf5(tmp_path / "m.mat", t=T, p=X, c=U)
    holds_m(from_file(tmp_path, "m.mat", **HDF5_CARD))


def test_matlab_and_numpy_files_are_read(tmp_path):
    scipy.io.savemat(tmp_path / "m.mat", {"t": T, "y": X, "u": U})
    np.savez(tmp_path / "m.npz", t=T, y=X, u=U)
    for name in ("m.mat", "m.npz"):
        holds_m(from_file(tmp_path, name, columns={"time": "t", "observation": ["y_0", "y_1", "y_2"],
                                                   "input": ["u_0", "u_1"]}))


CARD_TEXT = "files: [m.csv]\ncolumns: {time: t, observation: [x, y, z], input: [u1, u2]}\n" \
            "units: {length: mm, input: '1', time: s}\nrest: [5, -3, 120]\n"


@pytest.mark.parametrize(("more", "words"), [
    ("decays: [m]\ndecays: [n]\n", "decays twice, lines 5 and 6"),
    ("split: {test: [m]}\nsplit: {validation: [n]}\n", "split twice, lines 5 and 6"),
    ("split: {test: [m], test: [n]}\n", "test twice"), ("seams: {m: [10], m: []}\n", "m twice")])
def test_a_key_that_stands_twice_in_a_card_is_refused(tmp_path, more, words):
    (tmp_path / "m.csv").write_bytes(lines(HEADER, *ROWS))
    (tmp_path / "card.yaml").write_text(CARD_TEXT + more)
    with pytest.raises(ValueError, match=words):
        custom(tmp_path / "card.yaml")


def test_pieces_of_one_recording_can_be_assigned(tmp_path):
    rig = small(tmp_path, seams={"m": [10]}, minimum_length=2, split={"test": ["m/1"]}, decays=[])
    assert [run.split for run in rig.read()] == ["train", "test"]


def test_runs_with_one_file_name_are_named_after_their_folders(tmp_path):
    rig = small(tmp_path)
    rig.write()
    for day in ("day1", "day2"):
        (tmp_path / day).mkdir()
        (tmp_path / day / "r.csv").write_bytes((tmp_path / "m.csv").read_bytes())
    rig.card["files"] = ["day1/r.csv", "day2/r.csv"]
    assert [run.name for run in rig.read()] == ["day1/r", "day2/r"]


@pytest.mark.parametrize("name", ["001", "2024-03-01"])
def test_a_run_whose_name_yaml_reads_otherwise_is_found_or_the_quotes_are_asked_for(tmp_path, name):
    rows = [f"{k / 100},{6 * 0.9**k + 5},-3,120,0,0" for k in range(20)]
    (tmp_path / f"{name}.csv").write_bytes(lines(HEADER, *rows))
    (tmp_path / "card.yaml").write_text(CARD_TEXT.replace("m.csv", f'"{name}.csv"') + f"decays: [{name}]\n")
    try:
        run, = custom(tmp_path / "card.yaml")
        assert run.kind == "decay" and run.name == name
    except ValueError as refusal:
        assert "quotes" in str(refusal)


def test_a_pattern_names_all_files_that_match_in_order(tmp_path):
    rig = small(tmp_path)
    rig.write()
    for name in ("b", "a"):
        (tmp_path / f"{name}.csv").write_bytes((tmp_path / "m.csv").read_bytes())
    rig.card["files"] = ["*.csv"]
    assert [run.name for run in rig.read()] == ["a", "b", "m"]
