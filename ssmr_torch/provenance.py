"""Provenance of a result: version, commit, time, configuration, and hashes of files."""

from __future__ import annotations

import hashlib
import json
import platform
import subprocess
from datetime import UTC, datetime
from pathlib import Path

from ssmr_torch import __version__


def provenance(configuration: dict | None = None) -> dict:
    """Package version, git commit ("+" when the tree has changes), Python, time, and a configuration with its hash."""
    record = {"package": f"ssmr_torch {__version__}", "commit": _commit(), "python": platform.python_version(),
              "time": datetime.now(UTC).isoformat(timespec="seconds")}
    if configuration is not None:
        text = json.dumps(configuration, sort_keys=True, default=str)
        record |= {"configuration": configuration, "configuration_hash": hashlib.sha256(text.encode()).hexdigest()[:16]}
    return record


def fingerprint(path: str | Path) -> dict:
    """Name and SHA-256 of a file, which is read piece by piece."""
    with open(path, "rb") as file:
        return {"file": Path(path).name, "sha256": hashlib.file_digest(file, "sha256").hexdigest()}


def _commit() -> str | None:
    here = Path(__file__).parent
    try:
        head = subprocess.run(["git", "rev-parse", "--short=12", "HEAD"], cwd=here, capture_output=True,
                              encoding="utf-8", errors="replace", check=True).stdout.strip()
        changed = subprocess.run(["git", "status", "--porcelain", "--untracked-files=no"], cwd=here,
                                 capture_output=True, encoding="utf-8", errors="replace",
                                 check=True).stdout.strip()
    except (OSError, subprocess.CalledProcessError):
        return None
    return head + ("+" if changed else "")
