"""The small recordings as measurement systems export them: text of Motive, Qualisys and Vicon, C3D, rosbag2."""

from __future__ import annotations

import sqlite3
import struct
from pathlib import Path

import numpy as np

from ssmr_torch.faults.made_recordings import small_recordings
from ssmr_torch.result_files import save_bytes, save_text

RATE = 100.0
COUNT = 20


def positions() -> np.ndarray:
    """(20, 3) mm."""
    return small_recordings().runs["m"].y


def rows_of(*columns) -> list[list]:
    return [list(row) for row in zip(*columns)]


def motive(path: Path, *, version: str = "1.23", units: str = "Millimeters", scale: float = 1.0, body: bool = False,
           hidden: int | None = None, rotation: str = "Quaternion") -> None:
    """A take with the markers tip and base; from version 1.24 on there is a row of parents.

    body: a rigid body with its rotation before them. hidden: a row in which the tip has blank cells.
    """
    y = positions() * scale
    angles = "XYZW" if rotation == "Quaternion" else "XYZ"
    columns: list[tuple[str, str, str, str, list]] = []  # type, name, what, axis, values
    if body:
        columns += [("Rigid Body", "head", "Rotation", axis, [0.1] * COUNT) for axis in angles]
        columns += [("Rigid Body", "head", "Position", axis, list(7.0 + y[:, k])) for k, axis in enumerate("XYZ")]
        columns += [("Rigid Body", "head", "Mean Marker Error", "", [0.0003] * COUNT)]
    columns += [("Marker", "tip", "Position", axis, list(y[:, k])) for k, axis in enumerate("XYZ")]
    columns += [("Marker", "base", "Position", axis, [float(k)] * COUNT) for k, axis in enumerate("XYZ")]
    head = [f"Format Version,{version},Take Name,m,Take Notes,,Capture Frame Rate,100.000000,"
            f"Export Frame Rate,100.000000,Capture Start Time,2024-05-01 10.00.00.000 AM,Capture Start Frame,0,"
            f"Total Frames in Take,{COUNT},"
            f"Total Exported Frames,{COUNT},Rotation Type,{rotation},Length Units,{units},Coordinate Space,Global", ""]
    told = [(",Type", 0), (",Name", 1), (",ID", 1), (",", 2)] if float(version) < 1.24 else \
        [(",Type", 0), (",Name", 1), (",ID", 1), (",Parent", 4), (",", 2)]
    for label, which in told:
        cells = ["" if which == 4 else column[which] for column in columns]
        head.append(",".join([label.lstrip(",") and f",{label[1:]}" or ",", *cells]))
    head.append(",".join(["Frame,Time (Seconds)", *(column[3] for column in columns)]))
    body_rows = []
    for k in range(COUNT):
        cells = ["" if column[1] == "tip" and k == hidden else f"{column[4][k]:.6f}" for column in columns]
        body_rows.append(",".join([str(k), f"{k / RATE:.6f}", *cells]))
    save_text(path, "\r\n".join([*head, *body_rows]) + "\r\n")


def qualisys(path: Path, *, numbered: bool = False, six: bool = False, frequency: str = "100",
             extra: bool = False) -> None:
    """A file of positions of tip and base; numbered: with Frame and Time and a row that names the columns; six: rigid
    bodies (6D) instead; extra: with the rows that later versions write.
    """
    y = positions()
    head = [f"NO_OF_FRAMES\t{COUNT}", "NO_OF_CAMERAS\t8", f"NO_OF_{'BODIES' if six else 'MARKERS'}\t2",
            f"FREQUENCY\t{frequency}", "NO_OF_ANALOG\t0", "ANALOG_FREQUENCY\t0", "DESCRIPTION\t--",
            "TIME_STAMP\t2024-05-01, 10:00:00.000\t12345.678", f"DATA_INCLUDED\t{'6D' if six else '3D'}"]
    head += ["EVENT\tstart\t1\t0.00000"] if extra else []
    head += ["BODY_NAMES\ttip\tbase" if six else "MARKER_NAMES\ttip\tbase"]
    head += ["TRAJECTORY_TYPES\tMeasured\tMeasured"] if extra else []
    head += ["\t".join(["Frame", "Time", *(f"{m} {a}" for m in ("tip", "base") for a in "XYZ")])] if numbered else []
    rows = [[*([str(k + 1), f"{k / RATE:.5f}"] if numbered else []), *(f"{v:.3f}" for v in y[k]), "0.000", "1.000",
             "2.000"]
            for k in range(COUNT)]
    save_text(path, "\r\n".join([*head, *("\t".join(row) for row in rows)]) + "\r\n")


def vicon(path: Path, *, first: int = 1, devices: bool = False, model: bool = False, hidden: int | None = None,
          unit: str = "mm") -> None:
    """Trajectories of s:tip and s:base; devices: an analog section of 1000 Hz before; model: one of model outputs."""
    y, lines = positions(), []
    if devices:
        lines += ["Devices", "1000", ",,Force Plate - Force,,", "Frame,Sub Frame,Fx,Fy,Fz", ",,N,N,N",
                  *(f"{first + k // 10},{k % 10},0.5,0.25,{k}" for k in range(10 * COUNT)), ""]
    if model:
        lines += ["Model Outputs", "100", ",,s:Angle,,", "Frame,Sub Frame,X,Y,Z", ",,deg,deg,deg",
                  *(f"{first + k},0,1,2,3" for k in range(COUNT)), ""]
    lines += ["Trajectories", "100", ",,s:tip,,,s:base,,", "Frame,Sub Frame,X,Y,Z,X,Y,Z", f",,{','.join([unit] * 6)}"]
    for k in range(COUNT):
        tip = ["", "", ""] if k == hidden else [f"{value:.6g}" for value in y[k]]
        lines.append(",".join([str(first + k), "0", *tip, "0", "1", "2"]))
    save_text(path, "\n".join([*lines, ""]))


def c3d(path: Path, *, analog: int = 0, invalid: int | None = None, units: str = "mm", rate: float = RATE) -> None:
    """Points tip and base as floats, as the manual of the format says: header, parameters, data; little-endian.

    analog: samples of the channel "force" per frame. invalid: a row in which the tip has the residual −1 and zeros.
    """
    groups: list[bytes] = []

    def entry(name: bytes, group: int, content: bytes) -> None:
        groups.append(struct.pack("<bb", len(name), group) + name + struct.pack("<h", 2 + len(content)) + content)

    def parameter(group: int, name: bytes, kind: int, sizes: list[int], data: bytes) -> None:
        entry(name, group, struct.pack("<bB", kind, len(sizes)) + bytes(sizes) + data + b"\0")

    def texts(group: int, name: bytes, values: list[str]) -> None:
        parameter(group, name, -1, [16, len(values)], b"".join(value.encode().ljust(16) for value in values))

    entry(b"POINT", -1, b"\0")
    entry(b"ANALOG", -2, b"\0")
    for name, value in ((b"USED", 2), (b"FRAMES", COUNT), (b"DATA_START", 4)):
        parameter(1, name, 2, [], struct.pack("<h", value))
    for name, number in ((b"SCALE", -1.0), (b"RATE", rate)):
        parameter(1, name, 4, [], struct.pack("<f", number))
    texts(1, b"LABELS", ["tip", "base"])
    parameter(1, b"UNITS", -1, [len(units)], units.encode())
    parameter(2, b"USED", 2, [], struct.pack("<h", 1 if analog else 0))
    parameter(2, b"RATE", 4, [], struct.pack("<f", rate * analog))
    parameter(2, b"GEN_SCALE", 4, [], struct.pack("<f", 1.0))
    parameter(2, b"SCALE", 4, [1], struct.pack("<f", 1.0))
    parameter(2, b"OFFSET", 2, [1], struct.pack("<h", 0))
    texts(2, b"LABELS", ["force"])
    parameters = (struct.pack("<BBBB", 1, 0x50, 2, 84) + b"".join(groups)).ljust(1024, b"\0")
    header = struct.pack("<BBHHHHHfHHf", 2, 0x50, 2, analog, 1, COUNT, 0, -1.0, 4, analog, rate).ljust(512, b"\0")
    frames = []
    for k, (x, y, z) in enumerate(positions()):
        frames.append(struct.pack("<4f", 0, 0, 0, -1.0) if k == invalid else struct.pack("<4f", x, y, z, 0.0))
        frames.append(struct.pack("<4f", 0.0, 1.0, 2.0, 0.0))
        frames.append(struct.pack(f"<{analog}f", *[0.5] * analog))
    data = b"".join(frames)
    save_bytes(path, header + parameters + data.ljust(-(-len(data) // 512) * 512, b"\0"))


def _padded(data: bytes, size: int) -> bytes:
    return data + b"\0" * (-len(data) % size)


def _stamped(nanoseconds: int, frame: str = "world") -> bytes:
    """std_msgs/Header in CDR."""
    name = frame.encode() + b"\0"
    return struct.pack("<iII", nanoseconds // 10**9, nanoseconds % 10**9, len(name)) + name


def pose_stamped(nanoseconds: int, position) -> bytes:
    """geometry_msgs/msg/PoseStamped in CDR."""
    return b"\0\1\0\0" + _padded(_stamped(nanoseconds), 8) + struct.pack("<7d", *position, 0.0, 0.0, 0.0, 1.0)


def float_array(values) -> bytes:
    """std_msgs/msg/Float64MultiArray in CDR."""
    return b"\0\1\0\0" + _padded(struct.pack("<III", 0, 0, len(values)), 8) + struct.pack(f"<{len(values)}d", *values)


def joint_state(nanoseconds: int, names, values) -> bytes:
    """sensor_msgs/msg/JointState in CDR."""
    data = _padded(_stamped(nanoseconds), 4) + struct.pack("<I", len(names))
    for name in names:
        text = name.encode() + b"\0"
        data = _padded(data, 4) + struct.pack("<I", len(text)) + text
    data = _padded(_padded(data, 4) + struct.pack("<I", len(values)), 8) + struct.pack(f"<{len(values)}d", *values)
    return b"\0\1\0\0" + data + struct.pack("<II", 0, 0)


def rosbag(folder: Path, topics: dict[str, tuple[str, list[tuple[int, bytes]]]]) -> Path:
    """A rosbag2 of SQLite with these topics: name → (type, [(ns, message in CDR)]); the path of its file."""
    folder.mkdir()
    path = folder / "m_0.db3"
    base = sqlite3.connect(path)
    base.execute("CREATE TABLE schema(schema_version INTEGER PRIMARY KEY, ros_distro TEXT NOT NULL)")
    base.execute("INSERT INTO schema VALUES (3, 'humble')")
    base.execute("CREATE TABLE topics(id INTEGER PRIMARY KEY, name TEXT NOT NULL, type TEXT NOT NULL, "
                 "serialization_format TEXT NOT NULL, offered_qos_profiles TEXT NOT NULL)")
    base.execute("CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INTEGER NOT NULL, timestamp INTEGER NOT NULL, "
                 "data BLOB NOT NULL)")
    for number, (name, (kind, messages)) in enumerate(topics.items(), 1):
        base.execute("INSERT INTO topics VALUES (?, ?, ?, 'cdr', '')", (number, name, kind))
        base.executemany("INSERT INTO messages(topic_id, timestamp, data) VALUES (?, ?, ?)",
                         [(number, stamp, data) for stamp, data in messages])
    base.commit()
    base.close()
    return path
