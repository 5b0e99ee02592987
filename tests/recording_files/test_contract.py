"""One claim for all formats: the same samples, written as each system writes them, are read alike."""

import zipfile

import h5py
import numpy as np
import pytest
import scipy.io

from ssmr_torch.recording_files.reading import FORMATS, read_tables

K = np.arange(20)
T, X, Y, Z, U1, U2 = K / 100, 5 + 0.1 * K, -3.0 + 0 * K, 120.0 + 0 * K, 0.01 * K, 0.0 * K
P, U = np.c_[X, Y, Z], np.c_[U1, U2]
STAMPS = 1_700_000_000_000_000_000 + 10_000_000 * K  # ns


def lines(*columns, between=","):
    return "".join(between.join(f"{value:.6g}" for value in row) + "\n" for row in np.c_[*columns])


def csv(folder):
    path = folder / "m.csv"
    path.write_text("t,x,y,z,u1,u2\ns,mm,mm,mm,N,N\n" + lines(T, P, U))
    return path, ["t", "x", "y", "z", "u1", "u2"]


def motive(folder):
    path = folder / "Take 1.csv"
    path.write_text("Format Version,1.23,Take Name,Take 1,Capture Frame Rate,100.000000,Export Frame Rate,100.000000,"
                    "Length Units,Millimeters,Coordinate Space,Global\n\n" + ",,Marker,Marker,Marker,Marker,Marker,"
                    "Marker\n,,tip,tip,tip,base,base,base\n,,1,1,1,2,2,2\n,," + ",".join(["Position"] * 6)
                    + "\nFrame,Time (Seconds),X,Y,Z,X,Y,Z\n" + lines(K, T, P, P[:, :0], U1, U2, 0 * T))
    return path, ["Time (Seconds)", "tip_X", "tip_Y", "tip_Z", "base_X", "base_Y"]


def qualisys(folder):
    path = folder / "m.tsv"
    keys = {"NO_OF_FRAMES": 20, "NO_OF_CAMERAS": 8, "NO_OF_MARKERS": 2, "FREQUENCY": 100, "NO_OF_ANALOG": 0,
            "DESCRIPTION": "--", "DATA_INCLUDED": "3D", "MARKER_NAMES": "tip\tbase"}
    path.write_text("".join(f"{key}\t{value}\n" for key, value in keys.items()) + lines(P, U, 0 * T, between="\t"))
    return path, ["Time", "tip_X", "tip_Y", "tip_Z", "base_X", "base_Y"]


def vicon(folder):
    path = folder / "trial.csv"
    path.write_text("Trajectories\n100\n,,arm:tip,,\nFrame,Sub Frame,X,Y,Z\n,,mm,mm,mm\n" + lines(K + 7, U2, P)
                    + "\nDevices\n200\n,,Valve,\nFrame,Sub Frame,u1,u2\n,,N,N\n"
                    + lines(np.repeat(K + 7, 2), K[:2].tolist() * 20, np.repeat(U, 2, axis=0)))
    return path, ["Time", "tip_X", "tip_Y", "tip_Z", "Valve_u1", "Valve_u2"]


def c3d(folder):
    library = pytest.importorskip("c3d")
    writer = library.Writer(point_rate=100, analog_rate=500)
    for row, inputs in zip(P, U):
        points = np.zeros((3, 5), np.float32)
        points[0, :3] = row
        writer.add_frames([(points, np.repeat(inputs[:, None], 5, axis=1).astype(np.float32))])
    writer.set_point_labels(["arm:tip", "arm:base", "arm:elbow"])
    writer.set_analog_labels(["u1", "u2"])
    writer.point_group.add_str("UNITS", "", "mm", 2)
    with (folder / "m.c3d").open("wb") as file:
        writer.write(file)
    return folder / "m.c3d", ["Time", "tip_X", "tip_Y", "tip_Z", "u1", "u2"]


def hdf5(folder):
    with h5py.File(folder / "m.h5", "w") as file:
        file["t"], file["c"] = T, U
        file.create_dataset("p", data=P).attrs["units"] = "mm"
        file["t"].attrs["units"] = "seconds since 2026-03-01 12:00:00"
        file["c"].attrs["units"] = b"N"
    return folder / "m.h5", ["t", "p_0", "p_1", "p_2", "c_0", "c_1"]


def hdf5_named_mat(folder):
    path, names = hdf5(folder)
    return path.rename(folder / "m.mat"), names


def compound(folder):
    table = np.zeros(20, [(name, float) for name in ("t", "x", "y", "z", "u1", "u2")])
    for name, column in zip(table.dtype.names, (T, X, Y, Z, U1, U2)):
        table[name] = column
    with h5py.File(folder / "m.h5", "w") as file:
        file["table"] = table
    return folder / "m.h5", list(table.dtype.names)


def matlab_5(folder):
    scipy.io.savemat(folder / "m.mat", {"t": T, "y": P, "u": U.T, "rate": 100.0, "who": "me"})
    return folder / "m.mat", ["t", "y_0", "y_1", "y_2", "u_0", "u_1"]


def matlab_struct(folder):
    scipy.io.savemat(folder / "m.mat", {"run": {"t": T[:, None], "y": P.T, "u": U}})
    return folder / "m.mat", ["t", "y_0", "y_1", "y_2", "u_0", "u_1"]


def matlab_7_3(folder):
    """As MATLAB writes it: a user block that names the version, arrays with their dimensions reversed."""
    with h5py.File(folder / "m.mat", "w", userblock_size=512) as file:
        for name, values in {"t": T[:, None], "y": P, "u": U}.items():
            file.create_dataset(name, data=values.T).attrs["MATLAB_class"] = np.bytes_("double")
        file.create_dataset("who", data=np.array([[109], [101]], np.uint16)).attrs["MATLAB_class"] = np.bytes_("char")
    with (folder / "m.mat").open("r+b") as file:
        file.write(b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(116) + b" " * 8 + b"\x00\x02IM")
    return folder / "m.mat", ["t", "y_0", "y_1", "y_2", "u_0", "u_1"]


def npz(folder):
    np.savez(folder / "m.npz", t=T, y=P, u=U)
    return folder / "m.npz", ["t", "y_0", "y_1", "y_2", "u_0", "u_1"]


def npy(folder):
    np.save(folder / "m.npy", np.c_[T, P, U])
    return folder / "m.npy", [f"column_{k}" for k in range(6)]


def parquet(folder):
    pytest.importorskip("pyarrow")
    import pandas

    frame = pandas.DataFrame({"t": T, "x": X, "y": Y, "z": Z, "u1": U1, "u2": U2, "note": ["a"] * 20,
                              "when": pandas.to_datetime(STAMPS)})
    frame.to_parquet(folder / "m.parquet")
    return folder / "m.parquet", ["t", "x", "y", "z", "u1", "u2"]


def bag(folder, plugin="SQLITE3"):
    """One table for each topic; the joints hold the position and the inputs."""
    pytest.importorskip("rosbags")
    from rosbags.rosbag2 import StoragePlugin, Writer
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS2_HUMBLE)
    kinds = store.types
    with Writer(folder / "bag", version=9, storage_plugin=StoragePlugin[plugin]) as writer:
        joints = writer.add_connection("/joints", "sensor_msgs/msg/JointState", typestore=store)
        tip = writer.add_connection("/tip", "geometry_msgs/msg/PointStamped", typestore=store)
        for stamp, position, inputs in zip(STAMPS.tolist(), P, U):
            header = kinds["std_msgs/msg/Header"](kinds["builtin_interfaces/msg/Time"](*divmod(stamp, 10**9)), "world")
            message = kinds["sensor_msgs/msg/JointState"](header, ["x", "y", "z"], position, np.empty(0),
                                                          np.r_[inputs, 0.0])
            writer.write(joints, stamp + 5, store.serialize_cdr(message, joints.msgtype))
            point = kinds["geometry_msgs/msg/PointStamped"](header, kinds["geometry_msgs/msg/Point"](*position))
            writer.write(tip, stamp + 9, store.serialize_cdr(point, tip.msgtype))
    return folder / "bag", ["time", "joints/position/x", "joints/position/y", "joints/position/z", "joints/effort/x",
                            "joints/effort/y"]


def bag_of_mcap(folder):
    return bag(folder, "MCAP")


def one_file_of_mcap(folder):
    return bag(folder, "MCAP")[0] / "bag.mcap", bag_names()


def bag_names():
    return ["time", *(f"joints/position/{axis}" for axis in "xyz"), "joints/effort/x", "joints/effort/y"]


WRITERS = (csv, motive, qualisys, vicon, c3d, hdf5, hdf5_named_mat, compound, matlab_5, matlab_struct, matlab_7_3, npz,
           npy, parquet, bag, bag_of_mcap, one_file_of_mcap)
SAID = {"csv": ("s", "mm", "N"), "motive": ("s", "mm", "mm"), "qualisys": ("s", "mm", "mm"), "vicon": ("s", "mm", "N"),
        "c3d": ("s", "mm", None), "hdf5": ("s", "mm", "N"), "hdf5_named_mat": ("s", "mm", "N"),
        "bag": ("ns", "m", None), "bag_of_mcap": ("ns", "m", None), "one_file_of_mcap": ("ns", "m", None)}


@pytest.mark.parametrize("write", WRITERS)
def test_the_same_samples_are_read_alike_from_every_format(write, tmp_path):
    path, names = write(tmp_path)
    table = read_tables(path)[0]
    read = table.numbers(names, path.name)
    if "bag" in write.__name__ or "mcap" in write.__name__:
        assert np.diff(table.columns["time"]).tolist() == [10_000_000] * 19
        read[:, 0] = T
    single = write is c3d
    np.testing.assert_allclose(read, np.c_[T, P, U], rtol=1e-7 if single else 0, atol=1e-15)
    said = [table.units.get(table.find(names[place])) for place in (0, 1, 4)]
    assert said == list(SAID.get(write.__name__, (None, None, None)))
    assert table.notes == () and table.run == "" and (table.interval is None or table.interval == 0.01)


def test_every_format_has_its_file_in_the_contract(tmp_path):
    read = set()
    for write in WRITERS:
        folder = tmp_path / write.__name__
        folder.mkdir()
        path, _ = write(folder)
        head = path.read_bytes()[:4096] if path.is_file() else b""
        read.add(next(each for each in FORMATS if each.recognises(head, path)).name)
    assert read == {each.name for each in FORMATS}


@pytest.mark.parametrize("write", [hdf5, npz, csv, parquet, matlab_5])
def test_a_file_is_told_by_its_content_not_by_its_name(write, tmp_path):
    path, names = write(tmp_path)
    renamed = path.rename(tmp_path / "recording.dat")
    np.testing.assert_allclose(read_tables(renamed)[0].numbers(names, "m"), np.c_[T, P, U], atol=1e-15)


@pytest.mark.parametrize(("content", "name", "message"), [
    (b"PK\x03\x04", "a.csv", "a.csv is a ZIP archive, .*; unpack it first"), (b"\x1f\x8b\x08", "a.csv", "compressed"),
    (b"\xd0\xcf\x11\xe0\xa1\xb1\x1a\xe1", "a.xls", "a spreadsheet; save it as CSV"),
    (b"\x80\x04\x95", "a.pkl", "a pickle, which could run foreign code; save it as NPZ or CSV"),
    (b"t,x\n0,1\n", "a.h5", "a.h5 is not an HDF5 file"), (b"t,x\n0,1\n", "b.parquet", "b.parquet cannot be read"),
    (b"\x93NUMPY\x01\0v\0{'descr'", "a.npy", "a.npy cannot be read"), (b"CDF\x01", "a.nc", "NetCDF 3"),
    (b"PAR1xxxx", "a.pq", "a.pq cannot be read"), (b"SQLite format 3\0", "a.db3", "cannot be read as a rosbag"),
    (b"SQLite format 3\0", "a.sqlite", "is a rosbag; name it a.db3"), (b"", "a.csv", "a.csv is empty"),
    (b"MATLAB 5.0 MAT-file" + b"x" * 200, "a.mat", "not a MATLAB file that can be read")])
def test_what_no_reader_takes_is_refused_with_what_it_is_and_the_remedy(content, name, message, tmp_path):
    (tmp_path / name).write_bytes(content)
    with pytest.raises(ValueError, match=message):
        read_tables(tmp_path / name)


def test_a_spreadsheet_named_csv_and_arrays_of_objects_are_refused(tmp_path):
    with zipfile.ZipFile(tmp_path / "a.csv", "w") as archive:
        archive.writestr("xl/workbook.xml", "")
    np.savez(tmp_path / "a.npz", t=np.array([{}, 1], dtype=object))
    for name, message in (("a.csv", "a spreadsheet; save it as CSV"), ("a.npz", "arrays of objects are not read")):
        with pytest.raises(ValueError, match=message):
            read_tables(tmp_path / name)


def test_a_format_whose_package_is_missing_is_refused_with_the_command_that_installs_it(tmp_path, monkeypatch):
    path, _ = c3d(tmp_path)
    monkeypatch.setattr("ssmr_torch.extras.find_spec", lambda name: None)
    with pytest.raises(ModuleNotFoundError, match=r"c3d is not installed: pip install 'ssmr_torch\[rigs\]'"):
        read_tables(path)
