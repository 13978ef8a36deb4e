"""The walk of one ray through a tree on a device: it decides in float32, and lists the tests that float32 leaves open.

A ray tests the boxes of both children of a node at once, by the offsets of `rays.wide_traversal`, and triangles by
`filters.filter_hits`. These functions of vectors serve here with vectors of one lane: one thread traces one ray.

Any hit. A ray ends at its first sure hit. Nearest hit. The bounds of each sure hit's t bound the search, as in
`rays.wide_traversal`: a hit surely nearer than all earlier ones replaces them, one surely behind them is ignored, and
others are rivals, which are listed like undecided tests.

A ray that finds the list full stops, and is traced again later.

`walk_candidates` leaves each test that float32 does not exclude to a *visitor*, which decides at once, in float64.
"""

from typing import NamedTuple

import numpy as np

from ...bvh.nodes import EMPTY, MAX_DEPTH, Reach, bvh_leaf, line_at, link_at
from ...kernels.device import atomic_add, load4_aligned
from ...kernels.exact.filters import (
    FilterRays,
    FilterTriangles,
    filter_hits,
    larger,
    max_magnitude,
    single_error_unit,
)
from ...kernels.jit import F32x4, inlined, overload
from ...kernels.simd import (
    extract,
    f32_at,
    f32_bits,
    fma,
    get,
    i32_at,
    mask_from_bits4,
    maximum,
    minimum,
    put,
    select,
    splat1,
    splat4,
    stack_i32,
    swap_halves,
)
from ..rays.wide_traversal import boxes_fit, largest_of, plane_offsets, raised_to, triangles_fit
from .device_rays import AGAIN, BLOCKED, CLEAR

TRIANGLE = 12  # words of a triangle
PRIM = 3  # its word with the triangle's index
NO_HIT = -1  # instead of the slot of the nearest hit
COUNTS = 5
PAIRS, REST, WON, PARTS, VISITS = range(COUNTS)
"""Elements of `Work.counts`: lengths of the lists, hits written by `settle_nearest`, parts that `find_parts` has added,
and nodes that shafts have visited."""

STACK = MAX_DEPTH + 2
_INF = np.float32(np.inf)


class TreeBuffers(NamedTuple):
    """A binary BVH on a device: addresses and numbers.

    A triangle is 12 words, so that it is read by three loads of 16 bytes: v0, its index (int32 bits), v1, 0, v2, 0.
    """

    nodes: int  # float32, 16 words per node, as in `bvh.nodes.Bvh`
    triangles: int  # float32, TRIANGLE words per slot
    reach: Reach  # of the root's boxes


class Work(NamedTuple):
    """What a launch traces, where its answers go, and its lists. Addresses on the device, and numbers."""

    first: int  # the launch traces rays from this one on
    n: int  # number of rays
    which: int  # int32: the rays of the launch, counted from `first`; 0: all n
    out: int  # int32 per ray from `first` on: its state, or the slot of its nearest hit, NO_HIT or AGAIN
    counts: int  # int32, PAIRS to VISITS; lengths of lists may exceed their capacities
    pairs: int  # int32, (ray from `first` on, slot) of each undecided test; slot -1: the receiver's own surface
    capacity: int  # in pairs
    rest: int  # records that the CPU decides, see `device_kernels`
    rest_capacity: int  # in records
    cull_faces: int  # a value of CULL_FACES


def list_pair(work, j, slot):
    """In kernels: add an undecided test of ray j to the list. Return whether there was room.

    The type of `work` selects the implementation: a `Work`, or what knows more about the test.
    """


@inlined
def _add_pair(work, j, slot):
    at = np.int64(atomic_add(i32_at(work.counts), PAIRS, 1))
    if at >= work.capacity:
        return False
    pairs = i32_at(work.pairs)
    put(pairs, 2 * at, j)
    put(pairs, 2 * at + 1, slot)
    return True


@overload(list_pair)
def _list_pair(work, j, slot):
    return (lambda work, j, slot: _add_pair(work, j, slot)) if work.instance_class is Work else None


# --- Boxes ------------------------------------------------------------------------------------------------------------


class _Axis(NamedTuple):
    """A ray prepared for the planes of two boxes along one axis. Lanes: left and right entry, left and right exit."""

    inverse: F32x4
    offsets: F32x4
    back: bool  # whether it enters through upper planes


class Slabs(NamedTuple):
    """A ray prepared for boxes."""

    x: _Axis
    y: _Axis
    z: _Axis
    tmin: F32x4


@inlined
def axis_between(inverse, near, far):
    """The `_Axis` of an inverse and the offsets of entries and exits, as from `plane_offsets`; float32."""
    offsets = select(mask_from_bits4(3), splat4(near), splat4(far))
    return _Axis(splat4(inverse), offsets, inverse < np.float32(0.0))


@inlined
def _axis_of(o, d, reach, along, turn, fits):
    inverse, near, far = plane_offsets(splat1(o), splat1(d), splat1(reach), splat1(along), splat1(turn), splat1(fits))
    return axis_between(extract(inverse, 0), extract(near, 0), extract(far, 0))


@inlined
def slabs_of(tree, o, d, tmin):
    """The `Slabs` of a ray; o, d, tmin: float32."""
    largest, reach = max_magnitude(d), larger(max_magnitude(o), largest_of(tree.reach))
    fits, (along, turn) = boxes_fit(largest, reach), raised_to(largest, reach)
    return Slabs(
        _axis_of(o[0], d[0], tree.reach[0], along, turn, fits),
        _axis_of(o[1], d[1], tree.reach[1], along, turn, fits),
        _axis_of(o[2], d[2], tree.reach[2], along, turn, fits),
        splat4(tmin),
    )


@inlined
def _times(nodes, at, axis):
    """t at which a ray meets the planes of both boxes along one axis, see `_Axis`."""
    planes = load4_aligned(nodes, at)  # lower left and right, upper left and right
    return fma(select(splat4(axis.back), swap_halves(planes), planes), axis.inverse, axis.offsets)


@inlined
def entries(nodes, node, box, limit):
    """(whether a ray enters the left child's box before `limit`, the right one's, the t of both entries, at most)."""
    at = line_at(node)
    x, y, z = _times(nodes, at, box.x), _times(nodes, at + 4, box.y), _times(nodes, at + 8, box.z)
    near = maximum(maximum(x, y), maximum(z, box.tmin))
    far = minimum(minimum(x, y), minimum(z, splat4(limit)))
    left, right = extract(near, 0), extract(near, 1)
    return left <= extract(far, 2), right <= extract(far, 3), left, right


@inlined
def _descend(tree, link, box, limit, stack, height):
    """(link of the first leaf below a link that a ray enters before `limit`, or EMPTY; the stack's height then)."""
    nodes, links = f32_at(tree.nodes), i32_at(tree.nodes)
    while link >= 0:
        left, right, near_left, near_right = entries(nodes, link, box, limit)
        left_link, right_link = np.int64(get(links, link_at(link, 0))), np.int64(get(links, link_at(link, 1)))
        left_first = near_left <= near_right
        if left and right:
            put(stack, height, right_link if left_first else left_link)
            height += 1
            link = left_link if left_first else right_link
        elif left or right:
            link = left_link if left else right_link
        else:
            link = np.int64(EMPTY)
    return link, height


# --- Triangles --------------------------------------------------------------------------------------------------------


@inlined
def filter_triangle(triangles, slot):
    """(`FilterTriangles` of the triangle in a slot of `TreeBuffers.triangles`, in one lane, its index)."""
    words = f32_at(triangles)
    a, b, c = (
        load4_aligned(words, TRIANGLE * slot),
        load4_aligned(words, TRIANGLE * slot + 4),
        load4_aligned(words, TRIANGLE * slot + 8),
    )
    p, q = b - a, c - a
    px, py, pz, qx, qy, qz = extract(p, 0), extract(p, 1), extract(p, 2), extract(q, 0), extract(q, 1), extract(q, 2)
    size = larger(max_magnitude((px, py, pz)), max_magnitude((qx, qy, qz)))
    triangle = FilterTriangles(
        splat1(extract(a, 0)), splat1(extract(a, 1)), splat1(extract(a, 2)), splat1(px), splat1(py), splat1(pz),
        splat1(qx), splat1(qy), splat1(qz), splat1(size),
    )  # fmt: skip
    return triangle, np.int64(extract(f32_bits(a), PRIM))


@inlined
def filter_ray(tree, o, d, tmin, tmax):
    """`FilterRays` of a ray in one lane; all arguments float32."""
    largest, reach = max_magnitude(d), larger(max_magnitude(o), largest_of(tree.reach))
    span = abs(d[0]) + abs(d[1]) + abs(d[2])
    unit, floor = single_error_unit(triangles_fit(largest, reach), span, reach)
    return FilterRays(
        splat1(o[0]), splat1(o[1]), splat1(o[2]), splat1(d[0]), splat1(d[1]), splat1(d[2]), splat1(tmin), splat1(tmax),
        splat1(unit), splat1(floor),
    )  # fmt: skip


@inlined
def _until(f, limit):
    """A `FilterRays` with another tmax."""
    return FilterRays(f.ox, f.oy, f.oz, f.dx, f.dy, f.dz, f.tmin, splat1(limit), f.unit, f.floor)


@inlined
def counts_with(side, cull_faces):
    """Whether a hit with this sign of d . n counts."""
    return cull_faces == 0 or side != cull_faces


# --- The walk ---------------------------------------------------------------------------------------------------------


@inlined
def walk(tree, r, j, any_hit, work):
    """The state of a ray, or the slot of its nearest hit, NO_HIT or AGAIN. Undecided tests are listed for ray j.

    r : DeviceRay
    any_hit : a literal, so that two kernels share this function
    """
    f = np.float32
    o = f(r.ray.ox), f(r.ray.oy), f(r.ray.oz)
    d = f(r.ray.dx), f(r.ray.dy), f(r.ray.dz)
    tmin, limit, lower = f(r.ray.tmin), f(r.ray.tmax), _INF
    best = np.int64(CLEAR if any_hit else NO_HIT)
    box, line = slabs_of(tree, o, d, tmin), filter_ray(tree, o, d, tmin, limit)
    stack, height, link = stack_i32(STACK), 0, np.int64(0)
    while True:
        link, height = _descend(tree, link, box, limit, stack, height)
        if link != EMPTY:
            leaf = bvh_leaf(link)
            for slot in range(leaf.first, leaf.first + leaf.count):
                triangle, prim = filter_triangle(tree.triangles, slot)
                if prim == r.skip:
                    continue
                tests = filter_hits(line if any_hit else _until(line, limit), triangle)
                sure = tests.hits != 0 and counts_with(1 if tests.positive != 0 else -1, work.cull_faces)
                if any_hit and sure:
                    return np.int64(BLOCKED)
                rival = False
                if sure:
                    near, far = extract(tests.near, 0), extract(tests.far, 0)
                    if near > limit:
                        continue
                    rival = not far < lower
                    if not rival:
                        best = slot
                    lower, limit = near if near < lower else lower, far if far < limit else limit
                if (rival or tests.unsure != 0) and not list_pair(work, j, slot):
                    return np.int64(AGAIN)
        if height == 0:
            return best
        height -= 1
        link = np.int64(get(stack, height))


# --- The walk of a visitor --------------------------------------------------------------------------------------------


GO_ON, UNDECIDED = 0, 3
"""Answers of a visitor besides BLOCKED: the walk goes on; float64 does not suffice, and the CPU traces the ray."""


def visit(visitor, r, slot, prim):
    """In kernels: test the triangle in a slot, whose index is `prim`: GO_ON, or the answer that ends the walk.

    The type of the visitor selects the implementation. Its field `limit` points to a float32, at or behind the largest
    t of interest, which `visit` may reduce.
    """


@inlined
def walk_candidates(tree, r, visitor):
    """Visit the triangles that float32 does not exclude, roughly in the order of t. The last answer of `visit`."""
    f = np.float32
    o = f(r.ray.ox), f(r.ray.oy), f(r.ray.oz)
    d = f(r.ray.dx), f(r.ray.dy), f(r.ray.dz)
    tmin = f(r.ray.tmin)
    box, line = slabs_of(tree, o, d, tmin), filter_ray(tree, o, d, tmin, f(r.ray.tmax))
    stack, height, link = stack_i32(STACK), 0, np.int64(0)
    while True:
        link, height = _descend(tree, link, box, get(visitor.limit, 0), stack, height)
        if link != EMPTY:
            leaf = bvh_leaf(link)
            for slot in range(leaf.first, leaf.first + leaf.count):
                triangle, prim = filter_triangle(tree.triangles, slot)
                if prim == r.skip:
                    continue
                tests = filter_hits(_until(line, get(visitor.limit, 0)), triangle)
                if tests.hits == 0 and tests.unsure == 0:
                    continue
                answer = np.int64(visit(visitor, r, slot, prim))
                if answer != GO_ON:
                    return answer
        if height == 0:
            return np.int64(GO_ON)
        height -= 1
        link = np.int64(get(stack, height))
