"""The kernel cache: the user's folder of compiled kernels, indexed by kernel digest (`kernel_digest`).

It is divided by compiler version and processor level. A record is ``magic, checksum, length of the description,
description (JSON), object file (zlib)``. The checksum detects truncated and modified records, and the symbol in the
object file those of other kernels: both count as missing, and are replaced.
"""

import json
import os
import re
import shutil
import stat
import sys
import tempfile
import time
import zlib
from collections.abc import Callable
from contextlib import AbstractContextManager, suppress
from functools import cache
from hashlib import blake2b
from pathlib import Path
from typing import NamedTuple

from ...base import files
from ...base.files import Untrusted, check_trusted, make_folder, private_folder, read_trusted
from ...base.progress import LOG
from ..marshalling import Spec
from ..processor import level
from . import kernel_digest

# --- Records ----------------------------------------------------------------------------------------------------------


_MAGIC = b"antumbra kernel 1\n"
_SUM = 16
_HEAD = len(_MAGIC) + _SUM


class KernelCode(NamedTuple):
    """Everything that a call from Python needs."""

    kernel: str  # module:qualname
    key: str  # kinds of the arguments, separated by spaces
    result: Spec  # kind of the result
    machine: bytes  # object file; the function's name contains the digest (`symbol_of`)

    def record(self) -> bytes:
        """The bytes of the record."""
        about = json.dumps([self.kernel, self.key, self.result]).encode()
        body = len(about).to_bytes(4, "little") + about + zlib.compress(self.machine, 6)
        return _MAGIC + blake2b(body, digest_size=_SUM).digest() + body


def symbol_of(digest: str) -> str:
    """The name of the function in the object file of a digest."""
    return f"antumbra_{digest}"


def from_record(data: bytes) -> KernelCode | None:
    """The code in a record, or None if the record is damaged."""
    body = data[_HEAD:]
    if not data.startswith(_MAGIC) or blake2b(body, digest_size=_SUM).digest() != data[len(_MAGIC) : _HEAD]:
        return None
    end = 4 + int.from_bytes(body[:4], "little")
    try:
        kernel, key, result = json.loads(body[4:end])
        return KernelCode(kernel, key, result, zlib.decompress(body[end:]))
    except (ValueError, TypeError, RecursionError, zlib.error):  # a valid checksum of something else
        return None


# --- The user's folder ------------------------------------------------------------------------------------------------


_DAY = 86400.0
UNUSED_DAYS = 60
"""Code that has not been loaded for this many days is evicted."""

_COMPILER = "machine_code", "processor", "toolchain.compiling", "toolchain.numba_frontend"


def _user_cache() -> Path:
    if sys.platform == "win32":
        return Path(os.environ.get("LOCALAPPDATA") or Path.home() / "AppData" / "Local")
    if sys.platform == "darwin":
        return Path.home() / "Library" / "Caches"
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")


@cache
def cache_root() -> Path:
    """The user's cache: ``ANTUMBRA_CACHE``, or else a folder in the system's cache folder.

    If other users can modify it, a private folder of this process is used instead.
    """
    return _trusted(Path(os.environ.get("ANTUMBRA_CACHE") or _user_cache() / "antumbra"), _check_folders)


@cache
def cache_folder() -> Path:
    """The user's kernel cache: `cache_root`, unless other users can modify the folders of kernels in it."""
    return _trusted(cache_root(), check_cache)


def _trusted(root: Path, check: Callable[[Path], None]) -> Path:
    """A cache if it passes the check; a private folder of this process if it does not."""
    try:
        check(root)
    except Untrusted as error:
        LOG.warning(f"{error}: kernels are compiled for this process alone")
        return private_folder("kernels")
    return root


def check_cache(root: Path) -> None:
    """Raise `Untrusted` if other users can modify a cache, or a folder in it with this compiler's kernels."""
    ours = root / "kernels" / toolchain()
    _check_folders(root, ours.parent, ours, *ours.glob("*"))


def _check_folders(*folders: Path) -> None:
    for folder in folders:
        with suppress(FileNotFoundError, NotADirectoryError, PermissionError):
            check_trusted(folder)


@cache
def toolchain() -> str:
    """The compiler's name: the versions of Numba and llvmlite, and a digest of the modules that compile."""
    sources = "".join(kernel_digest.module_digest(f"antumbra.kernels.{name}") for name in _COMPILER)
    digest = blake2b(sources.encode(), digest_size=4).hexdigest()
    return f"numba-{_version('numba')}-llvmlite-{_version('llvmlite')}-{digest}"


def _version(package: str) -> str:
    from importlib.metadata import PackageNotFoundError, version  # slow to import, and not needed with a library

    try:
        return version(package)
    except PackageNotFoundError:
        return "none"


class KernelFolder:
    """A folder with one file per kernel and kinds of arguments."""

    def __init__(self, root: Path, level: str) -> None:
        self.root, self.level, self.path = root, level, root / "kernels" / toolchain() / level

    def _file(self, digest: str) -> Path:
        return self.path / f"{digest}.kernel"

    def get(self, digest: str) -> KernelCode | None:
        """The code stored under a digest; None if there is none, or if the file is damaged or another kernel's."""
        file = self._file(digest)
        try:
            data = read_trusted(file)
            if time.time() - file.stat().st_mtime > _DAY:
                os.utime(file)  # marks it as used for pruning
        except OSError:
            return None
        code = from_record(data)
        return code if code is not None and symbol_of(digest).encode() in code.machine else None

    def has(self, digest: str) -> bool:
        try:
            file = self._file(digest)
            status = file.lstat()
            check_trusted(file, status)
        except OSError:
            return False
        return stat.S_ISREG(status.st_mode)

    def put(self, digest: str, code: KernelCode) -> None:
        """Store code atomically: readers see a complete file or none.

        Raises
        ------
        OSError
            If the folder is not writable.
        """
        make_folder(self.path)
        handle, name = tempfile.mkstemp(dir=self.path, prefix=f"{digest}.", suffix=".part")
        try:
            with os.fdopen(handle, "wb") as file:
                file.write(code.record())
            os.replace(name, self._file(digest))
        except BaseException:
            with suppress(OSError):
                os.unlink(name)
            raise

    def is_writable(self) -> bool:
        try:
            make_folder(self.path)
        except OSError:
            return False
        return os.access(self.path, os.W_OK)

    def lock(self, digest: str) -> AbstractContextManager[None]:
        """The lock held by the process that compiles the kernel of a digest."""
        make_folder(self.path)
        return files.file_lock(self.path / f"{digest}.lock")

    def prune(self) -> None:
        """Evict code unused for `UNUSED_DAYS`, and files of older versions of the package."""
        oldest = time.time() - UNUSED_DAYS * _DAY
        for file in self.root.glob("kernels/*/*/*"):
            with suppress(OSError):
                limit = time.time() - _DAY if file.suffix in (".part", ".lock") else oldest
                if file.stat().st_mtime < limit:
                    file.unlink()
        for folder in (*self.root.glob("kernels/*/*"), *self.root.glob("kernels/*")):
            with suppress(OSError):
                folder.rmdir()  # if it is empty
        for folder in self.root.glob("*"):
            if re.fullmatch(r"[0-9a-f]{16}", folder.name) and (folder / "compiled").is_dir():  # of version 0.1
                shutil.rmtree(folder, ignore_errors=True)


@cache
def user_cache() -> KernelFolder:
    """The folder of this user's kernels for this processor."""
    return KernelFolder(cache_folder(), level())
