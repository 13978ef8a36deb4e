"""Shadow rays of points through trees: the last of the chain of `PointSource` of an engine."""

from typing import ClassVar, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...base.progress import ProgressCallback, split_progress
from ...query.query_bounds import place, reach_of
from ...query.shadow_query import ShadowQuery
from ...scene.triangles import Triangles
from ...trace.transmission import TracedQuery
from ..accelerator import Accelerated, Accelerator
from ..device_plans import cpu_plan
from ..plan_records import precompile_plan
from ..precompilation import precompile
from ..primary_visibility import precompiled_method
from .source_protocols import PointQuery, RenderSource, box_of, moment_of, points_memory


class PlanKernels:
    """Compiles the kernels of an engine's plan and source before its first query."""

    def __init__(self, source: RenderSource, accelerator: Accelerator):
        self._source, self._plan, self._ready = source, accelerator.plan, False

    def make_ready(self) -> None:
        """Compile them, once."""
        if not self._ready:
            if self._plan.device is not None:
                precompile("devices")
            precompile_plan(cpu_plan(self._plan), precompiled_method(self._source.gbuffer))
            self._source.warm_up()
            self._ready = True


class TreeShadows:
    """Traces the shadow rays of points through the trees of a source: a `PointSource`."""

    prefers_rows: ClassVar[bool] = False

    def __init__(self, source: RenderSource, accelerator: Accelerator, kernels: PlanKernels):
        self._source, self._accelerator, self._kernels = source, accelerator, kernels

    def shadows(self, points: PointQuery, progress: ProgressCallback | None) -> list[TracedQuery]:
        """The shadow query of each light, with its answer."""
        accelerator, memory = self._accelerator, self._source.memory
        self._kernels.make_ready()
        if memory is not None:
            memory.begin(points_memory(points))
        accelerator.begin(points.rays, points.later)
        accelerated, queries = self._tree_and_queries(points)
        accelerated.begin()
        if accelerated.cutouts is not None:
            cutouts = accelerated.cutouts.in_month(points.month)
            accelerated = accelerated._replace(cutouts=cutouts.as_holes() if points.whole else cutouts)
        steps = split_progress(progress, len(queries))
        bits = accelerator.answer_all(accelerated, queries, None, steps, points.known)
        return [accelerator.traced_query(accelerated, *each) for each in zip(queries, bits)]

    def _tree_and_queries(self, points: PointQuery) -> tuple[Accelerated, list[ShadowQuery]]:
        geometry = self._source.geometry
        if geometry is None:
            triangles, accelerated = moment_of(self._source, points.time)
        else:
            triangles, accelerated = geometry.for_points(points.time)
        queries = queries_in(self._source, triangles, points, self._accelerator.threads)
        if accelerated is None:  # the tree depends on the queries
            accelerated = self._accelerator.tree_for(triangles, queries)
            if geometry is not None:
                geometry.keep_for_points(accelerated)
        return accelerated, queries


def queries_in(source: RenderSource, triangles: Triangles, points: PointQuery, threads: int) -> list[ShadowQuery]:
    """The shadow query of each light, for the triangles of a moment."""
    frame = SceneFrame(triangles.origin, box_of(source, triangles))
    return queries_of(points, frame, threads)


class SceneFrame(NamedTuple):
    """Where a scene is."""

    origin: NDArray[np.float64]  # (3,) world: the origin of the recentred frame
    box: NDArray[np.float32]  # (2, 3): bounds of the scene, in the recentred frame


_NO_CORNERS = np.empty((0, 9), np.float32)  # points have no triangles of their own


def queries_of(points: PointQuery, frame: SceneFrame, threads: int) -> list[ShadowQuery]:
    """The shadow query of each light."""
    origins, sides, normals = points.receivers
    reach = reach_of(frame.box, origins, threads) if origins.size else 1.0
    no_faces = np.full(sides.shape, -1, np.int32)
    placed = [place(light, frame.origin, frame.box, reach) for light in points.lights]
    return [
        ShadowQuery(origins, no_faces, sides, normals, _NO_CORNERS, light, sets, points.facing, no_faces)
        for light, sets in zip(placed, points.samples)
    ]
