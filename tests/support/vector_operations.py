"""Every operation of `antumbra.kernels.simd`, computed by kernels and by numpy, for the tests in `kernels/simd/`.

As a script it writes the results of the kernels to a file: ``python vector_operations.py results.npz``. So tests can
compare processes that compile for different processors.
"""

import sys

import numpy as np

from antumbra.kernels import simd
from antumbra.kernels.jit import kernel as compiled
from antumbra.kernels.simd import (
    absolute,
    all_lanes,
    any_lane,
    bits,
    extract,
    flip_sign,
    fma,
    maximum,
    minimum,
    reduce_and,
    reduce_max,
    reduce_min,
    select,
    shuffle,
    square_root,
    store,
    swap_halves,
    to_f32,
    to_i32,
)

LANES = (4, 8, 16)
_F32 = np.finfo(np.float32)
_I32 = np.iinfo(np.int32)


# --- inputs ---------------------------------------------------------------------------------------------


def _all_pairs(values, n):
    """Two arrays of length n that start with every pair of the values."""
    a, b = (grid.ravel() for grid in np.meshgrid(values, values))
    return np.resize(a, n), np.resize(b, n)


def f32_inputs():
    """Two arrays with every pair of hard float32 and pairs of random bit patterns, and a third, well-behaved array."""
    tiny, largest = _F32.smallest_subnormal, _F32.max
    half = [np.nan, np.inf, 0.0, tiny, 3 * tiny, _F32.smallest_normal, 1e-30, 1 / 3, 1.0, 1.5, 7e9, largest]
    hard = np.array([*half, *(-x for x in half)], np.float32)
    rng = np.random.default_rng(7)
    a, b = _all_pairs(hard, 1024)
    a[640:], b[640:] = rng.integers(0, 2**32, (2, 384), np.uint32).view(np.float32)
    return a, b, rng.uniform(-8, 8, 1024).astype(np.float32)


def i32_inputs():
    """Two arrays with every pair of hard int32 and random pairs, and an array of shift counts."""
    hard = np.array([0, 1, -1, 2, -2, 3, 46341, -46341, 65535, 2**30, _I32.max, _I32.max - 1, _I32.min], np.int32)
    rng = np.random.default_rng(8)
    a, b = _all_pairs(hard, 512)
    a[176:], b[176:] = rng.integers(_I32.min, _I32.max, (2, 336), np.int32, endpoint=True)
    return a, b, rng.integers(0, 32, 512).astype(np.int32)


def in_range_reals():
    """float32 numbers in the range of int32, with the largest and the smallest of them."""
    rng = np.random.default_rng(9)
    reals = (rng.uniform(-1, 1, 512) * 2.0 ** rng.integers(-3, 31, 512)).astype(np.float32)
    reals[:8] = 0.0, -0.0, 0.99999994, -0.99999994, 1.5, -1.5, 2147483520.0, -2147483648.0
    return reals


def mask_inputs(lanes):
    """Pairs of words of `lanes` bits: none, all, each single bit, random."""
    rng = np.random.default_rng(10)
    words = np.array([0, 2**lanes - 1, *(1 << k for k in range(lanes)), *rng.integers(0, 2**lanes, 12)], np.int64)
    return _all_pairs(words, words.size**2)


# --- kernels --------------------------------------------------------------------------------------------


@compiled
def _reverse4(v):
    return shuffle(v, 3, 2, 1, 0)


@compiled
def _reverse8(v):
    return shuffle(v, 7, 6, 5, 4, 3, 2, 1, 0)


@compiled
def _reverse16(v):
    return shuffle(v, 15, 14, 13, 12, 11, 10, 9, 8, 7, 6, 5, 4, 3, 2, 1, 0)


_REVERSE = {4: _reverse4, 8: _reverse8, 16: _reverse16}


def make_f32_kernel(lanes):
    load, broadcast, splat = (getattr(simd, f"{name}{lanes}") for name in ("load", "broadcast", "splat"))
    reverse = _REVERSE[lanes]

    @compiled
    def compute(a, b, c, out, masks, sums):
        n = a.size
        for i in range(0, n, lanes):
            x, y, z = load(a, i), load(b, i), load(c, i)
            w = x
            w += y
            w -= 1
            w *= z
            w /= np.float32(3)
            store(out, 0 * n + i, x + y)
            store(out, 1 * n + i, x - y)
            store(out, 2 * n + i, x * y)
            store(out, 3 * n + i, x / y)
            store(out, 4 * n + i, -x)
            store(out, 5 * n + i, +x)
            store(out, 6 * n + i, x * np.float32(0.1) - 2)
            store(out, 7 * n + i, np.float32(0.1) - 1 / x)
            store(out, 8 * n + i, w)
            store(out, 9 * n + i, minimum(x, y))
            store(out, 10 * n + i, maximum(x, y))
            store(out, 11 * n + i, minimum(np.float32(0.5), maximum(z, -1)))
            store(out, 12 * n + i, fma(z, z, np.float32(-0.1)))
            store(out, 13 * n + i, absolute(x))
            store(out, 14 * n + i, flip_sign(x, y))
            store(out, 15 * n + i, select(x < y, x, y))
            store(out, 16 * n + i, select(x < y, z, np.float32(9)))
            store(out, 17 * n + i, swap_halves(x))
            store(out, 18 * n + i, reverse(x))
            store(out, 19 * n + i, broadcast(a, i + 1))
            store(out, 20 * n + i, splat(c[i]))
            store(out, 21 * n + i, square_root(x))
            k = i // lanes
            masks[0, k] = bits(x < y)
            masks[1, k] = bits(x <= y)
            masks[2, k] = bits(x > y)
            masks[3, k] = bits(x >= y)
            masks[4, k] = bits(x == y)
            masks[5, k] = bits(x != y)
            masks[6, k] = bits(np.float32(0.5) < z)
            sums[0, k] = reduce_min(z)
            sums[1, k] = reduce_max(z)
            sums[2, k] = extract(x, k % lanes)

    return compute


def make_i32_kernel(lanes):
    load, broadcast, splat = (getattr(simd, f"{name}{lanes}") for name in ("load", "broadcast", "splat"))
    iota, reverse = getattr(simd, f"iota{lanes}"), _REVERSE[lanes]

    @compiled
    def compute(a, b, c, reals, out, masks, sums, floats):
        n = a.size
        for i in range(0, n, lanes):
            x, y, s = load(a, i), load(b, i), load(c, i)
            w = x
            w += y
            w -= 7
            w *= y
            w &= 0x7FFFFF0F
            w |= s
            w ^= x
            w <<= 3
            w >>= s
            store(out, 0 * n + i, x + y)
            store(out, 1 * n + i, x - y)
            store(out, 2 * n + i, x * y)
            store(out, 3 * n + i, x & y)
            store(out, 4 * n + i, x | y)
            store(out, 5 * n + i, x ^ y)
            store(out, 6 * n + i, x << s)
            store(out, 7 * n + i, x >> s)
            store(out, 8 * n + i, -x)
            store(out, 9 * n + i, ~x)
            store(out, 10 * n + i, x * 3 - np.int64(1))
            store(out, 11 * n + i, 5 - x)
            store(out, 12 * n + i, (x << 4) >> np.int32(2))
            store(out, 13 * n + i, w)
            store(out, 14 * n + i, minimum(x, y))
            store(out, 15 * n + i, maximum(x, y))
            store(out, 16 * n + i, absolute(x))
            store(out, 17 * n + i, select(x < y, 1, y))
            store(out, 18 * n + i, swap_halves(x))
            store(out, 19 * n + i, reverse(x))
            store(out, 20 * n + i, broadcast(a, i + 1))
            store(out, 21 * n + i, splat(a[i]))
            store(out, 22 * n + i, iota())
            store(out, 23 * n + i, to_i32(load(reals, i)))
            store(floats, i, to_f32(x))
            k = i // lanes
            masks[0, k] = bits(x < y)
            masks[1, k] = bits(x <= y)
            masks[2, k] = bits(x > y)
            masks[3, k] = bits(x >= y)
            masks[4, k] = bits(x == y)
            masks[5, k] = bits(x != y)
            masks[6, k] = bits(np.int32(5) < x)
            sums[0, k] = reduce_min(x)
            sums[1, k] = reduce_max(x)
            sums[2, k] = extract(x, k % lanes)
            sums[3, k] = reduce_and(x | y)

    return compute


def make_mask_kernel(lanes):
    from_bits, splat = getattr(simd, f"mask_from_bits{lanes}"), getattr(simd, f"splat{lanes}")

    @compiled
    def compute(a, b, out):
        for k in range(a.size):
            x, y = from_bits(a[k]), from_bits(b[k])
            w = x
            w &= y
            w |= ~x
            w ^= y
            out[0, k] = bits(x & y)
            out[1, k] = bits(x | y)
            out[2, k] = bits(x ^ y)
            out[3, k] = bits(~x)
            out[4, k] = bits(select(x, y, from_bits(5)))
            out[5, k] = bits(x & (b[k] % 2 == 0))
            out[6, k] = bits(w)
            out[7, k] = bits(swap_halves(x))
            out[8, k] = bits(splat(True))
            out[9, k] = any_lane(x)
            out[10, k] = all_lanes(x)
            out[11, k] = extract(x, k % lanes)

    return compute


def joined(lanes):
    """A kernel that joins the vectors of two arrays, one by one."""
    load = getattr(simd, f"load{lanes}")

    @compiled
    def compute(a, b, out):
        for i in range(0, len(a), lanes):
            store(out, 2 * i, simd.join(load(a, i), load(b, i)))

    return compute


def permuted(lanes):
    """A kernel that permutes the vectors of an array by those of another."""
    load = getattr(simd, f"load{lanes}")

    @compiled
    def compute(a, order, out):
        for i in range(0, len(a), lanes):
            store(out, i, simd.permute(load(a, i), load(order, i)))

    return compute


@compiled
def bits_of_f32(a, out):
    """Write the bits of an array."""
    for i in range(0, len(a), 8):
        store(out, i, simd.f32_bits(simd.load8(a, i)))


# --- expectations ---------------------------------------------------------------------------------------
# Dicts in the order of the rows that the kernels write.


def _comparisons(a, b):
    return {"lt": a < b, "le": a <= b, "gt": a > b, "ge": a >= b, "eq": a == b, "ne": a != b}


def _permutations(a, lanes):
    groups = a.reshape(-1, lanes)
    return {
        "swap_halves": np.roll(groups, lanes // 2, axis=1).ravel(),
        "reverse": groups[:, ::-1].ravel(),
        "broadcast": np.repeat(a[1::lanes], lanes),
    }


def _scalars(reduced, extracted, lanes):
    groups, row = reduced.reshape(-1, lanes), np.arange(reduced.size // lanes)
    return {
        "reduce_min": groups.min(1),
        "reduce_max": groups.max(1),
        "extract": extracted.reshape(-1, lanes)[row, row % lanes],
    }


def expect_f32(lanes):
    """(vectors, masks, scalars) by numpy. Here fma is rounded twice."""
    a, b, c = f32_inputs()
    f = np.float32
    with np.errstate(all="ignore"):
        vectors = {
            "add": a + b,
            "sub": a - b,
            "mul": a * b,
            "div": a / b,
            "neg": -a,
            "pos": +a,
            "scalar_right": a * f(0.1) - 2,
            "scalar_left": f(0.1) - 1 / a,
            "in_place": (a + b - 1) * c / 3,
            "minimum": np.minimum(a, b),
            "maximum": np.maximum(a, b),
            "extremum_scalar": np.clip(c, -1, f(0.5)),
            "fma": c * c - f(0.1),
            "absolute": abs(a),
            "flip_sign": a * np.where(np.signbit(b), f(-1), f(1)),
            "select": np.where(a < b, a, b),
            "select_scalar": np.where(a < b, c, f(9)),
            **_permutations(a, lanes),
            "splat": np.repeat(c[::lanes], lanes),
            "square_root": np.sqrt(a),
        }
        masks = _comparisons(a, b) | {"scalar": f(0.5) < c}
    return vectors, masks, _scalars(c, a, lanes)


def expect_i32(lanes):
    """(vectors, masks, scalars) by numpy."""
    a, b, c = i32_inputs()
    with np.errstate(all="ignore"):
        vectors = {
            "add": a + b,
            "sub": a - b,
            "mul": a * b,
            "and": a & b,
            "or": a | b,
            "xor": a ^ b,
            "shl": a << c,
            "shr": a >> c,
            "neg": -a,
            "invert": ~a,
            "scalar_right": a * 3 - 1,
            "scalar_left": 5 - a,
            "shift_scalar": (a << 4) >> 2,
            "in_place": ((((((a + b - 7) * b) & 0x7FFFFF0F) | c) ^ a) << 3) >> c,
            "minimum": np.minimum(a, b),
            "maximum": np.maximum(a, b),
            "absolute": abs(a),
            "select": np.where(a < b, np.int32(1), b),
            **_permutations(a, lanes),
            "splat": np.repeat(a[::lanes], lanes),
            "iota": np.resize(np.arange(lanes, dtype=np.int32), a.size),
            "to_i32": in_range_reals().astype(np.int32),
        }
    common = np.bitwise_and.reduce((a | b).reshape(-1, lanes), 1)
    return vectors, _comparisons(a, b) | {"scalar": a > 5}, _scalars(a, a, lanes) | {"reduce_and": common}


def expect_mask(lanes):
    """Words of mask bits by numpy."""
    a, b = mask_inputs(lanes)
    full, half = 2**lanes - 1, lanes // 2
    return {
        "and": a & b,
        "or": a | b,
        "xor": a ^ b,
        "invert": ~a & full,
        "select": (a & b) | (~a & full & 5),
        "scalar": np.where(b % 2 == 0, a, 0),
        "in_place": (((a & b) | ~a) ^ b) & full,
        "swap_halves": (a >> half) | ((a << half) & full),
        "splat_true": np.full(a.size, full),
        "any_lane": (a != 0).astype(np.int64),
        "all_lanes": (a == full).astype(np.int64),
        "extract": (a >> (np.arange(a.size) % lanes)) & 1,
    }


# --- results --------------------------------------------------------------------------------------------


def _run(kernel, inputs, expected, lanes, *more_outputs):
    """The results of a kernel, under the names of the expected results."""
    n, dtype = inputs[0].size, inputs[0].dtype
    vectors = np.full((len(expected[0]), n), -9, dtype)
    words = np.full((len(expected[1]), n // lanes), -1)
    scalars = np.full((len(expected[2]), n // lanes), -9, dtype)
    kernel(*inputs, vectors, words, scalars, *more_outputs)
    masks = ((words[:, :, None] >> np.arange(lanes)) & 1).astype(bool).reshape(-1, n)
    results = zip(expected, (vectors, masks, scalars))
    return {name: row for names, rows in results for name, row in zip(names, rows, strict=True)}


def compute_f32(lanes):
    return _run(make_f32_kernel(lanes), f32_inputs(), expect_f32(lanes), lanes)


def compute_i32(lanes):
    a, b, c = i32_inputs()
    to_f32 = np.full(a.size, np.nan, np.float32)
    kernel, inputs = make_i32_kernel(lanes), (a, b, c, in_range_reals())
    return _run(kernel, inputs, expect_i32(lanes), lanes, to_f32) | {"to_f32": to_f32}


def compute_mask(lanes):
    """The results of the mask kernels. The words' higher bits are set, and must not matter."""
    a, b = mask_inputs(lanes)
    names = expect_mask(lanes)
    words = np.full((len(names), a.size), -1)
    make_mask_kernel(lanes)(a | -(1 << lanes), b, words)
    return dict(zip(names, words, strict=True))


def compute_all():
    """The results of all kernels, under names such as ``f32x8.add``."""
    groups = (("f32x", compute_f32), ("i32x", compute_i32), ("mask", compute_mask))
    return {
        f"{prefix}{lanes}.{name}": array
        for lanes in LANES
        for prefix, compute in groups
        for name, array in compute(lanes).items()
    }


@compiled
def _add_min_select(a, b, out):
    x, y = simd.load8(a, 0), simd.load8(b, 0)
    store(out, 0, select(x < y, x + y, minimum(x, y)))


def assembly():
    """The machine code of ``x + y``, ``minimum`` and ``select`` on f32x8 for the processor compiled for."""
    from antumbra.kernels import machine_code
    from antumbra.kernels.processor import level
    from antumbra.kernels.toolchain import compiling

    module, _ = compiling.lower_kernel(_add_min_select, " ".join(3 * ["A[f4,1,C]"]), "add_min_select")
    return machine_code.emit_assembly(machine_code.optimise(module, level()), level())


if __name__ == "__main__":
    np.savez(sys.argv[1], assembly=assembly(), **compute_all())
