"""Queries of points: which samples of lights do given receivers see, without a camera."""

import numpy as np

from ..query.bounds import reach_of
from ..query.horizon import below_horizon
from ..query.placing import place
from ..query.receivers import FREE
from ..query.shadow import ShadowQuery
from ..scene.lights import Light
from .memory import FrameMemory
from .render_jobs import warm_up
from .renderer import Progress, Renderer


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
        self._accelerator, self._source, self.threads = renderer.accelerator, renderer.source, renderer.threads
        warm_up(renderer.plan, renderer.source.gbuffer)
        self._source.warm_up()
        self._rays, self._time, self._box = rays, time, np.empty((0, 3))

    def begin(self, memory: FrameMemory) -> None:
        """Prepare triangles and tree; `memory`: of one query."""
        self._source.begin(memory)
        self._accelerator.begin(self._rays)
        self.triangles, self._ready = self._source.for_points(self._time)
        self._box = self._source.box(self.triangles)

    def query(self, origins, sides, normals, light: Light, samples, facing: int = 0) -> ShadowQuery:
        """The query of (h, w, 3) float32 receivers; see `ShadowQuery` for the other arrays."""
        reach = reach_of(self._box, origins, self.threads) if origins.size else 1.0
        no_faces = np.full(sides.shape, -1, np.int32)
        corners, patch = self.triangles.vertices.reshape(-1, 9), place(light, self.triangles.origin, self._box, reach)
        return ShadowQuery(origins, no_faces, sides, normals, corners, patch, samples, facing, no_faces)

    def answer(self, query: ShadowQuery) -> np.ndarray:
        """The bits of a query, (h, w, ceil(spp / 64)) uint64."""
        return self.answer_all([query])[0]

    def answer_all(self, queries: list[ShadowQuery], progress: Progress | None = None) -> list[np.ndarray]:
        """The bits of queries of receivers of the same shape, by one tree."""
        make, ready = self._accelerator, self._ready
        if ready is None:  # the tree depends on the queries
            culled, shown = make.culled(self.triangles, queries), make.show(self.triangles, queries)
            ready = make.build(self.triangles, culled, shown)
        ready.begin()
        return make.answer_all(ready, queries, None, progress)


class AskingPoints(PointQueries):
    """Points in a row that ask which samples of a light they see, as often as they like. `memory`: of one query."""

    def __init__(self, renderer: Renderer, time: float, rays: int, memory: FrameMemory):
        super().__init__(renderer, rays, time)
        self.begin(memory)

    def bits(self, receivers: np.ndarray, unit: np.ndarray | None, light, samples, cull_faces: int = 0) -> np.ndarray:
        """(n, ceil(spp / 64)) uint64: bit s is set where sample s is occluded.

        receivers : (n, 3) float32, in the recentred frame, already moved off their surfaces
        unit : (n, 3) float64 unit normals to the tested side; None: points in free space
        light : a light
        samples : (16, spp, 3) float64, in the light's domain
        cull_faces : a value of CULL_FACES
        """
        return self.answer(self.row(receivers, unit, light, samples, cull_faces))[0]

    def below(self, receivers: np.ndarray, unit: np.ndarray, light, samples) -> np.ndarray:
        """(n, ceil(spp / 64)) uint64: bit s is set where the receiver's own surface occludes sample s; see `bits`."""
        return below_horizon(self.row(receivers, unit, light, samples, 0), self.threads)[0]

    def row(self, receivers, unit, light, samples, cull_faces) -> ShadowQuery:
        """The query of `bits`."""
        sides = np.full((1, len(receivers)), FREE if unit is None else 1, np.int8)
        normals = np.empty((0, 0, 3)) if unit is None else unit[None]
        return self.query(receivers[None], sides, normals, light, samples, cull_faces)
