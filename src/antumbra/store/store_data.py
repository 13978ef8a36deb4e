"""The scene of a store: what `Scene` offers without all triangles in memory, and what needs them, if they fit."""

from collections.abc import Iterator
from functools import cached_property
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from ..base.checks import quoted
from ..base.errors import InputError
from ..base.memory import readable_size
from ..base.pickles import without_cached
from ..scene.alpha_masks import Cutouts
from ..scene.mesh import MeshInfo, ObjectInfo, Source
from ..scene.raster import CellWindow
from ..scene.scene_bounds import Detail, check_extent, frame_origin
from ..scene.scene_data import SceneData
from ..scene.terrain import TERRAIN_TYPE
from ..scene.triangles import Triangles
from .face_order import FaceCorners, every_triangle, gather_triangles
from .store_file import Store, open_store
from .store_format import VERSION
from .stored_cutouts import StoredCutouts
from .stored_heights import StoredTerrain
from .stored_looks import SceneLooks
from .system_resources import default_limit, resident_memory

_OF_LOOKS = "a store keeps the mean colour"  # in notes of earlier stores of scenes with materials
_WITH_CUTOUTS = 3  # the first version that has cut-outs
ALL_BYTES = 160
"""Memory for a triangle while all are gathered."""


class StoreData(SceneData):
    """Name, bounds, cameras and lights of a scene whose triangles are in a store. It is static."""

    resident: ClassVar[bool] = False
    max_memory: int | None = None  # limit in bytes on the memory of the process; None: `default_limit()`

    def __init__(self, store: Store):
        if not isinstance(store, Store):
            raise InputError(f"store is {quoted(store)}; antumbra.load opens a store by its path")
        meta = store.meta
        check_extent(meta.bounds, store.path.name)  # earlier versions built stores of narrower scenes
        self.store, self.name, self.up, self.notes, self.duration = store, meta.name, meta.up, meta.notes, 0.0
        if store.version < VERSION and any(_OF_LOOKS in note for note in meta.notes):
            old = "was built by an earlier version, without textures; build it again to show them"
            if store.version < _WITH_CUTOUTS:
                old = (
                    "was built by an earlier version, which made all faces solid; build it again if some let light pass"
                )
            self.notes = (*self.notes, f"{store.path.name}: {old}")
        self.meshes: list[MeshInfo] = []
        self.objects = [ObjectInfo(meta.name, -1, 0, "" if meta.heights is None else TERRAIN_TYPE)]
        if (kept := meta.objects) is not None:
            self.objects = [ObjectInfo(name, -1, 0, *of) for name, *of in zip(kept.names, kept.types, kept.parents)]
            self.lacks_surfaces = kept.had_surfaces
        self.bounds, self.origin, self.crs = meta.bounds, meta.origin, meta.crs
        self.middle = frame_origin(*meta.bounds)
        self.raster, self.given_unit = meta.raster, meta.unit
        self._cameras, self._lights = list(meta.cameras), list(meta.lights)

    @property
    def n_triangles(self) -> int:
        return self.store.n_triangles

    @property
    def box(self) -> NDArray[np.float32]:
        """(2, 3) float32: exact bounds of all vertices, recentred."""
        return self.store.meta.box

    @property
    def cutout_bytes(self) -> int:
        """The memory that tracing of the cut-outs takes."""
        return self.store.cutout_bytes()

    @property
    def framed_points(self) -> NDArray[np.float64] | None:
        return self.store.meta.framed

    @property
    def detail(self) -> Detail | None:
        return self.store.meta.detail

    def __getstate__(self) -> dict[str, Any]:
        return without_cached(self)

    @cached_property
    def _surface(self) -> StoredTerrain | None:
        heights = self.store.heights()
        return None if heights is None else StoredTerrain(heights, self.bounds, self.n_triangles)

    @property
    def terrain(self) -> Any:
        """The heights, which are read where they are needed, in place of a `HeightGrid`; None for other scenes."""
        return None if self._surface is None else self._surface.heights

    @property
    def terrain_towards(self) -> Any:
        """`StoredTerrain.towards`; None for other scenes."""
        return None if self._surface is None else self._surface.towards

    def cell_tops(self, window: CellWindow | None = None) -> tuple[NDArray[np.float64], NDArray[np.integer]] | None:
        return None if self._surface is None else self._surface.pages.cell_tops(window)

    @cached_property
    def stored_cutouts(self) -> StoredCutouts | None:
        """`Store.cutouts`, read on first use."""
        return self.store.cutouts()

    @property
    def has_looks(self) -> bool:
        return self.stored_looks is not None

    @cached_property
    def stored_looks(self) -> SceneLooks | None:
        return self.store.looks()

    @property
    def cutouts(self) -> Cutouts | None:
        """The faces that let light pass; None: all are solid. `Cutouts.solid` is empty."""
        found = self.stored_cutouts
        return None if found is None or not len(found.cutouts.faces) else found.cutouts

    @property
    def has_cutouts(self) -> bool:
        """Whether some faces are in no chunk, but in `stored_cutouts`."""
        return self.store.has_cutouts

    @property
    def lets_light_pass(self) -> bool:
        return self.has_cutouts

    def ignore_alpha(self) -> None:
        """No-op if all faces are solid. InputError for others, since holes are not among the faces of a store."""
        if self.store.has_cutouts:
            raise InputError(f"{self.store.path.name}: keeps the holes of its scene; build it again with ?cutouts=off")

    @property
    def object_of_face(self) -> np.ndarray:
        """(n,) int32; a read-only broadcast array if the store is one object."""
        return np.broadcast_to(np.int32(0), self.n_triangles) if len(self.objects) == 1 else self._owners

    @cached_property
    def _owners(self) -> NDArray[np.int32]:
        objects = self.store.meta.objects
        assert objects is not None
        self.check_all(np.dtype(np.int32).itemsize)
        return np.repeat(np.array(objects.of, np.int32), objects.faces)

    @property
    def colours(self) -> np.ndarray:
        """Always raises InputError: the colours are in the chunks of the store."""
        raise self.refusal()

    @property
    def source(self) -> Source:
        """Always raises InputError: what the store was built from is not known."""
        raise self.refusal()

    def triangles(self, time: float = 0.0, threads: int | None = None) -> Triangles:
        """All triangles; those without an area are points. Raises the error of `check_all`."""
        self.clamped(time)  # refuses what is no number
        self.check_all(ALL_BYTES)
        stored = self.stored_cutouts
        clear = None if stored is None else stored.clear.faces
        cutouts = None if stored is None else stored.cutouts
        return all_triangles(*gather_triangles(self.store, stored), self.origin, cutouts, clear, threads)

    def every(self, step: int, time: float, threads: int | None = None) -> NDArray[np.float32]:
        return every_triangle(self.store, self.stored_cutouts, step)

    @cached_property
    def _face_corners(self) -> FaceCorners:
        return FaceCorners(self.store, self.stored_cutouts)

    def corners(self, time: float = 0.0, faces: NDArray[np.integer] | None = None) -> NDArray[np.float64]:
        """As `SceneData.corners`, in the precision of the frame; only coordinates of float32 are those of the source.

        All corners at once must fit in memory, see `check_all`; some are read from a scratch file that the first call
        makes.
        """
        if faces is None:
            self.check_all(ALL_BYTES)
            return gather_triangles(self.store, self.stored_cutouts).vertices + self.origin
        return self._face_corners.of(faces) + self.origin

    def check_all(self, size: int) -> None:
        """Check that `size` bytes for each triangle are left in memory. Raises InputError otherwise."""
        if not self.fits(size):
            raise InputError(
                f"{self.store.path.name}: this needs all {self.n_triangles:,} triangles at once, and "
                f"{readable_size(self._need(size))} of memory; raise max_memory (--max-memory), or study a part"
            )

    def fits(self, size: int) -> bool:
        return self._need(size) <= (self.max_memory or default_limit())

    def _need(self, size: int) -> int:
        """The memory of this process with `size` bytes for each triangle."""
        return resident_memory() + size * self.n_triangles

    def content(self, time: float, threads: int | None = None) -> Iterator[memoryview | bytes]:
        """`Store.content`."""
        yield from self.store.content()

    def refusal(self) -> InputError:
        """The error raised by methods that need all triangles."""
        return InputError(
            f"{self.store.path.name}: a store cannot be used for this; use the file that it was built from"
        )


def all_triangles(
    vertices: NDArray[np.float32],
    colours: NDArray[np.float32],
    origin: NDArray[np.float64],
    cutouts: Cutouts | None,
    clear: NDArray[np.int32] | None,
    threads: int | None,
) -> Triangles:
    """All triangles of a store.

    vertices : (n, 3, 3), recentred
    colours : (n, 3)
    cutouts : those of `StoreData.cutouts`, even without faces
    clear : (k,): the faces that no ray hits; None: none
    """
    from ..kernels.parallel import thread_count
    from ..scene.triangle_setup import solid_faces, survey

    faces = np.arange(len(vertices), dtype=np.int32)
    if cutouts is not None:
        is_solid = np.ones(len(faces), np.bool_)
        is_solid[cutouts.faces] = False
        if clear is not None:
            is_solid[clear] = False
        cutouts = cutouts._replace(solid=faces[is_solid])
    solid = solid_faces(survey(vertices, thread_count(threads))[0], None if cutouts is None else cutouts.solid)
    return Triangles(vertices, origin.copy(), faces, colours, cutouts, solid)


def load_store(path: Path) -> StoreData:
    """Open the scene of a store."""
    return StoreData(open_store(path))
