"""Functions that Numba compiles, kept between processes where there is a place to keep them."""

from __future__ import annotations

import logging
from collections.abc import Callable
from contextlib import suppress
from typing import Any

import numba
from numba.core.caching import FunctionCache

from ssmr_torch.own_folder import has_home, own_folder

log = logging.getLogger(__name__)
_said: set[str] = set()


def compiled(**options: Any) -> Callable:
    """Decorator: `numba.njit` with these options. What it compiles is kept beside the package or in the
    user's home, whichever can be written; without a home in a folder of this user among the temporary files; else in no
    file.

    The variable NUMBA_CACHE_DIR names another folder. A full disk or a damaged file there costs a compilation, nothing
    else.
    """

    def decorate(function):
        made = numba.njit(**options)(function)
        if not has_home() and not numba.config.CACHE_DIR:
            numba.config.CACHE_DIR = str(own_folder() or "")
        for _ in range(2):
            try:
                made._cache = _Kept(function)
                return made
            except (RuntimeError, ValueError, OSError):  # Numba has found no place, or cannot write its name
                numba.config.CACHE_DIR = str(own_folder() or "")
        _say("compiled functions are kept in no file, so that each process compiles them again for some seconds; set "
             "NUMBA_CACHE_DIR to a folder that can be written")
        return made

    return decorate


class _Kept(FunctionCache):
    def load_overload(self, sig, target_context):
        try:
            return super().load_overload(sig, target_context)
        except Exception as error:  # a damaged file raises any type of error
            _say(f"a compiled function cannot be read from {self.cache_path} ({type(error).__name__}: {error}); it is "
                 "compiled again")
            with suppress(Exception):
                self.flush()
            return None

    def save_overload(self, sig, data):
        try:
            super().save_overload(sig, data)
        except Exception as error:
            _say(f"compiled functions cannot be kept in {self.cache_path} ({error})")


def _say(line: str) -> None:
    if line not in _said:
        _said.add(line)
        log.warning(line)
