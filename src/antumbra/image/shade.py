"""Simple shading: diffuse surfaces, light falloff, visibility from the query, and a little ambient light."""

import numpy as np

from ..jit import kernel
from ..parallel import CHUNK, N, new_ticket, run, take, thread_count
from ..query.receivers import NOTHING
from ..query.samples import patch_at, sample_point
from ..scene.lights import DIRECTIONAL

AMBIENT = 0.12
"""Ambient irradiance as a share of the mean direct irradiance that the seen surfaces would get without shadows."""

_LIGHT_POINTS = 16  # points of a light that stand for all of it


@kernel
def _point_irradiance(light, flat, px, py, pz, nx, ny, nz, lx, ly, lz):
    """Irradiance per unit intensity at p (normal n) from light point l; `flat` is the unit normal of a flat light."""
    wx, wy, wz = lx - px, ly - py, lz - pz
    r2 = wx * wx + wy * wy + wz * wz
    if not r2 > 0.0:
        return 0.0
    r = np.sqrt(r2)
    cosine = (nx * wx + ny * wy + nz * wz) / r
    if not cosine > 0.0:
        return 0.0
    if light.kind == DIRECTIONAL:
        return cosine
    if flat[0] != 0.0 or flat[1] != 0.0 or flat[2] != 0.0:
        cosine *= abs(flat[0] * wx + flat[1] * wy + flat[2] * wz) / r
    return cosine / r2


@kernel
def _irradiance_rows(ticket, position, normal, side, light, flat, points, out):
    y0 = take(ticket)
    while y0 >= 0:
        for y in range(y0, min(y0 + ticket[CHUNK], ticket[N])):
            for x in range(side.shape[1]):
                total = 0.0
                if side[y, x] != NOTHING:
                    p, n = position[y, x], normal[y, x]
                    patch = patch_at(light, p[0], p[1], p[2])
                    for s in range(len(points)):
                        lx, ly, lz = sample_point(patch, points[s, 0], points[s, 1])
                        total += _point_irradiance(
                            light, flat, p[0], p[1], p[2], n[0], n[1], n[2], lx, ly, lz
                        )
                out[y, x] = np.float32(total / len(points))
        y0 = take(ticket)


def irradiance(gbuffer, patch, samples, threads=None) -> np.ndarray:
    """(H, W) float32: what each pixel's surface would get of a light of intensity 1 if nothing were in the way.

    patch : LightPatch; samples : (16, spp, 2) in the light's domain, of which some stand for the light
    """
    flat = np.cross(patch.u, patch.v) if patch.kind != DIRECTIONAL else np.zeros(3)
    length = np.linalg.norm(flat)
    flat = flat / length if length > 0 else np.zeros(3)
    points = np.ascontiguousarray(samples.reshape(-1, 2)[:: max(1, samples.size // 2 // _LIGHT_POINTS)])
    out = np.empty(gbuffer.face.shape, np.float32)
    ticket = new_ticket(len(out), 8)
    args = gbuffer.position, gbuffer.normal, gbuffer.side, patch, flat, points, out
    run(_irradiance_rows, thread_count(threads), ticket, *args)
    return out


def shade(gbuffer, colour, lights, irradiances, visibility, ambient=AMBIENT) -> np.ndarray:
    """(H, W, 3) float32 linear radiance of diffuse surfaces; 0 where nothing is seen.

    colour : (n, 3) float32, of each face
    lights : objects with `intensity` and `colour`; irradiances, visibility : (H, W) float32 for each
    """
    seen = gbuffer.side != NOTHING
    light = np.zeros((*seen.shape, 3), np.float32)
    everywhere = np.zeros(3)
    for source, e, v in zip(lights, irradiances, visibility):
        rgb = np.asarray(source.colour, np.float32) * np.float32(source.intensity)
        light += (e * v)[..., None] * rgb
        everywhere += (e.sum(dtype=np.float64) / max(1, np.count_nonzero(seen))) * rgb
    light += (ambient * everywhere).astype(np.float32)
    return np.where(seen[..., None], light * colour[gbuffer.face] * np.float32(1.0 / np.pi), np.float32(0.0))
