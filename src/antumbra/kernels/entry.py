"""The one function of a kernel that Python calls: ``int64 f(words*, words*)``.

It reads the arguments from 8-byte words (`arguments.flatten`), calls the kernel, and writes the result as words.
The result is 0, or Numba's status if the kernel raised.
"""

from llvmlite import ir
from numba.core import cgutils, types
from numba.np import arrayobj

from .library import Library
from .parts import Lowered

WORD = ir.IntType(64)


class _Words:
    """8-byte words in memory, one after the other."""

    def __init__(self, context, builder, pointer):
        self.context, self.builder, self._pointer, self._at = context, builder, pointer, 0

    def _next(self):
        address = cgutils.gep_inbounds(self.builder, self._pointer, self._at)
        self._at += 1
        return address

    def word(self):
        return self.builder.load(self._next())

    def read(self, kind):
        """The LLVM value of the next argument, of type `kind`."""
        builder = self.builder
        if isinstance(kind, types.Array):
            return self._array(kind)
        if isinstance(kind, types.BaseTuple):
            return self.context.make_tuple(builder, kind, [self.read(item) for item in kind.types])
        if isinstance(kind, types.Boolean):
            return builder.icmp_unsigned("!=", self.word(), WORD(0))
        if isinstance(kind, types.Integer):
            word, wanted = self.word(), self.context.get_value_type(kind)
            return builder.trunc(word, wanted) if wanted.width < 64 else word
        if kind == types.float64:
            return builder.bitcast(self.word(), ir.DoubleType())
        if kind == types.float32:
            return builder.bitcast(builder.trunc(self.word(), ir.IntType(32)), ir.FloatType())
        if kind == types.none:
            return self.context.get_dummy_value()
        raise NotImplementedError(f"a kernel's argument of type {kind}")

    def _array(self, kind):
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

    def write(self, kind, value):
        """Write the LLVM value of a result of type `kind`."""
        builder = self.builder
        if isinstance(kind, types.BaseTuple):
            for i, item in enumerate(kind.types):
                self.write(item, builder.extract_value(value, i))
        elif kind != types.none:
            builder.store(self._as_word(kind, value), self._next())

    def _as_word(self, kind, value):
        builder = self.builder
        if isinstance(kind, types.Boolean):
            return builder.zext(self.context.cast(builder, value, kind, types.boolean), WORD)
        if isinstance(kind, types.Integer):
            widen = builder.sext if kind.signed else builder.zext
            return widen(value, WORD) if value.type.width < 64 else value
        if kind == types.float64:
            return builder.bitcast(value, WORD)
        if kind == types.float32:
            return builder.zext(builder.bitcast(value, ir.IntType(32)), WORD)
        raise NotImplementedError(f"a kernel's result of type {kind}")


def entry_library(context, lowered: Lowered, symbol: str) -> Library:
    """The library of the function `symbol`, which Python calls."""
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
