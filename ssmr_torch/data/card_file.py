"""Cards: YAML files that a user writes, checked key by key, refused in one sentence each."""

from __future__ import annotations

import difflib
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import ClassVar, Self, TypeVar

import yaml
from pydantic import BaseModel, ConfigDict, ValidationError
from pydantic_core import PydanticCustomError

from ssmr_torch.data.card_text import content_of

UNKNOWN, MISSING, SAID = "extra_forbidden", "missing", "value_error"  # types of pydantic's errors
C = TypeVar("C", bound="Card")


class Card(BaseModel):
    """Base of all cards, and of their parts; the fields are the keys of the file, each with its type and its range.

    The `description` of a field says what is expected there; it ends the sentence with which a wrong value is refused.
    part: name of the key whose value this is, where it is a part of a card.
    Raises ValueError in one sentence for a key that is unknown (with the nearest one) or missing, and for a value that
    is not what its field describes.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")
    part: ClassVar[str] = ""

    def __init__(self, **values):
        try:
            super().__init__(**values)
        except ValidationError as error:
            raise ValueError(_sentence(type(self), error, values)) from None

    def changed(self, **changes) -> Self:
        """The same card but for these keys, checked again."""
        return type(self)(**{**dict(self), **changes})

    def text(self) -> str:
        """The card as YAML."""
        return yaml.safe_dump(self.model_dump(), sort_keys=False, allow_unicode=True, default_flow_style=None,
                              width=120)


def not_as_described() -> PydanticCustomError:
    """To be raised by a field's own check: the value is refused with what the field describes."""
    return PydanticCustomError("not_as_described", "not as described")


def read_card(path: str | Path, kind: type[C], page: str) -> C:
    """The card of this kind in a YAML file.

    page: where the keys are explained. Raises FileNotFoundError, and ValueError in one line that begins with the
    name of the file: for text that is not YAML (with the line), and for what the card refuses.
    """
    path = Path(path)
    if not path.is_file():
        raise FileNotFoundError(f"no card at {path}; write one as {page} shows")
    try:
        content = _with_text_keys(content_of(path.read_text(encoding="utf-8")))
        if not isinstance(content, dict):
            raise ValueError(f"the card is {type(content).__name__}; expected keys and values")
        return kind(**content)
    except yaml.MarkedYAMLError as error:
        line = f"line {error.problem_mark.line + 1}: " if error.problem_mark else ""
        raise ValueError(f"{path.name}: {line}{error.problem or error.context}; expected YAML") from error
    except UnicodeDecodeError as error:
        raise ValueError(f"{path.name} is not text; expected a card, in YAML, as {page} shows; ssmr_torch.load "
                         "opens files of this package") from error
    except (ValueError, yaml.YAMLError) as error:
        raise ValueError(f"{path.name}: {' '.join(str(error).split())}") from error


def _with_text_keys(content):
    """YAML reads the key 7 as a number; the keyword arguments of a card are text."""
    return {str(key): _with_text_keys(value) for key, value in content.items()} if isinstance(content, dict) \
        else content


def refuse_unknown(where: str, content: Iterable, known: Iterable[str]) -> None:
    """Raises ValueError for the first key that is not known, with the nearest one that is."""
    known = list(known)
    for key in content:
        if key not in known:
            raise ValueError(_unknown(where, key, known))


def _unknown(where: str, key: object, known: list[str]) -> str:
    nearest = difflib.get_close_matches(str(key), known, n=1, cutoff=0.0)
    return f"{where} has the unknown key {key!r}; did you mean {nearest[0]!r}? Known keys: {', '.join(known)}"


def _sentence(kind: type[Card], error: ValidationError, values: Mapping) -> str:
    """What is wrong, first of all a misspelled key, since the key that was meant is then missing as well."""
    where, found = kind.part or "the card", error.errors(include_url=False)
    unknown, missing = ([str(one["loc"][0]) for one in found if one["type"] == each] for each in (UNKNOWN, MISSING))
    if unknown:
        return _unknown(where, unknown[0], list(kind.model_fields))
    if missing:
        needed = [name for name, field in kind.model_fields.items() if field.is_required()]
        return f"{where} lacks the key {' and '.join(missing)}; it needs {', '.join(needed)}"
    first = found[0]
    if first["type"] == SAID:
        return str(first["ctx"]["error"])
    name = str(first["loc"][0])
    expected = kind.model_fields[name].description or f"another value ({first['msg']})"
    return f"{f'{kind.part}.' if kind.part else ''}{name} is {values.get(name, first['input'])!r}; expected {expected}"
