"""Irradiance from lists of lights at the surfaces of pixels, with shadows: a sample is a light, so its bit is needed.

Eight neighbouring pixels are shaded together. Their sample sets repeat every four columns, so the lights of a row of
pixels are vectors that are the same for all groups of eight.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..kernels.exact.filters import dot
from ..kernels.jit import F32Ptr, I32Ptr, inlined, kernel
from ..kernels.parallel import items, new_ticket, run, thread_count
from ..kernels.simd import (
    any_lane,
    as_i32,
    gather,
    get,
    iota8,
    load8,
    minimum,
    ptr,
    ptr_at,
    put,
    select,
    splat8,
    square_root,
    store,
)
from ..query.gbuffer import GBuffer
from ..query.receivers import NOTHING
from ..query.shadow_query import ShadingNormals
from ..query.surface_links import deinterleave, interleave
from ..scene.light_lists import LightList, PointLights
from ..trace.transmission import TracedQuery, TransmissionPointers, transmission_pointers
from .irradiance import pixel_normals, terminator_factor

# mypy: disable-error-code="call-arg, var-annotated"
# (mypy counts the typing context among the arguments of intrinsics)

_LANES = 8
_ZERO, _ONE = np.float32(0.0), np.float32(1.0)

# --- The lights of a list, as vectors of eight pixels -----------------------------------------------------------------

_POINT, _ROUNDED, _NORMAL, _CANDELA, _FIELDS = 0, 3, 6, 9, 12
"""Vectors of a light: position or direction, rounding error of that, normal, and red, green and blue candela."""


class ListedLights(NamedTuple):
    """A list of lights, for kernels."""

    vectors: np.ndarray  # (4, n, _FIELDS, 8) float32: for rows y mod 4 of pixels, n samples
    distant: bool  # whether the lights have directions instead of positions
    facing: bool  # whether the lights have normals, around which their light falls off by the cosine
    least: np.float32  # squared distances are clamped to at least this


class ListFields(NamedTuple):
    """The numbers of a list of lights, set by set."""

    values: NDArray[np.float64]  # (16, n, _FIELDS): the fields of the lights of each set
    distant: bool  # as in `ListedLights`
    facing: bool
    least: float


def list_fields(lights: LightList, samples: NDArray[np.float64], origin: NDArray[np.float64]) -> ListFields:
    """The fields of the lights of a list with these samples, (16, n, 3), in a frame with this origin."""
    values = np.zeros((16, samples.shape[1], _FIELDS))
    values[..., _CANDELA:] = lights.weights()
    distant, facing, least = True, False, 0.0
    points = samples
    if isinstance(lights, PointLights):
        distant, facing, least = False, lights.normals is not None, lights.nearest**2
        points = samples - origin
        if lights.normals is not None:
            values[..., _NORMAL:_CANDELA] = lights.normals[lights.sets]
    values[..., _POINT:_ROUNDED] = points
    values[..., _ROUNDED:_NORMAL] = points - points.astype(np.float32)
    return ListFields(values, distant, facing, least)


def _listed_lights(lights: LightList, samples: NDArray[np.float64], origin: NDArray[np.float64]) -> ListedLights:
    """The lights of a list as vectors."""
    values, distant, facing, least = list_fields(lights, samples, origin)
    by_row = values.reshape(4, 4, -1, _FIELDS).transpose(0, 2, 3, 1).astype(np.float32)  # the columns x mod 4 last
    return ListedLights(np.ascontiguousarray(np.tile(by_row, 2)), distant, facing, np.float32(least))


# --- Eight pixels -----------------------------------------------------------------------------------------------------

_WIDE = 10  # planes of a row of surfaces: normal, position, geometric normal, and bend


class _Row(NamedTuple):
    """The surfaces of a row of pixels, deinterleaved; elements beyond its end are undefined."""

    planes: F32Ptr  # the `_WIDE` planes, then three for the irradiance
    step: int  # elements of a plane


class _Light(NamedTuple):
    """What the bits of eight pixels let pass, as pointers."""

    bits: I32Ptr  # the bits, as words of 32
    words: int  # of a pixel
    through: TransmissionPointers


@inlined
def _triple(row, plane, x):
    at = plane * row.step + x
    return load8(row.planes, at), load8(row.planes, at + row.step), load8(row.planes, at + 2 * row.step)


@inlined
def _light_vector(vectors, at, field):
    at = (at + field) * _LANES
    return load8(vectors, at), load8(vectors, at + _LANES), load8(vectors, at + 2 * _LANES)


@inlined
def _towards(lights, vectors, at, p):
    """The vectors from p to the lights of eight pixels."""
    q = _light_vector(vectors, at, _POINT)
    if lights.distant:
        return q
    e = _light_vector(vectors, at, _ROUNDED)
    return (q[0] - p[0]) + e[0], (q[1] - p[1]) + e[1], (q[2] - p[2]) + e[2]


@inlined
def _falloff(lights, vectors, at, n, w):
    """Irradiance per candela at surfaces with normals n from lights at offsets w."""
    cosine = dot(n, w)
    if lights.distant:
        return select(cosine > _ZERO, cosine, _ZERO)
    r2 = dot(w, w)
    r = square_root(r2)
    value = cosine / (r * select(r2 > lights.least, r2, lights.least))
    if lights.facing:
        emitted = dot(_light_vector(vectors, at, _NORMAL), w) / r
        value = select(emitted < _ZERO, value * (_ZERO - emitted), _ZERO)
    return select((r2 > _ZERO) & (cosine > _ZERO), value, _ZERO)


@inlined
def _passing(light, rows, s, c):
    """The share of channel c that arrives at eight pixels from sample s, if it is not occluded."""
    through = light.through
    at = (select(rows >= 0, rows, 0) * through.spp + s) * through.channels + min(c, through.channels - 1)
    return select(rows >= 0, gather(through.values, at), _ONE)


@inlined
def _shade_eight(lights, row, at, light, soft):
    """The red, green and blue irradiance of eight pixels: `at`, from column x on, in rows y mod 4 = `phase`."""
    (pixels, x, phase), n_lights = at, lights.vectors.shape[1]
    n, p = _triple(row, 0, x), _triple(row, 3, x)
    red, green, blue, hidden = splat8(_ZERO), splat8(_ZERO), splat8(_ZERO), splat8(0)
    rows = gather(as_i32(light.through.rows), pixels) if light.through.n > 0 else splat8(-1)
    if not any_lane(dot(n, n) > _ZERO):  # no surfaces
        return red, green, blue
    vectors = ptr_at(lights.vectors, phase * n_lights * _FIELDS * _LANES)
    for s in range(n_lights):
        hidden = gather(light.bits, pixels * light.words + (s >> 5)) if s & 31 == 0 else hidden >> 1
        lit, first = (hidden & 1) == 0, s * _FIELDS
        if not any_lane(lit):
            continue
        w = _towards(lights, vectors, first, p)
        e = select(lit, _falloff(lights, vectors, first, n, w), _ZERO)
        if soft:
            e = e * terminator_factor(_triple(row, 6, x), n, load8(row.planes, 9 * row.step + x), w)
        r, g, b = _light_vector(vectors, first, _CANDELA)
        if any_lane(rows >= 0):
            r, g = r * _passing(light, rows, s, 0), g * _passing(light, rows, s, 1)
            b = b * _passing(light, rows, s, 2)
        red, green, blue = red + e * r, green + e * g, blue + e * b
    return red, green, blue


# --- Rows of pixels ---------------------------------------------------------------------------------------------------


@inlined
def _load_row(gbuffer, surface, y, row):
    """Deinterleave the surfaces of a row; pixels without one get normals of zero, and so no light."""
    w = gbuffer.side.shape[1]
    at, sides, bends = y * w, ptr(gbuffer.side), ptr(surface.bend)
    deinterleave(ptr(surface.normal), 3 * at, w, row.planes, 0, row.step)
    deinterleave(ptr(gbuffer.position), 3 * at, w, row.planes, 3 * row.step, row.step)
    if surface.soft:
        deinterleave(ptr(surface.geometric), 3 * at, w, row.planes, 6 * row.step, row.step)
        for x in range(w):
            put(row.planes, 9 * row.step + x, get(bends, at + x))
    for x in range(w):
        for c in range(3):
            normal = get(row.planes, c * row.step + x)
            put(row.planes, c * row.step + x, normal if get(sides, at + x) != NOTHING else _ZERO)


@kernel
def _list_rows(ticket, gbuffer, surface, lights, bits, light, out, scratch):
    """Worker: shade rows of pixels. `scratch`: the thread's memory for a `_Row`."""
    (h, w), step = gbuffer.side.shape, len(scratch) // (_WIDE + 3)
    row, passing = _Row(ptr(scratch), step), _Light(as_i32(ptr(bits)), 2 * bits.shape[2], transmission_pointers(light))
    colours, last = ptr_at(scratch, _WIDE * step), h * w - 1
    for y in items(ticket):
        _load_row(gbuffer, surface, y, row)
        for x in range(0, w, _LANES):
            pixels = minimum(iota8() + (y * w + x), last)
            red, green, blue = _shade_eight(lights, row, (pixels, x, y & 3), passing, surface.soft)
            store(colours, x, red)
            store(colours, step + x, green)
            store(colours, 2 * step + x, blue)
        interleave(colours, 0, step, w, ptr(out), 3 * y * w)


def list_irradiance(
    gbuffer: GBuffer,
    lights: LightList,
    traced: TracedQuery,
    shading: ShadingNormals | None = None,
    threads: int | None = None,
) -> NDArray[np.float32]:
    """(H, W, 3) float32: irradiance of each pixel's surface from a list of lights, with shadows; 0 in the background.

    traced : the query of the list's samples, and its answer
    shading : None: geometric normals
    """
    h, w = gbuffer.face.shape
    out = np.empty((h, w, 3), np.float32)
    listed = _listed_lights(lights, traced.query.samples, gbuffer.origin)
    scratch = lambda: (np.empty((_WIDE + 3) * (w + _LANES), np.float32),)
    args = gbuffer, pixel_normals(gbuffer, shading), listed, traced.bits, traced.through, out
    run(_list_rows, thread_count(threads), new_ticket(h, 4), *args, own=scratch)
    return out
