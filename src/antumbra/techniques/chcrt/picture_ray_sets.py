"""The ray sets of a picture: shadow segments, passes of one ray per pixel, camera rays, and combinations of them.

Each ray set answers occlusion queries by `occlusion_queries.ask`. Each traces lists of parts by the tracer of its kind
of rays.
"""

from collections.abc import Callable, Sequence
from functools import partial

import numpy as np

from ...bvh.nodes import boxes_of
from ...query.shadow_query import ShadowQuery
from ...scene.camera import CameraRays
from ...scene.lights import AMBIENT, is_list
from ...trace.frusta.multi_frusta import trace_tree_list
from ...trace.light_table import STRATA
from ...trace.packets.packet16 import over_pixels, over_samples
from ...trace.packets.ray_tile import is_far, is_huge, is_incoherent
from ...trace.primary.primary_rays import picture_seen, trace_hits
from ...trace.tile import TileShape, tile_shape
from ...trace.tree_list import Hits, TreeList, no_hits
from ..tracer_options import ChcRtOptions
from .nearest_hits import mark_hits, trace_nearest
from .occlusion_queries import NONE, Answers, Pairs, ScreenRays, ask, picture_of, pixels_of, tiles_of
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
from .tree_parts import Lists, TreeParts, lists_of


class RaySets:
    """The base of ray sets of one kind.

    parts : Parts
    rays : Rays
    sets : int
    front_to_back : bool
        True: rays go through lists front to back; False: in the tree's order of parts.
    """

    front_to_back = True

    def __init__(self, parts: TreeParts, rays: ScreenRays, threads: int):
        self.parts, self.rays, self.threads, self.sets = parts, rays, threads, len(rays.cells)

    @property
    def tiles(self):
        return self.rays.tiles

    def ask(self, pairs: Pairs, threshold: int, again: bool) -> Answers:
        return ask(self.rays, self.parts.lines, pairs, threshold, again, self.threads)

    def marker(self) -> Callable | None:
        return None

    def lists(self, pairs: Pairs, keys: np.ndarray) -> Lists:
        return lists_of(pairs, keys, self.parts, self.tiles.smallest, self.sets, self.front_to_back)

    def forest(self, lists: Lists, sets: int = 1, fresh: bool = False) -> TreeList:
        p, t = self.parts, self.tiles
        return TreeList(p.trees, p.heads, t.pixels, t.across, sets, lists.starts, lists.items, fresh)


class SegmentRaySets(RaySets):
    """The segments of a query to some chunks of its samples: one set for all, or one for each stratum.

    several : one set for each stratum
    trace : the tracer of forests
    """

    front_to_back = False

    def __init__(
        self, parts: TreeParts, options: ChcRtOptions, query: ShadowQuery, bits, chunks, trace, several, **how
    ):
        self.query, self.bits, self.chunks, self.trace_, self.how = query, bits, chunks, trace, how
        first = chunks.start * STRATA
        count = min(len(chunks) * STRATA, query.samples.shape[1] - first)
        shape, sets = tile_shape(query), count if several else 1
        picture, threads = picture_of(shape, *query.sides.shape), how["threads"]
        self.segments = SegmentBundles(query, bits, first, count, sets)
        cells = bound_cells(query, picture, first, count, sets, threads)
        super().__init__(parts, ScreenRays(self.segments, picture, tiles_of(shape, options.tile), cells), threads)
        self.fresh = True

    def trace(self, pairs: Pairs, keys: np.ndarray) -> None:
        lists = self.lists(pairs, keys)
        if not (self.fresh or len(lists.tiles)):
            return
        forest = self.forest(_padded(lists, self.sets), STRATA if self.sets > 1 else 1, self.fresh)
        self.trace_(forest, self.query, self.bits, chunks=self.chunks, **self.how)
        tiles = np.arange(self.tiles.smallest, dtype=np.int32) if self.fresh else lists.tiles
        shorten(self.rays.cells, self.tiles.spans, tiles, self.segments, self.rays.picture, self.threads)
        self.fresh = False


def _padded(lists: Lists, sets: int) -> Lists:
    """The lists of a chunk with fewer than STRATA sets, padded with empty lists to STRATA sets."""
    if sets in (1, STRATA):
        return lists
    counts = np.zeros((len(lists.starts) // sets, STRATA), np.int32)
    counts[:, :sets] = np.diff(lists.starts).reshape(-1, sets)
    return lists._replace(starts=np.concatenate([[0], np.cumsum(counts)]).astype(np.int32))


def segments_of(parts: TreeParts, query: ShadowQuery) -> list[tuple[range, Callable, bool]]:
    """How a query's segments are traced: (chunks of samples, tracer of forests, one set for each stratum).

    Rays to a lamp or the sun are one set, and multi-frusta tracing traces them. Each direction of the hemisphere is a
    set of its own (Sec. 5.3), and packets trace its rays.
    """
    chunks, kind = range(-(-query.samples.shape[1] // STRATA)), query.light.kind
    if is_incoherent(query):
        trace = over_samples if is_list(query.light) else over_pixels
        return [(range(c, c + 1), trace, kind == AMBIENT) for c in chunks]
    wide = is_huge(query, parts.extents) or is_far(query, boxes_of(parts.lines[:1]))
    return [(chunks, over_pixels if wide else trace_tree_list, kind == AMBIENT)]


class HitRays(RaySets):
    """The base of rays that look for hits, `hits` so far."""

    hits: Hits

    def ask(self, pairs: Pairs, threshold: int, again: bool) -> Answers:
        return super().ask(pairs, threshold, False)  # a ray enters the box of its nearest hit before the hit

    def marker(self) -> Callable | None:
        return partial(mark_hits, self.hits, threads=self.threads)


class PassRaySet(HitRays):
    """Rays that look for their nearest hits, or for any hit: one a pixel, or a row of rays."""

    def __init__(self, parts: TreeParts, options: ChcRtOptions, rays: PassRays, threads: int):
        h, w = rays.skip.shape
        if h == 1:
            picture = picture_of(TileShape(16, 1, -(-w // 16), 1), 1, w)
        else:
            picture = pixels_of(h, w, is_spread(rays))
        cells, tiles = bound_rays(picture, rays, threads), tiles_of(picture.shape, options.tile)
        super().__init__(parts, ScreenRays(rays, picture, tiles, cells), threads)
        self.pass_, self.hits = rays, rays.hits

    def marker(self) -> Callable | None:
        return None if self.pass_.any_hit else super().marker()

    def trace(self, pairs: Pairs, keys: np.ndarray) -> None:
        lists, rays = self.lists(pairs, keys), self.rays
        if len(lists.tiles):
            trace_nearest(self.forest(lists), rays.picture, self.pass_, rays.cells[0], self.threads)


class CameraRaySet(HitRays):
    """The rays of a camera through some rows of pixels: their nearest hits.

    rows : slice
        Of the picture, from a multiple of 16. The others have hits in front of everything, so their rays do not look.
    """

    def __init__(
        self, parts: TreeParts, options: ChcRtOptions, camera: CameraRays, rows: slice, reach: float, threads: int
    ):
        self.length, self.hits = length_of(reach), no_hits((camera.height, camera.width))
        self.hits.t[: rows.start], self.hits.t[rows.stop :] = NONE, NONE
        picture, source = pixels_of(*self.hits.t.shape), CameraBundles(camera, self.hits.t, self.length)
        cells, tiles = bound_camera(picture, camera, rows, self.length, threads), tiles_of(picture.shape, options.tile)
        super().__init__(parts, ScreenRays(source, picture, tiles, cells), threads)
        self.seen = picture_seen(camera, parts.boxes[0], self.hits)

    def trace(self, pairs: Pairs, keys: np.ndarray) -> None:
        lists, rays = self.lists(pairs, keys), self.rays
        if len(lists.tiles):
            trace_hits(self.forest(lists), self.seen, self.threads)
            shorten_camera(
                rays.cells[0], self.tiles.spans, lists.tiles, rays.picture, self.hits, self.length, self.threads
            )


class CombinedRaySets:
    """Ray sets of several kinds over one picture, as the sets of one question. A part is read once for all of them."""

    def __init__(self, members: Sequence[RaySets]):
        self.members = members
        self.ends = np.cumsum([member.sets for member in members])
        self.sets, self.tiles = int(self.ends[-1]), members[0].tiles

    def _of_members(self, pairs: Pairs):
        """Yield (member, its pairs with its own numbers of sets, their places) for all members."""
        which = np.searchsorted(self.ends, pairs.set, side="right")
        for i, member in enumerate(self.members):
            mine = np.flatnonzero(which == i)
            first = int(self.ends[i]) - member.sets
            yield member, Pairs(pairs.tile[mine], pairs.set[mine] - np.int32(first), pairs.row[mine]), mine

    def ask(self, pairs: Pairs, threshold: int, again: bool) -> Answers:
        counts, keys, groups = np.zeros(len(pairs.tile), np.int32), np.ones(len(pairs.tile), np.float32), 0
        for member, own, mine in self._of_members(pairs):
            if len(mine):
                answers = member.ask(own, threshold, again)
                counts[mine], keys[mine], groups = answers.counts, answers.keys, groups + answers.groups
        return Answers(counts, keys, groups)

    def trace(self, pairs: Pairs, keys: np.ndarray) -> None:
        for member, own, mine in self._of_members(pairs):
            member.trace(own, keys[mine])

    def marker(self) -> Callable | None:
        markers = [mark for member in self.members if (mark := member.marker()) is not None]

        def mark(first: np.ndarray, marks: np.ndarray) -> None:
            for each in markers:
                each(first, marks)

        return mark if markers else None
