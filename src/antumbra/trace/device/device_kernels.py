"""The kernels of devices, one thread per ray, test or word, and the list of them.

Stages of a query:

1. `trace_*` walks the tree in float32 and lists undecided tests. `trace_shafts` (`shaft_traversal`) does so for 16
   segments per thread, in the parts that `find_parts` lists.
2. `settle_*` decides these in float64. What is left becomes records for the CPU, which decides by the exact predicate
   (`settling`). `mark_rays` brings its answers back.
3. `pack_states` makes bits of the states of segments; `report_hits` computes t and weights of nearest hits, and leaves
   those that double-double arithmetic cannot round to the CPU.

A record is RECORD float64 words: (ray, slot) and (best slot, 0) as pairs of int32, and the 12 numbers of a `Ray`.
"""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from ...bvh.nodes import EMPTY, bvh_leaf, line_at, link_at
from ...kernels.device import atomic_add, thread_index, u8_at
from ...kernels.exact.filters import (
    MISS,
    T_ACCURACY,
    UNKNOWN,
    UNSURE,
    are_differences,
    clamp_weight,
    edges64,
    larger,
    line_verdict,
    quick_t,
    quick_weights,
    smaller,
    verdict,
    volumes64,
)
from ...kernels.exact.predicate import misses_bounds, trivially_misses
from ...kernels.jit import inlined, kernel
from ...kernels.simd import f32_at, f64_at, get, i32_at, put, stack_f32
from ...kernels.toolchain.device_code import DeviceKernel
from ...scene.scene_bounds import NEAREST
from .build_kernels import BUILD_KERNELS
from .device_rays import AGAIN, BLOCKED, TRACED, DevicePatch, RayBuffers, SampleBuffers, ray_at
from .device_traversal import NO_HIT, PRIM, REST, TRIANGLE, WON, TreeBuffers, Work, counts_with, list_pair, walk
from .ploc_kernels import PLOC_KERNELS
from .shaft_parts import ShaftTiles, find_parts
from .shaft_traversal import trace_shafts

RECORD = 14
_APART = np.float64(1.0 + 2.0**-27)  # more than the errors of two accurate t
_INF, _NEAREST = np.float32(np.inf), np.float32(NEAREST)

# --- 1. Trace in float32 ----------------------------------------------------------------------------------------------


@inlined
def _trace(tree, rays, any_hit, work):
    k = thread_index()
    if k >= work.n:
        return
    j = k if work.which == 0 else np.int64(get(i32_at(work.which), k))
    r = ray_at(rays, work.first + j)
    answer = np.int64(r.state)
    if r.horizon and not list_pair(work, j, -1):
        answer = np.int64(AGAIN)
    if answer == TRACED:
        answer = walk(tree, r, j, any_hit, work)
    put(i32_at(work.out), j, answer)


@kernel
def trace_any(tree, rays, work):  # tree: TreeBuffers, work: Work
    """Trace segments, or any hit of rays: write the state of each."""
    _trace(tree, rays, True, work)


@kernel
def trace_nearest(tree, rays, work):  # tree: TreeBuffers, work: Work
    """Trace rays: write the slot of the nearest hit of each."""
    _trace(tree, rays, False, work)


# --- 2. Decide in float64 ---------------------------------------------------------------------------------------------


@inlined
def copy_corners(tree, slot, corners):
    """Copy the corners of the triangle in a slot to 9 float32."""
    words = f32_at(tree.triangles)
    for k in range(3):
        for axis in range(3):
            put(corners, 3 * k + axis, get(words, TRIANGLE * slot + 4 * k + axis))


@inlined
def put_record(work, at, j, slot, best, ray):
    """Write a record for the CPU to place `at`."""
    heads, numbers = i32_at(work.rest), f64_at(work.rest)
    put(heads, 2 * RECORD * at, j)
    put(heads, 2 * RECORD * at + 1, slot)
    put(heads, 2 * RECORD * at + 2, best)
    put(heads, 2 * RECORD * at + 3, 0)
    for k in range(len(ray)):
        put(numbers, RECORD * at + 2 + k, ray[k])


@inlined
def add_record(work, j, slot, best, ray):
    """Add a record for the CPU, if there is room."""
    at = np.int64(atomic_add(i32_at(work.counts), REST, 1))
    if at < work.rest_capacity:
        put_record(work, at, j, slot, best, ray)


@kernel
def record_rays(rays, work, first, n):
    """Record n rays of the list `work.which` from the `first` on, for the CPU to trace: (ray, skip), (state, 0)."""
    k = thread_index()
    if k < n:
        j = np.int64(get(i32_at(work.which), first + k))
        r = ray_at(rays, work.first + j)
        put_record(work, k, j, r.skip, r.state, r.ray)


@inlined
def side_of_hit(ray, corners, cull_faces):
    """The sign of d . n of a sure hit that counts, MISS or UNSURE."""
    if misses_bounds(ray, corners, 0):
        return MISS
    side = verdict(volumes64(ray, corners, 0), ray.tmin, ray.tmax)
    if side == UNSURE:
        return MISS if trivially_misses(ray, corners, 0) else UNSURE
    return side if side != MISS and counts_with(side, cull_faces) else MISS


@inlined
def _is_accurate(w):
    return w.t_error <= T_ACCURACY * abs(w.t) and w.d_error <= T_ACCURACY * abs(w.d)


@inlined
def _vertex(corners, k):
    f = np.float64
    return f(get(corners, 3 * k)), f(get(corners, 3 * k + 1)), f(get(corners, 3 * k + 2))


@inlined
def exact_t(ray, corners):
    """t rounded to the nearest float64, or UNKNOWN where double-double arithmetic is not accurate enough."""
    a, p, q = edges64(corners, 0, ray.ox, ray.oy, ray.oz)
    o, v0, v1, v2 = (ray.ox, ray.oy, ray.oz), _vertex(corners, 0), _vertex(corners, 1), _vertex(corners, 2)
    t, _ = quick_t((ray.dx, ray.dy, ray.dz), a, p, q)
    return t if are_differences(o, v0, v1, v2, a, p, q) else UNKNOWN


@inlined
def picture_t(ray, corners, exact):
    """t as from `filters.hit_t`; exact: as from `exact_t`."""
    w = volumes64(ray, corners, 0)
    return w.t / w.d if _is_accurate(w) else exact


@inlined
def hit_order(ray, corners, prim, side, other, other_prim):
    """1 if a hit precedes another one, as `filters.precedes` states, -1 if it follows, 0 if this is undecided.

    corners, other : pointers to the corners of both triangles
    side : the sign of d . n of the first one
    """
    a, b = volumes64(ray, corners, 0), volumes64(ray, other, 0)
    if _is_accurate(a) and _is_accurate(b):
        t, other_t = a.t / a.d, b.t / b.d
        if t > other_t * _APART or other_t > t * _APART:
            return 1 if t < other_t else -1
    t, other_t, other_side = exact_t(ray, corners), exact_t(ray, other), line_verdict(b)
    if t == UNKNOWN or other_t == UNKNOWN:
        return 0
    if t != other_t:
        return 1 if t < other_t else -1
    if other_side == UNSURE or other_side == MISS:
        return 0
    first = prim < other_prim if side == other_side else side < 0
    return 1 if first else -1


@inlined
def _settle_any(tree, rays, work, j, slot):
    out, corners = i32_at(work.out), stack_f32(9)
    if get(out, j) == BLOCKED:
        return
    r = ray_at(rays, work.first + j)
    if slot < 0:
        add_record(work, j, slot, -1, r.ray)
        return
    copy_corners(tree, slot, corners)
    side = side_of_hit(r.ray, corners, work.cull_faces)
    if side == UNSURE:
        add_record(work, j, slot, -1, r.ray)
    elif side != MISS:
        put(out, j, BLOCKED)


@inlined
def _settle_nearest(tree, rays, work, j, slot):
    best, corners, nearest = np.int64(get(i32_at(work.out), j)), stack_f32(9), stack_f32(9)
    if best == AGAIN or best == slot:
        return
    r = ray_at(rays, work.first + j)
    copy_corners(tree, slot, corners)
    side, order = side_of_hit(r.ray, corners, work.cull_faces), 0
    if side == MISS:
        return
    if side != UNSURE:
        order = 1
        if best >= 0:
            copy_corners(tree, best, nearest)
            prims = i32_at(tree.triangles)
            prim, best_prim = get(prims, TRIANGLE * slot + PRIM), get(prims, TRIANGLE * best + PRIM)
            order = hit_order(r.ray, corners, prim, side, nearest, best_prim)
    if order > 0:
        put(i32_at(work.out), j, slot)
        atomic_add(i32_at(work.counts), WON, 1)
    elif order == 0:
        add_record(work, j, slot, best, r.ray)


@kernel
def settle_any(tree, rays, work, first, n):  # tree: TreeBuffers, work: Work
    """Decide n listed tests from the `first` on: mark rays that are surely blocked; records for the undecided ones."""
    k, pairs = thread_index(), i32_at(work.pairs)
    if k < n:
        _settle_any(tree, rays, work, get(pairs, 2 * (first + k)), np.int64(get(pairs, 2 * (first + k) + 1)))


@kernel
def settle_nearest(tree, rays, work, first, n):  # tree: TreeBuffers, rays: RayBuffers, work: Work
    """Decide n listed tests from the `first` on: write hits that precede the nearest one; records for undecided ones.

    Threads of one ray may overwrite each other's hits, so this is repeated until no hit is written (`Work.counts`).
    Each time, the ray's hit is an earlier one than before.
    """
    k, pairs = thread_index(), i32_at(work.pairs)
    if k < n:
        _settle_nearest(tree, rays, work, get(pairs, 2 * (first + k)), np.int64(get(pairs, 2 * (first + k) + 1)))


@kernel
def mark_rays(out, marks, n):  # marks: address of int32
    """Write what the CPU has decided: out[ray] = value for n pairs of int32 (ray, value)."""
    k = thread_index()
    if k < n:
        put(i32_at(out), get(i32_at(marks), 2 * k), get(i32_at(marks), 2 * k + 1))


# --- 3. Report --------------------------------------------------------------------------------------------------------


@kernel
def pack_states(states, n, words, n_words):  # states: address of int32, n: number, n_words: number
    """Bit k of the int32 words is set if state k is BLOCKED."""
    k = thread_index()
    if k < n_words:
        word = np.int32(0)
        for i in range(32):
            if 32 * k + i < n and get(i32_at(states), 32 * k + i) == BLOCKED:
                word |= np.int32(1) << np.int32(i)
        put(i32_at(words), k, word)


class HitBuffers(NamedTuple):
    """Where `report_hits` writes: addresses on the device."""

    face: int  # int32
    t: int  # float64
    u: int  # float32
    v: int  # float32


HIT_BYTES = HitBuffers(4, 8, 4, 4)  # per hit


@inlined
def _numbers_of_hit(ray, corners):
    """(t, u, v) of a hit; t or u is UNKNOWN where double-double or float64 arithmetic is not accurate enough."""
    a, p, q = edges64(corners, 0, ray.ox, ray.oy, ray.oz)
    u, v = quick_weights((ray.dx, ray.dy, ray.dz), a, p, q)
    return exact_t(ray, corners), u, v


@kernel
def report_hits(tree, rays, work, hits, first, n):  # tree: TreeBuffers, work: Work
    """Write the numbers of n rays' hits from the `first` on; records for those that the CPU must compute."""
    k, corners = thread_index(), stack_f32(9)
    if k >= n:
        return
    j = first + k
    slot, face, t, u, v = (
        np.int64(get(i32_at(work.out), j)),
        np.int32(-1),
        np.float64(np.inf),
        np.float64(0.0),
        np.float64(0.0),
    )
    if slot < NO_HIT:  # the hit in another tree stands
        return
    if slot >= 0:
        r = ray_at(rays, work.first + j)
        copy_corners(tree, slot, corners)
        face = get(i32_at(tree.triangles), TRIANGLE * slot + PRIM)
        t, u, v = _numbers_of_hit(r.ray, corners)
        if t == UNKNOWN or u == UNKNOWN:
            add_record(work, j, slot, -1, r.ray)
    put(i32_at(hits.face), j, face)
    put(f64_at(hits.t), j, t)
    put(f32_at(hits.u), j, clamp_weight(u))
    put(f32_at(hits.v), j, clamp_weight(v))


@kernel
def use_picture_t(tree, rays, work, hits):
    """Write t as pictures on the CPU have it, by `filters.hit_t`."""
    # In: tree: TreeBuffers, rays: RayBuffers, work: Work, hits: HitBuffers, with numbers. Out: t of hits
    j, corners = thread_index(), stack_f32(9)
    if j >= work.n:
        return
    slot = np.int64(get(i32_at(work.out), j))
    if slot >= 0:
        copy_corners(tree, slot, corners)
        t = get(f64_at(hits.t), j)
        put(f64_at(hits.t), j, picture_t(ray_at(rays, work.first + j).ray, corners, t))


@kernel
def write_blocked(states, n, blocked):  # blocked: address of bool
    """Write whether each of n states is BLOCKED, as bool."""
    k = thread_index()
    if k < n:
        put(u8_at(blocked), k, np.uint8(get(i32_at(states), k) == BLOCKED))


@kernel
def write_numbers(hits, rays, t, u, v, n):
    """Write numbers of n hits, by the CPU: t float64, u and v float32, of the rays in a list of int32."""
    k = thread_index()
    if k < n:
        j = get(i32_at(rays), k)
        put(f64_at(hits.t), j, get(f64_at(t), k))
        put(f32_at(hits.u), j, get(f32_at(u), k))
        put(f32_at(hits.v), j, get(f32_at(v), k))


# --- Rays of arrays on the device -------------------------------------------------------------------------------------


class PointBuffer(NamedTuple):
    """Points or directions in an array of the caller on the device."""

    address: int
    double: int  # 1 for float64, 0 for float32
    row: int  # 3; or 0, if all rays share one row
    frame: tuple[float, float, float]  # world position of the origin of the scene's frame; 0 for directions
    directions: int  # 1: directions, which must not be zero; 0: points
    limit: float  # largest magnitude in the frame


@inlined
def _world(points, i, k):
    at = points.row * i + k
    return get(f64_at(points.address), at) if points.double != 0 else np.float64(get(f32_at(points.address), at))


@inlined
def _coordinate(points, i, k):
    y = np.float32(_world(points, i, k) - points.frame[k])
    return y if points.directions != 0 or abs(y) >= _NEAREST or y != y else np.float32(0.0)


@inlined
def _is_exact(points, i, k, x):
    """Whether the coordinate x in the frame gives that of the world."""
    return np.float64(x) + points.frame[k] == _world(points, i, k)


@kernel
def frame_points(points, n, out, faults):  # out: address of int32
    """Convert n points to the scene's frame, as `query.ray_list.RayArrays.local`, and count invalid ones.

    faults : three int32: their number, the index of one of them, and 1 if the frame does not hold all digits of a point
    """
    i = thread_index()
    if i < n:
        x, y, z = _coordinate(points, i, 0), _coordinate(points, i, 1), _coordinate(points, i, 2)
        put(f32_at(out), 3 * i, x)
        put(f32_at(out), 3 * i + 1, y)
        put(f32_at(out), 3 * i + 2, z)
        still = points.directions != 0 and x == 0.0 and y == 0.0 and z == 0.0
        if still or not (abs(x) <= points.limit and abs(y) <= points.limit and abs(z) <= points.limit):
            atomic_add(i32_at(faults), 0, 1)
            put(i32_at(faults), 1, i)
        if not (_is_exact(points, i, 0, x) and _is_exact(points, i, 1, y) and _is_exact(points, i, 2, z)):
            put(i32_at(faults), 2, 1)


@kernel
def gather_points(points, corners, n, out):  # points, out: addresses of float32, corners: of int32
    """Write the points of n corners."""
    i = thread_index()
    if i < n:
        at = 3 * np.int64(get(i32_at(corners), i))
        for axis in range(3):
            put(f32_at(out), 3 * i + axis, get(f32_at(points), at + axis))


# --- Refit ------------------------------------------------------------------------------------------------------------


@inlined
def _bounds_of_child(tree, link, axis):
    """(lower, upper) of a child's box along one axis: of its triangles, or of its children's boxes."""
    nodes, words, low, high = f32_at(tree.nodes), f32_at(tree.triangles), _INF, -_INF
    if link >= 0:
        at = line_at(link) + 4 * axis
        return smaller(get(nodes, at), get(nodes, at + 1)), larger(get(nodes, at + 2), get(nodes, at + 3))
    if link != EMPTY:
        leaf = bvh_leaf(link)
        for slot in range(leaf.first, leaf.first + leaf.count):
            for k in range(3):
                x = get(words, TRIANGLE * slot + 4 * k + axis)
                low, high = smaller(low, x), larger(high, x)
    return low, high


@kernel
def refit_nodes(tree, order, first, n):  # tree: TreeBuffers, order: address of int32
    """Compute the boxes of n nodes of a list (int32) from the `first` on, from those of their children; none of -1."""
    k = thread_index()
    if k < n:
        node = np.int64(get(i32_at(order), first + k))
        if node < 0:
            return
        for side in range(2):
            link = np.int64(get(i32_at(tree.nodes), link_at(node, side)))
            for axis in range(3):
                low, high = _bounds_of_child(tree, link, axis)
                put(f32_at(tree.nodes), line_at(node) + 4 * axis + side, low)
                put(f32_at(tree.nodes), line_at(node) + 4 * axis + 2 + side, high)


# --- The list ---------------------------------------------------------------------------------------------------------


_ONE = np.float32(1.0)
TREE = TreeBuffers(0, 0, (_ONE, _ONE, _ONE))
RAYS = RayBuffers(0, 0, 0, 0, 0, 0, 0.0, 0.0, 0)
_ZERO = (0.0, 0.0, 0.0)
SAMPLES = SampleBuffers(0, 0, 0, 0, 0, DevicePatch(0, _ZERO, _ZERO, _ZERO, _ZERO, 0.0), 0, 0)
HITS = HitBuffers(0, 0, 0, 0)
WORK = Work(0, 0, 0, 0, 0, 0, 0, 0, 0, 0)
TILES = ShaftTiles(0, 0, 0, 0, 0, 0.0)

KERNELS = {
    "trace_any": DeviceKernel(trace_any, (TREE, RAYS, WORK)),
    "trace_samples": DeviceKernel(trace_any, (TREE, SAMPLES, WORK)),
    "find_parts": DeviceKernel(find_parts, (SAMPLES, WORK, TILES)),
    "trace_shafts": DeviceKernel(trace_shafts, (TREE, SAMPLES, WORK, TILES)),
    "trace_nearest": DeviceKernel(trace_nearest, (TREE, RAYS, WORK)),
    "settle_any": DeviceKernel(settle_any, (TREE, RAYS, WORK, 0, 0)),
    "settle_samples": DeviceKernel(settle_any, (TREE, SAMPLES, WORK, 0, 0)),
    "settle_nearest": DeviceKernel(settle_nearest, (TREE, RAYS, WORK, 0, 0)),
    "record_rays": DeviceKernel(record_rays, (RAYS, WORK, 0, 0)),
    "record_samples": DeviceKernel(record_rays, (SAMPLES, WORK, 0, 0)),
    "mark_rays": DeviceKernel(mark_rays, (0, 0, 0)),
    "pack_states": DeviceKernel(pack_states, (0, 0, 0, 0)),
    "report_hits": DeviceKernel(report_hits, (TREE, RAYS, WORK, HITS, 0, 0)),
    "use_picture_t": DeviceKernel(use_picture_t, (TREE, RAYS, WORK, HITS)),
    "write_blocked": DeviceKernel(write_blocked, (0, 0, 0)),
    "write_numbers": DeviceKernel(write_numbers, (HITS, 0, 0, 0, 0, 0)),
    "frame_points": DeviceKernel(frame_points, (PointBuffer(0, 0, 0, _ZERO, 0, 0.0), 0, 0, 0)),
    "gather_points": DeviceKernel(gather_points, (0, 0, 0, 0)),
    "refit_nodes": DeviceKernel(refit_nodes, (TREE, 0, 0, 0)),
}
"""Name -> kernel. Modules with other kernels add them."""


def add_kernels(kernels: Mapping[str, DeviceKernel]) -> None:
    """Add kernels to `KERNELS`, by which they are launched. ValueError if a name is taken."""
    if taken := KERNELS.keys() & kernels.keys():
        raise ValueError(f"other kernels of devices are named {', '.join(sorted(taken))}")
    KERNELS.update(kernels)


add_kernels(BUILD_KERNELS)
add_kernels(PLOC_KERNELS)
