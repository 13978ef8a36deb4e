"""One ray through a wide BVH: eight boxes, or eight triangles, at a time; the one body of any-hit and closest-hit."""

from typing import NamedTuple

import numpy as np

from ..bvh.nodes import MAX_DEPTH
from ..bvh.wide import GROUP_WORDS, LINKS, NODE_WORDS, WIDTH
from ..jit import inlined, kernel
from ..predicate.filters import hit_t
from ..predicate.vector_filters import FilterTriangles, meet
from ..simd import (
    bits,
    broadcast8,
    compress,
    fma,
    get,
    load8,
    lowest_bit,
    mask_from_bits8,
    maximum,
    minimum,
    popcount,
    ptr_at,
    put,
    splat16,
    stack_f32,
    stack_f64,
    stack_i32,
    stack_i64,
    store,
)
from .block import (
    BLOCK_WORDS,
    DX,
    FAR,
    INVERSE,
    LANES,
    LIMIT,
    NEAR,
    OX,
    PRECISE_WORDS,
    TMAX,
    TMIN,
    Rays,
    filter_ray8,
    prepare,
    ray_of,
)
from .counters import BOX_TESTS, NODES, TRIANGLE_TESTS, count
from .traverse import settle

STACK = (MAX_DEPTH + 2) * WIDTH
_BEYOND = np.float64(1.0 + 2.0**-20)  # covers the error of `hit_t` (2**-29) and the rounding to float32


class Query(NamedTuple):
    """What counts as a hit, and what is wanted."""

    cull_faces: object  # a value of CULL_FACES
    any_hit: object


class Found(NamedTuple):
    """Pointers to what has been found for each ray of a block."""

    lane: object  # int64 *, group * 8 + lane of the triangle; -1: none
    prim: object  # int64 *, its index; only for the nearest
    t: object  # float64 *, where it is met; only for the nearest


@kernel
def consider(tree, rays, i, at, sure, query, found, counters):
    """Ray i may meet (`sure`: does meet) the triangle in lane `at`: settle that; keep the triangle if it is best."""
    slot = np.int64(get(tree.slots, at))
    prim = np.int64(get(tree.prim_ids, slot))
    if prim == get(rays.skip, i):
        return False
    ray = ray_of(rays, i)
    if not sure:
        side = settle(ray, tree.corners, slot, counters)
        if side == 0 or side == query.cull_faces:
            return False
    if query.any_hit:
        put(found.lane, i, at)
        return True
    t = hit_t(ray, tree.corners, slot)
    best = get(found.t, i)
    if get(found.lane, i) < 0 or t < best or (t == best and prim < get(found.prim, i)):
        put(found.lane, i, at)
        put(found.prim, i, prim)
        put(found.t, i, t)
        limit = np.float32(t * _BEYOND)
        if limit < get(rays.rows, LIMIT + i):
            put(rays.rows, LIMIT + i, limit)
    return False


@inlined
def group_of(groups, at):
    """The `FilterTriangles` of the group that starts at word `at`."""
    return FilterTriangles(
        load8(groups, at), load8(groups, at + 8), load8(groups, at + 16), load8(groups, at + 24),
        load8(groups, at + 32), load8(groups, at + 40), load8(groups, at + 48), load8(groups, at + 56),
        load8(groups, at + 64), load8(groups, at + 72),
    )  # fmt: skip


@inlined
def facing(hits, positive, cull_faces):
    """The hits that are not culled."""
    if cull_faces == 0:
        return hits
    return hits & (~positive if cull_faces > 0 else positive)


@inlined
def visit_leaf(tree, rays, i, link, query, found, counters):
    """Test the triangles of a leaf; whether an any-hit query has its answer."""
    group, n = ~link >> 4, ~link & 15
    count(counters, TRIANGLE_TESTS, n)
    hits, positive, unsure = meet(filter_ray8(rays.rows, i), group_of(tree.groups, group * GROUP_WORDS))
    there = (1 << n) - 1
    hits = facing(hits, positive, query.cull_faces) & there
    if query.any_hit and hits and get(rays.skip, i) < 0:
        put(found.lane, i, group * WIDTH + lowest_bit(hits))
        return True
    todo = hits | (unsure & there)
    while todo:
        k = lowest_bit(todo)
        todo &= todo - 1
        if consider(tree, rays, i, group * WIDTH + k, (hits >> k) & 1, query, found, counters):
            return True
    return False


class Slabs(NamedTuple):
    """A ray against eight boxes: broadcast rows of its block, and the words of the planes that it enters through."""

    ix: object
    iy: object
    iz: object
    near_x: object
    near_y: object
    near_z: object
    far_x: object
    far_y: object
    far_z: object
    tmin: object
    x: object
    y: object
    z: object


@inlined
def _slabs(block, i):
    b = block
    upper = np.int64(WIDTH)
    return Slabs(
        broadcast8(b, INVERSE + i), broadcast8(b, INVERSE + LANES + i), broadcast8(b, INVERSE + 2 * LANES + i),
        broadcast8(b, NEAR + i), broadcast8(b, NEAR + LANES + i), broadcast8(b, NEAR + 2 * LANES + i),
        broadcast8(b, FAR + i), broadcast8(b, FAR + LANES + i), broadcast8(b, FAR + 2 * LANES + i),
        broadcast8(b, TMIN + i),
        upper if get(b, INVERSE + i) < 0 else np.int64(0),
        2 * upper + (upper if get(b, INVERSE + LANES + i) < 0 else np.int64(0)),
        4 * upper + (upper if get(b, INVERSE + 2 * LANES + i) < 0 else np.int64(0)),
    )  # fmt: skip


@inlined
def _enter(nodes, at, r, limit):
    """The eight boxes of the node at word `at`: (mask of those entered before `limit`, vector of entry t)."""
    x, y, z = load8(nodes, at + r.x), load8(nodes, at + r.y), load8(nodes, at + r.z)
    near = maximum(maximum(fma(x, r.ix, r.near_x), fma(y, r.iy, r.near_y)), maximum(fma(z, r.iz, r.near_z), r.tmin))
    x, y, z = load8(nodes, at + (r.x ^ WIDTH)), load8(nodes, at + (r.y ^ WIDTH)), load8(nodes, at + (r.z ^ WIDTH))
    far = minimum(minimum(fma(x, r.ix, r.far_x), fma(y, r.iy, r.far_y)), minimum(fma(z, r.iz, r.far_z), limit))
    return near <= far, near


@inlined
def push_sorted(stack, entry, height, values, nears, hits):
    """Push values[k] for each k in `hits`, that with the least nears[k] on top; the new height."""
    base = height
    while hits:
        k = lowest_bit(hits)
        hits &= hits - 1
        t, j = get(nears, k), height
        while j > base and get(entry, j - 1) < t:
            put(entry, j, get(entry, j - 1))
            put(stack, j, get(stack, j - 1))
            j -= 1
        put(entry, j, t)
        put(stack, j, get(values, k))
        height += 1
    return height


@inlined
def walk_wide(tree, rays, i, query, found, counters):
    """Trace ray i of a prepared block: write what it meets, any triangle or the nearest, to `found`.

    ``found.lane`` is -1, and ``found.t`` the ray's tmax, before. The answer is that of `traverse.walk`.
    """
    nodes, links = tree.nodes, tree.links
    stack, entry, nears = stack_i32(STACK), stack_f32(STACK), stack_f32(WIDTH)
    slabs = _slabs(rays.rows, i)
    height, link = 0, np.int64(0)
    while True:
        if link >= 0:
            count(counters, NODES, 1)
            count(counters, BOX_TESTS, WIDTH)
            at = link * NODE_WORDS
            entered, near = _enter(nodes, at, slabs, broadcast8(rays.rows, LIMIT + i))
            hits = bits(entered)
            if not query.any_hit:
                store(nears, 0, near)
                height = push_sorted(stack, entry, height, ptr_at(links, at + LINKS), nears, hits)
            elif hits:
                link = np.int64(get(links, at + LINKS + lowest_bit(hits)))
                hits &= hits - 1
                store(stack, height, compress(mask_from_bits8(hits), load8(links, at + LINKS)))
                height += popcount(hits)
                continue
        elif visit_leaf(tree, rays, i, link, query, found, counters):
            return
        while not query.any_hit and height > 0 and get(entry, height - 1) > get(rays.rows, LIMIT + i):
            height -= 1
        if height == 0:
            return
        height -= 1
        link = np.int64(get(stack, height))


@kernel
def any_hit_wide(tree, ray, skip, cull_faces, counters):
    """Slot of a triangle that the ray meets, or -1."""
    rows, precise, skips = stack_f32(BLOCK_WORDS), stack_f64(PRECISE_WORDS), stack_i32(LANES)
    f = np.float32
    store(rows, OX, splat16(f(ray.ox)))
    store(rows, OX + LANES, splat16(f(ray.oy)))
    store(rows, OX + 2 * LANES, splat16(f(ray.oz)))
    store(rows, DX, splat16(f(ray.dx)))
    store(rows, DX + LANES, splat16(f(ray.dy)))
    store(rows, DX + 2 * LANES, splat16(f(ray.dz)))
    store(rows, TMIN, splat16(f(ray.tmin)))
    store(rows, TMAX, splat16(f(ray.tmax)))
    put(precise, 0, ray.dx)
    put(precise, LANES, ray.dy)
    put(precise, 2 * LANES, ray.dz)
    put(precise, 3 * LANES, ray.rx)
    put(precise, 4 * LANES, ray.ry)
    put(precise, 5 * LANES, ray.rz)
    put(skips, 0, skip)
    found = Found(stack_i64(1), stack_i64(1), stack_f64(1))
    put(found.lane, 0, -1)
    prepare(rows, tree.reach)
    walk_wide(tree, Rays(rows, precise, skips), 0, Query(cull_faces, True), found, counters)
    lane = get(found.lane, 0)
    return np.int64(-1) if lane < 0 else np.int64(get(tree.slots, lane))
