"""The common base of what scenes hold: `MemoryData` has triangles in memory, `StoreData` on disk."""

from abc import ABC, abstractmethod
from contextlib import suppress

import numpy as np

from ..checks import number, quoted, whole_number
from ..errors import InputError
from .appearance import Appearance
from .camera import Camera
from .cityjson.model import CityModel
from .cutouts import Cutouts
from .lights import Light
from .mesh import MeshInfo, ObjectInfo
from .triangles import Triangles

_GAP = 1e-5  # under a scene, as a share of its size: less than a picture shows, and more than float32 rounds


class SceneData(ABC):
    """Name, bounds, cameras, lights and triangles of a scene. `engine.scene.Scene` documents the attributes."""

    name: str
    up: str  # "y" or "z"
    notes: tuple[str, ...]
    duration: float  # seconds
    meshes: list[MeshInfo]
    objects: list[ObjectInfo]
    bounds: np.ndarray  # (2, 3) float64, world
    origin: np.ndarray  # (3,) float64, world
    city: CityModel | None = None  # of a CityJSON file
    crs: str | None = None  # coordinate reference system of the world coordinates, such as "EPSG:7415"
    _cameras: list[Camera]  # at time 0
    _lights: list[Light]

    @property
    @abstractmethod
    def n_triangles(self) -> int: ...

    @property
    def appearance(self) -> Appearance | None:
        """Textures, colours of vertices, shading normals and alpha. A store has none."""
        return None

    @property
    def cutouts(self) -> Cutouts | None:
        """The faces with holes, which alpha cuts; None: all faces are solid, as those of a store."""
        return None

    def ignore_alpha(self) -> None:
        """Make all faces solid. Call it before the first query."""
        assert self.cutouts is None, "only scenes in memory have cut-outs"

    @property
    @abstractmethod
    def object_of_face(self) -> np.ndarray:
        """(n,) int32: the index in `objects` of each face, in the order of `triangles`. Do not write to it."""

    @abstractmethod
    def triangles(self, time: float = 0.0, threads: int | None = None) -> Triangles:
        """The triangles at `time`. A store raises InputError."""

    @abstractmethod
    def _cameras_at(self, time: float) -> list[Camera]:
        """The cameras at a time within 0 .. `duration`."""

    @abstractmethod
    def _lights_at(self, time: float) -> list[Light]:
        """The lights at a time within 0 .. `duration`."""

    @property
    def animated(self) -> bool:
        """Whether anything can change between time 0 and `duration`."""
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
        index = self._known("camera", index, len(self._cameras))
        return self._cameras_at(self.clamped(time))[index]

    def light(self, index: int = 0, time: float = 0.0) -> Light:
        """Light `index` of the file at `time`."""
        index = self._known("light", index, len(self._lights))
        return self._lights_at(self.clamped(time))[index]

    def _known(self, kind: str, index: int, count: int) -> int:
        """The checked index of one of the scene's own cameras or lights."""
        with suppress(InputError):
            return whole_number(index, kind, 0, count - 1)
        raise InputError(f"{self.name}: there is no {kind} {quoted(index)}; the scene has {count}")

    def ground_height(self, time: float | None = None) -> float:
        """The height, along the up axis, of a level ground just under the scene, in world units.

        time : seconds; under the scene at this moment of an animation; None: at moments all over the animation
        """
        gap = _GAP * float(np.linalg.norm(np.ptp(self.bounds, axis=0)))
        return self._lowest(None if time is None else self.clamped(time)) - gap

    def _lowest(self, time: float | None) -> float:
        """The lowest height of the scene, world."""
        return float(self.bounds[0, "xyz".index(self.up)])

    def clamped(self, time) -> float:
        """`time`, clamped to 0 .. `duration`. Raises InputError unless it is a number."""
        time = number(time, "time (seconds)", -np.inf, np.inf, "[]")
        return min(max(time, 0.0), self.duration)
