"""`srdh`: a BVH with an order of children, built for a sample of the shadow rays [Feltman et al. 2012, Sec. 3.4].

Records are split top-down with the bins of `bsah`. The heuristic of `srdh_cost` chooses the split as long as rays come
to a range. `bsah` takes over where none do. Traversal kernels choose the child that comes first. Constant kernels are
free: the first child is stored as the left one.

Departures from the paper:

- Leaves have more than one triangle.
- The cost of a subtree grows less than linearly with its triangles (`linear`).
- A few evenly spread rays, as the SAH assumes, are added to the given rays (`prior`).
- Orders are chosen once more when the tree is done (`reorder`).

Ranges of few records have few bins.
"""

from functools import cache
from typing import NamedTuple

import numpy as np

from ..errors import InputError
from ..kernels.jit import inlined, kernel, overload
from ..kernels.parallel import thread_count
from ..kernels.simd import as_i32, get, load4, load8, ptr_at, put, stack_array, stack_f32, stack_i32, store
from ..trace.rays.ray_hits import Intersections
from . import binned_sah
from .assemble import assemble
from .bins import BIN_WORDS, binned, clear_bins, fill_bins, make_mapping, partition
from .bounds import range_bounds, write_boxes
from .links import link_at, order_at
from .nodes import MAX_DEPTH, Bvh
from .prepare import PAIR, checked, make_records, power_of_two_for
from .rayorder import order_by_rays
from .rayset import HIT, RAY, ShownRaysPointers, Side, check_intersections, divide_rays, shown_rays
from .splits import must_halve
from .srdh_cost import CONSTANT, DISTANCE, HeuristicSettings, no_ray_split, ray_split
from .srdh_top import RayLevels
from .subtree import Ranges, Settings, build_range, copy_corners, grow, push_range, write_leaf
from .top import build_top
from .top_down import build_below, largest_subtree

PRIOR = 16.0  # 1 to 2 % fewer box tests than without a prior, with rays of 16 x 16 pixels
KERNELS = {"constant": CONSTANT, "distance": DISTANCE, "all": CONSTANT | DISTANCE}
"""Name: traversal kernels to choose from. They are left or right first, front to back or back to front, or all four."""

_WAITING = MAX_DEPTH + 1
_NUMBERS = 4 * _WAITING
_BOXES = 16 * _WAITING
_MOST = 1 << 25  # rays of waiting ranges: a GiB


class RaySettings(NamedTuple):
    """The settings and rays of all ranges below the top."""

    max_leaf: int
    scale: np.float32  # this and the next three as in `srdh_cost.HeuristicSettings`
    kernels: int
    prior: np.float64
    linear: bool
    rays: np.ndarray  # (m, RAY) float32: the `ShownRays` of all ranges that threads build alone, joined
    hits: np.ndarray  # (h, HIT) float32: their hits, joined
    spans: np.ndarray  # (s, 4) int64: first ray, number of rays, first hit, number of hits of each such range
    rooms: np.ndarray  # (s,) int64: capacity for rays below each such range (`_rooms_for`)


def _rooms_for(n_rays: np.ndarray) -> np.ndarray:
    """The capacity for rays below ranges to which `n_rays` rays come.

    All rays may come to the waiting range of each level, to the range that is divided, and to both its sides. Hardly
    any of this memory is ever touched. The capacity is limited to _MOST. Ranges that find no room continue by the SAH.
    """
    return np.minimum((_WAITING + 3) * n_rays, np.maximum(3 * n_rays, _MOST))


def _scratch_words(settings: RaySettings) -> int:
    """The float32 that a thread needs: for the bins of a range, and the hits and rays of the waiting ranges.

    Waiting ranges share the hits of the first set, since each hit is on one side of a split.
    """
    return int(BIN_WORDS + 3 * HIT * settings.spans[:, 3].max() + RAY * settings.rooms.max())


@inlined
def _from(waiting, start):
    """The `ShownRaysPointers` from the position `start`, a `Side`, on."""
    rays = ptr_at(waiting.rays, start.rays * RAY)
    return ShownRaysPointers(rays, as_i32(rays), ptr_at(waiting.hits, start.hits * HIT))


@kernel
def _move_down(waiting, start, n, to):
    """Move n rays and hits from `start` down to `to`; all three are `Side`s."""
    for i in range(n.rays):
        store(waiting.rays, (to.rays + i) * RAY, load8(waiting.rays, (start.rays + i) * RAY))
    for i in range(n.hits):
        store(waiting.hits, (to.hits + i) * HIT, load4(waiting.hits, (start.hits + i) * HIT))


@inlined
def _beyond(start, n, times):
    """The position behind `times` sets of n rays and hits each."""
    return Side(start.rays + times * n.rays, start.hits + times * n.hits)


@kernel
def _leaf_is_cheaper(n, depth, n_rays, cost, settings):
    """Whether a leaf costs less than the split of a range; never for the root."""
    rays = n_rays + settings.prior
    return n <= settings.max_leaf and depth > 0 and not (rays + cost < rays * n)


@kernel
def _choose(source, first, last, depth, box, mapping, rays, n_rays, settings):
    """The `RaySplit` of a range. Axis -1 means that `grow` builds the range."""
    if n_rays == 0 or must_halve(last - first, depth):
        return no_ray_split()
    clear_bins(source.bins, mapping.n_bins)
    fill_bins(source.records, first, last, mapping, source.bins)
    return ray_split(source.bins, rays, n_rays, mapping, box, settings)


@kernel
def _first_set(settings, s, scratch):
    """The stack of waiting ray sets as `ShownRaysPointers`: at first ray set s alone. The next set is on top."""
    first_ray, n_rays, first_hit, n_hits = settings.spans[s]
    rays = ptr_at(scratch, 3 * n_hits * HIT)
    for i in range(n_rays):
        store(rays, i * RAY, load8(settings.rays, (first_ray + i) * RAY))
    for i in range(n_hits):
        store(scratch, i * HIT, load4(settings.hits, (first_hit + i) * HIT))
    return ShownRaysPointers(rays, as_i32(rays), scratch)


@kernel
def _grow_with_rays(source, first, last, depth, box, centroids, settings, s, out):
    """`subtree.grow` from node 1 on, for ray set s; returns the index of the next free node."""
    ranges, spans = Ranges(stack_i32(_NUMBERS), stack_f32(_BOXES)), stack_array(np.int64, _WAITING, 4)
    plain, records, boxes = Settings(settings.max_leaf, settings.scale), source.records, stack_f32(16)
    next_node, waiting = np.int64(1), _first_set(settings, s, ptr_at(source.bins.boxes, BIN_WORDS))
    spans[0, 0], spans[0, 1], spans[0, 2], spans[0, 3] = 0, 0, settings.spans[s, 1], settings.spans[s, 3]
    height = push_range(ranges, 0, first, last, depth, 12, box, centroids)
    while height > 0:
        height -= 1
        b, e = np.int64(get(ranges.numbers, height * 4)), np.int64(get(ranges.numbers, height * 4 + 1))
        d, word = np.int64(get(ranges.numbers, height * 4 + 2)), np.int64(get(ranges.numbers, height * 4 + 3))
        here, centroids = load8(ranges.boxes, height * 16), load8(ranges.boxes, height * 16 + 8)
        start, n = Side(spans[height, 0], spans[height, 1]), Side(spans[height, 2], spans[height, 3])
        mapping = make_mapping(centroids, e - b)
        chosen = _choose(source, b, e, d, here, mapping, _from(waiting, start), n.rays, settings)
        if chosen.split.axis < 0 or start.rays + 3 * n.rays > settings.rooms[s]:
            next_node = grow(source, b, e, d, here, centroids, plain, out, next_node, word)
            continue
        if _leaf_is_cheaper(e - b, d, n.rays, chosen.cost, settings):
            write_leaf(records, b, e, out, word)
            continue
        m = partition(records, b, e, mapping, chosen.split)
        low, low_centroids = range_bounds(records, b, m)
        high, high_centroids = range_bounds(records, m, e)
        store(boxes, 0, low)
        store(boxes, 8, high)
        near, far = _beyond(start, n, 1), _beyond(start, n, 2)
        low_at, high_at = (near, far) if chosen.swapped else (far, near)  # the second child's set is first in memory
        n_low, n_high = divide_rays(
            _from(waiting, start), n.rays, mapping, chosen, boxes, _from(waiting, low_at), _from(waiting, high_at)
        )
        n_second, n_first = (n_low, n_high) if chosen.swapped else (n_high, n_low)
        then = _beyond(start, n_second, 1)
        _move_down(waiting, near, n_second, start)
        _move_down(waiting, far, n_first, then)
        spans[height] = start.rays, start.hits, n_second.rays, n_second.hits
        spans[height + 1] = then.rays, then.hits, n_first.rays, n_first.hits
        put(out.links, word, next_node)
        left, right = link_at(next_node, 0), link_at(next_node, 1)
        if chosen.swapped:
            write_boxes(out.nodes, next_node, high, low)
            height = push_range(ranges, height, b, m, d + 1, right, low, low_centroids)
            height = push_range(ranges, height, m, e, d + 1, left, high, high_centroids)
        else:
            write_boxes(out.nodes, next_node, low, high)
            height = push_range(ranges, height, m, e, d + 1, right, high, high_centroids)
            height = push_range(ranges, height, b, m, d + 1, left, low, low_centroids)
        put(out.links, order_at(next_node), chosen.order)
        next_node += 1
    return next_node


@overload(build_range)
def _build_range(vertices, source, first, last, depth, box, centroids, settings, s, out):
    if settings.instance_class is RaySettings:

        def build(vertices, source, first, last, depth, box, centroids, settings, s, out):
            next_node = _grow_with_rays(source, first, last, depth, box, centroids, settings, s, out)
            copy_corners(vertices, first, last, out)
            return next_node - 1

        return build


@cache
def _compile_top() -> None:
    """Load the kernels that only large scenes run, so that the first build of a process readies all later ones."""
    segment = np.float32([[-1.0, 0.0, 0.1]]), np.float32([[3.0, 3.0, 3.0]])
    rays = shown_rays(Intersections(*segment, np.array([0, 1]), np.zeros(1, np.int32)), PAIR)
    method = binned(2)
    bounds = make_records(PAIR, method.records, 1)
    settings = HeuristicSettings(np.float32(1.0), np.int64(CONSTANT), np.float64(PRIOR), False)
    build_top(2, *bounds, 1, RayLevels(method, rays, settings, 1, 1).split)


def build(
    vertices: np.ndarray,
    threads: int | None = None,
    max_leaf: int = 4,
    *,
    rays: Intersections | None = None,
    kernels: str = "constant",
    prior: float = PRIOR,
    linear: bool = False,
    reorder: bool = True,
) -> Bvh:
    """Build a BVH for shadow rays like `rays`; the same, bit for bit, for any number of threads.

    Parameters
    ----------
    vertices, threads, max_leaf
        As for `binned_sah.build`.
    rays : Intersections
        A sparse sample of the rays that will be traced, with all triangles that each ray meets. With None or an
        empty sample, the tree is that of `bsah`.
    kernels : str
        A name in `KERNELS`: the traversal kernels from which the builder chooses at each node.
    prior : float
        Evenly spread rays, as the SAH assumes, that are added to the rays of each range. With them, few rays do not
        outweigh the SAH. 0 is as published.
    linear : bool
        Whether the cost of a subtree is its number of triangles n, as published. Otherwise it is n to the power of
        3/4, which is nearer to the true cost and makes better trees.
    reorder : bool
        Whether constant orders are chosen once more at the end, when costs are known (`rayorder`). The paper does
        not. It applies only to constant `kernels`.

    Returns
    -------
    Bvh
        With an order at each node to which rays came. A left child follows its parent in memory.

    Raises
    ------
    InputError
        As `binned_sah.build`; also on unknown kernels, an invalid prior, or rays that meet triangles out of range.
    """
    if kernels not in KERNELS:
        raise InputError(f"kernels is {kernels!r}; choose one of {', '.join(KERNELS)}")
    if not 0.0 <= prior < np.inf:
        raise InputError(f"prior is {prior!r}; it must be a number of rays, 0 or more")
    flat, threads = checked(vertices, max_leaf), thread_count(threads)
    n = len(flat)
    if n < 2 or rays is None or len(rays.origins) == 0:
        return binned_sah.build(vertices, threads, max_leaf)
    check_intersections(rays, n)
    _compile_top()
    method = binned(n)
    box, centroids = make_records(flat, method.records, threads)
    heuristic = HeuristicSettings(power_of_two_for(box), np.int64(KERNELS[kernels]), np.float64(prior), bool(linear))
    levels = RayLevels(method, shown_rays(rays, flat), heuristic, largest_subtree(n), threads)
    top = levels.arranged(build_top(n, box, centroids, largest_subtree(n), levels.split))
    found = levels.sets()
    settings = RaySettings(np.int64(max_leaf), *heuristic, *found, _rooms_for(found[2][:, 1]))
    bvh, subtrees = build_below(flat, method, _scratch_words(settings), top, settings, threads)
    del method  # room for the final nodes
    bvh = assemble(bvh, top, subtrees, threads)
    return order_by_rays(bvh, threads, rays=rays) if reorder and kernels == "constant" else bvh
