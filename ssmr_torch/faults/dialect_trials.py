"""Text in any dialect: separators, encodings, comments, units, tokens for what is absent, and files that were cut."""

from __future__ import annotations

from pathlib import Path

from ssmr_torch.faults.clock_trials import LAST
from ssmr_torch.faults.made_recordings import small_recordings
from ssmr_torch.faults.outcome import Expected
from ssmr_torch.faults.trial import Trials
from ssmr_torch.result_files import save_bytes, save_text

TRIALS = Trials()
HEADER = "t,x,y,z,u1,u2"


def lines() -> list[str]:
    """The header and the 20 rows of the small recordings."""
    return [HEADER, *small_recordings().rows("m")]


def written(folder: Path, content: str | bytes, case: str, card: dict | None = None, name: str = "m.csv",
            **expected) -> Expected:
    """The file and its card; read as the small recordings, where nothing else is expected."""
    save = save_bytes if isinstance(content, bytes) else save_text
    save(folder / name, content)
    made = small_recordings()
    made.card |= {"files": [name]} | (card or {})
    made.write_card(folder)
    if "remedy" not in expected:
        expected = {"samples": {"m": 20}, "values": LAST, "refused": False} | expected
    return Expected(case, **expected)


def joined(rows: list[str], newline: str = "\n") -> str:
    return newline.join(rows) + newline


@TRIALS.of("dialects of text")
def semicolons_and_decimal_commas(made, rng, folder):
    text = joined(lines()).replace(",", ";").replace(".", ",")
    return written(folder, text.encode("cp1252"), "; and decimal commas, as a German spreadsheet writes")


@TRIALS.of("dialects of text")
def tabs_and_old_line_ends(made, rng, folder):
    return written(folder, joined(lines(), "\r").replace(",", "\t"), "tabs, lines end with CR alone")


@TRIALS.of("dialects of text")
def blanks_that_align(made, rng, folder):
    rows = ["".join(f"{cell:>12}" for cell in row.split(",")) for row in lines()]
    return written(folder, joined(rows), "columns aligned by blanks")


@TRIALS.of("dialects of text")
def utf_32_with_a_mark(made, rng, folder):
    return written(folder, joined(lines(), "\r\n").encode("utf-32"), "UTF-32 with a byte order mark, CRLF")


@TRIALS.of("dialects of text")
def utf_16_of_the_other_end(made, rng, folder):
    return written(folder, "\ufeff".encode("utf-16-be") + joined(lines()).encode("utf-16-be"),
                   "UTF-16, big-endian, with a mark")


@TRIALS.of("dialects of text")
def comments_of_other_languages(made, rng, folder):
    sign = str(rng.choice(["//", "%", "#", ";;"]))
    rows = lines()
    return written(folder,
                   joined([f"{sign} rig: 3, gain 1,5", f"{sign}", *rows[:9], f"{sign} marker lost, found", *rows[9:]]),
                   f"lines of comments with {sign}, one of them among the rows")


@TRIALS.of("dialects of text")
def units_in_the_names(made, rng, folder):
    rows = lines()
    return written(folder, joined(["t [s],x [mm],y [mm],z [mm],u1 [1],u2 [1]", *rows[1:]]),
                   "units in brackets in the names",
                   refused=None, remedy=(r"x \[mm\]|'x'",), samples={"m": 20}, values=LAST)


@TRIALS.of("dialects of text")
def other_units_than_those_of_the_card(made, rng, folder):
    rows = lines()
    return written(folder, joined([rows[0], "s,cm,cm,cm,-,-", *rows[1:]]), "a row of units that says cm, the card mm",
                   refused=True, remedy=("cm", "mm"))


@TRIALS.of("dialects of text")
def the_header_again_in_the_middle(made, rng, folder):
    rows = lines()
    return written(folder, joined([*rows[:12], HEADER, *rows[12:]]), "the header again after 11 rows")


@TRIALS.of("dialects of text")
def text_columns_that_nobody_uses(made, rng, folder):
    rows = [f"{row},{'ok, rig' if k else 'note'}" if not k else f'{row},"ok, rig {k}"' for k, row in enumerate(lines())]
    return written(folder, joined(rows), "an unused text column with commas in quotation marks")


@TRIALS.of("dialects of text")
def everything_in_quotation_marks(made, rng, folder):
    rows = [",".join(f'"{cell}"' for cell in row.split(",")) for row in lines()]
    return written(folder, joined(rows), "every cell in quotation marks")


@TRIALS.of("dialects of text")
def an_absent_value(made, rng, folder):
    token = str(rng.choice(["1.#IND", "-1.#IND", "1.#INF", "nan", "NULL", "n/a", "N/A", "NaT", "---", "<NA>", "#NUM!",
                            "inf", "(null)", "?", "missing"]))
    row, rows = int(rng.integers(4, 17)), lines()
    cells = rows[row].split(",")
    cells[1] = token
    rows[row] = ",".join(cells)
    return written(folder, joined(rows), f"{token} in row {row - 1}, missing: split", {"missing": "split"}, values=LAST)


@TRIALS.of("dialects of text")
def a_thousands_separator(made, rng, folder):
    rows = [row.replace(",120,", ',"1,120",') for row in lines()]
    return written(folder, joined(rows), 'z as "1,120"', refused=True, remedy=("1,120",))


@TRIALS.of("dialects of text")
def a_summary_below(made, rng, folder):
    return written(folder, joined([*lines(), "", "Total rows:,20", "Exported by rig 2.1"]),
                   "two lines of a summary below the rows")


@TRIALS.of("dialects of text")
def blank_cells_at_the_end_of_the_header_alone(made, rng, folder):
    rows = lines()
    return written(folder, joined([f"{rows[0]},,", *(f"{row},," for row in rows[1:])]), "two empty columns at the end")


@TRIALS.of("dialects of text")
def numbers_as_fortran_writes_them(made, rng, folder):
    rows = lines()
    text = [rows[0], *(",".join(f"{float(cell):.8E}".replace("E", "D") for cell in row.split(",")) for row in rows[1:])]
    return written(folder, joined(text), "1.5D+00 as Fortran writes", refused=None, remedy=("D",), samples={"m": 20},
                   values=LAST)


@TRIALS.of("dialects of text")
def a_minus_sign_of_typography(made, rng, folder):
    return written(folder, joined(lines()).replace("-3", "−3"), "−3 with the sign of typography", refused=None,
                   remedy=("−3",), samples={"m": 20}, values=LAST)


@TRIALS.of("dialects of text")
def zero_bytes_of_a_torn_log(made, rng, folder):
    return written(folder, joined(lines()).encode() + b"\0" * 300, "300 zero bytes at the end, as after a power cut",
                   refused=None, remedy=("zero bytes|cut|not a text",), samples={"m": 20}, values=LAST)


@TRIALS.of("files that were cut")
def inside_a_number(made, rng, folder):
    text = joined(lines())
    cut = text.rindex(",120,") + 4  # ",12"
    return written(folder, text[:cut], "the last row ends inside z: 12 for 120", samples={"m": 19}, values=(),
                   said=("m",),
                   rows=(19,), near=1)


@TRIALS.of("files that were cut")
def inside_the_last_number(made, rng, folder):
    made.write(folder)
    path = folder / "d1.csv"
    order = [row.split(",") for row in path.read_text(encoding="utf-8").splitlines()]
    rows = [",".join([row[0], *row[4:], *row[1:4]]) for row in order]
    rows[-1] = rows[-1][:rows[-1].rindex(",") + 3]  # 11 for 119.998
    save_text(path, "\n".join(rows))
    made.card["rest"] = "last sample of decays"
    made.write_card(folder)
    return Expected("z of the last row of d1 ends as 11 or 12 of 119.99 or 120.01", said=("d1",), rows=(299,), near=1,
                    samples={"d1": 299}, error=1.1)


@TRIALS.of("files that were cut")
def without_a_last_newline(made, rng, folder):
    return written(folder, joined(lines()).rstrip("\n"), "a sound file without a newline at its end")


@TRIALS.of("files that were cut")
def inside_a_row(made, rng, folder):
    text = joined(lines())
    return written(folder, text[:text.rindex("-3")], "the last row has two cells of six", samples={"m": 19}, values=(),
                   said=("m",), rows=(19,), near=1)


@TRIALS.of("files that were cut")
def nothing_but_a_header(made, rng, folder):
    return written(folder, HEADER + "\n", "a header without rows", refused=True, remedy=("rows|empty",))


@TRIALS.of("files that were cut")
def a_row_in_the_middle(made, rng, folder):
    rows = lines()
    return written(folder, joined([*rows[:9], rows[9][:8], *rows[10:]]), "row 8 has lost its end", refused=True,
                   remedy=(r"\b8\b",))
