"""Meshes with materials, textures and colours of vertices, from arrays in the order of a file or a library."""

import numpy as np

from ..errors import InputError
from .materials import PLAIN, Material, look_of
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
        If there are too few or too many colours.
    ValueError
        If the texture cannot be decoded.
    """
    used = None if faces is None else used_faces(np.asarray(faces), n_vertices, where)[1]
    rows = lambda values: None if values is None else np.asarray(values)[slice(None) if used is None else used]
    if colours is not None:
        colours = linear_colours(colours, where, alpha=True)
        if colours.ndim != 2 or len(colours) != n_vertices:
            raise InputError(f"{where}: vertex_colours of {n_vertices} vertices have shape {colours.shape}")
    uv, colours = rows(uv), rows(colours)
    look = look_of(material, uv, colours, rows(normals), mesh.positions)
    return mesh._replace(colour=mean_colours(material, mesh.faces, uv, colours), look=look)
