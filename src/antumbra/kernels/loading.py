"""Load machine code from files into this process. llvmlite links it, and Numba is not needed."""

import ctypes
from collections.abc import Callable, Sequence
from functools import cache
from typing import NamedTuple

import llvmlite.binding as llvm

from .arguments import NONE, Result
from .cache import Folder, Pack, cache_folder, packs
from .closure import kernel_digest
from .code import Code, symbol_of
from .jit import kernel
from .processor import level
from .progress import LOG

_UNUSED = ctypes.create_string_buffer(8)  # for the results of kernels that have none
_ENTRY = ctypes.CFUNCTYPE(ctypes.c_int64, ctypes.c_char_p, ctypes.c_char_p)


class Event(NamedTuple):
    """The source of a kernel's machine code."""

    kernel: str
    key: str
    source: str  # "pack", "cache" or "compiled"


events: list[Event] = []
"""All kernels that this process has loaded, in order."""


@cache
def user_cache() -> Folder:
    return Folder(cache_folder(), level())


def find(function: kernel, key: str) -> Callable:
    """A function of packed arguments that runs a kernel: loaded from a file, or compiled and kept."""
    digest = kernel_digest(function, key)
    code, source = _kept(digest) or compiled(function, key, digest)
    events.append(Event(function.name, key, source))
    return _linked(code, symbol_of(digest))


def _stores() -> list[tuple[Pack | Folder, str]]:
    return [*((pack, "pack") for pack in packs(level())), (user_cache(), "cache")]


def _kept(digest: str) -> tuple[Code, str] | None:
    return next(((code, source) for store, source in _stores() if (code := store.get(digest))), None)


def is_kept(function: kernel, key: str) -> bool:
    """Whether machine code of a kernel for arguments of a kind is on disk."""
    digest = kernel_digest(function, key)
    return any(store.has(digest) for store, _ in _stores())


def compiled(function: kernel, key: str, digest: str) -> tuple[Code, str]:
    """(code, its source). The code is compiled here and kept, or another process compiles it at the same time."""
    folder = user_cache()
    try:
        return kept_or_made(function, key, digest, [folder])[0]
    except OSError as error:
        _say_once(f"{folder.path} cannot be written ({error.strerror}): kernels are compiled each time")
        from . import compiling

        return compiling.make(function, key, digest, [folder.level])[0], "compiled"


def kept_or_made(function: kernel, key: str, digest: str, folders: Sequence[Folder]) -> list[tuple[Code, str]]:
    """(code, its source) for each folder. If another process compiles the kernel, this one waits for its code.

    Raises
    ------
    OSError
        If a folder cannot be written.
    """
    with folders[0].lock(digest):
        found = {folder: folder.get(digest) for folder in folders}
        missing = [folder for folder in folders if found[folder] is None]
        if missing:
            from . import compiling  # imports Numba

            made = compiling.make(function, key, digest, [folder.level for folder in missing])
            for folder, code in zip(missing, made):
                folder.put(digest, code)
                found[folder] = code
    return [(found[folder], "compiled" if folder in missing else "cache") for folder in folders]


@cache
def _say_once(line: str) -> None:
    LOG.warning(line)


@cache
def _engine() -> llvm.ExecutionEngine:
    llvm.initialize_native_target()
    llvm.initialize_native_asmprinter()
    machine = llvm.Target.from_default_triple().create_target_machine(opt=2, jit=True)
    return llvm.create_mcjit_compiler(llvm.parse_assembly(""), machine)


def _linked(code: Code, symbol: str) -> Callable:
    """A function that runs machine code. Call it under the lock of `jit`."""
    engine, result, name = _engine(), Result(code.result), code.kernel
    engine.add_object_file(llvm.ObjectFileRef.from_data(code.machine))
    engine.finalize_object()
    address = engine.get_function_address(symbol)
    if not address:
        raise RuntimeError(f"{name}: its machine code has no function {symbol}")
    run = _ENTRY(address)

    def nothing(words: bytes):
        status = run(words, _UNUSED)
        if status:
            raise RuntimeError(f"{name}: error {status} in compiled code")

    def call(words: bytes):
        memory = ctypes.create_string_buffer(result.size)
        status = run(words, memory)
        if status:
            raise RuntimeError(f"{name}: error {status} in compiled code")
        return result(memory)

    return nothing if code.result == NONE else call
