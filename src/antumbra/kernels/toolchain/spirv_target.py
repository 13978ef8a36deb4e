"""SPIR-V: device code that drivers of OpenCL 2.1 and later take, if they support intermediate languages."""

from ..device.operations import PREFIX
from .device_emission import TargetModule
from .device_ir import inline_everything, parsed, without_target

TRIPLE, TRIPLE_OF_LANES = "spirv64v1.0-unknown-unknown", "spirv64v1.3-unknown-unknown"
"""The oldest version, which every driver takes; and the first one with shuffles and ballots. LLVM ends the process
where a version lacks an operation."""

_LANES = tuple(f"@{PREFIX}{name}(" for name in ("shuffle", "ballot"))


def _index(name: str, function: str) -> str:
    return f"""
declare spir_func i64 @{function}(i32)
define i32 @{PREFIX}{name}() alwaysinline {{
  %wide = call spir_func i64 @{function}(i32 0)
  %index = trunc i64 %wide to i32
  ret i32 %index
}}
"""


def _lane(name: str, function: str) -> str:
    return f"""
declare spir_func i32 @{function}()
define i32 @{PREFIX}{name}() alwaysinline {{
  %value = call spir_func i32 @{function}()
  ret i32 %value
}}
"""


_OPERATIONS = f"""
{_index("block_index", "_Z12get_group_idj")}
{_index("block_size", "_Z14get_local_sizej")}
{_index("index_in_block", "_Z12get_local_idj")}
{_lane("lane_index", "_Z22get_sub_group_local_idv")}
{_lane("lane_count", "_Z18get_sub_group_sizev")}
declare spir_func i32 @_Z17sub_group_shuffleij(i32, i32) convergent
define i32 @{PREFIX}shuffle(i32 %value, i32 %lane) alwaysinline convergent {{
  %found = call spir_func i32 @_Z17sub_group_shuffleij(i32 %value, i32 %lane)
  ret i32 %found
}}

declare spir_func <4 x i32> @_Z16sub_group_balloti(i32) convergent
define i64 @{PREFIX}ballot(i1 %condition) alwaysinline convergent {{
  %number = zext i1 %condition to i32
  %words = call spir_func <4 x i32> @_Z16sub_group_balloti(i32 %number)
  %low = extractelement <4 x i32> %words, i32 0
  %high = extractelement <4 x i32> %words, i32 1
  %low64 = zext i32 %low to i64
  %high64 = zext i32 %high to i64
  %shifted = shl i64 %high64, 32
  %bits = or i64 %shifted, %low64
  ret i64 %bits
}}

declare spir_func void @_Z7barrierj(i32) convergent
define void @{PREFIX}barrier() alwaysinline convergent {{
  call spir_func void @_Z7barrierj(i32 3)
  ret void
}}
"""
"""The functions of `antumbra.kernels.device` by OpenCL's, with their names in C++. The barrier is for both memories."""


def spirv_module(assembly: str, entry: str) -> TargetModule:
    """The module of a kernel for SPIR-V, from the assembly that `device_ir` made."""
    module = parsed(assembly.replace(f"define void @{entry}(", f"define spir_kernel void @{entry}(", 1))
    module.link_in(parsed(_OPERATIONS))
    inline_everything(module, entry)
    triple = TRIPLE_OF_LANES if any(name in assembly for name in _LANES) else TRIPLE
    return TargetModule(triple, "", "", without_target(str(module)))
