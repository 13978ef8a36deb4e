"""The common base of scenes: `Scene` has its triangles in memory, a store's `PagedScene` on disk."""

from abc import ABC, abstractmethod
from contextlib import suppress
from html import escape

import numpy as np

from ..checks import choice, number, quoted, whole_number
from ..errors import InputError
from . import engine, framing
from .appearance import Appearance
from .camera import MAX_SIZE, Camera
from .cityjson.model import CityModel
from .cutouts import Cutouts
from .hit import Hit
from .lights import Light
from .mesh import MeshInfo, ObjectInfo
from .triangles import Triangles
from .view import KINDS, View, skies_with, view_of_box

_GAP = 1e-5  # under a scene, as a share of its size: less than a picture shows, and more than float32 rounds


class AnyScene(ABC):
    """Name, bounds, cameras and lights of a scene, and ray queries. `Scene` documents the attributes."""

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
    _view: View | None = None

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

    def default_camera(
        self, width: int = 1024, height: int = 1024, kind: str = "perspective", time: float | None = None
    ) -> Camera:
        """A three-quarter view from a little above, as near as it shows the scene.

        Parts far from all others may lie outside of the picture, and so may a wide ground. A scene that encloses a room
        is shown from inside.

        Parameters
        ----------
        width, height : int
            Pixels.
        kind : str
            "perspective"; "orthographic", from outside; "top", orthographic from above; or "panoramic", in a room from
            its middle.
        time : float or None
            Seconds; the camera shows this moment of an animation. None: the whole animation.
        """
        choice(kind, "camera kind", KINDS)
        width = whole_number(width, "picture width", 1, MAX_SIZE)
        height = whole_number(height, "picture height", 1, MAX_SIZE)
        view = self.view if time is None else self._view_at(self.clamped(time))
        return view.camera(width, height) if kind == "perspective" else view.other_camera(kind, width, height)

    @property
    def view(self) -> View:
        """The geometry that a default picture shows. It is found at the first use."""
        if self._view is None:
            self._view = self._find_view()
        return self._view

    def _find_view(self) -> View:
        return view_of_box(self.bounds, self.up)

    def _view_at(self, time: float) -> View:
        """The view of a moment."""
        return self.view

    def ground_height(self, time: float | None = None) -> float:
        """The height, along the up axis, of a level ground just under the scene, in world units.

        time : seconds; under the scene at this moment of an animation; None: at moments all over the animation
        """
        gap = _GAP * float(np.linalg.norm(np.ptp(self.bounds, axis=0)))
        return self._lowest(None if time is None else self.clamped(time)) - gap

    def _lowest(self, time: float | None) -> float:
        """The lowest height of the scene, world."""
        return float(self.bounds[0, "xyz".index(self.up)])

    def default_lights(self, time: float = 0.0) -> list[Light]:
        """The scene's own lights at a time, or daylight: a sun to the viewer's left, and a `Sky`.

        A closed room without lights has a lamp instead of the sun. Own lights get a sky if one of them is a sun.
        """
        time = self.clamped(time)
        own = [self.light(i, time) for i in range(len(self._lights))]
        return own + skies_with(own, self.up) if own else self.view.lights()

    def default_light(self):
        """A single light: a `QuadLight` above the scene, as wide as the radius of its bounding sphere."""
        return framing.default_light(self.bounds, self.up)

    def occluded(
        self,
        origins,
        directions=None,
        tmin=0.0,
        tmax=np.inf,
        skip_face=None,
        time=0.0,
        *,
        targets=None,
        cull_faces=None,
        threads=None,
    ) -> np.ndarray:
        """Any-hit query: True for each ray that a triangle blocks strictly between tmin and tmax, or before its target.

        The answer is exact (docs/design/exactness.md). A scene in a store keeps to its `PagedScene.max_memory`.

        Parameters
        ----------
        origins, directions : (..., 3) float, world
            They broadcast against each other. `origins` alone may have shape (..., 6). Arrays with DLPack in host
            memory are accepted. Float64 origins are recentred before they are rounded to float32. Directions are
            rounded to float32. They need not be of unit length.
        tmin, tmax : float or (...) float
            In lengths of the direction, with 0 <= tmin. They bound `Hit.t`, in float64: a triangle blocks if
            ``tmin < t < tmax`` for the t that `closest_hit` reports for it. So a hit at exactly tmin or tmax does not
            count.
        skip_face : int or (...) int, optional
            A face that is not tested, for rays that start on a known face; -1: none.
        time : float
            Seconds. The BVH of the last query's time is kept.
        targets : (..., 3) float, world, optional
            The other ends of segments, in place of `directions`, `tmin` and `tmax`. A triangle blocks a segment if it
            meets it strictly between its ends. Targets are recentred and rounded as origins are. The answer is that of
            real arithmetic for the two rounded points: no direction between them is rounded.
        cull_faces : None, "front" or "back"
            Faces whose given side faces the ray's origin do not block it.
        threads : int, optional
            None: all cores.

        Returns
        -------
        (...) bool

        Raises
        ------
        InputError
            If shapes do not broadcast, origins, directions or targets are NaN, infinite or beyond float32, a direction
            is zero, tmin is negative or infinite, tmax is NaN, or targets are given beside directions, tmin or tmax.
        """
        rays = origins, directions, tmin, tmax, skip_face
        return engine.answer("ask", self, True, rays, targets, time, cull_faces, threads)

    def closest_hit(
        self,
        origins,
        directions=None,
        tmin=0.0,
        tmax=np.inf,
        skip_face=None,
        time=0.0,
        *,
        cull_faces=None,
        threads=None,
    ) -> Hit:
        """The nearest hit of each ray strictly between tmin and tmax; arguments and errors as for `occluded`.

        Returns
        -------
        Hit
            t (...) float64, in lengths of the direction, inf on a miss: the real number, rounded to the nearest
            float64. face (...) int32, -1 on a miss. u, v (...) float32, weights of the face's second and third corner,
            from 0 to 1. Among faces with the same t, the lowest index wins.

        Notes
        -----
        ``closest_hit(o, d, tmin=hit.t)`` finds the next hit. Repeated until nothing is hit, it visits each t once, in
        order, and of faces with the same t the lowest index.
        """
        rays = origins, directions, tmin, tmax, skip_face
        return engine.answer("ask", self, False, rays, None, time, cull_faces, threads)

    def _repr_html_(self) -> str:
        """What a notebook shows: a table of facts."""
        size = " x ".join(f"{v:.4g}" for v in self.bounds[1] - self.bounds[0])
        rows = {
            "triangles": f"{self.n_triangles:,}",
            "objects": f"{len(self.objects):,}",
            "size": f"{size}, {self.up} up",
            **({"crs": self.crs} if self.crs else {}),
            "cameras, lights": f"{len(self._cameras)}, {len(self._lights)}",
            **({"duration": f"{self.duration:g} s"} if self.animated else {}),
            **({"left out": "; ".join(self.notes)} if self.notes else {}),
        }
        body = "".join(f"<tr><th>{name}</th><td>{escape(value)}</td></tr>" for name, value in rows.items())
        return f"<table><caption>{type(self).__name__} {escape(self.name)}</caption>{body}</table>"

    def clamped(self, time) -> float:
        """`time`, clamped to 0 .. `duration`. Raises InputError unless it is a number."""
        time = number(time, "time (seconds)", -np.inf, np.inf, "[]")
        return min(max(time, 0.0), self.duration)
