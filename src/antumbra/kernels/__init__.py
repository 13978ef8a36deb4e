"""What kernels are made of, and how they become machine code. Nothing here knows a scene.

What kernels are made of:

- jit: the decorators `kernel`, `inlined`, `overload`
- simd/: vectors as values inside kernels; vec: three coordinates at once
- predicate/: whether a ray meets a triangle, exactly
- parallel: threads that share the work of one kernel

From a call to machine code, without Numba:

- arguments: the kinds and values of arguments, as words
- closure, definitions: a digest of all that a kernel is made of
- loading, cache, code, locks: object files from packs and from the user's folder, linked
- processor: levels of processors

What is compiled, and by whom:

- compiling, parts, library, entry, machine, numba_speed, numba_import: Numba and LLVM
- crew, worker, progress: several processes at once
- needs, pack: what jobs call, as recorded; packs that wheels bring
"""

from importlib import import_module

from . import jit


def _late(module: str, name: str):
    """A function of a module that is imported when the function is called: Numba takes its time."""
    return lambda *arguments: getattr(import_module(f"{__name__}.{module}"), name)(*arguments)


jit.above = jit.Above(
    _late("loading", "find"), _late("compiling", "type_of_function"), _late("compiling", "type_of_global")
)
