"""Compiled functions: their building blocks and their compilation to machine code. Independent of scenes.

- `jit`: the decorators `kernel`, `inlined`, `formula`, `overload`; types of the fields of kernel arguments
- `marshalling`: arguments and results as 8-byte words
- `processor`: processor levels
- `machine_code`: LLVM's optimisation and emission for a level
- `simd/`: vectors as values inside kernels
- `device/`: what only devices have: thread indices, lanes, local memory, barriers
- `vec3`: vectors of three coordinates, scalar or in lanes
- `transposition`: eight vectors of eight float32
- `exact/`: the exact ray-triangle test
- `array_pool`: recycled memory for large arrays
- `parallel`: threads that share the work of one kernel
- `ticket_loops`: loops over the items of a ticket, imported only by the compiler
- `toolchain/`: digests, compilation, the cache of machine code, compilation ahead of time
"""

from collections.abc import Callable
from importlib import import_module
from typing import Any

from . import jit


def _late(module: str, name: str) -> Callable[..., Any]:
    """A function whose module is imported on its first call, because importing Numba is slow."""
    return lambda *arguments: getattr(import_module(f"{__name__}.{module}"), name)(*arguments)


jit.hooks = jit.ToolchainHooks(
    _late("toolchain.kernel_loading", "find"),
    _late("toolchain.compiling", "type_of_function"),
    _late("toolchain.compiling", "type_of_global"),
)
