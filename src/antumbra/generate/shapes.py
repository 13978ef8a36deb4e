"""Small meshes such as boxes, lofts and tubes, and scene parts: instanced copies of meshes, assembled at the end.

Faces are counter-clockwise seen from outside; +Y is up. Most meshes are closed.
"""

import itertools
from collections.abc import Callable, Iterable
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..kernels.elementary import cos, sin, sin_cos
from ..kernels.small_matrices import dot, product

# --- Meshes from grids of points --------------------------------------------------------------------------------------


class PaletteMesh(NamedTuple):
    """Indexed triangles with palette colours."""

    vertices: NDArray[np.float32]  # (v, 3) float32, metres
    faces: NDArray[np.int32]  # (f, 3) int32
    colour: NDArray[np.uint8]  # (f,) uint8, palette indices


def cross(a: NDArray[np.float64], b: NDArray[np.float64]) -> NDArray[np.float64]:
    """`np.cross` of (..., 3) arrays, without its overhead for small arrays."""
    return a[..., [1, 2, 0]] * b[..., [2, 0, 1]] - a[..., [2, 0, 1]] * b[..., [1, 2, 0]]


def steps(number: float, detail: float, least: int = 1) -> int:
    """A tessellation count that grows with detail and equals `number` at detail 1."""
    return max(least, round(number * detail))


def merge(*meshes: PaletteMesh) -> PaletteMesh:
    """Several meshes as one."""
    starts = np.cumsum([0] + [len(m.vertices) for m in meshes[:-1]], dtype=np.int32)
    return PaletteMesh(
        np.concatenate([m.vertices for m in meshes]),
        np.concatenate([m.faces + start for m, start in zip(meshes, starts)]),
        np.concatenate([m.colour for m in meshes]),
    )


def raise_mesh(mesh: PaletteMesh, y: float) -> PaletteMesh:
    """The mesh, raised by `y` metres."""
    return mesh._replace(vertices=mesh.vertices + np.array([0.0, y, 0.0], np.float32))


def orient_outward(mesh: PaletteMesh) -> PaletteMesh:
    """A closed mesh with its faces oriented outward, so that its signed volume is positive."""
    a, b, c = (mesh.vertices[mesh.faces[:, i]].astype(np.float64) - mesh.vertices[0] for i in range(3))
    if np.sum(np.cross(a, b) * c) < 0.0:
        return mesh._replace(faces=mesh.faces[:, ::-1])
    return mesh


def _split(index: np.ndarray, flip: np.ndarray | None = None) -> np.ndarray:
    """Two triangles per cell of an array of vertex indices; `flip` selects the other diagonal."""
    a, b, c, d = index[:-1, :-1], index[:-1, 1:], index[1:, 1:], index[1:, :-1]
    pairs = np.stack([a, b, c, a, c, d], axis=-1)
    if flip is not None:
        pairs = np.where(flip[..., None], np.stack([a, b, d, b, c, d], axis=-1), pairs)
    return pairs.reshape(-1, 3)


def _colours(colour: ArrayLike, n: int) -> NDArray[np.uint8]:
    """`colour`, one value or one per cell, as (n,) uint8."""
    colour = np.asarray(colour, np.uint8).reshape(-1)
    return np.repeat(colour, n // len(colour))


def grid(points: ArrayLike, colour: ArrayLike = 0, flip: NDArray[np.bool_] | None = None) -> PaletteMesh:
    """An open surface through (m, n, 3) points that faces (along n) x (along m); colour: scalar or (m - 1, n - 1)."""
    points = np.asarray(points, np.float32)
    index = np.arange(points.shape[0] * points.shape[1], dtype=np.int32).reshape(points.shape[:2])
    faces = _split(index, flip)
    return PaletteMesh(points.reshape(-1, 3), faces, _colours(colour, len(faces)))


def heightfield(
    x: NDArray[np.float64], z: NDArray[np.float64], height: NDArray[np.float64], colour: ArrayLike = 0
) -> PaletteMesh:
    """An open surface (x[i], height[i, j], z[j]) that faces up."""
    points = np.empty((len(x), len(z), 3), np.float32)
    points[..., 0], points[..., 1], points[..., 2] = np.asarray(x)[:, None], height, z
    return grid(points, colour)


@lru_cache(maxsize=64)
def _rim(m: int, n: int) -> np.ndarray:
    """The boundary vertices of an m x n grid, in the winding order of its faces."""
    index = np.arange(m * n, dtype=np.int32).reshape(m, n)
    return np.concatenate([index[0, :-1], index[:-1, -1], index[-1, :0:-1], index[:0:-1, 0]])


def shell(front: ArrayLike, back: ArrayLike, colour: ArrayLike = 0, rim_colour: int | None = None) -> PaletteMesh:
    """The solid between two (m, n, 3) grids of points."""
    front, back = np.asarray(front, np.float32), np.asarray(back, np.float32)
    m, n = front.shape[:2]
    index = np.arange(m * n, dtype=np.int32).reshape(m, n)
    front_faces, rim = _split(index), _rim(m, n)
    wall = _split(np.stack([np.append(rim, rim[0]), np.append(rim, rim[0]) + m * n])[::-1].astype(np.int32))
    faces = np.concatenate([front_faces, front_faces[:, ::-1] + m * n, wall])
    cells = _colours(colour, len(front_faces))
    edge = _colours(cells[0] if rim_colour is None else rim_colour, len(wall))
    vertices = np.concatenate([front.reshape(-1, 3), back.reshape(-1, 3)])
    return orient_outward(PaletteMesh(vertices, faces, np.concatenate([cells, cells, edge])))


def block(points: ArrayLike, level: float, colour: ArrayLike = 0) -> PaletteMesh:
    """The solid between a surface of (m, n, 3) points and the horizontal plane at height `level`."""
    top = grid(points, colour)
    m, n = np.asarray(points).shape[:2]
    rim = _rim(m, n)
    foot = top.vertices[rim] * np.array([1, 0, 1], np.float32) + np.array([0, level, 0], np.float32)
    under = np.arange(m * n, m * n + len(rim), dtype=np.int32)
    wall = _split(np.stack([np.append(under, under[0]), np.append(rim, rim[0])]))
    cap = np.stack([np.full_like(under, m * n + len(rim)), np.roll(under, -1), under], axis=1)
    return orient_outward(
        PaletteMesh(
            np.concatenate([top.vertices, foot, foot.mean(axis=0, keepdims=True)]),
            np.concatenate([top.faces, wall, cap]),
            np.concatenate([top.colour, _colours(top.colour[0], len(wall) + len(cap))]),
        )
    )


@lru_cache(maxsize=256)
def _loft_faces(n: int, k: int, closed: bool) -> np.ndarray:
    index = np.arange(n * k, dtype=np.int32).reshape(n, k)
    index = np.concatenate([index, index[:, :1]], axis=1)
    if closed:
        return _split(np.concatenate([index, index[:1]]))
    fan = np.stack([np.zeros(k - 2, np.int32), np.arange(1, k - 1), np.arange(2, k)], axis=1)
    return np.concatenate([_split(index), fan[:, ::-1], fan + (n - 1) * k]).astype(np.int32)


def lofts(sections: ArrayLike, colour: ArrayLike = 0, closed: bool = False) -> PaletteMesh:
    """Solids through (c, n, k, 3) sections: c bodies of n loops of k points, in one mesh.

    The loops must be counter-clockwise seen from the last section. Fans cap the ends, so the end loops must be convex.
    `closed` joins the last loop to the first instead. colour: one, or one per body.
    """
    sections = np.asarray(sections, np.float32)
    c, n, k = sections.shape[:3]
    one = _loft_faces(n, k, closed)
    faces = (one + np.arange(0, c * n * k, n * k, dtype=np.int32)[:, None, None]).reshape(-1, 3)
    return PaletteMesh(sections.reshape(-1, 3), faces, _colours(colour, len(faces)))


def loft(sections: ArrayLike, colour: ArrayLike = 0, closed: bool = False) -> PaletteMesh:
    """The solid through (n, k, 3) sections of either orientation; see `lofts`."""
    return orient_outward(lofts(np.asarray(sections)[None], colour, closed))


def capped(rings: ArrayLike, low: ArrayLike, high: ArrayLike, colour: ArrayLike = 0) -> PaletteMesh:
    """The solid through (n, k, 3) loops, closed by fans around the points `low` and `high` ((3,)).

    The loops must be counter-clockwise seen from `high`. colour: one, or (n - 1) k for the cells and 2 k for the fans.
    """
    rings = np.asarray(rings, np.float32)
    n, k = rings.shape[:2]
    index = np.arange(n * k, dtype=np.int32).reshape(n, k)
    index = np.concatenate([index, index[:, :1]], axis=1)
    foot, top = (np.full(k, n * k + i, np.int32) for i in range(2))
    fans = [
        np.stack([foot, index[0, 1:], index[0, :-1]], axis=1),
        np.stack([top, index[-1, :-1], index[-1, 1:]], axis=1),
    ]
    cells = _split(index)
    vertices = np.concatenate([rings.reshape(-1, 3), np.array([low, high], np.float32)])
    colour = np.asarray(colour, np.uint8)
    if colour.ndim:
        colour = np.concatenate([np.repeat(colour[: (n - 1) * k], 2), colour[(n - 1) * k :]])
    return PaletteMesh(vertices, np.concatenate([cells, *fans]), _colours(colour, len(cells) + 2 * k))


def revolve(
    profile: ArrayLike, segments: int, colour: ArrayLike = 0, scale: NDArray[np.float64] | None = None
) -> PaletteMesh:
    """A solid of revolution about +Y through (k, 2) points (radius, height), closed at the axis.

    scale : (k, segments), optional
        Factors for the radius, for flutes and ribs.
    """
    profile = np.asarray(profile, np.float32)
    angle = np.linspace(0.0, 2.0 * np.pi, segments, endpoint=False)
    radius = profile[:, :1] if scale is None else profile[:, :1] * scale
    points = np.empty((len(profile), segments, 3), np.float32)
    points[..., 0], points[..., 2] = radius * cos(angle), -radius * sin(angle)
    points[..., 1] = profile[:, 1:]
    return capped(points[profile[:, 0] > 0.0], (0, profile[0, 1], 0), (0, profile[-1, 1], 0), colour)


_SIGNS = np.array(list(itertools.product((-1, 1), repeat=3)), np.int32)  # corner = 4 [x > 0] + 2 [y > 0] + [z > 0]


def _hull(polygons: list[list[int]], points: NDArray[np.float64]) -> NDArray[np.int32]:
    """Fans over planar convex polygons around the origin, oriented outward."""
    faces = []
    for p in polygons:
        normal = np.cross(points[p[1]] - points[p[0]], points[p[2]] - points[p[0]])
        p = p if dot(normal, points[p].mean(axis=0)) > 0 else p[::-1]
        faces += [(p[0], p[i], p[i + 1]) for i in range(1, len(p) - 1)]
    return np.array(faces, np.int32)


def _corner(signs: ArrayLike) -> int:
    return int((np.array(signs) > 0) @ np.array([4, 2, 1]))


def _box_faces(bevelled: bool) -> np.ndarray:
    """Faces of a box. If bevelled, corner c has three vertices 3 c + axis, each on the face of that axis."""
    per = 3 if bevelled else 1
    points = np.repeat(_SIGNS.astype(float), per, axis=0)
    if bevelled:
        points *= np.tile(0.5 + 0.5 * np.eye(3), (8, 1))
    polygons = []
    for axis, side in itertools.product(range(3), (-1, 1)):
        loop = [np.insert(uv, axis, side) for uv in ((-1, -1), (-1, 1), (1, 1), (1, -1))]
        polygons.append([per * _corner(s) + axis % per for s in loop])
    if bevelled:
        polygons += [[3 * c, 3 * c + 1, 3 * c + 2] for c in range(8)]
        for axis, sides in itertools.product(range(3), itertools.product((-1, 1), repeat=2)):
            a, b = (3 * _corner(np.insert(sides, axis, end)) for end in (-1, 1))
            i, j = (axis + 1) % 3, (axis + 2) % 3
            polygons.append([a + i, a + j, b + j, b + i])
    return _hull(polygons, points)


_BOX, _BEVELLED = _box_faces(False), _box_faces(True)


def box(size: ArrayLike, centre: ArrayLike = (0.0, 0.0, 0.0), colour: ArrayLike = 0, bevel: float = 0.0) -> PaletteMesh:
    """A box of `size` (3,) around `centre`, bevelled by `bevel` metres: 12 triangles, or 44 with bevels."""
    half = np.asarray(size, np.float64) / 2.0
    if bevel > 0.0:
        inset = half - np.minimum(bevel, 0.45 * half) * (1.0 - np.eye(3))
        vertices, faces = (_SIGNS[:, None] * inset).reshape(-1, 3), _BEVELLED
    else:
        vertices, faces = _SIGNS * half, _BOX
    return PaletteMesh((vertices + np.asarray(centre)).astype(np.float32), faces, _colours(colour, len(faces)))


def boxes(sizes: ArrayLike, centres: ArrayLike, colour: ArrayLike = 0) -> PaletteMesh:
    """Plain boxes of (k, 3) sizes around (k, 3) centres; colour: one, or one per box."""
    sizes, centres = np.broadcast_arrays(np.asarray(sizes, np.float32), np.asarray(centres, np.float32))
    vertices = _SIGNS.astype(np.float32) * (sizes[:, None] / 2) + centres[:, None]
    faces = _BOX + np.arange(0, 8 * len(sizes), 8, dtype=np.int32)[:, None, None]
    return PaletteMesh(vertices.reshape(-1, 3), faces.reshape(-1, 3), _colours(colour, 12 * len(sizes)))


def arc(centre: ArrayLike, radius: ArrayLike, start: float, end: float, n: int) -> NDArray[np.float64]:
    """(n + 1, 2) points of an arc around `centre`. Angles are in degrees; radius: one, or (2,)."""
    angle = np.radians(np.linspace(start, end, n + 1))
    points: NDArray[np.float64] = np.asarray(centre) + np.stack([cos(angle), sin(angle)], axis=1) * np.asarray(radius)
    return points


def prism(lower: ArrayLike, upper: ArrayLike, depth: float, colour: ArrayLike = 0) -> PaletteMesh:
    """The solid between two polylines (n, 2) in the x-y plane, with thickness `depth` in z around 0."""
    flat = np.stack([np.asarray(lower, np.float32), np.asarray(upper, np.float32)])
    z = np.full((*flat.shape[:2], 1), depth / 2, np.float32)
    return shell(np.concatenate([flat, z], axis=-1), np.concatenate([flat, -z], axis=-1), colour)


def frame_ring(profile: ArrayLike, half_x: float, half_z: float, colour: ArrayLike = 0) -> PaletteMesh:
    """A mitred moulding around a rectangle with a closed (k, 2) profile (outward offset, height)."""
    profile = np.asarray(profile, np.float32)
    sx, sz = np.array([1, 1, -1, -1])[:, None], np.array([1, -1, -1, 1])[:, None]
    out, y = profile[:, 0], np.broadcast_to(profile[:, 1], (4, len(profile)))
    points = np.stack([sx * (half_x + out), y, sz * (half_z + out)], axis=-1)
    return loft(points, colour, closed=True)


def tubes(paths: ArrayLike, radii: ArrayLike, sides: int, colour: ArrayLike = 0) -> PaletteMesh:
    """Closed round bars along (c, n, 3) paths with (c, n) or (n,) radii > 0."""
    paths = np.asarray(paths, np.float64)
    tangent = np.gradient(paths, axis=1)
    tangent /= np.linalg.norm(tangent, axis=-1, keepdims=True)
    overall = paths[:, -1] - paths[:, 0]
    across = np.where(np.abs(overall[:, 1:2]) > np.linalg.norm(overall, axis=1, keepdims=True) * 0.7, 0, 1)
    reference = np.stack([1.0 - across, across, across * 0.0], axis=-1)
    u = cross(reference, tangent)
    u /= np.linalg.norm(u, axis=-1, keepdims=True)
    v = cross(tangent, u)
    angle = np.linspace(0.0, 2.0 * np.pi, sides, endpoint=False)[:, None]
    ring = cos(angle) * u[:, :, None] + sin(angle) * v[:, :, None]
    return lofts(paths[:, :, None] + np.asarray(radii)[..., None, None] * ring, colour)


# --- Scene parts: meshes with transforms of their copies, cheap to count before assembly ------------------------------


class ScenePart(NamedTuple):
    """Copies of a mesh: vertices of copy i are ``matrix[i] @ vertex + offset[i]``."""

    mesh: PaletteMesh
    offset: NDArray[np.float32]  # (k, 3) float32
    matrix: NDArray[np.float32]  # (k, 3, 3) float32
    shade: NDArray[np.uint8]  # (k,) uint8, added to the palette index of every face

    @property
    def n_triangles(self) -> int:
        return len(self.offset) * len(self.mesh.faces)


def rotation_y(angle: ArrayLike) -> NDArray[np.float64]:
    """(k, 3, 3) rotations about +Y by (k,) angles in radians; 90 degrees map +Z to +X."""
    angle = np.atleast_1d(np.asarray(angle, np.float64))
    (s, c), zero, one = sin_cos(angle), np.zeros_like(angle), np.ones_like(angle)
    return np.stack([c, zero, s, zero, one, zero, -s, zero, c], axis=-1).reshape(-1, 3, 3)


def rotation_x(angle: ArrayLike) -> NDArray[np.float64]:
    """(k, 3, 3) rotations about +X by (k,) angles in radians; 90 degrees map +Y to +Z."""
    angle = np.atleast_1d(np.asarray(angle, np.float64))
    (s, c), zero, one = sin_cos(angle), np.zeros_like(angle), np.ones_like(angle)
    return np.stack([one, zero, zero, zero, c, -s, zero, s, c], axis=-1).reshape(-1, 3, 3)


def place_copies(
    mesh: PaletteMesh,
    at: ArrayLike = (0.0, 0.0, 0.0),
    turn: ArrayLike = 0.0,
    scale: ArrayLike = 1.0,
    tilt: ArrayLike | None = None,
    shade: ArrayLike = 0,
) -> ScenePart:
    """Copies of a mesh at (k, 3) positions: scaled ((k,) or (k, 3)), tilted about X, then turned about Y (radians)."""
    offset = np.atleast_2d(np.asarray(at, np.float32))
    k = len(offset)
    rotation = rotation_y(turn)
    if tilt is not None:
        rotation = product(rotation, rotation_x(tilt))
    factors = np.asarray(scale, np.float64)
    if factors.ndim == 1:
        factors = factors[:, None, None]
    elif factors.ndim == 2:
        factors = factors[:, None, :]
    matrix = np.broadcast_to((rotation * factors).astype(np.float32), (k, 3, 3))
    return ScenePart(mesh, offset, matrix, np.broadcast_to(np.asarray(shade, np.uint8), (k,)))


def move_parts(parts: Iterable[ScenePart], at: ArrayLike = (0.0, 0.0, 0.0), turn: ArrayLike = 0.0) -> list[ScenePart]:
    """The parts, rotated as a whole about Y (radians), then translated by `at` (3,)."""
    around, shift = rotation_y(turn)[0], np.asarray(at, np.float32)
    return [
        part._replace(
            offset=(product(part.offset, around.T) + shift).astype(np.float32),
            matrix=product(around, part.matrix).astype(np.float32),
        )
        for part in parts
    ]


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
        placed = vertices[v : v + k * m].reshape(k, m, 3)
        placed[:] = product(part.mesh.vertices, part.matrix.transpose(0, 2, 1)) + part.offset[:, None]
        starts = np.arange(v, v + k * m, m, dtype=np.int32)[:, None, None]
        np.add(part.mesh.faces, starts, out=faces[f : f + k * n].reshape(k, n, 3))
        np.add(part.mesh.colour, part.shade[:, None], out=colour[f : f + k * n].reshape(k, n))
        v, f = v + k * m, f + k * n
    return PaletteMesh(vertices, faces, colour)


def fitted(
    build: Callable[[float], list[ScenePart]], triangles: int, detail: float, near: float = 0.93
) -> list[ScenePart]:
    """`build(detail)` at the detail that gives just under `triangles` triangles; `detail`: the first guess.

    The number of triangles grows about linearly with the square of the detail, which is solved for by false position.
    The number grows in steps, so any from `near` * `triangles` up to `triangles` is accepted. If even the coarsest
    version has more, it is returned.
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
