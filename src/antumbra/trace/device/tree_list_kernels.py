"""Kernels for tree lists on a device: each segment of a screen tile is traced through the trees that its tile lists.

One thread takes a segment through the trees of a list, one after the other, until a triangle surely blocks it. As in
`trace.tree_list`, a table has the addresses of the trees, so they may come and go between launches. An undecided test
is listed with its tree's place in the lists. What float64 leaves undecided becomes a record (`device_kernels`) with the
triangle's corners, because the CPU may not have the tree.

- `trace_listed`, `settle_listed`: as `trace_samples` and `settle_samples`
- `pack_listed`: the bits of a launch's answers, which also join those that are known
"""

from typing import NamedTuple

import numpy as np

from ...kernels.device import atomic_add, i64_at, thread_index
from ...kernels.exact.filters import MISS, UNSURE
from ...kernels.jit import inlined, kernel, overload
from ...kernels.simd import f32_at, get, i32_at, put, stack_f32
from ...kernels.toolchain.device_code import DeviceKernel
from .device_kernels import SAMPLES, WORK, add_kernels, copy_corners, put_record, record_rays, side_of_hit
from .device_rays import (
    AGAIN,
    BLOCKED,
    CLEAR,
    TRACED,
    TileSegments,
    place_in_tiles,
    ray_at,
    tile_receiver,
    words_per_receiver,
)
from .device_traversal import PAIRS, REST, TreeBuffers, Work, list_pair, walk

TREE_WORDS = 6
"""int64 of a tree in a table: addresses of its nodes and triangles, the three float32 of its reach, numbers of both."""

TEST = 3  # int32 of an undecided test: segment, slot, place of its tree in the lists
CORNERS = 9  # float32 of a record's triangle


class TreeListBuffers(NamedTuple):
    """Trees, and the lists of them for tiles: addresses on the device, and numbers."""

    trees: int  # int64, TREE_WORDS per tree
    starts: int  # int32: where in `items` the list of each tile and set begins, and the end
    items: int  # int32: trees
    sets: int  # lists per tile: 1, or one for each sample of the segments
    blockers: int  # int32 per item: set to 1 if its tree blocks a segment, or is left to the CPU
    corners: int  # float32, CORNERS per record


class ListedWork(NamedTuple):
    """The `Work` of a walk through a listed tree."""

    work: Work
    item: int  # place of the tree in the lists
    cull_faces: int


class _UndecidedTest(NamedTuple):
    """An undecided test."""

    j: int  # the segment, counted from `Work.first`
    slot: int  # -1: the receiver's own surface
    item: int


@inlined
def _add_test(work, test):
    """Add an undecided test to the list. Return whether there was room."""
    at = np.int64(atomic_add(i32_at(work.counts), PAIRS, 1))
    if at >= work.capacity:
        return False
    tests = i32_at(work.pairs)
    put(tests, TEST * at, test.j)
    put(tests, TEST * at + 1, test.slot)
    put(tests, TEST * at + 2, test.item)
    return True


@overload(list_pair)
def _list_test(work, j, slot):
    if work.instance_class is ListedWork:
        return lambda work, j, slot: _add_test(work.work, _UndecidedTest(j, slot, work.item))
    return None


@inlined
def tree_at(lists, item):
    """The `TreeBuffers` of the tree at a place of the lists."""
    at = TREE_WORDS * np.int64(get(i32_at(lists.items), item))
    words, reach = i64_at(lists.trees), f32_at(lists.trees)
    x, y, z = get(reach, 2 * at + 4), get(reach, 2 * at + 5), get(reach, 2 * at + 6)
    return TreeBuffers(get(words, at), get(words, at + 1), (x, y, z))


@inlined
def _list_of(lists, segments, k):
    """(begin, end) in the items of the list of segment k."""
    place = place_in_tiles(segments, k)
    tile = np.int64(get(i32_at(segments.tiles), place.at))
    number = tile * lists.sets + (place.sample if lists.sets > 1 else np.int64(0))
    return np.int64(get(i32_at(lists.starts), number)), np.int64(get(i32_at(lists.starts), number + 1))


@inlined
def _walk_list(lists, r, j, span, work):
    """The state of a segment after the trees from span[0] to span[1] of the lists."""
    item, answer = span[0], np.int64(CLEAR)
    while item < span[1] and answer == CLEAR:
        answer = walk(tree_at(lists, item), r, j, True, ListedWork(work, item, work.cull_faces))
        if answer == BLOCKED:
            put(i32_at(lists.blockers), item, 1)
        item += 1
    return answer


@kernel
def trace_listed(lists, segments, work):  # lists: TreeListBuffers, segments: TileSegments, work: Work
    """Trace segments through the trees of their lists: write the state of each."""
    k = thread_index()
    if k >= work.n:
        return
    j = k if work.which == 0 else np.int64(get(i32_at(work.which), k))
    r = ray_at(segments, work.first + j)
    answer = np.int64(r.state)
    if r.horizon and not _add_test(work, _UndecidedTest(j, -1, -1)):
        answer = np.int64(AGAIN)
    if answer == TRACED:
        answer = _walk_list(lists, r, j, _list_of(lists, segments, work.first + j), work)
    put(i32_at(work.out), j, answer)


@inlined
def _leave(lists, work, test, ray, corners):
    """Leave a test to the CPU: a record, if there is room, whose slot is its own place; -1 as in the test."""
    at = np.int64(atomic_add(i32_at(work.counts), REST, 1))
    if at >= work.rest_capacity:
        return
    put_record(work, at, test.j, at if test.slot >= 0 else np.int64(-1), test.item, ray)
    if test.slot >= 0:
        put(i32_at(lists.blockers), test.item, 1)
        for i in range(CORNERS):
            put(f32_at(lists.corners), CORNERS * at + i, get(corners, i))


@inlined
def _settle(lists, segments, work, test):
    out, corners = i32_at(work.out), stack_f32(CORNERS)
    if get(out, test.j) == BLOCKED:
        return
    r = ray_at(segments, work.first + test.j)
    if test.slot < 0:
        _leave(lists, work, test, r.ray, corners)
        return
    copy_corners(tree_at(lists, test.item), test.slot, corners)
    side = side_of_hit(r.ray, corners, work.cull_faces)
    if side == UNSURE:
        _leave(lists, work, test, r.ray, corners)
    elif side != MISS:
        put(out, test.j, BLOCKED)
        put(i32_at(lists.blockers), test.item, 1)


@kernel
def settle_listed(lists, segments, work, first, n):  # lists: TreeListBuffers, segments: TileSegments, work: Work
    """Decide n listed tests from the `first` on: mark segments that are surely blocked; records for undecided ones."""
    k, tests = thread_index(), i32_at(work.pairs)
    if k < n:
        at = TEST * (first + k)
        slot, item = np.int64(get(tests, at + 1)), np.int64(get(tests, at + 2))
        _settle(lists, segments, work, _UndecidedTest(np.int64(get(tests, at)), slot, item))


@kernel
def pack_listed(segments, work, words, n):  # segments: TileSegments, work: Work, words: address of int32
    """Write n words of bits, those of the launch's receivers: which of their segments it has found to be blocked.

    Known bits are set as well (`TileSegments.blocked`), so that the next launches omit these segments.
    """
    k, per_receiver = thread_index(), words_per_receiver(segments)
    if k >= n:
        return
    at, i = k // per_receiver, k % per_receiver
    word, states = np.int32(0), i32_at(work.out)
    for bit in range(32):
        s = 32 * i + bit
        if s < segments.count and get(states, at * segments.count + s) == BLOCKED:
            word |= np.int32(1) << np.int32(bit)
    put(i32_at(words), k, word)
    receiver = tile_receiver(segments, place_in_tiles(segments, work.first + at * segments.count))
    if receiver >= 0 and word != 0:
        known = receiver * per_receiver + i
        put(i32_at(segments.blocked), known, get(i32_at(segments.blocked), known) | word)


_SEGMENTS = TileSegments(SAMPLES, 0, 0, 0, 0, 0, 0, 0, 0, 0)
_LISTS = TreeListBuffers(0, 0, 0, 0, 0, 0)

TREE_LIST_KERNELS = {
    "trace_listed": DeviceKernel(trace_listed, (_LISTS, _SEGMENTS, WORK)),
    "settle_listed": DeviceKernel(settle_listed, (_LISTS, _SEGMENTS, WORK, 0, 0)),
    "record_listed": DeviceKernel(record_rays, (_SEGMENTS, WORK, 0, 0)),
    "pack_listed": DeviceKernel(pack_listed, (_SEGMENTS, WORK, 0, 0)),
}

add_kernels(TREE_LIST_KERNELS)
