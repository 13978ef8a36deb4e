"""Irradiance at the surfaces of pixels: closed forms for points, spheres, parallelograms and disks; sums over lists.

The closed forms leave shadows out; sums over lists include them. docs/design/radiometry.md derives the formulas.
"""

from typing import NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from ..kernels import small_matrices
from ..kernels.elementary import acos, atan, atan2, cos, log1p, sin_cos
from ..kernels.exact.filters import cross, dot
from ..kernels.jit import inlined, kernel
from ..kernels.parallel import items, new_ticket, run, thread_count
from ..kernels.simd import get, ptr, put
from ..query.gbuffer import GBuffer
from ..query.light_samples import tangent_disk
from ..query.receivers import NOTHING
from ..query.shadow_query import ShadingNormals, three_at
from ..scene.light_lists import LightList, PointLights
from ..scene.lights import DIRECTIONAL, SPHERE, LightPatch
from ..trace.transmission import TracedQuery, arriving, row_of, transmission_pointers

# --- Terminator of interpolated normals, see docs/design/shading.md ---------------------------------------------------


class PixelNormals(NamedTuple):
    """Shading and geometric normals of the pixels, for kernels."""

    normal: np.ndarray  # (H, W, 3) float32: shading normals
    geometric: np.ndarray  # (H, W, 3) float32
    bend: np.ndarray  # (H, W) float32: `ShadingNormals.bend`; read only if `soft`
    soft: bool  # whether shading and geometric normals differ


def pixel_normals(gbuffer: GBuffer, shading: ShadingNormals | None) -> PixelNormals:
    """The normals of a G-buffer; `shading`: its interpolated normals, or None."""
    if shading is None:
        return PixelNormals(gbuffer.normal, gbuffer.normal, gbuffer.depth, False)
    return PixelNormals(shading.normal, gbuffer.normal, shading.bend, True)


@inlined
def terminator_factor(g, n, bend, w):
    """Factor of light along w, with geometric normal g, shading normal n, and `ShadingNormals.bend`.

    Light from below the geometric surface does not count. Towards the height `bend` above the horizon of n, light
    fades by the polynomial of Chiang et al. [2019], so that it ends before adjacent faces turn away from it.
    """
    height = dot(n, w) / np.sqrt(dot(w, w))
    if not (dot(g, w) > 0.0 and height > bend):
        return 0.0
    share = (height - bend) / bend if height < 2.0 * bend else 1.0  # Eq. (2)
    return share * (1.0 + share * (1.0 - share))


# --- Uniform parallelograms and disks, clipped at the receiver's horizon ----------------------------------------------
#
# An emitter has uniform radiance on both sides and unit intensity: radiance times area is 1. Vectors are tuples of
# three float64, relative to the receiver; n is its unit normal. Equation numbers are those of
# docs/design/radiometry.md.


# mypy: disable-error-code="call-arg, var-annotated"
# (mypy counts the typing context among the arguments of intrinsics)


@inlined
def _sum(a, b):
    return a[0] + b[0], a[1] + b[1], a[2] + b[2]


@inlined
def _offset(a, s, u, t, v):
    """a + s u + t v."""
    return a[0] + s * u[0] + t * v[0], a[1] + s * u[1] + t * v[1], a[2] + s * u[2] + t * v[2]


@inlined
def _edge(a, b, n):
    """Eq. (2): the integral along the segment from a to b."""
    c = cross(a, b)
    sine = np.sqrt(dot(c, c))
    return atan2(sine, dot(a, b)) * dot(n, c) / sine if sine > 0.0 else 0.0


@inlined
def quad_irradiance(corner, u, v, area, n):
    """Irradiance from the parallelogram with the given corner and edges u and v [Lambert 1760]."""
    a, b, d = corner, _sum(corner, u), _sum(corner, v)
    c = _sum(b, v)
    heights = dot(n, a), dot(n, b), dot(n, c), dot(n, d)
    if max(max(heights[0], heights[1]), max(heights[2], heights[3])) <= 0.0:
        return 0.0
    if min(min(heights[0], heights[1]), min(heights[2], heights[3])) >= 0.0:
        total = _edge(a, b, n) + _edge(b, c, n) + _edge(c, d, n) + _edge(d, a, n)
    else:
        total = _clipped_quad((a, b, c, d), heights, n)
    return 0.5 * abs(total) / area


@kernel
def _clipped_quad(corners, heights, n):
    """The integral around the part of a convex quadrilateral above the horizon, which crosses two of its edges."""
    total, out, back = 0.0, corners[0], corners[0]  # where the boundary leaves and re-enters the upper side
    for k in range(4):
        a, b = corners[k], corners[(k + 1) & 3]
        ha, hb = heights[k], heights[(k + 1) & 3]
        if ha >= 0.0 and hb >= 0.0:
            total += _edge(a, b, n)
        elif ha >= 0.0 or hb >= 0.0:
            share = ha / (ha - hb)
            cut = _offset(a, share, b, -share, a)
            if ha >= 0.0:
                total, out = total + _edge(a, cut, n), cut
            else:
                total, back = total + _edge(cut, b, n), cut
    return total + _edge(out, back, n)


@inlined
def disk_irradiance(c, axis, r, n):
    """Irradiance from the disk with centre c, unit axis and radius r > 0."""
    level, h, facing = dot(n, c), dot(axis, c), dot(n, axis)
    if h < 0.0:
        h, facing = -h, -facing
    extent = r * np.sqrt(max(1.0 - facing * facing, 0.0))  # heights: level +- extent
    if level <= -extent:
        return 0.0
    if level < extent:
        return _clipped_disk(c, axis, r, n)
    d2, r2 = dot(c, c), r * r
    sum2, diff2 = d2 + r2, d2 - r2
    s = np.sqrt(diff2 * diff2 + 4.0 * r2 * h * h)
    if not s > 0.0:
        return 0.0
    along = 2.0 * h * h / (s + diff2) if diff2 > 0.0 else 0.5 * (s - diff2) / r2  # Eq. (3)
    across = 2.0 * h / (s + sum2)
    return max((along * facing + across * (level - h * facing)) / s, 0.0)


@kernel
def _clipped_disk(c, axis, r, n):
    """`disk_irradiance` of the part above the horizon, bounded by an arc and a chord.

    The arc is c + r (u cos t + v sin t), -t0 <= t <= t0; u points upwards.
    """
    facing = dot(n, axis)
    tilt = np.sqrt(1.0 - facing * facing)
    u = (n[0] - facing * axis[0]) / tilt, (n[1] - facing * axis[1]) / tilt, (n[2] - facing * axis[2]) / tilt
    v = cross(axis, u)
    cosine = min(max(-dot(n, c) / (r * tilt), -1.0), 1.0)
    t0, x, y = acos(cosine), r * cosine, r * np.sqrt(1.0 - cosine * cosine)
    arc = _arc(dot(c, u), dot(c, v), dot(c, axis), r, facing, tilt, t0)
    return abs(arc + _edge(_offset(c, x, u, y, v), _offset(c, x, u, -y, v), n)) / (2.0 * np.pi * r * r)


@inlined
def _arc(cu, cv, h, r, facing, tilt, t0):
    """Eq. (4): the integral along the arc, of (i sin t' + j cos t' + k) / (a + b cos t') with t' = t - phase."""
    p, phase = np.sqrt(cu * cu + cv * cv), atan2(cv, cu)
    sine, cosine = sin_cos(phase)
    at_sine, at_cosine = r * facing * cv, r * (facing * cu - tilt * h)
    i, j = at_sine * cosine - at_cosine * sine, at_sine * sine + at_cosine * cosine
    k = r * r * facing
    a, b = p * p + h * h + r * r, 2.0 * r * p
    q = np.sqrt((h * h + (p - r) * (p - r)) * (h * h + (p + r) * (p + r)))  # sqrt(a^2 - b^2)
    if not q > 0.0:
        return 0.0
    start, end = -t0 - phase, t0 - phase
    atan_difference = _atan_over(a + q, b, end) - _atan_over(a + q, b, start)
    of_one = 2.0 * (t0 - b * atan_difference) / q
    of_cosine = 2.0 * (a * atan_difference - t0 * b / (a + q)) / q
    step = (cos(end) - cos(start)) / (a + b * cos(start))
    of_sine = -step * _log1p_over(b * step)
    return i * of_sine + j * of_cosine + k * of_one


@inlined
def _atan_over(m, b, t):
    """atan(b sin t / (m + b cos t)) / b, also for b = 0."""
    sine, cosine = sin_cos(t)
    x = sine / (m + b * cosine)
    return atan(b * x) / b if b * abs(x) > 1e-9 else x


@inlined
def _log1p_over(x):
    """log(1 + x) / x, also for x = 0."""
    return log1p(x) / x if abs(x) > 1e-9 else 1.0


# --- Emitters ---------------------------------------------------------------------------------------------------------

Vector3: TypeAlias = tuple[float, float, float]

POINT, QUAD, DISK = 0, 1, 2
_FORMS = {"point": POINT, "square": QUAD, "disk": DISK}


class Emitter(NamedTuple):
    """A light of intensity 1 in the recentred frame, for kernels; vectors are tuples of three float64."""

    kind: int  # FIXED, DIRECTIONAL or SPHERE
    form: int  # POINT, QUAD or DISK
    base: Vector3  # as in `LightPatch`
    u: Vector3
    v: Vector3
    axis: Vector3  # unit normal of a flat light; 0 for points and spheres
    size: float  # area of a QUAD, radius of a DISK, 0 for a POINT
    scale: float  # distant disks: radiance over that of a disk of intensity 1; else 1


def emitter_of(patch: LightPatch, domain: str) -> Emitter:
    """The emitter of a patch that is neither a list nor ambient light; `domain`: the domain of its light."""
    across = np.cross(patch.u, patch.v)
    area, form = float(small_matrices.length(across)), _FORMS[domain]
    if patch.kind == SPHERE:
        size, axis = patch.radius, np.zeros(3)
    elif area > 0.0:
        size, axis = (area if form == QUAD else float(np.sqrt(area))), across / area
    else:
        form, size, axis = POINT, 0.0, np.zeros(3)
    scale = float(small_matrices.dot(patch.base, patch.base)) + size * size if patch.kind == DIRECTIONAL else 1.0
    vectors = _three(patch.base), _three(patch.u), _three(patch.v), _three(axis)
    return Emitter(patch.kind, form, *vectors, float(size), scale)


def _three(vector: np.ndarray) -> Vector3:
    x, y, z = vector.tolist()
    return x, y, z


@inlined
def _from_point(c, n, distant):
    """Irradiance from a point at c; if `distant`, c is any point in its direction."""
    r2, height = dot(c, c), dot(n, c)
    if not (height > 0.0 and r2 > 0.0):
        return 0.0
    return height / np.sqrt(r2) if distant else height / (r2 * np.sqrt(r2))


@inlined
def _from_sphere(centre, radius, n):
    """Irradiance from a sphere: that of the disk in which the tangent cone touches it, with the sphere's radiance."""
    disk = tangent_disk(centre[0], centre[1], centre[2], radius, 0.0, 0.0, 0.0)
    r = np.sqrt(disk.ux * disk.ux + disk.uy * disk.uy + disk.uz * disk.uz)
    if not r > 0.0:
        return 0.0
    distance = np.sqrt(dot(centre, centre))
    axis = (0.0, 0.0, 1.0)
    if distance > 0.0:
        axis = centre[0] / distance, centre[1] / distance, centre[2] / distance
    share = r / radius
    return share * share * disk_irradiance((disk.bx, disk.by, disk.bz), axis, r, n)


@inlined
def emitted_irradiance(light, p, n):
    """Unshadowed irradiance at the point p with the unit normal n from an `Emitter`."""
    c = light.base
    if light.kind != DIRECTIONAL:
        c = c[0] - p[0], c[1] - p[1], c[2] - p[2]
    if light.kind == SPHERE:
        return _from_sphere(c, light.size, n)
    if light.form == QUAD:
        return quad_irradiance(c, light.u, light.v, light.size, n)
    if light.form == DISK:
        return light.scale * disk_irradiance(c, light.axis, light.size, n)
    return _from_point(c, n, light.kind == DIRECTIONAL)


@kernel
def _irradiance_kernel(ticket, position, normal, side, light, out):
    positions, normals, sides, irradiances = ptr(position), ptr(normal), ptr(side), ptr(out)
    for i in items(ticket):
        e = 0.0
        if get(sides, i) != NOTHING:
            e = emitted_irradiance(light, three_at(positions, i), three_at(normals, i))
        put(irradiances, i, np.float32(e))


def irradiance(
    gbuffer: GBuffer,
    patch: LightPatch,
    domain: str,
    shading: ShadingNormals | None = None,
    threads: int | None = None,
) -> NDArray[np.float32]:
    """(H, W) float32: unshadowed irradiance of each pixel's surface from a light of intensity 1; 0 in the background.

    The light is clipped at the horizon of the normal. A receiver inside a sphere gets the light of the disk that it
    samples.

    patch : LightPatch, neither a list nor ambient light
    domain : domain of the light
    shading : None: geometric normals
    """
    out = np.empty(gbuffer.face.shape, np.float32)
    normal = gbuffer.normal if shading is None else shading.normal
    ticket = new_ticket(out.size, 4096)
    run(
        _irradiance_kernel,
        thread_count(threads),
        ticket,
        gbuffer.position,
        normal,
        gbuffer.side,
        emitter_of(patch, domain),
        out,
    )
    return out


# --- Lists of lights: each sample is one light, so its bit is needed --------------------------------------------------


@kernel
def _falloff(wx, wy, wz, nx, ny, nz, mx, my, mz, facing, least):
    """Irradiance per candela at a surface with normal n from a light at offset w.

    If `facing`, the light has a cosine falloff around m. The squared distance is clamped to at least `least`.
    """
    r2 = wx * wx + wy * wy + wz * wz
    cosine = nx * wx + ny * wy + nz * wz  # times the distance
    if not (r2 > 0.0 and cosine > 0.0):
        return 0.0
    r = np.sqrt(r2)
    emitted = -(mx * wx + my * wy + mz * wz) / r if facing else 1.0
    if not emitted > 0.0:
        return 0.0
    return emitted * cosine / (r * (r2 if r2 > least else least))


@kernel
def _list_rows(ticket, gbuffer, surface, points, distant, normals, candela, least, bits, light, out):
    facing, (normal, geometric, bend, soft) = len(normals) > 0, surface
    through = transmission_pointers(light)
    mx = my = mz = 0.0
    for y in items(ticket):
        for x in range(gbuffer.side.shape[1]):
            red = green = blue = 0.0
            k = (x & 3) + 4 * (y & 3)
            if gbuffer.side[y, x] != NOTHING:
                px = py = pz = np.float32(0.0)
                if not distant:
                    px, py, pz = gbuffer.position[y, x, 0], gbuffer.position[y, x, 1], gbuffer.position[y, x, 2]
                nx, ny, nz = normal[y, x, 0], normal[y, x, 1], normal[y, x, 2]
                gx, gy, gz = geometric[y, x, 0], geometric[y, x, 1], geometric[y, x, 2]
                row = row_of(through, y * gbuffer.side.shape[1] + x)
                for s in range(points.shape[1]):
                    if bits[y, x, s >> 6] >> np.uint64(s & 63) & np.uint64(1):
                        continue
                    wx, wy, wz = points[k, s, 0] - px, points[k, s, 1] - py, points[k, s, 2] - pz
                    if facing:
                        mx, my, mz = normals[k, s, 0], normals[k, s, 1], normals[k, s, 2]
                    e = _falloff(wx, wy, wz, nx, ny, nz, mx, my, mz, facing, least)
                    if soft:
                        e *= terminator_factor((gx, gy, gz), (nx, ny, nz), bend[y, x], (wx, wy, wz))
                    red += e * candela[k, s, 0] * arriving(through, row, s, 0)
                    green += e * candela[k, s, 1] * arriving(through, row, s, 1)
                    blue += e * candela[k, s, 2] * arriving(through, row, s, 2)
            out[y, x, 0], out[y, x, 1], out[y, x, 2] = np.float32(red), np.float32(green), np.float32(blue)


def list_irradiance(
    gbuffer: GBuffer,
    lights: LightList,
    traced: TracedQuery,
    shading: ShadingNormals | None = None,
    threads: int | None = None,
) -> NDArray[np.float32]:
    """(H, W, 3) float32: irradiance of each pixel's surface from a list of lights, with shadows; 0 in the background.

    Distant lights are unit vectors, for which `_falloff` at the origin is the cosine.

    traced : the query of the list's samples, and its answer
    shading : None: geometric normals
    """
    out = np.empty((*gbuffer.face.shape, 3), np.float32)
    distant, points, normals, least = True, traced.query.samples, None, 0.0
    if isinstance(lights, PointLights):
        distant, points, normals, least = False, points - gbuffer.origin, lights.normals, lights.nearest**2
    normals = np.empty((0, 0, 3)) if normals is None else np.ascontiguousarray(normals[lights.sets])
    args = gbuffer, pixel_normals(gbuffer, shading), points, distant, normals, lights.weights(), least
    run(_list_rows, thread_count(threads), new_ticket(len(out), 4), *args, traced.bits, traced.through, out)
    return out
