"""The appearance of a scene: textures, vertex colours and shading normals, per face corner.

Shading normals are stored relative to their triangles (`normals_in_frames`), so that animation moves them along.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from fnmatch import fnmatchcase
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..base.pickles import without_cached
from ..kernels.small_matrices import determinant, inverse, product
from .materials import (
    PLAIN,
    LightShare,
    Material,
    MeshAppearance,
    PbrParameters,
    Texture,
    TextureMap,
    pbr_of,
)
from .mesh import Piece, Source
from .scene_bounds import faces_of
from .tangents import add_tangents, corner_tangents

SHARPEST = 0.35
"""About the sine of 20 degrees: faces that bend more form a visible edge."""

_FLAT = 1e-12  # a matrix counts as singular if its determinant is below this times its norm cubed


@dataclass(frozen=True, eq=False)
class Appearance:
    """Materials and corner attributes of the faces of a scene, beyond one colour per face; constant over time."""

    materials: list[Material]
    material_of_face: NDArray[np.int32]  # (n,) int32: index in `materials`; -1: the face has a plain colour
    uv: NDArray[np.float32] | None  # (n, 3, 2) float32: texture coordinates of corners; 0 without a texture
    colours: NDArray[np.float32] | None  # (n, 3, 4) float32: linear colour and alpha of corners; 1 where there is none
    normals: NDArray[np.float32] | None  # (n, 3, 3) float32: corner normals, `normals_in_frames`; 0 where there is none
    bends: NDArray[np.float32] | None  # (n, 3) float32: sine of the angle from normals to faces, see `_widen`
    textured: NDArray[np.bool_]  # (n,) bool: whether the face shows a texture
    mapped: NDArray[np.bool_] | None = None  # (n,) bool: whether it has texture coordinates; None: as `textured`
    tangents: NDArray[np.float32] | None = None  # (n, 3, 3) float32: of corners, as `normals`, for normal maps
    hands: NDArray[np.float32] | None = None  # (n,) float32: +-1, the handedness of `tangents`; 0 where there is none
    second_uv: NDArray[np.float32] | None = None  # (n, 3, 2) float32: coordinates of maps with a set of their own

    def __getstate__(self) -> dict[str, Any]:
        return without_cached(self)

    @cached_property
    def pbr(self) -> list[PbrParameters] | None:
        """The parameters of each material; None if all surfaces are diffuse."""
        parameters = [pbr_of(material) for material in self.materials]
        return None if all(each.is_plain for each in parameters) else parameters

    @property
    def textures(self) -> list[Texture]:
        """The textures of all materials, each once."""
        return list(dict.fromkeys(m.texture for m in self.materials if m.texture is not None))

    def has_material(self, pattern: str) -> NDArray[np.bool_]:
        """(n,) bool: the faces whose material has a name that matches, as file names do."""
        chosen = [k for k, material in enumerate(self.materials) if fnmatchcase(material.name, pattern)]
        return np.isin(self.material_of_face, chosen)

    def with_transmittance(self, faces: NDArray[np.bool_], transmittance: tuple[LightShare, ...]) -> "Appearance":
        """The appearance with copies of the materials of some faces, which let light pass: one share, or twelve."""
        materials, material_of_face = list(self.materials), self.material_of_face.copy()
        for k in np.unique(self.material_of_face[faces]):
            material = self.materials[k] if k >= 0 else PLAIN
            material_of_face[faces & (self.material_of_face == k)] = len(materials)
            materials.append(material._replace(transmittance=transmittance))
        return replace(self, materials=materials, material_of_face=material_of_face)


class VertexShading(NamedTuple):
    """What the faces around the vertices of a mesh decide; of a part of its faces, what all of them decide."""

    widest: NDArray[np.float64]  # (v,): sines of angles, see `_widen`
    tangents: NDArray[np.float64]  # (2 v, 3): `tangents.add_tangents`


class _MeshFaces(NamedTuple):
    """The faces of all copies of a mesh."""

    look: MeshAppearance
    faces: np.ndarray  # (f, 3) int
    first: int  # index of its first face in the scene
    copies: int
    linear: NDArray[np.float64] | None  # (k, 3, 3) float64
    shading: VertexShading | None = None  # of the only copy; None: these are all faces

    @property
    def rows(self) -> slice:
        return slice(self.first, self.first + self.copies * len(self.faces))


def plain_appearance(n: int) -> Appearance:
    """The appearance of n faces with plain colours."""
    return Appearance([], np.full(n, -1, np.int32), None, None, None, None, np.zeros(n, np.bool_))


def appearance_of(source: Source, n: int, plain: bool = False) -> Appearance | None:
    """The appearance of the n faces of a source; None if every face has a plain colour.

    plain : whether names of materials are wanted even then
    """
    parts = list(_parts(source))
    if not parts or (not plain and all(part.look.is_plain for part in parts)):
        return None
    return _with_normals(parts, n)


def appearance_of_piece(piece: Piece, shading: VertexShading | None = None) -> Appearance | None:
    """The appearance of the faces of all copies in a piece; None if the mesh has no look.

    shading : what all faces of the mesh decide, if the piece has some of them
    """
    part = _mesh_faces(piece, 0)
    if part is None:
        return None
    return _with_normals([part._replace(shading=shading)], faces_of(piece) * len(piece.vertices))


def add_shading(piece: Piece, shading: VertexShading) -> None:
    """Add the faces of a piece, in order, to what those before them decide, in place. It has one copy, and normals."""
    part = _mesh_faces(piece, 0)
    assert part is not None
    corners, normals = _turned(part)
    _widen(shading.widest, corners, normals, part.faces)
    if part.look.uv is not None and any(map(_bump_of, part.look.materials)):
        assert part.look.rest_positions is not None
        add_tangents(shading.tangents, part.look.rest_positions, part.faces, _bump_uv(part)[0])


def _with_normals(parts: "list[_MeshFaces]", n: int) -> Appearance:
    (normals, bends), (tangents, hands) = _normals(parts, n), _tangents(parts, n)
    return replace(_without_normals(parts, n), normals=normals, bends=bends, tangents=tangents, hands=hands)


def appearance_of_mesh(look: MeshAppearance, faces: NDArray[np.integer]) -> Appearance:
    """The appearance of the (f, 3) faces of a mesh, without normals."""
    return _without_normals([_MeshFaces(look, faces, 0, 1, None)], len(faces))


def _without_normals(parts: "list[_MeshFaces]", n: int) -> Appearance:
    looks = {id(part.look): part.look for part in parts}
    materials = list(dict.fromkeys(material for look in looks.values() for material in look.materials))
    number = {material: i for i, material in enumerate(materials)}
    numbers = {key: np.array([number[m] for m in look.materials] + [-1], np.int32) for key, look in looks.items()}
    material_of_face, mapped = np.full(n, -1, np.int32), np.zeros(n, bool)
    for part in parts:
        look, of_copies = part.look, (part.copies, len(part.faces))
        of_face = 0 if look.material_of_face is None else look.material_of_face  # -1 selects the last entry, also -1
        material_of_face[part.rows].reshape(of_copies)[:] = numbers[id(look)][of_face]
        mapped[part.rows].reshape(of_copies)[:] = look.uv is not None if look.textured is None else look.textured
    uv = _corners(parts, "uv", np.zeros((n, 3, 2), np.float32))
    colours = _corners(parts, "colours", np.ones((n, 3, 4), np.float32))
    second_uv = _corners(parts, "second_uv", np.zeros((n, 3, 2), np.float32))
    textured = textured_faces(materials, material_of_face, mapped)
    return Appearance(materials, material_of_face, uv, colours, None, None, textured, mapped, second_uv=second_uv)


def textured_faces(
    materials: list[Material], material_of_face: NDArray[np.int32], mapped: NDArray[np.bool_]
) -> NDArray[np.bool_]:
    """(n,) bool: `Appearance.textured`, from `Appearance.mapped`."""
    if any(material.has_maps and material.texture is None for material in materials):
        has_texture = np.array([m.texture is not None for m in materials] + [False])
        return np.asarray(mapped & has_texture[material_of_face])
    return mapped


def _parts(source: Source) -> Iterator[_MeshFaces]:
    first = 0
    for piece in source.pieces(0.0):
        if (part := _mesh_faces(piece, first)) is not None:
            yield part
        first += faces_of(piece) * len(piece.vertices)


def _mesh_faces(piece: Piece, first: int) -> _MeshFaces | None:
    """The faces of a piece, whose first one has the number `first`; None if it has no look."""
    count = faces_of(piece)
    if piece.look is None or not count:
        return None
    faces = np.arange(3 * count).reshape(-1, 3) if piece.faces is None else piece.faces
    return _MeshFaces(piece.look, faces, first, len(piece.vertices), piece.linear)


def _corners(parts: list[_MeshFaces], name: str, out: np.ndarray) -> np.ndarray | None:
    """`out`, with a vertex attribute written to the corners of faces; None if no part has it."""
    attributes = [(part, values) for part in parts if (values := getattr(part.look, name)) is not None]
    for part, values in attributes:
        out[part.rows].reshape(part.copies, *part.faces.shape, -1)[:] = values[part.faces]
    return out if attributes else None


def _normals(parts: list[_MeshFaces], n: int) -> tuple[np.ndarray | None, np.ndarray | None]:
    """`Appearance.normals` and `Appearance.bends`."""
    shaded = [part for part in parts if part.look.normals is not None]
    if not shaded:
        return None, None
    out, bends = np.zeros((n, 3, 3), np.float32), np.zeros((n, 3), np.float32)
    for part in shaded:
        corners, turned = _turned(part)
        out[part.rows] = normals_in_frames(corners, turned)
        assert part.look.normals is not None
        n_vertices = len(part.look.normals)
        vertices = (part.faces + n_vertices * np.arange(part.copies)[:, None, None]).reshape(-1, 3)
        if part.shading is None:
            _widen(widest := np.zeros(part.copies * n_vertices), corners, turned, vertices)
        else:
            widest = part.shading.widest
        bends[part.rows] = widest[vertices]
    return out, bends


def _turned(part: _MeshFaces) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """The corners and the shading normals of the faces of all copies, (k f, 3, 3) float64 each, at rest."""
    normals, rest_positions = part.look.normals, part.look.rest_positions
    assert normals is not None and rest_positions is not None
    linear = _invertible(part)
    corners = product(rest_positions, linear.transpose(0, 2, 1))
    turned = product(normals, inverse(linear))  # by the inverse transpose
    corners, turned = (each[:, part.faces].reshape(-1, 3, 3) for each in (corners, turned))
    return corners, turned


def _invertible(part: _MeshFaces) -> NDArray[np.float64]:
    """(k, 3, 3) float64: the linear parts of the transforms of copies; the identity where they are singular."""
    linear = np.eye(3)[None].repeat(part.copies, 0) if part.linear is None else part.linear
    singular = np.abs(determinant(linear)) < _FLAT * np.linalg.norm(linear, axis=(1, 2)) ** 3
    return np.where(singular[:, None, None], np.eye(3), linear)  # scaled to zero at rest: use object space


def _tangents(parts: list[_MeshFaces], n: int) -> tuple[np.ndarray | None, np.ndarray | None]:
    """`Appearance.tangents` and `Appearance.hands`. Those of mirrored copies are turned, as are their triangles."""
    bumpy = [part for part in parts if part.look.uv is not None and any(map(_bump_of, part.look.materials))]
    if not bumpy:
        return None, None
    out, hands = np.zeros((n, 3, 3), np.float32), np.zeros(n, np.float32)
    for part in bumpy:
        look, faces, positions = part.look, part.faces, part.look.rest_positions
        assert positions is not None
        uv, has_bump = _bump_uv(part)
        sums = None if part.shading is None else part.shading.tangents
        tangents = corner_tangents(positions, faces, uv, look.normals, look.tangents, sums)
        linear = _invertible(part)
        corners = product(positions, linear.transpose(0, 2, 1))[:, faces].reshape(-1, 3, 3)
        mirrored = np.sign(determinant(linear))[:, None, None]
        turned = product(tangents[..., :3].reshape(-1, 3), linear.transpose(0, 2, 1)) * mirrored
        out[part.rows] = normals_in_frames(corners, turned.reshape(-1, 3, 3))
        hands[part.rows] = np.tile(np.where(has_bump, np.sign(tangents[:, 0, 3]), 0.0), part.copies)
    return out, hands


def _bump_uv(part: _MeshFaces) -> tuple[np.ndarray, NDArray[np.bool_]]:
    """(f, 3, 2): the coordinates of corners in normal maps; (f,) bool: which faces have one."""
    look, faces = part.look, part.faces
    assert look.uv is not None
    uv, has_bump = look.uv[faces], np.zeros(len(faces), bool)
    for k, material in enumerate(look.materials):
        if (bump := _bump_of(material)) is not None:
            rows = np.ones(len(faces), bool) if look.material_of_face is None else look.material_of_face == k
            uv[rows], has_bump = bump.transformed(uv[rows]), has_bump | rows
    return uv, has_bump


def _bump_of(material: Material) -> TextureMap | None:
    return pbr_of(material).normal_map


def _widen(widest: NDArray[np.float64], corners: np.ndarray, normals: np.ndarray, vertices: np.ndarray) -> None:
    """Raise the sines at vertices of faces: of the largest angle between its shading normals and normals of its faces.

    A light elevated by less than this angle above the horizon of the shading normal is below the horizon of some of
    these faces. `picture.irradiance` cuts the light off at this angle on all of them alike, at most at `SHARPEST`.
    """
    across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    sine = np.linalg.norm(np.cross(normals, across[:, None]), axis=-1)
    sine /= np.maximum(np.linalg.norm(normals, axis=-1) * np.linalg.norm(across, axis=-1)[:, None], 1e-300)
    np.maximum.at(widest, vertices.reshape(-1), np.minimum(sine, SHARPEST).reshape(-1))


def normals_in_frames(corners: NDArray[np.float64], normals: NDArray[np.float64]) -> NDArray[np.float32]:
    """(f, 3, 3) float32: corner normals relative to their triangles, so that they move with them.

    corners, normals : (f, 3, 3) float64

    A normal n of a triangle with edges e1, e2 and unit normal g is stored as (n . e1, n . e2, n . g |e1 x e2|^(1/2)).
    These numbers are invariant under rotation, translation and scaling of the triangle. Under any affine map within the
    triangle's plane, they transform as normals do under the inverse transpose. `picture.pixel_appearance` can therefore
    reconstruct n in the moved triangle, and animations, skins and morph targets move normals with their triangles.
    """
    length = np.linalg.norm(normals, axis=-1, keepdims=True)
    normals = normals / np.where(length > 0.0, length, 1.0)
    e1, e2 = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    across = np.cross(e1, e2)
    area = np.linalg.norm(across, axis=1)
    upright = across / np.sqrt(np.where(area > 0.0, area, 1.0))[:, None]  # g |e1 x e2|^(1/2)
    out: NDArray[np.float32] = product(normals, np.stack([e1, e2, upright], 2)).astype(np.float32)
    return out


def normals_from_frames(corners: NDArray[np.float64], frames: NDArray[np.floating]) -> NDArray[np.float64]:
    """(f, 3, 3) float64: unit corner normals of triangles, the inverse of `normals_in_frames`.

    They are 0 where the frame is 0, and in triangles without area.

    corners, frames : (f, 3, 3)
    """
    e1, e2 = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    across = np.cross(e1, e2)
    squared = (across * across).sum(1)[:, None]
    safe = np.where(squared > 0.0, squared, 1.0)
    area = np.sqrt(safe)
    # the dual basis of e1, e2 and the scaled normal
    basis = np.stack([np.cross(e2, across) / safe, np.cross(across, e1) / safe, across / (area * np.sqrt(area))], 1)
    normals = product(frames.astype(np.float64), basis)
    length = np.linalg.norm(normals, axis=-1, keepdims=True)
    return np.asarray(normals / np.where(length > 0.0, length, 1.0))
