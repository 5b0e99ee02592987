"""The command: `ssmr NAME …` is `python experiments/NAME.py …`, from the checkout and from the wheel alike.

Here nothing heavy is imported: help, version and refusals come at once, Hydra only with an entry point.
"""

from __future__ import annotations

import ast
import difflib
import os
import sys
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path

from ssmr_torch import __version__
from ssmr_torch.extras import remedy, require
from ssmr_torch.interruption import ended_in_order
from ssmr_torch.quiet_libraries import print_anything
from ssmr_torch.renamed import COMMANDS as RENAMED
from ssmr_torch.renamed import SINCE, refuse_old_names

OF_THE_PAPER = ("delay-study", "reproduce") if find_spec("ssmr_torch.paper") else ()  # paper/ can be deleted
COMMANDS = ("collect", "read", "check", "train", "compare", "export", "evaluate", "design", "control", "commission",
            "serve-controller", "serve-plant", "report", *OF_THE_PAPER, "benchmark", "faults", "docs-numbers")
SEARCH = "search="
OF_FILES = {"read": "files"}  # commands whose arguments without key are files, and the key that they mean
COMPLETION = ("-sc", "--shell-completion")  # as Hydra has it


def main() -> int | None:
    """The command line; returns the exit status, or what the entry point returns. Bad input ends in one message."""
    print_anything()
    arguments = sys.argv[1:]
    first = arguments[0] if arguments else "--help"
    if first in ("-h", "--help"):
        print(usage())
        return 0
    if first == "--version":
        print(f"ssmr_torch {__version__}")
        return 0
    if first in COMPLETION:
        return complete(arguments)
    if first in RENAMED:
        print(f"ssmr: {first} is {RENAMED[first]} since version {SINCE}", file=sys.stderr)
        return 2
    if first.replace("_", "-") not in COMMANDS:
        near = difflib.get_close_matches(first, COMMANDS, n=1)
        print(f"ssmr: there is no command {first!r}{f'; did you mean {near[0]}?' if near else ''}\n"
              f"the commands are {', '.join(COMMANDS)}; ssmr --help says what they do", file=sys.stderr)
        return 2
    try:
        refuse_old_names(arguments[1:])
    except ValueError as error:
        print(f"ssmr {first}: {error}", file=sys.stderr)
        return 2
    with ended_in_order(first):
        return start(first, with_files(first, arguments[1:]))


def start(command: str, arguments: list[str], program: str | None = None) -> int | None:
    """Run an entry point with these arguments, under the name of its script, with which it can start itself again."""
    sys.argv = [program or str(script(command)), *arguments]
    try:
        if any(argument.startswith(SEARCH) for argument in arguments):
            require("optuna")  # else Hydra says only that it has no such sweeper
        entry = module_of(command).main
    except ModuleNotFoundError as error:
        if remedy(error) is None:
            raise
        print(f"ssmr {command}: {remedy(error)}", file=sys.stderr)
        return 1
    entry()
    return 0


def module_of(command: str):
    """The script of a command as a module."""
    return import_module(f"ssmr_torch.experiments.{script(command).stem}")


def with_files(command: str, arguments: list[str]) -> list[str]:
    """The arguments, with files that are named without a key under the key that the command has for them."""
    key = OF_FILES.get(command)
    options = [before.startswith("-") and "=" not in before for before in ["", *arguments]]
    files = [argument for argument, of_option in zip(arguments, options) if key and not of_option
             and not argument.startswith("-") and ("=" not in argument or Path(argument).exists())]
    if not files:
        return arguments
    quoted = ("'" + file.replace("'", "\\'") + "'" for file in files)
    return [*(argument for argument in arguments if argument not in files), f"{key}=[{','.join(quoted)}]"]


def script(command: str) -> Path:
    folder = find_spec("ssmr_torch.experiments").submodule_search_locations[0]
    return Path(folder, f"{command.replace('-', '_')}.py")


def usage() -> str:
    """What `ssmr --help` prints: every command with the first sentence of its script."""
    texts = {name: script(name).read_text(encoding="utf-8") for name in COMMANDS}
    said = {name: ast.get_docstring(ast.parse(text)).splitlines()[0] for name, text in texts.items()}
    width = max(map(len, said))
    return "\n".join([
        "ssmr COMMAND [key=value …]: learn the dominant dynamics of a robot from trajectories, and control it", "",
        *(f"  {name:<{width}}  {sentence}" for name, sentence in said.items()), "",
        "ssmr COMMAND --help       the options of a command; --cfg job shows its configuration",
        "ssmr COMMAND --config-dir DIR …   groups of configuration of your own, beside those of the package",
        "eval \"$(ssmr -sc install=bash)\"    completion of commands and options in this shell; also zsh, fish",
        "ssmr --version"])


def complete(arguments: list[str]) -> int | None:
    """Hydra's shell completion: the shell asks with the line so far in COMP_LINE, of which the command is the start."""
    _, *words = os.environ.get("COMP_LINE", "").split(" ")
    if not any(argument.startswith("query=") for argument in arguments):
        return start(COMMANDS[0], arguments, program="ssmr")
    if len(words) < 2:
        print("\n".join(COMMANDS) if "query=fish" in arguments else " ".join(COMMANDS))
        return 0
    if words[0].replace("_", "-") not in COMMANDS:
        return 0
    os.environ["COMP_LINE"] = " ".join(["ssmr", *words[1:]])
    return start(words[0], arguments, program="ssmr")
