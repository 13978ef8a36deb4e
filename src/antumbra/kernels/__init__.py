"""Compiled functions: their building blocks, and their way to machine code. Nothing here knows a scene.

Building blocks of kernels:

- jit: the decorators `kernel`, `inlined`, `overload`
- simd/: vectors as values inside kernels; vec: three coordinates at once; fields: types for readers
- predicate/: the exact test of a ray and a triangle
- parallel: threads that share the work of one kernel

From a call to machine code, without Numba:

- arguments: the kinds and values of arguments, as 8-byte words
- closure, definitions: a digest of all code and constants that a kernel reaches
- loading, cache, code, locks: linking of object files from packs and from the user's folder
- private: folders and files that other users cannot change
- processor: levels of processors

Compiling:

- compiling, parts, library, entry, machine, numba_speed, numba_import: Numba and LLVM
- crew, worker, progress: several compiling processes at once
- needs: the recorded kernels of each job; pack: packs for wheels
"""

from importlib import import_module

from . import jit


def _late(module: str, name: str):
    """A function whose module is imported at its first call, because the import of Numba is slow."""
    return lambda *arguments: getattr(import_module(f"{__name__}.{module}"), name)(*arguments)


jit.above = jit.Above(
    _late("toolchain.kernel_cache", "find"), _late("toolchain.compiling", "type_of_function"), _late("toolchain.compiling", "type_of_global")
)
