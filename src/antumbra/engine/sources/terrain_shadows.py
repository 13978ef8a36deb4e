"""Terrain: a source of shadow rays of points and of ray lists, without a tree and without stored triangles.

The plan ``auto`` answers queries at points, and finds any or the nearest hits of ray lists, by these rays if the scene
is a single raster of heights. They take about 10 bytes per cell, where triangles and their trees take about 400, and
have the bits of every other plan. Pictures, lists of all hits and other plans use the triangles, and `TerrainShadows`
hands over to them once that pays off.

Rays from the vertices towards distant lights go 16 at a time, along stencils. They are faster than any tree.
"""

from collections.abc import Callable, Iterable
from functools import partial
from time import perf_counter

import numpy as np
from numpy.typing import NDArray

from ...base.errors import InputError
from ...base.memory import available_memory, readable_size
from ...base.progress import ProgressCallback
from ...query.equal_samples import copy_bits, with_distinct_samples
from ...query.ray_list import HitArrays, RayArguments, TracedRays, changed_error, hit_arrays
from ...query.receivers import Receivers
from ...query.shadow_query import ShadowQuery, new_bits
from ...scene.light_lists import DirectionalLights
from ...scene.lights import DIRECTIONAL
from ...scene.raster import CellWindow
from ...scene.scene_bounds import flush_to_zero
from ...scene.scene_data import SceneData
from ...scene.terrain import HeightGrid, faces_of_squares
from ...scene.triangles import Triangles
from ...trace.rays.local_rays import are_valid, local_rays
from ...trace.terrain.bordered_terrain import INSIDE, BorderedTerrain
from ...trace.terrain.terrain_lanes import trace_stencils
from ...trace.terrain.terrain_ray_lists import MOST_EXTENTS, trace_rays
from ...trace.terrain.terrain_rays import TerrainTree, terrain_tree, trace_terrain
from ...trace.terrain.terrain_stencils import Relief, Stencils, relief_of, stencils_of
from ...trace.terrain.terrain_views import Ground, Over, ground_of, height_over, view_from
from ...trace.transmission import TracedQuery
from ..auto.cost_model import GOOD, build_seconds
from ..precompilation import precompile
from .point_shadows import SceneFrame, queries_of
from .source_protocols import Memory, PointQuery, PointSource, RenderSource, TreeHits

_TREE_BYTES = 400  # memory of a triangle with its trees
_RELIEF_BYTES = 25  # memory of a cell of heights without a border, for lanes
_SHARE = 0.7  # of the available memory, which they may take
_RAYS_PER_TRIANGLE = 4  # rays that take as much longer here than in a tree as the tree takes to build
_LISTED = 1 << 16  # rays of a list that are traced between looks at the clock
_TRIED = 1 << 12  # rays of a list over a store that are traced first
_SLOW = 2.5e-6  # seconds of a ray below the surface, where a store's trees take half as long


class TerrainPyramid:
    """The surface of a raster of heights, with a pyramid of its greatest heights, made when they are first needed.

    It stays what it was when it was made, also while users move the scene.

    data : SceneData
        A scene that is a single raster of heights.
    memory : Memory, optional
        Of a source whose heights are read where they are needed, as far as this memory goes.
    """

    def __init__(self, data: SceneData, memory: Memory | None = None):
        surface = data.terrain
        assert surface is not None
        self._memory = memory
        self.surface, self._bounds = surface, data.bounds
        self._frame = SceneFrame(data.origin, flush_to_zero((data.bounds - data.origin).astype(np.float32)))
        self._tree: TerrainTree | None = None
        self._relief: tuple[TerrainTree, Relief] | None = None  # made with the first stencils
        self._towards = data.terrain_towards
        self._stencils: tuple[bytes, Relief, Stencils | None] | None = None  # of the latest offsets
        self._squares: NDArray[np.int32] | None = None  # made for the first nearest hits
        self._ground: Ground | None = None  # made for the first view

    @property
    def tree(self) -> TerrainTree | None:
        """The surface with its pyramid; None if it does not fit into memory."""
        if self._towards is not None:
            found = self._towards(None, 0.0, None, self._left)
            return None if found is None else found.tree
        if self._tree is None:
            self._tree = terrain_tree(self.surface, self._frame.origin)
        return self._tree

    def _left(self) -> float:
        """Bytes of memory that are left for the heights."""
        return np.inf if self._memory is None else self._memory.left()

    @property
    def relief(self) -> tuple[TerrainTree, Relief]:
        """The surface, without a border, and its heights for lanes. InputError if they do not fit into memory."""
        if self._relief is None:
            if self._tree is None:
                grid, need = self.surface.grid, _RELIEF_BYTES * self.surface.grid.rows * self.surface.grid.columns
                if need > (left := self._left()):
                    raise InputError(
                        f"{self.surface.name}: {grid.rows * grid.columns:,} cells take about {readable_size(need)} of "
                        f"memory, more than the {readable_size(left)} that are left; raise max_memory"
                    )
                heights = self.surface.rows(0, grid.rows)
                self._tree = terrain_tree(HeightGrid(self.surface.name, grid, None, heights), self._frame.origin)
            self._relief = self._tree, relief_of(self._tree)
        return self._relief

    @property
    def ground(self) -> Ground | None:
        """The heights, for views; None if they do not fit into memory."""
        if self._ground is None and (tree := self.tree) is not None:
            if self._towards is None:
                self._ground = ground_of(tree.x, tree.y, tree.z)
            elif 4 * tree.z.size <= self._left():
                (rows, columns), z = INSIDE, np.ascontiguousarray(tree.z[INSIDE])
                self._ground = ground_of(tree.x[columns].copy(), tree.y[rows].copy(), z)
        return self._ground

    def over(self, sensors: Receivers, cells: NDArray[np.int64] | None, height: float | None) -> Over | None:
        """How sensors lie above cells, by `height_over`; cells None: all. None if they are not those of the cells."""
        size = self.surface.grid.rows * self.surface.grid.columns
        if sensors.n != (size if cells is None else len(cells)) or not sensors.n:
            return None
        if cells is not None and int(cells.max()) >= size:
            return None
        ground = self.ground
        return None if ground is None else height_over(ground, sensors.origins[0], cells, height)

    def view(self, eye: NDArray[np.float32], height: float, far: float, threads: int) -> NDArray[np.uint8] | None:
        """(cells,) uint8: what an eye sees of sensors at a height above all cells, by `view_from`."""
        precompile("terrain views")
        assert self.ground is not None  # as it has sensors
        classes = view_from(self.ground, eye, height, threads, far)
        return None if classes is None else classes.reshape(-1)

    @property
    def extent(self) -> float:
        """The longer side of the surface."""
        return float(np.ptp(self._bounds, axis=0)[:2].max())

    @property
    def squares(self) -> NDArray[np.int32] | None:
        """The face of each square, for nearest hits; None if they do not fit into memory."""
        if self._squares is None and (tree := self.tree) is not None:
            if self._towards is not None and 2 * 4 * tree.z.size > self._left():
                return None
            faces = faces_of_squares(self.surface)
            missing = [(a - 1 - b) // 2 for a, b in zip(tree.z.shape, faces.shape)]  # in the border of the tree
            self._squares = np.pad(faces, [(n, n) for n in missing], constant_values=-1) if any(missing) else faces
        return self._squares

    def shadows(self, points: PointQuery, threads: int, progress: ProgressCallback | None) -> list[TracedQuery] | None:
        """The shadow query of each light, with its answer; None if the surface does not fit into memory."""
        traced, in_rows = list[TracedQuery](), self.has_stencils(points, any)
        window = self._window_of(points.receivers) if in_rows else None
        for query in queries_of(points, self._frame, threads):
            few = with_distinct_samples(query)
            bits, offsets = new_bits(few), _offsets_of(few)
            surface = self._surface_towards(few, offsets, window, in_rows)
            if surface is None:
                return None
            tree, relief = surface
            stencils = None
            if in_rows and relief is not None and offsets is not None and query.cull_faces == 0:
                stencils = self._stencils_of(tree, relief, offsets)
            if stencils is None or relief is None:
                trace_terrain(tree, few, bits, threads, progress)
            else:
                trace_stencils(tree, relief, stencils, few, bits, threads, progress)
            bits = bits if few is query else copy_bits(bits, query.samples.shape[1])
            traced.append(TracedQuery(query, bits, None))
        return traced

    def _surface_towards(
        self, query: ShadowQuery, offsets: NDArray[np.float64] | None, window: CellWindow | None, in_rows: bool
    ) -> tuple[TerrainTree, Relief | None] | None:
        """The surface that the segments of a query may meet, and its heights for lanes if they are in memory."""
        if self._towards is not None:
            lowest = float(query.origins[..., 2].min(initial=np.inf))
            found: BorderedTerrain | None = self._towards(offsets, lowest, window, self._left)
            return found
        if in_rows:
            return self.relief
        tree = self.tree
        return None if tree is None else (tree, None)

    def _window_of(self, receivers: Receivers) -> CellWindow | None:
        """The cells around receivers; None if any lie beside the surface."""
        grid = self.surface.grid
        cells = grid.cells_of(receivers.origins.reshape(-1, 3)[:, :2] + self._frame.origin[:2])
        (west, north), (east, south) = np.floor(cells.min(0)), np.ceil(cells.max(0))
        if west < -1 or north < -1 or east > grid.columns or south > grid.rows:
            return None
        row, column = max(int(north), 0), max(int(west), 0)
        last = min(int(south) + 1, grid.rows), min(int(east) + 1, grid.columns)
        return CellWindow(row, column, last[0] - row, last[1] - column)

    def _stencils_of(self, tree: TerrainTree, relief: Relief, offsets: NDArray[np.float64]) -> Stencils | None:
        """`stencils_of`, which blocks of the same study share."""
        latest, key = self._stencils, offsets.tobytes()
        if latest is None or latest[0] != key or latest[1] is not relief:
            latest = self._stencils = key, relief, stencils_of(tree, relief, offsets)
        return latest[2]

    def has_stencils(self, points: PointQuery, how_many: Callable[[Iterable[bool]], bool]) -> bool:
        """Whether points follow the rows of the raster, and any or all of the lights are distant."""
        distant = how_many(isinstance(light, DirectionalLights) for light in points.lights)
        return distant and _follows_rows(points.receivers, self.surface)


def _offsets_of(query: ShadowQuery) -> NDArray[np.float64] | None:
    """(n, 3) from receivers to the ends of the segments of a query of parallel rays; None for other queries."""
    light, sets = query.light, query.samples
    if light.kind != DIRECTIONAL or not (sets == sets[0]).all():
        return None
    offsets: NDArray[np.float64] = light.base + sets[0] @ np.stack([light.u, light.v, light.w])
    return offsets


class TerrainShadows:
    """Terrain as a `PointSource` and a `HitSource`, which hands over to the trees of a scene.

    By the ski-rental rule, it does so once its rays have taken as long as a tree takes to build, if a tree takes a part
    of the memory that is available; and at once where it cannot answer a query, or its heights do not fit into memory.
    The trees of a store exist, but only rays below the surface are faster there.

    Parameters
    ----------
    data : SceneData
        Its `terrain` is not None; it may become so when users move the scene.
    ray_lists : TreeHits
    points : PointSource
        These two answer what is handed over.
    threads : int
    source : RenderSource
        The scene.

    Attributes
    ----------
    pyramid : TerrainPyramid
    """

    def __init__(self, data: SceneData, ray_lists: TreeHits, points: PointSource, threads: int, source: RenderSource):
        self.pyramid, self._geometry = TerrainPyramid(data, source.memory), source.geometry
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
        traced = self.pyramid.shadows(points, self._threads, progress)
        return self._points.shadows(points, progress) if traced is None else traced

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
            fits = _TREE_BYTES * self._data.n_triangles <= _SHARE * (available_memory() or 0)
            self._has_room = fits and self._geometry is not None
        return self._has_room

    def trace_rays(self, rays: RayArguments, any_hit: bool, threads: int) -> TracedRays:
        """The hits of rays. InputError if a ray is invalid."""
        hits = None if self._ray_lists.plan is not None else self._hits(rays, any_hit, threads)
        if hits is None:
            return self._ray_lists.trace_rays(rays, any_hit, threads)
        if any_hit:
            return TracedRays(hits, None)
        if (geometry := self._geometry) is None:
            return TracedRays(hits, partial(self._triangles_hit, rays.copied(), threads))
        face = hits.face.reshape(rays.shape)
        return TracedRays(hits, lambda: (geometry.moment(0.0)[0], face))  # triangles are made only then

    def _triangles_hit(self, rays: RayArguments, threads: int) -> tuple[Triangles, NDArray[np.integer]]:
        """The triangles that rays hit, by tracing them through the trees of a store."""
        find = self._ray_lists.trace_rays(rays, False, threads).find
        assert find is not None
        return find()

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
        tree, squares = self.pyramid.tree, None if any_hit else self.pyramid.squares  # not in the time of the rays
        if tree is None or (squares is None and not any_hit):
            return None
        out = hit_arrays(rays.n, any_hit)
        first, n = 0, _TRIED if self._geometry is None else _LISTED
        while first < rays.n:
            start, part = perf_counter(), slice(first, first + n)
            trace_rays(tree, squares, local.part(part), HitArrays(*(each[part] for each in out)), threads)
            spent = (perf_counter() - start) * threads
            self._seconds += spent
            if self._seconds > budget and self._has_room_for_tree():
                return None
            if first == 0 and self._geometry is None and spent > _SLOW * min(n, rays.n) and rays.n > n:
                return None
            first, n = first + n, _LISTED
        return out


def _follows_rows(receivers: Receivers, surface: HeightGrid) -> bool:
    """Whether most receivers lie one column east of the one before them."""
    steps = np.diff(receivers.origins.reshape(-1, 3)[:, :2].astype(np.float64), axis=0)
    next_to = (np.abs(steps[:, 0] - surface.grid.dx) < 0.01 * surface.grid.dx) & (steps[:, 1] == 0.0)
    return 2 * int(next_to.sum()) > len(next_to)
