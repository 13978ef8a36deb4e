"""The tracer `cones`, apart from its kernels, so that other plans start sooner."""

import numpy as np

from ...base.progress import ProgressCallback
from ...query.shadow_query import ShadowQuery
from ...scene.lights import DIRECTIONAL, FIXED
from ...trace.tracer import TRIANGLES, Bits, Box, Counters, Tracer
from ...trace.tracer_cost import TreelessCost
from ..culling.pre_bvh_culling import Soup
from ..tracer_options import FASTEST_RAY_HIERARCHY, RayHierarchyOptions

OLSSON = "Olsson and Assarsson 2011, Improved ray hierarchy alias free shadows"

_MAX_SAMPLES = 4  # of queries for which cones may be faster than rays


class RayHierarchyTracer(Tracer):
    """A hierarchy over the rays, traversed by triangles, instead of a BVH over the triangles."""

    paper = OLSSON
    form = TRIANGLES

    def __init__(self, options: RayHierarchyOptions, description: str):
        self.options, self.description = options, description

    def trace(
        self,
        prepared: Soup,
        query: ShadowQuery,
        bits: Bits,
        threads: int | None = None,
        counters: Counters | None = None,
        progress: ProgressCallback | None = None,
        fresh: bool = True,
    ) -> None:
        from .ray_hierarchy import trace_shadow

        if not fresh:
            bits[...] = 0  # every segment is traced
        trace_shadow(prepared, query, bits, threads, counters, progress, self.options)


class FastestCones(RayHierarchyTracer):
    """The tracer `cones`."""

    cost = TreelessCost(triangles=0.03, saving=0.25, reason="one apex, many rays per triangle")

    def __init__(self) -> None:
        text = "a hierarchy over the shadow rays, traversed by triangles, instead of one over the scene"
        super().__init__(FASTEST_RAY_HIERARCHY, text)

    def suits(self, query: ShadowQuery, box: Box) -> bool:
        return has_one_apex(query) and query.samples.shape[1] <= _MAX_SAMPLES


def has_one_apex(query: ShadowQuery) -> bool:
    """Whether all segments of a query end in one point or have one direction."""
    light = query.light
    return light.kind == DIRECTIONAL or (light.kind == FIXED and not np.any(light.u) and not np.any(light.v))
