"""Cards that lie or are wrong: keys twice, names that YAML changes, runs that do not exist, code, hostile YAML."""

from __future__ import annotations

from pathlib import Path

import yaml

from ssmr_torch.faults.clock_trials import LAST
from ssmr_torch.faults.made_recordings import small_recordings
from ssmr_torch.faults.outcome import Expected
from ssmr_torch.faults.trial import Trials
from ssmr_torch.result_files import save_text

TRIALS = Trials()
CARD = """files: [m.csv]
columns: {time: t, observation: [x, y, z], input: [u1, u2]}
units: {length: mm, input: "1", time: s}
rest: [5, -3, 120]
"""


def card(folder: Path, text: str, *files: str) -> None:
    """A card of this text beside copies of the small recordings under these names."""
    made = small_recordings()
    content = "\n".join([",".join(made.header()), *made.rows("m")]) + "\n"
    for name in files or ("m.csv", "n.csv"):
        save_text(folder / name, content)
    save_text(folder / "card.yaml", text)


def refused(folder: Path, text: str, case: str, *remedy: str) -> Expected:
    card(folder, text)
    return Expected(case, refused=True, remedy=remedy)


# Keys twice ------------------------------------------------------------------------------------------------------

@TRIALS.of("keys twice in a card")
def a_unit(made, rng, folder):
    return refused(folder, CARD + "rest: [0, 0, 0]\n", "rest twice", "rest", "4", "5")


@TRIALS.of("keys twice in a card")
def within_the_columns(made, rng, folder):
    text = CARD.replace("{time: t, observation: [x, y, z], input: [u1, u2]}",
                        "\n  time: t\n  observation: [x, y, z]\n  input: [u1, u2]\n  observation: [x, y]")
    return refused(folder, text, "observation twice within columns", "observation", "4", "6")


@TRIALS.of("keys twice in a card")
def in_other_quotation_marks(made, rng, folder):
    return refused(folder, CARD + 'missing: split\n"missing": refuse\n', "missing and \"missing\"", "missing", "5", "6")


@TRIALS.of("keys twice in a card")
def a_run_in_two_splits(made, rng, folder):
    return refused(folder, CARD.replace("[m.csv]", "[m.csv, n.csv]") + "split: {test: [m], validation: [m]}\n",
                   "m is test and validation", r"\bm\b", "test", "validation")


# Names -----------------------------------------------------------------------------------------------------------

@TRIALS.of("names of runs and files")
def numbers_with_leading_zeros(made, rng, folder):
    card(folder, CARD.replace("m.csv", '"007.csv", "008.csv", "010.csv"') + "decays: [007]\nsplit: {test: [010]}\n",
         "007.csv", "008.csv", "010.csv")
    return Expected("runs 007 and 010 without quotation marks", remedy=("quot",), samples={"007": 20, "010": 20},
                    names=("007", "008", "010"))


@TRIALS.of("names of runs and files")
def words_that_yaml_takes_for_truth(made, rng, folder):
    card(folder, CARD.replace("m.csv", '"no.csv", "yes.csv"') + "decays: [no]\n", "no.csv", "yes.csv")
    return Expected("a run named no", remedy=("quot",), samples={"no": 20, "yes": 20})


@TRIALS.of("names of runs and files")
def a_time_of_day(made, rng, folder):
    card(folder, CARD.replace("m.csv", '"12:30:15.csv"') + "decays: [12:30:15]\n", "12:30:15.csv")
    return Expected("a run named 12:30:15", remedy=("quot",), samples={"12:30:15": 20})


@TRIALS.of("names of runs and files")
def the_same_name_in_two_folders(made, rng, folder):
    card(folder, CARD.replace("m.csv", "left/r.csv, right/r.csv") + "split: {test: [right/r]}\n", "left/r.csv",
         "right/r.csv")
    return Expected("left/r.csv and right/r.csv", refused=False, names=("left/r", "right/r"))


@TRIALS.of("names of runs and files")
def patterns(made, rng, folder):
    card(folder, CARD.replace("m.csv", '"d?.csv", "c*.csv"') + "decays: [d1, d2]\n", "d1.csv", "d2.csv", "c1.csv",
         "c10.csv")
    return Expected("files by patterns d?.csv and c*.csv", refused=False, names=("d1", "d2", "c1", "c10"))


@TRIALS.of("names of runs and files")
def a_pattern_that_nothing_matches(made, rng, folder):
    return refused(folder, CARD.replace("m.csv", '"q*.csv"'), "the pattern q*.csv", r"q\*\.csv")


@TRIALS.of("names of runs and files")
def a_pattern_and_a_file_of_it(made, rng, folder):
    card(folder, CARD.replace("m.csv", 'm.csv, "*.csv"'))
    return Expected("m.csv and *.csv", remedy=("m.csv", "twice"), samples={"m": 20, "n": 20})


@TRIALS.of("names of runs and files")
def a_misspelled_run(made, rng, folder):
    return refused(folder, CARD.replace("m.csv", "m.csv, n.csv") + "split: {test: [nn]}\n", "test: [nn]", "nn",
                   r"\bn\b")


@TRIALS.of("names of runs and files")
def pieces_between_seams(made, rng, folder):
    card(folder, CARD + "seams: {m: [5, 12]}\nminimum_length: 2\nsplit: {test: [m/2]}\ndecays: [m/0]\n")
    return Expected("m/0 is a decay, m/2 the test", refused=False, names=("m/0", "m/1", "m/2"))


@TRIALS.of("names of runs and files")
def a_piece_that_does_not_exist(made, rng, folder):
    return refused(folder, CARD + "seams: {m: [10]}\nminimum_length: 2\nsplit: {test: [m/2]}\n", "m/2 of two pieces",
                   "m/2", "m/1")


@TRIALS.of("names of runs and files")
def a_seam_outside(made, rng, folder):
    return refused(folder, CARD + "seams: {m: [10, 20]}\n", "a seam at row 20 of 20", "20")


# YAML that is hostile --------------------------------------------------------------------------------------------

@TRIALS.of("hostile cards")
def code(made, rng, folder):
    mark = folder / "ran.txt"
    expected = refused(folder, CARD + f"symmetry: !!python/object/apply:os.system ['echo > {mark}']\n",
                       "a tag that runs code")
    return expected


@TRIALS.of("hostile cards")
def a_billion_laughs(made, rng, folder):
    anchors = "\n".join(f"x{k}: &x{k} [{', '.join([f'*x{k - 1}'] * 9)}]" for k in range(1, 10))
    return refused(folder, CARD + f"x0: &x0 [1, 1]\n{anchors}\n", "lists of lists of references, nine deep")


@TRIALS.of("hostile cards")
def very_deep(made, rng, folder):
    return refused(folder, CARD + "symmetry: " + "[" * 3000 + "]" * 3000 + "\n", "brackets 3,000 deep")


@TRIALS.of("hostile cards")
def a_list_that_holds_itself(made, rng, folder):
    return refused(folder, CARD + "symmetry: &a {inputs: [*a]}\n", "a value that contains itself")


@TRIALS.of("hostile cards")
def wrong_types(made, rng, folder):
    content = yaml.safe_load(CARD)
    key = str(rng.choice(["files", "columns", "units", "rest", "minimum_length", "irregularity", "range",
                          "sampling_time"]))
    value = [{"a": 1}, [[1]], "text", float("nan"), -1, 1e300, True, [], 10**30][int(rng.integers(9))]
    content[key] = value
    card(folder, yaml.safe_dump(content, sort_keys=False))
    return Expected(f"{key}: {value!r}"[:60], refused=True, remedy=(key.split("_")[0],))


@TRIALS.of("hostile cards")
def a_huge_number(made, rng, folder):
    return refused(folder, CARD + "minimum_length: " + "9" * 5000 + "\n", "minimum_length of 5,000 digits",
                   "minimum_length|digits")


@TRIALS.of("hostile cards")
def a_file_outside(made, rng, folder):
    return refused(folder, CARD.replace("m.csv", "/etc/passwd"), "/etc/passwd as a recording", "passwd")


@TRIALS.of("hostile cards")
def a_folder_and_a_device(made, rng, folder):
    return refused(folder, CARD.replace("m.csv", str(rng.choice(["/dev/zero", "."]))),
                   "a device or a folder as a recording")


@TRIALS.of("hostile cards")
def tabs_for_blanks(made, rng, folder):
    return refused(folder, CARD.replace("units: {length: mm", "units:\n\tlength: mm\n#"), "a tab in front of a key",
                   "line")


@TRIALS.of("hostile cards")
def a_byte_order_mark(made, rng, folder):
    card(folder, "\ufeff" + CARD)
    return Expected("a card with a byte order mark", refused=False, samples={"m": 20}, values=LAST)
