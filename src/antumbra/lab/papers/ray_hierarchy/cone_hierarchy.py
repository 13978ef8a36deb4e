"""Ray hierarchies of cones with a common apex [Olsson and Assarsson 2011], and the tracers ``cones:...``.

A cone has a unit axis w and a half-angle a in [0, pi], and stores the lengths of its shortest and longest ray (Sec.
4.3). The tracers are the report's variants and all other combinations of the options.

The tests are those of [Olsson and Assarsson 2011, Sec. 3.2 and 3.3]. Let n be a unit vector, w and a the axis and
half-angle of a cone, and c = n . w. The largest extent of the cone along n, as a share of a ray's length, is

    cos(acos(c) - a) = c cos a + sqrt(1 - c^2) sin a

or 1 if n is in the cone, so planes are tested without a projection. The distances of Sec. 3.2 follow: -c / sin a is an
edge's distance from the centre of the unit circle. Tests are conservative: within the error bounds, a cone is possible.
"""

from typing import NamedTuple

import numpy as np

from ....base.errors import InputError
from ....kernels.exact.filters import cross
from ....kernels.exact.filters import dot as dot3
from ....kernels.jit import inlined, kernel, overload
from ....kernels.simd import absolute, bits, fma, get, load16, maximum, put, select, splat16, square_root
from ....kernels.vec3 import Vec3, dot, rows
from ....techniques.rayhierarchy import ray_tree
from ....techniques.rayhierarchy.cone_tracer import RayHierarchyTracer
from ....techniques.rayhierarchy.light_beams import relative
from ....techniques.rayhierarchy.ray_leaves import block_of
from ....techniques.rayhierarchy.shadow_planes import (
    COVERS,
    INNER,
    OUTER,
    integer,
    number16,
    put_integer,
    put_number,
    sphere_of,
)
from ....techniques.tracer_options import RayHierarchyOptions

# --- Tests of a triangle: precise, of its bounding sphere, and for covered cones --------------------------------------


SPHERE, DIRECTIONS, EXACT = 32, 37, 46
"""Offsets in a row. SPHERE: the triangle's bounding sphere, with the unit vector to its centre, its radius relative to
the centre's distance, and the distance of its nearest point. DIRECTIONS: unit vectors to the corners. EXACT: whether
all rays end at the apex."""

_F = np.float32
_E = _F(2.0**-20)  # exceeds the rounding error of products of unit vectors
TINY = np.float64(1e-30)  # shorter vectors have no direction
_NEAR = _F(2.0**-10)  # corners closer to a cone's axis define no tangential plane


@inlined
def unit_of(v):
    """(v / |v|, |v|); a vector of zero length becomes 0."""
    length = np.sqrt(dot3(v, v))
    s = 1.0 / length if length > TINY else np.float64(0.0)
    return (v[0] * s, v[1] * s, v[2] * s), length


@inlined
def _put_plane(row, at, plane):
    """Write a plane with a unit normal."""
    n, length = unit_of((plane.x, plane.y, plane.z))
    put_number(row, at, n[0])
    put_number(row, at + 1, n[1])
    put_number(row, at + 2, n[2])
    put_number(row, at + 3, plane.m / length if length > TINY else 0.0)


@kernel
def write_cone_row(view, shape, row):
    """Write the row of a triangle's `Shape`. Return True, since this rejects no triangle."""
    corners = shape.a, shape.b, shape.c
    for k in range(4):
        _put_plane(row, OUTER + 4 * k, shape.outer[k])
        _put_plane(row, INNER + 4 * k, shape.inner[k])
    for k in range(3):
        d = unit_of(corners[k])[0]
        put_number(row, DIRECTIONS + 3 * k, d[0])
        put_number(row, DIRECTIONS + 3 * k + 1, d[1])
        put_number(row, DIRECTIONS + 3 * k + 2, d[2])
    centre, radius = sphere_of(shape)
    towards, far = unit_of(centre)
    for k in range(3):
        put_number(row, SPHERE + k, towards[k])
    put_number(row, SPHERE + 3, (radius + view.radius) / max(far, TINY))
    put_number(row, SPHERE + 4, far - (radius + view.radius) - _E * far)
    put_integer(row, EXACT, 1 if view.radius == 0.0 else 0)
    put_integer(row, COVERS, 1 if shape.covers else 0)
    return True


@inlined
def _along(group, ways, row, at):
    """f32x16: n . w for the vector n at offset `at` of a row."""
    y = fma(load16(group, ways), number16(row, at + 1), load16(group, 2 * ways) * number16(row, at + 2))
    return fma(load16(group, 0), number16(row, at), y)


@inlined
def _sine(c):
    """f32x16: an upper bound of sqrt(1 - c^2)."""
    return square_root(maximum(_F(1.0) - c * c, _F(0.0)) + _E)


@inlined
def _may_reach(group, ways, row, at):
    """mask16 of the cones with a possible ray end on the positive side of the outer plane at offset `at` of a row."""
    c, cos, sin = _along(group, ways, row, at), load16(group, 3 * ways), load16(group, 4 * ways)
    k = select(c >= cos - _E, splat16(_F(1.0)), fma(c, cos, _sine(c) * sin)) + _E
    m = number16(row, at + 3)
    length = select(k > _F(0.0), load16(group, 6 * ways), load16(group, 5 * ways))
    return ~(fma(k, length, fma(absolute(m), _E, m)) < _F(0.0))


@inlined
def _meets_sphere(group, ways, row):
    """mask16 of the cones that the sphere may intersect [Roger et al. 2007]."""
    z = _along(group, ways, row, SPHERE)
    x = number16(row, SPHERE) - z * load16(group, 0)
    y = number16(row, SPHERE + 1) - z * load16(group, ways)
    p = Vec3(x, y, number16(row, SPHERE + 2) - z * load16(group, 2 * ways))
    r, nearest = number16(row, SPHERE + 3), number16(row, SPHERE + 4)
    away = square_root(dot(p, p)) * load16(group, 3 * ways) - z * load16(group, 4 * ways)
    return (away <= r + _E) & (nearest <= load16(group, 6 * ways))


@inlined
def _beside(cos, sin, p, length, z, others, heights):
    """mask16 of the cones that the tangential plane towards a corner separates from all corners (Fig. 4b).

    p, z : the corner's direction, across the axis and along it
    others, heights : the same for all three corners
    """
    s = cos / length
    separated = (length > _NEAR) & (cos > _F(0.0))
    for k in range(3):
        separated = separated & (fma(dot(p, others[k]), s, -(sin * heights[k])) > _E)
    return separated


@inlined
def _in_shadow(group, ways, row):
    """mask16 of the cones that miss the triangle: separated by a tangential plane, or wide with the triangle outside.

    Distances from the edges alone do not reject cones in the "triangle shadow", near a corner. A cone wider than a
    half-space is the complement of a convex cone, and misses the triangle if all corners lie in this convex cone.
    """
    w, cos, sin = rows(group, 0, ways), load16(group, 3 * ways), load16(group, 4 * ways)
    at = DIRECTIONS
    z = _along(group, ways, row, at), _along(group, ways, row, at + 3), _along(group, ways, row, at + 6)
    p = _across(row, at, w, z[0]), _across(row, at + 3, w, z[1]), _across(row, at + 6, w, z[2])
    limit = cos - _E
    missed = (cos <= _F(0.0)) & (z[0] < limit) & (z[1] < limit) & (z[2] < limit)
    for k in range(3):
        missed = missed | _beside(cos, sin, p[k], square_root(dot(p[k], p[k])), z[k], p, z)
    return missed


@inlined
def _across(row, at, w, z):
    """`Vec3`: the component of a corner's direction perpendicular to the axes."""
    x, y = number16(row, at) - z * w.x, number16(row, at + 1) - z * w.y
    return Vec3(x, y, number16(row, at + 2) - z * w.z)


@inlined
def possible_cones(group, row, ways, alive, spheres):
    """Bits of the `alive` cones of a group with rays that the triangle may block.

    Both tests reject cones that miss the bounding sphere, or whose longest ray ends before it. So the precise test
    accepts a subset of the cones that the sphere test accepts: without the sphere, it accepts triangles beyond all
    receivers whose plane the cone intersects in front of them, such as walls in line with the light.
    """
    possible = bits(_meets_sphere(group, ways, row)) & alive
    if spheres or possible == 0:
        return possible
    reached = _may_reach(group, ways, row, OUTER) & _may_reach(group, ways, row, OUTER + 4)
    reached = reached & _may_reach(group, ways, row, OUTER + 8) & _may_reach(group, ways, row, OUTER + 12)
    possible &= bits(reached)
    if possible != 0 and integer(row, EXACT) != 0:
        possible &= ~bits(_in_shadow(group, ways, row))
    return possible


@inlined
def _all_beyond(group, ways, row, at):
    """mask16 of the cones whose rays all end on the positive side of the inner plane at offset `at` (Sec. 3.3)."""
    c, cos, sin = _along(group, ways, row, at), load16(group, 3 * ways), load16(group, 4 * ways)
    k = fma(c, cos, -(_sine(c) * sin)) - _E
    narrow = (c > _F(0.0)) & (cos > _F(0.0)) & (k > _F(0.0))
    m = number16(row, at + 3)
    return narrow & (fma(k, load16(group, 5 * ways), fma(absolute(m), -_E, m)) > _F(0.0))


@inlined
def covered_cones(group, row, ways):
    """Bits of the cones whose rays are all blocked by the triangle (early accept, Sec. 3.3)."""
    if integer(row, COVERS) == 0:
        return np.int64(0)
    covered = _all_beyond(group, ways, row, INNER) & _all_beyond(group, ways, row, INNER + 4)
    return bits(covered & _all_beyond(group, ways, row, INNER + 8) & _all_beyond(group, ways, row, INNER + 12))


# --- Nodes ------------------------------------------------------------------------------------------------------------


ROWS = 7  # rows of a node: x, y and z of the axis, cos a, sin a, lengths of the shortest and longest ray
_MORE, _LESS = np.float64(1.0 + 2.0**-20), np.float64(1.0 - 2.0**-20)


class Cones(NamedTuple):
    """The node type of a hierarchy of cones; selects the overloads below."""

    rows: int = ROWS


@inlined
def _plus(a, b):
    return a[0] + b[0], a[1] + b[1], a[2] + b[2]


@inlined
def _wider(w, axis, c, s, cos, sin):
    """(cosine, sine) of the larger of two angles to `w`: that of (c, s), and that of a cone's far side.

    The cone is given by its unit axis, and `cos` and `sin` of its half-angle.
    """
    n = cross(w, axis)
    across, along = np.sqrt(dot3(n, n)), dot3(w, axis)
    far, side = along * cos - across * sin, across * cos + along * sin
    if side < 0.0:  # the angle exceeds pi: all directions
        return np.float64(-1.0), np.float64(0.0)
    return (far, side) if far < c else (c, s)


@inlined
def _put_cone(group, ways, lane, w, c, s, shortest, longest):
    """Write a cone. Its angle and its range of lengths are enlarged slightly to cover rounding."""
    for k in range(3):
        put(group, k * ways + lane, w[k])
    put(group, 3 * ways + lane, max(c - 2.0**-22 * (s + 2.0**-22), -1.0))
    put(group, 4 * ways + lane, min(s + 2.0**-22, 1.0) if c > -1.0 else 0.0)
    put(group, 5 * ways + lane, shortest * _LESS)
    put(group, 6 * ways + lane, longest * _MORE)


@inlined
def _ray_of(view, leaves, at):
    """(direction from the apex, length) of the ray to receiver `at` of a leaf."""
    p = leaves.origins
    x, y, z = get(p, at), get(p, at + leaves.ways), get(p, at + 2 * leaves.ways)
    return unit_of(relative(view, (np.float64(x), np.float64(y), np.float64(z))))


@kernel
def _cone_of_leaf(view, leaves, leaf, group, lane):
    """Write the cone around the rays of a leaf; return whether the leaf has rays."""
    ways, z, lanes = leaves.ways, np.float64(0.0), get(leaves.lanes, leaf)
    w, first = (z, z, z), 3 * block_of(leaves, leaf) * ways
    for i in range(ways):
        if lanes >> i & 1:
            d, length = _ray_of(view, leaves, first + i)
            w = _plus(w, d)
    w = unit_of(w)[0]
    if dot3(w, w) == 0.0:
        w = (np.float64(0.0), np.float64(0.0), np.float64(1.0))
    c, s, shortest, longest = np.float64(2.0), z, np.float64(np.inf), z
    for i in range(ways):
        if lanes >> i & 1:
            d, length = _ray_of(view, leaves, first + i)
            if length > TINY:
                c, s = _wider(w, d, c, s, np.float64(1.0), z)
            else:
                c, s = np.float64(-1.0), z
            shortest, longest = min(shortest, length), max(longest, length)
    _put_cone(group, ways, lane, w, c, s, shortest, longest)
    return lanes != 0


@inlined
def _axis(children, ways, i):
    w = get(children, i), get(children, ways + i), get(children, 2 * ways + i)
    return unit_of((np.float64(w[0]), np.float64(w[1]), np.float64(w[2])))[0]


@inlined
def _angle(children, ways, i):
    """(cosine, sine) of a cone's half-angle.

    They are computed from the smaller of the stored values, because the larger is less accurate in float32.
    """
    cos, sin = np.float64(get(children, 3 * ways + i)), np.float64(get(children, 4 * ways + i))
    if cos > sin:
        return np.sqrt(1.0 - sin * sin), sin
    return cos, np.sqrt(max(1.0 - cos * cos, 0.0))


@kernel
def _cone_of_nodes(children, alive, ways, group, lane):
    """Write the cone around a group of cones."""
    z = np.float64(0.0)
    w = (z, z, z)
    for i in range(ways):
        if alive >> i & 1:
            w = _plus(w, _axis(children, ways, i))
    w = unit_of(w)[0]
    if dot3(w, w) == 0.0:
        w = (np.float64(0.0), np.float64(0.0), np.float64(1.0))
    c, s, shortest, longest = np.float64(2.0), z, np.float64(np.inf), z
    for i in range(ways):
        if alive >> i & 1:
            cos, sin = _angle(children, ways, i)
            c, s = _wider(w, _axis(children, ways, i), c, s, cos, sin)
            shortest = min(shortest, np.float64(get(children, 5 * ways + i)))
            longest = max(longest, np.float64(get(children, 6 * ways + i)))
    _put_cone(group, ways, lane, w, c, s, shortest, longest)


@overload(ray_tree.union_of)
def _union_of(nodes, block, lanes, union):
    if nodes.instance_class is Cones:
        return lambda nodes, block, lanes, union: False


@overload(ray_tree.meet_union)
def _meet_union(nodes, group, union, ways):
    if nodes.instance_class is Cones:
        return lambda nodes, group, union, ways: np.int64(0)


@overload(ray_tree.bound_leaf)
def _bound_leaf(nodes, view, face, leaves, leaf, group, lane):
    if nodes.instance_class is Cones:
        return lambda nodes, view, face, leaves, leaf, group, lane: _cone_of_leaf(view, leaves, leaf, group, lane)


@overload(ray_tree.bound_node)
def _bound_node(nodes, children, alive, ways, group, lane):
    if nodes.instance_class is Cones:
        return lambda nodes, children, alive, ways, group, lane: _cone_of_nodes(children, alive, ways, group, lane)


@overload(ray_tree.write_row)
def _write_row(nodes, view, face, ways, shape, spheres, row):
    if nodes.instance_class is Cones:
        return lambda nodes, view, face, ways, shape, spheres, row: write_cone_row(view, shape, row)


@overload(ray_tree.writes_sixteen)
def _writes_sixteen(nodes):
    if nodes.instance_class is Cones:
        return lambda nodes: False


@overload(ray_tree.possible)
def _possible(nodes, group, row, ways, alive, spheres):
    if nodes.instance_class is Cones:
        return lambda nodes, group, row, ways, alive, spheres: possible_cones(group, row, ways, alive, spheres)


@overload(ray_tree.possible_triangles)
def _possible_triangles(nodes, group, node, block, ways):
    if nodes.instance_class is Cones:
        return lambda nodes, group, node, block, ways: np.int64(0)


@overload(ray_tree.covered)
def _covered(nodes, group, row, ways, among):
    if nodes.instance_class is Cones:
        return lambda nodes, group, row, ways, among: covered_cones(group, row, ways) & among


# --- Tracers ----------------------------------------------------------------------------------------------------------


_EXCLUDE = ("spheres", "precise"), ("spheres", "boxes"), ("precise", "boxes"), ("spheres", "early-accept")

_WORDS = {
    "spheres": "four-way cones in screen order, tested against bounding spheres of triangles",
    "precise": "four-way cones in screen order, tested against triangles",
    "boxes": "the same, with boxes in the light's projection instead of cones",
    "wide": "the same, with sixteen children per node",
    "sorted": "the same, with rays sorted by direction",
    "blocks": "the same, with sorted blocks of 4 x 4 pixels and sixteen children per node",
    "early-accept": "the same, but accepts all rays of a cone at once where a triangle covers it",
    "two-pass": "the same, with good occluders first",
    "backface": "the same, but drops triangles that face culling makes transparent before the traversal",
    "shared": "the same, with one traversal for all samples of a light",
    "shafts": "the same, with shafts where a light is as large as the receivers",
    "clustered": "the same, with triangles in Morton order",
}


def with_words(*words: str) -> RayHierarchyOptions:
    """The options named by the words.

    Without "boxes", nodes are the report's cones; without "spheres", tests are precise (Sec. 3.2).
    """
    flags = {word.replace("-", "_"): True for word in words if word not in ("boxes", "precise")}
    return RayHierarchyOptions(nodes=None if "boxes" in words else Cones, **flags)


_TABLE_1_WORDS = {
    "Precise": ("precise",),
    "PreciseSorted": ("precise", "sorted"),
    "Spheres": ("spheres",),
    "SpheresSorted": ("spheres", "sorted"),
    "PreciseSEA": ("precise", "sorted", "early-accept"),
    "PreciseEATP": ("precise", "early-accept", "two-pass"),
    "PreciseSEATP": ("precise", "sorted", "early-accept", "two-pass"),
}

TABLE_1 = {name: with_words(*words) for name, words in _TABLE_1_WORDS.items()}
"""The variants that the report evaluates, by its names."""


def with_culling(name: str) -> str:
    """The plan of a Table 1 variant that drops culled faces before the traversal, as in the report (Sec. 3.6)."""
    return ":".join(("cones", *_TABLE_1_WORDS[name], "backface"))


CONES: dict[str, tuple[RayHierarchyOptions, str]] = {
    **{f"cones:{word}": (with_words(word), text) for word, text in _WORDS.items()},
    **{f"cones:{name}": (options, f"the report's variant {name}") for name, options in TABLE_1.items()},
}
"""Tracer -> (options, description)."""


def combination(name: str) -> RayHierarchyOptions | None:
    """The options of a name such as ``cones:spheres:sorted``; None for other names.

    Each word may occur once, in any order.

    Raises
    ------
    InputError
        If two options exclude each other.
    """
    family, *words = name.split(":")
    if family != "cones" or not words or len(set(words)) < len(words) or not set(words) <= set(_WORDS):
        return None
    for one, other in _EXCLUDE:
        if one in words and other in words:
            raise InputError(f"tracer {name!r}: {one!r} and {other!r} exclude each other; omit one of them")
    return with_words(*words)


def find_combination(text: str) -> tuple[str, RayHierarchyTracer] | None:
    """(canonical name, tracer) of a combination of options; None for other names.

    The canonical name has its words in the order of `_WORDS`.
    """
    options = combination(text)
    if options is None:
        return None
    family, *words = text.split(":")
    words.sort(key=list(_WORDS).index)
    return ":".join((family, *words)), RayHierarchyTracer(options, "a combination of options")
