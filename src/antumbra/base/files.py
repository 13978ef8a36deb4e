"""Files and folders: checked input paths, locks, trusted files, temporary files, atomic output.

Input. A file to be read must be a regular, non-empty file. A reference in a scene must stay within the scene's folder.

Locks. A process holds a lock file until it releases it or ends. Machine code is loaded only from files that no one but
this user, or the system, can modify.

Temporary files. Before a process creates ``.antumbra-0123456789ab.tmp``, it creates the empty
``.antumbra-0123456789ab.lock`` and locks it. The system releases the lock when the process ends for any reason, so a
file whose lock is free is abandoned, and a later process removes it. This also holds if the owner ran in another
container, or on another machine that shares the folder. The lock is a separate file because SMB and Windows forbid
writing to a locked file.

Output. Files are written completely or not at all.
"""

import atexit
import ctypes
import errno
import io
import os
import re
import secrets
import shutil
import stat
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, redirect_stderr, redirect_stdout, suppress
from functools import cache
from pathlib import Path
from tempfile import TemporaryFile
from urllib.parse import unquote

from .checks import alternatives, path_of
from .errors import InputError

# --- Input paths ------------------------------------------------------------------------------------------------------


_SCHEME = re.compile(r"[A-Za-z][A-Za-z0-9+.-]*:")
_REMOTE = re.compile(r"(?:.*?/)?(https?|ftp|s3|gs):/+(.+?\.(?:zip|tgz|tar|gz)(?=/)|.+)", re.I)  # `Path` joins slashes
_BUCKET = re.compile(r"/vsi(s3|gs)(?:_streaming)?/+(.+)", re.I)
_VIRTUAL = re.compile(r"/vsi[a-z0-9_]+/|[a-z][a-z0-9+.-]+:/", re.I)  # of GDAL, or a URL; a drive's letter is one letter
_DOWNLOADS = {"s3": "aws s3 cp {} .", "gs": "gcloud storage cp {} ."}


def checked_file(path: Path, where: str) -> Path:
    """`path` if it is a regular, non-empty file. A pipe or device could block forever.

    Nothing is read from the network or from archives; a URL is refused with the command that downloads it.
    """
    try:
        status = path.stat()
    except (FileNotFoundError, NotADirectoryError):
        raise InputError(f"{where}: {_why_missing(path)}") from None
    except OSError as error:
        if error.errno == errno.ENAMETOOLONG:
            where = f"{where[:40]}..." if len(where) > 80 else where
            raise InputError(f"{where}: the name is too long for this system; shorten it") from None
        if error.errno == errno.ELOOP:
            raise InputError(f"{where}: {_LOOP}") from None
        raise InputError(f"{where}: cannot be read ({_reason(error)}); check the permissions") from None
    if not stat.S_ISREG(status.st_mode):
        raise InputError(f"{where}: not a regular file; name a scene file")
    if status.st_size == 0:
        raise InputError(f"{where}: the file is empty; export or copy it again")
    return path


_LOOP = "symbolic links lead in a circle; name the file itself"


def _why_missing(path: Path) -> str:
    """Why a path leads to no file, and what to do."""
    if path.is_symlink():
        return "is a symbolic link to a file that does not exist; name the file itself"
    file, mark, _ = path.name.partition("?")
    if mark and file and path.with_name(file).is_file():
        return f"{file} has no such option; antumbra formats lists the options of files"
    return _cure_of_virtual(path) or "no such file; check the path"


def _cure_of_virtual(path: Path) -> str | None:
    """How to make a local file of a URL, or of a path in one of GDAL's virtual file systems; None for other paths."""
    name = path.as_posix()
    if not _VIRTUAL.match(name):
        return None
    if remote := _BUCKET.match(name) or _REMOTE.match(name):
        scheme = remote[1].lower()
        command = _DOWNLOADS.get(scheme, "curl -LO {}").format(f"{scheme}://{remote[2]}")
        return f"is not a local file; download it first: {command}"
    return "is not a local file; download or unpack it first, and give the path of the file itself"


@contextmanager
def without_output() -> Iterator[None]:
    """Suppress standard output and error, including from C++: OpenEXR also reports damaged files there."""
    _flush()
    copies = {}
    for number in (1, 2):
        with suppress(OSError):  # a closed stream
            copies[number] = os.dup(number)
    null = os.open(os.devnull, os.O_WRONLY)
    try:
        for number in copies:
            os.dup2(null, number)
        with redirect_stdout(io.StringIO()), redirect_stderr(io.StringIO()):
            yield
    finally:
        _flush()
        for number, old in copies.items():
            os.dup2(old, number)
            os.close(old)
        os.close(null)


def _flush() -> None:
    """Flush the standard streams of Python and of C."""
    for stream in (sys.stdout, sys.stderr):
        with suppress(OSError, ValueError, AttributeError):
            stream.flush()
    with suppress(OSError, AttributeError, TypeError):
        ctypes.CDLL(None).fflush(None)


def sibling(folder: Path, uri: str, where: str) -> Path:
    """The file of a relative `uri` in a scene; InputError unless it is within the scene's `folder`."""
    name = unquote(uri)
    short_uri = uri if len(uri) <= 80 else uri[:77] + "..."
    if _SCHEME.match(uri) or uri.startswith(("//", "\\\\")):
        raise InputError(f"{where} is {short_uri!r}; only files in the scene's folder are read, put it there")
    if not name or not name.isprintable() or name.startswith(("/", "\\")) or _SCHEME.match(name):
        raise InputError(f"{where} is {short_uri!r}; it must be a relative path in the scene's folder")
    base = folder.resolve()
    path = (base / name).resolve()
    if not path.is_relative_to(base):
        raise InputError(f"{where} is {short_uri!r}, outside the scene's folder; put the file beside the scene")
    return path


# --- Locks between processes ------------------------------------------------------------------------------------------


_POLL_SECONDS = 0.05
_LOCK_FLAGS = os.O_RDWR | os.O_CREAT | getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_NONBLOCK", 0)

if sys.platform == "win32":
    import msvcrt
else:
    import fcntl


def lock(descriptor: int) -> None:
    """Lock an open file until it is closed; do not wait.

    Raises
    ------
    BlockingIOError
        If another process holds the lock.
    OSError
        If the file system does not support locks.
    """
    if sys.platform == "win32":
        try:
            msvcrt.locking(descriptor, msvcrt.LK_NBLCK, 1)
        except OSError as error:  # Windows does not report why
            raise BlockingIOError(*error.args) from error
    else:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)


@contextmanager
def file_lock(path: Path) -> Iterator[None]:
    """Hold the lock file `path` within the context, after waiting for the process that holds it. Ctrl-C stops waiting.

    The file is removed on exit, so a process that has waited then holds a nameless file. Callers must therefore check
    again, within the context, whether the work is still to be done.
    """
    handle = os.open(path, _LOCK_FLAGS, 0o600)
    try:
        while True:
            try:
                lock(handle)
                break
            except BlockingIOError:
                time.sleep(_POLL_SECONDS)
        yield
    finally:
        if os.name != "nt":
            with suppress(OSError):
                path.unlink()
        os.close(handle)


# --- Trusted files and folders ----------------------------------------------------------------------------------------


FOLDER_LOCK = ".lock"
"""The file in a temporary folder that is locked while its owner is alive; see `antumbra.base.files`."""

_WRITABLE = stat.S_IWGRP | stat.S_IWOTH
_READ_FLAGS = os.O_RDONLY | sum(getattr(os, name, 0) for name in ("O_NOFOLLOW", "O_NONBLOCK", "O_CLOEXEC", "O_BINARY"))


class Untrusted(OSError):
    """A folder or file that other users can modify; the message says which, and why."""


def make_folder(path: Path) -> None:
    """Create a folder and its missing parents with permissions for this user only; existing folders stay unchanged."""
    if not path.is_dir():
        make_folder(path.parent)
        path.mkdir(mode=0o700, exist_ok=True)


def check_trusted(path: Path, status: os.stat_result | None = None) -> None:
    """Raise `Untrusted` if users other than this one and the system's can modify a file or folder.

    Always passes on Windows, where user folders are private.

    status : of the open file; None means that of `path`

    Raises
    ------
    OSError
        If it does not exist.
    """
    status = path.stat() if status is None else status
    if not hasattr(os, "getuid"):
        return
    if status.st_uid not in (os.getuid(), 0):
        raise Untrusted(f"{path} belongs to another user (id {status.st_uid})")
    if status.st_mode & stat.S_IWOTH or (status.st_mode & stat.S_IWGRP and not _is_private_group(status.st_gid)):
        raise Untrusted(f"{path} can be changed by other users (try: chmod go-w)")


def read_trusted(path: Path) -> bytes:
    """The contents of a regular file that belongs to this user or to the system.

    Raises
    ------
    OSError
        If it does not exist, is a link, a pipe or a device, or if others can modify it (`Untrusted`).
    """
    descriptor = os.open(path, _READ_FLAGS)  # without O_NONBLOCK, a pipe would block forever
    with open(descriptor, "rb") as file:
        status = os.fstat(descriptor)
        if not stat.S_ISREG(status.st_mode):
            raise Untrusted(f"{path} is not a regular file")
        check_trusted(path, status)
        return file.read()


@cache
def private_folder(name: str) -> Path:
    """A new temporary folder that is private to this process and removed when it ends.

    If the process is killed, a later one removes it; see `antumbra.base.files`.
    """
    folder, owner = Path(tempfile.mkdtemp(prefix=f"antumbra-{name}-")), os.getpid()
    claim_folder(folder)
    atexit.register(lambda: shutil.rmtree(folder, ignore_errors=True) if os.getpid() == owner else None)
    return folder


def claim_folder(folder: str | Path) -> int:
    """Mark a temporary folder as in use by this process; return the descriptor that holds the lock."""
    descriptor = os.open(os.path.join(folder, FOLDER_LOCK), os.O_RDWR | os.O_CREAT, 0o600)
    with suppress(OSError):  # without locks, the folder is never removed
        lock(descriptor)
    return descriptor


def _is_private_group(group: int) -> bool:
    """Whether a group is this user's private group, which many systems create without other members."""
    try:
        import grp
        import pwd

        user, entry = pwd.getpwuid(os.getuid()), grp.getgrgid(group)
    except (ImportError, KeyError):
        return False
    return user.pw_gid == group and entry.gr_name == user.pw_name and set(entry.gr_mem) <= {user.pw_name}


# --- Temporary files --------------------------------------------------------------------------------------------------


_TEMPORARY_NAME = re.compile(r"(\.antumbra-[0-9a-f]{12})\.(tmp|lock)")
_FOLDER_NAME = re.compile(r"antumbra-(?:[a-z]+-)?[a-z0-9_]{8}")  # as named by mkdtemp
_MIN_AGE = 10.0  # seconds before a folder without a locked file counts as abandoned
_TRIES = 3  # attempts to lock a name before a file is created without a lock


@contextmanager
def temporary_name(folder: str | Path) -> Iterator[Path]:
    """Yield a new name in `folder`, reserved while this process is alive.

    On exit, a file or folder of that name is removed. The first call for a folder also removes those that killed
    processes left there.

    Raises
    ------
    OSError
        If no file can be created in `folder`.
    """
    remove_abandoned(os.path.realpath(folder))
    path, descriptor = _reserve_name(Path(folder))
    try:
        yield path
    finally:
        with suppress(OSError):
            _remove(str(path))
        if descriptor is not None:
            os.close(descriptor)  # first, for Windows
            with suppress(OSError):
                path.with_suffix(".lock").unlink()


def _remove(path: str) -> None:
    """Remove a file, or a folder with all its contents."""
    if os.path.isdir(path) and not os.path.islink(path):
        shutil.rmtree(path)
    else:
        os.unlink(path)


@contextmanager
def temporary_folder() -> Iterator[Path]:
    """Yield a new temporary folder, which is removed on exit.

    The first call also removes folders of this user left by killed processes.
    """
    parent = tempfile.gettempdir()
    remove_abandoned_folders(parent)
    folder = tempfile.mkdtemp(prefix="antumbra-", dir=parent)
    descriptor = claim_folder(folder)
    try:
        yield Path(folder)
    finally:
        os.close(descriptor)  # first, for Windows
        shutil.rmtree(folder, ignore_errors=True)


@cache
def remove_abandoned_folders(parent: str) -> None:
    """Remove this user's temporary folders in `parent` whose owners have ended."""
    with suppress(OSError), os.scandir(parent) as entries:
        for entry in entries:
            if _FOLDER_NAME.fullmatch(entry.name) and entry.is_dir(follow_symlinks=False) and _belongs_to_user(entry):
                with suppress(OSError):
                    _remove_folder_if_abandoned(entry.path)


def _belongs_to_user(entry: os.DirEntry[str]) -> bool:
    return not hasattr(os, "getuid") or entry.stat(follow_symlinks=False).st_uid == os.getuid()


def _remove_folder_if_abandoned(folder: str) -> None:
    """Remove a folder whose owner has ended; OSError if the owner is alive or cannot be determined."""
    descriptor = os.open(
        os.path.join(folder, FOLDER_LOCK), os.O_RDWR | getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_NONBLOCK", 0)
    )
    try:
        if time.time() - os.fstat(descriptor).st_mtime > _MIN_AGE:  # a younger folder's owner may be about to lock it
            lock(descriptor)
            shutil.rmtree(folder, ignore_errors=True)
    finally:
        os.close(descriptor)


@cache  # listing a folder with thousands of frames is slow
def remove_abandoned(folder: str) -> None:
    """Remove Antumbra's temporary files in `folder` whose owners have ended; files without a known owner stay."""
    with suppress(OSError), os.scandir(folder) as entries:
        files = [entry.name for entry in entries if entry.is_file(follow_symlinks=False)]
        for stem in {match[1] for name in files if (match := _TEMPORARY_NAME.fullmatch(name))}:
            with suppress(OSError):  # another user's, write-protected, or already gone
                _remove_if_abandoned(os.path.join(folder, stem))


def _reserve_name(folder: Path) -> tuple[Path, int | None]:
    """A new name and the descriptor that holds its lock, which is None if the file system has no locks."""
    for _ in range(_TRIES):
        path = folder / f".antumbra-{secrets.token_hex(6)}.tmp"
        file = path.with_suffix(".lock")
        descriptor = os.open(file, os.O_RDWR | os.O_CREAT | os.O_EXCL, 0o666)
        with suppress(OSError):
            lock(descriptor)
            if os.fstat(descriptor).st_nlink:  # 0 if another process removed it as abandoned before it was locked
                return path, descriptor
        os.close(descriptor)
        with suppress(OSError):
            file.unlink()
    return path.with_suffix(".part"), None  # without a lock, it is never removed by another process


def _remove_if_abandoned(stem: str) -> None:
    """Remove ``stem.tmp`` and ``stem.lock``; OSError if their owner is alive or cannot be determined."""
    descriptor = _lock_abandoned(stem + ".lock")
    try:
        shutil.rmtree(stem + ".tmp", ignore_errors=True)  # of an output that is a folder
        for suffix in (".tmp", ".lock"):  # the lock last: while it exists, only one process can remove the file
            with suppress(FileNotFoundError):
                _remove(stem + suffix)
    finally:
        if descriptor is not None:
            os.close(descriptor)


def _lock_abandoned(file: str) -> int | None:
    """Lock an abandoned lock file, and return its descriptor; None if its owner has removed it."""
    try:
        if os.name == "nt":
            os.unlink(file)  # fails while its owner has it open
            return None
        descriptor = os.open(file, os.O_RDWR | os.O_NOFOLLOW | os.O_NONBLOCK)
    except FileNotFoundError:
        return None
    try:
        lock(descriptor)
    except OSError:
        os.close(descriptor)
        raise
    return descriptor


# --- Atomic output ----------------------------------------------------------------------------------------------------


PARTS_MANIFEST = "_manifest.json"
"""File that completes a folder of Parquet."""

FOLDERS = {".zarr": (".zgroup", "zarr.json"), ".parquets": (PARTS_MANIFEST,)}
"""Suffixes of outputs that are folders -> files by which such a folder is known, so that it may be replaced."""

LEAST_BYTES = 1 << 16
"""Disk space that any output is assumed to need, in bytes."""

_UNSUPPORTED = errno.EOPNOTSUPP, errno.EINVAL, errno.ENOSYS


def checked_output(path: object, suffixes: Sequence[str], size: int = LEAST_BYTES) -> Path:
    """Check, before long work begins, that an output file can be written; return `path` as a `Path`.

    Parameters
    ----------
    path : str or path-like
    suffixes : sequence of str
        Allowed suffixes in lower case, such as ``(".png", ".exr")``.
    size : int
        Expected size of the file in bytes.

    Raises
    ------
    InputError
        If the suffix is not allowed, the folder is missing, not writable or full, or `path` is not a regular file.

    Notes
    -----
    An unnamed temporary file is briefly created in the folder. This detects conditions that permissions do not show,
    such as quotas and read-only file systems.
    """
    path = path_of(path, "output path")
    mode = _mode(path)
    kinds = alternatives(list(suffixes))
    known = FOLDERS.get(path.suffix.lower(), ()) if path.suffix.lower() in suffixes else ()
    if mode is not None and stat.S_ISDIR(mode) and not any((path / name).exists() for name in known):
        cure = (
            f"remove it, since it holds no {path.suffix} output, or name another"
            if known
            else f"name a {kinds} file in it"
        )
        raise InputError(f"{path}: is a folder; {cure}")
    if path.suffix.lower() not in suffixes:
        kind = f"unknown suffix {path.suffix!r}" if path.suffix else "the name has no suffix"
        raise InputError(f"{path}: {kind}; use {kinds}")
    _check_kind(path, mode)
    _check_access(path, exists=mode is not None)
    check_disk_space(path, size)
    return path


def checked_folder(path: object, parents: bool = False) -> Path:
    """Check, before long work begins, that a folder exists or can be created, and is writable.

    parents : whether missing parents will be created too

    Raises
    ------
    InputError
        If `path` is not a folder, its parent is missing, or it is not writable.
    """
    path = path_of(path, "folder")
    mode = _mode(path)
    if mode is not None and not stat.S_ISDIR(mode):
        raise InputError(f"{path}: is a file; name a folder")
    inside = path / "file" if mode is not None else path
    while parents and not inside.parent.exists():
        inside = inside.parent
    _check_access(inside, exists=False)
    check_disk_space(inside, LEAST_BYTES)
    return path


def check_disk_space(path: Path, size: int) -> None:
    """Raise an InputError unless a file of `size` bytes can be written at `path`, in an existing folder."""
    folder = os.path.dirname(os.path.realpath(path))
    try:
        with TemporaryFile(dir=folder) as file:
            file.write(bytes(min(size, LEAST_BYTES)))
            file.flush()
        free = shutil.disk_usage(folder).free
    except OSError as error:
        raise InputError(f"{path}: cannot be written ({_reason(error)}); choose another place") from None
    if size > free:
        raise InputError(
            f"{path}: takes {size / 1e6:,.1f} MB, and {folder} has {free / 1e6:,.1f} MB left; free some, or choose "
            "another place"
        )


def reserve(descriptor: int, size: int) -> None:
    """Extend an open file to `size` bytes, and reserve the disk space if the system supports it.

    A full disk then raises an OSError here. Otherwise it would raise one on later writes, or kill the process if they
    go through a memory map.
    """
    try:
        os.posix_fallocate(descriptor, 0, size)
    except AttributeError:  # Windows, macOS
        os.truncate(descriptor, size)
    except OSError as error:
        if error.errno not in _UNSUPPORTED:
            raise
        os.truncate(descriptor, size)


@contextmanager
def atomic_output(path: str | os.PathLike[str], *, durable: bool = False) -> Iterator[Path]:
    """Yield a temporary name beside `path`; on exit without an exception, the temporary file replaces `path`.

    durable : wait until the new name is on disk, so that it survives even a power failure

    Raises
    ------
    InputError
        If `path` is a device or pipe, or writing fails; the message names `path` and the reason. No file is left
        behind, and an existing file stays.
    """
    target = Path(os.path.realpath(path))  # keeps symbolic links
    _check_kind(path, _mode(target))  # os.replace would turn a device such as /dev/null into a file
    with writing(path), temporary_name(target.parent) as temporary:
        yield temporary
        os.replace(temporary, target)
        if durable:
            _sync_folder(target.parent)


@contextmanager
def writing(path: str | os.PathLike[str]) -> Iterator[None]:
    """Within the context, an OSError becomes an InputError that says that `path` cannot be written, and why."""
    try:
        yield
    except OSError as error:
        raise InputError(f"{path}: cannot be written ({_reason(error)}); choose another place") from error


@contextmanager
def atomic_folder(path: Path) -> Iterator[Path]:
    """As `atomic_output`, for an output that is a folder: the caller makes the temporary one."""
    target = Path(os.path.realpath(path))
    try:
        with temporary_name(target.parent) as temporary, temporary_name(target.parent) as old:
            try:
                yield temporary
                if target.exists():
                    os.replace(target, old)
                os.replace(temporary, target)
            finally:
                for each in (temporary, old):
                    shutil.rmtree(each, ignore_errors=True)
    except OSError as error:
        raise InputError(f"{path}: cannot be written ({_reason(error)}); choose another place") from error


def _sync_folder(folder: Path) -> None:
    if os.name == "posix":  # Windows cannot open folders
        descriptor = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(descriptor)
        finally:
            os.close(descriptor)


def _mode(path: Path) -> int | None:
    try:
        return os.stat(path).st_mode
    except FileNotFoundError:
        return None
    except NotADirectoryError:
        raise InputError(f"{path}: {path.parent} is not a folder; choose another place") from None
    except (OSError, ValueError) as error:
        raise InputError(f"{path}: cannot be written ({_reason(error)}); choose another place") from None


def _check_kind(path: str | os.PathLike[str], mode: int | None) -> None:
    if mode is not None and not (stat.S_ISREG(mode) or stat.S_ISDIR(mode)):
        raise InputError(f"{path}: is not a regular file; choose another name")


def _check_access(path: Path, exists: bool) -> None:
    folder = os.path.dirname(os.path.realpath(path))
    if not os.path.isdir(folder):
        raise InputError(f"{path}: the folder {folder} does not exist; make it first")
    if not os.access(folder, os.W_OK | os.X_OK):
        raise InputError(f"{path}: no permission to write in {folder}; choose another place")
    if exists and not os.access(path, os.W_OK):
        raise InputError(f"{path}: is write-protected; choose another name")


def _reason(error: Exception) -> str:
    return " ".join(str(getattr(error, "strerror", None) or error).split()) or type(error).__name__
