"""Unoccluded irradiance from a light at the surfaces that pixels see."""
# mypy: disable-error-code="call-arg, var-annotated"
# (mypy counts the typing context among the arguments of intrinsics)

from typing import NamedTuple

import numpy as np

from ..kernels.fields import F32Ptr
from ..kernels.jit import inlined, kernel
from ..kernels.parallel import CHUNK, N, new_ticket, run, take, thread_count
from ..kernels.simd import get, ptr, ptr_at, put
from ..query.receivers import NOTHING
from ..query.samples import moved, patch_at, sample_point, tangent_disk
from ..scene.lights import DIRECTIONAL, SPHERE

_CROSS = np.array([[0.3, 0.1], [0.9, 0.3], [0.7, 0.9], [0.1, 0.7]])
_POINTS = {"square": _CROSS, "disk": (2.0 * _CROSS - 1.0) * 0.8, "point": np.zeros((1, 2))}
"""Domain -> points (a, b) that represent the whole light."""


@inlined
def point_irradiance(distant, flat, p, n, q):
    """Irradiance per unit intensity at p (normal n) from light point q; `flat` is the unit normal of a flat light."""
    wx, wy, wz = q[0] - p[0], q[1] - p[1], q[2] - p[2]
    r2 = wx * wx + wy * wy + wz * wz
    r = np.sqrt(r2)
    cosine = (n[0] * wx + n[1] * wy + n[2] * wz) / r
    lit = (r2 > 0.0) & (cosine > 0.0)
    if flat[0] != 0.0 or flat[1] != 0.0 or flat[2] != 0.0:
        cosine *= abs(flat[0] * wx + flat[1] * wy + flat[2] * wz) / r
    found = cosine if distant else cosine / r2
    return found if lit else 0.0


@inlined
def softened(p, g, n, bend, q):
    """The factor for light from q at p, with geometric normal g, shading normal n, and `ShadingNormals.bend`.

    Light below the geometric surface gives nothing. Towards the height `bend` above the horizon of n it fades, by the
    polynomial of Chiang et al. [2019]. So it has ended where the next faces turn away from the light.
    """
    wx, wy, wz = q[0] - p[0], q[1] - p[1], q[2] - p[2]
    height = (n[0] * wx + n[1] * wy + n[2] * wz) / np.sqrt(wx * wx + wy * wy + wz * wz)
    if not (g[0] * wx + g[1] * wy + g[2] * wz > 0.0 and height > bend):
        return 0.0
    share = (height - bend) / bend if height < 2.0 * bend else 1.0
    return share * (1.0 + share * (1.0 - share))


@inlined
def _row(pointer, x):
    return get(pointer, 3 * x), get(pointer, 3 * x + 1), get(pointer, 3 * x + 2)


class Terminator(NamedTuple):
    """What ends the light of shading normals."""

    geometric: F32Ptr  # float32 *, (w, 3): geometric normals
    bend: F32Ptr  # float32 *, (w,)
    soft: bool  # whether there are shading normals


@inlined
def _add(totals, x, distant, flat, p, n, q, terminator):
    e = point_irradiance(distant, flat, p, n, q)
    if terminator.soft:
        e *= softened(p, _row(terminator.geometric, x), n, get(terminator.bend, x), q)
    put(totals, x, get(totals, x) + e)


@inlined
def _add_row(position, normal, terminator, light, fixed, flat, a, b, totals, w):
    """Add a row of pixels' irradiance from point (a, b) of the light. LLVM vectorises the loop of each kind."""
    zero = np.float64(0.0)
    if light.kind == SPHERE:
        cx, cy, cz, radius = light.base[0], light.base[1], light.base[2], light.radius
        for x in range(w):
            p, n = _row(position, x), _row(normal, x)
            patch = tangent_disk(cx, cy, cz, radius, np.float64(p[0]), np.float64(p[1]), np.float64(p[2]))
            _add(totals, x, False, flat, p, n, sample_point(patch, a, b, zero), terminator)
    elif light.kind == DIRECTIONAL:
        for x in range(w):
            p, n = _row(position, x), _row(normal, x)
            q = sample_point(moved(fixed, p[0], p[1], p[2]), a, b, zero)
            _add(totals, x, True, flat, p, n, q, terminator)
    else:
        q = sample_point(fixed, a, b, zero)
        for x in range(w):
            _add(totals, x, False, flat, _row(position, x), _row(normal, x), q, terminator)


@kernel
def _irradiance_rows(ticket, position, normal, geometric, bend, soft, side, light, flat, points, out, totals):
    """Worker: compute rows of pixels. `totals` is the thread's own memory for a row of float64."""
    w = side.shape[1]
    zero, one = np.float64(0.0), np.float64(1.0)
    fixed = patch_at(light, zero, zero, zero, zero, zero, one)
    flat = flat[0], flat[1], flat[2]
    y0 = take(ticket)
    while y0 >= 0:
        for y in range(y0, min(y0 + ticket[CHUNK], ticket[N])):
            totals[:] = 0.0
            for s in range(len(points)):
                a, b = points[s, 0], points[s, 1]
                terminator = Terminator(ptr_at(geometric, 3 * y * w), ptr_at(bend, y * w), soft)
                rows = ptr_at(position, 3 * y * w), ptr_at(normal, 3 * y * w)
                _add_row(*rows, terminator, light, fixed, flat, a, b, ptr(totals), w)
            for x in range(w):
                out[y, x] = np.float32(totals[x] / len(points)) if side[y, x] != NOTHING else np.float32(0.0)
        y0 = take(ticket)


def flat_normal(patch) -> np.ndarray:
    """(3,) float64: the unit normal of a flat light's patch; 0 if the light is not flat."""
    flat = np.cross(patch.u, patch.v)
    length = np.linalg.norm(flat)
    return flat / length if length > 0 else np.zeros(3)


def normals_of(gbuffer, shading) -> tuple[np.ndarray, np.ndarray, np.ndarray, bool]:
    """(normals that shade, geometric normals, `ShadingNormals.bend`, whether they differ), for kernels."""
    if shading is None:
        return gbuffer.normal, gbuffer.normal, gbuffer.depth, False  # the third is not read
    return shading.normal, gbuffer.normal, shading.bend, True


def irradiance(gbuffer, patch, domain, shading=None, threads=None) -> np.ndarray:
    """(H, W) float32: irradiance of each pixel's surface from an unoccluded light of intensity 1.

    shading : ShadingNormals; None: the geometric normals
    patch : LightPatch; domain : domain of the light, which chooses the few points that represent the light
    """
    flat = np.zeros(3) if patch.kind == DIRECTIONAL else flat_normal(patch)
    out = np.empty(gbuffer.face.shape, np.float32)
    ticket = new_ticket(len(out), 8)
    args = gbuffer.position, *normals_of(gbuffer, shading), gbuffer.side, patch, flat, _POINTS[domain], out
    run(_irradiance_rows, thread_count(threads), ticket, *args, own=lambda: (np.empty(out.shape[1]),))
    return out
