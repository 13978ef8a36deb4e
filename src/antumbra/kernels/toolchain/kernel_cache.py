"""The kernel cache: machine code from packs and from the user's folder, loaded into this process or compiled.

Packs come with the package. Packs and folder are indexed by kernel digest (`kernel_digest`). The user's folder is
divided by compiler version and processor level. A pack's name contains its level; packs are tested where they are
built. llvmlite links loaded code, and Numba is imported only to compile.
"""

import ctypes
import json
import os
import re
import shutil
import stat
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager, suppress
from functools import cache
from hashlib import blake2b
from importlib.metadata import version
from pathlib import Path
from typing import Any, NamedTuple

import llvmlite.binding as llvm

from ... import files as locks
from ...files import Untrusted, check_trusted, make_folder, private_folder, read_trusted
from ...progress import LOG
from ..jit import kernel
from ..machine_code import KernelCode, from_record, level, symbol_of
from ..marshalling import NONE, ResultReader
from . import kernel_digest as definitions
from .kernel_digest import kernel_digest

# --- Packs and the user's folder --------------------------------------------------------------------------------------


_DAY = 86400.0
UNUSED_DAYS = 60
"""Code that has not been loaded for this many days is evicted."""

_COMPILER = "machine_code", "toolchain.compiling", "toolchain.numba_frontend"
PACKS = Path(__file__).parents[1] / "packs"


def _user_cache() -> Path:
    if sys.platform == "win32":
        return Path(os.environ.get("LOCALAPPDATA") or Path.home() / "AppData" / "Local")
    if sys.platform == "darwin":
        return Path.home() / "Library" / "Caches"
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")


@cache
def cache_folder() -> Path:
    """The user's kernel cache: ``ANTUMBRA_CACHE``, or else a folder in the system's cache folder.

    If other users can modify it, a private folder of this process is used instead.
    """
    root = Path(os.environ.get("ANTUMBRA_CACHE") or _user_cache() / "antumbra")
    try:
        check_cache(root)
    except Untrusted as error:
        LOG.warning(f"{error}: kernels are compiled for this process alone")
        return private_folder("kernels")
    return root


def check_cache(root: Path) -> None:
    """Raise `Untrusted` if other users can modify a cache, or a folder in it with this compiler's kernels."""
    ours = root / "kernels" / toolchain()
    for folder in (root, ours.parent, ours, *ours.glob("*")):
        with suppress(FileNotFoundError, NotADirectoryError, PermissionError):
            check_trusted(folder)


@cache
def toolchain() -> str:
    """The compiler's name: the versions of Numba and llvmlite, and a digest of the modules that compile."""
    sources = "".join(definitions.module_digest(f"antumbra.kernels.{name}") for name in _COMPILER)
    digest = blake2b(sources.encode(), digest_size=4).hexdigest()
    return f"numba-{version('numba')}-llvmlite-{version('llvmlite')}-{digest}"


class KernelFolder:
    """A folder with one file per kernel and kinds of arguments."""

    def __init__(self, root: Path, level: str) -> None:
        self.root, self.level, self.path = root, level, root / "kernels" / toolchain() / level

    def _file(self, digest: str) -> Path:
        return self.path / f"{digest}.kernel"

    def get(self, digest: str) -> KernelCode | None:
        """The code stored under a digest; None if there is none, or if the file is damaged."""
        file = self._file(digest)
        try:
            data = read_trusted(file)
            if time.time() - file.stat().st_mtime > _DAY:
                os.utime(file)  # marks it as used for pruning
        except OSError:
            return None
        return from_record(data)

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
        return locks.file_lock(self.path / f"{digest}.lock")

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


class KernelPack:
    """Records of many kernels in one file, with an index beside it: {digest: [offset, size]}."""

    def __init__(self, path: Path) -> None:
        self._path, self._index = path, json.loads(path.with_suffix(".json").read_text())

    def get(self, digest: str) -> KernelCode | None:
        if digest not in self._index:
            return None
        offset, size = self._index[digest]
        with open(self._path, "rb") as file:
            file.seek(offset)
            return from_record(file.read(size))

    def has(self, digest: str) -> bool:
        return digest in self._index


def write_pack(folder: Path, level: str, codes: dict[str, KernelCode]) -> Path:
    """Write a pack for a level from {digest: code}, and return its path."""
    folder.mkdir(parents=True, exist_ok=True)
    path, index, offset = _pack_path(folder, level), {}, 0
    with open(path, "wb") as file:
        for digest, code in sorted(codes.items()):
            record = code.record()
            index[digest] = [offset, len(record)]
            offset += file.write(record)
    path.with_suffix(".json").write_text(json.dumps(index, separators=(",", ":")))
    return path


def _pack_path(folder: Path, level: str) -> Path:
    return folder / f"{sys.platform}-{level}.pack"  # object file formats depend on the system


@cache
def packs(level: str) -> list[KernelPack]:
    """The packs for a level, from the folder ``ANTUMBRA_PACKS``, or else from the package."""
    try:
        return [KernelPack(_pack_path(Path(os.environ.get("ANTUMBRA_PACKS") or PACKS), level))]
    except (OSError, ValueError):
        return []


# --- Loading ----------------------------------------------------------------------------------------------------------


_UNUSED = ctypes.create_string_buffer(8)  # for kernels without results
_ENTRY = ctypes.CFUNCTYPE(ctypes.c_int64, ctypes.c_char_p, ctypes.c_char_p)


class LoadEvent(NamedTuple):
    """Where the machine code of a kernel came from."""

    kernel: str
    key: str
    source: str  # "pack", "cache" or "compiled"


events: list[LoadEvent] = []
"""All kernels loaded by this process, in order."""


@cache
def user_cache() -> KernelFolder:
    """The folder of this user's kernels for this processor."""
    return KernelFolder(cache_folder(), level())


def find(function: kernel, key: str) -> Callable[[bytes], Any]:
    """A function of packed arguments that runs a kernel, loaded from a file, or compiled and cached."""
    digest = kernel_digest(function, key)
    code, source = _cached(digest) or compiled(function, key, digest)
    events.append(LoadEvent(function.name, key, source))
    return _linked(code, symbol_of(digest))


def _stores() -> list[tuple[KernelPack | KernelFolder, str]]:
    return [*((pack, "pack") for pack in packs(level())), (user_cache(), "cache")]


def _cached(digest: str) -> tuple[KernelCode, str] | None:
    return next(((code, source) for store, source in _stores() if (code := store.get(digest))), None)


def is_cached(function: kernel, key: str) -> bool:
    """Whether a kernel's machine code for the argument kinds of `key` is on disk."""
    digest = kernel_digest(function, key)
    return any(store.has(digest) for store, _ in _stores())


def compiled(function: kernel, key: str, digest: str) -> tuple[KernelCode, str]:
    """(code, its source). The code is compiled and cached here, unless another process is already compiling it."""
    folder = user_cache()
    try:
        return load_or_compile(function, key, digest, [folder])[0]
    except OSError as error:
        _warn_once(f"{folder.path} cannot be written ({error.strerror}): kernels are compiled each time")
        from . import compiling

        return compiling.compile_kernel(function, key, digest, [folder.level])[0], "compiled"


def load_or_compile(
    function: kernel, key: str, digest: str, folders: Sequence[KernelFolder]
) -> list[tuple[KernelCode, str]]:
    """(code, its source) for each folder. If another process is compiling the kernel, wait for its code.

    Raises
    ------
    OSError
        If a folder is not writable.
    """
    with folders[0].lock(digest):
        codes = {folder: code for folder in folders if (code := folder.get(digest)) is not None}
        missing = [folder for folder in folders if folder not in codes]
        if missing:
            from . import compiling  # imports Numba

            compiled_codes = compiling.compile_kernel(function, key, digest, [folder.level for folder in missing])
            for folder, code in zip(missing, compiled_codes):
                folder.put(digest, code)
                codes[folder] = code
    return [(codes[folder], "compiled" if folder in missing else "cache") for folder in folders]


@cache
def _warn_once(line: str) -> None:
    LOG.warning(line)


@cache
def _engine() -> llvm.ExecutionEngine:
    llvm.initialize_native_target()
    llvm.initialize_native_asmprinter()
    machine = llvm.Target.from_default_triple().create_target_machine(opt=2, jit=True)
    return llvm.create_mcjit_compiler(llvm.parse_assembly(""), machine)


def _linked(code: KernelCode, symbol: str) -> Callable[[bytes], Any]:
    """A function that runs machine code. Call `_linked` under the lock of `jit`."""
    engine, result, name = _engine(), ResultReader(code.result), code.kernel
    engine.add_object_file(llvm.ObjectFileRef.from_data(code.machine))
    engine.finalize_object()
    address = engine.get_function_address(symbol)
    if not address:
        raise RuntimeError(f"{name}: its machine code has no function {symbol}")
    run = _ENTRY(address)

    def call_without_result(words: bytes) -> None:
        status = run(words, _UNUSED)
        if status:
            raise RuntimeError(f"{name}: error {status} in compiled code")

    def call(words: bytes) -> object:
        memory = ctypes.create_string_buffer(result.size)
        status = run(words, memory)
        if status:
            raise RuntimeError(f"{name}: error {status} in compiled code")
        return result(memory)

    return call_without_result if code.result == NONE else call
