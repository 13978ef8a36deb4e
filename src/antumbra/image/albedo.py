"""The base colour that each pixel sees: of its face, or of its material, texture and colours of vertices."""

from concurrent.futures import ThreadPoolExecutor
from typing import NamedTuple

import numpy as np

from ..errors import InputError
from ..kernels.jit import inlined, kernel
from ..kernels.parallel import new_ticket, run, shares, thread_count
from ..kernels.predicate.filters import cross, dot
from ..kernels.simd import get, ptr, put
from ..query.shadow_query import three_at
from ..scene.appearance import Appearance
from ..scene.camera import CameraRays, ExplicitRays
from ..scene.materials import Texture
from .corners import Places, along, frame_of, minus, weights
from .texels import Pictures, looked_up, pictures_of

_FAR = 1e4  # heights of an orthographic picture
_GRAZING = 0.02  # a footprint is at most as stretched as at this cosine


class Paints(NamedTuple):
    """What faces of the scene show, for kernels."""

    colour: np.ndarray  # (m, 3) float32: of the triangles that `Places.face` indexes
    material: np.ndarray  # (n,) int32: of faces of the scene; -1: the face has its colour
    factors: np.ndarray  # (k, 3) float32: of materials
    texture: np.ndarray  # (k,) bool: whether the material's texture can be looked up
    textured: np.ndarray  # (n,) bool: whether the face shows it
    uv: np.ndarray  # (n, 3, 2) float32, or (0, 3, 2)
    colours: np.ndarray  # (n, 3, 4) float32, or (0, 3, 4)
    pictures: Pictures  # the texture of material i is picture i


class Eye(NamedTuple):
    """Where a picture is seen from."""

    x: float
    y: float
    z: float
    pixel: float  # width of a pixel at depth 1
    least: float  # and at depth 0


def eye_of(rays: CameraRays | ExplicitRays, parts: int) -> Eye:
    """The eye of a camera, in the frame of the triangles; `parts`: sub-pixels along a side of a pixel."""
    if isinstance(rays, CameraRays):
        return _eye(rays.origin, float(np.linalg.norm(rays.dy)) / parts, 0.0)
    if rays.extent is None:
        return _eye(rays.origin, np.pi / rays.height / parts, 0.0)
    far = rays.origin - _FAR * rays.extent * rays.axes[2]  # where parallel rays come from, about
    return _eye(far, 0.0, rays.extent / rays.height / parts)


def _eye(place: np.ndarray, pixel: float, least: float) -> Eye:
    x, y, z = map(float, place)
    return Eye(x, y, z, pixel, least)


@inlined
def _footprint(frame, n, p, eye, depth):
    """Two vectors in the plane of a triangle (unit normal n): the sides of what a pixel covers around its point p."""
    size = eye.pixel * depth + eye.least
    d = minus(p, (eye.x, eye.y, eye.z))
    distance = np.sqrt(dot(d, d))
    towards = dot(d, n)
    a = d[0] - towards * n[0], d[1] - towards * n[1], d[2] - towards * n[2]
    length = np.sqrt(dot(a, a))
    if length <= 1e-6 * distance:  # seen from straight above: any direction in the plane
        a = frame.e1
        length = np.sqrt(dot(a, a))
    unit = a[0] / length, a[1] / length, a[2] / length
    stretched = size / max(abs(towards) / distance, _GRAZING)
    b = cross(n, unit)
    return (
        (size * b[0], size * b[1], size * b[2]),
        (stretched * unit[0], stretched * unit[1], stretched * unit[2]),
    )


@inlined
def _in_texture(frame, uv, face, d):
    """How texture coordinates change along the vector d; `uv` is a pointer."""
    b1, b2 = along(frame, d)
    s0, t0 = get(uv, 6 * face), get(uv, 6 * face + 1)
    s1, t1 = get(uv, 6 * face + 2) - s0, get(uv, 6 * face + 3) - t0
    s2, t2 = get(uv, 6 * face + 4) - s0, get(uv, 6 * face + 5) - t0
    return b1 * s1 + b2 * s2, b1 * t1 + b2 * t2


@inlined
def _mixed(values, at, step, b, c):
    """Component c of what the three corners have, `step` numbers each from `at` on."""
    return b[0] * get(values, at + c) + b[1] * get(values, at + step + c) + b[2] * get(values, at + 2 * step + c)


@inlined
def _painted(places, paints, eye, at, i, k, material):
    """(red, green, blue) of pixel `at`, which sees triangle i and face k of the scene."""
    corners = ptr(places.corners)
    p, frame = three_at(ptr(places.position), at), frame_of(corners, i)
    b = weights(frame, corners, i, p)
    factors = ptr(paints.factors)
    r, g, blue = get(factors, 3 * material), get(factors, 3 * material + 1), get(factors, 3 * material + 2)
    red, green, blue = np.float64(r), np.float64(g), np.float64(blue)
    if paints.textured[k] and paints.texture[material] and frame.g2 > 0.0:
        uv, depth = ptr(paints.uv), np.float64(get(ptr(places.depth), at))
        across, stretched = _footprint(frame, three_at(ptr(places.normal), at), p, eye, depth)
        light = looked_up(
            paints.pictures,
            np.int64(material),
            (_mixed(uv, 6 * k, 2, b, 0), _mixed(uv, 6 * k, 2, b, 1)),
            _in_texture(frame, uv, k, across),
            _in_texture(frame, uv, k, stretched),
        )
        red, green, blue = red * light[0], green * light[1], blue * light[2]
    if len(paints.colours) > 0:
        colours = ptr(paints.colours)
        red *= _mixed(colours, 12 * k, 4, b, 0)
        green *= _mixed(colours, 12 * k, 4, b, 1)
        blue *= _mixed(colours, 12 * k, 4, b, 2)
    return red, green, blue


@kernel
def _albedo_rows(ticket, places, paints, eye, out):
    w = places.ids.shape[1]
    ids, faces, materials, own = ptr(places.ids), ptr(places.face), ptr(paints.material), ptr(paints.colour)
    shown = ptr(out)
    for y0, last in shares(ticket):
        for at in range(y0 * w, last * w):
            red = green = blue = 0.0
            k = np.int64(get(ids, at))
            if k >= 0:
                i, material = np.int64(get(faces, at)), get(materials, k)
                if material >= 0:
                    red, green, blue = _painted(places, paints, eye, at, i, k, material)
                else:
                    red = np.float64(get(own, 3 * i))
                    green = np.float64(get(own, 3 * i + 1))
                    blue = np.float64(get(own, 3 * i + 2))
            put(shown, 3 * at, np.float32(red))
            put(shown, 3 * at + 1, np.float32(green))
            put(shown, 3 * at + 2, np.float32(blue))


def albedo(places: Places, colour: np.ndarray, appearance: Appearance, eye: Eye, threads=None) -> np.ndarray:
    """(H, W, 3) float32: linear base colours; 0 where nothing is seen.

    colour : (m, 3) float32, the colour of each triangle that `places.face` indexes

    Textures are decoded when they are seen for the first time. Raises InputError if one cannot be.
    """
    threads = thread_count(threads)
    out = np.empty(places.position.shape, np.float32)
    paints = _paints(places, colour, appearance, threads)
    run(_albedo_rows, threads, new_ticket(len(out), 8), places, paints, eye, out)
    return out


def _paints(places: Places, colour: np.ndarray, appearance: Appearance, threads: int) -> Paints:
    materials = appearance.materials
    seen = np.bincount(appearance.material_of_face[places.ids[places.ids >= 0]] + 1, minlength=len(materials) + 1)
    shown = [material.texture if count else None for material, count in zip(materials, seen[1:])]
    _decode(list(dict.fromkeys(t for t in shown if t is not None)), threads)
    none = lambda values, width: np.empty((0, 3, width), np.float32) if values is None else values
    return Paints(
        colour,
        appearance.material_of_face,
        np.array([m.factor[:3] for m in materials], np.float32),
        np.array([t is not None for t in shown]),
        appearance.textured,
        none(appearance.uv, 2),
        none(appearance.colours, 4),
        pictures_of(shown),
    )


def _decode(textures: list[Texture], threads: int) -> None:
    """Decode textures and their mip levels; they keep both."""

    def decode(texture: Texture) -> None:
        try:
            texture.mips  # noqa: B018
        except ValueError as error:
            raise InputError(f"{texture.name} cannot be decoded ({error}); render without textures") from error

    with ThreadPoolExecutor(threads) as pool:
        list(pool.map(decode, textures))
