"""Scenes for stores: a source whose pieces are read one after the other, and never kept."""

from typing import ClassVar, NoReturn

import numpy as np
from numpy.typing import NDArray

from ..base.errors import one_line
from .camera import Camera
from .face_looks import LookFinder, StreamedLooks, attributes_of
from .lights import Light
from .mesh import Source
from .open_faces import OpenFaceFinder, StreamedOpenFaces
from .scene_bounds import FaceSample, Survey, frame_origin
from .scene_data import SceneData
from .shared_vertices import SharedVertices, shares_vertices

_IN_RANGES = (
    "was read in ranges of faces, at whose borders smooth shading may differ slightly, since corners name normals and "
    "texture coordinates by numbers of their own; build_store(antumbra.load(...)) avoids this"
)


class StreamedData(SceneData):
    """A scene of a source, of which only the bounds are in memory.

    Name, up axis, notes and pieces equal those of `MemoryData`, with faces in the same order.
    """

    resident: ClassVar[bool] = False
    has_copies = False  # whether memory would keep copies of meshes as instances, which are shown from outside

    def __init__(self, source: Source, *, name: str, up: str, notes: tuple[str, ...] = ()):
        self.name, self.up, self.notes = one_line(name), up, tuple(map(one_line, notes))
        self.source, self.meshes, self.objects = source, source.meshes, source.objects
        self.duration = float(source.duration)
        survey, self._has_looks, self._attributes, has_borders = Survey(source.file), False, set[str](), False
        self._has_alpha = False
        self._open_faces: StreamedOpenFaces | None = StreamedOpenFaces()
        self._shared: SharedVertices | None = None  # of meshes with normals that are read in ranges
        sample = FaceSample(sum(mesh.triangles * mesh.instances for mesh in source.meshes))
        for piece in source.pieces(0.0):
            survey.add(piece)
            sample.add(piece)
            self._open_faces.count(piece)
            self._has_alpha |= piece.look is not None and any(each.lets_light_pass for each in piece.look.materials)
            if piece.look is not None and not piece.look.is_plain:
                self._has_looks, attributes = True, attributes_of(piece.look)
                self._attributes |= attributes
                if shares_vertices(piece):
                    self._shared = self._shared or SharedVertices(source.file)
                    self._shared.add(piece)
                else:
                    has_borders |= piece.is_range and "normals" in attributes
        if has_borders:
            self.notes = (*self.notes, one_line(f"{source.file}: {_IN_RANGES}"))
        self._n_triangles, self._sample = survey.n_triangles, sample.corners
        self.bounds, self.origin = survey.bounds(), survey.origin()
        self.middle = frame_origin(*self.bounds)
        self._cameras, self._lights = source.cameras(0.0), source.lights(0.0)

    @property
    def n_triangles(self) -> int:
        return self._n_triangles

    def sampled_faces(self, time: float | None = None) -> NDArray[np.float64]:
        """(m, 3, 3) float64, world: as from `scene_bounds.sampled_faces`, at rest."""
        return self._sample

    @property
    def has_looks(self) -> bool:
        return self._has_looks

    def looks(self) -> LookFinder | None:
        return StreamedLooks(self._attributes, self._shared) if self._has_looks else None

    @property
    def lets_light_pass(self) -> bool:
        return self._has_alpha and self._open_faces is not None

    def open_faces(self) -> OpenFaceFinder | None:
        return self._open_faces

    def ignore_alpha(self) -> None:
        self._open_faces = None

    @property
    def object_of_face(self) -> NoReturn:
        """Always raises InputError."""
        raise self.refusal()

    def triangles(self, time: float = 0.0, threads: int | None = None) -> NoReturn:
        """Always raises InputError."""
        raise self.refusal()

    def _cameras_at(self, time: float) -> list[Camera]:
        return self.source.cameras(time)

    def _lights_at(self, time: float) -> list[Light]:
        return self.source.lights(time)
