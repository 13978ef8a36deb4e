"""Texels of cut-outs in kernels: does a ray that meets a face pass through a hole of its texture?"""

from typing import NamedTuple

import numpy as np

from ..kernels.fields import F32Ptr, I32Ptr, I64Ptr, U8Ptr
from ..kernels.jit import inlined, kernel, overload
from ..kernels.predicate.filters import weights
from ..kernels.simd import get, ptr
from ..scene.materials import CLAMP, MIRROR
from .rays.traverse import passed


class Texels(NamedTuple):
    """What the slots of a tree of cut-outs need to find texels: see `scene.cutouts.Cutouts`."""

    uv: np.ndarray  # (m, 6) float32, slot -> texture coordinates of the three corners
    mask: np.ndarray  # (m,) int32, slot -> mask
    shapes: np.ndarray  # (p, 4) int32
    first: np.ndarray  # (p,) int64
    texels: np.ndarray  # (b,) uint8


class TexelPointers(NamedTuple):
    """Pointers to the arrays of `Texels`, which must outlive them."""

    uv: F32Ptr  # float32 *
    mask: I32Ptr  # int32 *
    shapes: I32Ptr  # int32 *
    first: I64Ptr  # int64 *
    texels: U8Ptr  # uint8 *


@inlined
def texel_pointers(texels):
    """`TexelPointers` of `Texels`."""
    return TexelPointers(
        ptr(texels.uv), ptr(texels.mask), ptr(texels.shapes), ptr(texels.first), ptr(texels.texels)
    )  # fmt: skip


@inlined
def _wrapped(x, size, wrap):
    """The texel 0 .. size - 1 that stands at place x of the endless texture."""
    if wrap == CLAMP:
        return min(max(x, np.int64(0)), size - 1)
    if wrap == MIRROR:
        x = x % (2 * size)
        return x if x < size else 2 * size - 1 - x
    return x % size


@inlined
def _inside(weight):
    """A weight, which rounding may have moved beyond 0 or 1."""
    return min(max(weight, np.float64(0.0)), np.float64(1.0))


@inlined
def _texture_coordinate(uv, slot, axis, b, c):
    f, at = np.float64, 6 * slot + axis
    return (1.0 - b - c) * f(get(uv, at)) + b * f(get(uv, at + 2)) + c * f(get(uv, at + 4))


@kernel
def is_hole(texels, ray, corners, slot):
    """Is the texel clear where the ray meets the cut-out in `slot`? One fixed float64 expression finds the texel."""
    b, c = weights(ray, corners, slot)
    b, c = _inside(b), _inside(c)
    k = np.int64(get(texels.mask, slot))
    w, h = np.int64(get(texels.shapes, 4 * k)), np.int64(get(texels.shapes, 4 * k + 1))
    u = np.int64(np.floor(_texture_coordinate(texels.uv, slot, 0, b, c) * w))
    v = np.int64(np.floor(_texture_coordinate(texels.uv, slot, 1, b, c) * h))
    x, y = _wrapped(u, w, get(texels.shapes, 4 * k + 2)), _wrapped(v, h, get(texels.shapes, 4 * k + 3))
    byte = get(texels.texels, get(texels.first, k) + y * ((w + 7) >> 3) + (x >> 3))
    return np.int64(byte) >> (x & 7) & 1 == 0


@overload(passed)
def _passed(listener, ray, corners, slot, prim):
    if getattr(listener, "instance_class", None) is TexelPointers:
        return lambda listener, ray, corners, slot, prim: is_hole(listener, ray, corners, slot)
    return None
