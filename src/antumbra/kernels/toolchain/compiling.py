"""Compilation of a kernel to machine code by Numba and LLVM; imported only when something must be compiled.

Python calls one entry function per kernel, ``int64 f(words*, words*)``. It reads the arguments from 8-byte words
(`marshalling.flatten`), calls the kernel, and writes the result as words. It returns 0, or Numba's status if the kernel
raised.
"""

from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

import llvmlite.binding as llvm
import numba
import numpy as np
from llvmlite import ir
from numba.core import cgutils, types
from numba.core.compiler_lock import global_compiler_lock
from numba.core.registry import cpu_target
from numba.np import arrayobj

from .. import machine_code as machine
from ..jit import guest_overloads, inlined, kernel, overloads
from ..marshalling import END, NONE, Spec, array_parts, class_of, is_array
from .kernel_cache import KernelCode, symbol_of
from .numba_frontend import Library, Lowered, generic_part, ir_libraries, numba_patches, part_of

# --- The entry function: ``int64 f(words*, words*)`` ------------------------------------------------------------------


WORD = ir.IntType(64)


class _Words:
    """Sequential access to 8-byte words in memory."""

    def __init__(self, context: Any, builder: Any, pointer: Any) -> None:
        self.context, self.builder, self._pointer, self._at = context, builder, pointer, 0

    def _next(self) -> Any:
        address = cgutils.gep_inbounds(self.builder, self._pointer, self._at)
        self._at += 1
        return address

    def word(self) -> Any:
        return self.builder.load(self._next())

    def read(self, kind: Any) -> Any:
        """The LLVM value of the next argument, of type `kind`."""
        builder = self.builder
        if isinstance(kind, types.Array):
            return self._array(kind)
        if isinstance(kind, types.BaseTuple):
            return self.context.make_tuple(builder, kind, [self.read(item) for item in kind.types])  # type: ignore[attr-defined]
        if isinstance(kind, types.Boolean):
            return builder.icmp_unsigned("!=", self.word(), WORD(0))
        if isinstance(kind, types.Integer):
            word, target = self.word(), self.context.get_value_type(kind)
            return builder.trunc(word, target) if target.width < 64 else word
        if kind == types.float64:
            return builder.bitcast(self.word(), ir.DoubleType())
        if kind == types.float32:
            return builder.bitcast(builder.trunc(self.word(), ir.IntType(32)), ir.FloatType())
        if kind == types.none:
            return self.context.get_dummy_value()
        raise NotImplementedError(f"a kernel's argument of type {kind}")

    def _array(self, kind: Any) -> Any:
        context, builder = self.context, self.builder
        element = context.get_data_type(kind.dtype)
        array = context.make_array(kind)(context, builder)
        arrayobj.populate_array(
            array,
            data=builder.inttoptr(self.word(), element.as_pointer()),
            shape=[self.word() for _ in range(kind.ndim)],
            strides=[self.word() for _ in range(kind.ndim)],
            itemsize=WORD(context.get_abi_sizeof(element)),
            meminfo=None,
        )
        return array._getvalue()

    def write(self, kind: Any, value: Any) -> None:
        """Write the LLVM value of a result of type `kind`."""
        builder = self.builder
        if isinstance(kind, types.BaseTuple):
            for i, item in enumerate(kind.types):  # type: ignore[attr-defined]
                self.write(item, builder.extract_value(value, i))
        elif kind != types.none:
            builder.store(self._as_word(kind, value), self._next())

    def _as_word(self, kind: Any, value: Any) -> Any:
        builder = self.builder
        if isinstance(kind, types.Boolean):
            return builder.zext(self.context.cast(builder, value, kind, types.boolean), WORD)
        if isinstance(kind, types.Integer):
            widen = builder.sext if kind.signed else builder.zext  # type: ignore[attr-defined]
            return widen(value, WORD) if value.type.width < 64 else value
        if kind == types.float64:
            return builder.bitcast(value, WORD)
        if kind == types.float32:
            return builder.zext(builder.bitcast(value, ir.IntType(32)), WORD)
        raise NotImplementedError(f"a kernel's result of type {kind}")


def entry_library(context: Any, lowered: Lowered, symbol: str) -> Library:
    """The library of a kernel's entry function, named `symbol`."""
    library = Library(context.codegen(), symbol)
    module = library.create_ir_module("entry")
    words = WORD.as_pointer()
    function = ir.Function(module, ir.FunctionType(WORD, [words, words]), symbol)
    builder = ir.IRBuilder(function.append_basic_block("entry"))
    arguments, results = (_Words(context, builder, pointer) for pointer in function.args)

    fndesc = lowered.fndesc
    values = [arguments.read(kind) for kind in fndesc.argtypes]
    callee = context.declare_function(module, fndesc)
    status, value = context.call_conv.call_function(builder, callee, fndesc.restype, fndesc.argtypes, values)
    with builder.if_then(status.is_error, likely=False):
        builder.ret(builder.sext(status.code, WORD))
    results.write(fndesc.restype, value)
    builder.ret(WORD(0))
    library.add_ir_module(module)
    library.add_linking_library(lowered.library)
    return library


# --- Compilation ------------------------------------------------------------------------------------------------------


_TYPES: dict[str, Any] = {
    "b": types.boolean, "i1": types.int8, "i2": types.int16, "i4": types.int32, "i": types.int64,
    "u1": types.uint8, "u2": types.uint16, "u4": types.uint32, "u": types.uint64,
    "f": types.float32, "d": types.float64, NONE: types.none,
}  # fmt: skip
_TOKENS = {kind: token for token, kind in _TYPES.items()}
_RUNTIME = "NRT_", "numba_", "Py", "_Py"


class KernelSize(NamedTuple):
    """The size of a kernel's linked IR before LLVM's optimisation."""

    functions: int
    instructions: int


# --- types -------------------------------------------------------------------------------------------------------


def argument_types(key: str) -> tuple[Any, ...]:
    """Numba's types of the arguments that a key describes."""
    tokens = iter(key.split())
    return tuple(_type(token, tokens) for token in tokens)


def _type(token: str, tokens: Iterator[str]) -> Any:
    if is_array(token):
        dtype, ndim, layout, writeable = array_parts(token)
        return types.Array(numba.from_dtype(np.dtype(dtype)), ndim, layout, readonly=not writeable)  # type: ignore[call-overload]
    if not token.endswith("("):
        return _TYPES[token]
    items = []
    for inner in tokens:
        if inner == END:
            break
        items.append(_type(inner, tokens))
    return types.BaseTuple.from_types(items, tuple if token == "(" else class_of(token[:-1]))


def result_spec(kind: Any) -> Spec:
    """The `marshalling.Spec` of a result type, from which `marshalling.ResultReader` builds the value."""
    if isinstance(kind, types.BaseTuple):
        cls = getattr(kind, "instance_class", tuple)
        name = None if cls is tuple else f"{cls.__module__}:{cls.__qualname__}"
        return [name, [result_spec(item) for item in kind.types]]  # type: ignore[attr-defined]
    token = _TOKENS.get(types.unliteral(kind))
    if token is None:
        raise TypeError(f"a kernel cannot return {kind} to Python")
    return token


def type_of_function(function: inlined) -> Any:
    """Numba's type of a function that kernels call."""
    return part_of(function).type


def type_of_global(value: object) -> Any:
    """Numba's type of an intrinsic or of a type."""
    try:
        return cpu_target.typing_context.resolve_value_type(value)
    except Exception:  # the value is newer than Numba's last refresh
        cpu_target.target_context.refresh()
        return cpu_target.typing_context.resolve_value_type(value)


_registered: dict[object, object] = {}


def _register_overloads(kernel: inlined, key: str) -> None:
    from .kernel_digest import homes_of, reachable_functions

    for function in reachable_functions(kernel.py_func, homes_of(key)):
        if function not in _registered and (overloads(function) or guest_overloads(function)):
            _registered[function] = part = generic_part(function)
            cpu_target.typing_context.insert_global(function, part.type)


# --- machine code ------------------------------------------------------------------------------------------------


@global_compiler_lock  # type: ignore[untyped-decorator]
def lower_kernel(kernel: kernel, key: str, symbol: str) -> tuple[llvm.ModuleRef, Spec]:
    """(LLVM module of everything that a kernel reaches, `Spec` of its result)."""
    _register_overloads(kernel, key)
    context = cpu_target.target_context
    context.refresh()
    with ir_libraries(context), numba_patches():
        lowered = part_of(kernel).lower(argument_types(key))
        library = entry_library(context, lowered, symbol)
    return library.linked(symbol), result_spec(lowered.signature.return_type)


def size_of(module: llvm.ModuleRef) -> KernelSize:
    """The size of a linked module."""
    inner = [f for f in module.functions if not f.is_declaration]
    return KernelSize(len(inner), sum(1 for f in inner for block in f.blocks for _ in block.instructions))


def external_functions(module: llvm.ModuleRef) -> list[str]:
    """Functions that a module calls and the process must provide, such as ``sin``."""
    return sorted(f.name for f in module.functions if f.is_declaration and not f.name.startswith("llvm."))


def compile_kernel(kernel: kernel, key: str, digest: str, levels: Sequence[str]) -> list[KernelCode]:
    """Machine code of a kernel for the argument kinds of `key`, one object per level in `levels`.

    Raises
    ------
    numba.core.errors.NumbaError
        If Numba cannot compile the kernel.
    TypeError
        If the kernel allocates memory or calls Python.
    """
    lowered_once, result = lower_kernel(kernel, key, symbol_of(digest))
    codes = []
    for level in levels:
        module = machine.optimise(lowered_once.clone(), level)
        runtime = [name for name in external_functions(module) if name.startswith(_RUNTIME)]
        if runtime:
            raise TypeError(
                f"{kernel.name} needs {', '.join(runtime)}: a kernel may not allocate memory or call Python"
            )
        codes.append(KernelCode(kernel.name, key, result, machine.emit_object(module, level)))
    return codes
