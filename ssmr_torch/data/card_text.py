"""The YAML of cards: keys once, and names as they are written."""

from __future__ import annotations

import re

import yaml

# What YAML 1.1 makes of names such as 001, 1:30, 2024-03-01, 1_000, on and no is not what a person means.
WHOLE = re.compile(r"[-+]?(?:0|[1-9][0-9]*)\Z")
BOOLEAN = re.compile(r"(?:true|True|TRUE|false|False|FALSE)\Z")
NUMBER = re.compile(r"""(?:[-+]?(?:[0-9]+\.[0-9]*|\.[0-9]+)(?:[eE][-+]?[0-9]+)?|[-+]?\.(?:inf|Inf|INF)
                        |\.(?:nan|NaN|NAN))\Z""", re.VERBOSE)
TAG = "tag:yaml.org,2002:"
RESOLVED = {f"{TAG}int": WHOLE, f"{TAG}bool": BOOLEAN, f"{TAG}float": NUMBER}


class _Loader(yaml.SafeLoader):
    """Refuses a key that stands twice, and keeps as text what only looks like a date, an octal number or a time."""

    yaml_implicit_resolvers = {
        first: [(tag, RESOLVED[tag] if tag in RESOLVED else pattern) for tag, pattern in resolvers
                if tag != f"{TAG}timestamp"]
        for first, resolvers in yaml.SafeLoader.yaml_implicit_resolvers.items()}

    def compose_mapping_node(self, anchor):
        node = super().compose_mapping_node(anchor)
        lines: dict[str, int] = {}
        for key, _ in node.value:
            if not isinstance(key, yaml.ScalarNode) or key.tag == f"{TAG}merge":
                continue
            name, line = str(key.value), key.start_mark.line + 1
            if name in lines:
                where = f"lines {lines[name]} and {line}" if lines[name] != line else f"both in line {line}"
                raise ValueError(f"{name} twice, {where}; a key stands once, so join the two or leave one out")
            lines[name] = line
        return node


def content_of(text: str) -> object:
    """What a card's YAML holds. Raises ValueError for a key that stands twice, with its lines; yaml.YAMLError for other
    text.
    """
    try:
        return yaml.load(text, _Loader)  # a safe loader
    except RecursionError:
        raise ValueError("its brackets or lists lie too deep in each other; expected keys and values, as in "
                         "{length: mm}") from None
