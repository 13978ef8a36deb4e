"""A bundle, up to 16 tiles whose shafts go through the tree together, and a thread's scratch memory for it."""

from typing import NamedTuple

import numpy as np

from ...bvh.nodes import MAX_DEPTH
from ...kernels.fields import F32Ptr, I32Ptr
from ...kernels.jit import inlined, kernel
from ...kernels.simd import get, load16, lowest_bit, put
from ..deferred import deferred_ints
from ..forest import TREE
from ..lighttable import ALL_GROUPS, STRATA
from ..slabs import Shafts
from ..tile import TILE_FLOATS, finished_strata, tile_at
from .region import MAX_TILES
from .tilegroup import tile_group_at

TILES = (MAX_TILES + 1) * TILE_FLOATS  # the last one is the whole of a tile group
LANES = 12 * 16
STACK = 4 * MAX_DEPTH
PLACES = 2 * MAX_TILES
WAITING = TREE + 1  # a leaf, and its lanes
BLOCKERS = WAITING + 2  # the number of a tree, and blocks that blocked all segments of a lane, the last one first
N_BLOCKERS = 4
AT = BLOCKERS + 1 + N_BLOCKERS
DEFERRED_INTS = deferred_ints(MAX_TILES)


class Bundle(NamedTuple):
    """How the 16 lanes of a bundle share its tiles and strata."""

    tiles: int  # 1 to 16, a power of two; a tile group counts as one tile
    groups: int  # groups of strata of each tile: lanes are slot * groups + group
    strata: int  # strata in a group
    is_tile_group: bool


class Scratch(NamedTuple):
    """A thread's memory."""

    tiles: F32Ptr  # float32: the parts of a cluster
    lanes: F32Ptr  # float32, rows of `Shafts`
    work: F32Ptr  # float32, for `shaftleaf`
    tile_group: F32Ptr  # float32, see `tilegroup`
    stack: I32Ptr  # int32: links and masks
    slots: I32Ptr  # int32: the bundle's tiles
    valid: I32Ptr  # int32: bits of each tile's receivers
    parts: I32Ptr  # int32, see `clusters`
    places: I32Ptr  # int32: y and x of each tile's first pixel
    planes: F32Ptr  # float32, for `horizon`
    at: I32Ptr  # int32: a walk as `descent.save` writes it; at TREE, WAITING and BLOCKERS what these describe
    deferred: I32Ptr  # int32, see `deferred`
    trials: F32Ptr  # float32, see `grouping`


@inlined
def _power_of_two(n):
    """The least power of two that is at least n."""
    power = np.int64(1)
    while power < n:
        power *= 2
    return power


@inlined
def tiles_to_fill(count):
    """The number of tiles that fill the lanes if each has `count` samples."""
    return STRATA // _power_of_two(count)


@inlined
def bundle_of(tiles, count):
    """The `Bundle` of a number of tiles with `count` samples each."""
    size, strata = _power_of_two(tiles), _power_of_two(count)
    groups = STRATA // size if STRATA // size < strata else strata
    return Bundle(size, groups, strata // groups, False)


@inlined
def tile_group_of(scratch, chunk):
    """The `TileGroup` of a bundle. Its first tile is in the first slot."""
    whole = tile_at(scratch.tiles, MAX_TILES, chunk)
    return tile_group_at(scratch.tile_group, scratch.tiles, scratch.valid, whole, np.int64(get(scratch.slots, 0)))


@inlined
def lane_strata(lanes, bundle):
    """Bits of the strata in some groups of a tile (bits)."""
    if bundle.strata == 1:
        return lanes
    ones, strata = (np.int64(1) << bundle.strata) - 1, np.int64(0)
    while lanes != 0:
        strata |= ones << (lowest_bit(lanes) * bundle.strata)
        lanes &= lanes - 1
    return strata


@inlined
def finished_groups(tile, valid, bundle):
    """Bits of the groups to which no segment from the `valid` receivers (bits) is left."""
    strata, ones, groups = finished_strata(tile, valid), (np.int64(1) << bundle.strata) - 1, np.int64(0)
    for q in range(bundle.groups):
        if (strata >> (q * bundle.strata)) & ones == ones:
            groups |= np.int64(1) << q
    return groups


@kernel
def fill_lanes(slot, tile, bundle, lanes):
    """Write the shafts of a tile's groups to the lanes of a slot."""
    first_group = 16 // bundle.strata
    for q in range(bundle.groups):
        lane, group = slot * bundle.groups + q, first_group + q
        for k in range(3):
            low, high = get(tile.info, 6 + k), get(tile.info, 9 + k)
            put(lanes, 16 * k + lane, low)
            put(lanes, 48 + 16 * k + lane, high)
            put(lanes, 96 + 16 * k + lane, get(tile.groups, group + k * ALL_GROUPS) - low)
            put(lanes, 144 + 16 * k + lane, get(tile.groups, group + (3 + k) * ALL_GROUPS) - high)


@inlined
def shafts_of(p):
    """Load the `Shafts` of the lanes from p."""
    return Shafts(
        load16(p, 0), load16(p, 16), load16(p, 32), load16(p, 48), load16(p, 64), load16(p, 80),
        load16(p, 96), load16(p, 112), load16(p, 128), load16(p, 144), load16(p, 160), load16(p, 176),
    )  # fmt: skip
