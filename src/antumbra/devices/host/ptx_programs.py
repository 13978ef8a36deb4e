"""The machine code of a kernel's threads, from PTX, for the processor that this runs on.

Threads of a kernel without meetings run one after another, in one function. With meetings, each thread is a coroutine
of LLVM's: it suspends where it meets others, with a `ThreadState` that says where and with what.
"""

import ctypes
import re
import sys
from functools import cache
from string import Template
from typing import Any

import numpy as np

from ...base.extras import import_extra
from ..device import DeviceError
from .ptx_reader import PtxKernel, read_kernel
from .ptx_translation import PARAMETERS, Translation

THREAD_STATE = np.dtype([("place", "i4"), ("words", "i4", 2), ("result", "i4"), ("handle", "i8")])
"""What a suspended thread has stored: the meeting's number from 1 on, or 0 at its end; two words; its coroutine."""

_ALIGNMENT = 16  # of memory in blocks and threads

_PLACE = "i32 %tid, i32 %ctaid, i32 %ntid, i32 %nctaid"

_PLAIN = Template(f"""
define internal void @thread({PARAMETERS}) {{
$variables
$lines
  br label %ended
ended:
  ret void
}}

define void @run(ptr %words, ptr %block_memory, i32 %first, i32 %end, i32 %ntid, i32 %nctaid) {{
start:
  br label %block
block:
  %ctaid = phi i32 [%first, %start], [%next_block, %block_done]
  br label %thread
thread:
  %tid = phi i32 [0, %block], [%next_thread, %thread]
  call void @thread(ptr %words, ptr %block_memory, {_PLACE})
  %next_thread = add i32 %tid, 1
  %more_threads = icmp ult i32 %next_thread, %ntid
  br i1 %more_threads, label %thread, label %block_done
block_done:
  %next_block = add i32 %ctaid, 1
  %more_blocks = icmp ult i32 %next_block, %end
  br i1 %more_blocks, label %block, label %done
done:
  ret void
}}
""")

_COROUTINE = Template(f"""
declare token @llvm.coro.id(i32, ptr, ptr, ptr)
declare i64 @llvm.coro.size.i64()
declare ptr @llvm.coro.begin(token, ptr)
declare i8 @llvm.coro.suspend(token, i1)
declare ptr @llvm.coro.free(token, ptr)
declare void @llvm.coro.end(ptr, i1, token)
declare void @llvm.coro.resume(ptr)
declare void @llvm.coro.destroy(ptr)
declare ptr @antumbra_malloc(i64)
declare void @antumbra_free(ptr)

%state = type {{ i32, i32, i32, i32, ptr }}

define internal ptr @thread({PARAMETERS}, ptr %state) presplitcoroutine {{
  %id = call token @llvm.coro.id(i32 0, ptr null, ptr null, ptr null)
  %size = call i64 @llvm.coro.size.i64()
  %frame = call ptr @antumbra_malloc(i64 %size)
  %handle = call ptr @llvm.coro.begin(token %id, ptr %frame)
  %state.0 = getelementptr %state, ptr %state, i32 0, i32 0
  %state.1 = getelementptr %state, ptr %state, i32 0, i32 1
  %state.2 = getelementptr %state, ptr %state, i32 0, i32 2
  %state.3 = getelementptr %state, ptr %state, i32 0, i32 3
$variables
$lines
  br label %ended
ended:
  store i32 0, ptr %state.0
  %memory = call ptr @llvm.coro.free(token %id, ptr %handle)
  call void @antumbra_free(ptr %memory)
  br label %suspended
suspended:
  call void @llvm.coro.end(ptr %handle, i1 false, token none)
  ret ptr %handle
}}

define void @start(ptr %words, ptr %block_memory, ptr %states, {_PLACE}) {{
  %at = getelementptr %state, ptr %states, i32 %tid
  %handle = call ptr @thread(ptr %words, ptr %block_memory, {_PLACE}, ptr %at)
  %stored = getelementptr %state, ptr %at, i32 0, i32 4
  store ptr %handle, ptr %stored
  ret void
}}

define void @resume(ptr %states, ptr %threads, i64 %n) {{
start:
  br label %loop
loop:
  %k = phi i64 [0, %start], [%next, %loop]
  %listed = getelementptr i64, ptr %threads, i64 %k
  %thread = load i64, ptr %listed
  %stored = getelementptr %state, ptr %states, i64 %thread, i32 4
  %handle = load ptr, ptr %stored
  call void @llvm.coro.resume(ptr %handle)
  %next = add i64 %k, 1
  %more = icmp ult i64 %next, %n
  br i1 %more, label %loop, label %done
done:
  ret void
}}

define void @destroy(ptr %handle) {{
  call void @llvm.coro.destroy(ptr %handle)
  ret void
}}
""")


class PtxProgram:
    """A kernel of PTX, translated to this processor's machine code.

    code : the text of PTX
    """

    def __init__(self, code: bytes) -> None:
        kernel = read_kernel(code.decode())
        translation = Translation(kernel)
        self.entry, self.meetings, self._faults = kernel.entry, translation.meetings, translation.faults
        self.block_memory = sum(_rounded(size) for size in kernel.block_memory.values())
        form = _COROUTINE if self.meetings else _PLAIN
        body = form.substitute(variables=_variables(kernel), lines="\n".join(translation.lines))
        self._engine = _compiled(f"@fault = global i32 0\n{body}\n{_declarations(body)}")
        self._fault = ctypes.c_int32.from_address(self._engine.get_global_value_address("fault"))

    def function(self, name: str, *kinds: Any) -> Any:
        """A function of the machine code without a result, whose parameters are of kinds of ctypes."""
        return ctypes.CFUNCTYPE(None, *kinds)(self._engine.get_function_address(name))

    def check_faults(self) -> None:
        """Raise a DeviceError if a thread has used an address that a card would not take."""
        if fault := self._fault.value:
            self._fault.value = 0
            raise DeviceError(f"{self.entry}: an address is null or misaligned in {self._faults[fault - 1]}")


def _rounded(size: int) -> int:
    return -(-size // _ALIGNMENT) * _ALIGNMENT


def _variables(kernel: PtxKernel) -> str:
    """Variables of a thread: registers, and the places of arrays."""
    lines = [f"{name}.r = alloca i{width}" for name, width in kernel.registers.items()]
    lines += [f"%memory.{name} = alloca [{size} x i8], align {_ALIGNMENT}" for name, size in kernel.own_memory.items()]
    first = 0
    for name, size in kernel.block_memory.items():
        lines.append(f"%memory.{name} = getelementptr i8, ptr %block_memory, i64 {first}")
        first += _rounded(size)
    return "\n".join(f"  {line}" for line in [*lines, "%laneid = and i32 %tid, 31"])


def _declarations(body: str) -> str:
    """Declarations of LLVM's functions on numbers that a body calls."""
    calls = set(re.findall(r"call (\w+) (@llvm\.(?!coro)[\w.]+)\(([^)]*)\)", body))
    kinds = {(result, name, ", ".join(re.findall(r"(\w+) [^,]+", values))) for result, name, values in calls}
    return "\n".join(f"declare {result} {name}({values})" for result, name, values in sorted(kinds))


@cache
def _llvm() -> Any:
    """LLVM, ready for this processor, with the C library's allocation for coroutines."""
    llvm = import_extra("llvmlite.binding", "the host device", "jit")
    llvm.initialize_native_target()
    llvm.initialize_native_asmprinter()
    library = ctypes.cdll.msvcrt if sys.platform == "win32" else ctypes.CDLL(None)
    for name in "malloc", "free":
        address = ctypes.cast(getattr(library, name), ctypes.c_void_p).value
        llvm.add_symbol(f"antumbra_{name}", address)
    return llvm


def _compiled(assembly: str) -> Any:
    """An engine of LLVM's with the machine code of a module."""
    llvm = _llvm()
    features = llvm.get_host_cpu_features().flatten()
    target = llvm.Target.from_default_triple()
    machine = target.create_target_machine(cpu=llvm.get_host_cpu_name(), features=features, opt=2, jit=True)
    module = llvm.parse_assembly(assembly)
    module.triple, module.data_layout = machine.triple, str(machine.target_data)
    module.verify()
    builder = llvm.create_pass_builder(machine, llvm.create_pipeline_tuning_options(speed_level=2))
    builder.getModulePassManager().run(module, builder)
    engine = llvm.create_mcjit_compiler(module, machine)
    engine.finalize_object()
    return engine
