"""Tables from the bags of ROS 1 and ROS 2: SQLite, MCAP and .bag."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import fields, is_dataclass
from pathlib import Path

import numpy as np

from ssmr_torch.extras import require
from ssmr_torch.recording_files.foreign_files import ROSBAGS
from ssmr_torch.recording_files.table import Table

FORMAT = "rosbag"
TIME, RECEIVED = "time", "received"
LONGEST = 256        # values of one array of a message that become columns
METRES = (  # as the messages of ROS define them
    "position/x", "position/y", "position/z", "translation/x", "translation/y", "translation/z", "point/x", "point/y",
    "point/z")
NEWTONS = ("force/x", "force/y", "force/z")


def read(path: Path) -> list[Table]:
    """A table for each topic of a bag, named after it, with columns such as tip/pose/position/x of /tip.

    time: int64 ns, the stamp of the header where a message has one, else when it was received; received: the latter.
    Every message whose fields are numbers is read: PoseStamped, PointStamped, TransformStamped, JointState (columns by
    the names of the joints), Float64, Float64MultiArray, WrenchStamped, … A transform message has a table for each
    frame.
    Raises ValueError for a damaged bag or one without numbers; ModuleNotFoundError without the extra rigs.
    """
    require("rosbags")
    if path.is_file() and path.suffix not in ROSBAGS:
        with path.open("rb") as file:
            head = file.read(16)
        suffix = next(suffix for suffix, mark in ROSBAGS.items() if head.startswith(mark))
        raise ValueError(f"{path.name} is a rosbag; name it {path.stem}{suffix}, as ROS does")
    try:
        messages = _messages(path)
    except Exception as error:  # the library raises many kinds for damaged bags
        raise ValueError(f"{path.name} cannot be read as a rosbag ({type(error).__name__}: {str(error)[:120]}); copy "
                         "or record it again, or convert it: ros2 bag convert") from error
    tables = [table for topic, rows in messages.items() if (table := _table(topic, rows)) is not None]
    if not tables:
        raise ValueError(f"{path.name} holds no topic of numbers; its topics are {sorted(messages)}")
    return tables


def _messages(path: Path) -> dict[str, list[dict[str, object]]]:
    """The fields of every message by topic, and by child frame of transforms."""
    from rosbags.highlevel import AnyReader
    from rosbags.typesys import Stores, get_typestore

    found: dict[str, list[dict[str, object]]] = {}
    with AnyReader([path], default_typestore=get_typestore(Stores.ROS2_JAZZY)) as reader:
        known = [each for each in reader.connections if each.msgtype in reader.typestore.fielddefs]
        for connection, received, raw in reader.messages(connections=known):
            message = reader.deserialize(raw, connection.msgtype)
            for part in getattr(message, "transforms", [message]):
                topic = connection.topic if part is message else f"{connection.topic}/{part.child_frame_id}"
                found.setdefault(topic, []).append(
                    {TIME: _stamp(part, received), RECEIVED: received, **dict(_fields(part))})
    return found


def _stamp(message, received: int) -> int:
    stamp = getattr(getattr(message, "header", None), "stamp", None)
    nanoseconds = 0 if stamp is None else int(stamp.sec) * 10**9 + int(getattr(stamp, "nanosec", 0))
    return nanoseconds or received  # an empty header has the stamp 0


def _fields(message, before: str = "") -> Iterator[tuple[str, object]]:
    """Numbers in a message by their path; arrays by their places, those of joints by their names."""
    names = getattr(message, "name", None)
    for field in fields(message):
        value, path = getattr(message, field.name), f"{before}{field.name}"
        if field.name in ("header", "layout", "__msgtype__", "covariance", "name", "child_frame_id"):
            continue
        if is_dataclass(value):
            yield from _fields(value, f"{path}/")
        elif isinstance(value, bool | int | float | np.generic):
            yield path, value
        elif isinstance(value, np.ndarray | list) and 0 < len(value) <= LONGEST:
            labels = names if isinstance(names, list) and len(names) == len(value) else range(len(value))
            for label, each in zip(labels, value):
                if is_dataclass(each):
                    yield from _fields(each, f"{path}/{label}/")
                elif not isinstance(each, str):
                    yield f"{path}/{label}", each


def _table(topic: str, rows: list[dict[str, object]]) -> Table | None:
    names = list(dict.fromkeys(name for row in rows for name in row))
    if len(names) == 2:
        return None
    columns, units = {}, {TIME: "ns", RECEIVED: "ns"}
    for name in names:
        values = np.array([row.get(name, np.nan) for row in rows])
        column = name if name in (TIME, RECEIVED) else f"{topic.strip('/')}/{name}"
        columns[column] = values
        unit = "m" if name.endswith(METRES) else "N" if name.endswith(NEWTONS) else None
        units |= {column: unit} if unit else {}
    return Table(columns, "", units, None, FORMAT, (), topic)
