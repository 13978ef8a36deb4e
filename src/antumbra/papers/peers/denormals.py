"""Switches denormals off for the calling thread, as Embree requires for tracing. Ours must be on again afterwards."""

import platform

from llvmlite import ir
from numba.core import types
from numba.extending import intrinsic

FLUSH = 0x8040  # MXCSR: flush to zero, denormals are zero
_X86 = platform.machine().lower() in ("x86_64", "amd64")


def _call(builder, name, slot):
    address = ir.IntType(8).as_pointer()
    function = builder.module.declare_intrinsic(name, (), ir.FunctionType(ir.VoidType(), [address]))
    builder.call(function, [builder.bitcast(slot, address)])


@intrinsic
def control(typingctx):
    """The MXCSR register of this thread; 0 on processors other than x86."""

    def codegen(context, builder, sig, values):
        slot = builder.alloca(ir.IntType(32))
        builder.store(ir.IntType(32)(0), slot)
        if _X86:
            _call(builder, "llvm.x86.sse.stmxcsr", slot)
        return builder.load(slot)

    return types.uint32(), codegen


@intrinsic
def set_control(typingctx, value):
    """Set the MXCSR register of this thread. This does nothing on processors other than x86."""

    def codegen(context, builder, sig, values):
        if _X86:
            slot = builder.alloca(ir.IntType(32))
            builder.store(context.cast(builder, values[0], value, types.uint32), slot)
            _call(builder, "llvm.x86.sse.ldmxcsr", slot)
        return context.get_dummy_value()

    return types.void(value), codegen
