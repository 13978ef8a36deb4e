"""Paths that are not scene files."""

import os
import threading

import pytest

from antumbra.base.errors import InputError
from antumbra.city.sensors.sensor_files import read_points
from antumbra.city.vegetation.vegetation_table import VegetationOptions, read_vegetation
from antumbra.engine.scene_loading import load
from antumbra.formats.gltf import gltf_source
from gltf_files import single


def message_of(path, read=load) -> str:
    with pytest.raises(InputError) as caught:
        read(path)
    message = str(caught.value)
    assert "\n" not in message
    return message


@pytest.mark.parametrize("name", ["gone.glb", "gone.gltf", "gone.obj", "gone.ply", "gone.stl", "gone.xyz", "gone"])
def test_missing_files(tmp_path, name):
    assert message_of(tmp_path / name) == f"{name}: no such file; check the path"
    assert message_of(str(tmp_path / name)) == f"{name}: no such file; check the path"


@pytest.mark.parametrize("name", ["a.zzz", "a.txt", "nosuffix", ".glb"])
def test_unknown_formats(tmp_path, name):
    (tmp_path / name).write_bytes(single().glb())
    message = message_of(tmp_path / name)
    assert message.startswith(f"{name}: unknown format") and ".glb, .gltf, .obj, .ply, .stl" in message


def test_folders_without_frames(tmp_path):
    (tmp_path / "dir.glb").mkdir()
    message = message_of(tmp_path / "dir.glb")
    assert message.startswith("dir.glb: a folder without frames.npy and faces.npy")


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="no named pipes on this system")
@pytest.mark.parametrize("name", ["pipe.glb", "pipe.obj"])
def test_pipes_do_not_block(tmp_path, name):
    os.mkfifo(tmp_path / name)
    messages = []
    reader = threading.Thread(target=lambda: messages.append(message_of(tmp_path / name)), daemon=True)
    reader.start()
    reader.join(20)
    assert messages == [f"{name}: not a regular file; name a scene file"]


@pytest.mark.parametrize("path", [None, 3, 2.5, ["a.glb"]])
def test_paths_of_other_types(path):
    assert "give the path of a file" in message_of(path)


def test_paths_that_no_system_has():
    for path in ("a\0b.glb", "x" * 5000 + ".glb", ""):
        assert message_of(path)


@pytest.mark.skipif(not hasattr(os, "geteuid") or os.geteuid() == 0, reason="the superuser may read everything")
def test_files_that_may_not_be_read(tmp_path):
    path = single().write(tmp_path)
    path.chmod(0)
    assert "made.glb: cannot be read" in message_of(path)


@pytest.mark.parametrize("error", [RuntimeError("first line\nsecond"), KeyError("x"), RecursionError(), MemoryError()])
def test_what_no_check_foresees_still_becomes_one_line(tmp_path, monkeypatch, error):
    def fail(*_):
        raise error

    path = single().write(tmp_path)
    monkeypatch.setattr(gltf_source, "read_gltf", fail)
    with pytest.raises(InputError) as caught:
        load(path)
    assert str(caught.value).startswith("made.glb: ") and "\n" not in str(caught.value)
    assert caught.value.__cause__ is error


@pytest.mark.skipif(not hasattr(os, "symlink"), reason="no symbolic links on this system")
@pytest.mark.parametrize("suffix", [".glb", ".obj", ".tif", ".asc", ".gpkg", ".antumbra", ".city.json", ".csv"])
def test_why_a_path_leads_nowhere_is_said(tmp_path, suffix):
    loop, dangling = (tmp_path / f"{name}{suffix}" for name in ("loop", "dangling"))
    loop.symlink_to(loop.name)
    dangling.symlink_to("gone" + suffix)
    (tmp_path / "file").write_text("x")
    readers = [load] if suffix != ".csv" else [read_trees_of, read_points]
    for read in readers:
        for path, words in (
            (loop, "symbolic links lead in a circle; name the file itself"),
            (dangling, "is a symbolic link to a file that does not exist; name the file itself"),
            (tmp_path / ("x" * 300 + suffix), "the name is too long for this system; shorten it"),
            (tmp_path / ("x/" * 3000 + "a" + suffix), "the name is too long for this system; shorten it"),
            (tmp_path / "file" / f"a{suffix}", "no such file; check the path"),
        ):
            assert words in message_of(path, read)


def read_trees_of(path):
    return read_vegetation(path, VegetationOptions())
