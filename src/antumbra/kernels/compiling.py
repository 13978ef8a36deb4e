"""Compile a kernel to machine code by Numba and LLVM. This module is imported only when something must be compiled."""

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numba
import numpy as np
from numba.core import types
from numba.core.compiler_lock import global_compiler_lock
from numba.core.registry import cpu_target

from . import machine
from .arguments import END, NONE, Spec, array_parts, class_of, is_array
from .code import Code, symbol_of
from .entry import entry_library
from .jit import guest_overloads, inlined, kernel, overloads
from .library import kept_as_ir
from .numba_speed import faster
from .parts import generic_part, part_of
from .simd import operators  # noqa: F401  (the meaning of Python's operators for vectors)

_TYPES = {
    "b": types.boolean, "i1": types.int8, "i2": types.int16, "i4": types.int32, "i": types.int64,
    "u1": types.uint8, "u2": types.uint16, "u4": types.uint32, "u": types.uint64,
    "f": types.float32, "d": types.float64, NONE: types.none,
}  # fmt: skip
_TOKENS = {kind: token for token, kind in _TYPES.items()}
_RUNTIME = "NRT_", "numba_", "Py", "_Py"


class Size(NamedTuple):
    """The size of a kernel's linked IR, before LLVM optimises."""

    functions: int
    instructions: int


# --- types -------------------------------------------------------------------------------------------------------


def argument_types(key: str) -> tuple[types.Type, ...]:
    """Numba's types of the arguments that a key describes."""
    tokens = iter(key.split())
    return tuple(_type(token, tokens) for token in tokens)


def _type(token: str, rest: Iterator[str]) -> types.Type:
    if is_array(token):
        dtype, ndim, layout, writeable = array_parts(token)
        return types.Array(numba.from_dtype(np.dtype(dtype)), ndim, layout, readonly=not writeable)
    if not token.endswith("("):
        return _TYPES[token]
    items = []
    for inner in rest:
        if inner == END:
            break
        items.append(_type(inner, rest))
    return types.BaseTuple.from_types(items, tuple if token == "(" else class_of(token[:-1]))


def result_spec(kind: types.Type) -> Spec:
    """The `arguments.Spec` of a result type: it tells `arguments.Result` how to build the value."""
    if isinstance(kind, types.BaseTuple):
        cls = getattr(kind, "instance_class", tuple)
        name = None if cls is tuple else f"{cls.__module__}:{cls.__qualname__}"
        return [name, [result_spec(item) for item in kind.types]]
    token = _TOKENS.get(types.unliteral(kind))
    if token is None:
        raise TypeError(f"a kernel cannot return {kind} to Python")
    return token


def type_of_function(function: inlined) -> types.Type:
    return part_of(function).type


def type_of_global(value) -> types.Type:
    """Numba's type of an intrinsic or of a type."""
    try:
        return cpu_target.typing_context.resolve_value_type(value)
    except Exception:  # the value is newer than Numba's last refresh
        cpu_target.target_context.refresh()
        return cpu_target.typing_context.resolve_value_type(value)


_known: dict[object, object] = {}


def _tell_numba_of_overloads(kernel: inlined, key: str) -> None:
    from .closure import homes_of, reached

    for function in reached(kernel.py_func, homes_of(key)):
        if function not in _known and (overloads(function) or guest_overloads(function)):
            _known[function] = part = generic_part(function)
            cpu_target.typing_context.insert_global(function, part.type)


# --- machine code ------------------------------------------------------------------------------------------------


@global_compiler_lock
def lowered(kernel: kernel, key: str, symbol: str):
    """(LLVM module of all that a kernel reaches, `Spec` of its result)."""
    _tell_numba_of_overloads(kernel, key)
    context = cpu_target.target_context
    context.refresh()
    with kept_as_ir(context), faster():
        found = part_of(kernel).lower(argument_types(key))
        library = entry_library(context, found, symbol)
    return library.linked(symbol), result_spec(found.signature.return_type)


def size_of(module) -> Size:
    """The size of a linked module."""
    inner = [f for f in module.functions if not f.is_declaration]
    return Size(len(inner), sum(1 for f in inner for block in f.blocks for _ in block.instructions))


def outside(module) -> list[str]:
    """Functions that a module calls and the process must provide, such as ``sin``."""
    return sorted(f.name for f in module.functions if f.is_declaration and not f.name.startswith("llvm."))


def make(kernel: kernel, key: str, digest: str, levels: Sequence[str]) -> list[Code]:
    """Machine code of a kernel for the argument kinds of `key`, one for each level in `levels`.

    Raises
    ------
    numba.core.errors.NumbaError
        If Numba cannot compile the kernel.
    TypeError
        If the kernel allocates memory or calls Python.
    """
    lowered_once, result = lowered(kernel, key, symbol_of(digest))
    codes = []
    for level in levels:
        module = machine.optimised(lowered_once.clone(), level)
        runtime = [name for name in outside(module) if name.startswith(_RUNTIME)]
        if runtime:
            raise TypeError(
                f"{kernel.name} needs {', '.join(runtime)}: a kernel may not allocate memory or call Python"
            )
        codes.append(Code(kernel.name, key, result, machine.emitted(module, level)))
    return codes
