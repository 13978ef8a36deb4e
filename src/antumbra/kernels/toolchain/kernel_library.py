"""Kernel libraries: the machine code of a release's kernels, loaded by ctypes alone, without Numba and LLVM.

An installed package has a shared library for each processor level of its system, and a list, ``kernels.json``: the
symbol and the kind of the result of each kernel and kinds of arguments, the files in which the kernels are defined, and
a digest of these files.

Validity. Libraries are of the very sources beside them, so a call needs no digest. If one of the files has been changed
since, its time is later than the library's. Only then are the files read, and if their digest differs, the libraries do
not count. Library names are those of the package's own folder: no setting makes a process load another one.
"""

import ctypes
import json
from collections.abc import Callable
from functools import cache
from hashlib import blake2b
from pathlib import Path
from typing import Any, NamedTuple

from ..marshalling import NONE, ResultReader, Spec
from ..processor import LIBRARIES, level, library_path

LIST, MODULE = "kernels.json", "kernels.wasm"
"""Names of the list of a library, and of the module of WebAssembly."""

PACKAGE = Path(__file__).parents[2]
_SLACK = 120.0  # seconds within which an installer writes all files


class LibraryKernel(NamedTuple):
    """A kernel in the libraries."""

    symbol: str
    result: Spec


class LibraryList(NamedTuple):
    """The contents of ``kernels.json``."""

    files: list[str]  # in which kernels are defined, relative to the package
    digest: str  # of the files
    kernels: dict[str, LibraryKernel]  # by `name_of`

    def write(self, folder: Path) -> None:
        """Write the list into the folder of its libraries."""
        (folder / LIST).write_text(json.dumps(self._asdict(), separators=(",", ":")))

    @classmethod
    def read(cls, folder: Path) -> "LibraryList":
        """The list in a folder. Raises OSError, ValueError, KeyError or TypeError if there is none."""
        contents = json.loads((folder / LIST).read_text())
        kernels = {name: LibraryKernel(*each) for name, each in contents["kernels"].items()}
        return cls(contents["files"], contents["digest"], kernels)

    @classmethod
    def installed(cls, folder: Path) -> "LibraryList | None":
        """The list in a folder of this package; None if there is none, or if sources have changed since."""
        try:
            contents, made = cls.read(folder), (folder / LIST).stat().st_mtime
            edited = any((PACKAGE / file).stat().st_mtime > made + _SLACK for file in contents.files)
            return None if edited and digest_of(PACKAGE, contents.files) != contents.digest else contents
        except (OSError, ValueError, KeyError, TypeError):
            return None


def name_of(kernel: str, key: str) -> str:
    """The name of a kernel, ``module:qualname``, and its kinds of arguments, in a `LibraryList`."""
    return f"{kernel} {key}"


def digest_of(package: Path, files: list[str]) -> str:
    """A digest of files of the package, whatever their line ends."""
    digest = blake2b(digest_size=16)
    for file in files:
        text = (package / file).read_bytes().replace(b"\r\n", b"\n")
        digest.update(f"{file} {len(text)}\n".encode() + text)
    return digest.hexdigest()


class KernelLibrary(NamedTuple):
    """The library for this processor."""

    kernels: dict[str, LibraryKernel]
    library: ctypes.CDLL

    def function(self, kernel: str, key: str) -> Callable[[bytes], Any] | None:
        """A function of packed arguments that runs a kernel; None if the library lacks it."""
        entry = self.kernels.get(name_of(kernel, key))
        return None if entry is None else callable_of(_ENTRY((entry.symbol, self.library)), entry.result, kernel)


@cache
def installed_library() -> KernelLibrary | None:
    """The library of this package for this processor; None if there is none, or if sources have changed since."""
    contents = LibraryList.installed(LIBRARIES)
    if contents is None:
        return None
    try:
        return KernelLibrary(contents.kernels, ctypes.CDLL(str(library_path(LIBRARIES, level()))))
    except OSError:
        return None


# --- Functions of packed arguments ------------------------------------------------------------------------------------


_UNUSED = ctypes.create_string_buffer(8)  # for kernels without results
_ENTRY = ctypes.CFUNCTYPE(ctypes.c_int64, ctypes.c_char_p, ctypes.c_char_p)


def callable_at(address: int, result: Spec, name: str) -> Callable[[bytes], Any]:
    """`callable_of` for the function at an address."""
    return callable_of(_ENTRY(address), result, name)


def callable_of(run: Callable[..., int], result: Spec, name: str) -> Callable[[bytes], Any]:
    """A function of packed arguments that runs a kernel.

    run : the kernel's entry function, see `compiling`
    name : of the kernel, for error messages
    """
    reader = ResultReader(result)

    def call_without_result(words: bytes) -> None:
        status = run(words, _UNUSED)
        if status:
            raise RuntimeError(f"{name}: error {status} in compiled code")

    def call(words: bytes) -> object:
        memory = ctypes.create_string_buffer(reader.size)
        status = run(words, memory)
        if status:
            raise RuntimeError(f"{name}: error {status} in compiled code")
        return reader(memory)

    return call_without_result if result == NONE else call
