"""Shading by lists of lights. Each sample is a light of its own, so shading needs every single bit."""

import numpy as np

from ..kernels.jit import kernel
from ..kernels.parallel import items, new_ticket, run, thread_count
from ..query.receivers import NOTHING
from ..scene.light_lists import PointLights
from .terminator import facing_of, softened


@kernel
def _falloff(wx, wy, wz, nx, ny, nz, mx, my, mz, facing, least):
    """Irradiance per candela at a surface with normal n from a light at offset w.

    If `facing`, the light shines by the cosine around m. The distance squared is clamped to at least `least`.
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
def _rows(ticket, gbuffer, surface, points, distant, normals, candela, least, bits, out):
    facing, (normal, geometric, bend, soft) = len(normals) > 0, surface
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
                for s in range(points.shape[1]):
                    if bits[y, x, s >> 6] >> np.uint64(s & 63) & np.uint64(1):
                        continue
                    wx, wy, wz = points[k, s, 0] - px, points[k, s, 1] - py, points[k, s, 2] - pz
                    if facing:
                        mx, my, mz = normals[k, s, 0], normals[k, s, 1], normals[k, s, 2]
                    e = _falloff(wx, wy, wz, nx, ny, nz, mx, my, mz, facing, least)
                    if soft:
                        e *= softened((gx, gy, gz), (nx, ny, nz), bend[y, x], (wx, wy, wz))
                    red += e * candela[k, s, 0]
                    green += e * candela[k, s, 1]
                    blue += e * candela[k, s, 2]
            out[y, x, 0], out[y, x, 1], out[y, x, 2] = np.float32(red), np.float32(green), np.float32(blue)


def list_irradiance(gbuffer, lights, samples, bits, shading=None, threads=None) -> np.ndarray:
    """(H, W, 3) float32: irradiance of each pixel's surface from a list of lights, shadows included; else 0.

    Distant lights are unit vectors: `_falloff` at the origin gives their cosine.

    shading : ShadingNormals; None: the geometric normals
    samples : (16, n, 3) float64 from `light_samples`; bits : (H, W, ceil(n / 64)) uint64, the answer of their query
    """
    out = np.empty((*gbuffer.face.shape, 3), np.float32)
    near = isinstance(lights, PointLights)
    normals, least = (lights.normals, lights.nearest**2) if near else (None, 0.0)
    normals = np.empty((0, 0, 3)) if normals is None else np.ascontiguousarray(normals[lights.sets])
    points = samples - gbuffer.origin if near else samples
    args = gbuffer, facing_of(gbuffer, shading), points, not near, normals, lights.weights(), least, bits, out
    run(_rows, thread_count(threads), new_ticket(len(out), 4), *args)
    return out
