"""Terrain: a source of shadow rays of points and of ray lists, without a tree and without stored triangles.

The plan ``auto`` answers queries at points, and finds any or the nearest hits of ray lists, by these rays if the scene
is a single raster of heights. They take about 10 bytes per cell, where triangles and their trees take about 400, and
have the bits of every other plan. Pictures, lists of all hits and other plans use the triangles, and `TerrainShadows`
hands over to them once that pays off.

Rays from the vertices towards distant lights go 16 at a time, along stencils. They are faster than any tree.
"""

from collections.abc import Callable, Iterable
from time import perf_counter

import numpy as np
from numpy.typing import NDArray

from ...base.memory import available_memory
from ...base.progress import ProgressCallback
from ...query.equal_samples import copy_bits, with_distinct_samples
from ...query.ray_list import HitArrays, RayArguments, TracedRays, changed_error, hit_arrays
from ...query.receivers import Receivers
from ...query.shadow_query import ShadowQuery, new_bits
from ...scene.light_lists import DirectionalLights
from ...scene.lights import DIRECTIONAL
from ...scene.scene_bounds import flush_to_zero
from ...scene.scene_data import SceneData
from ...scene.terrain import HeightGrid, faces_of_squares
from ...trace.rays.local_rays import are_valid, local_rays
from ...trace.terrain.terrain_lanes import trace_stencils
from ...trace.terrain.terrain_ray_lists import MOST_EXTENTS, trace_rays
from ...trace.terrain.terrain_rays import TerrainTree, terrain_tree, trace_terrain
from ...trace.terrain.terrain_stencils import Relief, Stencils, relief_of, stencils_of
from ...trace.terrain.terrain_views import Ground, Over, ground_of, height_over, view_from
from ...trace.transmission import TracedQuery
from ..auto.cost_model import GOOD, build_seconds
from ..precompilation import precompile
from .in_memory_source import RayLists
from .point_shadows import SceneFrame, queries_of
from .source_protocols import PointQuery, PointSource

_TREE_BYTES = 400  # memory of a triangle with its trees
_SHARE = 0.7  # of the available memory, which they may take
_RAYS_PER_TRIANGLE = 4  # rays that take as much longer here than in a tree as the tree takes to build
_LISTED = 1 << 16  # rays of a list that are traced between looks at the clock
_NO_CORNERS = np.empty((0, 9), np.float32)


class TerrainPyramid:
    """The surface of a raster of heights, with a pyramid of its greatest heights, made when they are first needed.

    It stays what it was when it was made, also while users move the scene.

    data : SceneData
        A scene that is a single raster of heights.
    """

    def __init__(self, data: SceneData):
        surface = data.terrain
        assert surface is not None
        self.surface, self._bounds = surface, data.bounds
        self._frame = SceneFrame(data.origin, flush_to_zero((data.bounds - data.origin).astype(np.float32)))
        self._tree: TerrainTree | None = None
        self._relief: Relief | None = None  # made with the first stencils
        self._squares: NDArray[np.int32] | None = None  # made for the first nearest hits
        self._ground: Ground | None = None  # made for the first view

    @property
    def tree(self) -> TerrainTree:
        """The surface with its pyramid."""
        if self._tree is None:
            self._tree = terrain_tree(self.surface, self._frame.origin)
        return self._tree

    @property
    def relief(self) -> tuple[TerrainTree, Relief]:
        """`tree`, and its heights for lanes."""
        if self._relief is None:
            self._relief = relief_of(self.tree)
        return self.tree, self._relief

    @property
    def ground(self) -> Ground:
        """The heights of `tree`, for views."""
        if self._ground is None:
            self._ground = ground_of(self.tree.x, self.tree.y, self.tree.z)
        return self._ground

    def over(self, sensors: Receivers, cells: NDArray[np.int64] | None, height: float | None) -> Over | None:
        """How sensors lie above cells, by `height_over`; cells None: all. None if they are not those of the cells."""
        size = self.surface.heights.size
        if sensors.n != (size if cells is None else len(cells)) or not sensors.n:
            return None
        if cells is not None and int(cells.max()) >= size:
            return None
        return height_over(self.ground, sensors.origins[0], cells, height)

    def view(self, eye: NDArray[np.float32], height: float, far: float, threads: int) -> NDArray[np.uint8] | None:
        """(cells,) uint8: what an eye sees of sensors at a height above all cells, by `view_from`."""
        precompile("terrain views")
        classes = view_from(self.ground, eye, height, threads, far)
        return None if classes is None else classes.reshape(-1)

    @property
    def extent(self) -> float:
        """The longer side of the surface."""
        return float(np.ptp(self._bounds, axis=0)[:2].max())

    @property
    def squares(self) -> NDArray[np.int32]:
        """The face of each square, for nearest hits."""
        if self._squares is None:
            self._squares = faces_of_squares(self.surface)
        return self._squares

    def shadows(self, points: PointQuery, threads: int, progress: ProgressCallback | None) -> list[TracedQuery]:
        """The shadow query of each light, with its answer."""
        traced, in_rows = [], self.has_stencils(points, any)
        for query in queries_of(points, self._frame, _NO_CORNERS, threads):
            few = with_distinct_samples(query)
            bits, stencils = new_bits(few), self._stencils(few) if in_rows else None
            if stencils is None:
                trace_terrain(self.tree, few, bits, threads, progress)
            else:
                trace_stencils(*self.relief, stencils, few, bits, threads, progress)
            bits = bits if few is query else copy_bits(bits, query.samples.shape[1])
            traced.append(TracedQuery(query, bits, None))
        return traced

    def has_stencils(self, points: PointQuery, how_many: Callable[[Iterable[bool]], bool]) -> bool:
        """Whether points follow the rows of the raster, and any or all of the lights are distant."""
        distant = how_many(isinstance(light, DirectionalLights) for light in points.lights)
        return distant and _follows_rows(points.receivers, self.surface)

    def _stencils(self, query: ShadowQuery) -> Stencils | None:
        """The stencils of a query of parallel rays; None if it has none."""
        light, sets = query.light, query.samples
        if light.kind != DIRECTIONAL or query.cull_faces != 0 or not (sets == sets[0]).all():
            return None
        return stencils_of(*self.relief, light.base + sets[0] @ np.stack([light.u, light.v, light.w]))


class TerrainShadows:
    """Terrain as a `PointSource` and a `HitSource`, which hands over to the trees of a scene in memory.

    By the ski-rental rule, it does so once its rays have taken as long as a tree takes to build, if a tree takes a part
    of the memory that is available; and at once where it cannot answer a query.

    Parameters
    ----------
    data : SceneData
        Its `terrain` is not None; it may become so when users move the scene.
    ray_lists : RayLists
    points : PointSource
        These two answer what is handed over.
    threads : int

    Attributes
    ----------
    pyramid : TerrainPyramid
    """

    def __init__(self, data: SceneData, ray_lists: RayLists, points: PointSource, threads: int):
        self.pyramid = TerrainPyramid(data)
        self._data, self._ray_lists, self._points, self._threads = data, ray_lists, points, threads
        self._rays = 0  # of all point queries so far
        self._seconds = 0.0  # of all threads, spent on ray lists so far
        self._has_room: bool | None = None  # for a tree; None: not needed yet

    @property
    def prefers_rows(self) -> bool:
        return self._data.terrain is not None

    def over(self, sensors: Receivers, cells: NDArray[np.int64] | None, height: float | None) -> Over | None:
        """`TerrainPyramid.over`; None also if the scene is no terrain any more."""
        return None if self._data.terrain is None else self.pyramid.over(sensors, cells, height)

    def view(self, eye: NDArray[np.float32], height: float, far: float) -> NDArray[np.uint8] | None:
        """`TerrainPyramid.view`."""
        return self.pyramid.view(eye, height, far, self._threads)

    def shadows(self, points: PointQuery, progress: ProgressCallback | None) -> list[TracedQuery]:
        """The shadow query of each light, with its answer."""
        if not self.serves(points):
            return self._points.shadows(points, progress)
        precompile("terrain")
        return self.pyramid.shadows(points, self._threads, progress)

    def serves(self, points: PointQuery) -> bool:
        """Whether a query is answered here. Rays along stencils are always faster than a tree."""
        if self._data.terrain is None:
            return False
        if self.pyramid.has_stencils(points, all):
            return True
        self._rays += points.rays
        return self._rays <= _RAYS_PER_TRIANGLE * self._data.n_triangles or not self._has_room_for_tree()

    def _has_room_for_tree(self) -> bool:
        if self._has_room is None:
            self._has_room = _TREE_BYTES * self._data.n_triangles <= _SHARE * (available_memory() or 0)
        return self._has_room

    def trace_rays(self, rays: RayArguments, any_hit: bool, threads: int) -> TracedRays:
        """The hits of rays. InputError if a ray is invalid."""
        hits = None if self._ray_lists.plan is not None else self._hits(rays, any_hit, threads)
        if hits is None:
            return self._ray_lists.trace_rays(rays, any_hit, threads)
        if any_hit:
            return TracedRays(hits, None)
        face = hits.face.reshape(rays.shape)
        return TracedRays(hits, lambda: (self._ray_lists.triangles(0.0), face))  # triangles are made only then

    def _hits(self, rays: RayArguments, any_hit: bool, threads: int) -> HitArrays | None:
        """The hits of rays; None if they are to be traced through a tree.

        Rays below the surface take many times as long as others, so time is counted, not rays.
        """
        if self._data.terrain is None or not (isinstance(rays.skip, float) and rays.skip < 0.0):
            return None
        budget = build_seconds(GOOD, self._data.n_triangles)
        if self._seconds > budget and self._has_room_for_tree():
            return None
        local = local_rays(rays.arrays(), rays.cull_faces)
        if not are_valid(local):
            rays.arrays().check()
            raise changed_error()
        reach = MOST_EXTENTS * self.pyramid.extent
        ends = (local.origins, local.directions) if rays.segments else (local.origins,)
        if any(each.size and float(np.abs(each).max()) > reach for each in ends):
            return None
        precompile("ray lists over terrain")
        squares, out = None if any_hit else self.pyramid.squares, hit_arrays(rays.n, any_hit)
        for first in range(0, rays.n, _LISTED):
            start, part = perf_counter(), slice(first, first + _LISTED)
            trace_rays(self.pyramid.tree, squares, local.part(part), HitArrays(*(each[part] for each in out)), threads)
            self._seconds += (perf_counter() - start) * threads
            if self._seconds > budget and self._has_room_for_tree():
                return None
        return out


def _follows_rows(receivers: Receivers, surface: HeightGrid) -> bool:
    """Whether most receivers lie one column east of the one before them."""
    steps = np.diff(receivers.origins.reshape(-1, 3)[:, :2].astype(np.float64), axis=0)
    next_to = (np.abs(steps[:, 0] - surface.grid.dx) < 0.01 * surface.grid.dx) & (steps[:, 1] == 0.0)
    return 2 * int(next_to.sum()) > len(next_to)
