"""A query in hot kernels: pointers and scalars, for each array passed on costs a reference count."""

from typing import NamedTuple

import numpy as np

from ..jit import inlined
from ..predicate.filters import plane
from ..query.receivers import FREE
from ..query.samples import patch_at, sample_point
from ..query.shadow import Horizon
from ..scene.lights import AMBIENT, LightPatch
from ..simd import get, ptr


class Asking(NamedTuple):
    """A ShadowQuery whose receivers are counted row by row."""

    origins: object  # float32
    faces: object  # int32
    sides: object  # int8
    normals: object  # float64
    corners: object  # float32
    samples: object  # float64
    light: LightPatch  # with tuples of three numbers
    w: int  # receivers in a row
    spp: int


@inlined
def _three(a):
    return a[0], a[1], a[2]


@inlined
def asking_of(query):
    """The `Asking` of a ShadowQuery."""
    p = query.light
    light = LightPatch(p.kind, _three(p.base), _three(p.u), _three(p.v), _three(p.w), p.radius)
    return Asking(
        ptr(query.origins), ptr(query.faces), ptr(query.sides), ptr(query.normals), ptr(query.corners),
        ptr(query.samples), light, query.sides.shape[1], query.samples.shape[1],
    )  # fmt: skip


@inlined
def three_at(p, i):
    """Three numbers, in float64."""
    return np.float64(get(p, 3 * i)), np.float64(get(p, 3 * i + 1)), np.float64(get(p, 3 * i + 2))


@inlined
def sets_at(asking, i):
    """The sample set of receiver i."""
    return (i % asking.w & 3) + 4 * (i // asking.w & 3)


@inlined
def patch_for(asking, i):
    """The `Patch` of the light for receiver i."""
    z = np.float64(0.0)
    n = three_at(asking.normals, i) if asking.light.kind == AMBIENT else (z, z, z)
    x, y, z = get(asking.origins, 3 * i), get(asking.origins, 3 * i + 1), get(asking.origins, 3 * i + 2)
    return patch_at(asking.light, x, y, z, n[0], n[1], n[2])


@inlined
def end_of(asking, patch, i, s):
    """Sample s of receiver i, float32."""
    at = (sets_at(asking, i) * asking.spp + s) * 3
    return sample_point(patch, get(asking.samples, at), get(asking.samples, at + 1), get(asking.samples, at + 2))


@inlined
def horizon_at(asking, i):
    """The `Horizon` of receiver i."""
    side, face, z = np.int64(get(asking.sides, i)), np.int64(get(asking.faces, i)), np.float64(0.0)
    if face >= 0:
        p, n, error = plane(asking.corners, face, z, z, z)
        return Horizon(side, face, p[0], p[1], p[2], n[0], n[1], n[2], error)
    p = three_at(asking.origins, i)
    n = (z, z, z) if side == FREE else three_at(asking.normals, i)
    return Horizon(side, face, p[0], p[1], p[2], n[0], n[1], n[2], z)
