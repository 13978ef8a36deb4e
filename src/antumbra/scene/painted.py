"""Meshes with materials, textures and colours of vertices, from arrays in the order of a file or a library."""

import numpy as np

from ..checks import as_array
from ..errors import InputError
from .materials import PLAIN, Material, Texture, look_of
from .meancolour import mean_colours
from .mesh import Mesh, linear_colours, used_faces


def painted(
    mesh: Mesh, faces, n_vertices: int, material: Material = PLAIN, where: str = "", uv=None, colours=None, normals=None
) -> Mesh:
    """A mesh of `make_mesh` with what its vertices show.

    faces, n_vertices : those that `make_mesh` had; it drops vertices that no face uses
    uv : (n_vertices, 2) float, texture coordinates, v down
    colours : (n_vertices, 3 or 4) float (linear) or uint8 (sRGB)
    normals : (n_vertices, 3) float

    Raises
    ------
    InputError
        If there are too few or too many rows of something.
    ValueError
        If the texture cannot be decoded.
    """
    used = None if faces is None else used_faces(np.asarray(faces), n_vertices, where)[1]
    rows = lambda values: None if values is None else np.asarray(values)[slice(None) if used is None else used]
    if colours is not None:
        colours = linear_colours(colours, where, alpha=True)
        if colours.ndim != 2 or len(colours) != n_vertices:
            raise InputError(f"{where}: vertex_colours of {n_vertices} vertices have shape {colours.shape}")
    uv, normals = _checked(uv, (n_vertices, 2), f"{where}: uv"), _checked(normals, (n_vertices, 3), f"{where}: normals")
    uv, colours = rows(uv), rows(colours)
    look = look_of(material, uv, colours, rows(normals), mesh.positions)
    return mesh._replace(colour=mean_colours(material, mesh.faces, uv, colours), look=look)


def _checked(values, shape: tuple[int, int], where: str) -> np.ndarray | None:
    if values is None:
        return None
    values = as_array(values, where)
    if values.shape != shape:
        raise InputError(f"{where} must be numbers {shape}, one row for each vertex, not {values.dtype} {values.shape}")
    return values


def picture_texture(picture, where: str) -> Texture:
    """A texture of an array (h, w, 3) or (h, w, 4) uint8, sRGB."""
    pixels = as_array(picture, f"{where}: texture")
    if pixels.dtype != np.uint8 or pixels.ndim != 3 or pixels.shape[2] not in (3, 4) or not pixels.size:
        raise InputError(f"{where}: texture must be (h, w, 3) or (h, w, 4) uint8, not {pixels.dtype} {pixels.shape}")
    opaque = np.full((*pixels.shape[:2], 1), 255, np.uint8)
    return Texture(where, np.ascontiguousarray(np.concatenate([pixels, opaque], axis=2)[..., :4]))


def upright(uv, n_vertices: int) -> np.ndarray | None:
    """Texture coordinates of trimesh and OBJ, which count v from below, as v down; None unless there are (n, 2)."""
    given = np.asarray([] if uv is None else uv)
    return np.array([0, 1]) + np.array([1, -1]) * given if given.shape == (n_vertices, 2) else None
