"""Simple shading: diffuse surfaces, light falloff, visibility from the query, and a little ambient light."""

import numpy as np

from ..jit import kernel
from ..parallel import CHUNK, N, new_ticket, run, take, thread_count
from ..query.receivers import NOTHING
from ..query.samples import patch_at, sample_point
from ..scene.lights import DIRECTIONAL

AMBIENT = 0.12
"""Ambient irradiance as a share of the mean direct irradiance that the seen surfaces would get without shadows."""

_ONE, _SIDEWAYS = np.float32(1.0), np.float32(0.65)
"""Share of the ambient light that reaches surfaces that face up, and sideways; those that face down get the least."""

_CROSS = np.array([[0.3, 0.1], [0.9, 0.3], [0.7, 0.9], [0.1, 0.7]])
_POINTS = {"square": _CROSS, "disk": (2.0 * _CROSS - 1.0) * 0.8, "point": np.zeros((1, 2))}
"""By domain: points (a, b) that stand for all of a light."""


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
                    px, py, pz = position[y, x, 0], position[y, x, 1], position[y, x, 2]
                    nx, ny, nz = normal[y, x, 0], normal[y, x, 1], normal[y, x, 2]
                    patch = patch_at(light, px, py, pz)
                    for s in range(len(points)):
                        lx, ly, lz = sample_point(patch, points[s, 0], points[s, 1])
                        total += _point_irradiance(light, flat, px, py, pz, nx, ny, nz, lx, ly, lz)
                out[y, x] = np.float32(total / len(points))
        y0 = take(ticket)


def irradiance(gbuffer, patch, domain, threads=None) -> np.ndarray:
    """(H, W) float32: what each pixel's surface would get of a light of intensity 1 if nothing were in the way.

    patch : LightPatch; domain : the light's, of which a few points stand for the light
    """
    flat = np.cross(patch.u, patch.v) if patch.kind != DIRECTIONAL else np.zeros(3)
    length = np.linalg.norm(flat)
    flat = flat / length if length > 0 else np.zeros(3)
    out = np.empty(gbuffer.face.shape, np.float32)
    ticket = new_ticket(len(out), 8)
    args = gbuffer.position, gbuffer.normal, gbuffer.side, patch, flat, _POINTS[domain], out
    run(_irradiance_rows, thread_count(threads), ticket, *args)
    return out


@kernel
def _shade_rows(ticket, face, normal, up, colour, tints, irradiances, visibility, ambient, image):
    inverse_pi = np.float32(1.0 / np.pi)
    y0 = take(ticket)
    while y0 >= 0:
        for y in range(y0, min(y0 + ticket[CHUNK], ticket[N])):
            for x in range(face.shape[1]):
                i = face[y, x]
                sky = _SIDEWAYS + (_ONE - _SIDEWAYS) * normal[y, x, up]
                for c in range(3):
                    light = ambient[c] * sky
                    for k in range(len(tints)):
                        light += irradiances[k, y, x] * visibility[k, y, x] * tints[k, c]
                    image[y, x, c] = light * colour[i, c] * inverse_pi if i >= 0 else np.float32(0.0)
        y0 = take(ticket)


def ambient_light(gbuffer, lights, irradiances) -> np.ndarray:
    """(3,) float32: the ambient irradiance of a picture; see AMBIENT."""
    mean = np.stack(irradiances).sum(axis=(1, 2), dtype=np.float64) / max(1, np.count_nonzero(gbuffer.side != NOTHING))
    return (AMBIENT * mean @ _tints(lights)).astype(np.float32)


def _tints(lights) -> np.ndarray:
    return np.array([np.asarray(s.colour, np.float32) * np.float32(s.intensity) for s in lights])


def shade(gbuffer, colour, lights, irradiances, visibility, ambient, up="y", threads=None) -> np.ndarray:
    """(H, W, 3) float32 linear radiance of diffuse surfaces; 0 where nothing is seen.

    colour : (n, 3) float32, of each face
    lights : objects with `intensity` and `colour`; irradiances, visibility : (H, W) float32 for each
    ambient : (3,) float32, from `ambient_light` of the whole picture
    up : "y" or "z", where most of the ambient light comes from
    """
    irradiances, visibility = np.stack(irradiances), np.stack(visibility)
    image = np.empty((*gbuffer.face.shape, 3), np.float32)
    args = (
        gbuffer.face,
        gbuffer.normal,
        "xyz".index(up),
        colour,
        _tints(lights),
        irradiances,
        visibility,
        ambient,
        image,
    )
    run(_shade_rows, thread_count(threads), new_ticket(len(image), 8), *args)
    return image
