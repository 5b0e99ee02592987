"""Files, runs and pieces as a card names them, and what YAML makes of names."""

import logging

import h5py
import numpy as np
import pytest
import scipy.io
import yaml

from ssmr_torch.data.card_reader import custom
from ssmr_torch.data.card_text import content_of
from ssmr_torch.recording_files.reading import read_tables

K = np.arange(20)
M = np.c_[K / 100, 5 + 0.1 * K, -3 + 0.05 * K, 120 - 0.02 * K * K, 0.01 * K, 0.02 * K]
DECAY = M * [1, 1, 1, 1, 0, 0]
OTHER = np.c_[M[:, :1], [5, -3, 120] - 0.5 * (M[:, 1:4] - [5, -3, 120]), -M[:, 4:]]  # another run of the same robot
CARD = {"files": ["m.csv"], "columns": {"time": "t", "observation": ["x", "y", "z"], "input": ["u1", "u2"]},
        "units": {"length": "mm", "input": "1", "time": "s"}, "rest": [5, -3, 120], "decays": []}
NESTED = {"time": "t", "observation": ["p_0", "p_1", "p_2"], "input": ["c_0", "c_1"]}


def write(path, rows=M, header="t,x,y,z,u1,u2"):
    path.parent.mkdir(parents=True, exist_ok=True)
    np.savetxt(path, rows, delimiter=",", header=header, comments="", fmt="%.10g")


def read(folder, **changes):
    (folder / "card.yaml").write_text(yaml.safe_dump({**CARD, **changes}))
    return custom(folder / "card.yaml")


def read_text(folder, text):
    (folder / "card.yaml").write_text(text)
    return custom(folder / "card.yaml")


def names(dataset):
    return [(run.name, run.kind, run.split, run.length) for run in dataset]


BEGIN = """files: [m.csv, n.csv]
columns: {time: t, observation: [x, y, z], input: [u1, u2]}
units: {length: mm, input: "1"}
rest: [5, -3, 120]
decays: [m]
"""


@pytest.mark.parametrize(("more", "message"), [
    ("decays: [n]\n", "card.yaml: decays twice, lines 5 and 6"),
    ("split: {test: [m]}\nsplit: {validation: [n]}\n", "split twice, lines 6 and 7"),
    ("split: {test: [m], test: [n]}\n", "test twice, both in line 6"),
    ("split:\n  test: [m]\n  validation: [n]\n  test: [n]\n", "test twice, lines 7 and 9"),
    ("seams: {m: [10], m: []}\n", "m twice, both in line 6"),
    ("seams:\n  m: [10]\n  m: []\n", "m twice, lines 7 and 8"),
    ("split: {test: [n], validation: [n]}\n", "split names the run 'n' twice, in split.test and split.validation"),
    ("centred: [n, n]\n", "centred names the run 'n' twice")])
def test_a_key_or_a_run_that_stands_twice_is_refused_with_its_place(more, message, tmp_path):
    for name in "mn":
        write(tmp_path / f"{name}.csv")
    with pytest.raises(ValueError, match=message):
        read_text(tmp_path, BEGIN + more)


def test_yaml_that_only_looks_like_numbers_dates_and_answers_is_text():
    said = content_of("a: [001, 2024-03-01, 1:30, 1_000, on, no, 0x10, 7, 1.5, true, 1e-2, ~]")["a"]
    assert said == ["001", "2024-03-01", "1:30", "1_000", "on", "no", "0x10", 7, 1.5, True, "1e-2", None]


@pytest.mark.parametrize("stem", ["001", "2024-03-01", "1_000", "no", "12", "1-2"])
def test_a_file_is_found_by_its_stem_without_quotes(stem, tmp_path):
    write(tmp_path / f"{stem}.csv", DECAY)
    dataset = read_text(tmp_path, BEGIN.replace("m.csv, n.csv", f"{stem}.csv").replace("[m]", f"[{stem}]"))
    assert names(dataset) == [(stem, "decay", "train", 20)]


def test_a_name_that_yaml_rounds_is_refused_with_the_remedy(tmp_path):
    write(tmp_path / "1.10.csv")
    with pytest.raises(ValueError, match="a run is named 1.1, which YAML .*; write the name in quotes"):
        read_text(tmp_path, BEGIN.replace("m.csv, n.csv", "1.10.csv").replace("[m]", "[1.10]"))


# Files

def test_a_pattern_names_all_files_that_match_in_order_and_lists_them(tmp_path, caplog):
    for name in ("b", "a", "c"):
        write(tmp_path / f"{name}.csv")
    caplog.set_level(logging.INFO, "ssmr_torch")
    assert [run.name for run in read(tmp_path, files=["*.csv"])] == ["a", "b", "c"]
    assert "*.csv: 3 files, a.csv, b.csv, c.csv" in caplog.text
    assert [run.name for run in read(tmp_path, files=["c.csv", "*.csv"])] == ["c", "a", "b"]
    with pytest.raises(FileNotFoundError, match=r"no file matches '\*.h5' in .*; it holds a.csv, b.csv, c.csv, card"):
        read(tmp_path, files=["*.h5"])
    with pytest.raises(FileNotFoundError, match=r"no file .*aa.csv; did you mean 'a.csv'\?"):
        read(tmp_path, files=["aa.csv"])


def test_a_file_with_brackets_in_its_name_is_that_file(tmp_path):
    write(tmp_path / "run[1].csv")
    assert names(read(tmp_path, files=["run[1].csv"])) == [("run[1]", "controlled", "train", 20)]


def test_files_of_one_name_in_two_folders_are_two_runs_and_two_sources(tmp_path):
    for day, rows in ((1, M), (2, OTHER)):
        write(tmp_path / f"day{day}" / "r.csv", rows)
    dataset = read(tmp_path, files=["day*/r.csv"], split={"test": ["day2/r"]})
    assert names(dataset) == [("day1/r", "controlled", "train", 20), ("day2/r", "controlled", "test", 20)]
    assert list(dataset.provenance["sources"]) == ["card.yaml", "day1/r.csv", "day2/r.csv"]


# Runs within files and pieces of runs

def test_groups_of_an_hdf5_file_are_runs_that_may_be_named_alone(tmp_path):
    with h5py.File(tmp_path / "session.h5", "w") as file:
        for run, rows in (("r1", DECAY), ("r2", OTHER)):
            file[f"{run}/t"], file[f"{run}/p"], file[f"{run}/c"] = rows[:, 0], rows[:, 1:4], rows[:, 4:]
    dataset = read(tmp_path, files=["session.h5"], columns=NESTED, decays=["r1"], split={"test": ["session:r2"]})
    assert names(dataset) == [("session:r1", "decay", "train", 20), ("session:r2", "controlled", "test", 20)]
    np.testing.assert_allclose(dataset[0].observation, 1e-3 * (M[:, 1:4] - [5, -3, 120]), atol=1e-12)
    with pytest.raises(ValueError, match=r"decays names the runs \['r3'\].* do not exist; .*'session:r1'"):
        read(tmp_path, files=["session.h5"], columns=NESTED, decays=["r3"])


def test_runs_of_matlab_structs_and_cells_are_read(tmp_path):
    structs = np.zeros((1, 2), [(name, "O") for name in ("t", "p", "c")])
    for place in range(2):
        structs[0, place] = (M[:, 0], M[:, 1:4], M[:, 4:])
    scipy.io.savemat(tmp_path / "s.mat", {"runs": structs})
    cells = np.empty(3, dtype=object)
    for place in range(3):
        cells[place] = {"t": M[:, :1], "p": M[:, 1:4].T, "c": M[:, 4:]}
    scipy.io.savemat(tmp_path / "c.mat", {"runs": cells})
    assert [run.name for run in read(tmp_path, files=["s.mat", "c.mat"], columns=NESTED)] == [
        "s:1", "s:2", "c:1", "c:2", "c:3"]


@pytest.mark.parametrize(("changes", "expected"), [
    ({"split": {"test": ["m/1"]}}, [("controlled", "train"), ("controlled", "test")]),
    ({"decays": ["m/0"]}, [("decay", "train"), ("controlled", "train")]),
    ({"decays": ["m"], "split": {"test": ["m/0"]}}, [("decay", "test"), ("decay", "train")])])
def test_a_piece_between_seams_has_a_split_and_a_kind_of_its_own(changes, expected, tmp_path):
    write(tmp_path / "m.csv", M if "m/1" in str(changes) else DECAY)
    dataset = read(tmp_path, seams={"m": [10]}, minimum_length=2, **changes)
    assert names(dataset) == [("m/0", *expected[0], 10), ("m/1", *expected[1], 10)]


def test_a_piece_that_does_not_exist_is_refused_with_those_that_do(tmp_path):
    write(tmp_path / "m.csv")
    with pytest.raises(ValueError, match=r"\['m/2'\] do not exist: m has 2 pieces, m/0 to m/1, cut at the rows \[10\]"):
        read(tmp_path, seams={"m": [10]}, minimum_length=2, split={"test": ["m/2"]})


def test_a_decay_whose_file_has_no_inputs_has_zero_inputs_which_is_said(tmp_path):
    write(tmp_path / "m.csv")
    write(tmp_path / "n.csv", OTHER[:, :4], "t,x,y,z")
    dataset = read(tmp_path, files=["m.csv", "n.csv"], decays=["n"])
    assert not dataset[1].input.any() and "The inputs of the decays n, which" in dataset.provenance["assumptions"][-1]
    with pytest.raises(ValueError, match=r"n.csv has no numeric column \['u1', 'u2'\]"):
        read(tmp_path, files=["m.csv", "n.csv"])


# What files say of themselves

@pytest.mark.parametrize(("header", "card", "message"), [
    ("t,x,y,z,u1,u2\ns,cm,cm,cm,N,N", {}, "m.csv: the file says cm, the card mm, of the column 'x'; write cm as units"),
    ("t [ms],x,y,z,u1,u2", {}, "the file says ms, the card s, of the column 't'; write ms as units.time"),
    ("t,x,y,z,u1 [mN],u2 [mN]", {"units": {"length": "mm", "input": "N"}}, "the file says mN, the card N"),
    ("t,x [in],y [in],z [in],u1,u2", {}, "the file says in, the card mm, .*; convert the column to m, cm or mm"),
    ("t,x [mm],y [mm],z [mm],u1 [N],u2 [N]", {}, None), ("t [s],x (left),y (left),z (left),u1 [V],u2 [V]",
                                                        {"columns": {**CARD["columns"], "observation": [
                                                            "x (left)", "y (left)", "z (left)"]}}, None)])
def test_a_unit_in_the_file_that_differs_from_the_cards_is_refused(header, card, message, tmp_path):
    write(tmp_path / "m.csv", header=header)
    if message is None:
        assert read(tmp_path, **card)[0].observation[-1, 0] == pytest.approx(1.9e-3)
        return
    with pytest.raises(ValueError, match=message):
        read(tmp_path, **card)


@pytest.mark.parametrize(("attributes", "values", "message"), [
    ({"units": "cm"}, M[:, 1:4], "the file says cm, the card mm"), ({"units": "mm"}, M[:, 1:4], None),
    ({"scale_factor": 0.01}, np.round(100 * M[:, 1:4]).astype(np.int16), None),
    ({"scale_factor": 0.1, "add_offset": 100.0}, 10 * (M[:, 1:4] - 100), None)])
def test_attributes_of_hdf5_scale_the_numbers_and_say_their_unit(attributes, values, message, tmp_path):
    with h5py.File(tmp_path / "m.h5", "w") as file:
        file["t"], file["c"] = M[:, 0], M[:, 4:]
        file.create_dataset("p", data=values).attrs.update(attributes)
    if message:
        with pytest.raises(ValueError, match=message):
            read(tmp_path, files=["m.h5"], columns=NESTED)
    else:
        assert read(tmp_path, files=["m.h5"], columns=NESTED)[0].observation[-1, 0] == pytest.approx(1.9e-3, abs=1e-9)


def test_a_sampling_time_that_differs_from_the_files_is_refused(tmp_path):
    head = "NO_OF_FRAMES\t20\nFREQUENCY\t100\nDATA_INCLUDED\t3D\nMARKER_NAMES\ttip\tbase\n"
    (tmp_path / "m.tsv").write_text(head + "".join("\t".join(map(str, [*row[1:], 0])) + "\n" for row in M))
    card = {"files": ["m.tsv"], "columns": {"observation": ["tip_X", "tip_Y", "tip_Z"], "input": ["base_X", "base_Y"]}}
    assert read(tmp_path, **card, sampling_time=0.01)[0].length == 20
    with pytest.raises(ValueError, match="m.tsv: the file says a sampling time of 0.01 s, the card 0.02 s"):
        read(tmp_path, **card, sampling_time=0.02)


def matlab_7_3(path, fill):
    with h5py.File(path, "w", userblock_size=512) as file:
        fill(file)
    with path.open("r+b") as file:
        file.write(b"MATLAB 7.3 MAT-file".ljust(116) + b" " * 8 + b"\x00\x02IM")


def stored(file, values, kind="double"):
    """A reference to values among the hidden ones of a MATLAB 7.3 file, transposed as MATLAB does."""
    hidden = file.require_group("#refs#")
    item = hidden.create_dataset(f"v{len(hidden)}", data=np.asarray(values).T)
    item.attrs["MATLAB_class"] = np.bytes_(kind)
    return item.ref


def test_runs_of_structs_and_cells_of_matlab_7_3_are_read(tmp_path):
    def structs(file):
        for name, columns in {"t": slice(0, 1), "p": slice(1, 4), "c": slice(4, 6)}.items():
            refs = [[stored(file, rows[:, columns])] for rows in (M, OTHER)]
            file.create_dataset(f"runs/{name}", data=np.array(refs, dtype=h5py.ref_dtype), dtype=h5py.ref_dtype)
        file["runs"].attrs["MATLAB_class"] = np.bytes_("struct")

    def cells(file):
        refs = [[stored(file, rows[:, columns]) for rows in (M, OTHER)] for columns in (slice(0, 1), slice(1, 4))]
        item = file.create_dataset("oData", data=np.array(refs, dtype=h5py.ref_dtype), dtype=h5py.ref_dtype)
        item.attrs["MATLAB_class"] = np.bytes_("cell")

    matlab_7_3(tmp_path / "s.mat", structs)
    matlab_7_3(tmp_path / "c.mat", cells)
    dataset = read(tmp_path, files=["s.mat"], columns=NESTED)
    assert [run.name for run in dataset] == ["s:1", "s:2"]
    np.testing.assert_allclose(dataset[1].input, OTHER[:, 4:])
    tables = read_tables(tmp_path / "c.mat")
    assert [table.run for table in tables] == ["1", "2"]
    np.testing.assert_array_equal(tables[1].numbers(["t", "y_0", "y_1", "y_2"], "c"), OTHER[:, :4])


def test_an_object_of_matlab_is_refused_with_the_command_that_converts_it(tmp_path):
    def table(file):
        file.create_dataset("log", data=np.zeros((1, 6), np.uint32)).attrs["MATLAB_class"] = np.bytes_("timetable")

    matlab_7_3(tmp_path / "o.mat", table)
    with pytest.raises(ValueError, match=r"o.mat holds the timetable 'log', .*writetable\(timetable2table\(T\), 'run"):
        read(tmp_path, files=["o.mat"], columns=NESTED)


def test_a_line_that_was_cut_stands_in_the_provenance_and_the_log(tmp_path, caplog):
    write(tmp_path / "m.csv")
    (tmp_path / "m.csv").write_text((tmp_path / "m.csv").read_text() + "0.2,7,-3,12")
    dataset = read(tmp_path)
    (note,) = dataset.provenance["notes"]
    assert note["run"] == "m" and note["rows"] == [[20, 20]] and note["done"] == "dropped" and dataset[0].length == 20
    assert "m: the last line, '0.2,7,-3,12', is incomplete" in caplog.text


def test_tables_with_clocks_of_their_own_are_refused_with_what_they_hold(tmp_path):
    with h5py.File(tmp_path / "m.h5", "w") as file:
        file["t"], file["p"], file["t2"], file["c"] = M[:, 0], M[:, 1:4], M[:15, 0], M[:15, 4:]
    with pytest.raises(ValueError, match="m.h5"):
        read(tmp_path, files=["m.h5"], columns=NESTED)
