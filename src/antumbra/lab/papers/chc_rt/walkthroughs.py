"""Walkthroughs of the CHC+RT benchmark, their rays, and the methods that trace them [Mattausch et al. 2015, Sec. 7].

The city has a walk along a street and a bird's-eye view. Any other scene has a few steps from its own camera, and a
distant view of the whole scene. The methods are CHC+RT and plain tracing from the root. Times cover tracing only: rays
are generated beforehand, and hits are not shaded.
"""

from collections.abc import Callable, Iterator, Sequence
from functools import partial
from itertools import islice
from typing import NamedTuple

import numpy as np

from ....base.errors import InputError
from ....base.progress import clock_seconds
from ....bvh.block_tree import BlockTree
from ....bvh.nodes import Bvh
from ....engine.plan import parse_plan
from ....engine.scene import AnyScene
from ....generate.city import PITCH
from ....kernels.jit import kernel
from ....kernels.parallel import items, new_ticket, run
from ....query.gbuffer import pixel_direction
from ....query.light_samples import light_samples
from ....query.query_bounds import bounds
from ....query.ray_passes import RayPass, diffuse_passes, diffuse_rays
from ....query.shadow_query import ShadowQuery, Surfaces, new_bits, ray_count, surface_queries
from ....scene.camera import Camera, CameraRays
from ....scene.lights import AmbientOcclusion, Light
from ....techniques.chcrt.chc_rt import ChcRtState, camera_hits, nearest_hits, reach_inside, trace_shadow
from ....techniques.chcrt.occlusion_queries import Pairs
from ....techniques.chcrt.picture_ray_sets import PassRaySet
from ....techniques.chcrt.ray_bundles import pass_rays
from ....techniques.chcrt.tree_parts import TreeParts
from ....techniques.tracer_options import ChcRtOptions
from ....trace.primary.primary_rays import trace_primary
from ....trace.rays import ray_hits
from ..benchmark_views import BenchmarkScenes, BenchmarkView, square

# --- Walkthroughs -----------------------------------------------------------------------------------------------------


_EYE = 1.7  # height of the eye above the street, in metres
_LANE = 1.5  # distance from the middle of the street, in metres, clear of cars
_FIRST, _LAST = 55.0, -5.0  # z of both ends of the walk along the street
_CITY_REACH, _REACH = 2.0, 1 / 200  # length of AO rays: in metres, or as a share of the scene's diagonal
_STEP = 1 / 100  # length of a walk from a camera, as a share of the diagonal
_TURN = np.radians(15.0)
_CLOSER = 0.6  # share of the distance at which the whole bounding sphere is visible, since most scenes are flat


VIEWS = NEAR, FAR = "near", "far"


class Walk(NamedTuple):
    """A walkthrough along a straight line."""

    name: str  # one of VIEWS
    first: Camera
    last: Camera

    def camera(self, frame: int, frames: int) -> Camera:
        """The camera of frame `frame` of `frames`."""
        share = frame / max(frames - 1, 1)
        a, b = self.first, self.last
        position, target = ((1.0 - share) * getattr(a, k) + share * getattr(b, k) for k in ("position", "target"))
        return Camera(position, target, a.up, a.vfov, a.width, a.height)


class WalkPlace(NamedTuple):
    """A scene and its walkthroughs."""

    name: str
    scene: AnyScene
    light: Light
    reach: float  # radius of ambient occlusion, in world units
    walks: tuple[Walk, Walk]  # of VIEWS

    def walk(self, view: str) -> Walk:
        """The walkthrough of one of VIEWS."""
        return self.walks[VIEWS.index(view)]

    def resized(self, width: int, height: int) -> "WalkPlace":
        """The same place with images of another size."""
        near, far = (
            walk._replace(first=walk.first.resized(width, height), last=walk.last.resized(width, height))
            for walk in self.walks
        )
        return self._replace(walks=(near, far))


def scenes(triangles: int) -> BenchmarkScenes:
    """The scenes of the benchmark; the city has about `triangles` triangles."""
    city = (f"procedural:city?triangles={triangles}",)
    return BenchmarkScenes(("sanmiguel_lite",), city, city, square(10))


def check_in_memory(view: BenchmarkView) -> None:
    """Raise an InputError if the scene is in a store."""
    if not view.scene.data.resident:
        raise InputError(f"{view.name}: a store; use --store instead of --scene")


def place_of(view: BenchmarkView) -> WalkPlace:
    """A scene with its two walks."""
    scene, size = view.scene, (view.camera.width, view.camera.height)
    city = scene.name == "city"
    diagonal = float(np.linalg.norm(scene.bounds[1] - scene.bounds[0]))
    near_cameras = _street(scene, size) if city else _steps(view.camera, _STEP * diagonal)
    far_camera = _move_closer(scene.default_camera(*size))
    reach = _CITY_REACH if city else _REACH * diagonal
    walks = Walk(NEAR, *near_cameras), Walk(FAR, far_camera, _orbited(far_camera, far_camera.target))
    return WalkPlace(view.name, scene, view.lights[0], reach, walks)


def _street(scene: AnyScene, size: tuple[int, int]) -> tuple[Camera, Camera]:
    """The first and last camera along the street nearest to the centre of the city."""
    low, high = scene.bounds
    blocks = round(float(high[0] - low[0]) / PITCH)
    x = _LANE + (PITCH / 2 if blocks % 2 else 0.0)
    places = ((x, _EYE, z) for z in (_FIRST, _LAST))
    first, last = (Camera(p, np.add(p, (0.0, 0.5, -20.0)), vfov=60.0, width=size[0], height=size[1]) for p in places)
    return first, last


def _steps(camera: Camera, length: float) -> tuple[Camera, Camera]:
    """The camera before and after a step ahead and a turn to the side."""
    ahead = camera.target - camera.position
    step = length / np.linalg.norm(ahead) * ahead
    position = camera.position + step
    target = _around(camera.target + step, position, camera.up)
    return camera, Camera(position, target, camera.up, camera.vfov, camera.width, camera.height)


def _move_closer(camera: Camera) -> Camera:
    """The camera, moved closer to its target."""
    position = camera.target + _CLOSER * (camera.position - camera.target)
    return Camera(position, camera.target, camera.up, camera.vfov, camera.width, camera.height)


def _orbited(camera: Camera, centre: np.ndarray) -> Camera:
    """The camera, moved along an arc around `centre`."""
    position = _around(camera.position, centre, camera.up)
    return Camera(position, camera.target, camera.up, camera.vfov, camera.width, camera.height)


def _around(point: np.ndarray, centre: np.ndarray, up: np.ndarray) -> np.ndarray:
    """A point, rotated around the axis `up` through `centre`."""
    axis, v = up / np.linalg.norm(up), point - centre
    along = np.dot(v, axis) * axis
    turned: np.ndarray = centre + along + np.cos(_TURN) * (v - along) + np.sin(_TURN) * np.cross(axis, v)
    return turned


# --- Ray kinds and methods --------------------------------------------------------------------------------------------


PRIMARY, AO, DIFFUSE, SOFT = KINDS = ("primary", "AO", "diffuse", "soft shadows")
PASSES, SPP = 20, 16  # rays per pixel: of AO and of diffuse light each; of soft shadows
SAMPLER = "halton:36"  # sampler of AO and diffuse rays

BUILD = "bsah+reinsert"
"""All methods trace this tree: an SAH tree after insertion-based optimisation, as in the paper."""

SINGLE, FRUSTA = "single", "multifrusta"
"""The tracer that stands in for GLSL: one ray at a time, from the root."""

TRACERS = {SINGLE: KINDS, "packet16": (AO, SOFT), FRUSTA: KINDS}
"""Stateless tracer -> the ray kinds that it has a method for. FRUSTA has the kernels of CHC+RT: for diffuse rays, that
which traces 16 of them together."""


def plan_of(tracer: str) -> str:
    """The plan of a tracer in the benchmark."""
    return f"{BUILD}+{tracer}"


ONE_PART = ChcRtOptions(triangles=1 << 62, height=1 << 30)
"""The options by which a whole tree is one part."""

Query = CameraRays | RayPass | ShadowQuery
Answer = tuple[np.ndarray, ...]
"""(bits,) of a shadow query; otherwise (face, t) per pixel."""


class FrameRays(NamedTuple):
    """The rays of one frame."""

    camera: CameraRays
    surfaces: Surfaces  # the visible surfaces
    shadows: dict[str, ShadowQuery]  # AO and SOFT -> query
    directions: np.ndarray  # directions of the diffuse passes, see `query.ray_passes.Passes`

    @property
    def shape(self) -> tuple[int, int]:
        return self.camera.height, self.camera.width

    def queries(self, kind: str) -> Iterator[Query]:
        """Yield the frame's queries for a ray kind."""
        if kind == PRIMARY:
            yield self.camera
        elif kind == DIFFUSE:
            yield from self.diffuse()
        else:
            yield self.shadows[kind]

    def diffuse(self) -> Iterator[RayPass]:
        """Yield the frame's diffuse passes, one at a time to save memory."""
        for directions in self.directions:
            rays = diffuse_rays(self.surfaces.gbuffer, self.shadows[AO].origins, directions)
            yield rays._replace(skip=self.surfaces.ids.reshape(-1))

    def rays(self, kind: str) -> int:
        """The frame's number of rays of a kind."""
        if kind == PRIMARY:
            return self.camera.width * self.camera.height
        query = self.shadows[SOFT if kind == SOFT else AO]
        return ray_count(query)


def frame_rays(place: WalkPlace, camera: Camera, surfaces: Surfaces, sampler: str, threads: int) -> FrameRays:
    """The camera rays, and all rays from the visible surfaces."""
    lights = [AmbientOcclusion(place.reach), place.light]
    samples = [light_samples(lights[0], PASSES, sampler), light_samples(lights[1], SPP)]
    queries = surface_queries(surfaces, lights, samples, threads=threads)
    directions = diffuse_passes([place.light], PASSES, sampler).directions
    return FrameRays(camera.rays(surfaces.triangles.origin), surfaces, dict(zip((AO, SOFT), queries)), directions)


@kernel
def _pixel_rays(ticket, rays, origins, directions):
    """Worker: generate the rays of pixel rows."""
    o = rays.origin
    for y in items(ticket):
        for x in range(rays.width):
            at = y * rays.width + x
            origins[at, 0], origins[at, 1], origins[at, 2] = o[0], o[1], o[2]
            directions[at, 0], directions[at, 1], directions[at, 2] = pixel_direction(rays, x, y)


def _camera_pass(rays: CameraRays, threads: int) -> RayPass:
    """The rays of a camera, one per pixel."""
    m = rays.width * rays.height
    ray_pass = RayPass(np.empty((m, 3), np.float32), np.empty((m, 3), np.float32), np.full(m, -1, np.int32))
    run(_pixel_rays, threads, new_ticket(rays.height, 8), rays, ray_pass.origins, ray_pass.directions)
    return ray_pass


class Culling:
    """CHC+RT, with its state from the previous frame."""

    def __init__(self, name: str, scheduled: ChcRtState, threads: int, together: int = 1):
        self.name, self.scheduled, self.threads, self.kinds = name, scheduled, threads, KINDS
        self.together = together  # number of diffuse passes traced at once

    def answer(self, queries: Sequence[Query], shape: tuple[int, int]) -> list[Answer]:
        first = queries[0]
        if isinstance(first, ShadowQuery):
            return [(_bits(first, partial(trace_shadow, self.scheduled), self.threads),)]
        if isinstance(first, CameraRays):
            hits = [camera_hits(self.scheduled, first, self.threads)]
        else:
            passes = [query for query in queries if isinstance(query, RayPass)]  # all, since a batch has one kind
            hits = nearest_hits(self.scheduled, passes, shape, self.threads)
        return [(each.face.reshape(-1), each.t.reshape(-1)) for each in hits]


class Plain:
    """A stateless tracer, which starts at the root.

    whole : the tree as one part, by which FRUSTA traces diffuse rays; None: it traces them as single rays
    """

    def __init__(self, name: str, bvh: Bvh, tree: BlockTree, threads: int, whole: TreeParts | None = None):
        self.name, self.kinds, self.bvh, self.tree, self.threads = name, TRACERS[name], bvh, tree, threads
        self.tracer = parse_plan(plan_of(name)).tracer
        self.blocks = name == "multifrusta"
        self.prepared = tree if self.blocks else self.tracer.prepare(bvh, threads)
        self.whole = whole if self.blocks else None

    together = 1

    def answer(self, queries: Sequence[Query], shape: tuple[int, int]) -> list[Answer]:
        (query,) = queries
        if isinstance(query, ShadowQuery):
            return [(_bits(query, partial(self.tracer.trace, self.prepared), self.threads),)]
        if self.blocks and isinstance(query, CameraRays):
            face, t = trace_primary(self.tree, query, self.threads)
            return [(face.reshape(-1), t.reshape(-1))]
        if self.whole is not None and isinstance(query, RayPass):
            return [self._by_cells(self.whole, query, shape)]
        rays = _camera_pass(query, self.threads) if isinstance(query, CameraRays) else query
        return [ray_hits.nearest_hits(self.bvh, *rays, self.threads)]

    def _by_cells(self, whole: TreeParts, query: RayPass, shape: tuple[int, int]) -> Answer:
        """The hits of a pass by the kernel of CHC+RT, in the whole tree and without queries."""
        reach = reach_inside(whole, *bounds(query.origins, self.threads))
        rays = PassRaySet(whole, ONE_PART, pass_rays(query, *shape, reach), self.threads)
        tiles = np.arange(rays.tiles.smallest, dtype=np.int32)
        nothing = np.zeros_like(tiles)
        rays.trace(Pairs(tiles, nothing, nothing), np.zeros(len(tiles), np.float32))
        return rays.hits.face.reshape(-1), rays.hits.t.reshape(-1)


Method = Culling | Plain


def _bits(query: ShadowQuery, trace: Callable[[ShadowQuery, np.ndarray, int], object], threads: int) -> np.ndarray:
    bits = new_bits(query)
    trace(query, bits, threads)
    return bits


def timed(method: Method, frame_rays: FrameRays, kind: str) -> tuple[float, list[Answer]]:
    """(seconds to trace the rays of a kind, answers)."""
    seconds, answers, queries = 0.0, list[Answer](), frame_rays.queries(kind)
    while batch := list(islice(queries, method.together)):
        start = clock_seconds()
        answers += method.answer(batch, frame_rays.shape)
        seconds += clock_seconds() - start
    return seconds, answers


def differing(one: list[Answer], other: list[Answer]) -> int:
    """The number of rays with different answers by two methods."""
    n = 0
    for a, b in zip(one, other, strict=True):
        if len(a) == 1:
            n += int(np.bitwise_count(a[0] ^ b[0]).sum())
        else:
            n += int(np.count_nonzero((a[0] != b[0]) | ~_close(a[1], b[1])))
    return n


def _close(one: np.ndarray, other: np.ndarray) -> np.ndarray:
    """(m,) bool: whether two t are equal up to rounding: `hit_t` of pictures is within 2**-29 of the t of rays."""
    with np.errstate(invalid="ignore"):
        close: np.ndarray = (one == other) | (np.abs(one - other) <= 2.0**-28 * np.abs(one))
    return close
