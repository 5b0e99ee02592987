"""The benchmarks by name: what each measures, in a sentence, and its settings with their defaults. Imports none."""

from __future__ import annotations

import ast
import difflib
from pathlib import Path

from ssmr_torch.defaults_of_signatures import keyword_defaults

NAMES = ("fit", "step", "comparison", "scaling", "endurance", "hostile", "plant", "robots", "obstacles", "designed",
         "disturbed", "libraries")


def settings_of(name: str) -> dict:
    """Settings of a benchmark with their defaults, plain values."""
    return keyword_defaults(f"ssmr_torch.benchmarks.{name}.rows")


def sentence_of(name: str) -> str:
    """What a benchmark measures: the first line of its file."""
    text = Path(__file__).with_name(f"{name}.py").read_text(encoding="utf-8")
    return ast.get_docstring(ast.parse(text)).splitlines()[0]


def listed() -> str:
    """What `ssmr benchmark` prints: every benchmark with its sentence."""
    width = max(map(len, NAMES))
    return "\n".join(["ssmr benchmark NAME [key=value …]: one table, also as CSV and JSON", "",
                      *(f"  {name:<{width}}  {sentence_of(name)}" for name in NAMES), "",
                      "ssmr benchmark NAME --cfg job    the settings of a benchmark and their defaults"])


def as_overrides(arguments: list[str]) -> list[str]:
    """Arguments of the command as Hydra takes them: NAME becomes benchmark=NAME, also in --help.

    Raises ValueError for a name that is none, with the list and the nearest one.
    """
    if not arguments or arguments[0].startswith("-") or "=" in arguments[0]:
        return arguments
    name = arguments[0].replace("-", "_")
    if name not in NAMES:
        near = difflib.get_close_matches(name, NAMES, n=1)
        raise ValueError(f"there is no benchmark {arguments[0]!r}{f'; did you mean {near[0]}?' if near else ''}\n"
                         f"the benchmarks are {', '.join(NAMES)}; ssmr benchmark says what they measure")
    return [f"benchmark={name}", *arguments[1:]]
