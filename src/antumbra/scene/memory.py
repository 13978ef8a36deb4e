"""What a scene in memory holds: triangles, cameras and lights as a function of time."""

from contextlib import suppress
from functools import cached_property

import numpy as np

from ..checks import choice, instance, items, quoted, text
from ..errors import InputError, one_line
from .appearance import Appearance, appearance_of
from .camera import Camera
from .cityjson.model import CityModel
from .cutouts import Cutouts, cutouts_of
from .data import SceneData
from .materials import OPAQUE
from .recentre import frame_origin
from .source import Source
from .survey import Survey, faces_of, objects_of
from .triangles import Triangles

_MOMENTS = 25  # of an animation, at which its lowest point is looked for


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
    ):
        if not all(hasattr(source, part) for part in ("pieces", "cameras", "lights")):
            raise InputError(f"source is {quoted(source)}; make a Scene by load, Scene.from_arrays or Scene.from_mesh")
        self.city = None if city is None else instance(city, CityModel, "city")
        self.name, self.up = one_line(text(name, "name")), checked_up(up)
        self.notes = tuple(one_line(note) for note in items(notes, str, "notes"))
        self.crs = None if crs is None else text(crs, "crs")
        self.source, self.meshes, self.duration = source, source.meshes, float(source.duration)
        self.objects = source.objects
        self._object_of_face: np.ndarray | None = None
        self.bounds, self.colours, self._looks, alpha = _survey(source)
        self._appearance: Appearance | None = None
        self._cutouts: Cutouts | None = None
        self._find_cutouts = alpha
        self.origin = frame_origin(*self.bounds)
        self._cameras, self._lights = source.cameras(0.0), source.lights(0.0)

    @property
    def n_triangles(self) -> int:
        return len(self.colours)

    def _lowest(self, time: float | None) -> float:
        if not self.animated:
            return super()._lowest(time)
        if time is None:
            return self._lowest_ever
        axis = "xyz".index(self.up)
        return float(self.triangles(time).vertices[..., axis].min() + self.origin[axis])

    @cached_property
    def _lowest_ever(self) -> float:
        found = [self._lowest(0.0)]
        for time in np.linspace(0.0, self.duration, _MOMENTS)[1:]:
            with suppress(InputError):  # a moment that has no triangles shows its error when it is rendered
                found.append(self._lowest(time))
        return min(found)

    @property
    def object_of_face(self) -> np.ndarray:
        """(n,) int32: the index in `objects` of each face, in the order of `triangles`. Do not write to it.

        The first use evaluates the geometry once more, piece by piece.
        """
        if self._object_of_face is None:
            self._object_of_face = objects_of(self.source.pieces(0.0))
        return self._object_of_face

    @property
    def appearance(self) -> Appearance | None:
        """Textures, colours of vertices, shading normals and alpha; None if each face has one colour and no more.

        The first use evaluates the geometry once more, piece by piece. Textures are decoded when they are shown.
        """
        if self._looks and self._appearance is None:
            self._appearance = appearance_of(self.source, self.n_triangles)
        return self._appearance

    @property
    def cutouts(self) -> Cutouts | None:
        """The faces with holes, which alpha cuts; None: all faces are solid. The first use decodes their textures.

        Raises
        ------
        InputError
            If a texture cannot be decoded.
        """
        if self._find_cutouts:
            assert self.appearance is not None
            self._cutouts, self._find_cutouts = cutouts_of(self.appearance), False
        return self._cutouts

    def ignore_alpha(self) -> None:
        """Make all faces solid. Call it before the first query."""
        self._cutouts, self._find_cutouts = None, False

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
        from .areas import solid_faces
        from .gather import gather

        time, threads = self.clamped(time), thread_count(threads)
        vertices = np.empty((self.n_triangles, 3, 3), np.float32)
        start = 0
        with np.errstate(all="ignore"):
            for piece in self.source.pieces(time):
                start += gather(piece, self.origin, vertices[start:], threads)
        face_id, cutouts = np.arange(self.n_triangles, dtype=np.int32), self.cutouts
        solid = solid_faces(vertices, None if cutouts is None else cutouts.solid, threads)
        return Triangles(vertices, self.origin.copy(), face_id, self.colours, cutouts, solid)

    def _cameras_at(self, time: float) -> list[Camera]:
        return self.source.cameras(time)

    def _lights_at(self, time: float) -> list:
        return self.source.lights(time)


def checked_up(up: str) -> str:
    return choice(up, "up", ("y", "z"))


def _survey(source: Source) -> tuple[np.ndarray, np.ndarray, bool, bool]:
    """Bounds ((2, 3) float64) and colours ((n, 3) float32) at time 0; whether any mesh has a look, and alpha."""
    survey, colours, looks, alpha = Survey(source.file), [np.empty((0, 3), np.float32)], False, False
    for piece in source.pieces(0.0):
        survey.add(piece)
        looks = looks or piece.look is not None
        alpha = alpha or (piece.look is not None and any(m.alpha_mode != OPAQUE for m in piece.look.materials))
        shape = piece.vertices.shape[0], faces_of(piece), 3
        colours.append(np.broadcast_to(piece.colour, shape).reshape(-1, 3))
    return survey.bounds(), np.concatenate(colours), looks, alpha
