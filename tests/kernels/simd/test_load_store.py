"""Loads, stores, pointers, memory on the stack, atomic operations."""

import threading
from typing import NamedTuple

import numpy as np
import pytest
from llvmlite import ir
from numba.core import types
from numba.extending import intrinsic

from antumbra.kernels import simd
from antumbra.kernels.jit import F32x8
from antumbra.kernels.jit import kernel as compiled
from antumbra.kernels.simd import (
    as_f32,
    as_i32,
    atomic_add,
    atomic_and,
    atomic_or,
    broadcast4,
    extract,
    f32_at,
    f64_at,
    gather,
    get,
    i32_at,
    load4,
    load8,
    load8x3_pair,
    load16,
    load16x3,
    mask_from_bits8,
    mask_from_bits16,
    prefetch,
    ptr,
    ptr_at,
    put,
    select,
    splat8,
    stack_f32,
    stack_f64,
    stack_i32,
    stack_i64,
    store,
    store_compressed,
    to_f32,
    to_f64,
)


@intrinsic
def _address(typingctx, pointer):
    return types.int64(pointer), lambda context, builder, sig, values: builder.ptrtoint(values[0], ir.IntType(64))


@pytest.mark.parametrize("lanes", [4, 8, 16])
@pytest.mark.parametrize("dtype", [np.float32, np.int32])
def test_load_and_store_touch_exactly_their_lanes_at_any_offset(lanes, dtype):
    load = getattr(simd, f"load{lanes}")

    @compiled
    def move(source, i, target, j):
        store(target, j, load(source, i))

    source = np.arange(1, 41).astype(dtype)
    for i, j in ((0, 0), (1, 2), (7, 3), (40 - lanes, 24)):
        target = np.zeros(40, dtype)
        move(source, i, target, j)
        expected = np.zeros(40, dtype)
        expected[j : j + lanes] = source[i : i + lanes]
        assert np.array_equal(target, expected)


def test_arrays_of_more_dimensions_count_elements_from_the_first():
    @compiled
    def move(source, target):
        store(target, 5, load4(source, 3))
        put(target, 0, get(source, 7))

    source, target = np.arange(8, dtype=np.float32).reshape(2, 2, 2), np.zeros((3, 3), np.float32)
    move(source, target)
    assert target.ravel().tolist() == [7, 0, 0, 0, 0, 3, 4, 5, 6]


def test_pointers_index_without_wraparound():
    @compiled
    def read(a, out):
        third = ptr_at(a, 3)
        store(out, 0, load4(third, np.uint32(1)))
        out[4] = get(third, -1)
        out[5] = extract(broadcast4(third, np.int32(-2)), 3)
        put(ptr_at(third, 2), -5, 99)
        store(ptr(out), 6, load4(ptr(a), 0))

    a, out = np.arange(8, dtype=np.float32), np.zeros(10, np.float32)
    read(a, out)
    assert out.tolist() == [4, 5, 6, 7, 2, 1, 99, 1, 2, 3]


@pytest.mark.parametrize("dtype", [np.bool_, np.uint8, np.int16, np.uint32, np.int64, np.float32, np.float64])
def test_get_and_put_every_element_type(dtype):
    @compiled
    def copy(a, b):
        for i in range(a.size):
            put(b, i, get(ptr(a), i))

    largest = np.iinfo(dtype).max if np.issubdtype(dtype, np.integer) else 1
    a, b = np.array([0, largest, 1, 0, 1], dtype), np.zeros(5, dtype)
    copy(a, b)
    assert np.array_equal(a, b)


def test_put_converts_to_the_element_type():
    @compiled
    def write(a, b):
        put(a, 0, 7)
        put(a, 1, np.float64(0.1))
        put(b, 0, np.int64(2**32 + 5))

    a, b = np.zeros(2, np.float32), np.zeros(1, np.int32)
    write(a, b)
    assert a.tolist() == [7, np.float32(0.1)] and b[0] == 5


def test_the_same_bytes_as_float_and_as_integer():
    """A load through one type sees a store through the other, also if the compiler sees both."""

    @compiled
    def negate(a, out):
        words = as_i32(a)
        for i in range(4):
            a[i] = np.float32(i)
            put(words, i, get(words, i) | np.int32(-(2**31)))
            out[i] = a[i]
        store(as_f32(as_i32(ptr(out))), 4, load4(as_f32(words), 0))

    a, out = np.ones(4, np.float32), np.zeros(8, np.float32)
    negate(a, out)
    assert out.tolist() == [-0.0, -1, -2, -3] * 2 and np.signbit(out).all()


def test_overlapping_stores_happen_in_order():
    @compiled
    def smear(a):
        p, q = ptr(a), ptr_at(a, 1)
        for i in range(4):
            store(q, i, load4(p, i))

    a = np.arange(8, dtype=np.int32)
    expected = a.copy()
    for i in range(4):
        expected[i + 1 : i + 5] = expected[i : i + 4].copy()
    smear(a)
    assert np.array_equal(a, expected)


@pytest.mark.parametrize("lanes", [4, 8, 16])
@pytest.mark.parametrize("dtype", [np.float32, np.int32])
def test_gather_takes_each_lane_from_its_own_place(lanes, dtype):
    load = getattr(simd, f"load{lanes}")

    @compiled
    def take(a, indices, out):
        store(out, 0, gather(a, load(indices, 0)))
        store(out, lanes, gather(ptr_at(a, 50), load(indices, 0) - 50))

    values = np.random.default_rng(3).integers(-1000, 1000, 100).astype(dtype)
    indices = np.array([99, 0, 7, 7, 50, 49, 3, 98, 1, 2, 99, 0, 60, 61, 62, 63], np.int32)
    out = np.zeros(2 * lanes, dtype)
    take(values, indices, out)
    np.testing.assert_array_equal(out, np.tile(values[indices[:lanes]], 2))


SIZE = 24


def test_stack_memory_holds_what_is_put_there_and_is_aligned():
    @compiled
    def push_and_pop(values, out, addresses):
        floats, ints, longs, one = stack_f32(SIZE), stack_i32(SIZE), stack_i64(SIZE), stack_i32(1)
        put(one, 0, -1)
        for i in range(SIZE):
            put(floats, i, values[i])
            put(ints, i, i * 3)
            put(longs, i, np.int64(i) << 40)
        store(floats, 8, load8(floats, 0) + load8(floats, 16))
        for i in range(SIZE):
            out[0, i], out[1, i], out[2, i] = get(floats, i), get(ints, i), get(longs, i)
        addresses[0], addresses[1] = _address(floats), _address(ints)
        addresses[2], addresses[3] = _address(longs), _address(one)
        return get(one, 0)

    values = np.linspace(0, 1, SIZE).astype(np.float32)
    out, addresses = np.zeros((3, SIZE)), np.zeros(4, np.int64)
    assert push_and_pop(values, out, addresses) == -1
    expected = values.copy()
    expected[8:16] = values[:8] + values[16:]
    assert np.array_equal(out[0], expected)
    assert np.array_equal(out[1], np.arange(SIZE) * 3)
    assert np.array_equal(out[2], np.arange(SIZE) * 2.0**40)
    assert not np.any(addresses % 64) and len(set(addresses.tolist())) == 4


def test_each_call_of_a_kernel_has_stack_memory_of_its_own():
    @compiled
    def depth_first(n):
        mine = stack_i64(2)
        put(mine, 0, n)
        below = depth_first(n - 1) if n > 0 else np.int64(0)
        return below + get(mine, 0)

    assert depth_first(np.int64(50)) == 50 * 51 // 2


def test_stack_memory_in_a_loop_is_one_block():
    @compiled
    def addresses(out):
        for i in range(out.size):
            out[i] = _address(stack_f32(1024))

    out = np.zeros(10, np.int64)
    addresses(out)
    assert len(set(out.tolist())) == 1


def test_prefetch_does_nothing_to_values_even_outside_the_array():
    @compiled
    def fetch(a):
        prefetch(a, 2)
        prefetch(ptr(a), 1 << 40)
        prefetch(a, -(1 << 30))
        return a[0]

    assert fetch(np.array([5, 6, 7])) == 5


def test_atomic_add_returns_the_old_value():
    @compiled
    def add(a):
        return atomic_add(a, 1, 5), atomic_add(ptr(a), 1, np.int32(-7)), atomic_add(a, 1, 0)

    a = np.array([1, 10, 100])
    assert add(a) == (10, 15, 8)
    assert a.tolist() == [1, 8, 100]


def test_atomic_add_loses_nothing_between_threads():
    @compiled
    def count(counter, turns, seen):
        for _ in range(turns):
            old = atomic_add(counter, 0, 1)
            seen[old] += 1

    counter, seen = np.zeros(1, np.int64), np.zeros(200_000, np.int64)
    count(counter, 0, seen)  # compile
    threads = [threading.Thread(target=count, args=(counter, 50_000, seen)) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert counter[0] == 200_000 and np.all(seen == 1)


def test_atomic_or_and_and_return_the_old_value():
    @compiled
    def combine(a):
        return atomic_or(a, 1, 5), atomic_and(ptr(a), 1, np.int64(~1)), atomic_or(a, 1, 0), atomic_and(a, 2, 0)

    a = np.array([1, 8, -1], np.int32)
    assert combine(a) == (8, 13, 12, -1)
    assert a.tolist() == [1, 12, 0]


def test_atomic_or_and_and_lose_nothing_between_threads():
    """Each thread sets and clears its own bits in words that all threads share."""

    @compiled
    def work(up, down, bit):
        for i in range(up.size):
            atomic_or(up, i, np.int32(1) << bit)
            atomic_and(down, i, ~(np.int32(1) << bit))

    up, down = np.zeros(50_000, np.int32), np.full(50_000, -1, np.int32)
    work(up[:0], down, 0)  # compile
    threads = [threading.Thread(target=work, args=(up, down, bit)) for bit in (0, 7, 8, 30)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    mask = 1 | 1 << 7 | 1 << 8 | 1 << 30
    assert (up == mask).all() and (down == ~mask).all()


class Interval(NamedTuple):
    lower: F32x8
    upper: F32x8


def test_vectors_travel_in_tuples_between_kernels():
    @compiled
    def widen(interval, by):
        return Interval(interval.lower - by, interval.upper + by)

    @compiled
    def swap_where(mask, pair):
        return select(mask, pair[1], pair[0]), select(mask, pair[0], pair[1]), mask

    @compiled
    def compute(a, out):
        interval = widen(Interval(load8(a, 0), load8(a, 8)), splat8(np.float32(1)))
        lower, upper, mask = swap_where(interval.lower > interval.upper, (interval.lower, interval.upper))
        if simd.any_lane(mask):
            store(out, 0, lower)
            store(out, 8, upper)

    a, out = np.arange(16, dtype=np.float32)[::-1].copy(), np.zeros(16, np.float32)
    compute(a, out)
    assert np.array_equal(out[:8], a[8:] + 1) and np.array_equal(out[8:], a[:8] - 1)


def test_addresses_and_float64_scratch():
    @compiled
    def read_all(a, b, c, out):
        scratch = stack_f64(3)
        put(scratch, 0, get(f32_at(a), 1))
        put(scratch, 1, get(f64_at(b), 1))
        put(scratch, 2, get(i32_at(c), 1))
        for k in range(3):
            out[k] = get(scratch, k)

    a, b, c = np.float32([1, 0.1]), np.array([1, 0.1]), np.int32([1, -7])
    out = np.zeros(3)
    read_all(a.ctypes.data, b.ctypes.data, c.ctypes.data, out)
    np.testing.assert_array_equal(out, [np.float32(0.1), 0.1, -7])


@pytest.mark.parametrize("lanes", [8, 16])
@pytest.mark.parametrize("dtype", [np.int32, np.float32])
def test_store_compressed(lanes, dtype):
    load, mask_from_bits = (load8, mask_from_bits8) if lanes == 8 else (load16, mask_from_bits16)

    @compiled
    def compressed(masks, values, out):
        for k in range(len(masks)):
            store_compressed(out[k], 2, mask_from_bits(masks[k]), load(values, 0))

    masks = (
        np.arange(256)
        if lanes == 8
        else np.r_[0, 0xFFFF, 0xFF00, 0x00FF, np.random.default_rng(1).integers(0, 1 << 16, 500)]
    )
    values = np.linspace(-7, 9, lanes).astype(dtype)
    out = np.full((len(masks), lanes + 4), 99, dtype)
    compressed(masks, values, out)
    for mask, row in zip(masks, out):
        chosen = values[[lane for lane in range(lanes) if mask >> lane & 1]]
        np.testing.assert_array_equal(row[2 : 2 + len(chosen)], chosen)
        assert (row[:2] == 99).all() and (row[2 + lanes :] == 99).all()


def test_interleaved_vectors_and_wider_numbers():
    @compiled
    def columns(a, b, out):
        x = load16x3(a, 1)
        y = load16x3(b, 2)
        for k in range(3):
            store(out, 16 * k, x[k])
            store(out, 48 + 16 * k, to_f32(y[k] - to_f64(x[k])))

    a = np.arange(60, dtype=np.float32) / 3
    b = np.arange(60, dtype=np.float64) / 7
    out = np.full(96, np.nan, np.float32)
    columns(a, b, out)
    first, second = a[1:49].reshape(16, 3), b[2:50].reshape(16, 3)
    np.testing.assert_array_equal(out[:48].reshape(3, 16), first.T)
    np.testing.assert_array_equal(out[48:].reshape(3, 16), (second - first).astype(np.float32).T)


def test_vectors_of_two_runs():
    @compiled
    def columns(a, b, i, j, out):
        x, y = load8x3_pair(a, i, j), load8x3_pair(b, j, i)
        for k in range(3):
            store(out, 16 * k, x[k])
            store(out, 48 + 16 * k, to_f32(y[k]))

    a = np.arange(100, dtype=np.float32)
    for i, j in ((3, 70), (41, 65), (75, 1)):
        out = np.full(96, np.nan, np.float32)
        columns(a, a.astype(np.float64), i, j, out)
        first, second = a[i : i + 24].reshape(8, 3), a[j : j + 24].reshape(8, 3)
        np.testing.assert_array_equal(out[:48].reshape(3, 16), np.concatenate([first, second]).T)
        np.testing.assert_array_equal(out[48:].reshape(3, 16), np.concatenate([second, first]).T)
