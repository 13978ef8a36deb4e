"""Queries of points: which samples of lights do given receivers see, without a camera."""

import numpy as np

from ..query.bounds import reach_of
from ..query.shadow import ShadowQuery
from ..scene.lights import Light
from .render_jobs import warm_up
from .renderer import Renderer


class PointQueries:
    """Answers queries of receivers that are no picture, all at one time; they share one tree if the plan allows it.

    Parameters
    ----------
    renderer : Renderer
        Holds the plan and the scene.
    rays : int
        About so many rays are in all queries.
    time : float
        Seconds.
    """

    def __init__(self, renderer: Renderer, rays: int, time: float):
        self._accelerator, self._source = renderer.accelerator, renderer.source
        warm_up(renderer.plan, renderer.source.gbuffer)
        self._source.warm_up()
        self._rays, self._time, self._box = rays, time, np.empty((0, 3))

    def begin(self, memory) -> None:
        """Prepare triangles and tree; `memory`: the `FrameMemory` of a query."""
        self._source.begin(memory)
        self._accelerator.begin(self._rays)
        self.triangles, self._ready = self._source.for_points(self._time)
        self._box = self._source.box(self.triangles)

    def query(self, origins, sides, normals, light: Light, samples, facing: int = 0) -> ShadowQuery:
        """The query of (h, w, 3) float32 receivers; see `ShadowQuery` for the other arrays."""
        reach = reach_of(self._box, origins, self._accelerator.threads) if origins.size else 1.0
        no_faces = np.full(sides.shape, -1, np.int32)
        corners, patch = self.triangles.vertices.reshape(-1, 9), light.patch(self.triangles.origin, reach)
        return ShadowQuery(origins, no_faces, sides, normals, corners, patch, samples, facing, no_faces)

    def answer(self, query: ShadowQuery) -> np.ndarray:
        """The bits of a query, (h, w, ceil(spp / 64)) uint64."""
        make, ready = self._accelerator, self._ready
        if ready is None:
            culled, shown = make.culled(self.triangles, [query]), make.show(self.triangles, [query])
            ready = make.build(self.triangles, culled, shown)
        ready.begin()
        return make.answer(ready, query)
