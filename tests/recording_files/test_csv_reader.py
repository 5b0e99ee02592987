"""What measurement systems write as CSV is read as it is meant, to the last bit, or refused with the place."""

import logging

import numpy as np
import pytest

from ssmr_torch.recording_files.reading import read_tables

nan, inf = float("nan"), float("inf")


@pytest.fixture
def columns(tmp_path):
    def read(text, encoding="utf-8", name="file.csv"):
        (tmp_path / name).write_bytes(text if isinstance(text, bytes) else text.encode(encoding))
        (table,) = read_tables(tmp_path / name)
        return {column: table.numbers([column], name)[:, 0].tolist() for column in table.columns}

    return read


@pytest.mark.parametrize("text", [
    "t,x\n0,1.5\n1,-2e-3\n", "t;x\n0,0;1,5\n1,0;-2,0e-3\n", "t\tx\n0\t1.5\n1\t-2e-3\n", "t\tx\n0,0\t1,5\n1,0\t-0,002\n",
    '"t","x"\n"0","1.5"\n"1","-0.002"\n', '"t","x"\n"0,0","1,5"\n"1,0","-0,002"\n', "t, x\n 0 , 1.5 \n1 , -2e-3\n",
    "# rig 3\n% 2026\n\nt,x\n0,1.5\n# pause\n\n1,-2e-3\n\n", "# t, x\n0,1.5\n1,-2e-3\n", "sep=;\nt;x\n0;1.5\n1;-2e-3\n",
    "t,x\ns,mm\n0,1.5\n1,-2e-3\n", "t;x\n[s];[mm]\n0,0;1,5\n1,0;-0,002\n", "t,x,\n0,1.5,\n1,-2e-3,\n",
    "t,x\n0,1.5,\n1,-2e-3,\n", "t,x\r\n0,1.5\r\n1,-2e-3\r\n", "t,x\r0,1.5\r1,-2e-3\r"])
def test_every_way_of_writing_two_columns_gives_the_same_numbers(columns, text):
    assert columns(text) == {"t": [0.0, 1.0], "x": [1.5, -0.002]}


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16", "utf-16-le", "utf-16-be", "cp1252"])
def test_names_with_umlauts_and_units_are_read_in_every_usual_encoding(columns, encoding):
    assert columns("Zeit;Höhe (µm)\ns;µm\n0,5;1,25\n", encoding) == {"Zeit": [0.5], "Höhe (µm)": [1.25]}


def test_numbers_are_those_of_float_to_the_last_bit(columns):
    rng = np.random.default_rng(0)
    values = rng.normal(size=2000) * 10.0 ** rng.integers(-300, 300, 2000)
    for text in ([repr(float(value)) for value in values], [f"{value:.12g}" for value in values]):
        assert columns("\n".join(["x,k", *(f"{each},0" for each in text)]))["x"] == [float(each) for each in text]


def test_empty_cells_and_the_words_for_them_are_nan(columns):
    words = ["", " ", "nan", "NaN", "NAN", "NA", "null", "N/A", "#N/A", "1.#QNAN"]
    read = columns("\n".join(["t,x,y", *(f"{word},{word},1" for word in words), "inf,-Infinity,2"]))
    np.testing.assert_array_equal(read["x"], [nan] * len(words) + [-inf])
    np.testing.assert_array_equal(read["t"], [nan] * len(words) + [inf])
    np.testing.assert_array_equal(columns("t,x,y\n0,1,\n1,2,3\n")["y"], [nan, 3.0])


def test_a_comma_in_a_quoted_name_delimits_nothing(columns):
    assert columns('"t","x, tip"\n0,1\n') == {"t": [0.0], "x, tip": [1.0]}


def test_what_was_left_out_or_supposed_is_said(columns, caplog):
    caplog.set_level(logging.INFO, "ssmr_torch")
    columns("t;x\ns;mm\n0,5;1,5\n")
    assert "the row below the names, 's;mm', is taken for units and left out" in caplog.text
    assert "commas are read as decimal signs" in caplog.text


@pytest.mark.parametrize(("text", "message"), [
    ("t,x,y\n0,1\n1,2,3\n", r"row 0 \(from 0\) has 2 cells, the header 3"),
    ("t,x,y\n0,1,\n1,2\n", r"row 1 \(from 0\) has 2 cells, the header 3"),
    ("t,x\n0,1,2\n1,2\n", r"row 0 \(from 0\) has 3 cells, the header 2"),
    ("t,x\n# a\n\n0,1\n1,2,3,4\n", r"row 1 \(from 0\) has 4 cells, the header 2"),
    ("t,x\n0,1\n1,2,3,4,5\n", r"row 1 \(from 0\) has 5 cells, the header 2"),
    ("t,x\ns,mm\n0,1\n1,oops\n", r"row 1 \(from 0\), column 'x' holds 'oops'; expected a number"),
    ("t,x\n0,True\n", "column 'x' holds 'True'"), ("t,x\n0,1_000\n", "column 'x' holds '1_000'"),
    ("t,x\n0,1.5D-3\n", "column 'x' holds '1.5D-3'"), ("t;x\n0,0;1,5\n0,1;oops\n", r"row 1 .* column 'x' holds 'oops'"),
    ("t;x\n0;1.5\n1;2,5\n", r"row 1 .*'2,5'; expected a number \(commas are decimal signs only where no cell has"),
    ("t,x\noops,oops\nno,no\n", r"row 0 \(from 0\), column 't' holds 'oops'"),
    ("t,x\n0,\"1\n1,2\n", "look for quotation marks without a partner"), ("\n\n", "expected the names of the columns"),
    ("0;1\n1;2\n", "the first row is '0;1'; expected the names"), ("t,x\n", "has a header but no rows"),
    (b"\x89PNG\r\n\x1a\n\x00\x00\x00", "is not a text file .*zero bytes.*; expected CSV"),
    (b"t,x\n0,1\n\x81\x00\n", "is not a text file .*; expected CSV")])
def test_what_cannot_be_meant_is_refused_with_the_place(columns, text, message):
    with pytest.raises(ValueError, match=message):
        columns(text)
