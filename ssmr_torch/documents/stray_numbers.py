"""Numbers with a unit that stand outside of the blocks: each is a setting, a definition, the paper's, or a fault.

The rule: a measured number stands in a block that a command writes. Running text may repeat a number of a block of the
same page. Code blocks and `code` are not looked at. Every other number with a unit, and every decimal number in a
table, is named in docs/numbers/allowed.yaml, by page and by kind.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Mapping
from pathlib import Path

import yaml

from ssmr_torch.documents.store import FOLDER

KINDS = {
    "settings": "what a user or a default chooses: periods, horizons, counts, options",
    "definitions": "what a robot, a model or a test is by construction, mathematics included",
    "paper": "what the paper or another source says; the source is named on the page",
    "tested": "what a test asserts; the test is named on the page",
}
UNITS = ("mm²", "mm", "cm", "m/s", "m", "µs", "ms", "s", "min", "minutes?", "seconds?", "hours?", "h", "%", "Hz", "kHz",
         "MB", "GB", "rad/s", "rad", "1/s", "kPa", "MPa", "bar", "mN", "N", "kg", "g", "kg/m³", "times", "core-hours")
AMOUNT = r"\d[\d,]*(?:\.\d+)?(?:e-?\d+)?|\.\d+"
WITH_UNIT = re.compile(rf"(?<![\w.\-/])[−±-]?((?:{AMOUNT})\s?(?:{'|'.join(UNITS)}))(?![\w²³/])")
IN_A_TABLE = re.compile(r"(?<![\w.])\d*\.\d+(?![\w.])")
BLOCKS = re.compile(r"<!-- numbers: .*?<!-- end -->", re.DOTALL)
CODE = re.compile(r"^```.*?^```|^(?: {4}[^\n]*\n)+|<!--.*?-->|``.*?``|`[^`]*`|\$\$.*?\$\$|\$[^$\n]*\$|\]\([^)]*\)",
                  re.DOTALL | re.MULTILINE)


def allowed(root: Path) -> dict[str, dict[str, list[str]]]:
    """docs/numbers/allowed.yaml: by page and kind the numbers that no command measures.

    The page `everywhere` allows numbers on all pages. Raises ValueError where a kind is unknown.
    """
    path = root / FOLDER / "allowed.yaml"
    found = yaml.safe_load(path.read_text(encoding="utf-8")) if path.is_file() else None
    for page, kinds in (found or {}).items():
        unknown = sorted(set(kinds) - set(KINDS))
        if unknown:
            raise ValueError(f"{path}: {page} has the kind {unknown[0]}; the kinds are {', '.join(KINDS)}")
    return found or {}


def numbers_in(text: str) -> set[str]:
    """Numbers with a unit, and decimal numbers in the rows of tables, each as it is written, with one blank."""
    found = {" ".join(number.split()) for number in WITH_UNIT.findall(text)}
    for line in text.splitlines():
        if line.lstrip().startswith("|"):
            rest = WITH_UNIT.sub("", line)
            found |= set(IN_A_TABLE.findall(rest))
    return found


def stray_numbers(text: str, kinds: Mapping[str, list[str]], everywhere: Collection[str] = ()) -> list[str]:
    """What is wrong with the numbers of one page: those outside of blocks that are neither in a block of the page nor
    allowed, and allowed ones that the page does not have.
    """
    blocks = " ".join(BLOCKS.findall(text))
    in_blocks, units = set(re.findall(AMOUNT, blocks)), set(re.findall(r"[^\W\d]+[²³]?|%", blocks))
    outside = numbers_in(CODE.sub(" ", BLOCKS.sub("\n", text)))
    permitted = [str(number) for each in kinds.values() for number in each]
    stray = {number for number in outside - set(permitted) - set(everywhere)
             if not (re.match(AMOUNT, number)[0] in in_blocks and set(number.split()[1:]) <= units)}
    unused = {number for number in permitted if number not in outside}
    twice = {number for number in permitted if permitted.count(number) > 1}
    path = FOLDER / "allowed.yaml"
    return [sentence.format(", ".join(sorted(each))) for sentence, each in (
        (f"{{}}: outside of a block; put each into one, or name it in {path} with its kind", stray),
        (f"{{}}: named in {path}, but not on the page", unused), (f"{{}}: named in {path} twice", twice)) if each]
