"""Measures walkthroughs out of core [Mattausch et al. 2015, Sec. 5.4, Tables 2 to 4], a rival, and several bounces.

Only part of the triangles is in memory. The eviction policies run one after the other, because each may fill the
memory. Before each walkthrough, the store's pages are dropped from the cache of the operating system; while it runs,
the system may cache pages that are read twice.
"""

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import lru_cache, partial
from itertools import islice, product
from math import inf
from pathlib import Path
from typing import NamedTuple, cast

import numpy as np
from numpy.typing import NDArray

from ....base.errors import InputError
from ....base.progress import clock_seconds
from ....bvh.nodes import Bvh
from ....engine.paged_scene import PagedScene
from ....engine.plan_records import precompile_plan
from ....engine.precompilation import precompile
from ....engine.sources.paged_source import RESERVED, Paged
from ....engine.sources.source_protocols import CameraView
from ....picture.frame_request import PASS_BYTES, Request, frame_memory
from ....picture.render_options import RenderOptions
from ....picture.renderer import Renderer
from ....query.light_samples import light_samples
from ....query.query_bounds import morton_codes
from ....query.ray_passes import RayPass, diffuse_passes, diffuse_rays
from ....query.shadow_query import Surfaces, surface_queries
from ....scene.camera import Camera
from ....scene.lights import AmbientOcclusion
from ....store.store_file import Store
from ....store.system_resources import drop_cached_pages, release_freed, resident_memory, storage_bytes
from ....techniques.chcrt.chc_rt import ChcRtState
from ....trace.rays import ray_hits
from ..bench_runner import Say
from ..benchmark_views import digest
from ..published_methods import THRESHOLDS, tracer_name
from . import mapped_tree
from .mapped_tree import map_tree
from .walkthrough_timing import (
    CHCRT,
    Digests,
    Pace,
    Turn,
    Walked,
    Walks,
    begin,
    colour_bleeding,
    error_of,
    options_of,
    statistics_counter,
)
from .walkthroughs import (
    DIFFUSE,
    KINDS,
    PASSES,
    SAMPLER,
    SPP,
    VIEWS,
    Answer,
    Culling,
    FrameRays,
    Plain,
    Walk,
    WalkPlace,
    frame_rays,
    timed,
)

# --- A store with a memory limit --------------------------------------------------------------------------------------


class StoreCase(NamedTuple):
    """A scene in a store, and its memory limit."""

    place: WalkPlace
    threads: int
    max_memory: int | None = None  # limit in bytes on the process; None: the default
    share: float | None = (
        None  # instead: about this share of the chunks in memory, apart from the rays, as in the paper
    )

    @property
    def store(self) -> Store:
        """The store; InputError if the scene is in memory."""
        if self.place.scene.data.resident:
            raise InputError(f"{self.place.name}: not a store; use --scene instead of --store")
        return cast(PagedScene, self.place.scene).store

    def begin(self, paged: Paged, camera: Camera) -> None:
        """Begin a frame of the store."""
        memory = frame_memory(_request(self.place, camera))
        if self.share is None:
            paged.begin(memory)
            return
        residency, whole = paged.residency, sum(map(paged.residency.max_bytes, range(len(self.store))))
        chunks = max(int(self.share * whole), residency.min_budget())
        release_freed()
        others = resident_memory() - residency.held + memory.fixed + RESERVED
        paged.limit = others + 2 * (chunks + memory.passes + memory.cells)
        paged.begin(memory)
        residency.budget = chunks
        residency.trim()


@contextmanager
def opened(case: StoreCase) -> Iterator[Paged]:
    """The store of a scene, with no chunk in memory, nor in the cache of the operating system."""
    drop_cached_pages(case.store.path)
    renderer = Renderer(case.place.scene, None, case.threads, max_memory=case.max_memory)
    precompile_plan(renderer.plan, "rays")
    precompile("light that bounces (rays)")
    paged = cast(Paged, renderer.source)
    scheduled = paged.accelerated.prepared
    scheduled.options = scheduled.options._replace(tile=options_of(case.place).tile)
    try:
        yield paged
    finally:
        paged.residency.close()


def _look(paged: Paged, camera: Camera) -> Surfaces:
    """The surfaces that a camera sees."""
    tree = paged.accelerated
    return paged.look(CameraView(camera, tree.triangles, tree, slice(0, camera.height)))


def _request(place: WalkPlace, camera: Camera) -> Request:
    """A frame request with the benchmark's rays."""
    lights = [AmbientOcclusion(place.reach), place.light]
    samples = [light_samples(lights[0], PASSES, SAMPLER), light_samples(lights[1], SPP)]
    return Request(camera, lights, RenderOptions(), samples, passes=[diffuse_passes([place.light], PASSES, SAMPLER)])


def _moved(before: NamedTuple, paged: Paged) -> dict[str, int]:
    """The paging counts since `before`."""
    after = paged.residency.paging
    return {name: b - a for name, a, b in zip(after._fields, before, after)}


# --- All ray kinds ----------------------------------------------------------------------------------------------------


MakeCase = Callable[[], StoreCase]
"""Returns the case; the first call may build its store."""


def out_of_core(case: MakeCase, pace: Pace, policies: Sequence[str], say: Say) -> Walks:
    """Walkthroughs under each eviction policy, the `method` of its turns."""
    for policy, view in product(policies, VIEWS):
        yield f"{view}, {policy}", partial(_under_policy, case, view, policy, pace, say)


def _under_policy(case: MakeCase, view: str, policy: str, pace: Pace, say: Say) -> Walked:
    made = case()
    with opened(made) as paged:
        paged.residency.policy = policy
        return walk_through_store(made, made.place.walk(view), paged, policy, pace, say)


def walk_through_store(case: StoreCase, walk: Walk, paged: Paged, name: str, pace: Pace, say: Say) -> Walked:
    """A walkthrough with all ray kinds; `name` is the `method` of the turns."""
    place, threads = case.place, case.threads
    method = Culling(name, paged.accelerated.prepared, threads)
    turns: list[Turn] = []
    digests: Digests = []
    for frame, camera in pace.along(walk, f"{place.name}, {walk.name}, {name}", say):
        rays: FrameRays | None = None
        case.begin(paged, camera)
        method.together = paged.together(PASS_BYTES * camera.width * camera.height)
        begin([method])
        for kind in KINDS:
            before, statistics = paged.residency.paging, statistics_counter(method)
            if rays is None:  # camera rays are timed with making the surfaces, whose triangles are in the chunks
                began = clock_seconds()
                surfaces = _look(paged, camera)
                seconds = clock_seconds() - began
                answers: list[Answer] = [(surfaces.ids, surfaces.gbuffer.depth)]
                rays = frame_rays(place, camera, surfaces, SAMPLER, threads)
            else:
                seconds, answers = timed(method, rays, kind)
            moved = _moved(before, paged)
            query = _query(walk, camera, frame, kind)
            digests += [(query, digest(a for answer in answers for a in answer)), _hits_digest(query, answers)]
            where = place.name, walk.name, SAMPLER, kind, name, frame
            turns.append(Turn(*where, rays.rays(kind), seconds, {**statistics(), **moved}, 0))
    return Walked(turns, digests)


def _query(walk: Walk, camera: Camera, frame: int, kind: str) -> str:
    """The query of a frame's rays, which names their answers."""
    return f"{walk.name}, {camera.width} x {camera.height}, {frame}, {kind}"


def _hits_digest(query: str, answers: Sequence[Answer]) -> tuple[str, bytes]:
    """The digest of the blocked segments or of the triangles that rays hit."""
    return f"{query}, hits", digest(answer[0] for answer in answers)


def map_through(case: MakeCase, tree: Callable[[], Path], pace: Callable[[], Pace], say: Say) -> Walks:
    """Walkthroughs by the ordinary tracer in a memory-mapped tree; see `mapped_tree`.

    tree : returns the folder of the tree's files
    pace : returns the pace, whose time limit does not apply
    """
    for view in VIEWS:
        yield view, partial(_mapped, case, tree, view, pace, say)


def _mapped(case: MakeCase, tree: Callable[[], Path], view: str, pace: Callable[[], Pace], say: Say) -> Walked:
    name, made = mapped_tree.NAME, case()
    place, threads, walk = made.place, made.threads, made.place.walk(view)
    with opened(StoreCase(place, threads)) as paged:  # makes the surfaces that rays start from
        turns, digests = list[Turn](), Digests()
        method = Plain(mapped_tree.TRACER, *map_tree(tree()), threads)
        for frame, camera in pace()._replace(limit=inf).along(walk, f"{place.name}, {walk.name}, {name}", say):
            paged.begin(frame_memory(_request(place, camera)))
            rays = frame_rays(place, camera, _look(paged, camera), SAMPLER, threads)
            for kind in KINDS:
                before = storage_bytes()
                seconds, answers = timed(method, rays, kind)
                read = {} if before is None else {"bytes": (storage_bytes() or 0) - before}
                digests.append(_hits_digest(_query(walk, camera, frame, kind), answers))
                where = place.name, walk.name, SAMPLER, kind, name, frame
                turns.append(Turn(*where, rays.rays(kind), seconds, dict[str, float](read), 0))
        return Walked(turns, digests)


# --- A rival with the same memory limit -------------------------------------------------------------------------------


RIVAL = "in order"
"""The rival: CHC+RT's kernel, chunks and memory limit, but blocks of pixels one after the other."""

_ROWS = 32  # rows of a block


def rival_through(case: MakeCase, pace: Pace, say: Say) -> Walks:
    """Walkthroughs of diffuse rays by CHC+RT and by the rival.

    A tracer that pages on demand ends a block of pixels before it begins the next one, so blocks read the same chunks
    again. CHC+RT traces all rays of the picture that may meet a chunk while it is in memory.
    """
    for view in VIEWS:
        yield view, partial(_beside_rival, case, view, pace.shorter(), say)


def _beside_rival(case: MakeCase, view: str, pace: Pace, say: Say) -> Walked:
    made, turns, digests = case(), list[Turn](), Digests()
    for name in (CHCRT, RIVAL):
        with opened(made) as paged:
            walked = _diffuse_through(made, made.place.walk(view), paged, name, pace, say)
        pace = pace._replace(most=len(walked.turns), limit=inf)  # the rival traces the same frames
        turns, digests = turns + walked.turns, digests + walked.digests
    return Walked(turns, digests)


def _diffuse_through(case: StoreCase, walk: Walk, paged: Paged, name: str, pace: Pace, say: Say) -> Walked:
    place, threads, exact = case.place, case.threads, paged.accelerated.prepared
    method, turns, digests = Culling(name, exact, threads), list[Turn](), Digests()
    for frame, camera in pace.along(walk, f"{place.name}, {walk.name}, {name}", say):
        case.begin(paged, camera)
        method.together = paged.together(PASS_BYTES * camera.width * camera.height)
        begin([method])
        rays = frame_rays(place, camera, _look(paged, camera), SAMPLER, threads)
        before = paged.residency.paging
        seconds, answers = _in_blocks(exact, rays, threads) if name == RIVAL else timed(method, rays, DIFFUSE)
        digests.append(_hits_digest(_query(walk, camera, frame, DIFFUSE), answers))
        where = place.name, walk.name, SAMPLER, DIFFUSE, name, frame
        turns.append(Turn(*where, rays.rays(DIFFUSE), seconds, dict[str, float](_moved(before, paged)), 0))
        del rays, answers  # free their memory for the next frame
    return Walked(turns, digests)


def _in_blocks(exact: ChcRtState, rays: FrameRays, threads: int) -> tuple[float, list[Answer]]:
    """(seconds to trace the diffuse rays block by block, answers)."""
    height, width = rays.shape
    seconds, answers = 0.0, list[Answer]()
    for each in rays.diffuse():
        for first in range(0, height, _ROWS):
            rows = slice(first * width, min(first + _ROWS, height) * width)
            block = RayPass(*(array[rows] for array in each))
            state = ChcRtState(exact.parts, exact.options._replace(keep=False))
            state.room = exact.room
            began = clock_seconds()
            answers += Culling(RIVAL, state, threads).answer([block], (len(block.origins) // width, width))
            seconds += clock_seconds() - began
    return seconds, answers


# --- Aggressive mode --------------------------------------------------------------------------------------------------


def aggressive_out_of_core(case: MakeCase, pace: Pace, say: Say) -> Walks:
    """Table 4 out of core, where it matters most: aggressive diffuse rays after exact camera rays."""
    for view in VIEWS:
        yield view, partial(_aggressive, case, view, pace, say)


def _aggressive(case: MakeCase, view: str, pace: Pace, say: Say) -> Walked:
    made, turns, pictures = case(), list[Turn](), list[np.ndarray]()
    for threshold in THRESHOLDS:
        with opened(made) as paged:
            turns += _bleed_through(made, made.place.walk(view), paged, threshold, pictures, pace, say)
    return Walked(turns, [])


def _bleed_through(
    case: StoreCase, walk: Walk, paged: Paged, threshold: int, pictures: list[np.ndarray], pace: Pace, say: Say
) -> list[Turn]:
    """The turns of one threshold.

    Threshold 0 appends its picture of each frame to `pictures`; the other thresholds are compared with these.
    """
    place, threads, exact = case.place, case.threads, paged.accelerated.prepared
    by = ChcRtState(exact.parts, exact.options._replace(threshold=threshold))
    name = tracer_name(threshold)
    camera_method, method = Culling(CHCRT, exact, threads), Culling(name, by, threads)
    turns: list[Turn] = []
    pace = pace._replace(limit=inf) if threshold else pace.shorter()
    frames = pace.along(walk, f"{place.name}, {walk.name}, {name}", say)
    for frame, camera in islice(frames, len(pictures) if threshold else None):
        case.begin(paged, camera)
        begin([camera_method, method])
        surfaces = _look(paged, camera)
        rays = frame_rays(place, camera, surfaces, SAMPLER, threads)
        by.room = exact.room
        before, statistics, seconds, hit_colours = paged.residency.paging, statistics_counter(method), 0.0, []
        passes, each = list(rays.diffuse()), PASS_BYTES * camera.width * camera.height
        for first in range(0, len(passes), n := paged.together(each)):
            began = clock_seconds()
            for hits in paged.nearest(passes[first : first + n], rays.shape, by):
                seconds += clock_seconds() - began
                hit_colours.append((hits.triangles.colour, hits.gbuffer.face))
                began = clock_seconds()
        moved = _moved(before, paged)
        picture = colour_bleeding(surfaces, hit_colours)
        pictures += [] if threshold else [picture]
        error = error_of(pictures[frame], picture) if threshold else None
        where = place.name, walk.name, SAMPLER, DIFFUSE, name, frame
        turns.append(Turn(*where, rays.rays(DIFFUSE), seconds, {**statistics(), **moved}, 0, error))
        del surfaces, rays, passes, hit_colours, hits  # free their memory for the next frame
    return turns


# --- Several bounces --------------------------------------------------------------------------------------------------


BOUNCES, PATHS = 3, 4
"""Bounces after the camera ray, and paths per pixel."""

SORTED = f"{CHCRT}, sorted"
"""The method that sorts paths before each bounce after the first; `chcrt` leaves them in the order of pixels."""


@lru_cache(4)
def _places(height: int, width: int) -> NDArray[np.int64]:
    """(height * width,) int64: the pixels of each sample set, set by set, each along a Morton curve."""
    y, x = np.divmod(np.arange(height * width), width)
    codes = (y & 3) << 2 | x & 3
    for bit in range(max(height, width).bit_length() - 1, 1, -1):
        codes = codes << 2 | (y >> bit & 1) << 1 | x >> bit & 1
    return np.argsort(codes)


def coherent_order(rays: RayPass, shape: tuple[int, int]) -> NDArray[np.int64]:
    """(H * W,) int64: which ray of a picture goes where, so that rays of neighbouring pixels are similar.

    Rays are sorted by the octant of their directions, then by the Morton codes of their origins [Mattausch et al. 2015,
    Sec. 6], and placed along a Morton curve over the picture. Each keeps its sample set, and so its path. Missing rays
    come last.
    """
    places = _places(*shape)
    sets = (places // shape[1] & 3) << 2 | places % shape[1] & 3
    d = rays.directions[places]
    octants = np.where(d.any(1), (d < 0.0) @ np.array([4, 2, 1]), 8)
    codes = sets << 34 | octants << 30 | morton_codes(rays.origins[places])
    order = np.empty_like(places)
    order[places] = places[np.argsort(codes)]
    return order


def bounce_kind(bounce: int) -> str:
    """The `kind` of the turns of a bounce; 0: camera rays."""
    return f"bounce {bounce}" if bounce else "camera"


def bounce_through(case: MakeCase, tree: Callable[[], Bvh | None], pace: Pace, say: Say) -> Walks:
    """Walkthroughs of diffuse paths of several bounces, all paths of a bounce traced together.

    tree : returns the whole tree; the ordinary tracer traces the same rays in it, and `differs` counts other hits
    """
    for view, name in product(VIEWS, (CHCRT, SORTED)):
        yield f"{view}, {name}", partial(_bounced, case, tree, view, name, pace.shorter(), say)


def _bounced(case: MakeCase, tree: Callable[[], Bvh | None], view: str, name: str, pace: Pace, say: Say) -> Walked:
    made, bvh = case(), tree()
    place, threads, walk = made.place, made.threads, made.place.walk(view)
    with opened(made) as paged:
        method, turns = Culling(name, paged.accelerated.prepared, threads), list[Turn]()
        for frame, camera in pace.along(walk, f"{place.name}, {walk.name}, bounces, {name}", say):
            made.begin(paged, camera)
            begin([method])
            ends: list[Surfaces] = []
            for bounce in range(BOUNCES + 1):
                rays = _bounce_rays(place, bounce, ends, threads)
                if name == SORTED and bounce > 1:
                    orders = [coherent_order(each, (camera.height, camera.width)) for each in rays]
                    rays = [RayPass(*(part[order] for part in each)) for each, order in zip(rays, orders)]
                before, statistics, began = paged.residency.paging, statistics_counter(method), clock_seconds()
                if bounce == 0:
                    ends = [_look(paged, camera)]
                else:
                    ends = list(paged.nearest(rays, (camera.height, camera.width)))
                seconds, moved = clock_seconds() - began, _moved(before, paged)
                n = sum(int((r.directions != 0).any(1).sum()) for r in rays) or camera.width * camera.height
                differs = 0 if bvh is None else sum(_other_hits(bvh, *each, threads) for each in zip(rays, ends))
                where = place.name, walk.name, SAMPLER, bounce_kind(bounce), name, frame
                turns.append(Turn(*where, n, seconds, {**statistics(), **moved}, differs))
            del rays, ends  # free their memory for the next frame
    return Walked(turns, [], compared=bvh is not None)


def _bounce_rays(place: WalkPlace, bounce: int, ends: Sequence[Surfaces], threads: int) -> list[RayPass]:
    """A diffuse ray of each path from the surfaces that it has reached; none before the first bounce."""
    if bounce == 0:
        return []
    samples = diffuse_passes([place.light], BOUNCES * PATHS, SAMPLER).directions[(bounce - 1) * PATHS :]
    starts = ends if len(ends) == PATHS else [ends[0]] * PATHS
    light, rays = AmbientOcclusion(place.reach), list[RayPass]()
    for surfaces, directions in zip(starts, samples):
        (query,) = surface_queries(surfaces, [light], [light_samples(light, 1)], threads=threads)
        each = diffuse_rays(surfaces.gbuffer, query.origins, directions, threads)
        rays.append(each._replace(skip=surfaces.ids.reshape(-1)))
    return rays


def _other_hits(bvh: Bvh, rays: RayPass, ends: Surfaces, threads: int) -> int:
    """The number of rays with another hit in a tree in memory."""
    face, t = ray_hits.nearest_hits(bvh, *rays, threads)
    same = (face == ends.ids.reshape(-1)) & (t.astype(np.float32) == ends.gbuffer.depth.reshape(-1))
    return int(np.count_nonzero(~same))


# --- Figures derived from turns ---------------------------------------------------------------------------------------


def hit_rate(turns: Sequence[Turn]) -> float:
    """The share of requested chunks that were in memory."""
    requested = sum(t.statistics["wanted"] for t in turns)
    return sum(t.statistics["cached"] for t in turns) / requested if requested else 1.0
