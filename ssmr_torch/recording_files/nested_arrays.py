"""Tables from files that nest arrays in groups: HDF5, MATLAB, NPZ."""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from typing import NamedTuple

import numpy as np

from ssmr_torch.recording_files.table import Table
from ssmr_torch.recording_files.units_said import unit_called, units_in_names

CLOCKS = ("t", "time", "times", "timestamp", "timestamps", "stamp", "stamps", "seconds", "clock", "frame", "frames")
FEWEST = 2           # rows that an array must have to be a column
WIDEST = 1000        # columns that one array may give


class Leaf(NamedTuple):
    """An array and its unit, "" where the file does not say it."""

    values: np.ndarray
    unit: str = ""


def leaf(values, unit: object = "") -> Leaf | dict | None:
    """The array as a leaf; a structured array as a group of its fields; None for what is no column.

    Dates become int64 ns, text becomes objects.
    """
    values = np.asarray(values)
    if values.dtype.names:
        return {name: each for name in values.dtype.names if (each := leaf(values[name].squeeze())) is not None}
    if values.dtype.kind in "Mm":
        return Leaf(values.astype(f"{values.dtype.kind}8[ns]").astype(np.int64), "ns")
    if values.dtype.kind == "S":
        values = np.char.decode(values, "utf-8", "replace").astype(object)
    elif values.dtype.kind == "U" or (values.dtype.kind == "O" and all(isinstance(v, str) for v in values.flat)):
        values = values.astype(object)
    elif values.dtype.kind not in "fiub":
        return None
    if values.ndim == 0 or max(values.shape) < FEWEST or 0 in values.shape:
        return None
    return Leaf(values, unit_called(unit) or "")


def tables_of(tree: Mapping, format: str, file: str) -> list[Table]:
    """The runs in nested arrays.

    tree: names → leaves, groups of them, or lists of groups. A run is an element of a list, or a group beside others
    with arrays of the same names, and is named after it; else the file is one run, whose columns are named by their
    path. An array y of (T, p) or (p, T) gives y_0 … y_{p-1}. Arrays of another length are a table of the same run with
    a clock of its own.
    Raises ValueError when there is no array of numbers.
    """
    tables = [table for run, content in _runs(tree) for table in _tables(run, _without_common(_flat(content)), format)]
    if not tables:
        raise ValueError(f"{file} holds no numeric dataset; expected one per column, (T,) or (T, p)")
    return tables


def _runs(tree: Mapping) -> list[tuple[str, Mapping]]:
    """Names and contents of the runs."""
    lists = {name: child for name, child in tree.items() if isinstance(child, list) and child}
    if lists:
        return [(f"{name}/{place}" if len(lists) > 1 else f"{place}", child) for name, children in lists.items()
                for place, child in enumerate(children, start=1)]
    groups = {name: child for name, child in tree.items() if isinstance(child, Mapping)}
    leaves = [child for child in tree.values() if isinstance(child, Leaf)]
    if len(groups) == 1 and not leaves:
        (inside,) = groups.values()
        found = _runs(inside)
        return found if len(found) > 1 or found[0][0] else [("", tree)]
    for candidates in (groups, {} if leaves else dict(_groups_of_arrays(tree))):
        alike = _alike(candidates)
        if alike and not _belong_together(alike, leaves):
            return list(alike.items())
    return [("", tree)]


def _groups_of_arrays(tree: Mapping, before: str = "") -> Iterator[tuple[str, Mapping]]:
    """Path and content of every group, at any depth, that holds arrays."""
    for name, child in tree.items():
        if isinstance(child, Mapping):
            if any(isinstance(each, Leaf) for each in child.values()):
                yield f"{before}{name}", child
            else:
                yield from _groups_of_arrays(child, f"{before}{name}/")


def _alike(groups: Mapping[str, Mapping]) -> dict[str, Mapping]:
    """The groups with arrays of the same names as most others, if at least two are."""
    names = {name: frozenset(path for path, _ in _flat(group)) for name, group in groups.items()}
    counts = Counter(each for each in names.values() if each)
    if not counts or max(counts.values()) < 2:
        return {}
    common = counts.most_common(1)[0][0]
    return {name: group for name, group in groups.items() if names[name] == common}


def _belong_together(groups: Mapping[str, Mapping], leaves: list[Leaf]) -> bool:
    """Whether the groups are parts of one run, such as markers, which have no clocks and are as long as each other."""
    flat = [(path, each) for group in groups.values() for path, each in _flat(group)]
    clocked = any(path.rpartition("/")[2].lower() in CLOCKS for path, _ in flat)
    lengths = {max(each.values.shape) for _, each in flat}
    beside = any(max(each.values.shape) in lengths for each in leaves)
    return beside or (not clocked and len(lengths) == 1)


def _flat(tree: Mapping, before: str = "") -> Iterator[tuple[str, Leaf]]:
    """Path and array of every leaf."""
    for name, child in tree.items():
        path = f"{before}{name}"
        if isinstance(child, Leaf):
            yield path, child
        elif isinstance(child, Mapping):
            yield from _flat(child, f"{path}/")


def _without_common(leaves: Iterable[tuple[str, Leaf]]) -> dict[str, Leaf]:
    """Arrays by their path, without a group that holds them all: "t" for "run/t"."""
    leaves = list(leaves)
    common = os.path.commonprefix([path.rpartition("/")[0] + "/" for path, _ in leaves])
    common = common[:common.rfind("/") + 1]
    return {path.removeprefix(common): each for path, each in leaves}


def _tables(run: str, leaves: dict[str, Leaf], format: str) -> list[Table]:
    lengths = _lengths(leaves)
    by_length: dict[int, dict[str, Leaf]] = {}
    for path, each in leaves.items():
        by_length.setdefault(_length(each.values, lengths), {})[path] = each
    found = []
    for length, of_length in sorted(by_length.items(), key=lambda item: -len(item[1])):
        if length < FEWEST:
            continue
        columns, units = {}, {}
        for path, each in of_length.items():
            new = _columns(path, each.values, length)
            columns |= new
            units |= dict.fromkeys(new, each.unit) if each.unit else {}
        if any(column.dtype.kind in "fiub" for column in columns.values()):
            found.append(Table(columns, run, {**units_in_names(columns), **units}, None, format))
    return [found[0]] + [Table(table.columns, run, table.units, None, format, (), f"{table.length} rows")
                         for table in found[1:]] if found else []


def _lengths(leaves: Mapping[str, Leaf]) -> list[int]:
    """Numbers of rows that arrays may have, likeliest first: of vectors, then of what most arrays share."""
    vectors = Counter(each.values.size for each in leaves.values() if each.values.ndim == 1)
    shared = Counter(extent for each in leaves.values() if each.values.ndim > 1
                     for extent in set(each.values.shape[:2]))
    return [*sorted(vectors, key=lambda n: (vectors[n] + shared[n], n), reverse=True),
            *sorted(shared, key=lambda n: (shared[n], n), reverse=True)]


def _length(values: np.ndarray, lengths: list[int]) -> int:
    return next((length for length in lengths if length in values.shape[:2]), 0)


def _columns(path: str, values: np.ndarray, length: int) -> dict[str, np.ndarray]:
    """Columns of an array (T,), (T, p), (p, T) or (T, a, b)."""
    if values.ndim == 1:
        return {path: values}
    if values.shape[0] != length:
        values = values.swapaxes(0, 1)
    if values[0].size > WIDEST:
        return {}
    return {f"{path}_{'_'.join(map(str, place))}": values[(slice(None), *place)]
            for place in np.ndindex(values.shape[1:])}
