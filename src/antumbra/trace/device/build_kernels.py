"""The kernels that build an LBVH on a device, the tree of `bvh.lbvh` with 30-bit codes, and refit it.

Each step is a launch, or a few, in which no thread waits for another: there are no barriers, and no atomic operations.

1. Morton codes: `bound_strips`, `join_strips` and `make_grid` bound the centroids; `write_codes` is the CPU's formula.
   `survey_strips` bounds new triangles in the same way.
2. Radix sort: `count_digits`, prefix sums (`sum_rows`, `scan_rows`), and `scatter_keys`, for each digit. A thread moves
   PART keys in order, so the sort is stable.
3. Nodes: `split_nodes` finds the range of each node of the radix tree on its own [Karras 2012, Sec. 4]. A node's left
   child, that one's left child, and so on form a *spine*. In depth-first order they follow each other, and the spines
   are in the order of their first slots. So prefix sums of the spines' lengths (`count_spines`) number all nodes, and
   `write_nodes` links them.
4. Boxes: a *pyramid* holds the boxes of 8, 16, 32, ... slots (`bound_slots`, `join_pairs`). A node covers a range of
   slots, whose box is joined from entries of the pyramid (`bound_nodes`). A refit is this step alone.
5. Cost: `sum_areas` and `join_areas` add what `tree_quality.sah_cost` does, in its order.
"""

from typing import NamedTuple

import numpy as np

from ...bvh.lbvh import split_position
from ...bvh.morton_sort import code_of_triangle
from ...bvh.nodes import bvh_link, link_at
from ...bvh.tree_quality import AREA_ROW, AREA_ROWS, areas_between
from ...bvh.triangle_bounds import INF, MAX_COORDINATE, corners_of, double_centroid, write_boxes
from ...kernels.device import load4_aligned, thread_index
from ...kernels.exact.filters import max_magnitude, plane
from ...kernels.jit import inlined, kernel
from ...kernels.simd import (
    f32_at,
    f64_at,
    get,
    highest_bit,
    i32_at,
    join,
    load4,
    load8,
    maximum,
    minimum,
    put,
    splat8,
    stack_i32,
    store,
)
from ...kernels.toolchain.device_code import DeviceKernel
from .device_traversal import PRIM, TRIANGLE, TreeBuffers

BITS = 10  # of a code, per axis
DIGIT = 4  # bits of a digit: the counters of a thread take 64 bytes
PART = 32  # keys of a thread
ROW = 64  # numbers that a thread adds
SLOTS = 8  # slots of the lowest boxes of a pyramid
RANGE = 3  # words of a node's range: its first slot, the first one of its right child, and its end
FAULT = 0  # word of a summary: whether a triangle is faulty; the next one is its index

_DIGITS = 1 << DIGIT
_LAST = np.int32((1 << BITS) - 1)
_CELLS = np.float64(1 << BITS)
_ZERO = np.float32(0.0)


class Source(NamedTuple):
    """The triangles of a tree: addresses on the device, and their number."""

    vertices: int  # float32, 9 for each triangle of the scene
    faces: int  # int32: the triangles of the tree, ascending; 0: all
    n: int  # triangles of the tree


@inlined
def face_of(source, i):
    """The index in the scene of triangle i of a `Source`."""
    return i if source.faces == 0 else np.int64(get(i32_at(source.faces), i))


# --- 1. Morton codes --------------------------------------------------------------------------------------------------


@inlined
def box_of(a, b, c):
    """The box of three corners; unused lanes hold any number."""
    return join(minimum(minimum(a, b), c), -maximum(maximum(a, b), c))


@inlined
def _is_valid(x):
    return abs(x) < MAX_COORDINATE  # not of NaN


@kernel
def bound_strips(source, strips, n, summary):  # source: Source, summary: address of int32
    """Write the centroid boxes, 8 float32 each, of n strips: every n-th triangle. Note triangles that no tree takes."""
    k = thread_index()
    if k >= n:
        return
    vertices, box, i = f32_at(source.vertices), splat8(INF), k
    while i < source.n:
        face, valid = face_of(source, i), True
        a, b, c = corners_of(vertices, face)
        box = minimum(box, double_centroid(box_of(a, b, c)))
        for word in range(9):
            valid = valid and _is_valid(get(vertices, 9 * face + word))
        if not valid:
            put(i32_at(summary), FAULT, 1)
            put(i32_at(summary), FAULT + 1, face)
        i += n
    store(f32_at(strips), 8 * k, box)


@kernel
def survey_strips(
    source, strips, n, tags
):  # source: Source of all triangles, strips: address of float32, tags: of int32
    """Write the boxes of n strips, as `bound_strips`; tag the triangles that may lack an area, and none after them."""
    k = thread_index()
    if k >= n:
        return
    zero = np.float64(0.0)
    vertices, box, i = f32_at(source.vertices), splat8(INF), k
    while i < source.n:
        a, b, c = corners_of(vertices, i)
        box = minimum(box, box_of(a, b, c))
        _, normal, error = plane(vertices, i, zero, zero, zero)
        put(i32_at(tags), i, np.int32(not max_magnitude(normal) > error))
        i += n
    store(f32_at(strips), 8 * k, box)
    if k == 0:
        put(i32_at(tags), source.n, 0)


@inlined
def _joined(boxes, first, end, step):
    box, i = splat8(INF), first
    while i < end:
        box = minimum(box, load8(boxes, 8 * i))
        i += step
    return box


@kernel
def join_strips(strips, n, out, m):  # strips: address of float32, out: number
    """Join n boxes to m: every m-th."""
    k = thread_index()
    if k < m:
        store(f32_at(out), 8 * k, _joined(f32_at(strips), k, n, m))


@kernel
def make_grid(strips, n, grid):  # strips, grid: addresses of float32
    """One thread: write the `morton_sort.Grid` over n boxes as four float32 of its origin, and its factor."""
    if thread_index() != 0:
        return
    box, out, side = _joined(f32_at(strips), 0, n, 1), f32_at(grid), _ZERO
    store(out, 0, box)
    for axis in range(3):
        side = max(side, -get(out, axis) - get(out, 4 + axis))
    # rounded twice, float64 gives the quotient of float32: some drivers of OpenCL round that one coarsely
    factor = np.float32(_CELLS / np.float64(side)) if side > _ZERO else INF
    put(out, 4, factor if factor < INF else _ZERO)


@kernel
def write_codes(source, grid, codes, faces):  # source: Source, grid: address of float32; codes, faces: of int32
    """Write the code of each triangle, and its index in the scene."""
    i, numbers = thread_index(), f32_at(grid)
    if i < source.n:
        face = face_of(source, i)
        code = code_of_triangle(f32_at(source.vertices), face, load4(numbers, 0), get(numbers, 4), _LAST)
        put(i32_at(codes), i, code)
        put(i32_at(faces), i, face)


# --- 2. Radix sort ----------------------------------------------------------------------------------------------------


class Keys(NamedTuple):
    """Keys and values, in parts of PART: addresses of int32, and numbers."""

    keys: int
    values: int
    n: int
    parts: int


@inlined
def _digit(key, shift):
    return (np.int64(key) >> shift) & (_DIGITS - 1)


@kernel
def count_digits(source, shift, counts):  # source: Keys, shift: first bit of the digit, counts: address of int32
    """Count each digit in each part: int32, digit by digit."""
    part = thread_index()
    if part >= source.parts:
        return
    count, out = stack_i32(_DIGITS), i32_at(counts)
    for d in range(_DIGITS):
        put(count, d, 0)
    for i in range(part * PART, min((part + 1) * PART, source.n)):
        d = _digit(get(i32_at(source.keys), i), shift)
        put(count, d, get(count, d) + 1)
    for d in range(_DIGITS):
        put(out, d * source.parts + part, get(count, d))


@kernel
def sum_rows(numbers, n, sums, m):  # numbers: address of int32, sums: number
    """Add ROW int32 of n at a time, to m sums."""
    k, total = thread_index(), np.int64(0)
    if k < m:
        for i in range(k * ROW, min((k + 1) * ROW, n)):
            total += get(i32_at(numbers), i)
        put(i32_at(sums), k, total)


@kernel
def scan_rows(numbers, n, row, starts, m):  # numbers: address of int32, m: number of rows
    """Replace each of n int32 by the sum of those before it in its row, plus the row's start; starts 0: one row."""
    k = thread_index()
    if k < m:
        total = np.int64(0) if starts == 0 else np.int64(get(i32_at(starts), k))
        for i in range(k * row, min((k + 1) * row, n)):
            number = get(i32_at(numbers), i)
            put(i32_at(numbers), i, total)
            total += number


@kernel
def scatter_keys(source, shift, places, keys, values):  # source: Keys, shift: first bit of the digit
    """Move keys and values to the places of their digits, the prefix sums of the counts."""
    part = thread_index()
    if part >= source.parts:
        return
    place = stack_i32(_DIGITS)
    for d in range(_DIGITS):
        put(place, d, get(i32_at(places), d * source.parts + part))
    for i in range(part * PART, min((part + 1) * PART, source.n)):
        key = get(i32_at(source.keys), i)
        d = _digit(key, shift)
        at = np.int64(get(place, d))
        put(place, d, at + 1)
        put(i32_at(keys), at, key)
        put(i32_at(values), at, get(i32_at(source.values), i))


@kernel
def keep_tagged(source, places, faces):  # source: Source, places and faces: addresses of int32
    """Write the indices of the tagged triangles, whose `places` are the prefix sums of all tags."""
    i, at = thread_index(), i32_at(places)
    if i < source.n and get(at, i + 1) > get(at, i):
        put(i32_at(faces), get(at, i), face_of(source, i))


# --- 3. Nodes ---------------------------------------------------------------------------------------------------------


class Spines(NamedTuple):
    """The radix tree of n codes: addresses of int32, and numbers."""

    splits: int  # of node i: the first slot of its right child
    ends: int  # of the spine that begins at slot i: the end of its range; 0: none begins there
    counts: int  # of each spine: its nodes of more than `max_leaf` triangles; n + 1 numbers, the last one 0
    n: int
    max_leaf: int


@inlined
def height(codes, i, k, n):
    """The bit at which slots `i` and `k` separate, positions being the lower bits; 64 if slot `k` is none."""
    if k < 0 or k >= n:
        return np.int64(64)
    differing = np.int64(get(codes, i) ^ get(codes, k))
    return highest_bit(differing) + 32 if differing != 0 else highest_bit(i ^ k)


@inlined
def other_end(codes, i, step, n):
    """The last slot of node i's range from slot i on, by steps of 1 or -1."""
    outside = height(codes, i, i - step, n)
    reach = np.int64(2)
    while height(codes, i, i + reach * step, n) < outside:
        reach *= 2
    length, reach = np.int64(0), reach >> 1
    while reach > 0:
        if height(codes, i, i + (length + reach) * step, n) < outside:
            length += reach
        reach >>= 1
    return i + length * step


@kernel
def split_nodes(codes, spines):  # codes: address of int32, spines: Spines
    """Write the split of each node of the radix tree, and the ends of spines [Karras 2012, Fig. 4].

    Node i has slot i at one end of its range: its first one if the node begins a spine, otherwise its last one.
    """
    i, keys, n = thread_index(), i32_at(codes), spines.n
    if i >= n:
        return
    end = np.int64(0)
    if i < n - 1:
        step = np.int64(1 if height(keys, i, i + 1, n) < height(keys, i, i - 1, n) else -1)
        other = other_end(keys, i, step, n)
        put(i32_at(spines.splits), i, split_position(keys, min(i, other), max(i, other) + 1, 0))
        end = other + 1 if step > 0 else end
    put(i32_at(spines.ends), i, end)


@kernel
def count_spines(spines):  # spines: Spines
    """Count the nodes of each spine."""
    i, count = thread_index(), np.int64(0)
    if i > spines.n:
        return
    end = np.int64(get(i32_at(spines.ends), i)) if i < spines.n else i
    node = i
    while end - i > spines.max_leaf:
        end = np.int64(get(i32_at(spines.splits), node))
        node = end - 1
        count += 1
    put(i32_at(spines.counts), i, count)


@inlined
def _link(first, end, number, max_leaf):
    return number if end - first > max_leaf else bvh_link(first, end - first)


@kernel
def write_nodes(spines, nodes, ranges):  # spines: Spines, with prefix sums as counts; nodes: address of float32
    """Write the links and ranges of the nodes of each spine. Spines are numbered in the order of their slots."""
    i = thread_index()
    if i >= spines.n:
        return
    links, out, numbers = i32_at(nodes), i32_at(ranges), i32_at(spines.counts)
    number, end, node = np.int64(get(numbers, i)), np.int64(get(i32_at(spines.ends), i)), i
    while end - i > spines.max_leaf:
        middle = np.int64(get(i32_at(spines.splits), node))
        put(links, link_at(number, 0), _link(i, middle, number + 1, spines.max_leaf))
        put(links, link_at(number, 1), _link(middle, end, np.int64(get(numbers, middle)), spines.max_leaf))
        put(out, RANGE * number, i)
        put(out, RANGE * number + 1, middle)
        put(out, RANGE * number + 2, end)
        number, end, node = number + 1, middle, middle - 1


# --- 4. Triangles and boxes -------------------------------------------------------------------------------------------


@kernel
def write_triangles(tree, faces, step, vertices, n):  # tree: TreeBuffers, vertices: address of float32
    """Write the triangles of n slots, whose indices in the scene are every `step`-th int32 at `faces`."""
    slot, words = thread_index(), i32_at(tree.triangles)
    if slot >= n:
        return
    face, at = get(i32_at(faces), step * slot), TRIANGLE * slot
    put(words, at + PRIM, face)
    put(words, at + 7, 0)
    put(words, at + 11, 0)
    for k in range(3):
        for axis in range(3):
            put(f32_at(tree.triangles), at + 4 * k + axis, get(f32_at(vertices), 9 * np.int64(face) + 3 * k + axis))


class Pyramid(NamedTuple):
    """Boxes of ranges of slots: an address, and a number."""

    boxes: int  # float32, 8 per box: box k joins boxes 2 k and 2 k + 1; from `lowest` on, they are of SLOTS slots each
    lowest: int


@inlined
def _box_of_slots(triangles, first, end):
    words, box = f32_at(triangles), splat8(INF)
    for slot in range(first, end):
        at = TRIANGLE * slot
        a, b, c = (load4_aligned(words, at), load4_aligned(words, at + 4), load4_aligned(words, at + 8))
        box = minimum(box, box_of(a, b, c))
    return box


@kernel
def bound_slots(tree, n, pyramid):  # tree: TreeBuffers, n: number of slots, pyramid: Pyramid
    """Write the lowest boxes of a pyramid."""
    k = thread_index()
    if k < pyramid.lowest:
        box = _box_of_slots(tree.triangles, k * SLOTS, min((k + 1) * SLOTS, n))
        store(f32_at(pyramid.boxes), 8 * (pyramid.lowest + k), box)


@kernel
def join_pairs(pyramid, first, end):  # pyramid: Pyramid
    """Write the boxes from `first` to `end` - 1 of a pyramid, whose pairs are there."""
    k, boxes = first + thread_index(), f32_at(pyramid.boxes)
    if k < end:
        store(boxes, 8 * k, minimum(load8(boxes, 16 * k), load8(boxes, 16 * k + 8)))


@inlined
def _box_of_range(tree, pyramid, first, end):
    """The box of the slots from `first` to `end` - 1."""
    low, high = (first + SLOTS - 1) // SLOTS, end // SLOTS
    if low >= high:
        return _box_of_slots(tree.triangles, first, end)
    head, tail = _box_of_slots(tree.triangles, first, low * SLOTS), _box_of_slots(tree.triangles, high * SLOTS, end)
    box, boxes = minimum(head, tail), f32_at(pyramid.boxes)
    low, high = low + pyramid.lowest, high + pyramid.lowest
    while low < high:
        if low & 1:
            box = minimum(box, load8(boxes, 8 * low))
            low += 1
        if high & 1:
            high -= 1
            box = minimum(box, load8(boxes, 8 * high))
        low, high = low >> 1, high >> 1
    return box


@kernel
def bound_nodes(tree, nodes, ranges, pyramid, n):  # tree: TreeBuffers, ranges: address of int32, pyramid: Pyramid
    """Write n nodes: the boxes of both children, and the links of `nodes`, which may be those of the tree."""
    node = thread_index()
    if node >= n:
        return
    words, links = i32_at(ranges), i32_at(tree.nodes)
    middle, end = np.int64(get(words, RANGE * node + 1)), np.int64(get(words, RANGE * node + 2))
    left, right = get(i32_at(nodes), link_at(node, 0)), get(i32_at(nodes), link_at(node, 1))
    left_box = _box_of_range(tree, pyramid, np.int64(get(words, RANGE * node)), middle)
    write_boxes(f32_at(tree.nodes), node, left_box, _box_of_range(tree, pyramid, middle, end))
    put(links, link_at(node, 0), left)
    put(links, link_at(node, 1), right)


# --- 5. Cost ----------------------------------------------------------------------------------------------------------


@kernel
def sum_areas(tree, n, sums):  # tree: TreeBuffers, n: number of nodes, sums: address of float64
    """Write the two sums of `areas_between` of each row of nodes."""
    k = thread_index()
    first = k * AREA_ROW
    if first < n:
        last = min(first + AREA_ROW, n)
        of_nodes, of_leaves = areas_between(f32_at(tree.nodes), i32_at(tree.nodes), first, last)
        put(f64_at(sums), 2 * k, of_nodes)
        put(f64_at(sums), 2 * k + 1, of_leaves)


@kernel
def join_areas(sums, n, out, m):  # sums, out: addresses of float64
    """Add the sums of AREA_ROWS of n rows at a time, to m."""
    k = thread_index()
    if k < m:
        of_nodes, of_leaves = 0.0, 0.0
        for i in range(k * AREA_ROWS, min((k + 1) * AREA_ROWS, n)):
            of_nodes += get(f64_at(sums), 2 * i)
            of_leaves += get(f64_at(sums), 2 * i + 1)
        put(f64_at(out), 2 * k, of_nodes)
        put(f64_at(out), 2 * k + 1, of_leaves)


# --- The list ---------------------------------------------------------------------------------------------------------


_ONE = np.float32(1.0)
_SOURCE, _KEYS, _SPINES, _PYRAMID = Source(0, 0, 0), Keys(0, 0, 0, 0), Spines(0, 0, 0, 0, 0), Pyramid(0, 0)
_TREE = TreeBuffers(0, 0, (_ONE, _ONE, _ONE))

BUILD_KERNELS = {
    "bound_strips": DeviceKernel(bound_strips, (_SOURCE, 0, 0, 0)),
    "survey_strips": DeviceKernel(survey_strips, (_SOURCE, 0, 0, 0)),
    "join_strips": DeviceKernel(join_strips, (0, 0, 0, 0)),
    "make_grid": DeviceKernel(make_grid, (0, 0, 0)),
    "write_codes": DeviceKernel(write_codes, (_SOURCE, 0, 0, 0)),
    "count_digits": DeviceKernel(count_digits, (_KEYS, 0, 0)),
    "sum_rows": DeviceKernel(sum_rows, (0, 0, 0, 0)),
    "scan_rows": DeviceKernel(scan_rows, (0, 0, 0, 0, 0)),
    "scatter_keys": DeviceKernel(scatter_keys, (_KEYS, 0, 0, 0, 0)),
    "keep_tagged": DeviceKernel(keep_tagged, (_SOURCE, 0, 0)),
    "split_nodes": DeviceKernel(split_nodes, (0, _SPINES)),
    "count_spines": DeviceKernel(count_spines, (_SPINES,)),
    "write_nodes": DeviceKernel(write_nodes, (_SPINES, 0, 0)),
    "write_triangles": DeviceKernel(write_triangles, (_TREE, 0, 0, 0, 0)),
    "bound_slots": DeviceKernel(bound_slots, (_TREE, 0, _PYRAMID)),
    "join_pairs": DeviceKernel(join_pairs, (_PYRAMID, 0, 0)),
    "bound_nodes": DeviceKernel(bound_nodes, (_TREE, 0, 0, _PYRAMID, 0)),
    "sum_areas": DeviceKernel(sum_areas, (_TREE, 0, 0)),
    "join_areas": DeviceKernel(join_areas, (0, 0, 0, 0)),
}
"""Name -> kernel."""
