"""Simple shading: diffuse surfaces, light falloff, visibility from the query, and a little ambient light.

Ambient occlusion scales the ambient light; lists of point lights come from `image.point_lights`.
"""
# mypy: disable-error-code="call-arg, var-annotated"
# (mypy counts the typing context among the arguments of intrinsics)

from typing import NamedTuple

import numpy as np

from ..kernels.jit import inlined, kernel
from ..kernels.parallel import CHUNK, N, new_ticket, run, take, thread_count
from ..kernels.simd import get, ptr, ptr_at, put
from ..query.receivers import NOTHING
from .filter import smoothed
from .irradiance import irradiance
from .point_lights import list_irradiance

AMBIENT = 0.12
"""Ambient irradiance as a share of the mean direct irradiance that the seen surfaces would get without shadows."""

_ONE, _SIDEWAYS = np.float32(1.0), np.float32(0.65)
"""Share of the ambient light that reaches surfaces that face up, and sideways; those that face down get the least."""


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


class _Rows(NamedTuple):
    """What `shade` adds up: pointers to float32, and how many images each has."""

    tints: object  # 3 a light
    irradiances: object  # of each light (H, W)
    visibility: object  # of each light (H, W)
    n: int  # lights
    skies: object  # of each ambient occlusion (H, W)
    n_skies: int
    more: object  # of each list of lights (H, W, 3)
    n_more: int
    step: int  # H W


@inlined
def _light_row(rows, normal, up, ambient, start, w, sums):
    """The light of w pixels from pixel `start` on: their reds, greens, blues. LLVM makes vectors of these loops."""
    for x in range(w):
        open_sky = _ONE
        for k in range(rows.n_skies):
            open_sky *= get(rows.skies, k * rows.step + start + x)
        sky = (_SIDEWAYS + (_ONE - _SIDEWAYS) * get(normal, 3 * (start + x) + up)) * open_sky
        for c in range(3):
            put(sums, c * w + x, ambient[c] * sky)
    for k in range(rows.n):
        at = k * rows.step + start
        irradiance, share = ptr_at(rows.irradiances, at), ptr_at(rows.visibility, at)
        for c in range(3):
            tint = get(rows.tints, 3 * k + c)
            for x in range(w):
                put(sums, c * w + x, get(sums, c * w + x) + get(irradiance, x) * get(share, x) * tint)
    for k in range(rows.n_more):
        for x in range(w):
            for c in range(3):
                put(sums, c * w + x, get(sums, c * w + x) + get(rows.more, 3 * (k * rows.step + start + x) + c))


@kernel
def _shade_rows(ticket, face, normal, up, colour, tints, irradiances, visibility, ambient, skies, more, image, sums):
    """Worker: rows of pixels; `sums`: the thread's own memory for the colours of one."""
    h, w = face.shape
    rows = _Rows(
        ptr(tints), ptr(irradiances), ptr(visibility), len(tints), ptr(skies), len(skies), ptr(more), len(more), h * w
    )
    faces, normals, colours, out = ptr(face), ptr(normal), ptr(colour), ptr(image)
    inverse_pi = np.float32(1.0 / np.pi)
    ambient = (ambient[0], ambient[1], ambient[2])
    y0 = take(ticket)
    while y0 >= 0:
        for y in range(y0, min(y0 + ticket[CHUNK], ticket[N])):
            _light_row(rows, normals, up, ambient, y * w, w, ptr(sums))
            for x in range(w):
                at, i = 3 * (y * w + x), np.int64(get(faces, y * w + x))
                for c in range(3):
                    shown = sums[c * w + x] * get(colours, 3 * max(i, 0) + c) * inverse_pi  # type: ignore[operator]
                    put(out, at + c, shown if i >= 0 else np.float32(0.0))
        y0 = take(ticket)


def shade(gbuffer, colour, lights, arrived, visibility, ambient, up="y", indirect=None, threads=None) -> np.ndarray:
    """(H, W, 3) float32 linear radiance of diffuse surfaces; 0 where nothing is seen.

    colour : (n, 3) float32, of each face
    lights : lights; arrived : of each from `arriving`; visibility : (H, W) float32 of each
    ambient : (3,) float32, from `ambient_light` of the whole picture
    up : "y" or "z", where most of the ambient light comes from
    indirect : (H, W, 3) float32, irradiance that comes on top; None: none
    """
    shape, shining = gbuffer.face.shape, _shining(lights)
    irradiances, shadows = (_stack([of[k] for k in shining], shape) for of in (arrived, visibility))
    lists = [arrived[k] for k, light in enumerate(lights) if light.domain == "list"]
    more = _stack(lists if indirect is None else [*lists, indirect], (*shape, 3))
    skies = _stack([visibility[k] for k, light in enumerate(lights) if light.domain == "hemisphere"], shape)
    tints = _tints([lights[k] for k in shining])
    image = np.empty((*shape, 3), np.float32)
    args = gbuffer.face, gbuffer.normal, "xyz".index(up), colour, tints, irradiances
    ticket = new_ticket(len(image), 8)
    own = lambda: (np.empty(3 * shape[1], np.float32),)
    run(_shade_rows, thread_count(threads), ticket, *args, shadows, ambient, skies, more, image, own=own)
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
    """(k, *shape) float32, also of none; one is not copied."""
    if len(images) == 1:
        return images[0][None]
    return np.stack(images) if images else np.empty((0, *shape), np.float32)
