"""Measures the SRDH paper: box tests (Figures 2, 4, 5), trees, RTSAH, build and trace times [Feltman et al. 2012].

Shadow rays start at the visible surfaces, and at the hits of one diffuse ray from each of these points. For counts, all
trees have one triangle per leaf, and rays are traced one by one. A pre-render of k x k pixels takes k x k evenly spaced
pixels of the picture, with at least `PRERENDER_SPP` samples per light and its own bounces. For times, methods alternate
within each round, and the median of the rounds counts.

RTSAH [Ize and Hansen 2011] predicts from areas which child of a node blocks more uniformly distributed lines for its
cost. Shadow rays are distributed differently: they start on surfaces and end at lights. Box tests are therefore counted
for both, with the order and with its opposite. An order that suits its lines saves box tests; its opposite wastes some.
"""

from collections.abc import Callable, Iterable, Sequence
from functools import cache, partial
from pathlib import Path
from statistics import median
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ....base.errors import InputError
from ....base.progress import clock_seconds
from ....bvh import binned_sah
from ....bvh.child_order import order_children
from ....bvh.nodes import LEFT_FIRST, Bvh, aligned_empty
from ....kernels.parallel import thread_count
from ....picture.renderer import Renderer
from ....query.gbuffer import GBuffer
from ....query.light_samples import light_samples
from ....query.query_bounds import reach
from ....query.receivers import FREE
from ....query.shadow_query import ShadowQuery, shadow_queries
from ....scene.camera import Camera
from ....scene.light_lists import PointLights
from ....scene.lights import MAX_SPP
from ....scene.triangles import Triangles
from ....techniques.srdh import srdh_builder
from ....techniques.srdh.representative_rays import (
    RepresentativeRays,
    RepresentativeRaySelector,
    SrdhRays,
    sparse_gbuffer,
)
from ....trace.rays.ray_hits import Intersections, bounce_surfaces
from ....trace.rays.ray_traversal import BUILT, RANDOM, SRDH, Ordered
from ....trace.rays.single_rays import UNOCCLUDED, count_steps
from ...bench_parts import BenchParts
from ..bench_runner import Say, interleave, medians, round_text
from ..benchmark_views import BenchmarkView, digest
from ..published_methods import BUILDERS, ORDERS
from .srdh_published import SrdhTable
from .srdh_trees import TreeMemory, TreeShape, frequent_occluders, tree_memory, tree_shape

# --- Box tests (Figures 2, 4 and 5) -----------------------------------------------------------------------------------


BASE = "random"  # all counts are relative to this order
SAH_ORDERS = (BASE, "front-to-back", "back-to-front", "rtsah")
PUBLISHED, CONSTANT, DISTANCE, OURS = "srdh, published", "constant kernels", "distance kernels", "srdh"
PIXELS = (8, 16, 32, 64, 128, 256)
"""Widths of the pre-renders of Fig. 4; the figure ends with all pixels."""

BUILD_PIXELS = (16, 32)
"""Widths of the pre-renders of Table 1."""

PRERENDER_SPP = 4
"""Minimum samples per light in pre-renders. With one, 16 x 16 pixels give 300 rays; the paper has up to 5,505."""

_paper = BUILDERS["srdh:paper"].build
METHODS: dict[str, tuple[Callable[..., Bvh], int]] = {
    PUBLISHED: (_paper, SRDH),
    CONSTANT: (partial(_paper, options=srdh_builder.PUBLISHED._replace(kernels="constant")), SRDH),
    DISTANCE: (partial(_paper, options=srdh_builder.PUBLISHED._replace(kernels="distance")), SRDH),
    OURS: (partial(srdh_builder.build, max_leaf=1), BUILT),
}
"""Method -> (build function, traversal order). The last one is the builder `srdh`."""


class BoxTests(NamedTuple):
    """The box tests of all shadow rays of a view by one method."""

    scene: str
    method: str  # one of SAH_ORDERS or METHODS
    pixels: int | None  # width of the pre-render; None: all rays are representative, or the method needs none
    triangles: int  # triangles of the scene
    rays: int
    blocked: int  # blocked rays
    boxes: tuple[int, ...]  # box tests, by `trace.rays.single_rays.CLASSES`
    tested: int  # triangle tests

    @property
    def total(self) -> int:
        return sum(self.boxes)


class Workload:
    """The shadow rays of a view, and the rays of its pre-renders."""

    def __init__(self, view: BenchmarkView, spp: int, threads: int | None):
        self.view, self.threads = view, thread_count(threads)
        self.triangles = view.scene.triangles(0.0, self.threads)
        self.sah = binned_sah.build(self.triangles.vertices, self.threads)
        self._samples = [light_samples(light, spp) for light in view.lights]
        self._prerendered = [light_samples(light, max(spp, PRERENDER_SPP)) for light in view.lights]
        self._gbuffer = Renderer(view.scene, threads=self.threads).see(self.triangles, view.camera)
        if not (self._gbuffer.face >= 0).any():
            raise InputError(f"{view.name}: the camera sees nothing; choose a scene whose first camera sees something")
        self._visible = self._queries(self._gbuffer, self._samples)

    def queries(self) -> list[ShadowQuery]:
        """All shadow queries, of the visible surfaces and of the bounces."""
        return [*self._visible, *self._bounce(None, self._samples, self.sah)]

    def representative_rays(self, pixels: int | None, bvh: Bvh | None) -> RepresentativeRays:
        """The representative rays: those of a pre-render, or all rays if `pixels` is None.

        The tree `bvh` of all triangles serves to trace the bounces and to find the triangles that the rays hit.
        """
        options, samples = (
            SrdhRays(size=pixels, spp=MAX_SPP, bounce=True),
            self._prerendered if pixels else self._samples,
        )
        queries = [query._replace(samples=sets) for query, sets in zip(self._visible, samples)]
        return RepresentativeRaySelector(options, self.threads).show(
            queries, self.triangles, bvh, partial(self._bounce, pixels, samples)
        )

    def _queries(self, gbuffer: GBuffer, samples: Sequence[np.ndarray]) -> list[ShadowQuery]:
        return shadow_queries(self.triangles, gbuffer, self.view.lights, samples, threads=self.threads)

    def _bounce(self, pixels: int | None, samples: Sequence[np.ndarray], bvh: Bvh) -> list[ShadowQuery]:
        sparse = sparse_gbuffer(self._gbuffer, SrdhRays(size=pixels))
        return self._queries(bounce_surfaces(sparse, self.triangles, bvh, threads=self.threads), samples)


class ShadowTrees(NamedTuple):
    """The trees of a view with one triangle per leaf, and the rays that `srdh:paper` was built for."""

    sah: Bvh
    published: Bvh  # for all rays
    rays: Intersections  # all rays
    sparse: Intersections | None  # the rays of 16 x 16 pixels, if they were counted

    def shapes(self, scene: str) -> list[TreeShape]:
        """The shapes of both trees, with the frequent occluders of all rays (Figure 3)."""
        trees, frequent = {"SAH": self.sah, PUBLISHED: self.published}, self.frequent()
        return [tree_shape(scene, name, bvh, frequent) for name, bvh in trees.items()]

    def frequent(self) -> NDArray[np.bool_]:
        return frequent_occluders(self.rays, len(self.sah.prim_ids))

    def memory(self, scene: str) -> TreeMemory:
        """The memory of both trees (Section 5)."""
        return tree_memory(scene, self.sah, self.published, self.sparse or self.rays)


def count_view(work: Workload, say: Say, pixels: Iterable[int] = PIXELS) -> tuple[list[BoxTests], ShadowTrees]:
    """All counts of one view, and its trees; InputError if its lights reach no visible surface."""
    view = work.view
    say(f"{view.name}, generating shadow rays")
    vertices, queries = work.triangles.vertices, work.queries()
    rows: list[BoxTests] = []

    def count(method: str, pixels: int | None, ordered: Ordered) -> None:
        say(f"{view.name}, {method}" + (f", {pixels} x {pixels} pixels" if pixels else ""))
        steps = [count_steps(ordered, query, len(vertices), work.threads) for query in queries]
        boxes = sum(np.sum(s.boxes, axis=(0, 1)) for s in steps).tolist()
        rays, blocked, tested = (
            sum(int(np.sum(getattr(s, f))) for s in steps) for f in ("rays", "blocked", "triangles")
        )
        rows.append(BoxTests(view.name, method, pixels, len(vertices), rays, blocked, tuple(boxes), tested))

    sah = binned_sah.build(vertices, work.threads, 1)
    for name in SAH_ORDERS:
        count(name, None, Ordered(ORDERS[name].prepare(sah), ORDERS[name].value))
    if rows[0].total == 0:
        raise InputError(f"{view.name}: no light is above any visible surface; choose a scene with lit surfaces")
    built, sparse = {}, None
    for width in (*pixels, None):
        say(f"{view.name}, hits of the rays of {f'{width} x {width}' if width else 'all'} pixels")
        met = work.representative_rays(width, work.sah).among(vertices, None, work.threads)
        for method, (build, order) in METHODS.items():
            if width is None or method in (PUBLISHED, OURS):
                say(f"{view.name}, building {method}")
                built[method] = build(vertices, work.threads, rays=met)
                count(method, width, Ordered(built[method], order))
        sparse = met if width == BUILD_PIXELS[0] else sparse
    return rows, ShadowTrees(sah, built[PUBLISHED], met, sparse)


def of(rows: Iterable[BoxTests], scene: str, method: str, pixels: int | None = None) -> BoxTests:
    """The row of a scene, method and pre-render."""
    return next(r for r in rows if (r.scene, r.method, r.pixels) == (scene, method, pixels))


def scenes_of(rows: Iterable[BoxTests]) -> list[str]:
    """The names of the scenes, in order."""
    return list(dict.fromkeys(r.scene for r in rows))


def relative(rows: Iterable[BoxTests], row: BoxTests) -> float:
    """The box tests of a row, relative to random order in the same scene."""
    return row.total / of(rows, row.scene, BASE).total


def saved(rows: Iterable[BoxTests], row: BoxTests, than: str = BASE) -> float:
    """The share of box tests that a row saves relative to method `than`."""
    return 1.0 - row.total / of(rows, row.scene, than).total


def saved_unoccluded(rows: Iterable[BoxTests], row: BoxTests) -> float:
    """The share of box tests of unoccluded rays that a row saves; 0 if there are none.

    All orders of a tree test the same number of boxes for an unoccluded ray.
    """
    before = of(rows, row.scene, BASE).boxes[UNOCCLUDED]
    return 1.0 - row.boxes[UNOCCLUDED] / before if before else 0.0


def beyond_all(rows: Iterable[BoxTests], row: BoxTests) -> float:
    """The extra box tests of a tree for a pre-render's rays, relative to the tree for all rays."""
    return row.total / of(rows, row.scene, row.method).total - 1.0


def savings(rows: Sequence[BoxTests]) -> list[dict[str, Any]]:
    """The savings of trees for all rays, relative to each order of the SAH tree, and the excess of trees for fewer."""
    return [
        {
            "scene": row.scene,
            "method": row.method,
            **{order: saved(rows, row, order) for order in SAH_ORDERS},
            "unoccluded": saved_unoccluded(rows, row),
            "beyond_all": beyond_all(rows, of(rows, row.scene, row.method, BUILD_PIXELS[0])),
        }
        for row in rows
        if row.pixels is None and row.method in (PUBLISHED, OURS)
    ]


class KernelGain(NamedTuple):
    """What kernels that compare distances change in a scene (Figure 5). Box tests are relative to constant kernels."""

    scene: str
    distance: float  # box tests with distance kernels alone, minus 1
    both: float  # box tests with all kernels, minus 1
    chosen: float  # share of the nodes with a kernel, in the tree with all kernels, that compare distances


def kernel_gains(rows: Sequence[BoxTests], trees: Iterable[TreeShape]) -> list[KernelGain]:
    """The gains in each scene."""
    shapes = {tree.scene: tree for tree in trees if tree.method == PUBLISHED}
    gain = lambda scene, method: of(rows, scene, method).total / of(rows, scene, CONSTANT).total - 1.0
    share = lambda tree: tree.distance / max(1, tree.ordered)
    return [
        KernelGain(scene, gain(scene, DISTANCE), gain(scene, PUBLISHED), share(shapes[scene]))
        for scene in scenes_of(rows)
    ]


# --- RTSAH with the lines that it assumes [Ize and Hansen 2011] -------------------------------------------------------


_SHAPE, _ENDS = (16, 24), 256  # shape of the array of start points, and number of end points


class RtsahCheck(NamedTuple):
    """Box tests of RTSAH, and of the opposite order, relative to random order."""

    scene: str
    lines: float  # uniformly distributed lines
    lines_reversed: float
    rays: float  # the shadow rays of a `Workload`
    rays_reversed: float


def even_lines(triangles: Triangles, seed: int = 0) -> ShadowQuery:
    """Segments between random points of a sphere around the scene, which are uniformly distributed inside it."""
    corners = triangles.vertices.reshape(-1, 3).astype(np.float64)
    low, high = corners.min(0), corners.max(0)
    rng, centre, radius = np.random.default_rng(seed), (low + high) / 2, 0.501 * np.linalg.norm(high - low)

    def on_sphere(n: int) -> np.ndarray:
        towards = rng.normal(size=(n, 3))
        points: np.ndarray = centre + radius * towards / np.linalg.norm(towards, axis=1, keepdims=True)
        return points

    light = PointLights(on_sphere(_ENDS) + triangles.origin)
    origins = on_sphere(_SHAPE[0] * _SHAPE[1]).astype(np.float32).reshape(*_SHAPE, 3)
    no_faces, sides = np.full(_SHAPE, -1, np.int32), np.full(_SHAPE, FREE, np.int8)
    patch = light.patch(triangles.origin, reach(triangles, origins))
    flat, samples = triangles.vertices.reshape(-1, 9), light_samples(light, 1)
    return ShadowQuery(origins, no_faces, sides, np.empty((0, 0, 3)), flat, patch, samples, 0, no_faces)


def opposite(bvh: Bvh) -> Bvh:
    """The tree with the children of every node swapped."""
    nodes = aligned_empty(bvh.nodes.shape, "f4")
    nodes[:] = bvh.nodes
    nodes[:, :14] = nodes[:, :14].reshape(-1, 7, 2)[:, :, ::-1].reshape(-1, 14)
    return bvh._replace(nodes=nodes, links=nodes.view(np.int32))


def check_rtsah(work: Workload) -> RtsahCheck:
    """Count the box tests of lines and of shadow rays in a SAH tree with one triangle per leaf."""
    bvh = binned_sah.build(work.triangles.vertices, work.threads, 1)
    ordered = order_children(bvh)
    orders = Ordered(bvh, RANDOM), Ordered(ordered, LEFT_FIRST), Ordered(opposite(ordered), LEFT_FIRST)
    n, shares = len(work.triangles.vertices), list[float]()
    for queries in [even_lines(work.triangles)], work.queries():
        boxes = [sum(int(count_steps(o, query, n, work.threads).boxes.sum()) for query in queries) for o in orders]
        shares += [boxes[1] / boxes[0], boxes[2] / boxes[0]]
    return RtsahCheck(work.view.name, *shares)


# --- Build times (Table 1) and trace times ----------------------------------------------------------------------------


TRACERS = ("single", "multifrusta", "packet16", "wide")
BUILDS = ("bsah", "srdh")
SPP = 16  # samples per pixel of the timed pictures


class BuildTimes(NamedTuple):
    """Seconds to build trees for the rays of one pre-render of a `Workload`.

    As in the paper, its measurements use one thread. The others use all threads.
    """

    scene: str
    pixels: int  # width of the pre-render
    triangles: int
    rays: int
    hits: int  # intersections of the rays with triangles
    sah_single: float  # bsah with one triangle per leaf, one thread
    sah: float  # bsah
    rays_by_sah: float  # generating the rays and intersecting them with the bsah tree, one thread
    published: float  # srdh:paper, one thread
    rays_by_lbvh: float  # building an lbvh, generating the rays and intersecting them with it
    srdh: float

    @property
    def both(self) -> float:
        """Time to build a SAH tree and a tree for shadow rays, relative to the SAH tree alone.

        This is the paper's ratio, with one triangle per leaf.
        """
        return (self.sah_single + self.rays_by_sah + self.published) / self.sah_single

    @property
    def instead(self) -> float:
        """Time to build only the tree for shadow rays, as a `Renderer` does, relative to bsah."""
        return (self.rays_by_lbvh + self.srdh) / self.sah


class RenderTimes(NamedTuple):
    """Seconds for a plan to render the direct light of a view."""

    scene: str
    build: str  # one of BUILDS
    tracer: str
    rays: int
    built: float
    traced: float
    bits: bytes  # digest of the answer

    @property
    def total(self) -> float:
        return self.built + self.traced


def build_times(work: Workload, spp: int, rounds: int, say: Say) -> list[BuildTimes]:
    """Measure Table 1 for one view, with `spp` samples per light as in its workload."""
    name, alone = work.view.name, Workload(work.view, spp, 1)
    counts = {}

    def build(pixels: int, turn: int) -> dict[str, float]:
        say(f"{name}, building for {pixels} x {pixels} pixels, {round_text(turn, rounds)}")
        seconds, counts[pixels] = _build_once(work, alone, pixels)
        return seconds

    laps = interleave(BUILD_PIXELS, rounds, build, warm_up=1)
    n = len(work.triangles.vertices)
    parts: dict[int, dict[str, Any]] = {k: medians(laps[k]) for k in BUILD_PIXELS}
    return [BuildTimes(name, k, n, *counts[k], **parts[k]) for k in BUILD_PIXELS]


def _build_once(work: Workload, alone: Workload, pixels: int) -> tuple[dict[str, float], tuple[int, int]]:
    """Build all trees once; return (seconds of each part, (rays, hits)). `alone`: the same workload on one thread."""
    vertices, threads, seconds = work.triangles.vertices, work.threads, {}

    def timed(part: str, build: Callable[[], Any]) -> Any:
        start = clock_seconds()
        result = build()
        seconds[part] = clock_seconds() - start
        return result

    timed("sah_single", lambda: binned_sah.build(vertices, 1, 1))
    timed("sah", lambda: binned_sah.build(vertices, threads))
    rays = timed("rays_by_sah", lambda: alone.representative_rays(pixels, alone.sah).among(vertices, None, 1))
    timed("published", lambda: BUILDERS["srdh:paper"].build(vertices, 1, rays=rays))
    rays = timed("rays_by_lbvh", lambda: work.representative_rays(pixels, None).among(vertices, None, threads))
    timed("srdh", lambda: srdh_builder.build(vertices, threads, rays=rays))
    return seconds, (len(rays.origins), len(rays.prims))


def render_times(view: BenchmarkView, threads: int | None, rounds: int, say: Say) -> list[RenderTimes]:
    """Measure each of BUILDS with each of TRACERS, with a `Renderer`'s default representative rays."""
    plans = [(build, tracer) for tracer in TRACERS for build in BUILDS]
    answers: dict[tuple[str, str], tuple[int, bytes]] = {}

    def render(plan: tuple[str, str], turn: int) -> tuple[float, float]:
        say(f"{view.name}, {'+'.join(plan)}, {round_text(turn, rounds)}")
        renderer = Renderer(view.scene, "+".join(plan), threads)  # a new one, which keeps no tree
        frame = renderer.render(view.camera, view.lights, spp=SPP if turn >= 0 else 1)
        answers[plan] = frame.rays, digest(frame.bits)
        return frame.timings["build"], frame.timings["trace"]

    rows = []
    for plan, laps in interleave(plans, rounds, render, warm_up=1).items():
        (rays, bits), (built, traced) = answers[plan], (median(seconds) for seconds in zip(*laps))
        rows.append(RenderTimes(view.name, *plan, rays, built, traced, bits))
    return rows


class TracerGain(NamedTuple):
    """Seconds with `srdh`, relative to those with `bsah`, for one tracer."""

    scene: str
    tracer: str
    trace: float
    total: float  # with the build


def gains(times: Sequence[RenderTimes]) -> list[TracerGain]:
    """The gains of each tracer in each scene."""
    by = {(t.scene, t.tracer, t.build): t for t in times}
    pairs = [tuple(by[scene, tracer, build] for build in BUILDS) for scene, tracer, build in by if build == BUILDS[0]]
    return [TracerGain(b.scene, b.tracer, s.traced / b.traced, s.total / b.total) for b, s in pairs]


# --- All measurements -------------------------------------------------------------------------------------------------


class SrdhEffort(NamedTuple):
    """How much to measure."""

    spp: int  # shadow rays counted per light and point
    timed_size: tuple[int, int]  # image size for timing
    rounds: int
    threads: int


class SrdhRows(NamedTuple):
    """All measured rows."""

    counts: list[BoxTests]
    trees: list[TreeShape]
    memory: list[TreeMemory]
    rtsah: list[RtsahCheck]
    builds: list[BuildTimes]
    renders: list[RenderTimes]


ROWS = BoxTests, TreeShape, TreeMemory, RtsahCheck, BuildTimes, RenderTimes
"""The rows in parts."""


def add_views(
    parts: BenchParts, views: Sequence[BenchmarkView], effort: SrdhEffort, say: Say, pictures: Path | None
) -> None:
    """Measure all views.

    Further lightings of a scene have pictures of half the width and height, and one pre-render for box tests.

    pictures : folder for the drawings of the first view's trees (Figure 3); None: no drawings
    """
    seen = set[int]()
    for view in views:
        relit = id(view.scene) in seen
        drawn = pictures if view.name == _figure_3(views) else None
        _add_view(parts, view, relit, effort, say, drawn)
        seen.add(id(view.scene))


def _add_view(
    parts: BenchParts, view: BenchmarkView, relit: bool, effort: SrdhEffort, say: Say, pictures: Path | None
) -> None:
    counted = view._replace(camera=_halved(view.camera)) if relit else view
    work = cache(partial(Workload, counted, effort.spp, effort.threads))

    def boxes() -> tuple[list[BoxTests], list[TreeShape], list[TreeMemory]]:
        counts, trees = count_view(work(), say, BUILD_PIXELS[:1] if relit else PIXELS)
        if pictures is not None:
            _draw_trees(trees, view.name, pictures)
        return counts, trees.shapes(view.name), [] if relit else [trees.memory(view.name)]

    def rtsah() -> list[RtsahCheck]:
        say(f"{view.name}, uniformly distributed lines")
        return [check_rtsah(work())]

    camera = view.camera.resized(*effort.timed_size)
    timed = view._replace(camera=_halved(camera) if relit else camera)
    for table, measure in (
        (SrdhTable.boxes, boxes),
        (SrdhTable.builds, lambda: build_times(work(), effort.spp, effort.rounds, say)),
        (SrdhTable.rtsah, rtsah),
        (SrdhTable.renders, lambda: render_times(timed, effort.threads, effort.rounds, say)),
    ):
        parts.add(table, view.name, measure, relit=relit, triangles=view.scene.n_triangles)


def rows_of(parts: BenchParts) -> SrdhRows:
    """The rows of all parts."""
    boxes = parts.values(SrdhTable.boxes)
    counted = ([row for part in boxes for row in part[k]] for k in range(3))
    return SrdhRows(*counted, *(parts.rows(table) for table in (SrdhTable.rtsah, SrdhTable.builds, SrdhTable.renders)))


def _halved(camera: Camera) -> Camera:
    """The camera with half as many pixels in each direction."""
    return camera.resized(-(-camera.width // 2), -(-camera.height // 2))


def _figure_3(views: Sequence[BenchmarkView]) -> str:
    """The name of the view whose trees are drawn: the bedroom with blinds, as in the paper, or else the first one."""
    names = [view.name for view in views]
    return next((name for name in names if name.startswith("blinds")), names[0])


def _draw_trees(trees: ShadowTrees, scene: str, folder: Path) -> None:
    from .srdh_trees import DrawnTree, write_trees

    drawn = [DrawnTree(f"{scene}: SAH", trees.sah), DrawnTree(f"{scene}: {PUBLISHED}", trees.published)]
    write_trees(drawn, trees.frequent(), folder / "srdh-trees.png")
