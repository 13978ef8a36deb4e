"""Machine code comes from folders and files that other users cannot change, and from no pipes."""

import json
import os
import subprocess
import sys
from types import SimpleNamespace

import pytest

import sample_package as sample
from antumbra.base import files
from antumbra.kernels.toolchain import kernel_cache
from antumbra.kernels.toolchain.kernel_cache import KernelCode

pytestmark = pytest.mark.skipif(not hasattr(os, "getuid"), reason="this system has no owners of files: Windows")
CODE = KernelCode("module:kernel", "i", ["module:Pair", ["i"]], b"machine code of antumbra_digest " * 50)
STRANGER = 65534


@pytest.fixture
def own(tmp_path):
    """A folder of this user, even if the tests are run by root, to whom no user is a stranger."""
    folder = tmp_path / "own"
    folder.mkdir(mode=0o755)
    return folder


def give_away(path):
    """Give a file to another user; skip the test where that is not allowed."""
    try:
        os.chown(path, STRANGER, STRANGER)
    except PermissionError:
        pytest.skip("only root can give files away: owners NOT checked")


@pytest.mark.parametrize("mode", [0o700, 0o755, 0o500, 0o644, 0o600])
def test_what_only_its_user_can_change(own, mode):
    own.chmod(mode)
    files.check_trusted(own)


@pytest.mark.parametrize("mode", [0o777, 0o757, 0o702, 0o1777])
def test_what_anyone_can_change(own, mode):
    own.chmod(mode)
    with pytest.raises(files.Untrusted, match="own can be changed by other users"):
        files.check_trusted(own)


def test_groups_of_several_users(own, monkeypatch):
    own.chmod(0o775)
    user, members = SimpleNamespace(pw_name="user", pw_gid=own.stat().st_gid), []
    monkeypatch.setattr("pwd.getpwuid", lambda user_id: user)
    monkeypatch.setattr("grp.getgrgid", lambda group_id: SimpleNamespace(gr_name="user", gr_mem=members))
    files.check_trusted(own)
    members.append("stranger")
    with pytest.raises(files.Untrusted):
        files.check_trusted(own)


def test_what_belongs_to_another_user(own):
    give_away(own)
    with pytest.raises(files.Untrusted, match=f"own belongs to another user .id {STRANGER}"):
        files.check_trusted(own)


def test_new_folders_are_private(own):
    files.make_folder(own / "a" / "b")
    assert [(own / name).stat().st_mode & 0o777 for name in ("a", "a/b")] == [0o700] * 2
    files.make_folder(own)
    assert own.stat().st_mode & 0o777 == 0o755


# --- files of kernels --------------------------------------------------------------------------------------------


def pipe(file):
    file.unlink()
    os.mkfifo(file)


def link(file):
    file.rename(file.with_suffix(".away"))
    file.symlink_to(file.with_suffix(".away"))


def fault_of(kind):
    return {"pipe": pipe, "link": link, "writable": lambda file: file.chmod(0o666), "foreign": give_away}[kind]


@pytest.mark.parametrize("kind", ["pipe", "link", "writable", "foreign"])
def test_a_file_that_is_not_ours_is_missing_and_is_replaced(own, kind):
    folder = kernel_cache.KernelFolder(own, "some-level")
    folder.put("digest", CODE)
    assert folder.get("digest") == CODE and folder.has("digest")
    fault_of(kind)(folder.path / "digest.kernel")
    assert folder.get("digest") is None and not folder.has("digest")
    folder.put("digest", CODE)
    assert folder.get("digest") == CODE and folder.has("digest")


def test_locks_do_not_follow_links(own):
    (own / "lock").symlink_to(own / "elsewhere")
    with pytest.raises(OSError, match="symbolic links"), files.file_lock(own / "lock"):
        pass
    assert not (own / "elsewhere").exists()
    os.mkfifo(own / "pipe")
    with files.file_lock(own / "pipe"):
        pass


# --- the folder of kernels ---------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def package(tmp_path_factory):
    return sample.write(tmp_path_factory.mktemp("package"))


def open_to_all(folder):
    folder.chmod(0o777)


def open_inside(folder):
    (folder / "kernels").mkdir()
    (folder / "kernels").chmod(0o777)


@pytest.mark.parametrize("spoil", [open_to_all, open_inside, give_away])
def test_folders_of_kernels_that_others_can_change(own, spoil):
    kernel_cache.check_cache(own)
    kernel_cache.check_cache(own / "missing")
    spoil(own)
    with pytest.raises(files.Untrusted, match=str(own)):
        kernel_cache.check_cache(own)


@pytest.mark.parametrize("spoil, trusted", [(open_to_all, False), (give_away, False), (open_inside, True)])
def test_measured_rates_come_from_a_folder_that_others_cannot_change(own, spoil, trusted, monkeypatch):
    """They need no kernels, whose folders are therefore not checked."""
    monkeypatch.setenv("ANTUMBRA_CACHE", str(own))
    kernel_cache.cache_root.cache_clear()
    try:
        spoil(own)
        assert (kernel_cache.cache_root() == own) == trusted
    finally:
        kernel_cache.cache_root.cache_clear()


def test_kernels_are_then_compiled_in_a_private_folder(package, own, tmp_path):
    own.chmod(0o777)
    temporary = tmp_path / "temporary"
    temporary.mkdir()
    env = {**sample.environment(package, own), "TMPDIR": str(temporary)}
    done = subprocess.run([sys.executable, "-c", sample.RUN], env=env, capture_output=True, text=True, timeout=300)
    assert done.returncode == 0 and json.loads(done.stdout)[0]["alone"] == 101, done.stderr
    (line,) = done.stderr.splitlines()
    assert line.startswith(str(own)) and line.endswith(": kernels are compiled for this process alone")
    assert not list(own.iterdir()) and not list(temporary.iterdir())


def test_compiling_processes_use_the_same_private_folder(package, own):
    own.chmod(0o777)
    program = """
from antumbra.kernels.toolchain.compile_pool import KernelRequest, compile_kernels
from antumbra.kernels.toolchain.kernel_loading import is_on_disk
from antumbra.kernels.marshalling import import_object

wrong = compile_kernels([KernelRequest("antumbra.sample.top:alone", "i")])
print(wrong, is_on_disk(import_object("antumbra.sample.top:alone"), "i"))
"""
    env = sample.environment(package, own)
    done = subprocess.run([sys.executable, "-c", program], env=env, capture_output=True, text=True, timeout=300)
    assert done.stdout == "[] True\n" and done.stderr.count("\n") == 1 and not list(own.iterdir())


# --- inputs of jobs on other nodes -------------------------------------------------------------------------------


@pytest.mark.parametrize("spoil", [open_to_all, give_away, lambda folder: folder.rmdir() or folder.write_bytes(b"")])
def test_a_folder_of_inputs_that_others_made(tmp_path, monkeypatch, caplog, spoil):
    from antumbra.cluster import node_files

    monkeypatch.setattr(node_files.tempfile, "tempdir", str(tmp_path))
    files.private_folder.cache_clear()
    own = node_files.user_temporary_folder()
    assert own == tmp_path / f"antumbra-{os.getuid()}" and own.stat().st_mode & 0o777 == 0o700
    assert node_files.user_temporary_folder() == own and not caplog.records
    spoil(own)
    other = node_files.user_temporary_folder()
    assert other != own and other.stat().st_mode & 0o777 == 0o700 and node_files.user_temporary_folder() == other
    assert caplog.messages[0].endswith(": files are fetched for this process alone")
