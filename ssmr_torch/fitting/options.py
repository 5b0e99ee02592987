"""Keyword options of a fit, by the names that its configuration has."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from difflib import get_close_matches

SECTIONS = ("model", "module")  # looked through for a flat name, and every step of `fit`
TOP = ("outputs",)              # keys beside the sections


def dotted(options: Mapping[str, object], configuration: Mapping) -> dict[str, object]:
    """The dotted name in a composed configuration, plain values, of each option, with its value.

    An option is named by its dotted name, or by the last part of it where no other section has a key of that name:
    state_dim is model.state_dim, transient is module.transient, ridge is fit.closed_form.ridge.
    Raises TypeError for a name that several sections have, with all of them, or none has, with the nearest.
    """
    known = list(_names(configuration))
    return {_found(name, known, configuration): value for name, value in options.items()}


def _names(configuration: Mapping) -> Iterator[str]:
    """Dotted names of what a flat name may mean."""
    yield from (name for name in TOP if name in configuration)
    sections = {name: configuration[name] for name in SECTIONS} | {
        f"fit.{step}": keys for step, keys in configuration["fit"].items()}
    for section, keys in sections.items():
        yield from (f"{section}.{key}" for key in keys or {} if not key.startswith("_"))


def _found(name: str, known: list[str], configuration: Mapping) -> str:
    if "." in name:
        if not _exists(name, configuration):
            raise TypeError(f"the configuration has no {name}; {_nearest(name, known)}")
        return name
    meant = [each for each in known if each.rpartition(".")[2] == name]
    if len(meant) > 1:
        raise TypeError(f"{name} may be {' or '.join(meant)}; say which, as in **{{{meant[0]!r}: …}}")
    if not meant:
        raise TypeError(f"no option {name}; {_nearest(name, known)}")
    return meant[0]


def _exists(name: str, configuration: Mapping) -> bool:
    node = configuration
    for part in name.split("."):
        if not isinstance(node, Mapping) or part not in node:
            return False
        node = node[part]
    return True


def _nearest(name: str, known: list[str]) -> str:
    """What may have been meant, and all that there is."""
    last = name.rpartition(".")[2]
    ends = [each.rpartition(".")[2] for each in known]
    near = get_close_matches(last, ends, n=1, cutoff=0.0)[0]
    return (f"did you mean {' or '.join(each for each in known if each.rpartition('.')[2] == near)}? "
            f"There are {', '.join(known)}")
