"""Traversal of instances by one ray: through the wide BVH over the copies, then through the wide BVH of each mesh.

A ray enters a copy in an approximate frame of its mesh, moved to where it enters the copy's box. There, boxes and
triangles are tested conservatively in float32, eight at a time: their planes and edges are moved by a bound on the
distance between the flattened triangles and the stored ones, and on the errors of the ray (docs/design/instances.md).

A triangle that the ray may meet is then placed by the arithmetic of flattening, which gives the float32 triangle of the
flattened scene, bit by bit, and tested as everywhere else. So all answers are those of the flattened scene.
"""

from typing import NamedTuple

import numpy as np

from ...bvh.instance_trees import mesh_pointers, mesh_reach
from ...bvh.nodes import EMPTY, GROUP_WORDS, LINKS, NODE_WORDS, WIDTH, wide_leaf
from ...kernels.exact.filters import (
    BEYOND,
    FilterRays,
    comes_first,
    hit_t,
    lines_may_pass,
    max_magnitude,
    single_error_unit,
)
from ...kernels.jit import F32Ptr, F32x8, F64Ptr, I32Ptr, I64Ptr, inlined, kernel, overload
from ...kernels.simd import (
    as_f32,
    bits,
    get,
    load8,
    lowest_bit,
    permute,
    popcount,
    put,
    splat8,
    stack_i32,
    store,
    store_compressed,
)
from ...scene.scene_bounds import NEAREST
from ..counters import BOX_TESTS, NODES, count
from .ray_traversal import triangle_hit
from .wide_traversal import LANE, STACK, WideSlabs, boxes_fit, enter, group_of, largest_of, sorted_keys

# --- Rays in frames ---------------------------------------------------------------------------------------------------


_SMALL, _LARGE = np.float32(2.0**-40), np.float32(2.0**40)
_ALONG = np.float32(2.0**-40)  # a direction's components are raised to at least this fraction of the largest one
_PAD = np.float32(2.0**-20)  # planes are moved outwards by this fraction of the largest coordinate involved
_INF, _ZERO, _ONE, _TWO = (np.float32(x) for x in (np.inf, 0.0, 1.0, 2.0))
EARLIER = np.float64(1.0 - 2.0**-19)  # more than the lane in a key, and the rounding of a box's entry, add to its t
LATER = np.float64(1.0 + 2.0**-20)
_NARROW, _COMPUTED = np.float64(2.0**-21), np.float64(2.0**-47)  # errors of a ray in a copy's frame
_MOST_TURN = np.float64(0.25)  # more than an ill-conditioned transform may turn a ray
_NEAREST = np.float32(NEAREST)


@inlined
def slab(o, d, along, pad, fits):
    """(inverse, near offset, far offset) of one axis, see `wide_traversal.prepare`."""
    steep = d if abs(d) > along else along
    inverse = _ONE / steep
    offset, grow = -(o * inverse), pad * abs(inverse)
    if fits:
        return inverse, offset - grow, offset + grow
    return _ZERO, -_INF, _INF


@inlined
def is_tame(d, reach, shift):
    """Whether float32 holds the products of a direction and coordinates up to `reach`. False for NaN."""
    largest = max_magnitude(d)
    return largest > _SMALL and largest < _LARGE and reach > _SMALL and reach < _LARGE and shift < _LARGE


@inlined
def slab_margins(o, d, reach, shift):
    """(whether float32 suffices, smallest component of the direction, distance by which planes are moved outwards)."""
    reach, largest = max(max_magnitude(o), reach), max_magnitude(d)
    return boxes_fit(largest, reach) and shift < _LARGE, largest * _ALONG, reach * _PAD + shift


@inlined
def _slabs(o, d, tmin, reach, shift):
    """The `WideSlabs` of a float32 ray. Planes are moved outwards by `shift`, besides the errors of the test.

    reach : largest magnitude of the coordinates of boxes
    """
    fits, along, pad = slab_margins(o, d, reach, shift)
    ix, near_x, far_x = slab(o[0], d[0], along, pad, fits)
    iy, near_y, far_y = slab(o[1], d[1], along, pad, fits)
    iz, near_z, far_z = slab(o[2], d[2], along, pad, fits)
    upper = np.int64(WIDTH)
    return WideSlabs(
        splat8(ix), splat8(iy), splat8(iz), splat8(near_x), splat8(near_y), splat8(near_z), splat8(far_x),
        splat8(far_y), splat8(far_z), splat8(tmin),
        upper if ix < _ZERO else 0,
        2 * upper + (upper if iy < _ZERO else 0),
        4 * upper + (upper if iz < _ZERO else 0),
    )  # fmt: skip


@inlined
def _mapped(maps, at, x, y, z):
    """The vector (x, y, z) in a copy's frame; `at`: first word of the copy's map."""
    return (
        get(maps, at) * x + get(maps, at + 1) * y + get(maps, at + 2) * z,
        get(maps, at + 3) * x + get(maps, at + 4) * y + get(maps, at + 5) * z,
        get(maps, at + 6) * x + get(maps, at + 7) * y + get(maps, at + 8) * z,
    )


class MappedRay(NamedTuple):
    """A ray in the frame of a copy's mesh: scalars."""

    o: tuple[np.float32, np.float32, np.float32]
    d: tuple[np.float32, np.float32, np.float32]  # its largest component is 1
    shift: np.float32  # at least the distance between this ray and the exact one, and between triangles
    reach: np.float32  # largest magnitude of a coordinate of the mesh
    start: np.float64  # t of the ray where this one begins
    scale: np.float64  # t of this ray, per t of the ray
    tame: bool  # whether float32 and the numbers above suffice


@inlined
def map_ray(scene, i, ray, start):
    """The `MappedRay` of a `Ray` in copy i, from t = `start` on."""
    f, at, maps = np.float32, 15 * i, scene.maps
    x, y, z = _mapped(
        maps, at,
        ray.ox + start * ray.dx - get(maps, at + 9),
        ray.oy + start * ray.dy - get(maps, at + 10),
        ray.oz + start * ray.dz - get(maps, at + 11),
    )  # fmt: skip
    dx, dy, dz = _mapped(maps, at, ray.dx, ray.dy, ray.dz)
    scale = max_magnitude((dx, dy, dz))
    inverse = np.float64(1.0) / scale
    o, d = (f(x), f(y), f(z)), (f(dx * inverse), f(dy * inverse), f(dz * inverse))
    reach = mesh_reach(scene, get(scene.mesh, i))
    # Eq. (5) of docs/design/instances.md
    speed, norm = max_magnitude((ray.dx, ray.dy, ray.dz)), get(maps, at + 13)
    size = max_magnitude((ray.ox, ray.oy, ray.oz)) + start * speed + get(maps, at + 12)
    offset = get(maps, at + 14) + norm * size * _COMPUTED
    travel = np.float64(max_magnitude(o)) + np.float64(reach) + offset
    turn = _NARROW + norm * speed * inverse * _COMPUTED
    shift = f((offset + travel * turn) * LATER) if turn < _MOST_TURN else _INF
    return MappedRay(o, d, shift, reach, start, scale, is_tame(d, max(max_magnitude(o), reach), shift))


@inlined
def filter_bounds(r):
    """(unit and floor of `FilterRays`, `slack` of `lines_may_pass`) of a `MappedRay`."""
    span = abs(r.d[0]) + abs(r.d[1]) + abs(r.d[2])
    unit, floor = single_error_unit(r.tame, span, r.reach)
    return unit, floor, _TWO * span * r.shift


@inlined
def copy_limit(r, t):
    """The t in a copy's frame beyond which hits do not matter, if t is that of the nearest one so far; float32."""
    if not r.tame:
        return _INF
    return np.float32((t * BEYOND - r.start) * r.scale * LATER)


class CopyRay(NamedTuple):
    """A `MappedRay` in eight lanes."""

    slabs: WideSlabs
    filter: FilterRays  # its tmin and tmax are not used
    slack: F32x8  # see `lines_may_pass`


@inlined
def _copy_ray(r):
    unit, floor, slack = filter_bounds(r)
    unit, floor = splat8(unit), splat8(floor)
    ox, oy, oz = splat8(r.o[0]), splat8(r.o[1]), splat8(r.o[2])
    dx, dy, dz = splat8(r.d[0]), splat8(r.d[1]), splat8(r.d[2])
    slabs = _slabs(r.o, r.d, _ZERO, r.reach, r.shift)
    return CopyRay(slabs, FilterRays(ox, oy, oz, dx, dy, dz, floor, floor, unit, floor), splat8(slack))


# --- Triangles of copies ----------------------------------------------------------------------------------------------


@inlined
def place_triangle(scene, i, mesh, source, corners, slot):
    """Write the corners of copy i's triangle in lane `source`, as flattening computes them, to a slot of `corners`."""
    for corner in range(3):
        v = 9 * source + 3 * corner
        x, y, z = get(mesh.corners, v), get(mesh.corners, v + 1), get(mesh.corners, v + 2)
        for axis in range(3):
            m, row = scene.matrices, 12 * i + 4 * axis
            world = get(m, row) * x + get(m, row + 1) * y + get(m, row + 2) * z + get(m, row + 3)
            local = np.float32(world - get(scene.origin, axis))
            put(corners, 9 * slot + 3 * corner + axis, _ZERO if abs(local) < _NEAREST else local)


@inlined
def face_of(scene, i, mesh, source):
    """The scene index of the face of copy i in lane `source`."""
    return get(scene.starts, get(scene.rows, i) + np.int64(get(mesh.part, source))) + np.int64(get(mesh.ids, source))


class InstanceQuery(NamedTuple):
    """The kind of query."""

    skip: int  # scene index of a face to ignore, or -1
    cull_faces: int  # a value of CULL_FACES
    any_hit: bool  # any hit, not the nearest


class InstanceHit(NamedTuple):
    """The hit of a ray so far: pointers to scratch memory."""

    corners: F32Ptr  # float32 *, 9 per slot
    tested: int  # slot of the triangle that is tested
    best: int  # slot of the one that is hit
    t: F64Ptr  # float64 *, 1: of the hit, by `hit_t`; the ray's tmax if there is none
    ids: I64Ptr  # int64 *, 3: scene index of the face, or -1; its copy; its lane in the mesh's tree


TESTED, BEST = np.int64(0), np.int64(1)  # slots for a single ray
HIT_FLOATS, HIT_IDS = 18, 3  # sizes of its memory


@inlined
def _keep(i, source, face, t, hit):
    """Record a hit on the triangle that is tested."""
    put(hit.t, 0, t)
    put(hit.ids, 0, face)
    put(hit.ids, 1, i)
    put(hit.ids, 2, source)
    for k in range(9):
        put(hit.corners, 9 * hit.best + k, get(hit.corners, 9 * hit.tested + k))


def test_triangle(scene, i, source, ray, query, hit, counters):
    """In kernels: test a ray against copy i's triangle in lane `source`, and record a hit. Return whether it is new.

    The type of `hit` selects the implementation. Other modules add theirs.
    """


@overload(test_triangle)
def _test_triangle(scene, i, source, ray, query, hit, counters):
    if hit.instance_class is InstanceHit:
        return lambda scene, i, source, ray, query, hit, counters: meets_triangle(
            scene, i, source, ray, query, hit, counters
        )
    return None


@kernel
def meets_triangle(scene, i, source, ray, query, hit, counters):
    """`test_triangle` for any hit or the nearest one."""
    mesh = mesh_pointers(scene, get(scene.mesh, i))
    place_triangle(scene, i, mesh, source, hit.corners, hit.tested)
    o = (np.float32(ray.ox), np.float32(ray.oy), np.float32(ray.oz))
    d = (np.float32(ray.dx), np.float32(ray.dy), np.float32(ray.dz))
    if not triangle_hit(hit.corners, hit.tested, ray, o, d, query.cull_faces, counters):
        return False
    face = face_of(scene, i, mesh, source)
    if face == query.skip:
        return False
    if query.any_hit:
        _keep(i, source, face, get(hit.t, 0), hit)
        return True
    t, best = hit_t(ray, hit.corners, hit.tested), get(hit.ids, 0)
    if best < 0 or comes_first(ray, hit.corners, hit.tested, face, t, hit.corners, hit.best, best, get(hit.t, 0)):
        _keep(i, source, face, t, hit)
        return True
    return False


# --- Traversal --------------------------------------------------------------------------------------------------------


_ROOM = STACK + 2 * WIDTH


class WideStack(NamedTuple):
    """Nodes and leaves to visit: pointers to scratch memory."""

    keys: I32Ptr  # int32 *, `_ROOM`: keys of `sorted_keys`
    links: I32Ptr  # int32 *, `_ROOM`


@inlined
def _push_sorted(nodes, links, node, slabs, limit, stack, top):
    """Push the children that a ray enters before `limit`, the nearest one on top. Return the new top."""
    at = node * NODE_WORDS
    entered, t_near = enter(nodes, at, slabs, splat8(limit))
    keys = sorted_keys(entered, t_near)
    store(stack.keys, top, keys)
    store(stack.links, top, permute(load8(links, at + LINKS), keys & LANE))
    return top + popcount(bits(entered))


@inlined
def _push_unsorted(nodes, links, node, slabs, limit, stack, top):
    """Push the children that a ray enters, in the node's order. Return the new top."""
    at = node * NODE_WORDS
    entered, _ = enter(nodes, at, slabs, splat8(limit))
    store_compressed(stack.links, top, entered, load8(links, at + LINKS))
    return top + popcount(bits(entered))


@inlined
def _pop_before(stack, top, limit):
    """The top of a sorted stack without the entries beyond `limit`."""
    while top > 0 and np.float64(get(as_f32(stack.keys), top - 1)) * EARLIER > limit:
        top -= 1
    return top


@inlined
def _may_meet(mesh, link, r):
    """Bits of the triangles of a leaf that a `CopyRay` may meet."""
    group, n = wide_leaf(link)
    return bits(lines_may_pass(r.filter, group_of(mesh.groups, group * GROUP_WORDS), r.slack)) & ((1 << n) - 1)


@kernel
def walk_copy(scene, i, ray, start, query, hit, counters):
    """Trace a ray through copy i from t = `start` on, and record hits. Return whether this ends an any-hit query."""
    stack, top, link = WideStack(stack_i32(_ROOM), stack_i32(_ROOM)), np.int64(0), np.int64(0)
    mesh, mapped = mesh_pointers(scene, get(scene.mesh, i)), map_ray(scene, i, ray, start)
    r, limit = _copy_ray(mapped), copy_limit(mapped, get(hit.t, 0))
    while True:
        if link >= 0:
            count(counters, NODES, 1)
            count(counters, BOX_TESTS, WIDTH)
            if query.any_hit:
                top = _push_unsorted(mesh.nodes, mesh.links, link, r.slabs, limit, stack, top)
            else:
                top = _push_sorted(mesh.nodes, mesh.links, link, r.slabs, limit, stack, top)
        else:
            lanes, first = _may_meet(mesh, link, r), wide_leaf(link).group * WIDTH
            while lanes:
                lane = lowest_bit(lanes)
                lanes &= lanes - 1
                if test_triangle(scene, i, first + lane, ray, query, hit, counters):
                    if query.any_hit:
                        return True
                    limit = copy_limit(mapped, get(hit.t, 0))
        if not query.any_hit:
            top = _pop_before(stack, top, np.float64(limit))
        if top == 0:
            return False
        top -= 1
        link = np.int64(get(stack.links, top))


@kernel
def walk_instances(scene, ray, query, hit, counters):
    """Find the hit of a ray, any or the nearest (ties: `filters.precedes`). `hit` has the result, and -1 on a miss."""
    stack, top, link = WideStack(stack_i32(_ROOM), stack_i32(_ROOM)), np.int64(0), np.int64(0)
    put(hit.t, 0, ray.tmax)
    put(hit.ids, 0, np.int64(-1))
    f = np.float32
    o, d = (f(ray.ox), f(ray.oy), f(ray.oz)), (f(ray.dx), f(ray.dy), f(ray.dz))
    slabs, start = _slabs(o, d, f(ray.tmin), largest_of(scene.reach), _ZERO), ray.tmin
    while True:
        limit = get(hit.t, 0) * BEYOND
        if link >= 0:
            count(counters, NODES, 1)
            count(counters, BOX_TESTS, WIDTH)
            top = _push_sorted(scene.nodes, scene.links, link, slabs, f(limit), stack, top)
        elif link != EMPTY and walk_copy(scene, ~link, ray, start, query, hit, counters):
            return
        top = _pop_before(stack, top, limit)
        if top == 0:
            return
        top -= 1
        link = np.int64(get(stack.links, top))
        start = max(ray.tmin, np.float64(get(as_f32(stack.keys), top)) * EARLIER)
