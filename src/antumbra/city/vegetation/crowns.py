"""Plants as closed crowns on trunks: ellipsoids or cones of few triangles, which let a share of the light pass.

A line crosses the surface of a convex crown twice or not at all. Each surface lets the square root of the crown's
share pass (`alpha_masks`), so the whole crown lets its share pass, wherever the line crosses it and however far it runs
inside. A horizontal section at the widest place of a crown has the area of the circle.
"""

from collections.abc import Generator
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...kernels.elementary import cos, sin
from ...scene.materials import Material, MeshAppearance, srgb_to_linear
from ...scene.mesh import MeshInfo, ObjectInfo, Piece, make_mesh

SHAPES = ("ellipsoid", "cone")
"""Shapes of crowns."""

TREE_TYPE = "SolitaryVegetationObject"
"""The type of plants as city objects, as in CityGML."""

CROWN, TRUNK = "crown", "trunk"
"""Names of materials."""

_GREEN = tuple(srgb_to_linear([0.45, 0.60, 0.36]).tolist())
_BROWN = tuple(srgb_to_linear([0.45, 0.36, 0.28]).tolist())
_SIDES = 8  # of the sections of a crown
_RINGS = (-0.7071067811865476, 0.0, 0.7071067811865476)  # heights of sections of a unit sphere
_TRUNK_SIDES = 6


class CrownShapes(NamedTuple):
    """The dimensions of plants above their feet, in the unit of the coordinates."""

    heights: NDArray[np.float64]  # (n,) of the tops, positive
    radii: NDArray[np.float64]  # (n,) of the crowns, positive
    clear: NDArray[np.float64]  # (n,) of the lowest parts of the crowns, at least 0, below the tops
    trunk_radii: NDArray[np.float64]  # (n,) at most those of the crowns; 0: no trunk
    shares: NDArray[np.float64]  # (n, 12, 3) in [0, 1]: red, green and blue light that a crown lets pass in each month
    shape: str  # one of `SHAPES`


class _Body(NamedTuple):
    """A closed convex body around the z axis, with a radius of 1, from z = 0 to 1, and outward normals."""

    vertices: NDArray[np.float64]  # (v, 3)
    faces: NDArray[np.int64]  # (f, 3)


def _circle(sides: int) -> NDArray[np.float64]:
    """(sides, 2) float64: corners of a regular polygon with the area of the unit circle."""
    angles = 2.0 * np.pi * np.arange(sides) / sides
    radius = np.sqrt(2.0 * np.pi / (sides * sin(2.0 * np.pi / sides)))
    return np.asarray(radius * np.stack([cos(angles), sin(angles)], 1))


def _stacked(heights: list[float], widths: list[float], sides: int) -> _Body:
    """A body of polygons at heights; a width of 0 at either end is a single vertex, others are closed by a fan."""
    vertices, rings = list[np.ndarray](), list[np.ndarray]()
    for height, width in zip(heights, widths):
        ring = width * _circle(sides) if width else np.zeros((1, 2))
        rings.append(np.arange(len(ring)) + sum(map(len, vertices)))
        vertices.append(np.column_stack([ring, np.full(len(ring), height)]))
    faces = [_fan(rings[0])[:, ::-1], _fan(rings[-1])]
    for low, high in pairwise(rings):
        this, after = np.arange(sides), (np.arange(sides) + 1) % sides
        if len(low) > 1:
            faces.append(np.stack([low[this], low[after], high[after % len(high)]], 1))
        if len(high) > 1:
            faces.append(np.stack([low[this % len(low)], high[after], high[this]], 1))
    return _Body(np.concatenate(vertices), np.concatenate(faces))


def _fan(ring: np.ndarray) -> np.ndarray:
    """(k - 2, 3): triangles of a convex polygon, counter-clockwise; none for a single vertex."""
    return np.stack([np.full(max(len(ring) - 2, 0), ring[0]), ring[1:-1], ring[2:]], 1)


def _crown(shape: str) -> _Body:
    if shape == "cone":
        return _stacked([0.0, 1.0], [1.0, 0.0], _SIDES)
    heights = [0.0, *((1.0 + z) / 2.0 for z in _RINGS), 1.0]
    return _stacked(heights, [0.0, *(float(np.sqrt(1.0 - z * z)) for z in _RINGS), 0.0], _SIDES)


class CrownMeshes:
    """The source of plants: one object each, all in one piece, plant after plant, each a crown and then a trunk."""

    duration = 0.0

    def __init__(self, feet: NDArray[np.float64], shapes: CrownShapes, ids: list[str], file: str, up: str):
        """`feet`: (n, 3) float64, world."""
        trunk = _stacked([0.0, 1.0], [1.0, 1.0], _TRUNK_SIDES)
        widths, tops = shapes.trunk_radii, (shapes.clear + shapes.heights) / 2.0  # trunks end inside their crowns
        crowns = _placed(_crown(shapes.shape), shapes.radii, shapes.clear, shapes.heights)
        trunks = _placed(trunk, widths, np.zeros(len(tops)), tops)
        materials, crown_material = _materials(shapes.shares)
        faces, owner, material = _interleaved(crowns[1], trunks[1] + crowns[0].size // 3, widths > 0.0, crown_material)
        vertices = np.concatenate([each.reshape(-1, 3) for each in (crowns[0], trunks[0])])
        if up == "y":
            vertices = vertices[:, [0, 2, 1]] * [1.0, 1.0, -1.0]
        vertices += np.concatenate([np.repeat(feet, each[0].shape[1], 0) for each in (crowns, trunks)])
        colours = np.array([each.factor[:3] for each in materials], np.float32)[material]
        self._mesh = make_mesh("trees", vertices, faces, colours, file)
        self._look, self._owners = MeshAppearance(tuple(materials), material_of_face=material), owner
        counts = np.bincount(owner, minlength=len(ids)).tolist()
        self.file, self.meshes = file, [MeshInfo(name, n, 1) for name, n in zip(ids, counts)]
        self.objects = [ObjectInfo(name, k, 0, TREE_TYPE) for k, name in enumerate(ids)]

    def pieces(self, time: float) -> Generator[Piece, None, None]:
        mesh = self._mesh
        yield Piece(
            mesh.positions[None], mesh.faces, mesh.colour, self.file, owners=self._owners, look=self._look,
            used=mesh.used,
        )  # fmt: skip

    def cameras(self, time: float) -> list[object]:
        return []

    def lights(self, time: float) -> list[object]:
        return []


def _placed(
    body: _Body, radii: np.ndarray, lower: np.ndarray, upper: np.ndarray
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """(n, v, 3) float64 vertices of a body for each plant, above its foot, z up; and (n, f, 3) faces."""
    vertices = body.vertices * radii[:, None, None]
    vertices[..., 2] = lower[:, None] + body.vertices[:, 2] * (upper - lower)[:, None]
    return vertices, body.faces + (np.arange(len(radii)) * len(body.vertices))[:, None, None]


def _materials(shares: np.ndarray) -> tuple[list[Material], NDArray[np.int32]]:
    """A material for trunks, then one for each transmittance of crowns; and the material of each crown."""
    unique, index = np.unique(shares.reshape(len(shares), -1), axis=0, return_inverse=True)
    materials = [Material(TRUNK, (*_BROWN, 1.0))]
    for months in unique.reshape(-1, *shares.shape[1:]).tolist():
        colours = [tuple(month) for month in months]
        same = all(each == colours[0] for each in colours)
        share = (colours[0],) if same else tuple(colours)
        materials.append(Material(CROWN, (*_GREEN, 1.0), transmittance=share, closed=True))
    return materials, (1 + index.reshape(-1)).astype(np.int32)


def _interleaved(
    crowns: np.ndarray, trunks: np.ndarray, has_trunk: np.ndarray, crown_material: np.ndarray
) -> tuple[NDArray[np.int64], NDArray[np.int32], NDArray[np.int32]]:
    """(f, 3) faces in the order of the plants; the plant, and the material, of each."""
    n, faces = len(crowns), np.concatenate([crowns, trunks], 1)
    tree = np.repeat(np.arange(n, dtype=np.int32), faces.shape[1]).reshape(n, -1)
    of_crown = np.arange(faces.shape[1]) < crowns.shape[1]
    material = np.where(of_crown, crown_material[:, None], 0).astype(np.int32)
    there = of_crown | has_trunk[:, None]
    return faces[there], tree[there], material[there]
