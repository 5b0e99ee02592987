"""A directory that is written aside and then takes the place of another one, as a whole or not at all."""

from __future__ import annotations

import ctypes
import errno
import os
import shutil
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

ATTEMPTS = 50
EXCHANGE, HERE = 2, -100  # RENAME_EXCHANGE and AT_FDCWD of Linux


@contextmanager
def whole_directory(directory: str | Path, refuse: Callable[[Path], None] = lambda replaced: None) -> Iterator[Path]:
    """A new folder that replaces the directory once everything is written; after an error it is removed.

    The folder lies beside the directory under a name that nobody else has. Of several processes that write the same
    directory at once, one wins whole. Files get the permissions that the user's umask allows.
    refuse: called with the directory that was replaced; if it raises, that directory is put back.
    """
    directory = Path(os.path.realpath(directory))
    directory.parent.mkdir(parents=True, exist_ok=True)
    within = Path(tempfile.mkdtemp(".part", f".{directory.name[:100]}.", directory.parent))
    aside = within / "new"
    try:
        aside.mkdir()
        yield aside
        allowed = aside.stat().st_mode & 0o666  # of a folder made under the user's umask
        for path in aside.rglob("*"):
            if path.is_file():
                path.chmod(allowed | path.stat().st_mode & 0o111)
        _replace(aside, directory, within / "old", refuse)
    finally:
        shutil.rmtree(within, ignore_errors=True)


def _replace(aside: Path, directory: Path, old: Path, refuse: Callable[[Path], None]) -> None:
    for _ in range(ATTEMPTS):
        if directory.exists() and _exchanged(aside, directory):
            try:
                refuse(aside)
            except BaseException:
                _exchanged(aside, directory)
                raise
            return
        try:
            if directory.exists():  # this system cannot exchange them
                os.replace(directory, old)
                refuse(old)
            os.replace(aside, directory)
            return
        except FileNotFoundError:
            continue  # another process has replaced the directory in this moment
        except OSError as error:
            if error.errno not in (errno.ENOTEMPTY, errno.EEXIST):
                raise
            shutil.rmtree(old, ignore_errors=True)
        finally:
            if old.exists() and not directory.exists():
                os.replace(old, directory)
    raise OSError(errno.EBUSY, f"{directory} is replaced by other processes all the time; try again", str(directory))


def _exchanged(one: Path, other: Path) -> bool:
    """Exchange two directories in one step; False where the system cannot, or where one is missing."""
    try:
        rename = ctypes.CDLL(None, use_errno=True).renameat2
    except (AttributeError, OSError, TypeError):
        return False
    return rename(HERE, os.fsencode(one), HERE, os.fsencode(other), EXCHANGE) == 0
