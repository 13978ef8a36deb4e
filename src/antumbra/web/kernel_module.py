"""The module of kernels of pages and of the package for JavaScript: WebAssembly, and the list that names its kernels.

Platform wheels contain it, so that pages need neither a compiler nor a linker. Elsewhere, or if sources have changed,
`kernel_linking` links it on first use.
"""

from contextlib import suppress
from functools import cache
from pathlib import Path
from typing import NamedTuple

from ..base.extras import import_extra
from ..kernels.toolchain.kernel_library import MODULE, LibraryKernel, LibraryList

FOLDER = Path(__file__).parent / "kernels"
"""The folder of the module in an installed package."""

_USER = "the first page of an installation without kernels"


class KernelModule(NamedTuple):
    """Kernels in WebAssembly."""

    wasm: bytes
    kernels: dict[str, LibraryKernel]  # by `kernel_library.name_of`


@cache
def kernel_module() -> KernelModule:
    """The module: that of the wheel, that of the cache, or one linked now.

    Raises
    ------
    InputError
        If it has to be linked, and the compiler or the linker is not installed.
    RuntimeError
        If a kernel is unknown, or cannot be compiled or linked.
    """
    with suppress(OSError):
        if (installed := LibraryList.installed(FOLDER)) is not None:
            return KernelModule((FOLDER / MODULE).read_bytes(), installed.kernels)
    for package, extra in ("numba", "jit"), ("ziglang", "build"):
        import_extra(package, _USER, extra)
    from .kernel_linking import linked_module

    return KernelModule(*linked_module())
