"""Machine code that is emitted for WebAssembly, which has 32-bit pointers."""

import pytest

from antumbra.kernels.machine_code import emit_object, library_destination, optimise

llvm = pytest.importorskip("llvmlite.binding")
WASM = library_destination("wasm32", "simd128")


def module_of(body: str):
    text = f"define i64 @f(ptr %words, ptr %results) {{\n{body}\n  ret i64 0\n}}\n"
    return optimise(llvm.parse_assembly(text), WASM)


def test_addresses_as_numbers_are_emitted_for_32_bit_pointers():
    code = emit_object(
        module_of(
            """
  %address = load i64, ptr %words
  %array = inttoptr i64 %address to ptr
  %value = load double, ptr %array
  store double %value, ptr %results
"""
        ),
        WASM,
    )
    assert code.startswith(b"\0asm")


@pytest.mark.parametrize(
    "body",
    ["store ptr %words, ptr %results", "%p = load ptr, ptr %words\n store i64 1, ptr %p"],
    ids=["stored", "loaded"],
)
def test_pointers_in_memory_are_refused(body):
    module = module_of(body)
    with pytest.raises(TypeError, match="keeps a pointer in memory"):
        emit_object(module, WASM)


def test_bits_of_masks_are_compared_by_their_difference():
    """LLVM cannot select a comparison of two masks; `direction_sign` asks for bits that one of them lacks."""
    code = emit_object(
        module_of(
            """
  %a = load <16 x float>, ptr %words
  %b = load <16 x float>, ptr %results
  %m = fcmp olt <16 x float> %a, %b
  %x = bitcast <16 x i1> %m to i16
  %lanes = load i16, ptr %words
  %inverse = xor i16 %x, -1
  %missing = and i16 %inverse, %lanes
  %none = icmp eq i16 %missing, 0
  %wide = zext i1 %none to i64
  store i64 %wide, ptr %results
"""
        ),
        WASM,
    )
    assert code.startswith(b"\0asm")
