"""Diffuse shading with ambient light.

A surface shows its base colour times the share of each light's irradiance that arrives, plus a little ambient light,
which ambient occlusion scales. `picture.irradiance` and `picture.light_list_irradiance` have the irradiance.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..kernels.jit import F32Ptr, inlined, kernel
from ..kernels.parallel import items, new_ticket, run, thread_count
from ..kernels.simd import get, ptr, ptr_at, put
from ..query.gbuffer import GBuffer
from ..query.receivers import NOTHING
from ..query.shadow_query import ShadingNormals
from ..query.surface_links import PictureSurfaces
from ..scene.light_lists import LightList
from ..scene.lights import Light, is_indirect
from ..trace.transmission import TracedQuery
from .discontinuity_filter import smooth_irradiance
from .irradiance import irradiance
from .light_list_irradiance import list_irradiance

# --- Diffuse shading --------------------------------------------------------------------------------------------------

# mypy: disable-error-code="call-arg, var-annotated"
# (mypy counts the typing context among the arguments of intrinsics)


AMBIENT = 0.12
"""Ambient irradiance as a share of the mean unoccluded direct irradiance of the visible surfaces."""

_ONE, SIDEWAYS = np.float32(1.0), np.float32(0.65)
"""Shares of the ambient light that surfaces get if they face up, and if they face sideways."""


def arriving_irradiance(
    gbuffer: GBuffer,
    light: Light,
    traced: TracedQuery,
    surfaces: PictureSurfaces | None = None,
    shading: ShadingNormals | None = None,
    threads: int | None = None,
) -> NDArray[np.float32]:
    """Irradiance of each pixel's surface from a light, as input of `shade`; `shading`: None for geometric normals.

    - Lists of lights: (H, W, 3) float32, with shadows. With `surfaces`, those of the G-buffer, the irradiance from
      interleaved lists is smoothed.
    - Ambient occlusion: zeros, (H, W) float32.
    - Other lights: (H, W) float32, unshadowed and for intensity 1.
    """
    if isinstance(light, LightList):
        arrived = list_irradiance(gbuffer, light, traced, shading, threads)
        return arrived if surfaces is None or not light.interleave else smooth_irradiance(surfaces, arrived, threads)
    if light.domain == "hemisphere":
        return np.zeros(gbuffer.face.shape, np.float32)
    return irradiance(gbuffer, traced.query.light, light.domain, shading, threads)


class _Rows(NamedTuple):
    """The images that `shade` adds up, as pointers, and their counts."""

    tints: F32Ptr  # float32 *, (n, 3): colour times intensity of each light
    irradiances: F32Ptr  # float32 *, (n, H, W): unoccluded irradiance of each light
    shares: F32Ptr  # float32 *, (n, H, W): share of it that arrives
    n: int  # number of lights
    skies: F32Ptr  # float32 *, (n_skies, H, W): visible fraction of each ambient occlusion
    n_skies: int
    more: F32Ptr  # float32 *, (n_more, H, W, 3): irradiance of each list of lights, and indirect irradiance
    n_more: int
    step: int  # number of pixels, H W


@inlined
def _light_row(rows, normal, up, ambient, start, w, sums):
    """Sum the light of w pixels from pixel `start` on, as w reds, w greens, w blues. LLVM vectorises these loops."""
    for x in range(w):
        open_sky = _ONE
        for k in range(rows.n_skies):
            open_sky *= get(rows.skies, k * rows.step + start + x)
        sky = (SIDEWAYS + (_ONE - SIDEWAYS) * get(normal, 3 * (start + x) + up)) * open_sky
        for c in range(3):
            put(sums, c * w + x, ambient[c] * sky)
    for k in range(rows.n):
        at = k * rows.step + start
        irradiance, share = ptr_at(rows.irradiances, at), ptr_at(rows.shares, at)
        for c in range(3):
            tint = get(rows.tints, 3 * k + c)
            for x in range(w):
                put(sums, c * w + x, get(sums, c * w + x) + get(irradiance, x) * get(share, x) * tint)
    for k in range(rows.n_more):
        for x in range(w):
            for c in range(3):
                put(sums, c * w + x, get(sums, c * w + x) + get(rows.more, 3 * (k * rows.step + start + x) + c))


class _Pixels(NamedTuple):
    """The surfaces of a picture that are shaded."""

    face: np.ndarray  # (H, W) int32
    normal: np.ndarray  # (H, W, 3) float32
    up: int  # the axis that points up
    colour: np.ndarray  # (n, 3) float32, of each face


class _Arrays(NamedTuple):
    """The images that `_Rows` points to, and the ambient light."""

    tints: np.ndarray
    irradiances: np.ndarray
    shares: np.ndarray
    skies: np.ndarray
    more: np.ndarray
    ambient: np.ndarray  # (3,) float32


@kernel
def _shade_rows(ticket, pixels, light, image, sums):
    """Worker: shade rows of pixels."""
    # In: pixels, `_Pixels`; light, `_Arrays`. Out: image, (H, W, 3) float32. Scratch: sums, (3 W,) float32 per thread
    h, w = pixels.face.shape
    rows = _Rows(
        ptr(light.tints),
        ptr(light.irradiances),
        ptr(light.shares),
        len(light.tints),
        ptr(light.skies),
        len(light.skies),
        ptr(light.more),
        len(light.more),
        h * w,
    )
    faces, normals, colours, out = ptr(pixels.face), ptr(pixels.normal), ptr(pixels.colour), ptr(image)
    inverse_pi = np.float32(1.0 / np.pi)
    ambient = (light.ambient[0], light.ambient[1], light.ambient[2])
    for y in items(ticket):
        _light_row(rows, normals, pixels.up, ambient, y * w, w, ptr(sums))
        for x in range(w):
            at, i = 3 * (y * w + x), get(faces, y * w + x)
            for c in range(3):
                radiance = sums[c * w + x] * get(colours, 3 * max(i, 0) + c) * inverse_pi
                put(out, at + c, radiance if i >= 0 else np.float32(0.0))


class Illumination(NamedTuple):
    """The light that reaches the surfaces of a picture."""

    lights: Sequence[Light]
    arrived: Sequence[np.ndarray]  # per light the result of `arriving_irradiance`
    shares: Sequence[np.ndarray]  # per light (H, W) or (H, W, 3) float32, from `picture.light_visibility`
    ambient: np.ndarray  # (3,) float32, from `ambient_light` of the whole picture
    indirect: np.ndarray | None = None  # (H, W, 3) float32, additional irradiance

    def only(self, numbers: Sequence[int]) -> "Illumination":
        """Some of the lights, with the ambient and indirect light."""
        lights, arrived, shares = self.lights, self.arrived, self.shares
        chosen = [lights[k] for k in numbers], [arrived[k] for k in numbers], [shares[k] for k in numbers]
        return Illumination(*chosen, self.ambient, self.indirect)


def shade(
    gbuffer: GBuffer, colour: np.ndarray, illumination: Illumination, up: str = "y", threads: int | None = None
) -> NDArray[np.float32]:
    """(H, W, 3) float32: linear radiance of diffuse surfaces; 0 in the background.

    colour : (n, 3) float32, the colour of each face
    up : "y" or "z", the axis from which most of the ambient light comes
    """
    lights, arrived, shares, ambient, indirect = illumination
    shape = gbuffer.face.shape
    shining = [k for k in _shining(lights) if shares[k].ndim == 2]
    irradiances, arriving_shares = (_stack([of[k] for k in shining], shape) for of in (arrived, shares))
    coloured = [_coloured(lights[k], arrived[k], shares[k]) for k in _shining(lights) if shares[k].ndim == 3]
    lists = [arrived[k] for k, light in enumerate(lights) if light.domain == "list"]
    more = _stack([*coloured, *lists, *([] if indirect is None else [indirect])], (*shape, 3))
    skies = _stack([_grey(shares[k]) for k, light in enumerate(lights) if light.domain == "hemisphere"], shape)
    tints = _tints([lights[k] for k in shining])
    image = np.empty((*shape, 3), np.float32)
    pixels = _Pixels(gbuffer.face, gbuffer.normal, "xyz".index(up), colour)
    light = _Arrays(tints, irradiances, arriving_shares, skies, more, ambient)
    ticket = new_ticket(len(image), 8)
    scratch = lambda: (np.empty(3 * shape[1], np.float32),)
    run(_shade_rows, thread_count(threads), ticket, pixels, light, image, own=scratch)
    return image


@kernel
def _sum_rows(ticket, image, out):
    """Worker: sum each channel over rows of pixels: (h, w, c) -> (h, c) float64."""
    (w, channels), values = image.shape[1:], ptr(image)
    for y in items(ticket):
        for c in range(channels):
            even = odd = 0.0
            for x in range(0, w - 1, 2):
                even += np.float64(get(values, (y * w + x) * channels + c))
                odd += np.float64(get(values, (y * w + x + 1) * channels + c))
            if w & 1:
                even += np.float64(get(values, (y * w + w - 1) * channels + c))
            out[y, c] = even + odd


def _sums(image: np.ndarray, threads: int | None) -> NDArray[np.float64]:
    """(c,) float64: the sum of each channel of an image (H, W, c), or (1,) of an image (H, W)."""
    image = np.ascontiguousarray(image)
    image = image.reshape(*image.shape[:2], -1)
    out = np.empty((len(image), image.shape[2]))
    run(_sum_rows, thread_count(threads), new_ticket(len(image), 32), image, out)
    sums: NDArray[np.float64] = out.sum(0)
    return sums


def ambient_light(
    gbuffer: GBuffer, lights: Sequence[Light], arrived: Sequence[np.ndarray], threads: int | None = None
) -> NDArray[np.float32]:
    """(3,) float32: the ambient irradiance of a picture, from the mean irradiance of its surfaces; see AMBIENT.

    It is 0 if the lights include bounced light. Without light except ambient occlusion, it is the product of the
    ambient lights' colours and intensities.
    """
    open_skies = [light for light in lights if light.domain == "hemisphere"]
    skies: NDArray[np.float32] = _tints(open_skies).prod(0)
    if any(is_indirect(light) for light in lights):
        return np.zeros(3, np.float32)
    total = np.zeros(3)
    for light, image in zip(lights, arrived):
        if light.domain != "hemisphere":
            total += _sums(image, threads) * (1.0 if light.domain == "list" else _tints([light])[0])
    if open_skies and not total.any():
        return skies
    n = int(np.count_nonzero(gbuffer.side != NOTHING))
    ambient: np.ndarray = AMBIENT * total / max(1, n) * skies
    return ambient.astype(np.float32)


def _shining(lights: Sequence[Light]) -> list[int]:
    """Indices of the lights whose irradiance is multiplied by their shares."""
    return [k for k, light in enumerate(lights) if light.domain not in ("hemisphere", "list")]


def _coloured(light: Light, arrived: np.ndarray, share: np.ndarray) -> NDArray[np.float32]:
    """(H, W, 3) float32: the irradiance from a light that comes through coloured surfaces."""
    irradiance: NDArray[np.float32] = arrived[..., None] * share * _tints([light])[0]
    return irradiance


def _grey(share: np.ndarray) -> np.ndarray:
    """(H, W) float32: the mean of the channels of a share."""
    grey: np.ndarray = share if share.ndim == 2 else share.mean(-1)
    return grey


def _tints(lights: Sequence[Light]) -> NDArray[np.float32]:
    """(k, 3) float32: colours times intensities."""
    return np.array([s.intensity * np.asarray(s.colour) for s in lights], np.float32).reshape(-1, 3)


def _stack(images: Sequence[np.ndarray], shape: tuple[int, ...]) -> NDArray[np.float32]:
    """(k, *shape) float32: the images as one array, even if there are none. A single image is not copied."""
    if len(images) == 1:
        one: np.ndarray = images[0][None]
        return one
    return np.stack(images) if images else np.empty((0, *shape), np.float32)
