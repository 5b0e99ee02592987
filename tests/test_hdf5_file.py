"""HDF5 files of others: nothing outside them is read, and none fills the memory."""

import subprocess
import sys

import h5py
import numpy as np
import pytest

from ssmr_torch.hdf5_file import open_hdf5


@pytest.fixture
def path(tmp_path):
    with h5py.File(tmp_path / "secret.h5", "w") as file:
        file["y"] = np.arange(10.0)
    (tmp_path / "raw.bin").write_bytes(bytes(80))
    return tmp_path / "a.h5"


def linked(file):
    file["y"] = h5py.ExternalLink("secret.h5", "y")


def linked_deep(file):
    file["g/x"] = 1.0
    file["g/y"] = h5py.ExternalLink("secret.h5", "/y")


def virtual(file):
    layout = h5py.VirtualLayout((10,), "f8")
    layout[:] = h5py.VirtualSource("secret.h5", "y", (10,))
    file.create_virtual_dataset("y", layout)


def stored_outside(file):
    file.create_dataset("y", (10,), "f8", external=[("raw.bin", 0, 80)])


def never_written(file):
    file.create_dataset("y", (10 ** 12,), "f8", chunks=(1000,))


def one_huge_chunk(file):
    file.create_dataset("y", (10,), "f8", chunks=(2 ** 28,), maxshape=(None,))


def compressed(file):
    file.create_dataset("y", data=np.zeros(2 * 10 ** 7), chunks=(2 * 10 ** 7,), compression="gzip")


def circle(file):
    file["a/b"] = file["/"]


def deep(file):
    file["/".join("a" * 40) + "/y"] = 1.0


@pytest.mark.parametrize(("write", "says"), [
    (linked, "'y' is a link to another file"), (linked_deep, "'g/y' is a link to another file"),
    (virtual, "'y' lies in other files"), (stored_outside, "'y' lies in other files"),
    (never_written, r"takes 8e\+12 bytes in memory"), (one_huge_chunk, r"takes 2.15e\+09 bytes"),
    (compressed, r"takes 1.6e\+08 bytes"), (circle, "'a/b' contains itself"), (deep, "32 groups deep")])
def test_a_file_that_reaches_outside_or_explodes_is_refused_by_name(path, write, says):
    with h5py.File(path, "w") as file:
        write(file)
    with pytest.raises(ValueError, match=rf"a\.h5: .*{says}"):
        open_hdf5(path)
    path.unlink()  # the refused file is closed


def test_a_file_within_itself_is_read_through_soft_links_and_second_names(path):
    with h5py.File(path, "w") as file:
        file.create_dataset("g/y", data=np.arange(1000.0), compression="gzip")
        file["soft"], file["hard"], file["nowhere"] = h5py.SoftLink("/g/y"), file["g/y"], h5py.SoftLink("/none")
        file["text"] = ["a", "b"]
    with open_hdf5(path) as file:
        assert file["soft"][3] == file["hard"][3] == 3.0


def test_a_damaged_and_a_missing_file_are_refused(path):
    path.write_bytes(b"\x89HDF\r\n\x1a\n" + bytes(100))
    with pytest.raises(ValueError, match=r"a\.h5 cannot be read"):
        open_hdf5(path)
    with pytest.raises(FileNotFoundError, match="no file"):
        open_hdf5(path.with_name("none.h5"))


@pytest.mark.parametrize("in_memory", [2 ** 28, 0], ids=["made in memory", "written piece by piece"])
def test_a_full_disk_is_an_error_and_not_the_end_of_the_process(tmp_path, in_memory):
    code = f"""
import resource, numpy as np
from ssmr_torch import hdf5_file
hdf5_file.IN_MEMORY = {in_memory}
resource.setrlimit(resource.RLIMIT_FSIZE, (12000, 12000))
for size in (1000, 100000):
    try:
        with hdf5_file.new_hdf5({str(tmp_path / "new.h5")!r}, size * 8 + 4000) as file:
            file["x"] = np.arange(float(size))
        print("written")
    except OSError as error:
        print(error.errno)
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert (done.returncode, done.stdout.split(), done.stderr) == (0, ["written", "27"], "")
