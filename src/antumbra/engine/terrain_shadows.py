"""Shadow queries at points over terrain, without a tree and without stored triangles.

The plan ``auto`` answers queries at points by these rays if the scene is a single raster of heights. They take about 10
bytes per cell, where triangles and their trees take about 400, and have the bits of every other plan. Pictures, ray
lists and other plans use the triangles.
"""

from collections.abc import Sequence
from typing import cast

import numpy as np
from numpy.typing import NDArray

from ..formats.gis.gis_data import terrain_data
from ..formats.gis.height_files import HeightOptions
from ..progress import ProgressCallback
from ..query.light_samples import light_samples
from ..query.query_bounds import place, reach_of
from ..query.receivers import Receivers
from ..query.shadow_query import ShadowQuery, new_bits
from ..scene.lights import DirectionalLight, Light
from ..scene.scene_bounds import flush_to_zero
from ..scene.scene_data import MemoryData, SceneData
from ..scene.terrain import HeightGrid, TerrainSurfaces
from ..trace.terrain_rays import TerrainTree, terrain_tree, trace_terrain
from ..trace.transmission import TracedQuery
from .plan import DEFAULT_PLAN, Plan
from .precompilation import Job, fixed_job, precompile

_TREE_BYTES = 400  # memory of a triangle with its trees
_SHARE = 0.7  # of the available memory, which they may take
_RAYS_PER_TRIANGLE = 4  # rays that take as much longer here than in a tree as the tree takes to build
_NO_CORNERS = np.empty((0, 9), np.float32)


def terrain_of(data: SceneData) -> HeightGrid | None:
    """The surface of a scene that is a single raster of heights in memory, solid and where it was read."""
    still = isinstance(data, MemoryData) and data.moved is None and data.cutouts is None
    source = cast(MemoryData, data).source if still else None
    surface = source.surface if isinstance(source, TerrainSurfaces) else None
    return surface if isinstance(surface, HeightGrid) else None


class TerrainShadows:
    """Answers shadow queries over a raster of heights. Callers take turns."""

    def __init__(self, data: SceneData):
        self._data = data
        self._tree: TerrainTree | None = None
        self._rays = 0  # of all queries so far
        self._has_room: bool | None = None  # for a tree; None: not needed yet

    def serves(self, plan: Plan, rays: int) -> bool:
        """Whether a query of a plan with a number of rays is answered here.

        By the ski-rental rule, a tree replaces these rays once they have taken as long as it takes to build, if it
        takes a part of the memory that is available.
        """
        if str(plan) != DEFAULT_PLAN or terrain_of(self._data) is None:
            return False
        self._rays += rays
        triangles = self._data.n_triangles
        if self._rays <= _RAYS_PER_TRIANGLE * triangles:
            return True
        if self._has_room is None:
            from ..store.system_resources import available_memory  # scenes in memory need no stores

            self._has_room = _TREE_BYTES * triangles <= _SHARE * (available_memory() or 0)
        return not self._has_room

    def shadows(
        self, receivers: Receivers, lights: Sequence[Light], samples: Sequence[NDArray[np.float64]], facing: int,
        threads: int, progress: ProgressCallback | None,
    ) -> list[TracedQuery]:  # fmt: skip
        """The shadow query of each light, with its answer; see `Engine.shadows`."""
        precompile(terrain_job)
        return self.trace(receivers, lights, samples, facing, threads, progress)

    def trace(
        self, receivers: Receivers, lights: Sequence[Light], samples: Sequence[NDArray[np.float64]], facing: int,
        threads: int, progress: ProgressCallback | None,
    ) -> list[TracedQuery]:  # fmt: skip
        """`shadows`, once its kernels are compiled."""
        data = self._data
        if self._tree is None:
            self._tree = terrain_tree(cast(HeightGrid, terrain_of(data)), data.origin)
        origins, sides, normals = receivers
        box = flush_to_zero((data.bounds - data.origin).astype(np.float32))
        reach = reach_of(box, origins, threads) if origins.size else 1.0
        no_faces, traced = np.full(sides.shape, -1, np.int32), []
        for light, sets in zip(lights, samples):
            patch = place(light, data.origin, box, reach)
            query = ShadowQuery(origins, no_faces, sides, normals, _NO_CORNERS, patch, sets, facing, no_faces)
            bits = new_bits(query)
            trace_terrain(self._tree, query, bits, threads, progress)
            traced.append(TracedQuery(query, bits, None))
        return traced


def terrain_job() -> Job:
    """The job of shadow queries over terrain."""

    def work() -> None:
        data = terrain_data((np.zeros((3, 3)), (1.0, 0.0, 0.0, 0.0, -1.0, 0.0)), HeightOptions())
        light, points = (
            DirectionalLight((0.0, 0.0, -1.0)),
            Receivers.in_space(np.array([[1.0, -1.0, 1.0]]), data.origin),
        )
        TerrainShadows(data).trace(points, [light], [light_samples(light, 1)], 0, 1, None)

    return fixed_job("terrain", work)
