"""Ray hierarchies of cones with a common apex [Olsson and Assarsson 2011], and the tracers ``cones:...``.

The tracers are the report's variants, and any other combination of the options.
"""

from typing import NamedTuple

import numpy as np

from ...engine.method_registry import Tracer, by_cones
from ...errors import InputError
from ...kernels.exact.filters import cross, dot
from ...kernels.jit import inlined, kernel, overload
from ...kernels.simd import get, put
from ...techniques.rayhierarchy import ray_tree as names
from ...techniques.rayhierarchy.light_beams import relative
from ...techniques.rayhierarchy.ray_leaves import block_of
from ...techniques.tracer_options import RayHierarchyOptions
from .cone_tests import TINY, covered_cones, possible_cones, unit_of, write_cone_row

# --- Nodes of a ray hierarchy as cones with a common apex [Olsson and Assarsson 2011] ---------------------------------
#
# A cone has a unit axis w and a half-angle a in [0, pi]. It stores the lengths of its shortest and its longest ray
# (Sec. 4.3).


ROWS = 7  # rows of a node: x, y and z of the axis, cos a, sin a, lengths of the shortest and the longest ray
_MORE, _LESS = np.float64(1.0 + 2.0**-20), np.float64(1.0 - 2.0**-20)


class Cones(NamedTuple):
    """Nodes of a hierarchy; see `nodes`."""

    rows: int = ROWS


@inlined
def _plus(a, b):
    return a[0] + b[0], a[1] + b[1], a[2] + b[2]


@inlined
def _wider(w, axis, c, s, cos, sin):
    """(cosine, sine) of the larger of two angles to `w`: that of (c, s), and that of a cone's far side.

    The cone has the unit vector `axis`, and `cos` and `sin` of its half-angle.
    """
    n = cross(w, axis)
    across, along = np.sqrt(dot(n, n)), dot(w, axis)
    far, side = along * cos - across * sin, across * cos + along * sin
    if side < 0.0:  # an angle of more than pi: all directions
        return np.float64(-1.0), np.float64(0.0)
    return (far, side) if far < c else (c, s)


@inlined
def _put_cone(group, ways, lane, w, c, s, shortest, longest):
    """Write a cone. Its angle and its range of lengths grow a little, to cover rounding."""
    for k in range(3):
        put(group, k * ways + lane, w[k])
    put(group, 3 * ways + lane, max(c - 2.0**-22 * (s + 2.0**-22), -1.0))
    put(group, 4 * ways + lane, min(s + 2.0**-22, 1.0) if c > -1.0 else 0.0)
    put(group, 5 * ways + lane, shortest * _LESS)
    put(group, 6 * ways + lane, longest * _MORE)


@inlined
def _ray_of(view, leaves, at):
    """(direction from the apex, length) of the ray to the receiver at index `at` of a leaf."""
    p = leaves.origins
    x, y, z = get(p, at), get(p, at + leaves.ways), get(p, at + 2 * leaves.ways)
    return unit_of(relative(view, (np.float64(x), np.float64(y), np.float64(z))))


@kernel
def _cone_of_leaf(view, leaves, leaf, group, lane):
    """Write the cone around the rays of a leaf; return whether the leaf has any."""
    ways, z, lanes = leaves.ways, np.float64(0.0), np.int64(get(leaves.lanes, leaf))
    w, first = (z, z, z), 3 * block_of(leaves, leaf) * ways
    for i in range(ways):
        if lanes >> i & 1:
            d, length = _ray_of(view, leaves, first + i)
            w = _plus(w, d)
    w = unit_of(w)[0]
    if dot(w, w) == 0.0:
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

    They follow from the smaller of the stored numbers, because in float32 the larger one is less accurate.
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
    if dot(w, w) == 0.0:
        w = (np.float64(0.0), np.float64(0.0), np.float64(1.0))
    c, s, shortest, longest = np.float64(2.0), z, np.float64(np.inf), z
    for i in range(ways):
        if alive >> i & 1:
            cos, sin = _angle(children, ways, i)
            c, s = _wider(w, _axis(children, ways, i), c, s, cos, sin)
            shortest = min(shortest, np.float64(get(children, 5 * ways + i)))
            longest = max(longest, np.float64(get(children, 6 * ways + i)))
    _put_cone(group, ways, lane, w, c, s, shortest, longest)


@overload(names.union_of)
def _union_of(nodes, block, lanes, union):
    if nodes.instance_class is Cones:
        return lambda nodes, block, lanes, union: False


@overload(names.meet_union)
def _meet_union(nodes, group, union, ways):
    if nodes.instance_class is Cones:
        return lambda nodes, group, union, ways: np.int64(0)


@overload(names.bound_leaf)
def _bound_leaf(nodes, view, face, leaves, leaf, group, lane):
    if nodes.instance_class is Cones:
        return lambda nodes, view, face, leaves, leaf, group, lane: _cone_of_leaf(view, leaves, leaf, group, lane)


@overload(names.bound_node)
def _bound_node(nodes, children, alive, ways, group, lane):
    if nodes.instance_class is Cones:
        return lambda nodes, children, alive, ways, group, lane: _cone_of_nodes(children, alive, ways, group, lane)


@overload(names.write_row)
def _write_row(nodes, view, face, ways, shape, spheres, row):
    if nodes.instance_class is Cones:
        return lambda nodes, view, face, ways, shape, spheres, row: write_cone_row(view, shape, row)


@overload(names.writes_sixteen)
def _writes_sixteen(nodes):
    if nodes.instance_class is Cones:
        return lambda nodes: False


@overload(names.possible)
def _possible(nodes, group, row, ways, alive, spheres):
    if nodes.instance_class is Cones:
        return lambda nodes, group, row, ways, alive, spheres: possible_cones(group, row, ways, alive, spheres)


@overload(names.covered)
def _covered(nodes, group, row, ways, among):
    if nodes.instance_class is Cones:
        return lambda nodes, group, row, ways, among: covered_cones(group, row, ways) & among


# --- The tracers ``cones:...``: the report's variants, and any other combination of the options -----------------------


_EXCLUDE = ("spheres", "precise"), ("spheres", "boxes"), ("precise", "boxes"), ("spheres", "early-accept")

_WORDS = {
    "spheres": "four-way cones in the order of the screen, tested against bounding spheres of triangles",
    "precise": "four-way cones in the order of the screen, tested against triangles",
    "boxes": "the same, boxes in the light's projection instead of cones",
    "wide": "the same, sixteen children to a node",
    "sorted": "the same, rays sorted by direction",
    "blocks": "the same, blocks of 4 x 4 pixels sorted, sixteen children to a node",
    "early-accept": "the same, cones that a triangle covers are done",
    "two-pass": "the same, good occluders first",
    "backface": "the same, triangles that face culling lets through are dropped at once",
    "shared": "the same, one traversal for all samples of a light",
    "shafts": "the same, shafts instead where a light is as large as what it lights",
    "clustered": "the same, triangles in Morton order",
}


def with_words(*words: str) -> RayHierarchyOptions:
    """The options that the words name.

    Without "boxes", nodes are the report's cones. Without "spheres", they are tested precisely (Sec. 3.2).
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
"""The variants that the report evaluates, by the report's names."""


def with_culling(name: str) -> str:
    """The plan of a variant of Table 1 that drops culled faces before the traversal, as the report does (Sec. 3.6)."""
    return ":".join(("cones", *_TABLE_1_WORDS[name], "backface"))


CONES: dict[str, tuple[RayHierarchyOptions, str]] = {
    **{f"cones:{word}": (with_words(word), text) for word, text in _WORDS.items()},
    **{f"cones:{name}": (options, f"the report's variant {name}") for name, options in TABLE_1.items()},
}
"""Name -> (options, description)."""


def combination(name: str) -> RayHierarchyOptions | None:
    """The options of a name such as ``cones:spheres:sorted``; None if it is no such name.

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
            raise InputError(f"tracer {name!r}: {one!r} and {other!r} exclude each other; leave one of them out")
    return with_words(*words)


def find_combination(text: str) -> tuple[str, Tracer] | None:
    """(canonical name, tracer) of a combination of options.

    The canonical name has its words in the order of `_WORDS`.
    """
    options = combination(text)
    if options is None:
        return None
    family, *words = text.split(":")
    words.sort(key=list(_WORDS).index)
    return ":".join((family, *words)), by_cones(options, "a combination of options")
