"""Shadow queries at points over terrain, without a tree and without stored triangles.

The plan ``auto`` answers queries at points, and finds any or the nearest hits of ray lists, by these rays if the scene
is a single raster of heights. They take about 10 bytes per cell, where triangles and their trees take about 400, and
have the bits of every other plan. Pictures, lists of all hits and other plans use the triangles.

Rays from the vertices towards distant lights go 16 at a time, along stencils. They are faster than any tree.
"""

from collections.abc import Sequence
from time import perf_counter
from typing import cast

import numpy as np
from numpy.typing import NDArray

from ...base.memory import available_memory
from ...base.progress import ProgressCallback
from ...query.query_bounds import place, reach_of
from ...query.ray_list import HitArrays, RayArguments, changed_error, hit_arrays
from ...query.receivers import Receivers
from ...query.shadow_query import ShadowQuery, new_bits
from ...scene.light_lists import DirectionalLights
from ...scene.lights import DIRECTIONAL, Light
from ...scene.scene_bounds import flush_to_zero
from ...scene.scene_data import MemoryData, SceneData
from ...scene.terrain import HeightGrid, TerrainSurfaces, faces_of_squares
from ...trace.rays.local_rays import are_valid, local_rays
from ...trace.terrain.terrain_lanes import trace_stencils
from ...trace.terrain.terrain_ray_lists import MOST_EXTENTS, trace_rays
from ...trace.terrain.terrain_rays import TerrainTree, terrain_tree, trace_terrain
from ...trace.terrain.terrain_stencils import Relief, Stencils, relief_of, stencils_of
from ...trace.transmission import TracedQuery
from ..auto.cost_model import GOOD, build_seconds
from ..plan import DEFAULT_PLAN, Plan
from ..precompilation import precompile

_TREE_BYTES = 400  # memory of a triangle with its trees
_SHARE = 0.7  # of the available memory, which they may take
_RAYS_PER_TRIANGLE = 4  # rays that take as much longer here than in a tree as the tree takes to build
_LISTED = 1 << 16  # rays of a list that are traced between looks at the clock
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
        self._relief: Relief | None = None  # made with the first stencils
        self._squares: NDArray[np.int32] | None = None  # made for the first nearest hits
        self._rays = 0  # of all queries so far
        self._seconds = 0.0  # of all threads, spent on ray lists so far
        self._has_room: bool | None = None  # for a tree; None: not needed yet

    def serves(self, plan: Plan, receivers: Receivers, lights: Sequence[Light], rays: int) -> bool:
        """Whether a query of a plan with a number of rays is answered here.

        By the ski-rental rule, a tree replaces these rays once they have taken as long as it takes to build, if it
        takes a part of the memory that is available. Rays along stencils are faster than the tree.
        """
        if str(plan) != DEFAULT_PLAN or (surface := terrain_of(self._data)) is None:
            return False
        if all(isinstance(light, DirectionalLights) for light in lights) and _follows_rows(receivers, surface):
            return True
        self._rays += rays
        return self._rays <= _RAYS_PER_TRIANGLE * self._data.n_triangles or not self._has_room_for_tree()

    def _has_room_for_tree(self) -> bool:
        if self._has_room is None:
            self._has_room = _TREE_BYTES * self._data.n_triangles <= _SHARE * (available_memory() or 0)
        return self._has_room

    def trace_rays(self, plan: Plan, rays: RayArguments, any_hit: bool, threads: int) -> HitArrays | None:
        """The hits of the rays of a plan; None if they are to be traced through a tree.

        That is so once rays have taken as long here as it takes to build one, if there is room for it. Rays below the
        surface take many times as long as others, so time is counted, not rays.

        Raises
        ------
        InputError
            If a ray is invalid: NaN, infinity, a zero direction, ...
        """
        surface = terrain_of(self._data) if str(plan) == DEFAULT_PLAN else None
        if surface is None or not (isinstance(rays.skip, float) and rays.skip < 0.0):
            return None
        budget = build_seconds(GOOD, self._data.n_triangles)
        if self._seconds > budget and self._has_room_for_tree():
            return None
        local = local_rays(rays.arrays(), rays.cull_faces)
        if not are_valid(local):
            rays.arrays().check()
            raise changed_error()
        reach = MOST_EXTENTS * float(np.ptp(self._data.bounds, axis=0)[:2].max())
        ends = (local.origins, local.directions) if rays.segments else (local.origins,)
        if any(each.size and float(np.abs(each).max()) > reach for each in ends):
            return None
        precompile("ray lists over terrain")
        if not any_hit and self._squares is None:
            self._squares = faces_of_squares(surface)
        squares, out = None if any_hit else self._squares, hit_arrays(rays.n, any_hit)
        for first in range(0, rays.n, _LISTED):
            start, part = perf_counter(), slice(first, first + _LISTED)
            trace_rays(self.tree, squares, local.part(part), HitArrays(*(each[part] for each in out)), threads)
            self._seconds += (perf_counter() - start) * threads
            if self._seconds > budget and self._has_room_for_tree():
                return None
        return out

    @property
    def tree(self) -> TerrainTree:
        """The surface with its pyramid; only for scenes that are a single raster of heights."""
        if self._tree is None:
            self._tree = terrain_tree(cast(HeightGrid, terrain_of(self._data)), self._data.origin)
        return self._tree

    @property
    def relief(self) -> tuple[TerrainTree, Relief]:
        """`tree`, and its heights for lanes."""
        if self._relief is None:
            self._relief = relief_of(self.tree)
        return self.tree, self._relief

    def shadows(
        self, receivers: Receivers, lights: Sequence[Light], samples: Sequence[NDArray[np.float64]], facing: int,
        threads: int, progress: ProgressCallback | None,
    ) -> list[TracedQuery]:  # fmt: skip
        """The shadow query of each light, with its answer; see `Engine.shadows`."""
        precompile("terrain")
        return self.trace(receivers, lights, samples, facing, threads, progress)

    def trace(
        self, receivers: Receivers, lights: Sequence[Light], samples: Sequence[NDArray[np.float64]], facing: int,
        threads: int, progress: ProgressCallback | None,
    ) -> list[TracedQuery]:  # fmt: skip
        """`shadows`, once its kernels are compiled."""
        data, tree = self._data, self.tree
        origins, sides, normals = receivers
        box = flush_to_zero((data.bounds - data.origin).astype(np.float32))
        reach = reach_of(box, origins, threads) if origins.size else 1.0
        no_faces, traced = np.full(sides.shape, -1, np.int32), []
        distant = any(isinstance(light, DirectionalLights) for light in lights)
        in_rows = distant and _follows_rows(receivers, cast(HeightGrid, terrain_of(data)))
        for light, sets in zip(lights, samples):
            patch = place(light, data.origin, box, reach)
            query = ShadowQuery(origins, no_faces, sides, normals, _NO_CORNERS, patch, sets, facing, no_faces)
            bits, stencils = new_bits(query), self._stencils(query) if in_rows else None
            if stencils is None:
                trace_terrain(tree, query, bits, threads, progress)
            else:
                trace_stencils(*self.relief, stencils, query, bits, threads, progress)
            traced.append(TracedQuery(query, bits, None))
        return traced

    def _stencils(self, query: ShadowQuery) -> Stencils | None:
        """The stencils of a query of parallel rays; None if it has none."""
        light, sets = query.light, query.samples
        if light.kind != DIRECTIONAL or query.cull_faces != 0 or not (sets == sets[0]).all():
            return None
        return stencils_of(*self.relief, light.base + sets[0] @ np.stack([light.u, light.v, light.w]))


def _follows_rows(receivers: Receivers, surface: HeightGrid) -> bool:
    """Whether most receivers lie one column east of the one before them."""
    steps = np.diff(receivers.origins.reshape(-1, 3)[:, :2].astype(np.float64), axis=0)
    next_to = (np.abs(steps[:, 0] - surface.grid.dx) < 0.01 * surface.grid.dx) & (steps[:, 1] == 0.0)
    return 2 * int(next_to.sum()) > len(next_to)
