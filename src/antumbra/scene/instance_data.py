"""Scene data of instances: meshes and transforms in memory, but not the triangles of the copies."""

import os
from collections.abc import Iterator, Mapping
from functools import cached_property
from typing import Any, ClassVar, NamedTuple, cast

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..base.errors import InputError, one_line
from ..base.pickles import without_cached
from .face_looks import LookFinder, StreamedLooks
from .instances import InstancedSource
from .materials import Transmittance
from .mesh import Source
from .scene_bounds import MAX_SAMPLED_FACES, check_extent, flush_to_zero, frame_origin
from .scene_data import MemoryData, SceneData, check_up_axis
from .streamed_data import StreamedData
from .triangles import Triangles
from .units import LengthUnit

# --- When to instance -------------------------------------------------------------------------------------------------


FLAT_BYTES = 256
"""Approximate memory of a triangle in memory: its corners, its colour, and its share of the trees."""

FEW_BYTES = 1 << 30
"""Copies of meshes that take no more memory than this are flattened, so that all plans can trace them."""


def wants_instances(source: Source, instances: bool | None, alpha: bool = True) -> bool:
    """Whether copies of meshes stay instances.

    instances : the choice of the user; None: instances if copies take more than `FEW_BYTES` and nothing prevents it
    alpha : whether alpha masks and transmission count; False: all faces are solid

    Raises
    ------
    InputError
        If the user chooses instances, but the source does not support it.
    """
    if instances is None:
        return saved_bytes(source) > FEW_BYTES and _obstacle(source, alpha) is None
    if instances and (obstacle := _obstacle(source, alpha)) is not None:
        raise InputError(f"{source.file}: instances=True does not work, since {obstacle}; leave it out")
    return instances


def would_be_instances(scene: StreamedData, instances: bool | None, alpha: bool = True) -> bool:
    """Whether memory would keep the copies of meshes of a scene that is read piece by piece; as `wants_instances`."""
    if instances is not None:
        return instances
    source = scene.source
    if not hasattr(source, "instances") or source.duration > 0.0 or (alpha and scene.lets_light_pass):
        return False
    return saved_bytes(source) > FEW_BYTES


def saved_bytes(source: Source) -> int:
    """The memory that flattening takes for copies beyond the first one of each mesh."""
    return FLAT_BYTES * sum(mesh.triangles * (mesh.instances - 1) for mesh in source.meshes)


def _obstacle(source: Source, alpha: bool) -> str | None:
    """Why copies cannot stay instances; None: they can."""
    if not hasattr(source, "instances"):
        return "this kind of scene has none"
    if source.duration > 0.0:
        return "the scene is animated"
    if alpha and any(mesh.alpha for mesh in cast(InstancedSource, source).instances().meshes):
        return "a material lets light pass (cutouts=False makes it solid)"
    return None


# --- The copy and the triangle of a face ------------------------------------------------------------------------------


class FacePlaces(NamedTuple):
    """Where faces of the scene are."""

    copy: NDArray[np.int64]  # (m,): index of the copy
    triangle: NDArray[np.int64]  # (m,): index of the face in the copy's mesh


class FaceObjects:
    """The object of each face, computed on demand. It is indexed like an (n,) int32 array, by arrays of faces."""

    dtype = np.dtype(np.int32)

    def __init__(self, data: "InstanceData"):
        self._data = data

    @property
    def shape(self) -> tuple[int]:
        return (self._data.n_triangles,)

    def __len__(self) -> int:
        return self._data.n_triangles

    def __getitem__(self, faces: Any) -> NDArray[np.int32]:
        chosen = np.arange(len(self))[faces] if isinstance(faces, slice) else np.asarray(faces)
        return self._data.places_of(chosen.reshape(-1)).copy.astype(np.int32).reshape(chosen.shape)

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> np.ndarray:
        return self[:].astype(np.int32 if dtype is None else dtype)


# --- Scene data -------------------------------------------------------------------------------------------------------


class InstanceData(SceneData):
    """Copies of meshes in world space, static and solid.

    instances : InstanceSet
    boxes : (k, 2, 3) float64, world
        Exact bounds of each copy.
    read_notes : tuple of str
        Notes without the one that materials are left out, since no other way to load helps a store.
    """

    instanced: ClassVar[bool] = True

    def __init__(
        self,
        source: InstancedSource,
        *,
        name: str = "scene",
        up: str = "y",
        notes: tuple[str, ...] = (),
        crs: str | None = None,
        unit: str | LengthUnit | None = None,
        threads: int | None = None,
    ):
        from ..kernels.parallel import thread_count  # imports Numba, which file inspection does not need
        from .instance_bounds import instance_bounds

        self.source, self.meshes, self.objects, self.duration = source, source.meshes, source.objects, 0.0
        self.name, self.up, self.crs = one_line(name), check_up_axis(up), crs
        self.unit = unit
        self.instances = source.instances()
        self.read_notes = tuple(one_line(note) for note in notes)
        looks = f"{source.file}: instances have one colour per face; instances=False loads textures and materials"
        self.notes = (*self.read_notes, one_line(looks)) if self.has_looks else self.read_notes
        self._n_triangles = self.instances.n_triangles
        self._check_finite(source.file)
        self.boxes = instance_bounds(self.instances, thread_count(threads))
        filled = self.boxes[np.array([len(self.instances.meshes[k].faces) > 0 for k in self.instances.mesh], bool)]
        if not len(filled):
            raise InputError(f"{source.file}: no triangles; export the scene with its meshes triangulated")
        self.bounds = np.stack([filled[:, 0].min(0), filled[:, 1].max(0)])
        check_extent(self.bounds, source.file)
        self.origin = self.middle = frame_origin(*self.bounds)
        self._cameras, self._lights = source.cameras(0.0), source.lights(0.0)

    def __getstate__(self) -> dict[str, Any]:
        return without_cached(self)

    def looks(self) -> LookFinder | None:
        return StreamedLooks() if self.has_looks else None

    @property
    def has_looks(self) -> bool:
        """Whether the source has more than a colour per face."""
        return any(mesh.varied for mesh in self.instances.meshes)

    def _check_finite(self, file: str) -> None:
        """Check that no world coordinate overflows, so that bounds are never NaN."""
        furthest = np.array([np.abs(mesh.positions).max(initial=0.0) for mesh in self.instances.meshes])
        with np.errstate(all="ignore"):
            reach = np.abs(self.instances.matrices).sum(axis=(1, 2)) * (1.0 + furthest[self.instances.mesh])
        if not (reach < _OVERFLOW).all():
            bad = int(np.argmin(reach < _OVERFLOW))
            raise InputError(f"{file}: instance {bad} is not finite or too large; scale the scene down")

    @property
    def n_triangles(self) -> int:
        return self._n_triangles

    @property
    def object_of_face(self) -> NDArray[np.int32]:
        """(n,) int32, computed where it is indexed by arrays of faces: the index in `objects` of each face."""
        return cast("NDArray[np.int32]", FaceObjects(self))

    @property
    def colours(self) -> NDArray[np.float32]:
        """(n, 3) float32: colours of all faces. Flattens the scene."""
        return self.flattened().colours

    def triangles(self, time: float = 0.0, threads: int | None = None) -> Triangles:
        """The triangles of all copies. Flattens the scene; InputError if that takes more memory than there is."""
        return self.flattened().triangles(time, threads)

    def corners(self, time: float = 0.0, faces: NDArray[np.integer] | None = None) -> NDArray[np.float64]:
        return self.world_corners(np.arange(self.n_triangles) if faces is None else faces)

    def flattened(self) -> MemoryData:
        """The same scene with all copies in memory.

        Raises
        ------
        InputError
            If they take more memory than the machine has.
        """
        need, memory = FLAT_BYTES * self.n_triangles, _machine_memory()
        if memory is not None and need > memory:
            raise InputError(
                f"{self.name}: {self.n_triangles:,} triangles with all copies take about {need / 1e9:,.0f} GB, and "
                f"this machine has {memory / 1e9:,.0f} GB; use what traces instances, such as the plan bsah+wide"
            )
        return self._flat

    @cached_property
    def _flat(self) -> MemoryData:
        data = MemoryData(self.source, name=self.name, up=self.up, notes=self.notes, crs=self.crs, unit=self.given_unit)
        data.ignore_looks()  # colours and shading must not depend on the plan
        return data

    def ignore_alpha(self) -> None:
        """Instances are always solid."""

    def set_transmittance(self, shares: Mapping[str, Transmittance]) -> None:
        """Always raises InputError: instances are solid."""
        raise InputError(f"{self.name}: instances are solid; load the scene with instances=False for transmittance")

    def update(self, *arguments: Any, **options: Any) -> None:
        """Always raises InputError: instances stay where they are."""
        raise InputError(f"{self.name}: update cannot move instances; load the scene with instances=False")

    # --- single faces ---

    @cached_property
    def _starts(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Ascending first faces of the parts of copies, and the copy and the mesh's first face of each."""
        instances = self.instances
        copy = np.repeat(np.arange(len(instances.mesh)), np.diff(instances.rows))
        parts = [instances.meshes[k].parts for k in instances.mesh]
        first = np.concatenate([each[:-1] for each in parts])
        size = np.concatenate([np.diff(each) for each in parts])
        order = np.argsort(instances.starts, kind="stable")
        order = order[size[order] > 0]
        return instances.starts[order], copy[order], first[order]

    def places_of(self, faces: ArrayLike) -> FacePlaces:
        """The copy and the mesh's triangle of faces, (m,) int."""
        starts, copy, first = self._starts
        part = np.searchsorted(starts, faces, side="right") - 1
        return FacePlaces(copy[part], np.asarray(faces, np.int64) - starts[part] + first[part])

    def world_corners(self, faces: ArrayLike) -> NDArray[np.float64]:
        """(m, 3, 3) float64, world: the corners of faces, (m,) int, as flattening computes them."""
        copy, triangle = self.places_of(faces)
        out = np.empty((len(copy), 3, 3))
        for k in np.unique(self.instances.mesh[copy]):
            at = np.flatnonzero(self.instances.mesh[copy] == k)
            mesh, matrices = self.instances.meshes[k], self.instances.matrices[copy[at]]
            x, y, z = np.moveaxis(mesh.positions[mesh.faces[triangle[at]]].astype(np.float64), 2, 0)
            for i in range(3):
                a, b, c, d = (matrices[:, i, j, None] for j in range(4))
                out[at, :, i] = a * x + b * y + c * z + d  # in the order of `transform_points`
        return out

    def some_triangles(self, faces: NDArray[np.int32]) -> Triangles:
        """The triangles of these faces, (m,) int32, in the recentred frame."""
        vertices = flush_to_zero((self.world_corners(faces) - self.origin).astype(np.float32))
        return Triangles(vertices, self.origin.copy(), faces, self._colours_of(faces))

    def _colours_of(self, faces: NDArray[np.int32]) -> NDArray[np.float32]:
        copy, triangle = self.places_of(faces)
        out = np.empty((len(faces), 3), np.float32)
        for k in np.unique(self.instances.mesh[copy]):
            at, colour = self.instances.mesh[copy] == k, self.instances.meshes[k].colour
            out[at] = colour if colour.ndim == 1 else colour[triangle[at]]
        return out

    def sampled_faces(self, time: float | None = None) -> NDArray[np.float64]:
        """(m, 3, 3) float64, world: as from `scene_bounds.sampled_faces`. Instances never move."""
        step = -(-self.n_triangles // MAX_SAMPLED_FACES)
        return self.world_corners(np.arange(0, self.n_triangles, step))

    def every(self, step: int, time: float, threads: int | None = None) -> NDArray[np.float32]:
        return self.some_triangles(np.arange(0, self.n_triangles, step, dtype=np.int32)).vertices

    def content(self, time: float, threads: int | None = None) -> Iterator[memoryview | bytes]:
        """The meshes and the transforms of their copies."""
        copies = self.instances
        for mesh in copies.meshes:
            for array in mesh.positions, mesh.faces, mesh.colour:
                yield np.ascontiguousarray(array).data
        for array in copies.mesh, copies.matrices, copies.starts:
            yield array.data


_OVERFLOW = 1e250


def _machine_memory() -> int | None:
    """Bytes of memory of this machine; None if unknown."""
    try:
        return os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    except (AttributeError, OSError, ValueError):
        return None
