"""The directory of a run belongs to one command at a time: a lock that the system takes away when its process ends."""

from __future__ import annotations

import errno
import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

try:
    import fcntl
except ImportError:  # there are no such locks, and no command is refused
    fcntl = None

LOCK = ".lock"  # only where the file system cannot lock a folder itself, as NFS
UNFINISHED = ".*.part"  # what a killed command has left, see `result_files` and `whole_directory`
RANKS = ("LOCAL_RANK", "NODE_RANK", "SLURM_PROCID")  # of the processes of one distributed training
BUSY = (errno.EWOULDBLOCK, errno.EACCES)

_held: dict[str, int] = {}


class DirectoryInUse(ValueError):
    """Another command works in this directory."""

    def __init__(self, directory: str | Path):
        super().__init__(f"{directory} is the directory of another command, which still runs; wait for its end, or "
                         "give another directory (hydra.run.dir, or hydra.sweep.dir with -m)")


def lock(directory: str | Path, *, shared: bool = False) -> bool:
    """Take the directory for this process, until `release` or its end; it is made where it is missing.

    shared: other processes that share it may have it, too.   Returns whether this call has taken it; False where this
    process has it already, or where this process is a further one of a distributed training.
    Raises DirectoryInUse where another process has it.
    """
    key = str(Path(directory).absolute())
    if fcntl is None or key in _held or any(os.environ.get(rank, "0") not in ("", "0") for rank in RANKS):
        return False
    Path(key).mkdir(parents=True, exist_ok=True)
    handle = _locked(Path(key), os.O_RDONLY, shared)
    _held[key] = _locked(Path(key, LOCK), os.O_RDWR | os.O_CREAT, shared) if handle is None else handle
    if not shared:
        for left in Path(key).glob(UNFINISHED):
            shutil.rmtree(left, ignore_errors=True) if left.is_dir() else left.unlink(missing_ok=True)
    return True


def release(directory: str | Path | None = None) -> None:
    """Give a directory back; None: all of this process."""
    for key in list(_held) if directory is None else [str(Path(directory).absolute())]:
        os.close(_held.pop(key))


@contextmanager
def alone_in(directory: str | Path) -> Iterator[None]:
    """`lock` inside; what this process had before, it keeps."""
    taken = lock(directory)
    try:
        yield
    finally:
        if taken:
            release(directory)


def _locked(path: Path, how: int, shared: bool) -> int | None:
    """The handle that holds the lock; None where the file system cannot lock this kind of file."""
    handle = os.open(path, how)
    try:
        fcntl.flock(handle, (fcntl.LOCK_SH if shared else fcntl.LOCK_EX) | fcntl.LOCK_NB)
    except OSError as error:
        os.close(handle)
        if error.errno in BUSY:
            raise DirectoryInUse(path.parent if path.name == LOCK else path) from error
        return None
    return handle
