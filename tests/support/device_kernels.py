"""Kernels for devices that are small, and together use what device kernels may use."""

from typing import NamedTuple

import numpy as np

from antumbra.kernels.device import (
    atomic_add,
    atomic_min,
    ballot,
    barrier,
    block_index,
    block_size,
    fma,
    i64_at,
    index_in_block,
    lane_count,
    lane_index,
    load4_aligned,
    local_i32,
    shuffle,
    thread_index,
    u8_at,
)
from antumbra.kernels.jit import kernel
from antumbra.kernels.simd import (
    absolute,
    extract,
    f32_at,
    f64_at,
    get,
    i32_at,
    maximum,
    minimum,
    popcount,
    product_error,
    put,
    splat4,
    stack_i32,
)
from antumbra.kernels.toolchain.device_code import DeviceKernel


class Arrays(NamedTuple):
    """Addresses of `n` elements each, and a scalar."""

    a: int  # float32 *
    b: int
    out: int
    n: int
    scale: np.float32


@kernel
def places(out):
    """Where each thread is, as six int64: of the launch, its block, and its subgroup."""
    i, to = thread_index(), i64_at(out)
    put(to, 6 * i, i)
    put(to, 6 * i + 1, block_index())
    put(to, 6 * i + 2, block_size())
    put(to, 6 * i + 3, index_in_block())
    put(to, 6 * i + 4, lane_index())
    put(to, 6 * i + 5, lane_count())


@kernel
def float_operations(arrays):
    """a + b, a - b, a b, a / b and a b + scale, five float32 for each element."""
    i = thread_index()
    if i < arrays.n:
        a, b, out = get(f32_at(arrays.a), i), get(f32_at(arrays.b), i), f32_at(arrays.out)
        put(out, 5 * i, a + b)
        put(out, 5 * i + 1, a - b)
        put(out, 5 * i + 2, a * b)
        put(out, 5 * i + 3, a / b)
        put(out, 5 * i + 4, fma(a, b, arrays.scale))


@kernel
def double_operations(a, b, out, n):
    """The same of float64, with the error of the product in the place of `fma`, and the root of |a|."""
    i = thread_index()
    if i < n:
        x, y, to = get(f64_at(a), i), get(f64_at(b), i), f64_at(out)
        product = x * y
        put(to, 6 * i, x + y)
        put(to, 6 * i + 1, x - y)
        put(to, 6 * i + 2, product)
        put(to, 6 * i + 3, x / y)
        put(to, 6 * i + 4, product_error(x, y, product))
        put(to, 6 * i + 5, np.sqrt(abs(x)))


@kernel
def sorted_links(boxes, order, n, visits):
    """A small traversal: items of a heap of n, larger ones first, by a stack; bytes, vectors and an atomic counter.

    boxes : float32 *, four for each item, at a multiple of 16 bytes
    order : uint8 *: the rank in which each thread has visited the item of its own index
    """
    i = thread_index()
    if i >= n:
        return
    stack = stack_i32(64)
    height, item, rank = 0, 0, 0
    while True:
        atomic_add(i64_at(visits), 0, 1)
        if item == i:
            put(u8_at(order), i, rank)
        rank += 1
        left, right = 2 * item + 1, 2 * item + 2
        if left < n and right < n:
            a, b = load4_aligned(f32_at(boxes), 4 * left), load4_aligned(f32_at(boxes), 4 * right)
            low, high = minimum(a, splat4(np.float32(1.0))), maximum(absolute(b), splat4(np.float32(0.25)))
            swap = extract(low, 0) + extract(low, 3) < extract(high, 1) * extract(high, 2)
            put(stack, height, left if swap else right)
            height += 1
            item = right if swap else left
        elif left < n:
            item = left
        else:
            if height == 0:
                return
            height -= 1
            item = get(stack, height)


@kernel
def reversed_blocks(numbers, out):
    """The int32 of each block in reverse order, by local memory."""
    own, size, memory = index_in_block(), block_size(), local_i32(0, 256)
    put(memory, own, get(i32_at(numbers), thread_index()))
    barrier()
    put(i32_at(out), block_index() * size + own, get(memory, size - 1 - own))


@kernel
def votes(numbers, bits, neighbours):
    """Who has an odd number: the ballot of each thread's subgroup; and the number of the next lane."""
    i = thread_index()
    number = np.int32(get(i32_at(numbers), i))
    put(i64_at(bits), i, ballot((number & 1) == 1))
    put(i32_at(neighbours), i, shuffle(number, (lane_index() + 1) % lane_count()))


@kernel
def counted_odds(numbers, total):
    """Add the number of odd int32 to an int64: one addition for each subgroup, then one for each block."""
    odds, sums = ballot((get(i32_at(numbers), thread_index()) & 1) == 1), local_i32(0, 1)
    if index_in_block() == 0:
        put(sums, 0, 0)
    barrier()
    if lane_index() == 0:
        atomic_add(sums, 0, popcount(odds))
    barrier()
    if index_in_block() == 0:
        atomic_add(i64_at(total), 0, get(sums, 0))


@kernel
def least_of(numbers, least, n, m):
    """Lower int32 k of m to the least of every m-th of n."""
    i = thread_index()
    if i < n:
        atomic_min(i32_at(least), i % m, get(i32_at(numbers), i))


PLACES = DeviceKernel(places, (0,))
FLOATS = DeviceKernel(float_operations, (Arrays(0, 0, 0, 0, np.float32(0)),))
DOUBLES = DeviceKernel(double_operations, (0, 0, 0, 0))
LINKS = DeviceKernel(sorted_links, (0, 0, 0, 0))
REVERSED = DeviceKernel(reversed_blocks, (0, 0))
VOTES = DeviceKernel(votes, (0, 0, 0))
ODDS = DeviceKernel(counted_odds, (0, 0))
LEAST = DeviceKernel(least_of, (0, 0, 0, 0))
SAMPLES = [FLOATS, DOUBLES, LINKS, REVERSED, VOTES, ODDS]
