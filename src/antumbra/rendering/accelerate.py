"""From triangles to what a plan's tracer takes, and to its answers: build, optimise or update a tree, prepare it."""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from ..bvh.blocks import block_tree
from ..bvh.nodes import Bvh
from ..chcrt.trace import Scheduled
from ..cull.cull import Culled
from ..errors import InputError
from ..methods import BUILDERS, CULLERS, OPTIMISERS, UPDATERS
from ..plan import Plan
from ..query.shadow import ShadowQuery
from ..rayhierarchy.soup import soup_of
from ..scene.triangles import Triangles
from .srdh_rays import Bounce, Showing, Shown, SrdhRays, check_srdh_rays


class Accelerated(NamedTuple):
    """A scene at one moment with its BVH, if the plan has one."""

    triangles: Triangles  # all of them, whatever has been culled
    bvh: Bvh | None  # of those that are left; prim_ids counts in all; None: the tracer walks none
    prepared: Any  # what the plan's tracer takes: the BVH, something made from it, or a `Soup` of those left

    @property
    def scheduled(self) -> Scheduled | None:
        """The state of a tracer that remembers the frames before; None of others."""
        return self.prepared if isinstance(self.prepared, Scheduled) else None

    def begin(self) -> None:
        """A frame begins, or another question of points."""
        if self.scheduled is not None:
            self.scheduled.begin()


class Accelerator:
    """Makes by a plan what its tracer takes, and has it answer; keeps what updates need from one tree to the next.

    Parameters
    ----------
    plan : Plan
    threads : int
    srdh_rays : SrdhRays or None
        Which rays a builder is shown that wants some (`srdh`); None: the default.
    """

    def __init__(self, plan: Plan, threads: int, srdh_rays: SrdhRays | None = None):
        check_srdh_rays(srdh_rays, plan)
        self.plan, self.threads = plan, threads
        self.showing = Showing(srdh_rays or SrdhRays(), threads) if plan.wants_rays else None
        self.one_tree = plan.build is not None and self.showing is None  # for shadow rays and the camera's
        self._kept = UPDATERS[plan.update].keep(self._new_tree) if plan.update else None
        self._rays: Callable | None = None  # vertices, BVH of them -> Intersections; while a builder may want them

    def culled(self, triangles: Triangles, queries) -> Culled | None:
        """The triangles that segments of these queries can meet; None if the plan culls nothing."""
        return CULLERS[self.plan.cull].cull(triangles, queries, self.threads) if self.plan.cull else None

    def show(self, triangles: Triangles, queries, bvh: Bvh | None = None, bounce: Bounce | None = None) -> Shown | None:
        """The rays that this plan's builder is shown for these queries; None if it wants none. See `Showing.show`."""
        return self.showing.show(queries, triangles, bvh, bounce) if self.showing else None

    def build(self, triangles: Triangles, culled: Culled | None = None, shown: Shown | None = None) -> Accelerated:
        """All triangles, or those that culling left, ready to be traced: with a BVH, unless the tracer walks none.

        `shown` is for a builder that wants rays.

        Raises
        ------
        InputError
            If the builder wants rays, and none are shown.
        """
        if self.plan.build is None:
            return self.prepare(triangles, None, culled)
        if self.showing is not None:
            if shown is None:
                raise InputError(f"plan {str(self.plan)!r}: its builder wants rays of a picture, or of points that ask")
            kept = None if culled is None else culled.kept
            self._rays = lambda vertices, bvh: shown.among(vertices, kept, self.threads, bvh)
        try:
            bvh = self._tree(triangles.vertices if culled is None else culled.vertices)
        finally:
            self._rays = None
        if culled is not None:
            bvh = bvh._replace(prim_ids=culled.kept[bvh.prim_ids])
        if self.showing is not None:
            self.showing.built(bvh)
        return self.prepare(triangles, bvh, culled)

    def _tree(self, vertices) -> Bvh:
        if self._kept is not None:
            return self._kept.update(vertices, self.threads)
        return self._new_tree(vertices, self.threads)

    def _new_tree(self, vertices, threads) -> Bvh:
        assert self.plan.build is not None
        builder, name = BUILDERS[self.plan.build], self.plan.optimise
        bvh = builder.build(vertices, threads, **self._shown_to(builder, vertices))
        if name is None:
            return bvh
        return OPTIMISERS[name].optimise(bvh, threads, **self._shown_to(OPTIMISERS[name], vertices, bvh))

    def _shown_to(self, method, vertices, bvh: Bvh | None = None) -> dict:
        """The arguments of a method that wants rays; `bvh`: of the triangles, if there is one."""
        return {"rays": self._rays(vertices, bvh)} if method.wants_rays and self._rays else {}

    def of_all(self, triangles: Triangles) -> Accelerated:
        """All triangles for the camera's rays: in the plan's tree, or in one that is made for them."""
        return self.build(triangles) if self.one_tree else self.for_camera(triangles)

    def for_camera(self, triangles: Triangles) -> Accelerated:
        """What the camera's rays are traced through where the plan has no BVH, or one that is made for shadow rays."""
        bvh = BUILDERS["bsah"].build(triangles.vertices, self.threads)
        return Accelerated(triangles, bvh, block_tree(bvh, self.threads))

    def prepare(self, triangles: Triangles, bvh: Bvh | None, culled: Culled | None = None) -> Accelerated:
        """What this plan's tracer takes: made from the BVH that its builder made, if it walks one; else the triangles.

        `culled`: the triangles that are left; None: all.
        """
        made = soup_of(triangles, culled) if bvh is None else bvh
        return Accelerated(triangles, bvh, self.plan.tracer.prepare(made, self.threads))

    def answer(self, accelerated: Accelerated, query: ShadowQuery, tally=None, progress=None) -> np.ndarray:
        """The bits of a query by this plan's tracer, (h, w, ceil(spp / 64)) uint64."""
        bits = np.zeros((*query.sides.shape, -(-query.samples.shape[1] // 64)), np.uint64)
        self.plan.tracer.trace(accelerated.prepared, query, bits, self.threads, tally, progress)
        return bits
