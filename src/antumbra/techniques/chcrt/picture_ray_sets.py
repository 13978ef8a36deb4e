"""The ray sets of an image: shadow segments, passes of one ray per pixel, camera rays, and combinations of them.

Each class answers occlusion queries by `occlusion_queries.ask`, and traces its rays through lists of parts with the
tracer for its kind of rays.
"""

from collections.abc import Callable, Iterator, Sequence
from functools import partial
from typing import Any, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from ...base.progress import ProgressCallback
from ...bvh.nodes import boxes_of
from ...query.shadow_query import ShadowQuery
from ...scene.camera import CameraRays
from ...scene.lights import AMBIENT, is_list
from ...trace.frusta.multi_frusta import trace_tree_list
from ...trace.light_table import STRATA
from ...trace.packets.packet16 import over_pixels, over_samples
from ...trace.packets.ray_tile import is_far, is_huge, is_incoherent
from ...trace.primary.primary_rays import primary_picture, sign_hits, trace_hits
from ...trace.tile import TileShape, tile_shape
from ...trace.tree_list import Hits, TreeList, no_hits
from ..tracer_options import ChcRtOptions
from .nearest_hits import mark_hits, trace_nearest
from .occlusion_queries import (
    NONE,
    Answers,
    Pairs,
    ScreenRays,
    Tiles,
    answer_queries,
    cells_of_pixels,
    cells_of_query,
    tiles_of,
)
from .ray_bundles import (
    CameraBundles,
    PassRays,
    SegmentBundles,
    bound_camera,
    bound_cells,
    bound_rays,
    is_spread,
    length_of,
    shorten,
    shorten_camera,
)
from .tree_parts import Lists, Mark, TreeParts, lists_of

TreeListTracer: TypeAlias = Callable[..., None]
"""Tracer of a `TreeList`, with the arguments of `trace.frusta.multi_frusta.trace_tree_list`."""


class RaySets:
    """Base of ray sets of one kind.

    parts : TreeParts
    rays : ScreenRays
    sets : int
    any_hit : bool
        See `visibility_fronts.FrameRaySet`.
    front_to_back : bool
        True: rays traverse their lists of parts front to back; False: in tree order.
    """

    any_hit = False
    front_to_back = True

    def __init__(self, parts: TreeParts, rays: ScreenRays, threads: int):
        self.parts, self.rays, self.threads, self.sets = parts, rays, threads, len(rays.cells)

    @property
    def tiles(self) -> Tiles:
        return self.rays.tiles

    def answer(self, pairs: Pairs, threshold: int) -> Answers:
        return answer_queries(self.rays, self.parts.lines, pairs, threshold, self.threads)

    def trace(self, pairs: Pairs, keys: NDArray[np.float32]) -> NDArray[np.bool_]:
        raise NotImplementedError

    def marker(self) -> Mark | None:
        return None

    def lists(self, pairs: Pairs, keys: NDArray[np.float32]) -> Lists:
        return lists_of(pairs, keys, self.parts, self.tiles.smallest, self.sets, self.front_to_back)

    def forest(self, lists: Lists, sets: int = 1, fresh: bool = False) -> TreeList:
        p, t = self.parts, self.tiles
        blockers = np.zeros(len(lists.items), np.uint8)
        return TreeList(p.trees, p.heads, t.pixels, t.across, sets, lists.starts, lists.items, fresh, blockers)


class SegmentStep(NamedTuple):
    """The segments of a query to some chunks of its samples."""

    query: ShadowQuery
    chunks: range
    trace: TreeListTracer
    several: bool  # one ray set per stratum; otherwise one for all segments


class SegmentRaySets(RaySets):
    """The ray sets of a step; `bits` are those of its query."""

    any_hit = True
    front_to_back = False

    def __init__(
        self,
        parts: TreeParts,
        options: ChcRtOptions,
        step: SegmentStep,
        bits: NDArray[np.uint64],
        threads: int,
        counters: NDArray[np.int64] | None = None,
        progress: ProgressCallback | None = None,
    ):
        query, chunks, self.trace_lists, several = step
        self.query, self.bits, self.counters = query, bits, counters
        self.arguments = {"threads": threads, "counters": counters, "progress": progress, "chunks": chunks}
        first = chunks.start * STRATA
        count = min(len(chunks) * STRATA, query.samples.shape[1] - first)
        shape, sets = tile_shape(query), count if several else 1
        picture = cells_of_query(shape, *query.sides.shape)
        self.segments = SegmentBundles(query, bits, first, count, sets)
        cells = bound_cells(query, picture, first, count, sets, threads)
        super().__init__(parts, ScreenRays(self.segments, picture, tiles_of(shape, options.tile), cells), threads)
        self.fresh = True

    def trace(self, pairs: Pairs, keys: NDArray[np.float32]) -> NDArray[np.bool_]:
        lists, blocking = self.lists(pairs, keys), np.zeros(len(pairs.tile), np.bool_)
        if not (self.fresh or len(lists.tiles)):
            return blocking
        tiles = np.arange(self.tiles.smallest, dtype=np.int32) if self.fresh else lists.tiles
        blocking[lists.order] = self.block(lists, tiles)
        shorten(self.rays.cells, self.tiles.spans, tiles, self.segments, self.rays.picture, self.threads)
        self.fresh = False
        return blocking

    def block(self, lists: Lists, tiles: NDArray[np.int32]) -> NDArray[Any]:
        """Set the bits of segments that the parts of lists block. Return (n,) 1 for the items that block a segment.

        tiles : those with segments to be traced
        """
        forest = self.forest(_padded(lists, self.sets), STRATA if self.sets > 1 else 1, self.fresh)
        self.trace_lists(forest, self.query, self.bits, **self.arguments)
        return forest.blockers


def _padded(lists: Lists, sets: int) -> Lists:
    """Pad the lists of a chunk with fewer than STRATA sets by empty lists, to STRATA sets."""
    if sets in (1, STRATA):
        return lists
    counts = np.zeros((len(lists.starts) // sets, STRATA), np.int32)
    counts[:, :sets] = np.diff(lists.starts).reshape(-1, sets)
    return lists._replace(starts=np.concatenate([[0], np.cumsum(counts)]).astype(np.int32))


def segments_of(parts: TreeParts, query: ShadowQuery) -> list[SegmentStep]:
    """Split a query's segments into steps.

    Rays to a lamp or the sun form one set, traced by multi-frusta tracing. Rays of each hemisphere direction form a set
    of their own (Sec. 5.3), traced by packets.
    """
    chunks, kind = range(-(-query.samples.shape[1] // STRATA)), query.light.kind
    if is_incoherent(query):
        trace = over_samples if is_list(query.light) else over_pixels
        return [SegmentStep(query, range(c, c + 1), trace, kind == AMBIENT) for c in chunks]
    wide = is_huge(query, parts.extents) or is_far(query, boxes_of(parts.lines[:1]))
    return [SegmentStep(query, chunks, over_pixels if wide else trace_tree_list, kind == AMBIENT)]


class HitRays(RaySets):
    """Base of nearest-hit rays; `hits` are their hits so far."""

    hits: Hits

    def marker(self) -> Mark | None:
        return partial(mark_hits, self.hits, threads=self.threads)

    def sign(self) -> None:
        """Write the signed t of all hits, unless tracing has written it."""


class PassRaySet(HitRays):
    """Nearest-hit or any-hit rays: one per pixel, or a row of rays."""

    def __init__(self, parts: TreeParts, options: ChcRtOptions, rays: PassRays, threads: int):
        h, w = rays.skip.shape
        if h == 1:
            picture = cells_of_query(TileShape(16, 1, -(-w // 16), 1), 1, w)
        else:
            picture = cells_of_pixels(h, w, is_spread(rays))
        cells, tiles = bound_rays(picture, rays, threads), tiles_of(picture.shape, options.tile)
        super().__init__(parts, ScreenRays(rays, picture, tiles, cells), threads)
        self.pass_, self.hits, self.any_hit = rays, rays.hits, rays.any_hit

    def marker(self) -> Mark | None:
        return None if self.any_hit else super().marker()

    def trace(self, pairs: Pairs, keys: NDArray[np.float32]) -> NDArray[np.bool_]:
        lists = self.lists(pairs, keys)
        if len(lists.tiles):
            self.find(lists)
        return self._blocking(pairs) if self.any_hit else np.zeros(len(pairs.tile), np.bool_)

    def find(self, lists: Lists) -> None:
        """Find hits in the parts of lists, and update the cells."""
        trace_nearest(self.forest(lists), self.rays.picture, self.pass_, self.rays.cells[0], self.threads)

    def _blocking(self, pairs: Pairs) -> NDArray[np.bool_]:
        """(k,) bool: the final pairs whose part has the hit of a ray."""
        tiles, (y, x) = self.tiles, np.nonzero(self.hits.part >= 0)
        is_hit = np.zeros((tiles.smallest, len(self.parts.trees)), np.bool_)
        is_hit[y // tiles.pixels * tiles.across + x // tiles.pixels, self.hits.part[y, x]] = True
        blocking: NDArray[np.bool_] = is_hit[pairs.tile, pairs.row - self.parts.inner]
        return blocking


class CameraRaySet(HitRays):
    """Nearest hits of camera rays through some rows of pixels.

    rows : slice
        Image rows to trace; starts at a multiple of 16. Rays of other rows are inactive: their t is negative.
    """

    def __init__(
        self, parts: TreeParts, options: ChcRtOptions, camera: CameraRays, rows: slice, reach: float, threads: int
    ):
        self.length, self.hits = length_of(reach), no_hits((camera.height, camera.width))
        self.hits.t[: rows.start], self.hits.t[rows.stop :] = NONE, NONE
        picture, source = cells_of_pixels(*self.hits.t.shape), CameraBundles(camera, self.hits.t, self.length)
        cells, tiles = bound_camera(picture, camera, rows, self.length, threads), tiles_of(picture.shape, options.tile)
        super().__init__(parts, ScreenRays(source, picture, tiles, cells), threads)
        self.picture = primary_picture(camera, parts.boxes[0], self.hits)

    def marker(self) -> Mark:
        def mark(first: NDArray[np.int64], marks: NDArray[np.uint8]) -> None:
            sign_hits(self.parts.trees, self.picture, first, self.threads)
            mark_hits(self.hits, first, marks, self.threads)

        return mark

    def sign(self) -> None:
        trees = self.parts.trees  # hits in trees that have left memory are signed
        sign_hits(trees, self.picture, np.where(trees[:, 0] != 0, 0, -1), self.threads)

    def trace(self, pairs: Pairs, keys: NDArray[np.float32]) -> NDArray[np.bool_]:
        lists = self.lists(pairs, keys)
        if len(lists.tiles):
            self.find(lists)
            self.shorten(lists.tiles)
        return np.zeros(len(pairs.tile), np.bool_)

    def find(self, lists: Lists) -> None:
        """Find the nearest hits in the parts of lists."""
        trace_hits(self.forest(lists), self.picture, self.threads)

    def shorten(self, tiles: NDArray[np.int32]) -> None:
        """Update the cells of some tiles after tracing."""
        cells, picture = self.rays.cells[0], self.rays.picture
        shorten_camera(cells, self.tiles.spans, tiles, picture, self.hits, self.length, self.threads)


class CombinedRaySets:
    """Any-hit or nearest-hit ray sets over one image, traced in one call. A part is read once for all of them."""

    def __init__(self, members: Sequence[RaySets]):
        self.members = members
        self.ends = np.cumsum([member.sets for member in members])
        self.sets, self.tiles, self.any_hit = int(self.ends[-1]), members[0].tiles, members[0].any_hit
        self.parts = members[0].parts

    def _of_members(self, pairs: Pairs) -> Iterator[tuple[RaySets, Pairs, NDArray[np.int64]]]:
        """Yield (member, its pairs with the member's set numbers, their indices in `pairs`) for all members."""
        which = np.searchsorted(self.ends, pairs.set, side="right")
        for i, member in enumerate(self.members):
            indices = np.flatnonzero(which == i)
            first = int(self.ends[i]) - member.sets
            yield member, Pairs(pairs.tile[indices], pairs.set[indices] - np.int32(first), pairs.row[indices]), indices

    def answer(self, pairs: Pairs, threshold: int) -> Answers:
        counts, keys, groups = np.zeros(len(pairs.tile), np.int32), np.ones(len(pairs.tile), np.float32), 0
        for member, member_pairs, indices in self._of_members(pairs):
            if len(indices):
                answers = member.answer(member_pairs, threshold)
                counts[indices], keys[indices], groups = answers.counts, answers.keys, groups + answers.groups
        return Answers(counts, keys, groups)

    def trace(self, pairs: Pairs, keys: NDArray[np.float32]) -> NDArray[np.bool_]:
        blocking = np.zeros(len(pairs.tile), np.bool_)
        for member, member_pairs, indices in self._of_members(pairs):
            blocking[indices] = member.trace(member_pairs, keys[indices])
        return blocking

    def marker(self) -> Mark | None:
        markers = [marker for member in self.members if (marker := member.marker()) is not None]

        def mark(first: NDArray[np.int64], marks: NDArray[np.uint8]) -> None:
            for marker in markers:
                marker(first, marks)

        return mark if markers else None
