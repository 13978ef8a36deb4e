"""Measures Figures 2, 4 and 5 of the SRDH paper: exact counts of box tests [Feltman et al. 2012].

Shadow rays start at the surfaces that the camera sees, and at the hits of one diffuse ray from each of these points.
All trees have one triangle in each leaf. Rays are traced one by one. A pre-render of k x k pixels takes k x k pixels of
the picture, spread evenly. They have `PRERENDER_SPP` samples of each light or more, and bounces of their own.
"""

from collections.abc import Callable, Iterable
from functools import partial
from typing import NamedTuple

import numpy as np

from ...bvh import binned_sah, srdh
from ...bvh.nodes import Bvh
from ...errors import InputError
from ...kernels.parallel import thread_count
from ...query.light_samples import MAX_SPP, light_samples
from ...query.shadow_query import ShadowQuery, shadow_queries
from ...rendering.renderer import Renderer
from ...techniques.srdh.representative_rays import (
    RepresentativeRays,
    RepresentativeRaySelector,
    SrdhRays,
    sparse_gbuffer,
)
from ...trace.rays.ray_hits import bounced
from ...trace.rays.ray_traversal import BUILT, SRDH, Ordered
from ...trace.rays.single_rays import UNOCCLUDED, count_steps
from ..views import View
from .variants import BUILDERS, ORDERS

BASE = "random"  # all counts are relative to this order
SAH_ORDERS = (BASE, "front-to-back", "back-to-front", "rtsah")
PUBLISHED, CONSTANT, DISTANCE, OURS = "srdh, published", "constant kernels", "distance kernels", "srdh"
PIXELS = (8, 16, 32, 64, 128, 256)
"""Widths of the pre-renders of Fig. 4; the figure ends with all pixels."""

PRERENDER_SPP = 4
"""The fewest samples of a light in pre-renders. With one, 16 x 16 pixels give 300 rays; the paper has up to 5,505."""

_paper = BUILDERS["srdh:paper"].build
METHODS: dict[str, tuple[Callable, int]] = {
    PUBLISHED: (_paper, SRDH),
    CONSTANT: (partial(_paper, kernels="constant"), SRDH),
    DISTANCE: (partial(_paper, kernels="distance"), SRDH),
    OURS: (partial(srdh.build, max_leaf=1), BUILT),
}
"""Method -> (function that builds its trees, traversal order). The last one is the builder `srdh`."""


class Counted(NamedTuple):
    """The box tests of all shadow rays of a view by one method."""

    scene: str
    method: str  # one of SAH_ORDERS or METHODS
    pixels: int | None  # width of the pre-render; None: all rays were representative, or the method needs none
    triangles: int  # triangles of the scene
    rays: int
    blocked: int  # rays that are blocked
    boxes: tuple[int, ...]  # boxes tested, by trace.rays.steps.CLASSES
    tested: int  # triangles tested

    @property
    def total(self) -> int:
        return sum(self.boxes)


class Workload:
    """The shadow rays of a view, and the rays of its pre-renders."""

    def __init__(self, view: View, spp: int, threads: int | None):
        self.view, self.threads = view, thread_count(threads)
        self.triangles = view.scene.triangles(0.0, self.threads)
        self.sah = binned_sah.build(self.triangles.vertices, self.threads)
        self._samples = [light_samples(light, spp) for light in view.lights]
        self._prerendered = [light_samples(light, max(spp, PRERENDER_SPP)) for light in view.lights]
        self._gbuffer = Renderer(view.scene, threads=self.threads).see(self.triangles, view.camera)
        if not (self._gbuffer.face >= 0).any():
            raise InputError(f"{view.name}: the camera sees nothing; choose a scene whose first camera sees something")
        self._seen = self._queries(self._gbuffer, self._samples)

    def queries(self) -> list[ShadowQuery]:
        """All shadow queries: of the visible surfaces, and of the bounces."""
        return [*self._seen, *self._bounce(None, self._samples, self.sah)]

    def shown(self, pixels: int | None, bvh: Bvh | None) -> RepresentativeRays:
        """The representative rays: those of a pre-render, or all (`pixels` None).

        `bvh` holds all triangles. It traces the bounces and finds the triangles that the rays meet.
        """
        asked, samples = SrdhRays(size=pixels, spp=MAX_SPP, bounce=True), self._prerendered if pixels else self._samples
        seen = [query._replace(samples=sets) for query, sets in zip(self._seen, samples)]
        return RepresentativeRaySelector(asked, self.threads).show(
            seen, self.triangles, bvh, partial(self._bounce, pixels, samples)
        )

    def _queries(self, gbuffer, samples) -> list[ShadowQuery]:
        return shadow_queries(self.triangles, gbuffer, self.view.lights, samples, threads=self.threads)

    def _bounce(self, pixels, samples, bvh) -> list[ShadowQuery]:
        some = sparse_gbuffer(self._gbuffer, SrdhRays(size=pixels))
        return self._queries(bounced(some, self.triangles, bvh, threads=self.threads), samples)


def count_view(
    view: View, spp: int, threads: int | None, say: Callable[[str], None], pixels: Iterable[int] = PIXELS
) -> list[Counted]:
    """All counts of one view; InputError if its camera sees nothing."""
    say(f"{view.name}, what camera and bounces see")
    work = Workload(view, spp, threads)
    vertices, queries = work.triangles.vertices, work.queries()
    rows: list[Counted] = []

    def count(method: str, shown: int | None, ordered: Ordered) -> None:
        say(f"{view.name}, {method}" + (f", {shown} x {shown} pixels shown" if shown else ""))
        steps = [count_steps(ordered, query, len(vertices), work.threads) for query in queries]
        boxes = sum(np.sum(s.boxes, axis=(0, 1)) for s in steps).tolist()
        rays, blocked, tested = (
            sum(int(np.sum(getattr(s, f))) for s in steps) for f in ("rays", "blocked", "triangles")
        )
        rows.append(Counted(view.name, method, shown, len(vertices), rays, blocked, tuple(boxes), tested))

    sah = binned_sah.build(vertices, work.threads, 1)
    for name in SAH_ORDERS:
        count(name, None, Ordered(ORDERS[name].prepare(sah), ORDERS[name].value))
    if rows[0].total == 0:
        raise InputError(f"{view.name}: no light is above any surface; choose a scene whose lights shine on something")
    for width in (*pixels, None):
        say(f"{view.name}, what the rays of {width or 'all'} pixels meet")
        met = work.shown(width, work.sah).among(vertices, None, work.threads)
        for method, (build, order) in METHODS.items():
            if width is None or method in (PUBLISHED, OURS):
                say(f"{view.name}, building {method}")
                count(method, width, Ordered(build(vertices, work.threads, rays=met), order))
    return rows


def of(rows: Iterable[Counted], scene: str, method: str, pixels: int | None = None) -> Counted:
    """The row of a scene, a method and a pre-render."""
    return next(r for r in rows if (r.scene, r.method, r.pixels) == (scene, method, pixels))


def scenes_of(rows: Iterable) -> list[str]:
    """The names of the scenes, in order."""
    return list(dict.fromkeys(r.scene for r in rows))


def relative(rows: Iterable[Counted], row: Counted) -> float:
    """The box tests of a row, relative to random order in the same scene."""
    return row.total / of(rows, row.scene, BASE).total


def saved(rows: Iterable[Counted], row: Counted, than: str = BASE) -> float:
    """The share of the box tests that a row saves compared with method `than`."""
    return 1.0 - row.total / of(rows, row.scene, than).total


def saved_unoccluded(rows: Iterable[Counted], row: Counted) -> float:
    """The share of box tests of unoccluded rays that a row saves; 0 if there are none.

    All orders of a tree test the same number of boxes for an unoccluded ray.
    """
    before = of(rows, row.scene, BASE).boxes[UNOCCLUDED]
    return 1.0 - row.boxes[UNOCCLUDED] / before if before else 0.0


def beyond_all(rows: Iterable[Counted], row: Counted) -> float:
    """The extra box tests of a tree for a pre-render's rays, as a share of those of the tree for all rays."""
    return row.total / of(rows, row.scene, row.method).total - 1.0
