"""Scene data: triangles, cameras and lights as functions of time, city objects, and grouped loader notes.

`SceneData` is the common base class: `MemoryData` holds triangles in memory, `StoreData` on disk.
"""

import json
import re
from abc import ABC, abstractmethod
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from copy import copy
from fnmatch import fnmatchcase
from functools import cached_property
from hashlib import sha256
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple, Protocol, cast

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..base.checks import as_array, checked_instance, choice, items, number, parts_of, quoted, text, whole_number
from ..base.errors import InputError, one_line
from ..base.pickles import Runs, in_runs, without_cached
from .alpha_masks import Cutouts, find_cutouts
from .appearance import Appearance, appearance_of, plain_appearance
from .camera import Camera
from .crs import unit_of_crs
from .face_looks import FoundLooks, LookFinder
from .lights import Light
from .materials import MONTHS, LightShare, Material, Texture, Transmittance
from .mesh import MeshInfo, ObjectInfo, Source
from .open_faces import FoundOpenFaces, OpenFaceFinder
from .raster import CellWindow, Raster, RasterAxes
from .scene_bounds import Detail, Survey, face_corners, faces_of, frame_origin, moving_faces, objects_of, sampled_faces
from .terrain import TERRAIN_TYPE, HeightGrid
from .triangles import Triangles
from .units import LengthUnit, checked_unit

if TYPE_CHECKING:
    from .indexed_triangles import IndexedVertices
    from .moved_geometry import MovableMeshes, ObjectChoice

# --- City objects and semantic surfaces (CityJSON) --------------------------------------------------------------------


class SemanticSurface(NamedTuple):
    """A semantic surface, such as a roof. Each polygon without semantics forms its own surface."""

    object: int  # index into `CityModel.objects`
    type: str | None  # such as "RoofSurface"; None: the polygon has no semantics
    geometry: int  # index into the object's "geometry"
    semantic: int | None  # index into the geometry's "semantics.surfaces"; None: the polygon has no semantics
    path: tuple[int, ...]  # nested indices in "boundaries" of the surface's first polygon
    parent: int | None = None  # of a window or door: index of its wall or roof in "semantics.surfaces"
    attributes: Mapping[str, Any] | None = None  # from the file; None: none


class CityModel(NamedTuple):
    """The object and semantic surface of each face of a scene, from CityJSON or footprints.

    `Scene.objects` has the same objects in the same order.

    Examples
    --------
    >>> village = at.examples.village()
    >>> village.city.objects[0], village.city.types[0], village.city.surfaces[1].type
    ('house-01', 'Building', 'WallSurface')
    >>> village.city.object_attribute("height", [0, 1])
    array([7.3, 7.3])
    """

    crs: str | None  # such as "EPSG:7415"; None: the file names none, or one without an EPSG code
    objects: list[str]  # ids of the objects with faces
    object_of_face: NDArray[np.int32]  # (n,) int32, index into `objects`
    surface_of_face: NDArray[np.int32]  # (n,) int32, index into `surfaces`
    surfaces: list[SemanticSurface]  # those with faces
    types: list[str]  # type of each object, such as "BuildingPart"
    parents: list[str]  # id of the outermost object that contains each object, such as the Building; "": none
    lods: list[str]  # all levels of detail with surfaces in the file, ascending
    attributes: Sequence[Mapping[str, Any]] = ()  # of each object, with those of the objects that contain it; (): none

    def surface_types(self, faces: "ArrayLike") -> NDArray[np.str_]:
        """(...) str: the type of each face's semantic surface, such as "RoofSurface".

        "" for polygons without semantics, and for the face -1 (a miss).

        faces : (...) int, such as `Hit.face`

        Raises
        ------
        InputError
            If a face index is out of range.
        """
        return _of_faces([surface.type or "" for surface in self.surfaces], self.surface_of_face, faces, "")

    @property
    def object_attribute_names(self) -> list[str]:
        """The attributes that any object has, sorted."""
        return _names(self.attributes)

    @property
    def surface_attribute_names(self) -> list[str]:
        """The attributes that any surface has, sorted."""
        return _names(surface.attributes or {} for surface in self.surfaces)

    def surface_attribute(self, name: str, faces: "ArrayLike") -> NDArray[Any]:
        """(...) float64 or str: an attribute of each face's semantic surface, such as "slope".

        Numbers, true (1) and false (0) are float64, with NaN where it is missing. If any value is of another kind, all
        are text, with "" where it is missing; lists and objects are JSON.

        name : its name in the file
        faces : (...) int, such as `Hit.face`; -1 is a miss

        Raises
        ------
        InputError
            If no surface has the attribute, or a face index is out of range.
        """
        attributes = [surface.attributes or {} for surface in self.surfaces]
        return _attribute(name, attributes, self.surface_of_face, faces, "surface")

    def object_attribute(self, name: str, faces: "ArrayLike") -> NDArray[Any]:
        """(...) float64 or str: an attribute of each face's object, or of an object that contains it.

        Parts of a building have the attributes of the building, unless their own have the same name. Values are those
        of `surface_attribute`.

        name : its name in the file
        faces : (...) int, such as `Hit.face`; -1 is a miss

        Raises
        ------
        InputError
            If no object has the attribute, or a face index is out of range.
        """
        return _attribute(name, self.attributes, self.object_of_face, faces, "object")


def _names(attributes: Iterable[Mapping[str, Any]]) -> list[str]:
    return sorted({name for each in attributes for name, value in each.items() if value is not None})


def _attribute(
    name: str, attributes: Sequence[Mapping[str, Any]], owner: NDArray[np.int32], faces: ArrayLike, kind: str
) -> NDArray[Any]:
    """One attribute of the surfaces or objects of faces; `owner`: (n,) int32, the index of each face's surface."""
    values = [each.get(text(name, "name")) for each in attributes]
    if all(value is None for value in values):
        known = _names(attributes)
        there = f"there are {', '.join(known[:20])}" if known else "there are no attributes"
        raise InputError(f"no {kind} of the city has the attribute {name!r}; {there}")
    if all(value is None or isinstance(value, (int, float)) for value in values):
        return _of_faces([np.nan if value is None else float(value) for value in values], owner, faces, np.nan)
    texts = [value if isinstance(value, str) else "" if value is None else json.dumps(value) for value in values]
    return _of_faces(texts, owner, faces, "")


def _of_faces(values: list[Any], owner: NDArray[np.int32], faces: ArrayLike, missing: object) -> NDArray[Any]:
    """(...) the values, one per surface or object, of faces; `missing` for the face -1."""
    faces, n = as_array(faces, "faces"), len(owner)
    if faces.dtype.kind == "f" or (faces.size and (faces.min() < -1 or faces.max() >= n)):
        raise InputError(f"faces must be whole numbers from -1 to {n - 1}, the city's last face")
    return np.array([*values, missing])[np.where(faces >= 0, owner[faces], len(values))]


class LookReader(Protocol):
    """The looks of all faces of a store, which are read where pictures see them."""

    @property
    def is_varied(self) -> bool:
        """Whether any face shows a texture, or colours of its corners."""
        ...

    @property
    def has_pbr(self) -> bool:
        """Whether `Appearance.pbr` has parameters."""
        ...

    @property
    def materials(self) -> list[Material]:
        """The materials of all faces."""
        ...

    def of(self, faces: NDArray[np.integer]) -> Appearance:
        """The appearance of faces, (m,), in this order. Attributes are None if no face of the scene has them."""
        ...

    def row_bytes(self) -> int:
        """Bytes of a face in an `Appearance`."""
        ...

    def decoding_bytes(self, textures: Iterable[Texture], threads: int) -> int:
        """Memory that decoding of textures takes, beyond what is decoded."""
        ...

    def forget(self, textures: Iterable[Texture] = ()) -> int:
        """Release decoded textures, except for some. Return their bytes."""
        ...


# --- The common base class of scene data ------------------------------------------------------------------------------


_GAP = 1e-5  # between scene and ground, relative to the scene's size: invisible, above float32 rounding error


class SceneData(ABC):
    """Name, bounds, cameras, lights and triangles of a scene. `engine.scene.Scene` documents the attributes.

    What a kind of scene offers, its attributes say: `resident`, `instanced`, `terrain`, `sampled_faces`, `cell_tops`.
    """

    resident: ClassVar[bool] = True  # False: the triangles are in a store, and never all in memory
    lacks_surfaces: bool = False  # whether semantic surfaces were left out, as in a store
    instanced: ClassVar[bool] = False  # whether the triangles are those of copies of meshes, made where they are needed
    name: str
    up: str  # "y" or "z"
    notes: tuple[str, ...]
    duration: float  # seconds
    meshes: list[MeshInfo]
    objects: list[ObjectInfo]
    bounds: NDArray[np.float64]  # (2, 3) float64, world
    origin: NDArray[np.float64]  # (3,) float64, world
    middle: NDArray[np.float64]  # (3,) float64, world: of the bounds when the scene was made
    city: CityModel | None = None  # of a CityJSON file, or of footprints
    axes: RasterAxes | None = None  # of the labelled array that has the cells; None: of a file
    raster: Raster | None = None  # the cells of the raster of heights that is the scene or its ground
    crs: str | None = None  # coordinate reference system of the world coordinates, such as "EPSG:7415"
    moved: Triangles | None = (
        None  # the triangles of the latest `update`, as `triangles` returns them; None: none so far
    )
    hidden: NDArray[np.bool_] | None = None  # (n,): faces that are not there, as in one of two states; None: none
    given_unit: LengthUnit | None = None  # of the world coordinates; None: that of the CRS, or metres
    terrain_towards: Any = None  # a method of rasters that are larger than memory; None: `terrain` is in memory
    _cameras: list[Camera]  # at time 0
    _lights: list[Light]

    @property
    def unit(self) -> LengthUnit:
        """The unit of the world coordinates: that of the CRS, or the one given, or metres."""
        return unit_of_crs(self.crs, self.given_unit)

    @unit.setter
    def unit(self, unit: str | LengthUnit | None) -> None:
        """Set the unit; None: that of the CRS, or metres. InputError if it contradicts the CRS."""
        self.given_unit = None if unit is None else checked_unit(unit)
        if unit is not None:
            unit_of_crs(self.crs, self.given_unit)

    @property
    @abstractmethod
    def n_triangles(self) -> int: ...

    @property
    def terrain(self) -> HeightGrid | None:
        """The raster of heights that is the whole scene, solid and where it was read; None for all other scenes."""
        return None

    @property
    def of_heights(self) -> bool:
        """Whether all objects are terrain, also in tiles and after an update, which have no `terrain`."""
        return all(each.type == TERRAIN_TYPE for each in self.objects)

    def cell_tops(self, window: CellWindow | None = None) -> tuple[NDArray[np.float64], NDArray[np.integer]] | None:
        """The height and the face at cells of a scene that is one raster of heights, as `TerrainSurfaces.tops`."""
        return None

    def sampled_faces(self, time: float | None = None) -> NDArray[np.float64] | None:
        """(m, 3, 3) float64, world: some of the faces at a time; None for a store. No time: at several times."""
        return None

    @property
    def framed_points(self) -> NDArray[np.float64] | None:
        """`default_picture.framed_points`, as recorded in a store; None: see `sampled_faces`."""
        return None

    @property
    def detail(self) -> Detail | None:
        """Where nearly all triangles are, as recorded in a store; None: not recorded, or see `sampled_faces`."""
        return None

    def every(self, step: int, time: float, threads: int | None = None) -> NDArray[np.float32]:
        """(m, 3, 3) float32, recentred: the corners of every step-th face at a time."""
        return self.triangles(time, threads).vertices[::step]

    def content(self, time: float, threads: int | None = None) -> Iterator[memoryview | bytes]:
        """What determines the triangles at a time, with colours, alpha masks and objects: the input of digests."""
        triangles = self.triangles(time, threads)
        arrays = triangles.vertices, triangles.origin, triangles.colour, self.object_of_face
        for array in *arrays, *(triangles.cutouts or ()):
            yield np.ascontiguousarray(array).data

    def check_all(self, size: int) -> None:
        """Check that work with `size` bytes for each triangle fits in memory. Raises InputError for a store if not."""
        self.check_resident()

    def fits(self, size: int) -> bool:
        """Whether `check_all` passes."""
        return self.resident

    def check_resident(self) -> None:
        """Check that the scene is in memory. Raises InputError for a store."""
        if not self.resident:
            raise self.refusal()

    def refusal(self) -> InputError:
        """The error raised by what needs all triangles, if they are never all in memory."""
        return InputError(f"{self.name}: its triangles are never all in memory; use a scene in memory for this")

    @property
    def appearance(self) -> Appearance | None:
        """Textures, vertex colours, shading normals and alpha; None for a store."""
        return None

    @property
    def has_looks(self) -> bool:
        """Whether a face has more than a colour: a texture, colours or normals of its vertices, or alpha."""
        return self.appearance is not None

    def looks(self) -> LookFinder | None:
        """Finds the looks of faces as pieces are read; None: all have plain colours."""
        return None if (appearance := self.appearance) is None else FoundLooks(appearance)

    @property
    def stored_looks(self) -> "LookReader | None":
        """What finds the appearance of some faces of a store; None: they have plain colours, or see `appearance`."""
        return None

    @property
    def cutouts(self) -> Cutouts | None:
        """The faces that let light pass; None: all faces are solid."""
        return None

    @property
    def lets_light_pass(self) -> bool:
        """Whether some faces are not solid."""
        return self.cutouts is not None

    def open_faces(self) -> OpenFaceFinder | None:
        """Finds the faces that are not solid, or hidden, as pieces are read; None: there are none."""
        return None

    def ignore_alpha(self) -> None:
        """Make all faces solid. Call it before the first query."""
        assert self.cutouts is None, "this kind of scene has no cut-outs"

    def set_transmittance(self, shares: Mapping[str, Transmittance]) -> None:
        """Let a share of the light pass through materials or objects. InputError for stores, which have neither."""
        raise InputError(f"{self.name}: a store keeps the transmittance of its scene; build it again with another")

    def update(
        self,
        vertices: "ArrayLike | None" = None,
        objects: "ObjectChoice" = None,
        transform: "ArrayLike | None" = None,
        threads: int | None = None,
    ) -> None:
        """Move the geometry. InputError for stores, whose triangles stay where they are."""
        raise InputError(f"{self.name} is in a store, and update works only for scenes in memory; load its source file")

    @property
    @abstractmethod
    def object_of_face(self) -> NDArray[np.int32]:
        """(n,) int32: the index in `objects` of each face, in the order of `triangles`. Do not write to it."""

    @abstractmethod
    def triangles(self, time: float = 0.0, threads: int | None = None) -> Triangles:
        """The triangles at `time`. A store raises InputError."""

    def corners(self, time: float = 0.0, faces: NDArray[np.integer] | None = None) -> NDArray[np.float64]:
        """(m, 3, 3) float64, world: the corners of faces, (m,) int, at `time`; None: all. A store raises InputError.

        They are those of the source, before a frame rounds them, so they do not depend on the other faces.
        """
        raise self.refusal()

    def _cameras_at(self, time: float) -> list[Camera]:
        """The cameras at a time in [0, `duration`]."""
        return self._cameras

    def _lights_at(self, time: float) -> list[Light]:
        """The lights at a time in [0, `duration`]."""
        return self._lights

    @property
    def animated(self) -> bool:
        """Whether `duration` is positive, so that the scene may change over time."""
        return self.duration > 0.0

    @property
    def cameras(self) -> list[Camera]:
        """The cameras of the file at time 0, 1024 pixels high."""
        return list(self._cameras)

    @property
    def lights(self) -> list[Light]:
        """The lights of the file (KHR_lights_punctual) at time 0."""
        return list(self._lights)

    def camera(self, index: int = 0, time: float = 0.0) -> Camera:
        """Camera `index` of the file at `time`."""
        index = self._checked_index("camera", index, len(self._cameras))
        return self._cameras_at(self.clamped(time))[index]

    def light(self, index: int = 0, time: float = 0.0) -> Light:
        """Light `index` of the file at `time`."""
        index = self._checked_index("light", index, len(self._lights))
        return self._lights_at(self.clamped(time))[index]

    def _checked_index(self, kind: str, index: int, count: int) -> int:
        """The checked index of a camera or light from the file."""
        with suppress(InputError):
            return whole_number(index, kind, 0, count - 1)
        known = {0: "the scene has none", 1: f"it has one {kind}, 0"}.get(count, f"its {kind}s are 0 to {count - 1}")
        raise InputError(f"{self.name}: there is no {kind} {quoted(index)}; {known}")

    def ground_height(self, time: float | None = None) -> float:
        """The height along the up axis, in world units, of a horizontal ground plane just below the scene.

        time : seconds: below the scene at this moment of an animation; None: below all sampled moments
        """
        gap = _GAP * float(np.linalg.norm(np.ptp(self.bounds, axis=0)))
        return self._lowest(None if time is None else self.clamped(time)) - gap

    def _lowest(self, time: float | None) -> float:
        """The lowest height of the scene in world units."""
        return float(self.bounds[0, "xyz".index(self.up)])

    def clamped(self, time: float) -> float:
        """`time`, clamped to 0 .. `duration`. Raises InputError unless it is a number."""
        time = number(time, "time (seconds)", -np.inf, np.inf, "[]")
        return min(max(time, 0.0), self.duration)


# --- Scenes in memory -------------------------------------------------------------------------------------------------


_MOST_NAMES = 12  # in errors
_MOMENTS = 25  # times of an animation at which the lowest point is sampled


class MemoryData(SceneData):
    """Triangles, cameras and lights in world space, at any time between 0 and `duration`."""

    def __init__(
        self,
        source: Source,
        *,
        name: str = "scene",
        up: str = "y",
        notes: tuple[str, ...] = (),
        city: CityModel | None = None,
        crs: str | None = None,
        unit: str | LengthUnit | None = None,
    ):
        if not all(hasattr(source, part) for part in ("pieces", "cameras", "lights")):
            raise InputError(f"source is {quoted(source)}; make a Scene by load, Scene.from_arrays or Scene.from_mesh")
        self.city = None if city is None else checked_instance(city, CityModel, "city")
        self.name, self.up = one_line(text(name, "name")), check_up_axis(up)
        self.notes = tuple(one_line(note) for note in items(notes, str, "notes"))
        self.crs = None if crs is None else text(crs, "crs")
        self.unit = unit
        self.source, self.meshes, self.duration = source, source.meshes, float(source.duration)
        self._loaded = source
        self.objects = source.objects
        self._object_of_face: np.ndarray | None = None
        survey, self.colours, self._looks, alpha = _survey(source)
        self._appearance: Appearance | None = None
        self._cutouts: Cutouts | None = None
        self._find_cutouts = self._finds_cutouts = alpha  # whether they are still to be found; or not replaced
        self.bounds, self.origin = survey.bounds(), survey.origin()
        self.middle = frame_origin(*self.bounds)
        self._cameras, self._lights = source.cameras(0.0), source.lights(0.0)
        self._movable: MovableMeshes | None = None

    def __getstate__(self) -> dict[str, Any]:
        """What cannot be found again from the geometry and the textures."""
        state = without_cached(self) | {"_object_of_face": None, "_appearance": None, "colours": in_runs(self.colours)}
        if self._finds_cutouts:
            state |= {"_cutouts": None, "_find_cutouts": True}
        if self.moved is not None:
            state["moved"] = self.moved.vertices, self.moved.solid
        return state

    def __setstate__(self, state: dict[str, Any]) -> None:
        vars(self).update(state)
        if isinstance(state["colours"], Runs):
            self.colours = state["colours"].array()
        if state.get("moved") is not None:
            (vertices, solid), faces = state["moved"], np.arange(self.n_triangles, dtype=np.int32)
            self.moved = Triangles(vertices, self.origin.copy(), faces, self.colours, self.cutouts, solid)

    @property
    def n_triangles(self) -> int:
        return len(self.colours)

    @property
    def terrain(self) -> HeightGrid | None:
        grid: HeightGrid | None = getattr(self.source, "height_grid", None)
        changed = self.moved is not None or self.cutouts is not None or self.hidden is not None
        return None if changed else grid

    def cell_tops(self, window: CellWindow | None = None) -> tuple[NDArray[np.float64], NDArray[np.integer]] | None:
        find = None if self.hidden is not None else getattr(self.source, "tops", None)
        return None if find is None else cast("tuple[NDArray[np.float64], NDArray[np.integer]] | None", find(window))

    def sampled_faces(self, time: float | None = None) -> NDArray[np.float64]:
        if time is None:
            return moving_faces(self.source, self.n_triangles)
        return sampled_faces(self.source, self.n_triangles, time)

    def content(self, time: float, threads: int | None = None) -> Iterator[memoryview | bytes]:
        if (terrain := self.terrain) is None:
            yield from super().content(time, threads)
        else:
            yield repr((terrain.grid, self.origin.tolist())).encode()
            yield sha256(np.ascontiguousarray(terrain.heights).data).digest()

    def _lowest(self, time: float | None) -> float:
        if not self.animated:
            return super()._lowest(time)
        if time is None:
            return self._lowest_ever
        axis = "xyz".index(self.up)
        return float(self.triangles(time).vertices[..., axis].min() + self.origin[axis])

    @cached_property
    def _lowest_ever(self) -> float:
        heights = [self._lowest(0.0)]
        for time in np.linspace(0.0, self.duration, _MOMENTS)[1:]:
            with suppress(InputError):  # an invalid moment reports its error when it is rendered
                heights.append(self._lowest(time))
        return min(heights)

    @property
    def object_of_face(self) -> NDArray[np.int32]:
        """(n,) int32: the index in `objects` of each face, in the order of `triangles`. Do not write to it.

        The first use evaluates the geometry once more, piece by piece.
        """
        if self._object_of_face is None:
            self._object_of_face = objects_of(self._loaded.pieces(0.0))
        return self._object_of_face

    @property
    def appearance(self) -> Appearance | None:
        """Textures, vertex colours, shading normals and alpha; None if every face has a plain colour.

        The first use evaluates the geometry once more, piece by piece. Textures are decoded on first use.
        """
        if self._looks and self._appearance is None:
            self._appearance = appearance_of(self._loaded, self.n_triangles)
        return self._appearance

    @property
    def cutouts(self) -> Cutouts | None:
        """The alpha-masked faces; None: all faces are solid. The first use decodes their textures.

        Raises
        ------
        InputError
            If a texture cannot be decoded.
        """
        if self._find_cutouts:
            assert self.appearance is not None
            self._cutouts, self._find_cutouts = find_cutouts(self.appearance), False
        return self._cutouts

    @cutouts.setter
    def cutouts(self, cutouts: Cutouts | None) -> None:
        """Replace them, before the first query."""
        self._cutouts, self._find_cutouts, self._finds_cutouts = cutouts, False, False
        if self.moved is not None:
            from ..kernels.parallel import thread_count
            from .triangle_setup import rows_with_area

            vertices = self.moved.vertices
            self.moved = self._triangles_of(vertices, rows_with_area(vertices, thread_count(None)))

    def open_faces(self) -> OpenFaceFinder | None:
        if self.cutouts is None and self.hidden is None:
            return None
        return FoundOpenFaces(self.n_triangles, self.cutouts, self.hidden)

    def ignore_alpha(self) -> None:
        """Make all faces solid. Call it before the first query."""
        self.cutouts = None

    def ignore_looks(self) -> None:
        """Give each face its mean colour only, and make all faces solid. Call it before the first query."""
        self.cutouts, self._looks, self._appearance = None, False, None

    def set_transmittance(self, shares: Mapping[str, Transmittance]) -> None:
        """Let a share of the light pass through materials or objects; see `antumbra.Scene.set_transmittance`."""
        appearance = appearance_of(self._loaded, self.n_triangles, plain=True) or plain_appearance(self.n_triangles)
        objects = [each.name for each in self.objects]
        for pattern, share in _checked_shares(shares):
            chosen = [k for k, name in enumerate(objects) if fnmatchcase(name, pattern)]
            faces = np.isin(self.object_of_face, chosen) | appearance.has_material(pattern)
            if not faces.any():
                names = ", ".join(sorted({*objects, *(m.name for m in appearance.materials)} - {""})[:_MOST_NAMES])
                raise InputError(f"{self.name}: no material or object is called {pattern!r}; there are: {names}")
            appearance = appearance.with_transmittance(faces, share)
        self.cutouts = find_cutouts(appearance)

    def triangles(self, time: float = 0.0, threads: int | None = None) -> Triangles:
        """The triangles at `time` (seconds, clamped to 0 .. `duration`), recentred, always in the same order.

        threads : int, optional
            None: all cores.

        Raises
        ------
        InputError
            If the time is not a number, or the animation moves vertices to infinity.
        """
        from ..kernels.parallel import thread_count  # imports Numba, which file inspection does not need
        from .triangle_setup import gather, rows_with_area, solid_faces

        time, threads = self.clamped(time), thread_count(threads)
        if (moved := self.moved) is not None:
            return moved
        vertices = np.empty((self.n_triangles, 3, 3), np.float32)
        start = 0
        with np.errstate(all="ignore"):
            for piece in self.source.pieces(time):
                start += gather(piece, self.origin, vertices[start:], threads).count
        if self.hidden is not None:
            vertices[self.hidden] = vertices[self._shown, 0]
        face_id, cutouts = np.arange(self.n_triangles, dtype=np.int32), self.cutouts
        solid = solid_faces(rows_with_area(vertices, threads), None if cutouts is None else cutouts.solid)
        return Triangles(vertices, self.origin.copy(), face_id, self.colours, cutouts, solid)

    def corners(self, time: float = 0.0, faces: NDArray[np.integer] | None = None) -> NDArray[np.float64]:
        chosen = np.arange(self.n_triangles) if faces is None else faces
        corners = face_corners(self.source, chosen, self.clamped(time))
        if self.hidden is not None:
            corners[self.hidden[chosen]] = face_corners(self.source, self._shown, self.clamped(time))[0, 0]
        return corners

    def hiding(self, faces: NDArray[np.bool_]) -> "MemoryData":
        """The same data, in the same frame and with the same numbers of faces and objects, without some faces.

        They become triangles without area at a corner of another face, so nothing meets them.

        faces : (n,) bool
        """
        out = copy(self)
        out.hidden = faces if faces.any() else None
        if faces.all():
            raise InputError(f"{self.name}: nothing of the scene is left; remove fewer objects")
        return out

    @property
    def _shown(self) -> NDArray[np.int64]:
        """(1,) int: a face that is not hidden."""
        return np.argmin(self.hidden, keepdims=True)  # type: ignore[arg-type, no-any-return]

    def update(
        self,
        vertices: "ArrayLike | None" = None,
        objects: "ObjectChoice" = None,
        transform: "ArrayLike | None" = None,
        threads: int | None = None,
    ) -> None:
        """Move the geometry; `antumbra.Scene.update` documents the parameters.

        `moved` becomes a new object, by which caches recognise that their triangles are out of date. Nothing that was
        returned before is changed. Callers take turns.
        """
        from ..kernels.parallel import thread_count
        from .indexed_triangles import IndexedVertices
        from .moved_geometry import MovableMeshes, placement_of
        from .resident_triangles import DeviceVertices, ResidentTriangles

        if self.animated:
            raise InputError(f"{self.name}: its animation moves the geometry, and update is for static scenes")
        if self.hidden is not None:
            raise InputError(f"{self.name}: objects of it were removed, and update is for scenes with all their faces")
        if (vertices is None) == (transform is None) or (vertices is not None and objects is not None):
            raise InputError(f"{self.name}: give update either vertices, or a transform with the objects to move")
        threads = thread_count(threads)
        if self._movable is None:
            self._movable = MovableMeshes(self._loaded, self.origin, self.n_triangles, self.name)
        if isinstance(vertices, DeviceVertices):
            framed = vertices.in_frame(self._movable.corners_of(vertices.shape), self.origin, self.name)
            moved: Triangles = ResidentTriangles.of(framed, self._triangles_of(None, framed.with_area))
            bounds = framed.bounds + self.origin
            self._movable.rest_in_frame(moved, framed.exact)
        elif vertices is not None:
            given = self._movable.given(vertices)
            replaced = self._movable.replaced(given, threads)
            moved, bounds = self._indexed_triangles(replaced.indexed, threads)
            self._movable.rest_on(given, moved, replaced.exact)
        else:
            assert transform is not None
            placement = placement_of(self.objects, objects, transform, self.name)
            corners = self._movable.placed(self.triangles(0.0, threads).vertices, placement, threads)
            moved, bounds = self._indexed_triangles(IndexedVertices(corners.reshape(-1, 3), None), threads)
        self.bounds, self.source = bounds, self._movable.source_of(moved)
        self.moved = moved  # last: caches compare it

    def _indexed_triangles(self, indexed: "IndexedVertices", threads: int) -> tuple[Triangles, NDArray[np.float64]]:
        """Triangles with these vertices, and their bounds, (2, 3) world."""
        from .triangle_setup import bounds_of_rows

        assert self._movable is not None
        moved = self._movable.indexed(indexed, self._triangles_of(None, None), threads)
        return moved, bounds_of_rows(indexed.positions, threads) + self.origin

    def _triangles_of(self, vertices: Any, with_area: NDArray[np.int32] | None) -> Triangles:
        """Triangles with other vertices; `with_area`: as from `triangle_setup.survey`."""
        from .triangle_setup import solid_faces

        face_id = np.arange(self.n_triangles, dtype=np.int32) if self.moved is None else self.moved.face_id
        cutouts = self.cutouts
        solid = solid_faces(with_area, None if cutouts is None else cutouts.solid)
        return Triangles(vertices, self.origin.copy(), face_id, self.colours, cutouts, solid)

    def _cameras_at(self, time: float) -> list[Camera]:
        return self.source.cameras(time)

    def _lights_at(self, time: float) -> list[Light]:
        return self.source.lights(time)


def check_up_axis(up: str) -> str:
    """Check that an axis is "y" or "z"; InputError for anything else."""
    axis: str = choice(up, "up", ("y", "z"))
    return axis


def _checked_shares(shares: Mapping[str, Transmittance]) -> list[tuple[str, tuple[LightShare, ...]]]:
    """Patterns of names, and one share, or one for each month if the months differ."""
    checked = []
    if not isinstance(shares, Mapping):
        raise InputError(f"transmittance is {quoted(shares)}; give a dict of names and shares")
    for pattern, share in shares.items():
        what = f"transmittance of {quoted(text(pattern, 'a name in transmittance'))}"
        values = [] if isinstance(share, Mapping) else parts_of(share)
        if values is None or len(values) != len(MONTHS):
            months = [_checked_share(values or share, what, "a number, red, green and blue, or one of these per month")]
        else:
            of_month = zip(MONTHS, values)
            months = [_checked_share(v, f"{what} in {m}", "a number, or red, green and blue") for m, v in of_month]
        checked.append((pattern, tuple(months) if len(set(months)) > 1 else (months[0],)))
    return checked


def _checked_share(share: Any, what: str, forms: str) -> LightShare:
    """Shares of red, green and blue, from a number or three; `forms`: what to give instead."""
    values = [share] * 3 if (parts := parts_of(share)) is None else parts
    if len(values) != 3:
        raise InputError(f"{what} is {quoted(share)}; it must be {forms}")
    red, green, blue = (number(value, what, 0.0, 1.0, "[]") for value in values)
    return red, green, blue


def _survey(source: Source) -> tuple[Survey, np.ndarray, bool, bool]:
    """The survey and the colours ((n, 3) float32) at time 0; whether any mesh has a look, and alpha."""
    survey, colours, looks, alpha = Survey(source.file), [np.empty((0, 3), np.float32)], False, False
    for piece in source.pieces(0.0):
        survey.add(piece)
        looks = looks or (piece.look is not None and not piece.look.is_plain)
        alpha = alpha or (piece.look is not None and any(m.lets_light_pass for m in piece.look.materials))
        shape = piece.vertices.shape[0], faces_of(piece), 3
        colours.append(np.broadcast_to(piece.colour, shape).reshape(-1, 3))
    return survey, np.concatenate(colours), looks, alpha


# --- Loader notes, grouped by kind: 62 missing textures give one note -------------------------------------------------


_QUOTED = re.compile(r"""'[^']*'|"[^"]*\"""")


def group_notes(notes: Iterable[str], where: str = "Scene.notes has all") -> list[str]:
    """The first note of each kind, with the number of further ones. Notes of a kind differ in names and numbers only.

    where : tells the user where to find all notes
    """
    kinds: dict[tuple[str, ...], list[str]] = {}
    for note in notes:
        kinds.setdefault(_kind(note), []).append(note)
    return [
        group[0] + (f" (and {len(group) - 1} more of this kind; {where})" if len(group) > 1 else "")
        for group in kinds.values()
    ]


def _kind(note: str) -> tuple[str, ...]:
    """The plain words of a note, without names, numbers and file names."""
    words = (word.strip("(),;:") for word in _QUOTED.sub("", note).split())
    return tuple(word for word in words if word.isalpha())
