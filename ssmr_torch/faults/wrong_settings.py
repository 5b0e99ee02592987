"""Wrong settings of every command, drawn at random: each must be refused in one sentence that names the key.

A draw takes a command line that is right, one key of its configuration, and a value of the wrong type, outside of any
range, not finite, or far too large; or two settings that contradict each other; or a mistake in the words themselves.
"""

from __future__ import annotations

import shutil
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from functools import cache
from math import inf, isfinite, nan
from pathlib import Path

import numpy as np

from ssmr_torch.command_ranges import OF_ANY, OF_COMMANDS
from ssmr_torch.configuration import written
from ssmr_torch.configuration_check import declared, is_left_open
from ssmr_torch.faults.command_lines import CONTRADICTIONS, MISTAKES, CommandLine, command_lines, prepared
from ssmr_torch.faults.commands_in_process import Ended, run_command
from ssmr_torch.ranges import Range, Truth, is_number

LIMIT = 10.0           # s, until which a wrong setting has to be refused
AT_WORK = 2.0          # s, after which a right setting counts as taken: the work itself may be long
LINES, CHARACTERS = 3, 420
HUGE = 1e299           # no quantity is as large
VALUES = (nan, inf, -inf, 0, -1, 1.5, 0.5, 1e300, -1e300, 1e-300, 10**9, 10**30, 3, 1.0e-3, "abc", "", [], [1, 2],
          [nan], ["abc"], [[1.0]], {"a": 1}, {}, True, False, None, "nan.0", "1,5")
PREFERRED = (nan, inf, 0, -1, 1.5, 1e300, "abc", None, [1, 2], {"a": 1})


def wrong_settings(count: int, seed: int) -> list[dict]:
    """Run `count` random cases, and say of each what came of it.

    Each is a mapping: kind ("value", "contradiction" or "mistake"), case (the command line), outcome, said.
    outcome: "refused": in a sentence of at most three lines that names the key; "survived": the value was a legal one;
    "wrong": accepted, or refused without the key or too long; "traceback"; "hang": no refusal within 10 s.
    """
    folder = Path(tempfile.mkdtemp(prefix="wrong_settings_"))
    try:
        files = prepared(folder, lambda command, overrides: _must_work(command, overrides, folder))
        rng = np.random.default_rng(seed)
        return [judged(_drawn(rng, files), folder / "run") for _ in range(count)]
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def judged(case: dict, directory: Path) -> dict:
    """Run one case of `_drawn` and judge it."""
    limit = AT_WORK if case["legal"] else LIMIT
    ended = run_command(case["command"], case["overrides"], directory, limit)
    shutil.rmtree(directory, ignore_errors=True)
    line = " ".join(["ssmr", case["command"].replace("_", "-"), *case["overrides"]])
    outcome, said = verdict(ended, case["legal"], case["names"])
    return {"kind": case["kind"], "case": line, "outcome": outcome, "said": said}


def verdict(ended: Ended, legal: bool, names: Sequence[str]) -> tuple[str, str]:
    """What an ending is worth, given whether the value is legal and which of these words a refusal has to hold."""
    if ended.how == "traceback":
        return "traceback", ended.said
    if ended.how == "refused":
        text = ended.said
        if text.count("\n") >= LINES or len(text) > CHARACTERS:
            return "wrong", f"refused in {text.count(chr(10)) + 1} lines of {len(text)} characters: {text}"
        if not legal and names and not any(name.lower() in text.lower() for name in names):
            return "wrong", f"refused without {' or '.join(names)}: {text}"
        return "refused", text
    if legal:
        return "survived", ended.said
    return ("hang" if ended.how == "late" else "wrong"), ended.said or "accepted"


def _must_work(command: str, overrides: Sequence[str], folder: Path) -> None:
    place = next(each.partition("=")[2] for each in overrides if each.startswith("hydra.run.dir="))
    ended = run_command(command, overrides, Path(place), 600.0)
    if ended.how != "done":
        raise RuntimeError(f"{command} {' '.join(overrides)}: {ended.said}")


def _drawn(rng: np.random.Generator, files: Mapping[str, str]) -> dict:
    """A case: kind, command, overrides, whether it is legal, and the words of which a refusal has to hold one."""
    share = rng.random()
    if share < 0.1:
        line, word = CONTRADICTIONS[rng.integers(len(CONTRADICTIONS))]
        return {"kind": "contradiction", "command": line.command, "overrides": line.filled(files), "legal": False,
                "names": [word]}
    lines = command_lines()
    line = lines[rng.integers(len(lines))]
    given = line.filled(files)
    found = keys(line.command, tuple(given))
    key = sorted(found)[rng.integers(len(found))]
    if share < 0.2 and "." in key:
        return _mistake(rng, line, given, key)
    range_, default = found[key]
    values = PREFERRED if rng.random() < 0.5 else VALUES
    value = values[rng.integers(len(values))]
    same = [each for each in given if each.partition("=")[0] == key]
    overrides = [*(each for each in given if each not in same), f"{'++' if isinstance(value, dict) else ''}{key}="
                 f"{text_of(value)}"]
    return {"kind": "value", "command": line.command, "overrides": overrides,
            "legal": is_legal(range_, default, value), "names": [key.rpartition(".")[2], str(value)]}


def _mistake(rng: np.random.Generator, line: CommandLine, given: list[str], key: str) -> dict:
    word = MISTAKES[rng.integers(len(MISTAKES))].format(key=key, group=key.partition(".")[0])
    return {"kind": "mistake", "command": line.command, "overrides": [*given, word], "legal": False,
            "names": [key.partition(".")[0], word.strip("+~").partition("=")[0] or word]}


def is_legal(range_: Range | None, default, value) -> bool:
    """Whether a key of this range and default may have a value; some values are wrong for every key."""
    if any(each != each or abs(each) > HUGE and each != inf for each in _numbers(value)):
        return False
    if isinstance(range_, Truth) or isinstance(default, bool):
        return isinstance(value, bool)
    if range_ is not None:
        return range_.fits(value)
    return value == default or (default is None or isinstance(default, Mapping)) and value in (None, {})


def _numbers(value) -> Iterator[float]:
    if is_number(value):
        yield value
    for each in value.values() if isinstance(value, Mapping) else value if isinstance(value, list) else ():
        yield from _numbers(each)


@cache
def keys(command: str, overrides: tuple[str, ...]) -> dict[str, tuple[Range | None, object]]:
    """Every key of a configuration that can be set, with its range and its default."""
    config = written(command, overrides)
    return dict(_keys("", config, OF_ANY | OF_COMMANDS.get(command, {}), at_top=True))


def _keys(key: str, node: Mapping, ranges: Mapping[str, Range], at_top: bool) -> Iterator[tuple[str, tuple]]:
    target = node.get("_target_")
    of_target = declared(target)[0] if isinstance(target, str) else None
    for name, value in node.items():
        full = f"{key}.{name}" if key else str(name)
        if str(name).startswith("_") or full in ("hydra", "found", "preset") or not str(name).isidentifier():
            continue
        range_ = ranges.get(full) if of_target is None else of_target.get(name)
        if isinstance(value, Mapping) and value:
            yield from _keys(full, value, ranges, at_top=False)
        elif isinstance(value, list) and any(isinstance(each, Mapping) for each in value):
            yield full, (range_, value)
        elif range_ is not None or of_target is not None:
            yield full, (range_, None if is_left_open(value) else value)
        elif at_top and value is not None:
            yield full, (None, value)


def text_of(value) -> str:
    """A value as a word of the command line."""
    if isinstance(value, dict):
        return "{" + ",".join(f"{key}:{text_of(each)}" for key, each in value.items()) + "}"
    if isinstance(value, list):
        return f"[{','.join(text_of(each) for each in value)}]"
    if value is None or isinstance(value, bool):
        return {None: "null", True: "true", False: "false"}[value]
    if isinstance(value, float):
        return repr(value) if isfinite(value) else str(value)
    return f"'{value}'" if isinstance(value, str) else str(value)


