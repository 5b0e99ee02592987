"""`read_tables`: the runs in a file of any known format."""

from __future__ import annotations

from pathlib import Path

from ssmr_torch.recording_files.column_files import read_columns
from ssmr_torch.recording_files.table import Table


def read_tables(path: str | Path) -> list[Table]:
    """The runs in a file, one `Table` each.

    Raises FileNotFoundError, or ValueError that names the format and what to do when the file cannot be read.
    """
    return [Table(read_columns(path))]
