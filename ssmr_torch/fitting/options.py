"""Finds the full name of a configuration key for each keyword option of `fit`."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from difflib import get_close_matches

SECTIONS = ("model", "module")  # sections with keys that a short name may mean; so does every step of `fit`
TOP = ("outputs",)              # such keys outside the sections


def dotted(options: Mapping[str, object], configuration: Mapping) -> dict[str, object]:
    """The options by their dotted names in a composed configuration (plain values), with their values.

    An option is given by its dotted name, or by the last part of it if no other section has a key of that name:
    state_dim is model.state_dim, transient is module.transient, ridge is fit.closed_form.ridge.
    Raises TypeError for a name that several sections have, and lists them; and for a name that none has, with the
    nearest one.
    """
    known = list(_names(configuration))
    return {_found(name, known, configuration): value for name, value in options.items()}


def _names(configuration: Mapping) -> Iterator[str]:
    """The dotted names that a short name may mean."""
    yield from (name for name in TOP if name in configuration)
    sections = {name: configuration[name] for name in SECTIONS} | {
        f"fit.{step}": keys for step, keys in configuration["fit"].items()}
    for section, keys in sections.items():
        yield from (f"{section}.{key}" for key in keys or {} if not key.startswith("_"))


def _found(name: str, known: list[str], configuration: Mapping) -> str:
    if "." in name:
        if not _exists(name, configuration):
            raise TypeError(f"the configuration has no key {name}; {_nearest(name, known)}")
        return name
    meant = [each for each in known if each.rpartition(".")[2] == name]
    if len(meant) > 1:
        raise TypeError(f"{name} may mean {' or '.join(meant)}; give the full name, for example **{{{meant[0]!r}: …}}")
    if not meant:
        raise TypeError(f"there is no option {name}; {_nearest(name, known)}")
    return meant[0]


def _exists(name: str, configuration: Mapping) -> bool:
    node = configuration
    for part in name.split("."):
        if not isinstance(node, Mapping) or part not in node:
            return False
        node = node[part]
    return True


def _nearest(name: str, known: list[str]) -> str:
    """A sentence with the nearest option and all options."""
    last = name.rpartition(".")[2]
    ends = [each.rpartition(".")[2] for each in known]
    near = get_close_matches(last, ends, n=1, cutoff=0.0)[0]
    return (f"did you mean {' or '.join(each for each in known if each.rpartition('.')[2] == near)}? "
            f"The options are {', '.join(known)}")
