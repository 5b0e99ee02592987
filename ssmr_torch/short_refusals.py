"""What Hydra and OmegaConf say of a wrong command line or configuration, in one sentence that names the key."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from difflib import get_close_matches

from hydra.errors import HydraException, InstantiationException
from omegaconf.errors import OmegaConfBaseException

MOST = 12       # options that a sentence lists
LONGEST = 300   # characters of what a library says
OF_THE_COMMAND_LINE = (HydraException, OmegaConfBaseException)
FAULTS_OF_SETTINGS = (ValueError, OSError, TypeError, ArithmeticError, LookupError, AttributeError, ImportError,
                      MemoryError, RuntimeError)


def in_one_sentence(error: BaseException, words: Sequence[str] = ()) -> str:
    """The sentence of an exception of Hydra or OmegaConf, or of what building a configured object raised.

    words: of the command line, for an exception that does not name the one that it is about.
    """
    said = str(error)
    if "Config group override must be a string" in said:
        wrong = next((word for word in words if re.fullmatch(r"[\w/@]*=([-+.\d].*|\{.*|true|false)", word)), "a group")
        return f"{wrong} is no option; expected the name of one: ssmr COMMAND --help lists them"
    if isinstance(error, ValueError) and not isinstance(error, OF_THE_COMMAND_LINE):
        return said
    if option := re.search(r"Could not find '([^']+)'(?s:.*?)Available options in '[^']*':\s*(.*)", said, re.S):
        return _no_option(option[1], option[2].split("Config search path")[0].split())
    if isinstance(error, InstantiationException):
        return _not_built(error)
    for each in _chain(error):
        parent, key = getattr(each, "parent_node", None), getattr(each, "full_key", None)
        if "is not in struct" in str(each) and key:
            known = [str(name) for name in parent if name != "hydra"] if isinstance(parent, Mapping) else []
            return _no_key(str(key), known)
    if missing := re.search(r"Could not override '([^']+)'\. No match in the defaults list", said):
        return f"{missing[1]} is no group of options of this command; ssmr COMMAND --help lists them"
    key = next((str(key) for each in _chain(error) if (key := getattr(each, "full_key", None))), "")
    first = _line(str(error.__cause__ or error) if "Error merging override" in said else said)
    where = getattr(error, "override", None) or key
    if override := re.search(r"Error (?:parsing|merging) override '([^']*)'", said):
        where = override[1]
    return first if not where or where in first else f"{where}: {first}"


def _no_option(path: str, options: list[str]) -> str:
    group, _, name = path.rpartition("/")
    near = get_close_matches(name, options, n=MOST, cutoff=0.0 if len(options) > MOST else 1.0)
    more = f", and {len(options) - MOST} more" if len(options) > MOST else ""
    hint = get_close_matches(name, options, n=1)
    return (f"{group}={name} is no option{f'; did you mean {group}={hint[0]}?' if hint else ''} "
            f"The options are {', '.join(sorted(near) if more else options)}{more}")


def _no_key(key: str, known: list[str]) -> str:
    near = get_close_matches(key.rpartition(".")[2], known, n=1)
    place = key.rpartition(".")[0]
    hint = f"did you mean {f'{place}.' if place else ''}{near[0]}?" if near else (
        f"expected one of {', '.join(known[:MOST])}{' …' if len(known) > MOST else ''}" if known else
        "--cfg job shows all settings")
    return f"{key} is no setting of this command; {hint}"


def _not_built(error: InstantiationException) -> str:
    """What is wrong with a configured object that could not be built: the sentence of its own error, where it has one.
    """
    cause = error.__cause__ or error
    key = re.search(r"full_key: (\S+)", str(error))
    if isinstance(cause, (ValueError, OSError)) and not isinstance(cause, OmegaConfBaseException):
        return str(cause)
    return f"{key[1] if key else 'a setting'} cannot be built: {_line(str(cause) or type(cause).__name__)}"


def built_wrongly(error: BaseException) -> bool:
    """Whether an exception says that a configured object could not be built from its settings."""
    return isinstance(error, InstantiationException) and isinstance(error.__cause__ or error, (
        *FAULTS_OF_SETTINGS, *OF_THE_COMMAND_LINE))


def _line(text: str) -> str:
    """The first line of a text that says something, shortened."""
    lines = [" ".join(line.split()) for line in text.splitlines() if line.strip()]
    first = lines[0] if lines else "no more is known"
    if first.endswith(":") and len(lines) > 1:
        first = f"{first} {lines[1]}"
    return first if len(first) <= LONGEST else f"{first[:LONGEST]}…"


def _chain(error: BaseException | None) -> Iterator[BaseException]:
    while error is not None:
        yield error
        error = error.__cause__ or error.__context__
