"""What a file of arrays declares is bounded before it is read."""

import io
import zipfile

import h5py
import numpy as np
import pytest
import scipy.io

from surefoot.sim.common.errors import SurefootError
from surefoot.sim.importing.array_file import read_hdf5, read_mat, read_npz

MANY = 21


def hdf5(fill):
    def write(path):
        with h5py.File(path, "w", libver="latest") as file:
            fill(file)

    return write


def many_datasets(file):
    for k in range(MANY):
        file.create_dataset(f"c{k}", shape=(3,), dtype="f8")


def many_names_of_one(file):
    file["t"] = np.arange(3.0)
    for k in range(MANY):
        file[f"c{k}"] = file["t"]


def many_references(file):
    for k in range(MANY):
        file.create_dataset(f"#refs#/{k}", shape=(3,), dtype="f8")


def huge_strings(file):
    file.create_dataset("s", shape=(1, 6), dtype="u4").attrs["MATLAB_class"] = np.bytes_("string")
    words = file.create_dataset("#refs#/a", shape=(10**10,), dtype="u8", chunks=(10**6,))
    words.attrs["MATLAB_class"] = np.bytes_("uint64")


def strings_elsewhere(file):
    where = [("/etc/passwd", 0, 64)]
    file.create_dataset("#refs#/a", shape=(8,), dtype="u8", external=where)


def huge(file):
    file.create_dataset("t", shape=(10**12,), dtype="f8", chunks=(1000,))


def many_members(path):
    with zipfile.ZipFile(path, "w") as file:
        for k in range(MANY):
            file.writestr(f"c{k}.npy", b"")


def nothing_a_billion_times(path):
    """Elements of no size: a file of 200 bytes whose rows took minutes."""
    head = io.BytesIO()
    about = {"descr": "|V0", "fortran_order": False, "shape": (10**12,)}
    np.lib.format.write_array_header_1_0(head, about)
    path.write_bytes(head.getvalue() + bytes(100))


def many_variables(path):
    scipy.io.savemat(path, {f"c{k}": np.arange(3.0) for k in range(MANY)})


@pytest.mark.parametrize(
    ("name", "write", "read", "word"),
    [
        ("r.h5", hdf5(many_datasets), read_hdf5, "columns"),
        ("r.h5", hdf5(many_names_of_one), read_hdf5, "columns"),
        ("r.mat", hdf5(many_references), read_mat, "columns"),
        ("r.mat", hdf5(huge_strings), read_mat, "memory"),
        ("r.mat", hdf5(strings_elsewhere), read_mat, "another file"),
        ("r.h5", hdf5(huge), read_hdf5, "memory"),
        ("r.npz", many_members, read_npz, "columns"),
        ("r.npy", nothing_a_billion_times, read_npz, "memory"),
        ("r.mat", many_variables, read_mat, "columns"),
    ],
)
def test_a_file_that_declares_too_much_is_refused(tmp_path, name, write, read, word, monkeypatch):
    monkeypatch.setenv("SUREFOOT_LIMITS", "columns=20")
    write(tmp_path / name)
    with pytest.raises(SurefootError, match=word) as found:
        read(tmp_path / name)
    assert name in str(found.value)
    assert "\n" not in str(found.value)
