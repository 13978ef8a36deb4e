"""A block of triangles that rays, shafts or beams are tested against, how it is fetched, and the test of one ray."""

from typing import NamedTuple

import numpy as np

from ..bvh.blocks import ROWS
from ..kernels.jit import inlined
from ..kernels.simd import get, prefetch, ptr_at
from .counters import TRIANGLE_TESTS, count
from .deferred import defer_triangles
from .raytest import ray_meets


class Block(NamedTuple):
    """A block, and all that it takes to test it against a tile's segments."""

    tree: object  # BlockPointers
    number: int
    present: int  # bits of its triangles
    valid: int  # bits of the tile's receivers
    facing: int  # a value of CULL_FACES
    work: object  # float32 scratch memory
    deferred: object  # see `deferred`


@inlined
def fetch(tree, link):
    """Ask for the node or the block behind a link; in large scenes, waiting for memory is what takes longest."""
    if link >= 0:
        prefetch(tree.nodes, link * 16)
        return
    block = ~link >> 5
    for row in range(ROWS):
        prefetch(tree.blocks, (block * ROWS + row) * 16)
    prefetch(tree.slots, block * 16)


@inlined
def numbers_of(b):
    return ptr_at(b.tree.blocks, b.number * (ROWS * 16))


@inlined
def slot_of(b, i):
    """Triangle i's place in the BVH's arrays."""
    return np.int64(get(b.tree.slots, b.number * 16 + i))


@inlined
def blocks_ray(b, o, d, own, place, counters):
    """Does a triangle of a block surely block the ray from o along d, each in all lanes?

    If not, what float32 cannot say is deferred for the ray's `place`, but for its receiver's `own` triangle.
    """
    count(counters, TRIANGLE_TESTS, 1)
    hit, unsure = ray_meets(o, d, numbers_of(b), b.facing, None)
    if hit & b.present != 0:
        return True
    if unsure & b.present != 0:
        defer_triangles(b.deferred, b.tree, b.number, own, place, unsure & b.present)
    return False
