"""The files that a recording card names, by patterns as well, and the names of the runs in them."""

from __future__ import annotations

import difflib
import logging
from collections import Counter
from collections.abc import Sequence
from pathlib import Path

from ssmr_torch.data.assembly import fingerprint

logger = logging.getLogger(__name__)

WILD = ("*", "?", "[")


def found_files(card: Path, names: Sequence[str]) -> list[Path]:
    """The files in the order of the card, those of a pattern sorted by name; relative to the card's folder.

    Raises FileNotFoundError for a pattern or name that nothing matches, with the nearest that is there.
    """
    folder, found = card.parent, []
    for name in names:
        path = folder / name
        if path.exists() or not any(sign in name for sign in WILD):
            matched = [path]
        else:
            matched = sorted(each for each in _matched(folder, name) if each.is_file() and each != card)
            if not matched:
                raise FileNotFoundError(f"no file matches {name!r} in {folder}; it holds {_listed(folder)}")
            logger.info("%s: %d files, %s", name, len(matched), ", ".join(map(str, _relative(matched, folder))))
        found += [each for each in matched if each not in found]
    missing = next((path for path in found if not path.exists()), None)
    if missing is not None:
        near = difflib.get_close_matches(missing.name, [each.name for each in _inside(missing.parent)], n=1)
        raise FileNotFoundError(f"no file {missing}; "
                                f"{f'did you mean {near[0]!r}?' if near else 'check the folder and the name'}")
    return found


def names_of_files(files: Sequence[Path], folder: Path) -> dict[Path, str]:
    """Names of the runs by file: the stem where it is the only one, else the path below the card without or, where that
    is not enough, with the ending: day1/r and day2/r.
    """
    stems = Counter(path.stem for path in files)
    below = dict(zip(files, _relative(files, folder)))
    short = Counter(each.with_suffix("") for each in below.values())
    return {path: path.stem if stems[path.stem] == 1 else
            (where.with_suffix("") if short[where.with_suffix("")] == 1 else where).as_posix()
            for path, where in below.items()}


def digests(card: Path, files: Sequence[Path]) -> dict[str, str]:
    """SHA-256 of the card and of every file, by its name, or by its path below the card where two share a name."""
    parts = [each for path in files for each in (sorted(filter(Path.is_file, path.iterdir())) if path.is_dir()
                                                 else [path])]
    shared = Counter(path.name for path in (card, *parts))
    named = {card.name if shared[card.name] == 1 else "./" + card.name: card}
    for path, where in zip(parts, _relative(parts, card.parent)):
        named[path.name if shared[path.name] == 1 else where.as_posix()] = path
    return {name: fingerprint(path)[path.name] for name, path in named.items()}


def _matched(folder: Path, pattern: str) -> list[Path]:
    absolute = Path(pattern)
    return list(Path(absolute.anchor).glob(str(absolute.relative_to(absolute.anchor)))) if absolute.is_absolute() \
        else list(folder.glob(pattern))


def _relative(files: Sequence[Path], folder: Path) -> list[Path]:
    """Paths below the folder, else what tells files elsewhere apart: the last folder and the name."""
    return [path.relative_to(folder) if path.is_relative_to(folder) and ".." not in path.parts
            else Path(*path.parts[-2:]) for path in files]


def _inside(folder: Path) -> list[Path]:
    return sorted(folder.iterdir()) if folder.is_dir() else []


def _listed(folder: Path) -> str:
    names = [path.name for path in _inside(folder)]
    return ", ".join(names[:10]) + (", …" if len(names) > 10 else "") if names else "nothing"
