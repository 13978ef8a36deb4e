"""Values at vertices: measured there, or on the faces around a vertex that lies inside a solid."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from ...progress import report_progress
from ...scene.lights import AmbientOcclusion
from .hidden import Solids
from .measure import Meter, SurfacePoints
from .parts import Part, face_vectors

_TOWARDS = 0.125, 0.25, 0.5, 0.75, 1.0  # of the way from a hidden vertex to the centre of a face


class Faces(NamedTuple):
    """The faces of all parts, over the vertices of all parts."""

    faces: np.ndarray  # (f, 3) int64
    areas: np.ndarray  # (f,) float64, twice the area
    normals: np.ndarray  # (f, 3) float64, unit, outward


def receivers_of(parts: Sequence[Part]) -> SurfacePoints:
    """The vertices of all parts, one part after the other."""
    return SurfacePoints(np.concatenate([p.positions for p in parts]), np.concatenate([p.normals for p in parts]))


def replace_hidden(
    values: np.ndarray, receivers: SurfacePoints, parts: Sequence[Part], meter: Meter, solids: Solids | None
) -> int:
    """Replace the values of vertices inside solids; return how many these are.

    values : (n, c) float32, as measured at the vertices of all parts
    solids : None: vertices inside solids keep their own values
    """
    if solids is None:
        return 0
    with report_progress("moving hidden points"):
        candidates = np.flatnonzero(suspects(values, meter))
        hidden = candidates[solids.hold(receivers.at(candidates))]
        if len(hidden):
            _replace(values, hidden, receivers, _faces_of(parts), meter, solids)
    return len(hidden)


def suspects(values: np.ndarray, meter: Meter) -> np.ndarray:
    """(n,) bool: receivers that may be inside a solid, since no ray leaves it; all, if rays end before its wall."""
    what, light = meter.asked.what, meter.asked.lights[0]
    if what == "bent-normal" or (isinstance(light, AmbientOcclusion) and light.radius is not None):
        return np.ones(len(values), bool)
    return np.asarray((values <= 1.0 / meter.asked.spp).all(-1))


def _faces_of(parts: Sequence[Part]) -> Faces:
    starts = np.cumsum([0, *(len(p.positions) for p in parts)])
    vectors = np.concatenate([face_vectors(p.positions, p.faces) * p.sign for p in parts])
    areas = np.linalg.norm(vectors, axis=1)
    faces = np.concatenate([p.faces.astype(np.int64) + start for p, start in zip(parts, starts)])
    return Faces(faces, areas, vectors / np.maximum(areas, 1e-300)[:, None])


def _replace(
    values, hidden: np.ndarray, receivers: SurfacePoints, all_faces: Faces, meter: Meter, solids: Solids
) -> None:
    """Give hidden vertices the mean, by area, of the nearest visible points on the faces around them.

    A vertex whose faces are hidden too keeps its value: nobody sees it.
    """
    waiting = np.zeros(len(values), bool)
    waiting[hidden] = True
    for share in _TOWARDS:
        face, corner = np.nonzero(waiting[all_faces.faces] & (all_faces.areas > 0.0)[:, None])
        if not len(face):
            return
        vertex = all_faces.faces[face, corner]
        centre = receivers.positions[all_faces.faces[face]].mean(1)
        points = SurfacePoints((1.0 - share) * receivers.positions[vertex] + share * centre, all_faces.normals[face])
        seen = ~solids.hold(points)
        if seen.any():
            found, weight = meter.values(points.at(seen)), all_faces.areas[face[seen]]
            total = np.bincount(vertex[seen], weight, len(values))
            done = waiting & (total > 0.0)
            for c in range(values.shape[1]):
                sums = np.bincount(vertex[seen], weight * found[:, c], len(values))
                values[done, c] = sums[done] / total[done]
            waiting &= ~done
