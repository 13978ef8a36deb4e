"""Machine code for a processor level: optimisation and emission by LLVM.

Operations by level. `source_of` has LLVM IR for operations that LLVM lowers badly at some levels; `optimise` links it.
LLVM can compress lanes to the front only with AVX-512, and otherwise stores them one by one. AVX2 can permute eight
lanes by an order from a table.

The rounding error of a product takes one fused instruction. Without that instruction, LLVM calls a library, so Dekker's
split [1971] is used instead. Both are exact.
"""

import re
from functools import cache
from typing import NamedTuple

import llvmlite.binding as llvm

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


class System(NamedTuple):
    """An operating system and processor family for which kernel libraries are made. WebAssembly counts as one."""

    triple: str  # LLVM's
    levels: tuple[str, ...]
    features: str = ""  # LLVM's, beside those of the level
    wide_triple: str | None = None  # for optimisation, if it needs 64-bit pointers; None: `triple`


_X86_LEVELS = "x86-64-v2", "x86-64-v3", "x86-64-v4"
SYSTEMS = {
    "linux-x86_64": System("x86_64-unknown-linux-gnu", _X86_LEVELS),
    "linux-aarch64": System("aarch64-unknown-linux-gnu", ("aarch64",)),
    "macos-x86_64": System("x86_64-apple-macosx11.0", _X86_LEVELS),
    "macos-arm64": System("arm64-apple-macosx11.0", ("aarch64",)),
    "windows-x86_64": System("x86_64-pc-windows-gnu", _X86_LEVELS),
    "windows-arm64": System("aarch64-pc-windows-gnu", ("aarch64",)),
    "wasm32": System(
        "wasm32-unknown-unknown",
        ("simd128",),
        "+simd128,+atomics,+bulk-memory,+nontrapping-fptoint,+sign-ext,+mutable-globals",
        "wasm64-unknown-unknown",
    ),
}
"""Numba's code has 64-bit addresses. Optimised with 32-bit pointers, most tracers become nothing: see `_narrow`."""


class Destination(NamedTuple):
    """Where machine code is to run: in this process, or in a library of a system."""

    level: str
    system: str | None = None  # a key of SYSTEMS; None: this process

    @classmethod
    def named(cls, name: str) -> "Destination":
        """The destination that `name` describes: a level, or ``system+level``."""
        system, _, level = name.rpartition("+")
        return cls(level, system or None)


def library_destination(system: str, level: str) -> str:
    """The name of a destination in a library; the name of one in this process is its level."""
    return f"{system}+{level}"


@cache
def _target_machine(name: str, wide: bool = False) -> llvm.TargetMachine:
    """LLVM's machine of a destination; wide: the one by which it is optimised."""
    to = Destination.named(name)
    processor = to.level if to.level.startswith("x86") else "generic"
    if to.system is None:
        llvm.initialize_native_target()
        llvm.initialize_native_asmprinter()
        target = llvm.Target.from_triple(llvm.get_process_triple())
        return target.create_target_machine(cpu=processor, opt=3, jit=True, reloc="static", codemodel="jitdefault")
    llvm.initialize_all_targets()
    llvm.initialize_all_asmprinters()
    system = SYSTEMS[to.system]
    target = llvm.Target.from_triple((system.wide_triple if wide else None) or system.triple)
    relocation = "static" if system.wide_triple else "pic"
    return target.create_target_machine(
        cpu=processor, features=system.features, opt=3, reloc=relocation, codemodel="small"
    )


def optimise(module: llvm.ModuleRef, destination: str) -> llvm.ModuleRef:
    """The module, inlined and optimised.

    destination : as for `Destination.named`

    A cheap run of passes first normalises loops, and a full run follows. Floating-point operations are never contracted
    or reordered.
    """
    machine = _target_machine(destination, wide=True)
    if any(function.is_declaration and is_level_operation(function.name) for function in module.functions):
        module.link_in(llvm.parse_assembly(source_of(Destination.named(destination).level)))
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


def emit_object(module: llvm.ModuleRef, destination: str) -> bytes:
    """The object file of an optimised module."""
    return bytes(_narrow(module, destination).emit_object(module))


def emit_assembly(module: llvm.ModuleRef, destination: str) -> str:
    """The assembly code of an optimised module."""
    return str(_narrow(module, destination).emit_assembly(module))


_POINTERS_IN_MEMORY = re.compile(r"^.*(?:\bstore ptr (?!null)|\bload ptr|\balloca [\[{].*\bptr\b).*$", re.M)
"""Null is stored where a function's result is None."""


def _narrow(module: llvm.ModuleRef, destination: str) -> llvm.TargetMachine:
    """LLVM's machine of a destination; a module with 64-bit pointers gets the pointers of that machine.

    Offsets are those of 64-bit pointers then, so no pointer may be in memory. Raises TypeError if one is.
    """
    to = Destination.named(destination)
    machine = _target_machine(destination)
    if to.system is not None and SYSTEMS[to.system].wide_triple:
        found = _POINTERS_IN_MEMORY.search(str(module))
        if found:
            raise TypeError(f"a kernel for {to.system} keeps a pointer in memory: {found[0].strip()}")
        module.triple, module.data_layout = machine.triple, str(machine.target_data)
    return machine
