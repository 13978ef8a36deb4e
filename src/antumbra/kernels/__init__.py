"""Compiled functions: their building blocks, and their way to machine code. Nothing here knows a scene.

- `jit`: the decorators `kernel`, `inlined`, `formula`, `overload`; types of the fields of kernel arguments
- `marshalling`: arguments and results as 8-byte words
- `machine_code`: processor levels, LLVM's optimisation and emission for a level, the record of a kernel's code
- `simd/`: vectors as values inside kernels
- `vec3`: three coordinates at once, of scalars or of vectors
- `exact/`: the exact test of a ray and a triangle
- `parallel`: threads that share the work of one kernel
- `ticket_loops`: loops over the items of a ticket, imported only by the compiler
- `toolchain/`: digests, compilation, the cache of machine code, compilation ahead of time
"""

from importlib import import_module

from . import jit


def _late(module: str, name: str):
    """A function whose module is imported at its first call, because the import of Numba is slow."""
    return lambda *arguments: getattr(import_module(f"{__name__}.{module}"), name)(*arguments)


jit.above = jit.Above(
    _late("toolchain.kernel_cache", "find"),
    _late("toolchain.compiling", "type_of_function"),
    _late("toolchain.compiling", "type_of_global"),
)
