"""The mean colour of each face: of its material, its vertices, and the part of a texture that it shows.

Whatever needs one colour for a face uses it: bounced light, stores, baking and jobs.
"""

import numpy as np

from .materials import CLAMP, MIRROR, Material, Texture

_POINTS = np.array([[2, 1, 1], [1, 2, 1], [1, 1, 2], [4 / 3, 4 / 3, 4 / 3]]) / 4.0
"""Barycentric coordinates of the points that stand for a face: of its four similar parts, the centres."""


def mean_colours(material: Material, faces: np.ndarray | None, uv=None, colours=None) -> np.ndarray:
    """(3,) or (f, 3) float32, linear, in [0, 1]: the base colour of a mesh or of each of its faces.

    faces : (f, 3) int; None: every three vertices are a face
    uv : (v, 2) float; None: a texture counts as a whole
    colours : (v, 3 or 4) float, linear

    Raises ValueError if the texture cannot be decoded.
    """
    colour: np.ndarray = np.array(material.factor[:3], np.float64)
    if material.texture is not None:
        texture = material.texture
        colour = colour * (texture.glance[-1][0, 0, :3] if uv is None else texture_means(texture, _corners(uv, faces)))
    if colours is not None:
        colour = colour * _corners(np.nan_to_num(np.asarray(colours)[:, :3]), faces).mean(axis=1, dtype=np.float64)
    return np.clip(colour, 0.0, 1.0).astype(np.float32)


def _corners(values: np.ndarray, faces: np.ndarray | None) -> np.ndarray:
    """(f, 3, k): the values of vertices at the corners of faces."""
    return values.reshape(-1, 3, values.shape[1]) if faces is None else values[faces]


def texture_means(texture: Texture, uv: np.ndarray) -> np.ndarray:
    """(f, 3) float32: the mean linear colour that faces show of a texture.

    uv : (f, 3, 2) float, texture coordinates of their corners

    Four texels stand for a face. They are of the mip level whose texels are about as large as a quarter of the face.
    """
    levels, uv = texture.glance, np.nan_to_num(np.asarray(uv, np.float64))
    edges = (uv[:, 1:] - uv[:, :1]) * levels[0].shape[1::-1]
    texels = np.abs(edges[:, 0, 0] * edges[:, 1, 1] - edges[:, 0, 1] * edges[:, 1, 0]) / 8.0
    level = np.clip(np.rint(0.5 * np.log2(np.maximum(texels, 1.0))), 0, len(levels) - 1).astype(np.int64)
    out = np.empty((len(uv), 3), np.float32)
    for k in np.unique(level):
        own, pixels = level == k, levels[k]
        points = np.einsum("pc,fcx->pfx", _POINTS, uv[own])
        x = _texel(points[..., 0], pixels.shape[1], texture.wrap_s)
        y = _texel(points[..., 1], pixels.shape[0], texture.wrap_t)
        out[own] = pixels[y, x, :3].mean(0)
    return out


def _texel(at: np.ndarray, n: int, wrap: int) -> np.ndarray:
    """Whole numbers below n: the texels at texture coordinates along one axis."""
    if wrap == CLAMP:
        at = np.clip(at, 0.0, 1.0)
    elif wrap == MIRROR:
        at = 1.0 - np.abs(at % 2.0 - 1.0)
    else:
        at = at % 1.0
    return np.minimum((at * n).astype(np.int64), n - 1)
