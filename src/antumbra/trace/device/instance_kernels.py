"""Kernels for scenes of instances: one thread walks the tree over the copies, and the trees of the meshes it enters.

The walk is that of `rays.instance_traversal`, in binary trees: a ray enters a copy in an approximate frame of its mesh,
where tests in float32 only reject. A triangle that is left is placed by the arithmetic of flattening, in float64, and
tested in float64 at once. A ray for which float64 leaves a test, the order of two hits, or the numbers of its hit
undecided becomes a record (`device_kernels`), and the CPU traces it.

- `block_by_copies`: any hit of ray lists and shadow segments
- `nearest_in_copies`: nearest hits of ray lists, with their numbers
"""

from typing import NamedTuple

import numpy as np

from ...bvh.instance_trees import GROUPS, MESH_WORDS, NODES, InstancePointers, mesh_pointers
from ...bvh.nodes import EMPTY, MAX_DEPTH, bvh_leaf, link_at
from ...kernels.device import i64_at, thread_index
from ...kernels.exact.filters import (
    BEYOND,
    END_FLOOR,
    MISS,
    UNKNOWN,
    UNSURE,
    FilterRays,
    clamp_weight,
    edges64,
    larger,
    lines_may_pass,
    quick_weights,
)
from ...kernels.jit import F32Ptr, F64Ptr, I64Ptr, inlined, kernel, overload
from ...kernels.simd import (
    bits,
    f32_at,
    f64_at,
    get,
    i32_at,
    put,
    splat1,
    splat4,
    stack_f32,
    stack_f64,
    stack_i32,
    stack_i64,
)
from ...kernels.toolchain.device_code import DeviceKernel
from ..rays.instance_traversal import (
    EARLIER,
    copy_limit,
    face_of,
    filter_bounds,
    map_ray,
    place_triangle,
    slab,
    slab_margins,
)
from .device_kernels import HITS, RAYS, SAMPLES, TREE, WORK, add_kernels, add_record, exact_t, hit_order, side_of_hit
from .device_rays import BLOCKED, CLEAR, TRACED, ray_at
from .device_traversal import GO_ON, UNDECIDED, Slabs, TreeBuffers, axis_between, entries, filter_triangle, slabs_of

_STACK = MAX_DEPTH + 2
_ZERO = np.float32(0.0)


class ForestBuffers(NamedTuple):
    """The trees of a scene of instances on a device: addresses, of arrays as in `InstanceArrays`.

    The words of a mesh name a binary tree, triangles as in `TreeBuffers`, and arrays by slot instead of lane.
    """

    top: TreeBuffers  # over the copies; it has no triangles
    copies: int  # int32: slot of the tree -> copy
    meshes: int  # int64
    mesh: int  # int32
    matrices: int  # float64
    maps: int  # float64
    rows: int  # int64
    starts: int  # int64
    origin: int  # float64


class Part(NamedTuple):
    """The rays of a launch."""

    first: int  # counted from `Work.first`
    n: int


@inlined
def _scene(forest):
    return InstancePointers(
        f32_at(forest.top.nodes), i32_at(forest.top.nodes), i64_at(forest.meshes), i32_at(forest.mesh),
        f64_at(forest.matrices), f64_at(forest.maps), i64_at(forest.rows), i64_at(forest.starts),
        f64_at(forest.origin), forest.top.reach,
    )  # fmt: skip


# --- Visitors ---------------------------------------------------------------------------------------------------------


def visit_copy(visitor, scene, i, r, slot):
    """In kernels: test copy i's triangle in a slot: GO_ON, or the answer that ends the walk.

    The type of the visitor selects the implementation. Its field `limit` points to a float64, at or behind the largest
    t of interest, which `visit_copy` may reduce.
    """


class _AnyHit(NamedTuple):
    """Finds a triangle that the ray meets: BLOCKED."""

    cull_faces: int
    limit: F64Ptr  # tmax
    corners: F32Ptr  # 9 float32


@inlined
def _place(visitor, scene, i, r, slot):
    """(the sign of d . n, face) of a hit on copy i's triangle in a slot; or MISS or UNSURE, and any face."""
    mesh = mesh_pointers(scene, get(scene.mesh, i))
    face = np.int64(face_of(scene, i, mesh, slot))
    if face == r.skip:
        return MISS, face
    place_triangle(scene, i, mesh, slot, visitor.corners, np.int64(0))
    return side_of_hit(r.ray, visitor.corners, visitor.cull_faces), face


@inlined
def _visit_any(visitor, scene, i, r, slot):
    side, _ = _place(visitor, scene, i, r, slot)
    if side == MISS:
        return GO_ON
    return UNDECIDED if side == UNSURE else BLOCKED


class _NearestHit(NamedTuple):
    """Finds the nearest hit."""

    cull_faces: int
    limit: F64Ptr  # t of the best hit so far, or tmax
    corners: F32Ptr
    best: I64Ptr  # scene index of its face, or -1
    best_corners: F32Ptr  # 9 float32


@inlined
def _visit_nearest(visitor, scene, i, r, slot):
    side, face = _place(visitor, scene, i, r, slot)
    if side == MISS:
        return GO_ON
    if side == UNSURE:
        return UNDECIDED
    order, best, t = 1, get(visitor.best, 0), exact_t(r.ray, visitor.corners)
    if best >= 0:
        order = hit_order(r.ray, visitor.corners, face, side, visitor.best_corners, best)
    if order == 0 or t == UNKNOWN:
        return UNDECIDED
    if order > 0:
        put(visitor.best, 0, face)
        put(visitor.limit, 0, t)
        for k in range(9):
            put(visitor.best_corners, k, get(visitor.corners, k))
    return GO_ON


@overload(visit_copy)
def _visit_copy(visitor, scene, i, r, slot):
    if visitor.instance_class is _AnyHit:
        return lambda visitor, scene, i, r, slot: _visit_any(visitor, scene, i, r, slot)
    if visitor.instance_class is _NearestHit:
        return lambda visitor, scene, i, r, slot: _visit_nearest(visitor, scene, i, r, slot)
    return None


# --- The walk ---------------------------------------------------------------------------------------------------------


@inlined
def _mapped_slabs(mapped):
    """The `Slabs` of a `MappedRay`, moved outwards by its errors."""
    fits, along, pad = slab_margins(mapped.o, mapped.d, mapped.reach, mapped.shift)
    return Slabs(
        axis_between(*slab(mapped.o[0], mapped.d[0], along, pad, fits)),
        axis_between(*slab(mapped.o[1], mapped.d[1], along, pad, fits)),
        axis_between(*slab(mapped.o[2], mapped.d[2], along, pad, fits)),
        splat4(_ZERO),
    )


@inlined
def _mapped_filter(mapped):
    """(`FilterRays` of a `MappedRay` in one lane, `slack` of `lines_may_pass`)."""
    unit, floor, slack = filter_bounds(mapped)
    o, d, unit, floor = mapped.o, mapped.d, splat1(unit), splat1(floor)
    line = FilterRays(
        splat1(o[0]), splat1(o[1]), splat1(o[2]), splat1(d[0]), splat1(d[1]), splat1(d[2]), floor, floor, unit, floor,
    )  # fmt: skip
    return line, splat1(slack)


@inlined
def _walk_copy(scene, i, r, start, visitor):
    """Visit the triangles of copy i that float32 does not exclude, from t = `start` on. The last answer."""
    at = np.int64(get(scene.mesh, i)) * MESH_WORDS
    nodes, links = f32_at(get(scene.meshes, at + NODES)), i32_at(get(scene.meshes, at + NODES))
    triangles = get(scene.meshes, at + GROUPS)
    mapped = map_ray(scene, i, r.ray, start)
    box, (line, slack) = _mapped_slabs(mapped), _mapped_filter(mapped)
    limit = copy_limit(mapped, get(visitor.limit, 0))
    stack, height, link = stack_i32(_STACK), 0, np.int64(0)
    while True:
        while link >= 0:
            left, right, near_left, near_right = entries(nodes, link, box, limit)
            left_link, right_link = np.int64(get(links, link_at(link, 0))), np.int64(get(links, link_at(link, 1)))
            if left and right:
                put(stack, height, right_link if near_left <= near_right else left_link)
                height += 1
                link = left_link if near_left <= near_right else right_link
            elif left or right:
                link = left_link if left else right_link
            else:
                link = np.int64(EMPTY)
        if link != EMPTY:
            leaf = bvh_leaf(link)
            for slot in range(leaf.first, leaf.first + leaf.count):
                triangle, _ = filter_triangle(triangles, slot)
                if bits(lines_may_pass(line, triangle, slack)) == 0:
                    continue
                answer = np.int64(visit_copy(visitor, scene, i, r, np.int64(slot)))
                if answer != GO_ON:
                    return answer
                limit = copy_limit(mapped, get(visitor.limit, 0))
        if height == 0:
            return np.int64(GO_ON)
        height -= 1
        link = np.int64(get(stack, height))


@inlined
def _walk_forest(forest, r, visitor):
    """Visit the triangles that float32 does not exclude, copy by copy. The last answer."""
    scene, f, nodes, links = _scene(forest), np.float32, f32_at(forest.top.nodes), i32_at(forest.top.nodes)
    o, d = (f(r.ray.ox), f(r.ray.oy), f(r.ray.oz)), (f(r.ray.dx), f(r.ray.dy), f(r.ray.dz))
    box = slabs_of(forest.top, o, d, f(r.ray.tmin))
    stack, entry, height = stack_i32(_STACK), stack_f32(_STACK), 0
    link, near = np.int64(0), f(r.ray.tmin)
    while True:
        while link >= 0:
            limit = f(get(visitor.limit, 0) * BEYOND) + END_FLOOR
            left, right, near_left, near_right = entries(nodes, link, box, limit)
            left_link, right_link = np.int64(get(links, link_at(link, 0))), np.int64(get(links, link_at(link, 1)))
            if left and right:
                first = near_left <= near_right
                put(stack, height, right_link if first else left_link)
                put(entry, height, near_right if first else near_left)
                height += 1
                link, near = left_link if first else right_link, near_left if first else near_right
            elif left or right:
                link, near = left_link if left else right_link, near_left if left else near_right
            else:
                link = np.int64(EMPTY)
        if link != EMPTY:
            leaf = bvh_leaf(link)
            for slot in range(leaf.first, leaf.first + leaf.count):
                start = larger(r.ray.tmin, np.float64(near) * EARLIER)
                i = np.int64(get(i32_at(forest.copies), slot))
                answer = _walk_copy(scene, i, r, start, visitor)
                if answer != GO_ON:
                    return answer
        if height == 0:
            return np.int64(GO_ON)
        height -= 1
        link, near = np.int64(get(stack, height)), get(entry, height)


# --- Kernels ----------------------------------------------------------------------------------------------------------


@kernel
def block_by_copies(forest, rays, work, part):  # forest: ForestBuffers, rays: of any kind, work: Work, part: Part
    """Write the states of rays or segments; records for those that the CPU traces."""
    k, corners, limit = thread_index(), stack_f32(9), stack_f64(1)
    if k >= part.n:
        return
    j = part.first + k
    r = ray_at(rays, work.first + j)
    answer = np.int64(r.state)
    if r.horizon:
        answer = np.int64(UNDECIDED)
    elif answer == TRACED:
        put(limit, 0, r.ray.tmax)
        answer = _walk_forest(forest, r, _AnyHit(work.cull_faces, limit, corners))
    if answer == UNDECIDED:
        add_record(work, j, r.skip, r.state, r.ray)
    put(i32_at(work.out), j, BLOCKED if answer == BLOCKED else CLEAR)


@kernel
def nearest_in_copies(forest, rays, work, hits, part):  # forest: ForestBuffers, work: Work, hits: HitBuffers
    """Write the nearest hits of a part of the rays; records for those that the CPU traces."""
    k, corners, limit = thread_index(), stack_f32(9), stack_f64(1)
    best, best_corners = stack_i64(1), stack_f32(9)
    if k >= part.n:
        return
    j, answer, u, v = part.first + k, np.int64(GO_ON), np.float64(0.0), np.float64(0.0)
    r = ray_at(rays, work.first + j)
    put(limit, 0, r.ray.tmax)
    put(best, 0, np.int64(-1))
    if r.state == TRACED:
        answer = _walk_forest(forest, r, _NearestHit(work.cull_faces, limit, corners, best, best_corners))
    face = get(best, 0)
    if answer == GO_ON and face >= 0:
        a, p, q = edges64(best_corners, 0, r.ray.ox, r.ray.oy, r.ray.oz)
        u, v = quick_weights((r.ray.dx, r.ray.dy, r.ray.dz), a, p, q)
    if answer == UNDECIDED or u == UNKNOWN:
        add_record(work, j, r.skip, r.state, r.ray)
    put(i32_at(hits.face), j, np.int32(face))
    put(f64_at(hits.t), j, get(limit, 0) if face >= 0 else np.float64(np.inf))
    put(f32_at(hits.u), j, clamp_weight(u))
    put(f32_at(hits.v), j, clamp_weight(v))


_FOREST = ForestBuffers(TREE, 0, 0, 0, 0, 0, 0, 0, 0)
_PART = Part(0, 0)

INSTANCE_KERNELS = {
    "block_by_copies": DeviceKernel(block_by_copies, (_FOREST, RAYS, WORK, _PART)),
    "block_samples_by_copies": DeviceKernel(block_by_copies, (_FOREST, SAMPLES, WORK, _PART)),
    "nearest_in_copies": DeviceKernel(nearest_in_copies, (_FOREST, RAYS, WORK, HITS, _PART)),
}
add_kernels(INSTANCE_KERNELS)
