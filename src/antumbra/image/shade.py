"""Simple shading: diffuse surfaces, light falloff, visibility from the query, and a little ambient light.

Ambient occlusion scales the ambient light; lists of point lights come from `image.point_lights`.
"""

import numpy as np

from ..jit import kernel
from ..parallel import CHUNK, N, new_ticket, run, take, thread_count
from ..query.receivers import NOTHING
from ..query.samples import patch_at, sample_point
from ..scene.lights import DIRECTIONAL
from .filter import smoothed
from .point_lights import list_irradiance

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
                    patch = patch_at(light, px, py, pz, np.float64(nx), np.float64(ny), np.float64(nz))
                    for s in range(len(points)):
                        lx, ly, lz = sample_point(patch, points[s, 0], points[s, 1], 0.0)
                        total += _point_irradiance(light, flat, px, py, pz, nx, ny, nz, lx, ly, lz)
                out[y, x] = np.float32(total / len(points))
        y0 = take(ticket)


def arriving(gbuffer, light, query, bits, seen=None, threads=None) -> np.ndarray:
    """What a light gives to each pixel's surface, as `shade` takes it.

    (H, W, 3) float32 of `PointLights`, shadows included; (H, W) float32 of other lights, if nothing were in the way and
    their intensity 1. Ambient occlusion gives nothing by itself. With ``seen``, of the same G-buffer, what comes from
    interleaved lists is smoothed.
    """
    if light.domain == "list":
        arrived = list_irradiance(gbuffer, light, query.samples, bits, threads)
        return arrived if seen is None or not light.interleave else smoothed(seen, arrived, threads)
    if light.domain == "hemisphere":
        return np.zeros(gbuffer.face.shape, np.float32)
    return irradiance(gbuffer, query.light, light.domain, threads)


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
def _shade_rows(ticket, face, normal, up, colour, tints, irradiances, visibility, ambient, open_sky, more, image):
    inverse_pi = np.float32(1.0 / np.pi)
    y0 = take(ticket)
    while y0 >= 0:
        for y in range(y0, min(y0 + ticket[CHUNK], ticket[N])):
            for x in range(face.shape[1]):
                i = face[y, x]
                sky = (_SIDEWAYS + (_ONE - _SIDEWAYS) * normal[y, x, up]) * open_sky[y, x]
                for c in range(3):
                    light = ambient[c] * sky
                    for k in range(len(tints)):
                        light += irradiances[k, y, x] * visibility[k, y, x] * tints[k, c]
                    for k in range(len(more)):
                        light += more[k, y, x, c]
                    image[y, x, c] = light * colour[i, c] * inverse_pi if i >= 0 else np.float32(0.0)
        y0 = take(ticket)


def shade(gbuffer, colour, lights, arrived, visibility, ambient, up="y", threads=None) -> np.ndarray:
    """(H, W, 3) float32 linear radiance of diffuse surfaces; 0 where nothing is seen.

    colour : (n, 3) float32, of each face
    lights : lights; arrived : of each from `arriving`; visibility : (H, W) float32 of each
    ambient : (3,) float32, from `ambient_light` of the whole picture
    up : "y" or "z", where most of the ambient light comes from
    """
    shape, shining = gbuffer.face.shape, _shining(lights)
    irradiances, shadows = (_stack([of[k] for k in shining], shape) for of in (arrived, visibility))
    more = _stack([arrived[k] for k, light in enumerate(lights) if light.domain == "list"], (*shape, 3))
    skies = [visibility[k] for k, light in enumerate(lights) if light.domain == "hemisphere"]
    open_sky, tints = _stack(skies, shape).prod(0), _tints([lights[k] for k in shining])
    image = np.empty((*shape, 3), np.float32)
    args = gbuffer.face, gbuffer.normal, "xyz".index(up), colour, tints, irradiances
    ticket = new_ticket(len(image), 8)
    run(_shade_rows, thread_count(threads), ticket, *args, shadows, ambient, open_sky, more, image)
    return image


def ambient_light(gbuffer, lights, arrived) -> np.ndarray:
    """(3,) float32: the ambient irradiance of a picture, by what arrives on average; see AMBIENT.

    Where the lights hold indirect light, there is no other; where they are ambient occlusion only, it is 1.
    """
    skies = _tints([light for light in lights if light.domain == "hemisphere"]).prod(0)
    if any(getattr(light, "indirect", False) for light in lights):
        return np.zeros(3, np.float32)
    if all(light.domain == "hemisphere" for light in lights):
        return skies
    shape, shining = gbuffer.face.shape, _shining(lights)
    total = _stack([arrived[k] for k in shining], shape).sum(axis=(1, 2), dtype=np.float64)
    total = total @ _tints([lights[k] for k in shining])
    for k, light in enumerate(lights):
        if light.domain == "list":
            total += arrived[k].sum(axis=(0, 1), dtype=np.float64)
    return (AMBIENT * total / max(1, np.count_nonzero(gbuffer.side != NOTHING)) * skies).astype(np.float32)


def _shining(lights) -> list[int]:
    """Which lights shine as one, dimmed by their visibility."""
    return [k for k, light in enumerate(lights) if light.domain not in ("hemisphere", "list")]


def _tints(lights) -> np.ndarray:
    """(k, 3) float32: colours times intensities."""
    return np.array([s.intensity * np.asarray(s.colour) for s in lights], np.float32).reshape(-1, 3)


def _stack(images, shape) -> np.ndarray:
    """(k, *shape) float32, also of none."""
    return np.stack(images) if images else np.empty((0, *shape), np.float32)
