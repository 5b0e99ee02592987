"""The arrays of a model in one safetensors file, whose metadata say which model they belong to."""

from __future__ import annotations

import json
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
from safetensors import SafetensorError, safe_open
from safetensors.numpy import save

from ssmr_torch.models.base import Model
from ssmr_torch.named_classes import class_named
from ssmr_torch.result_files import save_bytes


def class_of(model: Model) -> str:
    return f"{type(model).__module__}:{type(model).__qualname__}"


def save_arrays(path: Path, arrays: dict[str, np.ndarray], metadata: dict[str, str] | None = None) -> None:
    """Write arrays to one file; it appears only when it is complete."""
    save_bytes(path, save({name: np.ascontiguousarray(array) for name, array in arrays.items()}, metadata))


def save_tables(path: Path, model: Model, **noted) -> None:
    """Write the arrays to one file. Its metadata hold class and plain values of the model, and the entries `noted`."""
    # One key only: safetensors writes several keys in any order, and the file's hash would change.
    noted = {"class": class_of(model), "plain": model.plain(), **noted}
    save_arrays(path, model.arrays, {"model": json.dumps(noted)})


def stored_arrays(path: Path) -> tuple[dict[str, np.ndarray], dict]:
    """The arrays of a file, and the entries in its metadata. Raises ValueError where the file is damaged."""
    try:
        with safe_open(path, "np") as file:
            noted = json.loads((file.metadata() or {}).get("model", "{}"))
            return {name: file.get_tensor(name) for name in file.keys()}, noted  # noqa: SIM118
    except (SafetensorError, ValueError, TypeError, RecursionError, OSError, AttributeError) as error:
        raise ValueError(f"{path} is damaged ({error}); export the model again") from error


@contextmanager
def needed(path: Path, what: str) -> Iterator[None]:
    """Turn any error that a model raises for missing or wrong arrays into a ValueError that names the file."""
    try:
        yield
    except (TypeError, LookupError, ValueError, AttributeError, ArithmeticError, MemoryError, RecursionError) as error:
        raise ValueError(f"{path} does not hold what {what} needs ({error}); export the model again") from error


def load_tables(path: Path) -> tuple[Model, dict]:
    """The model in a file of `save_tables`, and the entries in its metadata. Raises ValueError for any other file.
    """
    arrays, noted = stored_arrays(path)
    if not isinstance(noted, dict) or not {"class", "plain"} <= noted.keys() or not isinstance(noted["plain"], dict):
        raise ValueError(f"{path} does not say which model its tables belong to; export the model again")
    try:
        family = class_named(noted["class"], Model)
    except (ImportError, AttributeError) as error:
        raise ValueError(f"{path} holds a model of the class {noted['class']}, which is not installed here ({error}); "
                         "install its package") from error
    except ValueError as error:
        raise ValueError(f"{path} holds a model of the class {noted['class']}: {error}") from error
    except TypeError as error:
        raise ValueError(f"{path} names the class {str(noted['class'])[:100]}, which is not a model; export the model "
                         "again") from error
    with needed(path, f"a {family.__name__}"):
        return family.from_plain(arrays, noted["plain"]), noted
