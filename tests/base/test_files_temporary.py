"""Temporary files: files of running processes stay, and files of killed processes are removed."""

import ast
import errno
import os
import signal
import subprocess
import sys

import pytest

from antumbra import InputError
from antumbra.base import files as files_module
from antumbra.base.files import atomic_output, remove_abandoned, temporary_folder, temporary_name
from repository import ROOT

fcntl = pytest.importorskip("fcntl", reason="this system has no flock: Windows")
DEAD = ".antumbra-0123456789ab"
LIVING = """
import sys
from antumbra.base.files import atomic_output

with atomic_output(sys.argv[1]) as temporary:
    temporary.write_bytes(b"half")
    print("ready", flush=True)
    sys.stdin.readline()
    temporary.write_bytes(b"whole")
"""
BUSY = """
import os, sys
from antumbra.base.files import remove_abandoned, temporary_folder, temporary_name

for _ in range(200):
    with temporary_name(".") as path:
        path.write_bytes(b"x")
        remove_abandoned.cache_clear()
        remove_abandoned(".")
        assert path.read_bytes() == b"x"
        os.replace(path, "made-" + sys.argv[1])
"""


@pytest.fixture(autouse=True)
def forgotten():
    """Forget the folders that have been cleaned up."""
    remove_abandoned.cache_clear()


def files(folder):
    return sorted(os.listdir(folder))


def dead(folder, stem=DEAD):
    """Write the files that a killed process leaves."""
    for suffix in (".lock", ".tmp"):
        (folder / (stem + suffix)).write_bytes(b"")


def test_the_next_writer_removes_what_the_dead_left(tmp_path):
    dead(tmp_path)
    (tmp_path / ".antumbra-aaaaaaaaaaaa.tmp").write_bytes(b"its lock was removed before")
    (tmp_path / ".antumbra-bbbbbbbbbbbb.lock").write_bytes(b"")  # killed before it made its file
    with atomic_output(tmp_path / "a.png") as path:
        assert len(files(tmp_path)) == 1  # the lock; the writer makes the file itself
        path.write_bytes(b"x")
    assert files(tmp_path) == ["a.png"]


def test_files_of_a_living_process_stay(tmp_path):
    command = [sys.executable, "-c", LIVING, str(tmp_path / "a.png")]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as living:
        assert living.stdout.readline() == "ready\n"
        dead(tmp_path)
        with atomic_output(tmp_path / "b.png") as path:
            path.write_bytes(b"x")
        left = files(tmp_path)
        assert [os.path.splitext(name)[1] for name in left] == [".lock", ".tmp", ".png"] and left[2] == "b.png"
        assert (tmp_path / left[1]).read_bytes() == b"half" and not left[1].startswith(DEAD)
        living.communicate("\n")
    assert living.returncode == 0
    assert files(tmp_path) == ["a.png", "b.png"] and (tmp_path / "a.png").read_bytes() == b"whole"


def test_files_of_this_process_stay(tmp_path):
    with temporary_name(tmp_path) as one:
        one.write_bytes(b"x")
        remove_abandoned.cache_clear()
        with temporary_name(tmp_path) as other:
            assert one != other and one.read_bytes() == b"x"
        assert files(tmp_path) == [one.with_suffix(".lock").name, one.name]
    assert files(tmp_path) == []


def test_many_at_once(tmp_path):
    """Processes that write in one folder never remove each other's files, nor locks that are not yet locked."""
    makers = [
        subprocess.Popen([sys.executable, "-c", BUSY, str(k)], cwd=tmp_path, stderr=subprocess.PIPE, text=True)
        for k in range(4)
    ]
    said = [maker.communicate()[1] for maker in makers]
    assert [maker.returncode for maker in makers] == [0] * 4, said
    assert files(tmp_path) == [f"made-{k}" for k in range(4)]


def test_removed_before_it_is_locked(tmp_path, monkeypatch):
    """Another writer removes a new lock before it is locked. Then the maker takes another name."""
    lock, seen = files_module.lock, []

    def late(descriptor):
        if not seen:
            seen.extend(files(tmp_path))
            remove_abandoned.cache_clear()
            remove_abandoned(str(tmp_path))
            assert files(tmp_path) == []
        lock(descriptor)

    with monkeypatch.context() as patched:
        patched.setattr(files_module, "lock", late)
        remove_abandoned(str(tmp_path))  # so that `temporary_name` does not
        with temporary_name(tmp_path) as path:
            assert len(seen) == 1 and files(tmp_path) == [path.with_suffix(".lock").name] != seen
    assert files(tmp_path) == []


def test_seen_to_while_it_is_not_yet_locked(tmp_path, monkeypatch):
    """Another writer has locked the new lock and will remove it. Then the maker takes another name."""
    lock, held = files_module.lock, []

    def late(descriptor):
        if not held:
            held.append(os.open(tmp_path / files(tmp_path)[0], os.O_RDWR))
            fcntl.flock(held[0], fcntl.LOCK_EX)
        lock(descriptor)

    monkeypatch.setattr(files_module, "lock", late)
    with temporary_name(tmp_path) as path:
        assert held and path.suffix == ".tmp" and files(tmp_path) == [path.with_suffix(".lock").name]
    os.close(held[0])


@pytest.mark.parametrize("number", [errno.ENOLCK, errno.EOPNOTSUPP])
def test_a_file_system_without_locks(tmp_path, monkeypatch, number):
    def flock(descriptor, how):
        raise OSError(number, os.strerror(number))

    dead(tmp_path)
    before = files(tmp_path)
    with monkeypatch.context() as patched:
        patched.setattr(fcntl, "flock", flock)
        with atomic_output(tmp_path / "a.png") as path:
            assert files(tmp_path) == before  # it is unknown whether their maker still runs
            path.write_bytes(b"x")
            remove_abandoned.cache_clear()
            remove_abandoned(str(tmp_path))
            assert path.exists()
    assert files(tmp_path) == [*before, "a.png"]
    # When locks work again, a file without a lock is still not touched.
    (tmp_path / path.name).write_bytes(b"")
    remove_abandoned.cache_clear()
    remove_abandoned(str(tmp_path))
    assert files(tmp_path) == [path.name, "a.png"]


def test_what_is_not_ours_stays(tmp_path):
    folder, other = tmp_path / "folder", tmp_path / "other"
    folder.mkdir()
    other.write_bytes(b"kept")
    (folder / ".antumbra-aaaaaaaaaaaa.tmp").symlink_to(other)
    (folder / ".antumbra-bbbbbbbbbbbb.lock").symlink_to(other)
    (folder / ".antumbra-cccccccccccc.tmp").mkdir()
    os.mkfifo(folder / ".antumbra-dddddddddddd.lock")  # opening it must not wait for the other end of the pipe
    for name in (".antumbra-notes.tmp", ".antumbra-0123456789AB.tmp", ".antumbra-0123456789ab.tmp~", "x.tmp"):
        (folder / name).write_bytes(b"")
    before = files(folder)
    dead(folder)
    remove_abandoned(str(folder))
    assert files(folder) == before and other.read_bytes() == b"kept"


def test_a_lock_that_is_a_link(tmp_path):
    dead(tmp_path)
    (tmp_path / "other").write_bytes(b"kept")
    (tmp_path / f"{DEAD}.lock").unlink()
    (tmp_path / f"{DEAD}.lock").symlink_to(tmp_path / "other")
    before = files(tmp_path)
    remove_abandoned(str(tmp_path))
    assert files(tmp_path) == before and (tmp_path / "other").read_bytes() == b"kept"


@pytest.mark.parametrize("function", ["open", "unlink", "scandir"])
def test_no_permission(tmp_path, monkeypatch, function):
    """Files of other users, and folders without permission, are no error. The errors are simulated, because root has
    all permissions."""
    dead(tmp_path)
    dead(tmp_path, ".antumbra-aaaaaaaaaaaa")
    before, called, true = files(tmp_path), [], getattr(os, function)

    def refused(path, *arguments):
        if function == "scandir" or os.path.basename(path).startswith(DEAD):
            called.append(path)
            raise PermissionError(errno.EACCES, "Permission denied")
        return true(path, *arguments)

    with monkeypatch.context() as patched:
        patched.setattr(os, function, refused)
        remove_abandoned(str(tmp_path))
    assert called and files(tmp_path) == (before if function == "scandir" else [f"{DEAD}.lock", f"{DEAD}.tmp"])


def test_a_folder_that_nobody_can_write_in(tmp_path):
    with pytest.raises(InputError, match=r"a\.png: cannot be written"), atomic_output(tmp_path / "gone" / "a.png"):
        raise AssertionError("there is no such folder")
    remove_abandoned(str(tmp_path / "gone"))


# --- folders -----------------------------------------------------------------------------------------------------


KILLED = """
import os, signal
from pathlib import Path
{make}
(Path(folder) / "model.glb").write_bytes(b"half")
os.kill(os.getpid(), signal.SIGKILL)
"""
MAKERS = {
    "a context": "from antumbra.base import files\nmade = files.temporary_folder()\nfolder = made.__enter__()",
    "a process": "from antumbra.base.files import private_folder\nfolder = private_folder('inputs')",
    "a node of a cluster": "from antumbra.cluster.ray_workers import Node\nnode = Node(1)\nfolder = node.folder",
}


@pytest.mark.parametrize("maker", MAKERS)
def test_folders_of_killed_processes_are_removed_and_those_of_others_stay(tmp_path, monkeypatch, maker):
    env = {**os.environ, "TMPDIR": str(tmp_path)}
    done = subprocess.run([sys.executable, "-c", KILLED.format(make=MAKERS[maker])], env=env)
    assert done.returncode == -signal.SIGKILL
    (left,) = tmp_path.iterdir()
    assert files(left) == [".lock", "model.glb"]
    (tmp_path / "antumbra-theirs00").mkdir()  # without a lock
    monkeypatch.setattr(files_module.tempfile, "tempdir", str(tmp_path))
    os.utime(left / ".lock", (0.0, 0.0))  # a young folder's owner may be about to lock it
    files_module.remove_abandoned_folders.cache_clear()
    with temporary_folder() as folder:
        os.utime(folder / ".lock", (0.0, 0.0))
        assert set(files(tmp_path)) == {folder.name, "antumbra-theirs00"} and folder.stat().st_mode & 0o777 == 0o700
        files_module.remove_abandoned_folders.cache_clear()
        with temporary_folder() as other:
            assert folder.exists() and other != folder
    assert files(tmp_path) == ["antumbra-theirs00"]
    files_module.remove_abandoned_folders.cache_clear()


def makes_folders(source):
    """Return whether code makes temporary folders by itself. Examples in docstrings may."""
    names = (
        getattr(node, "id", None) or getattr(node, "attr", None) or getattr(node, "name", None)
        for node in ast.walk(ast.parse(source))
    )
    return not {"TemporaryDirectory", "mkdtemp"}.isdisjoint(names)


def test_no_other_module_makes_folders_that_outlive_a_killed_process():
    assert makes_folders("from tempfile import mkdtemp") and makes_folders("with tempfile.TemporaryDirectory(): pass")
    assert not makes_folders('"""\n>>> with TemporaryDirectory() as folder:\n"""')
    found = [path.name for path in (ROOT / "src").rglob("*.py") if makes_folders(path.read_text(encoding="utf-8"))]
    assert sorted(found) == ["files.py"]
