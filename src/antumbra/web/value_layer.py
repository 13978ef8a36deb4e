"""Numbers of a result on the surfaces of a page: of faces, of corners of faces, or of points near surfaces."""

from typing import Any, NamedTuple

import numpy as np

from ..scene.triangles import Triangles


class Stop(NamedTuple):
    """A value with its text and colour."""

    value: float
    text: str
    colour: tuple[int, int, int]  # sRGB


class ValueLayer(NamedTuple):
    """Numbers and their colours; one of `faces`, `corners` and `points` says where they belong."""

    name: str  # what the numbers are
    unit: str
    values: np.ndarray  # (n,) float64; NaN: none
    stops: list[Stop]  # by ascending value; colours between them are interpolated
    ticks: list[tuple[float, str]]  # of the legend
    classes: bool = False  # whether each value is a stop, with a colour of its own
    faces: np.ndarray | None = None  # (faces of the scene,) int: the row of each face, -1: none
    corners: np.ndarray | None = None  # (faces of the scene, 3) int: the rows of its corners, -1: none
    points: np.ndarray | None = None  # (n, 3) float64, world
    normals: np.ndarray | None = None  # (n, 3): which sides of surfaces points colour; None: all
    point_faces: np.ndarray | None = None  # (n,) int: the face that each point colours before others do; None: any
    reach: float = 0.0  # world units: points colour the surface so far around them

    def arrays(self, triangles: Triangles) -> dict[str, np.ndarray]:
        """The columns of a page that `page/surface_values.mjs` reads, in the order of its triangles."""
        single = self.values.astype(np.float32)
        exact = np.array_equal(single, self.values, equal_nan=True)
        found: dict[str, np.ndarray] = {"values": single if exact else self.values}
        rows = self.corners if self.faces is None else self.faces
        if rows is not None:
            return found | {"rowOf": rows[triangles.face_id].astype(np.int32)}
        assert self.points is not None
        found["points"] = (self.points - triangles.origin).astype(np.float32)
        if self.normals is not None:
            found["pointNormals"] = self.normals.astype(np.float32)
        if self.point_faces is not None:
            row = np.full(max(triangles.face_id.max(), self.point_faces.max(initial=0)) + 1, -1, np.int32)
            row[triangles.face_id] = np.arange(len(triangles.face_id))
            found["pointFaces"] = row[self.point_faces]
        return found

    def about(self) -> dict[str, Any]:
        """The scale and its legend, in JSON types, and what the rows are."""
        stops = [stop._asdict() for stop in self.stops]
        ticks = [{"value": value, "text": text} for value, text in self.ticks]
        scale = {"name": self.name, "unit": self.unit, "classes": self.classes, "stops": stops, "ticks": ticks}
        at = "faces" if self.faces is not None else "corners" if self.corners is not None else "points"
        return {**scale, "at": at, "reach": self.reach}
