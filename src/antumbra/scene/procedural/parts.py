"""Parts of a scene: meshes with the positions of their copies. They are counted cheaply and assembled at the end."""

from collections.abc import Callable, Iterable
from typing import NamedTuple

import numpy as np

from .shapes import PaletteMesh


class ScenePart(NamedTuple):
    """Copies of a mesh: vertices of copy i are ``matrix[i] @ vertex + offset[i]``."""

    mesh: PaletteMesh
    offset: np.ndarray  # (k, 3) float32
    matrix: np.ndarray  # (k, 3, 3) float32
    shade: np.ndarray  # (k,) uint8, added to the colour of every face

    @property
    def n_triangles(self) -> int:
        return len(self.offset) * len(self.mesh.faces)


def turned(angle) -> np.ndarray:
    """(k, 3, 3) rotations about +Y by (k,) angles in radians; 90 degrees take +Z to +X."""
    angle = np.atleast_1d(np.asarray(angle, np.float64))
    c, s, zero, one = np.cos(angle), np.sin(angle), np.zeros_like(angle), np.ones_like(angle)
    return np.stack([c, zero, s, zero, one, zero, -s, zero, c], axis=-1).reshape(-1, 3, 3)


def tilted(angle) -> np.ndarray:
    """(k, 3, 3) rotations about +X by (k,) angles in radians; 90 degrees take +Y to +Z."""
    angle = np.atleast_1d(np.asarray(angle, np.float64))
    c, s, zero, one = np.cos(angle), np.sin(angle), np.zeros_like(angle), np.ones_like(angle)
    return np.stack([one, zero, zero, zero, c, -s, zero, s, c], axis=-1).reshape(-1, 3, 3)


def put(mesh: PaletteMesh, at=(0.0, 0.0, 0.0), turn=0.0, scale=1.0, tilt=None, shade=0) -> ScenePart:
    """Copies of a mesh at (k, 3) positions: scaled ((k,) or (k, 3)), tilted about X, then turned about Y (radians)."""
    offset = np.atleast_2d(np.asarray(at, np.float32))
    k = len(offset)
    matrix = turned(turn)
    if tilt is not None:
        matrix = matrix @ tilted(tilt)
    scale = np.asarray(scale, np.float64)
    if scale.ndim == 1:
        scale = scale[:, None, None]
    elif scale.ndim == 2:
        scale = scale[:, None, :]
    matrix = np.broadcast_to((matrix * scale).astype(np.float32), (k, 3, 3))
    return ScenePart(mesh, offset, matrix, np.broadcast_to(np.asarray(shade, np.uint8), (k,)))


def moved(parts: Iterable[ScenePart], at=(0.0, 0.0, 0.0), turn=0.0) -> list[ScenePart]:
    """The parts, turned about Y (radians) as one, then moved by `at` (3,)."""
    around = turned(turn)[0].astype(np.float32)
    shift = np.asarray(at, np.float32)
    return [part._replace(offset=part.offset @ around.T + shift, matrix=around @ part.matrix) for part in parts]


def count(parts: Iterable[ScenePart]) -> int:
    """The number of triangles of the parts, without assembling them."""
    return sum(part.n_triangles for part in parts)


def assemble(parts: Iterable[ScenePart]) -> PaletteMesh:
    """All copies of all parts as one mesh."""
    parts = [part for part in parts if part.n_triangles]
    n_vertices = sum(len(part.offset) * len(part.mesh.vertices) for part in parts)
    vertices = np.empty((n_vertices, 3), np.float32)
    faces = np.empty((count(parts), 3), np.int32)
    colour = np.empty(len(faces), np.uint8)
    v = f = 0
    for part in parts:
        k, m, n = len(part.offset), len(part.mesh.vertices), len(part.mesh.faces)
        moved = vertices[v : v + k * m].reshape(k, m, 3)
        np.matmul(part.mesh.vertices, part.matrix.transpose(0, 2, 1), out=moved)
        moved += part.offset[:, None]
        starts = np.arange(v, v + k * m, m, dtype=np.int32)[:, None, None]
        np.add(part.mesh.faces, starts, out=faces[f : f + k * n].reshape(k, n, 3))
        np.add(part.mesh.colour, part.shade[:, None], out=colour[f : f + k * n].reshape(k, n))
        v, f = v + k * m, f + k * n
    return PaletteMesh(vertices, faces, colour)


def fitted(build: Callable[[float], list[ScenePart]], triangles: int, detail: float, near=0.93) -> list[ScenePart]:
    """`build(detail)` with the detail that gives just under `triangles` triangles, found from a first guess.

    The number of triangles grows with the square of the detail, which false position finds. Counts grow in steps, so
    any count from `near` * `triangles` on is accepted. If even the coarsest version has more, it is taken.
    """
    x, low, high = detail**2, (0.0, 0.0), (np.inf, np.inf)  # (square of the detail, triangles) below and above
    best: list[ScenePart] = []
    for _ in range(12):
        parts = build(np.sqrt(x))
        n = count(parts)
        if n <= triangles:
            low, best = (x, n), parts
        else:
            high = (x, n)
            best = best or parts
        if near * triangles <= n <= triangles or x < 1e-4:
            break
        if high[0] == np.inf:
            x *= min(8.0, 0.98 * triangles / max(n, 1))
        elif low[0] == 0.0:
            x *= max(0.1, 0.96 * triangles / max(n, 1) - 0.02)
        else:
            share = (0.97 * triangles - low[1]) / (high[1] - low[1])
            x = low[0] + (high[0] - low[0]) * float(np.clip(share, 0.15, 0.85))
    return parts if count(best) > triangles else best
