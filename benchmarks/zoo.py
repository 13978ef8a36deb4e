"""The cases of `wrong_elsewhere`: closed float32 meshes, and rays that are sensitive to rounding.

All coordinates are multiples of a power of two, so that Antumbra's recentred frame represents them exactly, and every
library gets the same input.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
import trimesh

UTM = np.array([592_770.0, 5_763_170.0, 20.0])
"""A place in Delft, in metres: float32 has steps of 6 cm eastwards and 50 cm northwards."""


class Case(NamedTuple):
    """A query on one mesh: rays that start in space, or points on faces that look towards suns."""

    name: str
    vertices: np.ndarray  # (m, 3, 3) float32; counter-clockwise from outside, or from inside for rooms
    origins: np.ndarray  # (n, 3) float32: origins of rays, or points on faces
    directions: np.ndarray  # (n, 3) float32: of rays, or towards suns
    faces: np.ndarray | None = None  # (n,) the face of each point; None: rays
    inside: bool = False  # whether the closed mesh contains all origins, so that every ray is blocked


def _stepped(values: np.ndarray, size: float) -> np.ndarray:
    """Rounded to steps of 2^-22 of the power of two above `size`."""
    step = 2.0 ** (np.ceil(np.log2(size)) - 22)
    return np.round(values / step) * step


def _ball(rng, stretch=(1.0, 1.0, 1.0), rings: int = 2) -> tuple[np.ndarray, np.ndarray]:
    """Vertices (v, 3) and faces (f, 3) of a rotated and stretched ball."""
    ball = trimesh.creation.icosphere(rings)
    turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    turn *= np.sign(np.linalg.det(turn))
    moved = ball.vertices * stretch @ turn.T
    return _stepped(moved, np.abs(moved).max()), np.asarray(ball.faces)


def _house(parts: int = 4) -> tuple[np.ndarray, np.ndarray]:
    """A box of 12 x 16 x 8 m with walls of squares, in UTM coordinates. Its corners are exact in float32."""
    box = trimesh.creation.box((12, 16, 8))
    for _ in range(parts // 2):
        box = box.subdivide()
    box.merge_vertices()
    return np.round(box.vertices * 2) / 2 + UTM, np.asarray(box.faces)


def _aimed(vertices, faces, origins, rng, at_edges: bool) -> np.ndarray:
    """Directions from origins to random vertices, or to random points of edges, rounded to float32."""
    which = faces[rng.integers(len(faces), size=len(origins))]
    a, b = vertices[which[:, 0]], vertices[which[:, 1]]
    share = rng.random((len(origins), 1)) if at_edges else 0.0
    return (a + share * (b - a) - origins).astype(np.float32)


def _within(vertices, rng, n: int, spread: float = 0.3) -> np.ndarray:
    """Points inside a convex mesh, around its middle."""
    weights = rng.random((n, len(vertices))) ** 8
    weights /= weights.sum(1, keepdims=True)
    middle, size = vertices.mean(0), np.ptp(vertices, axis=0).max()
    return middle + _stepped(spread * (weights @ (vertices - middle)), size)


def _closed(name: str, mesh, rng, n: int, at_edges: bool, spread: float = 0.3) -> Case:
    """Rays from inside a closed convex mesh to its vertices or edges."""
    vertices, faces = mesh
    origins = _within(vertices, rng, n, spread).astype(np.float32)
    directions = _aimed(vertices, faces, origins.astype(float), rng, at_edges)
    return Case(name, vertices[faces].astype(np.float32), origins, directions, inside=True)


def vertices_of_ball(rng, n: int) -> Case:
    return _closed("cracks at vertices", _ball(rng), rng, n, at_edges=False)


def edges_of_ball(rng, n: int) -> Case:
    return _closed("cracks at edges", _ball(rng), rng, n, at_edges=True)


def slivers(rng, n: int) -> Case:
    """A ball stretched to a needle: triangles 10,000 times as long as wide."""
    return _closed("slivers", _ball(rng, (1.0, 1e-4, 1e-4)), rng, n, at_edges=True)


def grazing(rng, n: int) -> Case:
    """A flattened ball: rays leave through its rim, almost parallel to the faces."""
    return _closed("grazing rays", _ball(rng, (1.0, 1.0, 1e-3)), rng, n, at_edges=True)


def huge(rng, n: int) -> Case:
    """A box of 2,000 km in twelve triangles, seen from within a kilometre of a corner."""
    box = trimesh.creation.box((2**21,) * 3)
    vertices, faces = box.vertices, np.asarray(box.faces)
    origins = (vertices[0] - np.sign(vertices[0]) * _stepped(1000 * rng.random((n, 3)), 2**21)).astype(np.float32)
    directions = _aimed(vertices, faces, origins.astype(float), rng, at_edges=True)
    return Case("huge triangles", vertices[faces].astype(np.float32), origins, directions, inside=True)


def house(rng, n: int) -> Case:
    return _closed("rooms in UTM coordinates", _house(), rng, n, at_edges=True, spread=0.9)


def silhouettes(rng, n: int) -> Case:
    """Rays from outside past the outline of a ball, as close as float32 allows: some hit it, and some do not."""
    vertices, faces = _ball(rng)
    eye = _stepped(3.0 * rng.normal(size=3) / np.sqrt(3) + 2.0, 8.0)
    corners = vertices[faces]
    front = (
        (np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]) * (eye - corners[:, 0])).sum(1)
    ) > 0
    edges = {}
    for face, is_front in zip(faces, front):
        for i, j in zip(face, np.roll(face, -1)):
            edges.setdefault((min(i, j), max(i, j)), []).append(is_front)
    outline = np.array([edge for edge, sides in edges.items() if sides[0] != sides[1]])
    a, b = vertices[outline[rng.integers(len(outline), size=n)]].transpose(1, 0, 2)
    directions = (a + rng.random((n, 1)) * (b - a) - eye).astype(np.float32)
    return Case("outlines", corners.astype(np.float32), np.tile(eye, (n, 1)).astype(np.float32), directions)


def _sunlit(name: str, mesh, rng, n: int, room: bool = False) -> Case:
    """Points on the faces of a convex mesh, and suns all around. In a room, the faces point inwards.

    Points closer than two float32 steps to another face are skipped, because rounding may have moved them onto it.
    """
    vertices, faces = mesh
    corners = vertices[faces][:, ::-1] if room else vertices[faces]
    which = rng.integers(len(faces), size=n)
    points = (rng.dirichlet((1, 1, 1), n)[:, :, None] * corners[which]).sum(1).astype(np.float32)
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    away = np.abs((points @ normals.T.astype(np.float64)) - (corners[:, 0] * normals).sum(1))
    coplanar = normals[which] @ normals.T > 1 - 1e-12
    clear = (coplanar | (away > 2.0 * np.spacing(np.abs(points).max(1, keepdims=True)))).all(1)
    suns = rng.normal(size=(8, 3)).astype(np.float32)[rng.integers(8, size=n)]
    return Case(name, corners.astype(np.float32), points[clear], suns[clear], which[clear], room)


def acne(rng, n: int) -> Case:
    return _sunlit("acne on a ball", _ball(rng, rings=3), rng, n)


def acne_far(rng, n: int) -> Case:
    return _sunlit("acne in UTM coordinates", _house(), rng, n)


def light_in_rooms(rng, n: int) -> Case:
    return _sunlit("light in closed rooms, UTM", _house(), rng, n, room=True)


CASES: tuple[Callable[..., Case], ...] = (
    vertices_of_ball,
    edges_of_ball,
    slivers,
    grazing,
    huge,
    silhouettes,
    house,
    acne,
    acne_far,
    light_in_rooms,
)
"""Functions of (rng, n) that make a case of about n rays."""
