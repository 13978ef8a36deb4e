"""Unshadowed irradiance at the surfaces of pixels: closed forms for points, spheres, parallelograms and disks.

docs/design/radiometry.md derives the formulas. `light_list_irradiance` has the light of lists, with shadows.
"""

from typing import NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from ..kernels import small_matrices
from ..kernels.elementary import acos, atan, atan2, cos, log1p, sin_cos
from ..kernels.exact.filters import cross, dot, smaller
from ..kernels.jit import F32Ptr, F64Ptr, inlined, kernel
from ..kernels.parallel import new_ticket, run, shares, thread_count
from ..kernels.simd import get, ptr, put, select, square_root, stack_f32, stack_f64
from ..query.gbuffer import GBuffer
from ..query.receivers import NOTHING
from ..query.shadow_query import ShadingNormals, three_at
from ..query.surface_links import deinterleave
from ..scene.lights import DIRECTIONAL, SPHERE, LightPatch

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
    """Factors of light along vectors w, with geometric normals g, shading normals n, and `ShadingNormals.bend`.

    Light from below the geometric surface does not count. Towards the height `bend` above the horizon of n, light
    fades by the polynomial of Chiang et al. [2019], so that it ends before adjacent faces turn away from it.

    w : float32 vectors; g, n and bend : float32 vectors or scalars
    """
    zero, one = np.float32(0.0), np.float32(1.0)
    height = dot(w, n) / square_root(dot(w, w))
    share = select(height < bend + bend, (height - bend) / bend, one)  # Eq. (2)
    return select((dot(w, g) > zero) & (height > bend), share * (one + share * (one - share)), zero)


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
    vectors = _three(patch.base), _three(patch.u), _three(patch.v), _three(axis)
    return Emitter(patch.kind, form, *vectors, float(size))


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
def _cap_irradiance(height, size):
    """Irradiance from the part above the horizon of a cap of the sky with radiance 1 / pi [Howell, B-43].

    height : sine of the elevation of its centre
    size : sine of its half-angle
    """
    if height >= size:
        return size * size * height
    if height <= -size:
        return 0.0
    q, cosine = np.sqrt((size - height) * (size + height)), np.sqrt(1.0 - size * size)
    above = np.pi - atan2(q, cosine * height)
    return max(size * size * height * above - cosine * q + atan2(q, cosine), 0.0) / np.pi


@inlined
def _from_sphere(centre, radius, n):
    """Irradiance from a sphere; inside it, from the great disk that faces the receiver."""
    distance = np.sqrt(dot(centre, centre))
    if distance > radius:
        return _cap_irradiance(dot(n, centre) / distance, radius / distance) / (radius * radius)
    axis = (0.0, 0.0, 1.0)
    if distance > 0.0:
        axis = centre[0] / distance, centre[1] / distance, centre[2] / distance
    return disk_irradiance(centre, axis, radius, n)


@inlined
def _from_sun(c, radius, n):
    """Irradiance from a distant disk that faces the receiver, by the radiance of a sphere."""
    distance = np.sqrt(dot(c, c))
    size = radius / np.sqrt(distance * distance + radius * radius)
    return _cap_irradiance(dot(n, c) / distance, size) / (size * size)


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
        distant = light.kind == DIRECTIONAL
        return _from_sun(c, light.size, n) if distant else disk_irradiance(c, light.axis, light.size, n)
    return _from_point(c, n, light.kind == DIRECTIONAL)


# --- Emitters above the horizon ---------------------------------------------------------------------------------------
#
# Most pixels see the whole emitter above their horizon. Its irradiance is then a formula without branches, so LLVM
# vectorises the loop over pixels. The loops leave other pixels, marked by `_CUT`, to
# `emitted_irradiance`.

_BLOCK = 256  # pixels of a share
_PLANES = 3 * _BLOCK
_CUT = -1.0
_LARGE_ANGLE = 0.25  # 1 - cosine of the largest angle of `_arc_over_sine`, 41 degrees


class _Block(NamedTuple):
    """The surfaces of the pixels of a share, deinterleaved, and their irradiance."""

    positions: F32Ptr  # three planes of `_BLOCK` elements
    normals: F32Ptr  # three planes
    values: F64Ptr


@inlined
def _vector(planes, i):
    """Vector i of three planes, in float64."""
    return np.float64(get(planes, i)), np.float64(get(planes, _BLOCK + i)), np.float64(get(planes, 2 * _BLOCK + i))


@inlined
def _unless_cut(value, height, size):
    """`value` if the emitter at this height, with this radius, is above the horizon, 0 if it is below, else `_CUT`."""
    below = 0.0 if height <= -size else _CUT
    return value if height >= size else below


@inlined
def _whole_suns(block, n, light):
    """Write the irradiance of n pixels from a distant point or disk."""
    c = light.base
    inverse = 1.0 / np.sqrt(dot(c, c))
    for i in range(n):
        height = dot(_vector(block.normals, i), c)
        put(block.values, i, _unless_cut(height * inverse, height, light.size))


@inlined
def _whole_spheres(block, n, light):
    """Write the irradiance of n pixels from a sphere or point: from outside, a whole sphere is its centre."""
    for i in range(n):
        c = _difference(light.base, _vector(block.positions, i))
        r2, height = dot(c, c), dot(_vector(block.normals, i), c)
        value = _unless_cut(height / (r2 * np.sqrt(r2)), height, light.size)
        put(block.values, i, value if r2 > light.size * light.size else _CUT)


@inlined
def _whole_disks(block, n, light):
    """Write the irradiance of n pixels from a disk: the formula of `disk_irradiance`."""
    r2 = light.size * light.size
    for i in range(n):
        c, normal = _difference(light.base, _vector(block.positions, i)), _vector(block.normals, i)
        level, facing, h = dot(normal, c), dot(normal, light.axis), dot(light.axis, c)
        sum2, diff2 = dot(c, c) + r2, dot(c, c) - r2
        s = np.sqrt(diff2 * diff2 + 4.0 * r2 * h * h)
        outside, inside = 2.0 * h * h / (s + diff2), 0.5 * (s - diff2) / r2
        along = outside if diff2 > 0.0 else inside
        across = 2.0 * abs(h) / (s + sum2)
        facing = -facing if h < 0.0 else facing
        value = _unless_cut((along * facing + across * (level - abs(h) * facing)) / s, level, light.size)
        put(block.values, i, value if s > 0.0 else _CUT)


@inlined
def _difference(a, b):
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]


@inlined
def _arc_over_sine(t):
    """angle / sine of the angle with cosine 1 - t, 0 <= t <= `_LARGE_ANGLE`; relative error 2e-8.

    The series of arcsin(z) / (z sqrt(1 - z^2)) at half the angle, whose terms have the ratios t k / (2 k + 1).
    """
    tail = 2.0 / 35.0 + t * (8.0 / 315.0 + t * (8.0 / 693.0 + t * (16.0 / 3003.0 + t * (16.0 / 6435.0))))
    return 1.0 + t * (1.0 / 3.0 + t * (2.0 / 15.0 + t * tail))


@inlined
def _unit(a):
    scale = 1.0 / np.sqrt(dot(a, a))
    return a[0] * scale, a[1] * scale, a[2] * scale


@inlined
def _whole_quads(block, n, light):
    """Write the irradiance of n pixels from a parallelogram that none of its edges sees at a large angle."""
    across = _sum(light.u, light.v)
    for i in range(n):
        corner, normal = _difference(light.base, _vector(block.positions, i)), _vector(block.normals, i)
        a, b = _unit(corner), _unit(_sum(corner, light.u))
        c, d = _unit(_sum(corner, across)), _unit(_sum(corner, light.v))
        p, q, r, s = dot(normal, a), dot(normal, b), dot(normal, c), dot(normal, d)
        t, u, v, w = 1.0 - dot(a, b), 1.0 - dot(b, c), 1.0 - dot(c, d), 1.0 - dot(d, a)
        total = (
            _arc_over_sine(t) * dot(normal, cross(a, b))
            + _arc_over_sine(u) * dot(normal, cross(b, c))
            + _arc_over_sine(v) * dot(normal, cross(c, d))
            + _arc_over_sine(w) * dot(normal, cross(d, a))
        )
        lowest = smaller(smaller(p, q), smaller(r, s))
        narrow = smaller(smaller(-t, -u), smaller(-v, -w)) >= -_LARGE_ANGLE
        value = 0.5 * abs(total) / light.size
        value = value if lowest >= 0.0 and narrow else _CUT
        highest = -smaller(smaller(-p, -q), smaller(-r, -s))
        put(block.values, i, 0.0 if highest <= 0.0 else value)


@inlined
def _whole_irradiance(block, n, light):
    """Write the irradiance of n pixels, or `_CUT`."""
    if light.kind == DIRECTIONAL and light.form != QUAD:
        _whole_suns(block, n, light)
    elif light.kind == SPHERE or light.form == POINT:
        _whole_spheres(block, n, light)
    elif light.form == DISK:
        _whole_disks(block, n, light)
    else:
        _whole_quads(block, n, light)


@kernel
def _irradiance_kernel(ticket, position, normal, side, light, out):
    positions, normals, sides, irradiances = ptr(position), ptr(normal), ptr(side), ptr(out)
    block = _Block(stack_f32(_PLANES), stack_f32(_PLANES), stack_f64(_BLOCK))
    for first, end in shares(ticket):
        deinterleave(positions, 3 * first, end - first, block.positions, 0, _BLOCK)
        deinterleave(normals, 3 * first, end - first, block.normals, 0, _BLOCK)
        _whole_irradiance(block, end - first, light)
        for i in range(first, end):
            e = get(block.values, i - first)
            if get(sides, i) == NOTHING:
                e = 0.0
            elif not e >= 0.0:
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
    ticket = new_ticket(out.size, _BLOCK)
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
