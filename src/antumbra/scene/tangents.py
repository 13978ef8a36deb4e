"""Tangents of normal maps, given by a file or derived from texture coordinates, at the corners of faces."""

import numpy as np
from numpy.typing import NDArray

from ..kernels.small_matrices import dot


def corner_tangents(
    positions: NDArray[np.floating],
    faces: NDArray[np.integer],
    uv: NDArray[np.floating],
    normals: NDArray[np.floating] | None = None,
    given: NDArray[np.floating] | None = None,
    sums: NDArray[np.float64] | None = None,
) -> NDArray[np.float64]:
    """(f, 3, 4) float64: the tangent of each corner, along which u grows, and its handedness; 0 where there is none.

    The bitangent, along which v decreases, is the handedness times normal x tangent, as in glTF. Where no tangent is
    given, it is the mean of the faces around the vertex, weighted by their angles, as in MikkTSpace; faces whose
    texture is mirrored do not count among those whose texture is not.

    positions : (v, 3)
    faces : (f, 3)
    uv : (f, 3, 2), coordinates of the corners in the normal map
    normals : (v, 3); None: those of the faces
    given : (v, 4), of glTF; rows of zeros are derived
    sums : (2 v, 3): those of `add_tangents` over all faces, if these are some of them; None: they are all
    """
    of_faces, sign = _face_tangents(positions[faces].astype(np.float64), uv.astype(np.float64))
    if normals is None:  # each face is flat
        tangents = np.repeat(of_faces[:, None], 3, 1)
    else:
        if sums is None:
            add_tangents(sums := np.zeros((2 * len(positions), 3)), positions, faces, uv)
        tangents = sums[_places(faces, sign, len(positions))]
        around = normals[faces].astype(np.float64)
        tangents = tangents - around * dot(tangents, around)[..., None]
    out = np.concatenate([_unit(tangents), np.broadcast_to(sign[:, None, None], (*faces.shape, 1))], -1)
    if given is not None:
        of_corners = given[faces].astype(np.float64)
        out = np.where(of_corners[..., :3].any(-1, keepdims=True), of_corners, out)
    return out


def add_tangents(
    sums: NDArray[np.float64], positions: NDArray[np.floating], faces: NDArray[np.integer], uv: NDArray[np.floating]
) -> None:
    """Add the tangents of faces, in their order, to the sums of their vertices, (2 v, 3); mirrored faces come last."""
    corners = positions[faces].astype(np.float64)
    of_faces, sign = _face_tangents(corners, uv.astype(np.float64))
    weighted = of_faces[:, None] * _angles(corners)[..., None]
    np.add.at(sums, _places(faces, sign, len(positions)).reshape(-1), weighted.reshape(-1, 3))


def _places(faces: NDArray[np.integer], sign: NDArray[np.float64], n: int) -> NDArray[np.integer]:
    """(f, 3): the rows of sums for corners: mirrored and other faces apart."""
    return np.asarray(faces + n * (sign < 0.0)[:, None])


def _face_tangents(corners: NDArray[np.float64], uv: NDArray[np.float64]) -> tuple[np.ndarray, np.ndarray]:
    """The unit direction of growing u on each face, (f, 3), and the handedness, (f,); 0 without area."""
    (e1, e2), (d1, d2) = np.moveaxis(corners[:, 1:] - corners[:, :1], 1, 0), np.moveaxis(uv[:, 1:] - uv[:, :1], 1, 0)
    area = d1[:, 0] * d2[:, 1] - d1[:, 1] * d2[:, 0]
    along = _unit((e1 * d2[:, 1:] - e2 * d1[:, 1:]) * np.sign(area)[:, None])
    return along, -np.sign(area)  # v points down in the texture


def _angles(corners: NDArray[np.float64]) -> NDArray[np.float64]:
    """(f, 3) float64: about the angles of triangles at their corners, in radians."""
    ahead = _unit(np.roll(corners, -1, 1) - corners)
    behind = -np.roll(ahead, 1, 1)
    half = np.linalg.norm(ahead - behind, axis=-1) / 2.0  # sine of half the angle
    return np.asarray(2.0 * half)


def _unit(vectors: NDArray[np.float64]) -> NDArray[np.float64]:
    length = np.linalg.norm(vectors, axis=-1, keepdims=True)
    return np.asarray(vectors / np.where(length > 0.0, length, 1.0))
