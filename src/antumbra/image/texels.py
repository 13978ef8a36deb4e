"""Texture look-ups: bilinear within a mip level, linear between two, and several along a stretched footprint."""

from typing import NamedTuple

import numpy as np

from ..kernels.jit import inlined
from ..kernels.simd import get, i32_at, ptr
from ..scene.materials import CLAMP, LINEAR, MIRROR, REPEAT, Texture

MOST_TAPS = 8
"""Look-ups along the longer side of a pixel's footprint, at most. A footprint that is longer still is blurred."""


class Pictures(NamedTuple):
    """Textures for kernels. Their arrays must outlive this."""

    pixels: np.ndarray  # (t,) int64: addresses of the texels, four bytes each, row by row
    mips: np.ndarray  # (t,) int64: addresses of those of smaller levels, one after the other
    sizes: np.ndarray  # (t, 2) int32: width and height
    wraps: np.ndarray  # (t, 2) int32: wrap_s and wrap_t
    nearest: np.ndarray  # (t,) bool
    linear: np.ndarray  # (256,) float32: the linear light of bytes


def pictures_of(textures: list[Texture | None]) -> Pictures:
    """The textures; those that are None may not be looked up."""
    n = len(textures)
    found = Pictures(
        np.zeros(n, np.int64),
        np.zeros(n, np.int64),
        np.zeros((n, 2), np.int32),
        np.zeros((n, 2), np.int32),
        np.zeros(n, np.bool_),
        LINEAR,
    )
    for i, texture in enumerate(textures):
        if texture is not None:
            found.pixels[i], found.mips[i] = texture.pixels.ctypes.data, texture.mips.ctypes.data
            found.sizes[i] = texture.pixels.shape[1::-1]
            found.wraps[i] = texture.wrap_s, texture.wrap_t
            found.nearest[i] = texture.nearest
    return found


@inlined
def _wrapped(i, n, wrap):
    """The texel at place i beside a coordinate from `_near`, on a line of n texels."""
    if wrap == REPEAT:
        return n - 1 if i < 0 else i if i < n else 0
    if wrap == MIRROR and i >= n:
        i = 2 * n - 1 - i
    return min(max(i, 0), n - 1)


@inlined
def _near(u, wrap):
    """A texture coordinate that shows the same: from 0 to 1, and to 2 if the texture is mirrored."""
    if wrap == REPEAT:
        return u - np.floor(u)
    return min(max(u, 0.0), 1.0) if wrap == CLAMP else u - 2.0 * np.floor(0.5 * u)


@inlined
def _light(linear, texel):
    """Linear red, green and blue of four bytes."""
    return (
        get(linear, texel & 255),
        get(linear, (texel >> 8) & 255),
        get(linear, (texel >> 16) & 255),
    )


@inlined
def _bilinear(texels, linear, w, h, wrap_s, wrap_t, u, v, nearest):
    """The picture at (u, v); `texels` and `linear` are pointers."""
    half = 0.0 if nearest else 0.5
    x, y = _near(u, wrap_s) * w - half, _near(v, wrap_t) * h - half
    x0, y0 = np.floor(x), np.floor(y)
    i, j = np.int64(x0), np.int64(y0)
    left, top = _wrapped(i, w, wrap_s), _wrapped(j, h, wrap_t) * w
    if nearest:
        return _light(linear, np.int64(get(texels, top + left)))
    right, low = _wrapped(i + 1, w, wrap_s), _wrapped(j + 1, h, wrap_t) * w
    fx, fy = x - x0, y - y0
    a, b = _light(linear, np.int64(get(texels, top + left))), _light(linear, np.int64(get(texels, top + right)))
    c, d = _light(linear, np.int64(get(texels, low + left))), _light(linear, np.int64(get(texels, low + right)))
    p, q, r, s = (1.0 - fx) * (1.0 - fy), fx * (1.0 - fy), (1.0 - fx) * fy, fx * fy
    return (
        p * a[0] + q * b[0] + r * c[0] + s * d[0],
        p * a[1] + q * b[1] + r * c[1] + s * d[1],
        p * a[2] + q * b[2] + r * c[2] + s * d[2],
    )


@inlined
def _at_level(pictures, k, level, u, v, nearest):
    """Texture k at (u, v), in a mip level."""
    one = np.int64(1)
    w, h = np.int64(pictures.sizes[k, 0]), np.int64(pictures.sizes[k, 1])
    texels, start = i32_at(pictures.pixels[k]), np.int64(0)
    if level > 0:
        for _ in range(level - 1):
            w, h = max(w >> one, one), max(h >> one, one)
            start += w * h
        w, h = max(w >> one, one), max(h >> one, one)
        texels = i32_at(pictures.mips[k] + 4 * start)
    return _bilinear(texels, ptr(pictures.linear), w, h, pictures.wraps[k, 0], pictures.wraps[k, 1], u, v, nearest)


@inlined
def _between(pictures, k, level, u, v):
    """Texture k at (u, v), linear between two mip levels; `level` is a float64 that is not negative."""
    largest = max(pictures.sizes[k, 0], pictures.sizes[k, 1])
    last = np.int64(np.floor(np.log2(np.float64(largest))))
    below = min(np.int64(level), last)
    a = _at_level(pictures, k, below, u, v, False)
    part = level - below
    if part <= 0.0 or below == last:
        return a
    b = _at_level(pictures, k, below + 1, u, v, False)
    return a[0] + part * (b[0] - a[0]), a[1] + part * (b[1] - a[1]), a[2] + part * (b[2] - a[2])


@inlined
def looked_up(pictures, k, uv, across, along):
    """(red, green, blue), linear: the mean of texture k around `uv`, over a pixel's footprint.

    across, along : the two sides of the footprint, in texture coordinates

    The longer side is covered by several look-ups, each in the mip level that suits the shorter one. So a floor seen at
    a grazing angle stays sharp, as with the anisotropic filters of graphics cards.
    """
    w, h = np.float64(pictures.sizes[k, 0]), np.float64(pictures.sizes[k, 1])
    one, two = np.hypot(across[0] * w, across[1] * h), np.hypot(along[0] * w, along[1] * h)
    side = along if two > one else across
    longer, shorter = max(one, two), min(one, two)
    if not longer > 1.0:
        return _at_level(pictures, k, 0, uv[0], uv[1], pictures.nearest[k])
    shorter = max(shorter, 1.0)
    taps = np.int64(min(np.ceil(longer / shorter), MOST_TAPS))
    level = min(np.log2(max(longer / taps, shorter)), 64.0)
    red = green = blue = 0.0
    for i in range(taps):
        at = (i + 0.5) / taps - 0.5
        light = _between(pictures, k, level, uv[0] + at * side[0], uv[1] + at * side[1])
        red, green, blue = red + light[0], green + light[1], blue + light[2]
    return red / taps, green / taps, blue / taps
