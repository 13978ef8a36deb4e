"""CHC+RT as a tracer: its state between frames, and how it answers shadow queries and passes of rays."""

from collections.abc import Callable
from threading import Lock
from typing import NamedTuple

import numpy as np

from ..bvh.blocks import block_tree
from ..bvh.nodes import Bvh, boxes_of
from ..kernels.parallel import thread_count
from ..query.bounds import bounds
from ..query.diffuse import RayPass
from ..query.shadow import ShadowQuery
from ..scene.camera import CameraRays
from ..scene.lights import AMBIENT, LIST
from ..trace.forest import Forest, Hits, no_hits
from ..trace.lighttable import STRATA
from ..trace.multifrusta.trace import trace_forest
from ..trace.packets.incoherent import is_far, is_huge, is_incoherent
from ..trace.packets.packet16 import over_pixels, over_samples
from ..trace.primary.trace import picture_seen, trace_hits
from ..trace.querychunk import TileShape, tile_shape
from .camera import CELL, bound_camera, length_of, shorten_camera
from .cells import Picture, bound_cells, picture_of, shorten
from .fronts import Fronts
from .nearest import PictureRays, bound_rays, looks_of, trace_nearest
from .options import Options
from .parts import Parts, parts_of
from .queries import Answers, ask
from .schedule import Lists, trace_frame
from .tiles import Tiles, tiles_of


class Scheduled:
    """A scene ready for CHC+RT, with the visibility states that the last frame left.

    Each query of a frame has its own state. Query n starts from the state of query n of the last frame, if both have
    the same numbers of receivers and rays. So frames are coherent if they ask their queries in the same order. The
    answers never depend on this.

    parts : Parts
    options : Options
    told : list of dict
        The statistics of each query of this frame: see `schedule.Statistics`.
    """

    def __init__(self, parts: Parts, options: Options):
        self.parts, self.options = parts, options
        self._fronts: dict[tuple, Fronts] = {}
        self._lock = Lock()
        self.begin()

    def begin(self) -> None:
        """Begin a new frame."""
        self._questions, self.told = 0, list[dict]()

    def fronts(self, tiles: Tiles, shape: tuple, sets: int) -> Fronts:
        """The state of the frame's next query."""
        key = self._questions, shape, sets
        self._questions += 1
        if key not in self._fronts:
            self._fronts[key] = Fronts(tiles, self.parts, sets, self.options)
        return self._fronts[key]

    def run(self, tiles: Tiles, shape: tuple, sets: int, rays, progress=None) -> None:
        """Trace one ray set, or several together, from the state of the frame's next query."""
        with self._lock:
            fronts = self.fronts(tiles, shape, sets)
            statistics = trace_frame(fronts, rays, progress)
            self.told.append(statistics.as_dict(fronts))


def prepare(bvh: Bvh, options: Options, threads=None) -> Scheduled:
    """The tracer's form of a builder's tree."""
    return Scheduled(parts_of(block_tree(bvh, threads), options), options)


class _Rays(NamedTuple):
    """The data that all ray sets share."""

    tiles: Tiles
    picture: Picture
    cells: np.ndarray  # (sets, regions, ROWS, 16) float32, see `cells.new_cells`
    parts: Parts
    threads: int

    def ask(self, fronts: Fronts, pairs, blind: bool) -> Answers:
        pair = fronts.tile[pairs], fronts.set[pairs], fronts.row[pairs]
        return ask(self.tiles, self.cells, self.parts.lines, *pair, fronts.options.threshold, blind, self.threads)

    def forest(self, lists: Lists, sets: int, fresh: bool) -> Forest:
        p, t = self.parts, self.tiles
        return Forest(p.trees, p.heads, t.pixels, t.across, sets, lists.starts, lists.items, fresh)


class _Shadows:
    """The segments of a query to some chunks of its samples, as ray sets: one for all, or one for each stratum."""

    front_to_back = False

    def __init__(self, scheduled: Scheduled, query: ShadowQuery, bits, chunks: range, trace, several: bool, options):
        self.query, self.bits, self.chunks, self.trace_, self.options = query, bits, chunks, trace, options
        self.first = chunks.start * STRATA
        self.count = min(len(chunks) * STRATA, query.samples.shape[1] - self.first)
        self.sets, threads = self.count if several else 1, options["threads"]
        shape = tile_shape(query)
        picture = picture_of(shape, *query.sides.shape)
        cells = bound_cells(query, picture, self.first, self.count, self.sets, threads)
        self.rays = _Rays(tiles_of(shape, scheduled.options.tile), picture, cells, scheduled.parts, threads)
        self.fresh = True

    def ask(self, fronts, pairs, again):
        return self.rays.ask(fronts, pairs, again)

    def trace(self, lists: Lists) -> None:
        if not (self.fresh or len(lists.tiles)):
            return
        sets = STRATA if self.sets > 1 else 1
        forest = self.rays.forest(_padded(lists, self.sets), sets, self.fresh)
        self.trace_(forest, self.query, self.bits, chunks=self.chunks, **self.options)
        tiles = np.arange(self.rays.tiles.smallest, dtype=np.int32) if self.fresh else lists.tiles
        r = self.rays
        shorten(r.cells, r.tiles.spans, tiles, self.query, r.picture, self.first, self.count, self.bits, r.threads)
        self.fresh = False


def _padded(lists: Lists, sets: int) -> Lists:
    """The lists of a chunk with fewer than STRATA sets, padded with empty lists to STRATA sets."""
    if sets in (1, STRATA):
        return lists
    counts = np.zeros((len(lists.starts) // sets, STRATA), np.int32)
    counts[:, :sets] = np.diff(lists.starts).reshape(-1, sets)
    return lists._replace(starts=np.concatenate([[0], np.cumsum(counts)]).astype(np.int32))


def trace_shadow(scheduled: Scheduled, query: ShadowQuery, bits, threads=None, counters=None, progress=None) -> None:
    """Answer a ShadowQuery: set bit s of ``bits[y, x]`` where sample s is occluded.

    Rays to a lamp or the sun share one visibility state, and multi-frusta tracing traces them. Each direction of the
    hemisphere has its own state (Sec. 5.3), and packets trace its rays.

    bits : (h, w, ceil(spp / 64)) uint64, zeros on entry
    counters : from `new_counters`, or None
    """
    chunks = range(-(-query.samples.shape[1] // STRATA))
    inside = None if scheduled.parts.memory else progress  # out of core, reading parts takes longest: report that
    options = {"threads": thread_count(threads), "counters": counters, "progress": inside}
    kind, steps, trace = query.light.kind, [chunks], trace_forest
    if is_incoherent(query):
        steps, trace = [range(c, c + 1) for c in chunks], over_samples if kind == LIST else over_pixels
    elif is_huge(query, scheduled.parts.extents) or is_far(query, boxes_of(scheduled.parts.lines[:1])):
        trace = over_pixels
    for step in steps:
        rays = _Shadows(scheduled, query, bits, step, trace, kind == AMBIENT, options)
        scheduled.run(rays.rays.tiles, query.sides.shape, rays.sets, rays, progress)


class _Nearest:
    """Closest-hit rays, one a pixel. `bound` makes the cells of their `Picture`."""

    front_to_back = True

    def __init__(self, scheduled: Scheduled, h: int, w: int, threads: int, bound: Callable[[Picture], np.ndarray]):
        shape = TileShape(CELL, CELL, -(-w // CELL), -(-h // CELL))
        picture, tiles = picture_of(shape, h, w), tiles_of(shape, scheduled.options.tile)
        self.hits = no_hits((h, w))
        self.rays = _Rays(tiles, picture, bound(picture), scheduled.parts, threads)

    def ask(self, fronts, pairs, again):
        return self.rays.ask(fronts, pairs, False)  # a ray enters the box of its nearest hit before the hit


class _Pass(_Nearest):
    """A pass of rays as a ray set."""

    def __init__(self, scheduled: Scheduled, rays: PictureRays, reach: float, threads: int):
        self.pass_, self.looks = rays, looks_of(rays, reach, threads)
        super().__init__(
            scheduled, *rays.skip.shape, threads, lambda picture: bound_rays(picture, rays, self.looks, threads)
        )

    def trace(self, lists: Lists) -> None:
        r, forest = self.rays, self.rays.forest(lists, 1, False)
        arrays = r.picture, self.pass_, self.hits, self.looks, r.cells[0], r.threads
        trace_nearest(forest, r.tiles.spans, lists.tiles, *arrays)


class _View(_Nearest):
    """The rays of a camera as a ray set."""

    def __init__(self, scheduled: Scheduled, camera: CameraRays, reach: float, threads: int):
        self.length = length_of(reach)
        super().__init__(
            scheduled, camera.height, camera.width, threads,
            lambda picture: bound_camera(picture, camera, self.length, threads),
        )  # fmt: skip
        self.seen = picture_seen(camera, scheduled.parts.boxes[0], self.hits)

    def trace(self, lists: Lists) -> None:
        r, forest = self.rays, self.rays.forest(lists, 1, False)
        trace_hits(forest, self.seen, r.threads)
        shorten_camera(r.cells[0], r.tiles.spans, lists.tiles, r.picture, self.hits, self.length, r.threads)


def _reach(scheduled: Scheduled, low, high) -> float:
    """The greatest length inside the scene of a ray that starts in the box from `low` to `high`."""
    boxes = scheduled.parts.boxes[0].astype(np.float64)
    return float(np.linalg.norm(np.maximum(boxes[1], high) - np.minimum(boxes[0], low))) + 1e-30


def nearest_hits(scheduled: Scheduled, rays: RayPass, shape: tuple[int, int], threads=None, progress=None) -> Hits:
    """The nearest hit of each ray of a pass over a picture of this shape. Every other method finds the same hits."""
    picture, threads = PictureRays(*(a.reshape(*shape, *a.shape[1:]) for a in rays)), thread_count(threads)
    made = _Pass(scheduled, picture, _reach(scheduled, *bounds(rays.origins, threads)), threads)
    scheduled.run(made.rays.tiles, shape, 1, made, progress)
    return made.hits


def camera_hits(scheduled: Scheduled, rays: CameraRays, threads=None, progress=None) -> Hits:
    """The nearest hits of a camera's rays.

    Raises
    ------
    InputError
        If directions of neighbouring pixels are too close, as in `query.raster.rasterise`.
    """
    view = _View(scheduled, rays, _reach(scheduled, rays.origin, rays.origin), thread_count(threads))
    scheduled.run(view.rays.tiles, (rays.height, rays.width), 1, view, progress)
    return view.hits
