"""The tracer `cones`, apart from its kernels, so that other plans start sooner."""

from ...base.progress import ProgressCallback
from ...query.equal_samples import have_equal_samples
from ...query.shadow_query import ShadowQuery
from ...trace.tracer import TRIANGLES, Bits, Box, Counters, Tracer
from ...trace.tracer_cost import QueryFeatures, TreelessCost
from ..culling.pre_bvh_culling import Soup
from ..tracer_options import FASTEST_RAY_HIERARCHY, RayHierarchyOptions

OLSSON = "Olsson and Assarsson 2011, Improved ray hierarchy alias free shadows"


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


def cone_rate(features: QueryFeatures) -> float:
    """Nanoseconds per ray by `cones`, to one apex: of its own, and shares of those per triangle and per query."""
    return 5.0 + 10.0 * features.facing + (13.0 * features.triangles + 2.3e6) / max(features.rays, 1)


class FastestCones(RayHierarchyTracer):
    """The tracer `cones`."""

    cost = TreelessCost(cone_rate, candidate=2.5, reason="one apex")

    def __init__(self) -> None:
        text = "a hierarchy over the shadow rays, traversed by triangles, instead of one over the scene"
        super().__init__(FASTEST_RAY_HIERARCHY, text)

    def suits(self, query: ShadowQuery, box: Box) -> bool:
        return has_one_apex(query)


def has_one_apex(query: ShadowQuery) -> bool:
    """Whether all segments of a query end in one point or have one direction."""
    return have_equal_samples(query.light, query.samples.reshape(1, -1, 3))
