"""`srdh`: a BVH and child order built for a sample of the shadow rays [Feltman et al. 2012, Sec. 3.4].

Records are split top-down with the bins of `bsah`. As long as rays reach a range, the heuristic of `ray_split` chooses
its split; `bsah` builds the ranges that no rays reach. Traversal kernels determine the child that comes first. Constant
kernels are free, because the first child is stored as the left one.

Departures from the paper:

- Leaves have more than one triangle.
- The cost of a subtree grows sublinearly with its triangle count (`linear`).
- A few uniformly distributed rays, as the SAH assumes, are added to the given rays (`prior`).
- Orders are chosen again once the tree is complete (`reorder`).

Small ranges have fewer bins.

Upper levels. They are built by `top_levels`, with a ray set for each range. All threads share the records of a range,
and one thread processes its rays.

Child order. `order_by_rays` chooses the best child order of a finished tree for sampled rays, by the cost metric of
[Feltman et al. 2012, Sec. 3.2], which a builder can only estimate. Let C be the cost of a subtree for a ray, and let H
be 1 if the ray hits a triangle in the subtree. If the left child A comes first, the cost is

    C = C(A) + (1 - H(A)) C(B)                                           (docs/design/srdh.md, eq. 3)

So the right child B should be first if, over the rays that reach the node,

    sum of H(B) C(A)  >  sum of H(A) C(B)                                (docs/design/srdh.md, eq. 4)

C and H of all subtrees that a ray enters are computed bottom-up. A node's own order does not change C and H of its
children. One pass therefore finds the best order at each node, for the rays that reach it in the old orders. Boxes and
triangles cost 1 each, so all sums are integers.
"""

from functools import cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...base.errors import InputError
from ...bvh import binned_sah
from ...bvh.binned_split import (
    BIN_BOXES,
    BIN_COUNTS,
    BIN_WORDS,
    Binned,
    Bins,
    Split,
    binned,
    cheapest_split,
    clear_bins,
    fill_bins,
    make_mapping,
    must_halve,
    partition,
)
from ...bvh.child_order import swap_children
from ...bvh.nodes import (
    EMPTY,
    LEFT_FIRST,
    LINK,
    MAX_DEPTH,
    ORDER,
    Bvh,
    aligned_empty,
    bvh_leaf,
    line_at,
    link_at,
    order_at,
    parents_first,
)
from ...bvh.top_down import (
    Ranges,
    Settings,
    build_below,
    build_range,
    build_subtree,
    copy_corners,
    largest_binned,
    part_of,
    push_range,
    range_at,
    write_leaf,
)
from ...bvh.top_levels import (
    Level,
    UpperLevels,
    assemble,
    blocks_of,
    build_top,
    join_bins,
    mapping_of_range,
    set_split,
    split_blocks,
)
from ...bvh.triangle_bounds import PAIR, area_scale_for, checked_vertices, make_records, write_boxes
from ...kernels.jit import inlined, kernel, overload
from ...kernels.parallel import items, new_ticket, run, thread_count
from ...kernels.simd import (
    as_i32,
    atomic_add,
    bits,
    load4,
    load8,
    load16,
    maximum,
    minimum,
    ptr,
    ptr_at,
    put,
    splat4,
    stack_array,
    stack_f32,
    stack_i32,
    store,
    swap_halves,
)
from ...trace.rays.ray_hits import Intersections
from .ray_split import (
    CONSTANT,
    DISTANCE,
    GROW,
    HIT,
    RAY,
    HeuristicSettings,
    RayHitSet,
    RayHitSetPointers,
    RaySplit,
    SetSize,
    bounded_rays,
    check_intersections,
    divide_rays,
    no_ray_split,
    ray_at,
    ray_hit_set,
    ray_split,
    rays_of,
)

# --- child order ------------------------------------------------------------------------------------------------------

_CHUNK = 64  # rays per work item
_LEVELS = MAX_DEPTH + 2


class _Frames(NamedTuple):
    """The nodes on the path from the root to a ray's current node, (_LEVELS,) int64 each."""

    node: NDArray[np.int64]  # index of the node
    entered: NDArray[np.int64]  # bits of the children whose boxes the ray enters
    side: NDArray[np.int64]  # next child to visit; 2: none
    comes: NDArray[np.int64]  # 1 if the ray reaches the node in the old orders
    cost: NDArray[np.int64]  # cost of the left child
    hits: NDArray[np.int64]  # 1 if the ray hits a triangle in the left child


@inlined
def _children_entered(nodes, node, ray):
    """Bits of the children whose boxes a ray enters."""
    b = line_at(node)
    x, y, z = (
        (load4(nodes, b) - ray.ox) * ray.ix,
        (load4(nodes, b + 4) - ray.oy) * ray.iy,
        (load4(nodes, b + 8) - ray.oz) * ray.iz,
    )
    u, v, w = swap_halves(x), swap_halves(y), swap_halves(z)
    t_near = maximum(maximum(minimum(x, u), minimum(y, v)), maximum(minimum(z, w), splat4(np.float32(0.0))))
    t_far = minimum(minimum(maximum(x, u), maximum(y, v)), minimum(maximum(z, w), splat4(np.float32(1.0))))
    return bits(t_near <= t_far * GROW) & 3


@inlined
def _leaf(bvh, link, met, ray):
    """(triangle count of a leaf, 1 if the ray hits one of them); `met`: the last ray that hit each triangle."""
    if link == EMPTY:
        return 0, 0
    leaf, hit = bvh_leaf(link), 0
    for slot in range(leaf.first, leaf.first + leaf.count):
        hit |= np.int64(met[bvh.prim_ids[slot]] == ray)
    return leaf.count, hit


@kernel
def _weigh(bvh, box_ray, i, met, frames, gains):
    """Add the cost that ray i saves if the right child comes first to each node's gain."""
    nodes = ptr(bvh.nodes)
    frames.node[0], frames.side[0], frames.comes[0] = 0, 0, 1
    frames.entered[0] = _children_entered(nodes, 0, box_ray)
    depth, cost, hit = 0, 0, 0  # cost, hit: of the last completed child
    while depth >= 0:
        node, side = frames.node[depth], frames.side[depth]
        if side == 1:
            frames.cost[depth], frames.hits[depth] = cost, hit
        if side == 2:
            left_cost, right_cost, met_left = frames.cost[depth], cost, frames.hits[depth]
            if frames.comes[depth] and met_left | hit:
                atomic_add(gains, node, hit * left_cost - met_left * right_cost)
            cost, hit = left_cost + (1 - met_left) * right_cost, hit | met_left
            cost += 1  # this node's own box
            depth -= 1
            continue
        frames.side[depth] += 1
        cost, hit = 1, 0
        if not frames.entered[depth] >> side & 1:
            continue
        link = np.int64(bvh.links[node, LINK + side])
        if link < 0:
            count, hit = _leaf(bvh, link, met, i)
            cost += count
            continue
        comes = frames.comes[depth] if side == 0 or frames.hits[depth] == 0 else 0
        depth += 1
        frames.node[depth], frames.side[depth], frames.comes[depth] = link, 0, comes
        frames.entered[depth] = _children_entered(nodes, link, box_ray)


@kernel
def _weigh_rays(ticket, bvh, rays, intersections, gains, met):
    """Worker: add the gains of each ray. `met` is thread-local memory, -1 for each triangle."""
    frames = _Frames(
        stack_array(np.int64, _LEVELS), stack_array(np.int64, _LEVELS), stack_array(np.int64, _LEVELS),
        stack_array(np.int64, _LEVELS), stack_array(np.int64, _LEVELS), stack_array(np.int64, _LEVELS),
    )  # fmt: skip
    for i in items(ticket):
        for k in range(intersections.first[i], intersections.first[i + 1]):
            met[intersections.prims[k]] = i
        _weigh(bvh, ray_at(ptr(rays), i), i, met, frames, gains)


@kernel
def _choose_orders(bvh, gains):
    """Swap the children of each node if that is the better order."""
    words = ptr(bvh.links)
    for node in range(len(bvh.nodes)):
        if gains[node] != 0:
            bvh.links[node, ORDER] = LEFT_FIRST
        if gains[node] > 0:
            swap_children(words, node)


@kernel
def _copy_nodes(bvh, order, numbers, new_nodes, new_links):
    """Copy the nodes in the depth-first `order`. `numbers` is scratch memory for the new indices."""
    for i in range(len(order)):
        numbers[order[i]] = i
    for i in range(len(order)):
        store(new_nodes, line_at(i), load16(bvh.nodes, line_at(np.int64(order[i]))))
        for side in range(2):
            link = bvh.links[order[i], LINK + side]
            new_links[i, LINK + side] = numbers[link] if link >= 0 else link


def order_by_rays(bvh: Bvh, threads: int | None = None, *, rays: Intersections | None = None) -> Bvh:
    """A copy of the tree with each node's child order chosen for sample rays. Nodes without deciding rays keep theirs.

    Parameters
    ----------
    bvh : Bvh
        It is not modified. Distance-based orders become constant where rays decide.
    rays : Intersections
        A sparse sample of the rays that will be traced, with all triangles that each ray hits. With None or an
        empty sample, `bvh` itself is returned.

    Returns
    -------
    Bvh
        Bitwise identical for any number of threads. A left child follows its parent in memory.

    Raises
    ------
    InputError
        If a ray hits a triangle whose index is out of range.
    """
    if rays is None or len(rays.origins) == 0 or len(bvh.prim_ids) < 2:
        return bvh
    check_intersections(rays, len(bvh.prim_ids))
    m, threads = len(rays.origins), thread_count(threads)
    gains = np.zeros(len(bvh.nodes), np.int64)
    thread_memory = lambda: (np.full(len(bvh.prim_ids), -1, np.int32),)
    run(_weigh_rays, threads, new_ticket(m, _CHUNK), bvh, bounded_rays(rays), rays, gains, own=thread_memory)
    old, new = aligned_empty(bvh.nodes.shape, "f4"), aligned_empty(bvh.nodes.shape, "f4")
    old[:] = bvh.nodes
    reordered = bvh._replace(nodes=old, links=old.view(np.int32))
    _choose_orders(reordered, gains)
    _copy_nodes(reordered, parents_first(reordered.links), np.empty(len(old), np.int32), new, new.view(np.int32))
    return bvh._replace(nodes=new, links=new.view(np.int32))


# --- upper levels -----------------------------------------------------------------------------------------------------

FIRST_RAY, N_RAYS, FIRST_HIT, N_HITS = range(4)  # columns of spans: a range's rays and hits in a `RayHitSet`


@inlined
def start_of(spans, r):
    """The start of range r's ray set, as a `SetSize`."""
    return SetSize(spans[r, FIRST_RAY], spans[r, FIRST_HIT])


@kernel
def _choose_splits(ticket, level, depth, sets, spans, settings, orders):
    """Worker: choose the split and child order of each range."""
    # In: level, a `Level`; depth; sets, the `RayHitSet` of all ranges; spans, (k, 4); settings, `HeuristicSettings`
    # Out: level.splits and level.places; orders, (k, 2) int32: order, 1 if the high side comes first
    total = Bins(stack_f32(BIN_BOXES), stack_i32(BIN_COUNTS))
    for r in items(ticket):
        mapping, choice = mapping_of_range(level, r), no_ray_split()
        if not must_halve(level.ranges[r, 1] - level.ranges[r, 0], depth):
            block, end = blocks_of(level, r)
            join_bins(level, block, end, mapping.n_bins, total)
            if spans[r, N_RAYS] > 0:
                rays, box = rays_of(sets, start_of(spans, r)), load8(ptr(level.boxes), r * 16)
                choice = ray_split(total, rays, spans[r, N_RAYS], mapping, box, settings)
            else:
                split = cheapest_split(total, mapping.n_bins, settings.scale)
                choice = RaySplit(split, choice.order, choice.swapped, choice.cost)
        set_split(level, r, choice.split)
        orders[r, 0], orders[r, 1] = choice.order, choice.swapped


@kernel
def _divide_sets(ticket, level, sides, sets, spans, orders, out, children):
    """Worker: write the ray sets of each range's children."""
    # In: level, sides of `split_blocks`; sets and spans of the ranges; orders of `_choose_splits`
    # Out: out, the children's `RayHitSet`; children, (2 k, 4): their spans, with the starts already set
    boxes = stack_f32(16)
    for r in items(ticket):
        split = Split(level.splits[r, 0], level.splits[r, 1], np.float32(0.0))
        low, high = SetSize(0, 0), SetSize(0, 0)
        if split.axis >= 0 and spans[r, N_RAYS] > 0:
            store(boxes, 0, load8(ptr(sides), r * 32))
            store(boxes, 8, load8(ptr(sides), r * 32 + 16))
            choice = RaySplit(split, np.int64(orders[r, 0]), orders[r, 1] != 0, np.float32(0.0))
            low, high = divide_rays(
                rays_of(sets, start_of(spans, r)), spans[r, N_RAYS], mapping_of_range(level, r), choice, boxes,
                rays_of(out, start_of(children, 2 * r)), rays_of(out, start_of(children, 2 * r + 1)),
            )  # fmt: skip
        children[2 * r, N_RAYS], children[2 * r, N_HITS] = low.rays, low.hits
        children[2 * r + 1, N_RAYS], children[2 * r + 1, N_HITS] = high.rays, high.hits


class RayLevels:
    """Splits the ranges of the upper levels, with a ray set for each range."""

    def __init__(
        self, method: Binned, rays: RayHitSet, settings: HeuristicSettings, largest: int, threads: int
    ) -> None:
        self.method, self.settings, self.largest, self.threads = method, settings, largest, threads
        # the ranges of the current level, in order: number of records, and their rays
        self.counts, self.rays = np.array([len(method.records)]), rays
        self.spans = np.array([[0, len(rays.rays), 0, len(rays.hits)]])
        self.done: list[tuple[RayHitSet, NDArray[np.int64]]] = []  # ranges to be built by one thread each, in order
        self.orders = [np.empty((0, 2), np.int32)]  # of each level, as written by `_choose_splits`

    def split(
        self, ranges: NDArray[np.int64], boxes: NDArray[np.float32], depth: int
    ) -> tuple[NDArray[np.int64], NDArray[np.float32]]:
        """The `split_level` for `build_top`."""
        large = self.counts > self.largest
        self.done.append((self.rays, self.spans[~large]))
        spans, orders = self.spans[large], np.empty((len(ranges), 2), np.int32)
        levels: list[Level] = []

        def choose(level: Level) -> None:
            ticket = new_ticket(len(ranges), 1)
            run(_choose_splits, self.threads, ticket, level, depth, self.rays, spans, self.settings, orders)
            levels.append(level)

        middles, sides = split_blocks(self.method, ranges, boxes, depth, self.threads, choose)
        capacity = np.repeat(spans[:, [N_RAYS, N_HITS]], 2, axis=0)
        children = np.zeros((2 * len(ranges), 4), np.int64)
        children[:, [FIRST_RAY, FIRST_HIT]] = np.cumsum(capacity, axis=0) - capacity
        out = RayHitSet(
            np.empty((capacity[:, 0].sum(), RAY), np.float32), np.empty((capacity[:, 1].sum(), HIT), np.float32)
        )
        ticket = new_ticket(len(ranges), 1)
        run(_divide_sets, self.threads, ticket, *levels, sides, self.rays, spans, orders, out, children)
        self.counts = np.column_stack([middles - ranges[:, 0], ranges[:, 1] - middles]).ravel()
        self.rays, self.spans = out, children
        self.orders.append(orders)
        return middles, sides

    def arranged(self, top: UpperLevels) -> UpperLevels:
        """The upper levels from `build_top`, with the first child of each node on the left."""
        order, swapped = np.concatenate(self.orders).T
        boxes, children = top.boxes.copy(), top.children.copy()
        boxes[swapped != 0] = boxes[swapped != 0, ::-1]
        children[swapped != 0] = children[swapped != 0, ::-1]
        return top._replace(boxes=boxes, children=children, orders=order)

    def sets(self) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.int64]]:
        """(rays, hits, spans) of the remaining ranges, in the order of `UpperLevels.ranges`."""
        done = [(rays, span) for rays, spans in [*self.done, (self.rays, self.spans)] for span in spans]
        rays = [r.rays[s[FIRST_RAY] : s[FIRST_RAY] + s[N_RAYS]] for r, s in done]
        hits = [r.hits[s[FIRST_HIT] : s[FIRST_HIT] + s[N_HITS]] for r, s in done]
        counts = np.array([[len(r), len(h)] for r, h in zip(rays, hits)])
        starts = np.cumsum(counts, axis=0) - counts
        spans = np.stack([starts[:, 0], counts[:, 0], starts[:, 1], counts[:, 1]], axis=1)
        return np.concatenate(rays), np.concatenate(hits), spans


# --- build ------------------------------------------------------------------------------------------------------------

PRIOR = 16.0  # reduces box tests by 1 to 2 % with sample rays of 16 x 16 pixels
KERNELS = {"constant": CONSTANT, "distance": DISTANCE, "all": CONSTANT | DISTANCE}
"""Name -> candidate traversal kernels: left or right first, front to back or back to front, or all four."""

_WAITING = MAX_DEPTH + 1
_NUMBERS = 4 * _WAITING
_BOXES = 16 * _WAITING
MAX_WAITING_RAYS = 1 << 25  # a GiB


class RaySettings(NamedTuple):
    """The settings and rays of all ranges below the upper levels."""

    max_leaf: np.int64
    scale: np.float32  # this and the next three as in `HeuristicSettings`
    kernels: np.int64
    prior: np.float64
    linear: bool
    rays: NDArray[np.float32]  # (m, RAY) float32: the rays of all ranges built by one thread each, concatenated
    hits: NDArray[np.float32]  # (h, HIT) float32: their hits, concatenated
    spans: NDArray[np.int64]  # (s, 4) int64: first ray, number of rays, first hit, number of hits of each such range
    rooms: NDArray[np.int64]  # (s,) int64: capacity for rays below each such range (`_rooms_for`)


def _rooms_for(n_rays: NDArray[np.int64]) -> NDArray[np.int64]:
    """The capacity for rays below ranges that `n_rays` rays reach.

    All rays may reach the waiting range of each level, the range being divided, and both its sides. Hardly any of this
    memory is ever touched. The capacity is limited to `MAX_WAITING_RAYS`. Ranges that exceed it continue by the SAH.
    """
    return np.minimum((_WAITING + 3) * n_rays, np.maximum(3 * n_rays, MAX_WAITING_RAYS))


def _scratch_words(settings: RaySettings) -> int:
    """The number of float32 per thread for the bins of a range, and the hits and rays of the waiting ranges.

    Waiting ranges share the hits of the first set, because each hit is on one side of a split.
    """
    return int(BIN_WORDS + 3 * HIT * settings.spans[:, 3].max() + RAY * settings.rooms.max())


@inlined
def _from(waiting, start):
    """`RayHitSetPointers` from the position `start`, a `SetSize`, on."""
    rays = ptr_at(waiting.rays, start.rays * RAY)
    return RayHitSetPointers(rays, as_i32(rays), ptr_at(waiting.hits, start.hits * HIT))


@kernel
def _move_down(waiting, start, n, to):
    """Move n rays and hits from `start` down to `to`; all three are a `SetSize`."""
    for i in range(n.rays):
        store(waiting.rays, (to.rays + i) * RAY, load8(waiting.rays, (start.rays + i) * RAY))
    for i in range(n.hits):
        store(waiting.hits, (to.hits + i) * HIT, load4(waiting.hits, (start.hits + i) * HIT))


@inlined
def _beyond(start, n, times):
    """The position after `times` sets of n rays and hits each."""
    return SetSize(start.rays + times * n.rays, start.hits + times * n.hits)


@kernel
def _leaf_is_cheaper(n, depth, n_rays, cost, settings):
    """Whether a leaf costs less than the split of a range; always False for the root."""
    rays = n_rays + settings.prior
    return n <= settings.max_leaf and depth > 0 and not (rays + cost < rays * n)


@kernel
def _choose(source, part, mapping, rays, n_rays, settings):
    """The `RaySplit` of a range; axis -1: `build_subtree` builds the range."""
    if n_rays == 0 or must_halve(part.last - part.first, part.depth):
        return no_ray_split()
    clear_bins(source.bins, mapping.n_bins)
    fill_bins(source.records, part.first, part.last, mapping, source.bins)
    return ray_split(source.bins, rays, n_rays, mapping, part.box, settings)


@kernel
def _first_set(settings, s, scratch):
    """The stack of waiting ray sets as `RayHitSetPointers`, with only ray set s at first. The next set is on top."""
    first_ray, n_rays, first_hit, n_hits = settings.spans[s]
    rays = ptr_at(scratch, 3 * n_hits * HIT)
    for i in range(n_rays):
        store(rays, i * RAY, load8(settings.rays, (first_ray + i) * RAY))
    for i in range(n_hits):
        store(scratch, i * HIT, load4(settings.hits, (first_hit + i) * HIT))
    return RayHitSetPointers(rays, as_i32(rays), scratch)


@kernel
def _grow_with_rays(source, part, settings, s, out):
    """`top_down.build_subtree` from node 1 on, for ray set s; returns the index of the next free node."""
    ranges, spans = Ranges(stack_i32(_NUMBERS), stack_f32(_BOXES)), stack_array(np.int64, _WAITING, 4)
    plain, records, boxes = Settings(settings.max_leaf, settings.scale), source.records, stack_f32(16)
    next_node, waiting = 1, _first_set(settings, s, ptr_at(source.bins.boxes, BIN_WORDS))
    spans[0, 0], spans[0, 1], spans[0, 2], spans[0, 3] = 0, 0, settings.spans[s, 1], settings.spans[s, 3]
    height = push_range(ranges, 0, part, LINK)
    while height > 0:
        height -= 1
        part, word = range_at(ranges, height)
        b, e, d = part.first, part.last, part.depth
        start, n = SetSize(spans[height, 0], spans[height, 1]), SetSize(spans[height, 2], spans[height, 3])
        mapping = make_mapping(part.centroids, e - b)
        choice = _choose(source, part, mapping, _from(waiting, start), n.rays, settings)
        if choice.split.axis < 0 or start.rays + 3 * n.rays > settings.rooms[s]:
            next_node = build_subtree(source, part, plain, out, next_node, word)
            continue
        if _leaf_is_cheaper(e - b, d, n.rays, choice.cost, settings):
            write_leaf(records, b, e, out, word)
            continue
        m = partition(records, b, e, mapping, choice.split)
        low, high = part_of(records, b, m, d + 1), part_of(records, m, e, d + 1)
        store(boxes, 0, low.box)
        store(boxes, 8, high.box)
        second_start, first_start = _beyond(start, n, 1), _beyond(start, n, 2)
        low_at, high_at = (
            (second_start, first_start) if choice.swapped else (first_start, second_start)
        )  # the second child's set is first in memory
        n_low, n_high = divide_rays(
            _from(waiting, start), n.rays, mapping, choice, boxes, _from(waiting, low_at), _from(waiting, high_at)
        )
        n_second, n_first = (n_low, n_high) if choice.swapped else (n_high, n_low)
        next_start = _beyond(start, n_second, 1)
        _move_down(waiting, second_start, n_second, start)
        _move_down(waiting, first_start, n_first, next_start)
        spans[height] = start.rays, start.hits, n_second.rays, n_second.hits
        spans[height + 1] = next_start.rays, next_start.hits, n_first.rays, n_first.hits
        put(out.links, word, next_node)
        left_link, right_link = link_at(next_node, 0), link_at(next_node, 1)
        left, right = (high, low) if choice.swapped else (low, high)
        write_boxes(out.nodes, next_node, left.box, right.box)
        height = push_range(ranges, height, right, right_link)
        height = push_range(ranges, height, left, left_link)
        put(out.links, order_at(next_node), choice.order)
        next_node += 1
    return next_node


@overload(build_range)
def _build_range(vertices, source, part, settings, s, out):
    if settings.instance_class is RaySettings:

        def build(vertices, source, part, settings, s, out):
            next_node = _grow_with_rays(source, part, settings, s, out)
            copy_corners(vertices, part.first, part.last, out)
            return next_node - 1

        return build


@cache
def _compile_top() -> None:
    """Load the kernels that only large scenes use, so that the first build of a process prepares for all later ones."""
    segment = np.array([[-1.0, 0.0, 0.1]], np.float32), np.array([[3.0, 3.0, 3.0]], np.float32)
    rays = ray_hit_set(Intersections(*segment, np.array([0, 1]), np.zeros(1, np.int32)), PAIR)
    method = binned(2)
    bounds = make_records(PAIR, method.records, 1)
    settings = HeuristicSettings(np.float32(1.0), np.int64(CONSTANT), np.float64(PRIOR), False)
    build_top(2, *bounds, 1, RayLevels(method, rays, settings, 1, 1).split)


class SrdhOptions(NamedTuple):
    """Options of the builder. `PUBLISHED` are those of the paper.

    The prior keeps a few rays from outweighing the SAH. Sublinear costs are closer to the true ones and yield better
    trees. Only constant orders are chosen again at the end, when costs are known (`order_by_rays`).
    """

    kernels: str = "constant"  # name in `KERNELS`: the traversal kernels from which the builder chooses at each node
    prior: float = PRIOR  # uniformly distributed rays, as the SAH assumes, added to the rays of each range
    linear: bool = False  # whether the cost of a subtree of n triangles is n; otherwise n to the power of 3/4
    reorder: bool = True  # whether orders are chosen again at the end


PUBLISHED = SrdhOptions("all", prior=0.0, linear=True, reorder=False)
"""As in the paper, except for its one triangle per leaf."""

_DEFAULTS = SrdhOptions()


def build(
    vertices: NDArray[np.float32],
    threads: int | None = None,
    max_leaf: int = 4,
    *,
    rays: Intersections | None = None,
    options: SrdhOptions = _DEFAULTS,
) -> Bvh:
    """Build a BVH for shadow rays like `rays`. The result is bitwise identical for any number of threads.

    Parameters
    ----------
    vertices, threads, max_leaf
        As for `binned_sah.build`.
    rays : Intersections
        A sparse sample of the rays that will be traced, with all triangles that each ray hits. With None or an
        empty sample, the tree is that of `bsah`.
    options : SrdhOptions

    Returns
    -------
    Bvh
        With a child order at each node that rays reached. A left child follows its parent in memory.

    Raises
    ------
    InputError
        As `binned_sah.build`; also on unknown kernels, an invalid prior, or rays with triangle indices out of range.
    """
    kernels, prior, linear, reorder = options
    if kernels not in KERNELS:
        raise InputError(f"kernels is {kernels!r}; choose one of {', '.join(KERNELS)}")
    if not 0.0 <= prior < np.inf:
        raise InputError(f"prior is {prior!r}; it must be a number of rays, 0 or more")
    flat, threads = checked_vertices(vertices, max_leaf), thread_count(threads)
    n = len(flat)
    if n < 2 or rays is None or len(rays.origins) == 0:
        return binned_sah.build(vertices, threads, max_leaf)
    check_intersections(rays, n)
    _compile_top()
    method = binned(n)
    box, centroids = make_records(flat, method.records, threads)
    heuristic = HeuristicSettings(area_scale_for(box), np.int64(KERNELS[kernels]), np.float64(prior), bool(linear))
    levels = RayLevels(method, ray_hit_set(rays, flat), heuristic, largest_binned(n), threads)
    top = levels.arranged(build_top(n, box, centroids, largest_binned(n), levels.split))
    sets = levels.sets()
    settings = RaySettings(np.int64(max_leaf), *heuristic, *sets, _rooms_for(sets[2][:, 1]))
    bvh, subtrees = build_below(flat, method, _scratch_words(settings), top, settings, threads)
    del method  # frees memory for the final nodes
    bvh = assemble(bvh, top, subtrees, threads)
    return order_by_rays(bvh, threads, rays=rays) if reorder and kernels == "constant" else bvh
