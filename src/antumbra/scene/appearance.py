"""The appearance of a scene: textures, colours of vertices and shading normals of all faces, corner by corner."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from .materials import Look, Material, Texture
from .mesh import Source
from .scene_bounds import faces_of

SHARPEST = 0.35
"""Sine of 20 degrees: faces that bend more make an edge that stays visible."""

_FLAT = 1e-12  # a matrix whose determinant is less, in cubes of its size, has no inverse


@dataclass(frozen=True, eq=False)
class Appearance:
    """What the faces of a scene show beyond one colour for each. It is the same at every time."""

    materials: list[Material]
    material_of_face: np.ndarray  # (n,) int32: index in `materials`; -1: the face has its colour and no more
    uv: np.ndarray | None  # (n, 3, 2) float32: texture coordinates of corners; 0 without a texture
    colours: np.ndarray | None  # (n, 3, 4) float32: linear colour and alpha of corners; 1 where a mesh has none
    normals: np.ndarray | None  # (n, 3, 3) float32: normals of corners, see `in_frames`; 0 where a mesh has none
    bends: np.ndarray | None  # (n, 3) float32: how far faces bend away from these normals, see `_bends`
    textured: np.ndarray  # (n,) bool: whether the face shows a texture

    @property
    def textures(self) -> list[Texture]:
        """The textures of all materials, each once."""
        return list(dict.fromkeys(m.texture for m in self.materials if m.texture is not None))


class _MeshFaces(NamedTuple):
    """The faces of the copies of a mesh."""

    look: Look
    faces: np.ndarray  # (f, 3) int
    first: int  # of the faces of the scene
    copies: int
    linear: np.ndarray | None  # (k, 3, 3) float64

    @property
    def rows(self) -> slice:
        return slice(self.first, self.first + self.copies * len(self.faces))


def appearance_of(source: Source, n: int) -> Appearance | None:
    """The appearance of the n faces of a source; None if each has one colour and no more."""
    parts = list(_parts(source))
    if not parts:
        return None
    looks = {id(part.look): part.look for part in parts}
    materials = list(dict.fromkeys(material for look in looks.values() for material in look.materials))
    number = {material: i for i, material in enumerate(materials)}
    numbers = {key: np.array([number[m] for m in look.materials] + [-1], np.int32) for key, look in looks.items()}
    material_of_face, textured = np.full(n, -1, np.int32), np.zeros(n, bool)
    for part in parts:
        look, of_copies = part.look, (part.copies, len(part.faces))
        of_face = 0 if look.material_of_face is None else look.material_of_face  # -1 is the last of the numbers
        material_of_face[part.rows].reshape(of_copies)[:] = numbers[id(look)][of_face]
        textured[part.rows].reshape(of_copies)[:] = look.uv is not None if look.textured is None else look.textured
    uv = _corners(parts, "uv", np.zeros((n, 3, 2), np.float32))
    colours = _corners(parts, "colours", np.ones((n, 3, 4), np.float32))
    return Appearance(materials, material_of_face, uv, colours, *_normals(parts, n), textured)


def _parts(source: Source) -> Iterator[_MeshFaces]:
    first = 0
    for piece in source.pieces(0.0):
        count, copies = faces_of(piece), len(piece.vertices)
        if piece.look is not None and count:
            faces = np.arange(3 * count).reshape(-1, 3) if piece.faces is None else piece.faces
            yield _MeshFaces(piece.look, faces, first, copies, piece.linear)
        first += count * copies


def _corners(parts: list[_MeshFaces], name: str, out: np.ndarray) -> np.ndarray | None:
    """`out`, with an attribute of vertices written to the corners of faces; None if no part has it."""
    given = [(part, values) for part in parts if (values := getattr(part.look, name)) is not None]
    for part, values in given:
        out[part.rows].reshape(part.copies, *part.faces.shape, -1)[:] = values[part.faces]
    return out if given else None


def _normals(parts: list[_MeshFaces], n: int) -> tuple[np.ndarray | None, np.ndarray | None]:
    """`Appearance.normals` and `Appearance.bends`."""
    given = [part for part in parts if part.look.normals is not None]
    if not given:
        return None, None
    out, bends = np.zeros((n, 3, 3), np.float32), np.zeros((n, 3), np.float32)
    for part in given:
        normals, rest = part.look.normals, part.look.rest
        assert normals is not None and rest is not None
        linear = np.eye(3)[None].repeat(part.copies, 0) if part.linear is None else part.linear
        flat = np.abs(np.linalg.det(linear)) < _FLAT * np.linalg.norm(linear, axis=(1, 2)) ** 3
        linear = np.where(flat[:, None, None], np.eye(3), linear)  # scaled to nothing at rest: the file's frame will do
        corners = rest.astype(np.float64) @ linear.transpose(0, 2, 1)
        turned = normals.astype(np.float64) @ np.linalg.inv(linear)  # by the inverse transpose
        corners, turned = (each[:, part.faces].reshape(-1, 3, 3) for each in (corners, turned))
        out[part.rows] = normals_in_frames(corners, turned)
        vertices = part.faces + len(rest) * np.arange(part.copies)[:, None, None]
        bends[part.rows] = _bends(corners, turned, vertices.reshape(-1, 3), part.copies * len(rest))
    return out, bends


def _bends(corners: np.ndarray, normals: np.ndarray, vertices: np.ndarray, n_vertices: int) -> np.ndarray:
    """(f, 3) float64: sine of the widest angle between the normal of a corner and the faces around its vertex.

    A light that is less than this angle above the horizon of the normal is below that of some of these faces.
    `picture.irradiance` ends the light there, on all of them alike, at most at `SHARPEST`.
    """
    across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    sine = np.linalg.norm(np.cross(normals, across[:, None]), axis=-1)
    sine /= np.maximum(np.linalg.norm(normals, axis=-1) * np.linalg.norm(across, axis=-1)[:, None], 1e-300)
    widest = np.zeros(n_vertices)
    np.maximum.at(widest, vertices.reshape(-1), np.minimum(sine, SHARPEST).reshape(-1))
    return widest[vertices]


def normals_in_frames(corners: np.ndarray, normals: np.ndarray) -> np.ndarray:
    """(f, 3, 3) float32: normals of corners, relative to their triangles, so that they move with them.

    corners, normals : (f, 3, 3) float64

    A normal n of a triangle with edges e1, e2 and unit normal g is kept as (n . e1, n . e2, n . g |e1 x e2|^(1/2)). A
    rotation, a translation or a scale of the triangle does not change these numbers. In its own plane, any affine
    map transforms them as the inverse transpose transforms normals. So `picture.pixel_appearance` finds n again in the
    moved triangle, and animations, skins and morph targets move normals with their triangles.
    """
    length = np.linalg.norm(normals, axis=-1, keepdims=True)
    normals = normals / np.where(length > 0.0, length, 1.0)
    e1, e2 = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    across = np.cross(e1, e2)
    area = np.linalg.norm(across, axis=1)
    upright = across / np.sqrt(np.where(area > 0.0, area, 1.0))[:, None]  # g |e1 x e2|^(1/2)
    return np.einsum("fci,fki->fck", normals, np.stack([e1, e2, upright], 1)).astype(np.float32)
