"""Operations that LLVM lowers badly at some level, written in its IR for each level. `machine` links them.

LLVM knows how to move lanes to the front only with AVX-512. Without it, it stores them one by one. AVX2 can permute
eight lanes by an order from a table.

The rounding error of a product is one fused instruction. Without the instruction, LLVM calls a library, so Dekker's
split [1971] takes its place. Both are exact.
"""

_STORE_COMPRESSED = "antumbra.store_compressed."  # (pointer, mask, lanes of int32)
_PRODUCT_ERROR = "antumbra.product_error"  # (a, b, a b rounded), float64


def _fronts() -> str:
    """For each mask of eight lanes, the lanes that are set, in order, as eight bytes of one int64."""
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

@antumbra.fronts = internal unnamed_addr constant [256 x i64] [{_fronts()}], align 64

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
"""Level: IR of the operations above. Other levels have `_BASE`."""

_BASE = _BY_LLVM + _SPLIT


def name_of_store_compressed(lanes: int) -> str:
    """The name of the function that `source_of` defines. Its source counts in the keys of kernels that use it."""
    name = f"{_STORE_COMPRESSED}v{lanes}i32"
    assert all(name in source for source in (_BASE, *_SOURCES.values()))
    return name


def name_of_product_error() -> str:
    """The name of the other function that `source_of` defines."""
    assert all(_PRODUCT_ERROR in source for source in (_BASE, *_SOURCES.values()))
    return _PRODUCT_ERROR


def source_of(level: str) -> str:
    """The IR of all operations for a level."""
    return _SOURCES.get(level, _BASE)


def is_missing(name: str) -> bool:
    """Whether a function that a module declares is one of `source_of`."""
    return name.startswith((_STORE_COMPRESSED, _PRODUCT_ERROR))
