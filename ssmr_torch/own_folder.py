"""Where this user can keep what is made again when it is lost: in the home folder, or among the temporary files."""

from __future__ import annotations

import os
import stat
import tempfile
from pathlib import Path


def has_home() -> bool:
    """Whether there is a home folder that can be written. Libraries take "~" for the name of a folder where none is."""
    home = os.path.expanduser("~")
    return os.path.isabs(home) and os.path.isdir(home) and os.access(home, os.W_OK | os.X_OK)


def own_folder() -> Path | None:
    """A folder that only this user can read and write, among the temporary files; None where there is none.

    Its name has the user's number. A folder of this name that belongs to somebody else is not used, because what lies
    there is run.
    """
    user = getattr(os, "getuid", lambda: -1)()
    try:
        folder = Path(tempfile.gettempdir()) / f"ssmr_torch-{user}"
        folder.mkdir(mode=0o700, exist_ok=True)
        found = folder.lstat()
    except OSError:
        return None
    private = user == -1 or found.st_uid == user and not found.st_mode & 0o077
    return folder if private and stat.S_ISDIR(found.st_mode) and os.access(folder, os.W_OK | os.X_OK) else None
