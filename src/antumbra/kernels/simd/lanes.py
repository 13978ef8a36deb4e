"""Operations on the lanes of vectors, and on scalars: make, choose, combine, convert, permute, reduce.

The scalar operations are bit counts of an int64, for loops over the set lanes of a mask, and the rounding error of a
float64 product. `widen_loops` is for loops that LLVM vectorises.
"""

from collections.abc import Sequence
from typing import Any

from llvmlite import ir
from numba.core import types
from numba.extending import intrinsic

from ..machine_code import name_of_product_error
from .vectors import I32, I64, Vector, as_vectors, call_llvm, common_vector, llvm_type, reject

# --- Operations on lanes ----------------------------------------------------------------------------------------------


_SIGN_BIT = -(2**31)
_SPLATS = (
    (types.Float, types.float32),
    (types.Integer, types.int32),
    (types.Boolean, types.boolean),
)


def _check_vector(function: str, v: object, *elements: types.Type) -> None:
    """Reject an argument that is not a vector of one of the element types."""
    if not isinstance(v, Vector) or v.element not in elements:
        reject(function, v, cure=f"needs a vector of {' or '.join(str(e) for e in elements)}")


def _check_common(function: str, args: tuple[Any, ...], *elements: types.Type) -> Vector:
    """The common vector type of the arguments."""
    vector = common_vector(args)
    if vector is None or vector.element not in elements:
        names = " or ".join(str(e) for e in elements)
        reject(function, *args, cure=f"needs vectors of {names} of one width; some may be scalars, not all")
    return vector


# --- make ---------------------------------------------------------------------------------------------------


def _make_splat(lanes: int) -> Any:
    @intrinsic
    def splat(typingctx, x):
        """The scalar in every lane: float -> f32, integer -> i32, bool -> mask."""
        vector = next((Vector(element, lanes) for kind, element in _SPLATS if isinstance(x, kind)), None)
        if vector is None:
            reject(f"splat{lanes}", x, cure="needs a real number or a bool")

        def codegen(context, builder, sig, values):
            return as_vectors(context, builder, vector, [x], values)[0]

        return vector(x), codegen

    return splat


def _make_iota(lanes: int) -> Any:
    @intrinsic
    def iota(typingctx):
        """0, 1, 2, ... as i32."""
        vector = Vector(types.int32, lanes)

        def codegen(context, builder, sig, values):
            return ir.Constant(llvm_type(vector), list(range(lanes)))

        return vector(), codegen

    return iota


def _make_mask_from_bits(lanes: int) -> Any:
    @intrinsic
    def mask_from_bits(typingctx, x):
        """Lane k is bit k of the integer; higher bits are ignored."""
        if not isinstance(x, types.Integer):
            reject(f"mask_from_bits{lanes}", x, cure="needs an integer")
        vector = Vector(types.boolean, lanes)

        def codegen(context, builder, sig, values):
            wide = context.cast(builder, values[0], x, types.int64)
            return builder.bitcast(builder.trunc(wide, ir.IntType(lanes)), llvm_type(vector))

        return vector(x), codegen

    return mask_from_bits


splat4, splat8, splat16 = (_make_splat(lanes) for lanes in (4, 8, 16))
splat1 = _make_splat(1)
"""A vector of one lane, with which functions of vectors serve single rays on devices."""
iota4, iota8, iota16 = (_make_iota(lanes) for lanes in (4, 8, 16))
mask_from_bits4, mask_from_bits8, mask_from_bits16 = (_make_mask_from_bits(lanes) for lanes in (4, 8, 16))


# --- choose and combine -------------------------------------------------------------------------------------


@intrinsic
def select(typingctx, mask, a, b):
    """Lanes of `a` where the mask is set, of `b` where it is not."""
    vector = _check_common("select", (a, b), types.float32, types.int32, types.boolean)
    if mask != Vector(types.boolean, vector.lanes):
        reject("select", mask, a, b, cure=f"the first argument must be a mask{vector.lanes}")

    def codegen(context, builder, sig, values):
        return builder.select(values[0], *as_vectors(context, builder, vector, (a, b), values[1:]))

    return vector(mask, a, b), codegen


def _make_extremum(name: str, f32_name: str, i32_name: str) -> Any:
    @intrinsic
    def extremum(typingctx, a, b):
        """The smaller (`minimum`) or larger (`maximum`) of two lanes; unspecified if one is NaN."""
        vector = _check_common(name, (a, b), types.float32, types.int32)

        def codegen(context, builder, sig, values):
            pair = as_vectors(context, builder, vector, (a, b), values)
            if vector.is_i32:
                return call_llvm(builder, f"llvm.{i32_name}.{vector.suffix}", pair[0].type, pair)
            # With nnan and nsz this is one instruction, even inside a masked select. select(a < b, a, b) is as good
            # on its own, but becomes mask logic inside a masked select.
            flags = ("nnan", "nsz")
            return call_llvm(builder, f"llvm.{f32_name}.{vector.suffix}", pair[0].type, pair, flags)

        return vector(a, b), codegen

    return extremum


minimum = _make_extremum("minimum", "minnum", "smin")
maximum = _make_extremum("maximum", "maxnum", "smax")


@intrinsic
def fma(typingctx, a, b, c):
    """a * b + c, rounded once if the target has the instruction, otherwise twice."""
    vector = _check_common("fma", (a, b, c), types.float32)

    def codegen(context, builder, sig, values):
        # Not llvm.fma: without the instruction, that becomes one library call per lane, ten times as slow.
        args = as_vectors(context, builder, vector, (a, b, c), values)
        return call_llvm(builder, f"llvm.fmuladd.{vector.suffix}", args[0].type, args)

    return vector(a, b, c), codegen


@intrinsic
def absolute(typingctx, a):
    """The absolute value. The most negative int32 has no counterpart and stays unchanged."""
    _check_vector("absolute", a, types.float32, types.int32)

    def codegen(context, builder, sig, values):
        if a.is_f32:
            return call_llvm(builder, f"llvm.fabs.{a.suffix}", values[0].type, values)
        int_min_is_undefined = ir.IntType(1)(0)
        return call_llvm(builder, f"llvm.abs.{a.suffix}", values[0].type, [values[0], int_min_is_undefined])

    return a(a), codegen


@intrinsic
def square_root(typingctx, a):
    """The square root, correctly rounded (IEEE 754); NaN for negative lanes."""
    _check_vector("square_root", a, types.float32)

    def codegen(context, builder, sig, values):
        return call_llvm(builder, f"llvm.sqrt.{a.suffix}", values[0].type, values)

    return a(a), codegen


@intrinsic
def flip_sign(typingctx, a, s):
    """`a`, negated in the lanes where the sign bit of `s` is set, including -0.0; both f32."""
    vector = _check_common("flip_sign", (a, s), types.float32)

    def codegen(context, builder, sig, values):
        integer = ir.VectorType(I32, vector.lanes)
        x, y = (builder.bitcast(v, integer) for v in as_vectors(context, builder, vector, (a, s), values))
        sign = builder.and_(y, ir.Constant(integer, [_SIGN_BIT] * vector.lanes))
        return builder.bitcast(builder.xor(x, sign), llvm_type(vector))

    return vector(a, s), codegen


@intrinsic
def to_f32(typingctx, v):
    """Convert i32 or f64 to f32, rounded to nearest."""
    _check_vector("to_f32", v, types.int32, types.float64)
    result = Vector(types.float32, v.lanes)

    def codegen(context, builder, sig, values):
        convert = builder.sitofp if v.is_i32 else builder.fptrunc
        return convert(values[0], llvm_type(result))

    return result(v), codegen


@intrinsic
def to_f64(typingctx, v):
    """Convert f32 to f64, exactly."""
    _check_vector("to_f64", v, types.float32)
    result = Vector(types.float64, v.lanes)

    def codegen(context, builder, sig, values):
        return builder.fpext(values[0], llvm_type(result))

    return result(v), codegen


@intrinsic
def to_i32(typingctx, v):
    """Convert f32 to i32, truncated towards zero; unspecified for NaN and for values outside int32."""
    _check_vector("to_i32", v, types.float32)
    result = Vector(types.int32, v.lanes)

    def codegen(context, builder, sig, values):
        return builder.fptosi(values[0], llvm_type(result))

    return result(v), codegen


@intrinsic
def f32_bits(typingctx, v):
    """The bits of f32 as i32."""
    _check_vector("f32_bits", v, types.float32)
    result = Vector(types.int32, v.lanes)

    def codegen(context, builder, sig, values):
        return builder.bitcast(values[0], llvm_type(result))

    return result(v), codegen


# --- permute and reduce -------------------------------------------------------------------------------------


def _permute(builder: Any, value: Any, indices: Sequence[int]) -> Any:
    order = ir.Constant(ir.VectorType(I32, len(indices)), list(indices))
    return builder.shuffle_vector(value, ir.Constant(value.type, ir.Undefined), order)


@intrinsic
def swap_halves(typingctx, v):
    """The upper half of the lanes, then the lower half."""
    if not isinstance(v, Vector):
        reject("swap_halves", v, cure="needs a vector")

    def codegen(context, builder, sig, values):
        half = v.lanes // 2
        return _permute(builder, values[0], [*range(half, v.lanes), *range(half)])

    return v(v), codegen


@intrinsic
def join(typingctx, a, b):
    """The lanes of `a`, then the lanes of `b`: a vector of twice the width."""
    if not isinstance(a, Vector) or a != b or a.lanes == 16:
        reject("join", a, b, cure="needs two vectors of one type, of 4 or 8 lanes")

    def codegen(context, builder, sig, values):
        order = ir.Constant(ir.VectorType(I32, 2 * a.lanes), list(range(2 * a.lanes)))
        return builder.shuffle_vector(*values, order)

    return Vector(a.element, 2 * a.lanes)(a, b), codegen


@intrinsic(prefer_literal=True)
def shuffle(typingctx, v, *indices):
    """Lane k of the result is lane ``indices[k]`` of `v`; the indices are literals, one per lane."""
    if not isinstance(v, Vector) or len(indices) != v.lanes:
        reject("shuffle", v, *indices, cure="needs a vector and one index per lane")
    if not all(isinstance(i, types.IntegerLiteral) and 0 <= i.literal_value < v.lanes for i in indices):
        reject("shuffle", v, *indices, cure=f"the indices must be literal integers from 0 to {v.lanes - 1}")

    def codegen(context, builder, sig, values):
        return _permute(builder, values[0], [i.literal_value for i in indices])

    return v(v, types.StarArgTuple(indices)), codegen


@intrinsic
def permute(typingctx, v, indices):
    """Lane k of the result is lane ``indices[k]`` of `v`; the indices are i32, from 0 to the last lane, unchecked."""
    if not isinstance(v, Vector) or indices != Vector(types.int32, v.lanes):
        reject("permute", v, indices, cure="needs a vector and as many i32")

    def codegen(context, builder, sig, values):
        result = ir.Constant(values[0].type, ir.Undefined)
        for k in range(v.lanes):  # LLVM finds the instruction, if the processor has one
            lane = builder.extract_element(values[0], builder.extract_element(values[1], I32(k)))
            result = builder.insert_element(result, lane, I32(k))
        return result

    return v(v, indices), codegen


@intrinsic
def extract(typingctx, v, i):
    """Lane `i` as a scalar; `i` from 0 to the last lane, unchecked."""
    if not isinstance(v, Vector) or not isinstance(i, types.Integer):
        reject("extract", v, i, cure="needs a vector and an integer")

    def codegen(context, builder, sig, values):
        return builder.extract_element(values[0], context.cast(builder, values[1], i, types.int64))

    return v.element(v, i), codegen


@intrinsic
def bits(typingctx, mask):
    """The mask as an int64 in which bit k is lane k."""
    _check_vector("bits", mask, types.boolean)

    def codegen(context, builder, sig, values):
        return builder.zext(builder.bitcast(values[0], ir.IntType(mask.lanes)), I64)

    return types.int64(mask), codegen


def _make_vote(name: str, comparison: str, number: int) -> Any:
    @intrinsic
    def vote(typingctx, mask):
        """Whether any lane (`any_lane`), or every lane (`all_lanes`), is set."""
        _check_vector(name, mask, types.boolean)

        def codegen(context, builder, sig, values):
            integer = ir.IntType(mask.lanes)
            return builder.icmp_unsigned(comparison, builder.bitcast(values[0], integer), integer(number))

        return types.boolean(mask), codegen

    return vote


any_lane = _make_vote("any_lane", "!=", 0)
all_lanes = _make_vote("all_lanes", "==", -1)


def _make_reduction(name: str, f32_name: str | None, i32_name: str) -> Any:
    @intrinsic
    def reduction(typingctx, v):
        """The smallest (`reduce_min`) or largest (`reduce_max`) lane, unspecified if one is NaN.

        `reduce_and` gives the bits common to all lanes of an i32 vector.
        """
        _check_vector(name, v, *((types.float32, types.int32) if f32_name else (types.int32,)))

        def codegen(context, builder, sig, values):
            llvm_name = f"llvm.vector.reduce.{f32_name if v.is_f32 else i32_name}.{v.suffix}"
            flags = ("nnan", "nsz") if v.is_f32 else ()
            return call_llvm(builder, llvm_name, values[0].type.element, values, flags)

        return v.element(v), codegen

    return reduction


reduce_min = _make_reduction("reduce_min", "fmin", "smin")
reduce_max = _make_reduction("reduce_max", "fmax", "smax")
reduce_and = _make_reduction("reduce_and", None, "and")

# --- Operations on scalars --------------------------------------------------------------------------------------------


def _make_bit_count(name: str, llvm_name: str, *flags: int) -> Any:
    @intrinsic
    def count(typingctx, x):
        if not isinstance(x, types.Integer):
            reject(name, x, cure="needs an integer")

        def codegen(context, builder, sig, values):
            wide = context.cast(builder, values[0], x, types.int64)
            return call_llvm(builder, llvm_name, I64, [wide, *(ir.IntType(1)(flag) for flag in flags)])

        return types.int64(x), codegen

    return count


popcount = _make_bit_count("popcount", "llvm.ctpop.i64")
lowest_bit = _make_bit_count("lowest_bit", "llvm.cttz.i64", 0)


@intrinsic
def highest_bit(typingctx, x):
    """Index of the highest set bit; -1 for 0."""
    if not isinstance(x, types.Integer):
        reject("highest_bit", x, cure="needs an integer")

    def codegen(context, builder, sig, values):
        wide = context.cast(builder, values[0], x, types.int64)
        zeros = call_llvm(builder, "llvm.ctlz.i64", I64, [wide, ir.IntType(1)(0)])
        return builder.sub(I64(63), zeros)

    return types.int64(x), codegen


@intrinsic
def product_error(typingctx, a, b, product):
    """a b - product, exactly, where `product` is the float64 product of two float64 numbers.

    The magnitudes must lie within 1e-150 .. 1e150, or be 0.
    """
    if (a, b, product) != (types.float64,) * 3:
        reject("product_error", a, b, product, cure="needs three float64")
    name = name_of_product_error()

    def codegen(context, builder, sig, values):
        return call_llvm(builder, name, ir.DoubleType(), values)

    return types.float64(a, b, product), codegen


# --- Vectorisation by LLVM --------------------------------------------------------------------------------------------


@intrinsic
def widen_loops(typingctx):
    """Let LLVM vectorise the loops of this kernel for 512-bit registers, where the processor has them.

    Otherwise it uses half of such a register, because some processors run slower with whole ones. That is no
    consideration in a kernel with vectors of 16 lanes. Call it in the kernel itself, not in an inlined function.
    """

    def codegen(context, builder, sig, values):
        set.add(builder.function.attributes, '"prefer-vector-width"="512"')  # llvmlite knows no attributes of targets
        return context.get_dummy_value()

    return types.void(), codegen
