"""Loading: a kernel's machine code from the package's library, from the user's cache, or compiled.

With a library for this processor, neither Numba nor llvmlite is needed. Kernels that it lacks (of plugins, of edited
sources) are linked by llvmlite from the user's cache, and Numba is imported only to compile what is not there.
"""

from collections.abc import Callable, Sequence
from functools import cache
from typing import Any, NamedTuple

from ...base.errors import InputError
from ...base.extras import import_extra
from ...base.progress import LOG
from ..jit import kernel
from ..processor import level
from .kernel_cache import KernelCode, KernelFolder, symbol_of, user_cache
from .kernel_digest import kernel_digest
from .kernel_library import callable_at, installed_library, name_of


class LoadEvent(NamedTuple):
    """Where the machine code of a kernel came from."""

    kernel: str
    key: str
    source: str  # "library", "cache" or "compiled"


events: list[LoadEvent] = []
"""All kernels loaded by this process, in order."""


def find(function: kernel, key: str) -> Callable[[bytes], Any]:
    """A function of packed arguments that runs a kernel.

    Raises
    ------
    InputError
        If the kernel must be compiled or linked, and Numba or llvmlite is missing.
    """
    library = installed_library()
    run = None if library is None else library.function(function.name, key)
    if run is not None:
        events.append(LoadEvent(function.name, key, "library"))
        return run
    _require_compiler(function.name)
    digest = kernel_digest(function, key)
    cached = user_cache().get(digest)
    code, source = compiled(function, key, digest) if cached is None else (cached, "cache")
    events.append(LoadEvent(function.name, key, source))
    return _linked(code, symbol_of(digest))


def is_on_disk(function: kernel, key: str) -> bool:
    """Whether a kernel's machine code for the argument kinds of `key` is on disk."""
    library = installed_library()
    if library is not None and name_of(function.name, key) in library.kernels:
        return True
    return has_compiler() and user_cache().has(kernel_digest(function, key))


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


# --- The compiler -----------------------------------------------------------------------------------------------------


@cache
def has_compiler() -> bool:
    """Whether Numba and llvmlite are installed."""
    from importlib.util import find_spec

    return all(find_spec(package) is not None for package in ("numba", "llvmlite"))


def _require_compiler(name: str) -> None:
    if not has_compiler():
        raise InputError(
            f"{name} is not among the compiled kernels of this installation ({level()}), so it needs a compiler: "
            "pip install 'antumbra[jit]'"
        )


@cache
def _engine() -> Any:
    llvm = import_extra("llvmlite.binding", "linking kernels", "jit")
    llvm.initialize_native_target()
    llvm.initialize_native_asmprinter()
    machine = llvm.Target.from_default_triple().create_target_machine(opt=2, jit=True)
    return llvm.create_mcjit_compiler(llvm.parse_assembly(""), machine)


def _linked(code: KernelCode, symbol: str) -> Callable[[bytes], Any]:
    """A function that runs machine code. Call `_linked` under the lock of `jit`."""
    llvm, engine = import_extra("llvmlite.binding", "linking kernels", "jit"), _engine()
    engine.add_object_file(llvm.ObjectFileRef.from_data(code.machine))
    engine.finalize_object()
    address = engine.get_function_address(symbol)
    if not address:
        raise RuntimeError(f"{code.kernel}: its machine code has no function {symbol}")
    return callable_at(address, code.result, code.kernel)
