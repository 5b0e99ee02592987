"""The 20 rows of one small recording in every dialect of text: the same numbers each time, or a refusal that says why.
"""

import logging

import numpy as np
import pytest

from ssmr_torch.recording_files.cells import number
from ssmr_torch.recording_files.cut_line import is_cut
from ssmr_torch.recording_files.reading import read_tables
from ssmr_torch.recording_files.units_said import split_unit, unit_called

K = np.arange(20)
M = np.c_[K / 100, 5 + 0.1 * K, 0 * K - 3.0, 0 * K + 120.0, 0.01 * K, 0.0 * K]
NAMES = ["t", "x", "y", "z", "u1", "u2"]
HEADER = ",".join(NAMES)
ROWS = [",".join(f"{value:.6g}" for value in row) for row in M]


def text(header=HEADER, rows=ROWS, end="\n"):
    return "\n".join([header, *rows]) + end


def between(delimiter, decimal="."):
    return "\n".join([HEADER.replace(",", delimiter), *(row.replace(".", decimal).replace(",", delimiter)
                                                        if decimal == "." else
                                                        row.replace(",", delimiter).replace(".", decimal)
                                                        for row in ROWS)]) + "\n"


def with_cell(row, column, cell):
    cells = ROWS[row].split(",")
    cells[column] = cell
    return text(rows=[*ROWS[:row], ",".join(cells), *ROWS[row + 1:]])


DIALECTS = {
    "a text column": text(f"{HEADER},frame_id", [f"{row},world" for row in ROWS]),
    "a text column with commas in quotes": text(f"{HEADER},note", [f'{row},"a, b"' for row in ROWS]),
    "a name in Windows-1252": text(f"{HEADER},T [°C]", [f"{row},21" for row in ROWS]).encode("cp1252"),
    "a name in Latin-1": text(f"{HEADER},\x81 [°C]", [f"{row},21" for row in ROWS]).encode("latin-1"),
    "UTF-8 with a mark": text().encode("utf-8-sig"), "UTF-16 with a mark": text().encode("utf-16"),
    "UTF-16, big end first": b"\xfe\xff" + text().encode("utf-16-be"), "UTF-16 without": text().encode("utf-16-le"),
    "UTF-32 with a mark": text().encode("utf-32"), "UTF-32 without": text().encode("utf-32-be"),
    "a comment with a comma first": "# rig: A, date: 1 March\n" + text(), "slashes": "// rig, A\n" + text(),
    "per cent": "% rig, A\n% 2\n" + text(), "a quoted comment": '"# rig: A, date"\n' + text(),
    "names in a comment": "# " + text(), "names in a comment of ROS": "%" + text(),
    "a row of units": text(f"{HEADER}\ns,mm,mm,mm,N,N"), "units in brackets": text(f"{HEADER}\n[s],[mm],[mm],[mm],,"),
    "sep= of Excel": "sep=;\n" + between(";"), "SEP=": "SEP=,\n" + text(),
    "a comma at the end of each row": text(rows=[f"{row}," for row in ROWS]),
    "a comma at the end of each row and the header": text(f"{HEADER},", [f"{row}," for row in ROWS]),
    "quoted names after blanks": text('"t", "x", "y", "z", "u1", "u2"'),
    "quoted numbers": text(rows=['"' + row.replace(",", '","') + '"' for row in ROWS]),
    "a last comment": text() + "# end\n", "a line of blanks": text(rows=[*ROWS[:10], "   ", *ROWS[10:]]),
    "empty rows of a spreadsheet at the end": text() + ",,,,,\n,,,,,\n",
    "a name that holds seven commas": (between(";").replace("u2\n", "u2;a,b,c,d,e,f,g,h\n", 1).replace("\n", ";1\n")
                                       .replace("h;1\n", "h\n", 1)),
    "semicolons": between(";"), "tabs": between("\t"), "bars": between("|"), "blanks": between("  "),
    "semicolons and decimal commas": between(";", ","), "tabs and decimal commas": between("\t", ","),
    "blanks and decimal commas": between(" ", ","),
    "blanks before the numbers": text(rows=["   " + row for row in ROWS]),
    "quoted decimal commas": text(rows=[",".join(f'"{cell}"'.replace(".", ",") for cell in row.split(","))
                                        for row in ROWS]),
    "CRLF": text().replace("\n", "\r\n"), "CR": text().replace("\n", "\r"), "no newline at the end": text(end=""),
    "lines above the names": "Rig A\nRate,100\nGain,3\n\n" + text(), "a title": "Recording of March 1\n" + text(),
    "a title with a colon": "Sample rate: 100 Hz\nOperator: A. B.\n" + text(),
}


def read(folder, content):
    path = folder / "m.csv"
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    (table,) = read_tables(path)
    return table


@pytest.mark.parametrize("dialect", DIALECTS)
def test_a_dialect_gives_the_same_numbers_and_no_note(dialect, tmp_path):
    table = read(tmp_path, DIALECTS[dialect])
    np.testing.assert_array_equal(table.numbers(NAMES, "m.csv"), M)
    assert table.notes == ()


@pytest.mark.parametrize("word", ["-nan(ind)", "1.#QNAN", "#N/A", "None", "-", "---", "nan", "NaN", "-nan", "NA",
                                  "null", "NULL", "N/A", "n/a", "<NA>", "#VALUE!", "", " ", "1.#IND", "-1.#IND", "?"])
def test_a_word_for_an_absent_value_is_nan_and_the_other_rows_stay(word, tmp_path):
    read_ = read(tmp_path, with_cell(10, 1, word)).numbers(NAMES, "m.csv")
    assert np.isnan(read_[10, 1]) and np.isnan(read_).sum() == 1
    np.testing.assert_array_equal(np.delete(read_, 10, axis=0), np.delete(M, 10, axis=0))


@pytest.mark.parametrize(("word", "value"), [("inf", np.inf), ("-Infinity", -np.inf), ("1.#INF", np.inf), ("1e3", 1e3)])
def test_words_for_infinity_are_infinite(word, value, tmp_path):
    assert read(tmp_path, with_cell(10, 1, word)).numbers(["x"], "m.csv")[10, 0] == value == number(word)


def test_whole_stamps_of_nanoseconds_stay_exact_and_dates_stay_text(tmp_path):
    rows = [f"{1_700_000_000_000_000_000 + 10_000_000 * k},2024-03-31T01:59:59.9{k:02d}+01:00,{k}" for k in range(20)]
    table = read(tmp_path, text("stamp,date,x", rows))
    assert table.columns["stamp"].dtype == np.int64 and set(np.diff(table.columns["stamp"])) == {10_000_000}
    assert table.columns["date"].dtype == object and table.columns["date"][3] == "2024-03-31T01:59:59.903+01:00"
    with pytest.raises(ValueError, match=r"m.csv: row 0 \(from 0\), column 'date' holds '2024-03-31T01"):
        table.numbers(["date"], "m.csv")


@pytest.mark.parametrize("cell", ["1,234.5", "1.234,5", "1'234.5", "12 345"])
def test_signs_between_thousands_are_refused_with_the_reason(cell, tmp_path):
    content = with_cell(10, 1, f'"{cell}"')
    with pytest.raises(ValueError, match="row 10 .*column 'x' holds .*export without signs between thousands"):
        read(tmp_path, content).numbers(["x"], "m.csv")


def test_units_are_known_from_a_row_and_from_names(tmp_path):
    for header in (f"{HEADER}\ns,mm,mm,mm,N,N", "t [s],x [mm],y [mm],z (mm),u1 [N],u2 {N}"):
        table = read(tmp_path, text(header))
        assert [table.units[table.find(name)] for name in NAMES] == ["s", "mm", "mm", "mm", "N", "N"]
        np.testing.assert_array_equal(table.numbers(NAMES, "m.csv"), M)
    assert unit_called("Millimeters") == "mm" and unit_called("mN") == "mN" and unit_called("MN") is None
    assert split_unit("Time (Seconds)") == ("Time", "s") and split_unit("x (left)") == ("x (left)", None)


def test_a_repeated_header_and_a_footer_are_left_out_and_said(tmp_path):
    table = read(tmp_path, text(rows=[*ROWS[:10], HEADER, *ROWS[10:], "Total,20", "End of recording"]))
    np.testing.assert_array_equal(table.numbers(NAMES, "m.csv"), M)
    repeated, footer = table.notes
    assert repeated.rows == (10,) and "repeated before row 10" in repeated.said and repeated.done == "dropped"
    assert "2 lines below row 19 (from 0), 'Total,20'" in footer.said


def test_names_that_stand_twice_refuse_only_what_is_meant_by_them(tmp_path):
    table = read(tmp_path, text("t,x,x,z,u1,u1"))
    np.testing.assert_array_equal(table.numbers(["t", "z"], "m.csv"), M[:, [0, 3]])
    with pytest.raises(ValueError, match=r"names a column twice, so write 'x \(1\)' or 'x \(2\)'"):
        table.numbers(["x"], "m.csv")
    np.testing.assert_array_equal(table.numbers(["x (2)"], "m.csv"), M[:, [2]])


def test_a_name_that_does_not_exist_is_refused_with_the_nearest(tmp_path):
    with pytest.raises(ValueError, match=r"no numeric column \['u3'\]; it has .*; did you mean 'u\d'\?"):
        read(tmp_path, text()).numbers(["u3"], "m.csv")


def test_a_group_of_names_above_the_names_joins_them(tmp_path):
    table = read(tmp_path, text(",tip,,,valve,\nt,x,y,z,1,2".replace("1,2", "a,b")))
    assert list(table.columns) == ["t", "tip_x", "tip_y", "tip_z", "valve_a", "valve_b"]


# A file that was cut while it was written

@pytest.mark.parametrize("cut", ["0.19,6.9,-3,120,0.19", "0.19,6.9,-3,120,0.19,", "0.19,6.9", "0.", "0.19,6.9,-3,12"])
def test_a_last_line_with_fewer_cells_is_left_out_and_said(cut, tmp_path):
    table = read(tmp_path, text(rows=[*ROWS[:19], cut], end=""))
    np.testing.assert_array_equal(table.numbers(NAMES, "m.csv"), M[:19])
    (note,) = table.notes
    assert note.kind == "cut line" and note.rows == (19,) and repr(cut) in note.said and "row 19" in note.said


def column(values, digits="%.6g"):
    return [["0", digits % value] for value in values]


SETTLED = 120 + 0.02 * np.random.default_rng(0).normal(size=300)
HELD = np.repeat(2 * np.random.default_rng(1).uniform(-1, 1, 20), 12)
SWING = 20 * np.sin(0.07 * np.arange(400))


@pytest.mark.parametrize(("values", "digits", "whole", "cut"), [
    (SETTLED, "%.6g", "119.987", "11"), (SETTLED, "%.6g", "119.987", "1"), (SETTLED, "%.6g", "120.003", "12"),
    (HELD, "%.6g", f"{HELD[-1]:.6g}", f"{HELD[-1]:.6g}"[:3]), (HELD, "%.6g", "0.75", "0."), (HELD, "%.6g", "-1.2", "-"),
    (SWING, "%.4f", "14.1234", "14.1"), (SWING, "%.4f", "14.1234", "1"), (SWING, "%.18e", "1.41e+01", "1.41e+0"),
    (np.arange(300) % 7, "%.0f", "3", ""), (0 * SWING, "%.0f", "0", "-")])
def test_a_number_that_was_cut_is_found_and_the_whole_one_is_kept(values, digits, whole, cut):
    rows = column(values, digits)
    assert is_cut(rows, ["0", cut])
    assert whole in ("0.75", "-1.2", "1.41e+01") or not is_cut(rows, ["0", whole])


def test_of_a_thousand_whole_files_without_a_last_newline_fewer_than_five_lose_a_row():
    rng = np.random.default_rng(0)
    lost = 0
    for digits in ("%.6g", "%.10g", "%.3f", "%.1f", "%.0f"):
        for signal in (SETTLED, HELD, SWING, np.round(SWING), np.cumsum(rng.normal(size=500))):
            rows = column(signal, digits)
            lost += sum(is_cut(rows[:k], rows[k]) for k in rng.integers(30, len(rows), 40))
    assert lost <= 5


def test_a_cut_file_of_utf_16_loses_its_last_character_only(tmp_path):
    table = read(tmp_path, text(end="\n0.2,7,-3,120,0.2,0.1\n").encode("utf-16")[:-1])
    np.testing.assert_array_equal(table.numbers(NAMES, "m.csv")[:20], M)


def test_signals_with_rows_of_their_own_are_tables_of_their_own_and_hidden_markers_are_not(tmp_path):
    """As PlotJuggler writes topics of two rates; and as two markers are hidden at different times."""
    rows = [f"{k / 100},{k},{2 * k},," if k % 3 else f"{k / 100},,,{k}," for k in range(60)]
    (tmp_path / "m.csv").write_text(text("__time,/tip/x,/tip/y,/cmd/0,", rows))
    tip, cmd = sorted(read_tables(tmp_path / "m.csv"), key=lambda table: -table.length)
    assert list(tip.columns) == ["__time", "/tip/x", "/tip/y"] and tip.part == "tip" and tip.length == 40
    assert list(cmd.columns) == ["__time", "/cmd/0"] and cmd.columns["/cmd/0"].tolist() == list(range(0, 60, 3))
    hidden = [f"{k},{'' if 10 < k < 20 else k},{'' if 15 < k < 40 else k}" for k in range(60)]
    assert len(read_tables(tmp_path / "m.csv")) == 2 and read(tmp_path, text("t,a,b", hidden)).length == 60


def test_what_is_left_out_above_the_names_is_logged(tmp_path, caplog):
    caplog.set_level(logging.INFO, "ssmr_torch")
    read(tmp_path, "Rig A\nRate,100\n" + text())
    assert "2 lines above the names are left out: 'Rig A'" in caplog.text
