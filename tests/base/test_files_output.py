import os
import sys

import pytest

from antumbra import InputError
from antumbra.base.files import atomic_output, checked_output

SUFFIXES = (".png", ".exr")


def check_fails(path, match):
    with pytest.raises(InputError, match=match) as caught:
        checked_output(path, SUFFIXES)
    assert "\n" not in str(caught.value)


def test_good_paths(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "old.exr").write_bytes(b"")
    for path in ("a.png", "./B.EXR", str(tmp_path / "c.png"), tmp_path / "old.exr"):
        assert os.fspath(checked_output(path, SUFFIXES)) == os.path.normpath(path)


def test_bad_paths(tmp_path):
    (tmp_path / "folder.png").mkdir()
    (tmp_path / "file").write_bytes(b"")
    check_fails(tmp_path / "folder.png", "is a folder; name a .png or .exr file in it")
    check_fails(tmp_path, "is a folder")
    check_fails(tmp_path / "a.gif", "unknown suffix '.gif'; use .png or .exr")
    check_fails(tmp_path / "a", "no suffix; use .png or .exr")
    check_fails("", "name a file or a folder")
    check_fails(tmp_path / "none" / "a.png", "none does not exist; make it first")
    check_fails(tmp_path / "file" / "a.png", "file is not a folder")
    check_fails(tmp_path / ("a" * 300 + ".png"), "cannot be written")
    check_fails(str(tmp_path / "a\0.png"), "name a file or a folder")
    check_fails(3, "must be a string or a path")


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="this system has no named pipes")
def test_a_pipe_is_no_file(tmp_path):
    os.mkfifo(tmp_path / "a.png")
    check_fails(tmp_path / "a.png", "not a regular file")
    with pytest.raises(InputError, match="not a regular file"), atomic_output(tmp_path / "a.png"):
        pytest.fail("the context was entered")
    assert (tmp_path / "a.png").is_fifo() and os.listdir(tmp_path) == ["a.png"]


def test_a_folder_without_permission(tmp_path, monkeypatch):
    monkeypatch.setattr(os, "access", lambda path, mode: False)  # root may write to any real folder
    check_fails(tmp_path / "a.png", "no permission to write in")


def test_a_file_without_permission(tmp_path, monkeypatch):
    path = tmp_path / "a.png"
    path.write_bytes(b"")
    monkeypatch.setattr(os, "access", lambda asked, mode: os.fspath(asked) != os.fspath(path))
    check_fails(path, "write-protected")


def test_what_is_written_becomes_the_file(tmp_path):
    path = tmp_path / "a.png"
    for content in (b"one", b"two"):
        with atomic_output(path) as temporary:
            assert temporary.parent == tmp_path and temporary != path
            temporary.write_bytes(content)
        assert path.read_bytes() == content
        assert os.listdir(tmp_path) == ["a.png"]


@pytest.mark.parametrize("error", [OSError(28, "No space left on device"), ValueError("x"), KeyboardInterrupt()])
def test_failure_leaves_everything_as_it_was(tmp_path, error):
    path = tmp_path / "a.png"
    path.write_bytes(b"old")
    with (
        pytest.raises(InputError if isinstance(error, OSError) else type(error)) as caught,
        atomic_output(path) as temporary,
    ):
        temporary.write_bytes(b"half")
        raise error
    assert path.read_bytes() == b"old"
    assert os.listdir(tmp_path) == ["a.png"]
    if isinstance(error, OSError):
        assert str(caught.value) == f"{path}: cannot be written (No space left on device); choose another place"


def test_a_folder_that_vanished_is_an_input_error(tmp_path):
    with pytest.raises(InputError, match="cannot be written"), atomic_output(tmp_path / "gone" / "a.png") as temporary:
        temporary.write_bytes(b"x")


@pytest.mark.skipif(sys.platform == "win32", reason="links need a privilege on Windows")
def test_a_link_stays_a_link(tmp_path):
    (tmp_path / "there").mkdir()
    link = tmp_path / "a.png"
    link.symlink_to(tmp_path / "there" / "b.png")
    assert checked_output(link, SUFFIXES) == link
    with atomic_output(link) as temporary:
        temporary.write_bytes(b"x")
    assert link.is_symlink() and (tmp_path / "there" / "b.png").read_bytes() == b"x"
