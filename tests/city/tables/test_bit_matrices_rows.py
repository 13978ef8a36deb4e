"""Matrices of bits in files: any order of rows, and full disks."""

import errno
import os
from types import SimpleNamespace

import numpy as np
import pytest

import antumbra as at
import antumbra.base.files
from antumbra.city.tables.bit_matrices import RowFile, row_file_size
from small_disk import small_disk

RNG = np.random.default_rng(0)


@pytest.mark.parametrize("shape", [(0, 3), (1, 1), (100, 3), (7, 0)])
def test_rows_in_any_order(tmp_path, shape):
    rows, order = RNG.integers(0, 1 << 63, shape, np.uint64), RNG.permutation(shape[0])
    with RowFile(tmp_path / "a.npy", shape) as file:
        for some in np.array_split(order, 5):
            file.put(some, rows[some])
    found = np.load(tmp_path / "a.npy")
    assert found.dtype == np.uint64 and np.array_equal(found, rows)
    assert os.path.getsize(tmp_path / "a.npy") == row_file_size(shape)


def test_a_system_that_cannot_reserve_space(tmp_path, monkeypatch):
    def refuse(*_):
        raise OSError(errno.EOPNOTSUPP, "Operation not supported")

    monkeypatch.setattr(os, "posix_fallocate", refuse)
    with RowFile(tmp_path / "a.npy", (2, 1)) as file:
        file.put(np.array([1]), np.array([[7]], np.uint64))
    assert np.load(tmp_path / "a.npy").tolist() == [[0], [7]]


def test_a_full_disk_is_an_error_before_the_first_row(tmp_path):
    with small_disk(tmp_path / "disk", 1 << 20) as disk:
        with pytest.raises(OSError, match="No space left") as caught:
            RowFile(disk / "a.npy", (1 << 10, 1 << 8))
        assert caught.value.errno == errno.ENOSPC


def ask_matrix(folder):
    scene = at.procedural("atrium", triangles=1000)
    at.visibility_matrix(scene, at.face_sensors(scene).part(0, 64), output=folder / "a.npy", keep=folder / "parts")


def ask_sun(folder):
    scene = at.procedural("atrium", triangles=1000)
    place, keep = at.Place(52.0, 4.4), folder / "parts"
    at.sun_hours(scene, "face", "2026-06-21", place=place, step=240, matrix=folder / "a.npy", keep=keep)


@pytest.mark.parametrize("ask", [ask_matrix, ask_sun])
def test_a_disk_that_fills_up_while_a_job_works(tmp_path, ask, monkeypatch):
    def refuse(*_):
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(antumbra.base.files.os, "posix_fallocate", refuse)
    with pytest.raises(at.InputError, match=r"a.npy: cannot be written \(No space left on device\)"):
        ask(tmp_path)
    assert os.listdir(tmp_path) == ["parts"]  # the same call goes on from them


@pytest.mark.parametrize("ask", [ask_matrix, ask_sun])
def test_a_disk_without_room_is_found_before_the_work(tmp_path, ask, monkeypatch):
    monkeypatch.setattr(antumbra.base.files.shutil, "disk_usage", lambda folder: SimpleNamespace(free=0))
    with pytest.raises(at.InputError, match=r"a.npy: takes .* MB, and .* has 0.0 MB left"):
        ask(tmp_path)
    assert not os.listdir(tmp_path)
