"""PTX: the code of NVIDIA's cards as text, which their driver compiles. Any card from Turing on takes it."""

from ..device.operations import PREFIX
from .device_emission import TargetModule
from .device_ir import FEATURES, PROCESSOR, TRIPLE, inline_everything, parsed, without_target


def _index(name: str, register: str) -> str:
    return f"""
declare i32 @llvm.nvvm.read.ptx.sreg.{register}()
define i32 @{PREFIX}{name}() alwaysinline {{
  %index = call i32 @llvm.nvvm.read.ptx.sreg.{register}()
  ret i32 %index
}}
"""


_OPERATIONS = f"""
{_index("block_index", "ctaid.x")}
{_index("block_size", "ntid.x")}
{_index("index_in_block", "tid.x")}
{_index("lane_index", "laneid")}
define i32 @{PREFIX}lane_count() alwaysinline {{
  ret i32 32
}}

declare i32 @llvm.nvvm.shfl.sync.idx.i32(i32, i32, i32, i32) convergent
define i32 @{PREFIX}shuffle(i32 %value, i32 %lane) alwaysinline convergent {{
  %found = call i32 @llvm.nvvm.shfl.sync.idx.i32(i32 -1, i32 %value, i32 %lane, i32 31)
  ret i32 %found
}}

declare i32 @llvm.nvvm.vote.ballot.sync(i32, i1) convergent
define i64 @{PREFIX}ballot(i1 %condition) alwaysinline convergent {{
  %bits = call i32 @llvm.nvvm.vote.ballot.sync(i32 -1, i1 %condition)
  %wide = zext i32 %bits to i64
  ret i64 %wide
}}

declare void @llvm.nvvm.barrier.cta.sync.aligned.all(i32) convergent
define void @{PREFIX}barrier() alwaysinline convergent {{
  call void @llvm.nvvm.barrier.cta.sync.aligned.all(i32 0)
  ret void
}}
"""
"""The functions of `antumbra.kernels.device`: all 32 lanes of a warp meet, and all threads of a block."""


def ptx_module(assembly: str, entry: str) -> TargetModule:
    """The module of a kernel for PTX, from the assembly that `device_ir` made."""
    module = parsed(assembly.replace(f"define void @{entry}(", f"define ptx_kernel void @{entry}(", 1))
    module.link_in(parsed(_OPERATIONS))
    inline_everything(module, entry)
    return TargetModule(TRIPLE, PROCESSOR, FEATURES, without_target(str(module)))
