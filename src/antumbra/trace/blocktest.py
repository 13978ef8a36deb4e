"""A block of triangles: the block as tests see it, its prefetch, and the test of one ray against it."""

from typing import NamedTuple

import numpy as np

from ..bvh.blocks import BlockPointers
from ..bvh.links import ROWS, block_leaf, line_at, row_at, rows_at, slot_at, slots_at
from ..kernels.fields import F32Ptr, I32Ptr
from ..kernels.jit import inlined
from ..kernels.simd import get, prefetch, ptr_at
from .counters import TRIANGLE_TESTS, count
from .deferred import defer_triangles
from .raytest import ray_meets


class Block(NamedTuple):
    """A block, and everything else that its tests against a tile's segments need."""

    tree: BlockPointers
    number: int
    present: int  # bits of its triangles
    valid: int  # bits of the tile's receivers
    facing: int  # a value of CULL_FACES
    work: F32Ptr | None  # float32 scratch memory; None: no test needs it
    deferred: I32Ptr  # int32, see `deferred`


@inlined
def fetch(tree, link):
    """Prefetch the node or the block behind a link. In large scenes, waiting for memory takes longest."""
    if link >= 0:
        prefetch(tree.nodes, line_at(link))
        return
    block = block_leaf(link).block
    for row in range(ROWS):
        prefetch(tree.blocks, row_at(block, row))
    prefetch(tree.slots, slots_at(block))


@inlined
def numbers_of(b):
    return ptr_at(b.tree.blocks, rows_at(b.number))


@inlined
def slot_of(b, i):
    """The slot of triangle i: its place in the BVH's arrays."""
    return np.int64(get(b.tree.slots, slot_at(b.number, i)))


@inlined
def blocks_ray(b, o, d, own, place, counters):
    """Does a triangle of a block surely block the ray from o along d, given in all lanes?

    If not, tests that float32 cannot decide are deferred for the ray's `place`, except the receiver's `own` triangle.
    """
    count(counters, TRIANGLE_TESTS, 1)
    hit, unsure = ray_meets(o, d, numbers_of(b), b.facing, None)
    if hit & b.present != 0:
        return True
    if unsure & b.present != 0:
        defer_triangles(b.deferred, b.tree, b.number, own, place, unsure & b.present)
    return False
