"""Machine code for a processor level: optimisation and emission by LLVM, and the record that holds a kernel's code.

Processor levels. A level names the instructions that machine code may use, so one pack serves all machines of a level.
`x86-64-v2`, `-v3` (AVX2, FMA) and `-v4` (AVX-512) are the levels of the x86-64 psABI. `aarch64` has NEON. The default
is the best level of this processor; ``ANTUMBRA_LEVEL`` selects another.

Records. A record is ``magic, checksum, length of the description, description (JSON), object file (zlib)``. The
checksum detects truncated, modified and foreign records, which count as missing.

Operations by level. `source_of` has LLVM IR for operations that LLVM lowers badly at some levels; `optimise` links it.
LLVM can compress lanes to the front only with AVX-512, and otherwise stores them one by one. AVX2 can permute eight
lanes by an order from a table.

The rounding error of a product takes one fused instruction. Without that instruction, LLVM calls a library, so Dekker's
split [1971] is used instead. Both are exact.
"""

import json
import os
import platform
import zlib
from functools import cache
from hashlib import blake2b
from typing import NamedTuple

import llvmlite.binding as llvm

from ..errors import InputError
from .marshalling import Spec

# --- Processor levels -------------------------------------------------------------------------------------------------


_V2 = ["cx16", "sahf", "popcnt", "sse3", "ssse3", "sse4.1", "sse4.2"]
_V3 = [*_V2, *["avx", "avx2", "bmi", "bmi2", "f16c", "fma", "lzcnt", "movbe", "xsave"]]
_V4 = [*_V3, *["avx512f", "avx512bw", "avx512cd", "avx512dq", "avx512vl"]]
X86 = {"x86-64-v2": _V2, "x86-64-v3": _V3, "x86-64-v4": _V4}
"""Features of each level, by LLVM's names. The name of a level is also LLVM's name of a processor."""

LEVELS = (*X86, "aarch64")
OTHER = "generic"
"""The level of all other machines: LLVM's generic processor."""


@cache
def level() -> str:
    """The level that kernels are compiled for on this machine."""
    name = os.environ.get("ANTUMBRA_LEVEL")
    best = _best()
    if not name:
        return best
    if name not in usable(best):
        raise InputError(f"ANTUMBRA_LEVEL is {name}: this machine runs {', '.join(usable(best))}")
    return name


def usable(best: str) -> list[str]:
    """The levels that a machine of level `best` can run."""
    return list(X86)[: list(X86).index(best) + 1] if best in X86 else [best]


def _best() -> str:
    machine = platform.machine().lower()
    if machine in ("arm64", "aarch64"):
        return "aarch64"
    if machine not in ("x86_64", "amd64"):
        return OTHER
    import llvmlite.binding as llvm

    has = llvm.get_host_cpu_features()
    return next((name for name, needs in reversed(X86.items()) if all(has.get(f) for f in needs)), OTHER)


# --- Records ----------------------------------------------------------------------------------------------------------


_MAGIC = b"antumbra kernel 1\n"
_SUM = 16
_HEAD = len(_MAGIC) + _SUM


class KernelCode(NamedTuple):
    """Everything that a call from Python needs."""

    kernel: str  # module:qualname
    key: str  # kinds of the arguments, separated by spaces
    result: Spec  # kind of the result
    machine: bytes  # object file; the function's name contains the digest (`symbol_of`)

    def record(self) -> bytes:
        """The bytes of the record."""
        about = json.dumps([self.kernel, self.key, self.result]).encode()
        body = len(about).to_bytes(4, "little") + about + zlib.compress(self.machine, 6)
        return _MAGIC + blake2b(body, digest_size=_SUM).digest() + body


def symbol_of(digest: str) -> str:
    """The name of the function in the object file of a digest."""
    return f"antumbra_{digest}"


def from_record(data: bytes) -> KernelCode | None:
    """The code in a record, or None if the record is damaged."""
    body = data[_HEAD:]
    if not data.startswith(_MAGIC) or blake2b(body, digest_size=_SUM).digest() != data[len(_MAGIC) : _HEAD]:
        return None
    end = 4 + int.from_bytes(body[:4], "little")
    kernel, key, result = json.loads(body[4:end])
    return KernelCode(kernel, key, result, zlib.decompress(body[end:]))


# --- Operations by level ----------------------------------------------------------------------------------------------


_STORE_COMPRESSED = "antumbra.store_compressed."  # (pointer, mask, lanes of int32)
_PRODUCT_ERROR = "antumbra.product_error"  # (a, b, a b rounded), float64


def _compress_orders() -> str:
    """For each mask of eight lanes, the set lanes in order, as the eight bytes of an int64."""
    orders = [[lane for lane in range(8) if mask >> lane & 1] for mask in range(256)]
    return ", ".join(f"i64 {sum(lane << 8 * place for place, lane in enumerate(order))}" for order in orders)


_BY_LLVM = "".join(
    f"""
declare <{n} x i32> @llvm.experimental.vector.compress.v{n}i32(<{n} x i32>, <{n} x i1>, <{n} x i32>)

define linkonce_odr void @{_STORE_COMPRESSED}v{n}i32(ptr %to, <{n} x i1> %mask, <{n} x i32> %lanes) alwaysinline {{
  %front = call <{n} x i32> @llvm.experimental.vector.compress.v{n}i32(
      <{n} x i32> %lanes, <{n} x i1> %mask, <{n} x i32> undef)
  store <{n} x i32> %front, ptr %to, align 4
  ret void
}}
"""
    for n in (8, 16)
)

_BY_PERMUTING = f"""
declare <8 x i32> @llvm.x86.avx2.permd(<8 x i32>, <8 x i32>)
declare i8 @llvm.ctpop.i8(i8)

@antumbra.fronts = internal unnamed_addr constant [256 x i64] [{_compress_orders()}], align 64

define linkonce_odr void @{_STORE_COMPRESSED}v8i32(ptr %to, <8 x i1> %mask, <8 x i32> %lanes) alwaysinline {{
  %bits = bitcast <8 x i1> %mask to i8
  %row = zext i8 %bits to i64
  %place = getelementptr [256 x i64], ptr @antumbra.fronts, i64 0, i64 %row
  %bytes = load <8 x i8>, ptr %place, align 8
  %order = zext <8 x i8> %bytes to <8 x i32>
  %front = call <8 x i32> @llvm.x86.avx2.permd(<8 x i32> %lanes, <8 x i32> %order)
  store <8 x i32> %front, ptr %to, align 4
  ret void
}}

define linkonce_odr void @{_STORE_COMPRESSED}v16i32(ptr %to, <16 x i1> %mask, <16 x i32> %lanes) alwaysinline {{
  %low = shufflevector <16 x i32> %lanes, <16 x i32> undef,
      <8 x i32> <i32 0, i32 1, i32 2, i32 3, i32 4, i32 5, i32 6, i32 7>
  %high = shufflevector <16 x i32> %lanes, <16 x i32> undef,
      <8 x i32> <i32 8, i32 9, i32 10, i32 11, i32 12, i32 13, i32 14, i32 15>
  %bits = bitcast <16 x i1> %mask to i16
  %low_bits = trunc i16 %bits to i8
  %rest = lshr i16 %bits, 8
  %high_bits = trunc i16 %rest to i8
  %low_mask = bitcast i8 %low_bits to <8 x i1>
  %high_mask = bitcast i8 %high_bits to <8 x i1>
  call void @{_STORE_COMPRESSED}v8i32(ptr %to, <8 x i1> %low_mask, <8 x i32> %low)
  %count = call i8 @llvm.ctpop.i8(i8 %low_bits)
  %skip = zext i8 %count to i64
  %next = getelementptr i32, ptr %to, i64 %skip
  call void @{_STORE_COMPRESSED}v8i32(ptr %next, <8 x i1> %high_mask, <8 x i32> %high)
  ret void
}}
"""

_FUSED = f"""
declare double @llvm.fma.f64(double, double, double)

define linkonce_odr double @{_PRODUCT_ERROR}(double %a, double %b, double %product) alwaysinline {{
  %minus = fneg double %product
  %error = call double @llvm.fma.f64(double %a, double %b, double %minus)
  ret double %error
}}
"""

_SPLIT = f"""
define linkonce_odr double @antumbra.high_half(double %x) alwaysinline {{
  %scaled = fmul double %x, 134217729.0
  %low = fsub double %scaled, %x
  %high = fsub double %scaled, %low
  ret double %high
}}

define linkonce_odr double @{_PRODUCT_ERROR}(double %a, double %b, double %product) alwaysinline {{
  %a1 = call double @antumbra.high_half(double %a)
  %a2 = fsub double %a, %a1
  %b1 = call double @antumbra.high_half(double %b)
  %b2 = fsub double %b, %b1
  %high = fmul double %a1, %b1
  %left = fsub double %product, %high
  %cross1 = fmul double %a2, %b1
  %less = fsub double %left, %cross1
  %cross2 = fmul double %a1, %b2
  %least = fsub double %less, %cross2
  %low = fmul double %a2, %b2
  %error = fsub double %low, %least
  ret double %error
}}
"""

_SOURCES = {
    "x86-64-v3": _BY_PERMUTING + _FUSED,
    "x86-64-v4": _BY_LLVM + _FUSED,
    "aarch64": _BY_LLVM + _FUSED,
}
"""IR of the operations above for each level. Other levels use `_BASE`."""

_BASE = _BY_LLVM + _SPLIT


def name_of_store_compressed(lanes: int) -> str:
    """The name of the compressing store in `source_of`. Its source is part of the digests of kernels that use it."""
    name = f"{_STORE_COMPRESSED}v{lanes}i32"
    assert all(name in source for source in (_BASE, *_SOURCES.values()))
    return name


def name_of_product_error() -> str:
    """The name of the function for product errors in `source_of`."""
    assert all(_PRODUCT_ERROR in source for source in (_BASE, *_SOURCES.values()))
    return _PRODUCT_ERROR


def source_of(level: str) -> str:
    """The IR of all operations for a level."""
    return _SOURCES.get(level, _BASE)


def is_level_operation(name: str) -> bool:
    """Whether a function that a module declares is defined in `source_of`."""
    return name.startswith((_STORE_COMPRESSED, _PRODUCT_ERROR))


# --- Optimisation and emission by LLVM --------------------------------------------------------------------------------


_TRIPLES = {"x86_64": ("x86-64", "x86_64-unknown-linux-gnu"), "aarch64": ("aarch64", "aarch64-unknown-linux-gnu")}
"""(prefix of its levels' names, LLVM's target triple) of each architecture, for cross-compilation."""


@cache
def _target_machine(level: str) -> llvm.TargetMachine:
    here = llvm.get_process_triple()
    begins = {machine: name for machine, (name, _) in _TRIPLES.items()}
    foreign = [m for m, name in begins.items() if level.startswith(name) and not here.startswith((m, name))]
    if foreign:
        llvm.initialize_all_targets()
        llvm.initialize_all_asmprinters()
    else:
        llvm.initialize_native_target()
        llvm.initialize_native_asmprinter()
    triple = _TRIPLES[foreign[0]][1] if foreign else here
    processor = level if level.startswith("x86") else "generic"
    model = {"reloc": "static", "codemodel": "jitdefault"}
    return llvm.Target.from_triple(triple).create_target_machine(cpu=processor, opt=3, jit=not foreign, **model)


def optimise(module: llvm.ModuleRef, level: str) -> llvm.ModuleRef:
    """The module, inlined and optimised.

    A cheap run of passes first normalises loops, and a full run follows. Floating-point operations are never contracted
    or reordered.
    """
    machine = _target_machine(level)
    if any(function.is_declaration and is_level_operation(function.name) for function in module.functions):
        module.link_in(llvm.parse_assembly(source_of(level)))
    module.triple, module.data_layout = machine.triple, str(machine.target_data)
    for cheap in True, False:
        options = llvm.create_pipeline_tuning_options()
        options.speed_level = 0 if cheap else 3
        options.loop_vectorization, options.slp_vectorization = not cheap, False
        builder = llvm.create_pass_builder(machine, options)
        passes = builder.getModulePassManager()
        if cheap:
            passes.add_loop_rotate_pass()
            passes.add_instruction_combine_pass()
            passes.add_jump_threading_pass()
        passes.run(module, builder)
    return module


def emit_object(module: llvm.ModuleRef, level: str) -> bytes:
    """The object file of a module."""
    return bytes(_target_machine(level).emit_object(module))


def emit_assembly(module: llvm.ModuleRef, level: str) -> str:
    """The assembly code of a module."""
    return str(_target_machine(level).emit_assembly(module))
