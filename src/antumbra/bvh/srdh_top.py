"""The first levels of an `srdh` build: the levels of `top`, with a ray set for each range.

All threads share the records of a range. One thread treats its rays.
"""

import numpy as np

from ..kernels.jit import inlined, kernel
from ..kernels.parallel import items, new_ticket, run
from ..kernels.simd import load8, ptr, stack_f32, stack_i32, store
from .bins import BIN_BOXES, BIN_COUNTS, Binned, Bins, cheapest_split
from .rayset import HIT, RAY, ShownRays, Side, divide_rays, rays_of
from .splits import Split, must_halve
from .srdh_cost import HeuristicSettings, RaySplit, no_ray_split, ray_split
from .top import UpperLevels, blocks_of, join_bins, mapping_of_range, set_split, split_blocks

FIRST_RAY, N_RAYS, FIRST_HIT, N_HITS = range(4)  # columns of spans: a range's rays and hits in a `ShownRays`


@inlined
def start_of(spans, r):
    """The start of range r's ray set, as a `Side`."""
    return Side(spans[r, FIRST_RAY], spans[r, FIRST_HIT])


@kernel
def _choose_splits(ticket, level, depth, sets, spans, settings, orders):
    """Worker: choose the split of each range, and the order of its children."""
    # In: level, a `Level`; depth; sets, the `ShownRays` of all ranges; spans, (k, 4); settings, `HeuristicSettings`
    # Out: level.splits and level.places; orders, (k, 2) int32: order, 1 if the high side comes first
    total = Bins(stack_f32(BIN_BOXES), stack_i32(BIN_COUNTS))
    for r in items(ticket):
        mapping, chosen = mapping_of_range(level, r), no_ray_split()
        if not must_halve(level.ranges[r, 1] - level.ranges[r, 0], depth):
            block, end = blocks_of(level, r)
            join_bins(level, block, end, mapping.n_bins, total)
            if spans[r, N_RAYS] > 0:
                rays, box = rays_of(sets, start_of(spans, r)), load8(ptr(level.boxes), r * 16)
                chosen = ray_split(total, rays, spans[r, N_RAYS], mapping, box, settings)
            else:
                split = cheapest_split(total, mapping.n_bins, settings.scale)
                chosen = RaySplit(split, chosen.order, chosen.swapped, chosen.cost)
        set_split(level, r, chosen.split)
        orders[r, 0], orders[r, 1] = chosen.order, chosen.swapped


@kernel
def _divide_sets(ticket, level, sides, sets, spans, orders, out, children):
    """Worker: write the ray sets of each range's children."""
    # In: level, sides of `split_blocks`; sets and spans of the ranges; orders of `_choose_splits`
    # Out: out, the children's `ShownRays`; children, (2 k, 4): their spans, with the starts already set
    boxes = stack_f32(16)
    for r in items(ticket):
        split = Split(level.splits[r, 0], level.splits[r, 1], np.float32(0.0))
        low, high = Side(np.int64(0), np.int64(0)), Side(np.int64(0), np.int64(0))
        if split.axis >= 0 and spans[r, N_RAYS] > 0:
            store(boxes, 0, load8(ptr(sides), r * 32))
            store(boxes, 8, load8(ptr(sides), r * 32 + 16))
            chosen = RaySplit(split, np.int64(orders[r, 0]), orders[r, 1] != 0, np.float32(0.0))
            low, high = divide_rays(
                rays_of(sets, start_of(spans, r)), spans[r, N_RAYS], mapping_of_range(level, r), chosen, boxes,
                rays_of(out, start_of(children, 2 * r)), rays_of(out, start_of(children, 2 * r + 1)),
            )  # fmt: skip
        children[2 * r, N_RAYS], children[2 * r, N_HITS] = low.rays, low.hits
        children[2 * r + 1, N_RAYS], children[2 * r + 1, N_HITS] = high.rays, high.hits


class RayLevels:
    """Splits the ranges of the top, level by level, and keeps the ray set of each range."""

    def __init__(self, method: Binned, rays: ShownRays, settings: HeuristicSettings, largest: int, threads: int):
        self.method, self.settings, self.largest, self.threads = method, settings, largest, threads
        # the ranges of the last level, in order: number of records, and their rays
        self.counts, self.rays = np.array([len(method.records)]), rays
        self.spans = np.array([[0, len(rays.rays), 0, len(rays.hits)]])
        self.done: list[tuple[ShownRays, np.ndarray]] = []  # ranges that one thread each builds, in order
        self.orders = [np.empty((0, 2), np.int32)]  # of each level, as `_choose_splits` writes them

    def split(self, ranges, boxes, depth):
        """The `split_level` for `build_top`."""
        large = self.counts > self.largest
        self.done.append((self.rays, self.spans[~large]))
        spans, orders, found = self.spans[large], np.empty((len(ranges), 2), np.int32), []

        def choose(level):
            ticket = new_ticket(len(ranges), 1)
            run(_choose_splits, self.threads, ticket, level, depth, self.rays, spans, self.settings, orders)
            found.append(level)

        middles, sides = split_blocks(self.method, ranges, boxes, depth, self.threads, choose)
        room = np.repeat(spans[:, [N_RAYS, N_HITS]], 2, axis=0)
        children = np.zeros((2 * len(ranges), 4), np.int64)
        children[:, [FIRST_RAY, FIRST_HIT]] = np.cumsum(room, axis=0) - room
        out = ShownRays(np.empty((room[:, 0].sum(), RAY), np.float32), np.empty((room[:, 1].sum(), HIT), np.float32))
        ticket = new_ticket(len(ranges), 1)
        run(_divide_sets, self.threads, ticket, *found, sides, self.rays, spans, orders, out, children)
        self.counts = np.column_stack([middles - ranges[:, 0], ranges[:, 1] - middles]).ravel()
        self.rays, self.spans = out, children
        self.orders.append(orders)
        return middles, sides

    def arranged(self, top: UpperLevels) -> UpperLevels:
        """The top of `build_top`, with the first child of each node on the left."""
        order, swapped = np.concatenate(self.orders).T
        boxes, children = top.boxes.copy(), top.children.copy()
        boxes[swapped != 0] = boxes[swapped != 0, ::-1]
        children[swapped != 0] = children[swapped != 0, ::-1]
        return top._replace(boxes=boxes, children=children, orders=order)

    def sets(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """(rays, hits, spans) of the remaining ranges, in the order of `UpperLevels.ranges`."""
        done = [(rays, span) for rays, spans in [*self.done, (self.rays, self.spans)] for span in spans]
        rays = [r.rays[s[FIRST_RAY] : s[FIRST_RAY] + s[N_RAYS]] for r, s in done]
        hits = [r.hits[s[FIRST_HIT] : s[FIRST_HIT] + s[N_HITS]] for r, s in done]
        counts = np.array([[len(r), len(h)] for r, h in zip(rays, hits)])
        starts = np.cumsum(counts, axis=0) - counts
        spans = np.stack([starts[:, 0], counts[:, 0], starts[:, 1], counts[:, 1]], axis=1)
        return np.concatenate(rays), np.concatenate(hits), spans
