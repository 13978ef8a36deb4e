"""The base colour and shading normal of each pixel, from face colours, textures and vertex attributes.

Texture lookups are trilinear and anisotropic. Shadows stay on the geometric surface.
"""

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..base.errors import InputError
from ..kernels.elementary import log2
from ..kernels.exact.filters import cross, dot
from ..kernels.jit import I32Ptr, inlined, kernel
from ..kernels.parallel import new_ticket, run, shares, thread_count
from ..kernels.simd import get, highest_bit, i32_at, ptr, put
from ..kernels.small_matrices import length
from ..query.shadow_query import ShadingNormals, Surfaces, three_at
from ..scene.appearance import Appearance
from ..scene.camera import CameraRays, ExplicitRays
from ..scene.materials import CLAMP, LINEAR, MIRROR, REPEAT, Texture

# --- Barycentric weights ----------------------------------------------------------------------------------------------


class SurfacePoints(NamedTuple):
    """The points that pixels see, and their triangles."""

    position: np.ndarray  # (H, W, 3) float32
    normal: np.ndarray  # (H, W, 3) float32, geometric
    depth: np.ndarray  # (H, W) float32
    face: np.ndarray  # (H, W) int32, index in `corners`
    ids: np.ndarray  # (H, W) int32, row of the appearance: face of the scene, or of those seen; -1: background
    corners: np.ndarray  # (n, 9) float32


def surface_points(surfaces: Surfaces, ids: NDArray[np.int32] | None = None) -> SurfacePoints:
    """The points of surfaces, as input of kernels; `ids`: rows of the appearance, if it is not that of all faces."""
    g, rows = surfaces.gbuffer, surfaces.ids if ids is None else ids
    return SurfacePoints(g.position, g.normal, g.depth, g.face, rows, surfaces.triangles.vertices.reshape(-1, 9))


class TriangleFrame(NamedTuple):
    """A triangle's frame for barycentric weights; float64."""

    triangle: int  # -1: none yet
    corner: tuple[float, float, float]  # the first corner
    e1: tuple[float, float, float]  # an edge from it, the direction of footprints seen perpendicularly
    g: tuple[float, float, float]  # cross product of the two edges from it
    g2: float  # squared length of g; without area, q1 and q2 are undefined
    q1: tuple[float, float, float]  # gradients of the weights of the second and the third corner
    q2: tuple[float, float, float]


_ORIGIN = (0.0, 0.0, 0.0)
NO_FRAME = TriangleFrame(-1, _ORIGIN, _ORIGIN, _ORIGIN, 0.0, _ORIGIN, _ORIGIN)


@inlined
def _minus(a, b):
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]


@inlined
def _times(a, scale):
    return a[0] * scale, a[1] * scale, a[2] * scale


@inlined
def triangle_frame(corners, i):
    """The `TriangleFrame` of triangle i; `corners` is a pointer."""
    c0 = three_at(corners, 3 * i)
    e1, e2 = _minus(three_at(corners, 3 * i + 1), c0), _minus(three_at(corners, 3 * i + 2), c0)
    g = cross(e1, e2)
    g2 = dot(g, g)
    inverse = 1.0 / g2
    return TriangleFrame(i, c0, e1, g, g2, _times(cross(e2, g), inverse), _times(cross(g, e1), inverse))


@inlined
def barycentric_weights(frame, p):
    """(b0, b1, b2): barycentric weights of the point p, clamped to [0, 1]; 1/3 each for zero area."""
    if not frame.g2 > 0.0:
        return 1.0 / 3.0, 1.0 / 3.0, 1.0 / 3.0
    d = _minus(p, frame.corner)
    b1 = min(max(dot(d, frame.q1), 0.0), 1.0)
    b2 = min(max(dot(d, frame.q2), 0.0), 1.0 - b1)
    return 1.0 - b1 - b2, b1, b2


# --- Texture lookups: bilinear in a mip level, linear between two levels, several along a stretched footprint ---------

MOST_TAPS = 8
"""Maximum number of lookups along the longer side of a pixel's footprint. Even longer footprints are blurred."""


class MippedTextures(NamedTuple):
    """Textures for kernels, by address: the textures must outlive this object."""

    pixels: np.ndarray  # (t,) int64: addresses of level 0: texels of four bytes, row by row
    mips: np.ndarray  # (t,) int64: addresses of the smaller levels, one after the other
    sizes: np.ndarray  # (t, 2) int32: width and height
    wraps: np.ndarray  # (t, 2) int32: wrap_s and wrap_t
    nearest: np.ndarray  # (t,) bool
    linear: np.ndarray  # (256,) float32: linear light of sRGB bytes, or the values of other bytes


def mipped_textures(textures: list[Texture | None], table: NDArray[np.float32] = LINEAR) -> MippedTextures:
    """Textures as input of kernels; entries that are None must not be looked up. `table`: the values of bytes."""
    n = len(textures)
    out = MippedTextures(
        np.zeros(n, np.int64),
        np.zeros(n, np.int64),
        np.zeros((n, 2), np.int32),
        np.zeros((n, 2), np.int32),
        np.zeros(n, np.bool_),
        table,
    )
    for i, texture in enumerate(textures):
        if texture is not None:
            out.pixels[i], out.mips[i] = texture.pixels.ctypes.data, texture.mips.ctypes.data
            out.sizes[i] = texture.pixels.shape[1::-1]
            out.wraps[i] = texture.wrap_s, texture.wrap_t
            out.nearest[i] = texture.nearest
    return out


@inlined
def _wrap_texel(i, n, wrap):
    """Index in a row of n texels of texel i next to a coordinate from `_wrap_coordinate`."""
    if wrap == REPEAT:
        return n - 1 if i < 0 else i if i < n else 0
    if wrap == MIRROR and i >= n:
        i = 2 * n - 1 - i
    return min(max(i, 0), n - 1)


@inlined
def _wrap_coordinate(u, wrap):
    """The equivalent texture coordinate from 0 to 1, or to 2 if the texture is mirrored."""
    if wrap == REPEAT:
        return u - np.floor(u)
    return min(max(u, 0.0), 1.0) if wrap == CLAMP else u - 2.0 * np.floor(0.5 * u)


@inlined
def _light(linear, texel):
    """Linear red, green and blue of four bytes."""
    return (
        get(linear, texel & 255),
        get(linear, (texel >> 8) & 255),
        get(linear, (texel >> 16) & 255),
    )


class _Level(NamedTuple):
    """A level of a texture; wraps: its wrap_s and wrap_t."""

    texels: I32Ptr
    w: int
    h: int
    wrap_s: int
    wrap_t: int


@inlined
def _level(pictures, k, level):
    """A mip level of texture k."""
    sizes, wraps, one = ptr(pictures.sizes), ptr(pictures.wraps), np.int64(1)
    w, h = get(sizes, 2 * k), get(sizes, 2 * k + 1)
    address = pictures.pixels[k]
    if level > 0:
        address = pictures.mips[k]
        for _ in range(level - 1):
            w, h = max(w >> one, one), max(h >> one, one)
            address += 4 * w * h
        w, h = max(w >> one, one), max(h >> one, one)
    return _Level(i32_at(address), w, h, get(wraps, 2 * k), get(wraps, 2 * k + 1))


@inlined
def _nearest(level, linear, u, v):
    """The texel at (u, v); `linear` is a pointer."""
    x, y = _wrap_coordinate(u, level.wrap_s) * level.w, _wrap_coordinate(v, level.wrap_t) * level.h
    left = _wrap_texel(np.int64(np.floor(x)), level.w, level.wrap_s)
    top = _wrap_texel(np.int64(np.floor(y)), level.h, level.wrap_t) * level.w
    return _light(linear, get(level.texels, top + left))


@inlined
def _bilinear(level, linear, u, v):
    """The bilinear lookup at (u, v); `linear` is a pointer."""
    w, h, wrap_s, wrap_t = level.w, level.h, level.wrap_s, level.wrap_t
    x, y = _wrap_coordinate(u, wrap_s) * w - 0.5, _wrap_coordinate(v, wrap_t) * h - 0.5
    x0, y0 = np.floor(x), np.floor(y)
    i, j = np.int64(x0), np.int64(y0)
    left, top = _wrap_texel(i, w, wrap_s), _wrap_texel(j, h, wrap_t) * w
    right, low = _wrap_texel(i + 1, w, wrap_s), _wrap_texel(j + 1, h, wrap_t) * w
    fx, fy = np.float32(x - x0), np.float32(y - y0)
    a, b = _light(linear, get(level.texels, top + left)), _light(linear, get(level.texels, top + right))
    c, d = _light(linear, get(level.texels, low + left)), _light(linear, get(level.texels, low + right))
    return _mix(_mix(a, b, fx), _mix(c, d, fx), fy)


@inlined
def _mix(a, b, share):
    """a + share (b - a) of colours."""
    return a[0] + share * (b[0] - a[0]), a[1] + share * (b[1] - a[1]), a[2] + share * (b[2] - a[2])


@inlined
def sample_texture(pictures, k, uv, across, along):
    """(red, green, blue), linear: the mean of texture k over a pixel's footprint around `uv`.

    across, along : the two sides of the footprint, in texture coordinates

    Several lookups cover the longer side, each in the mip level of the shorter side, as in the anisotropic filters of
    GPUs: a floor seen at a grazing angle stays sharp.
    """
    w, h, linear = np.int64(pictures.sizes[k, 0]), np.int64(pictures.sizes[k, 1]), ptr(pictures.linear)
    one, two = _squared(across[0] * w, across[1] * h), _squared(along[0] * w, along[1] * h)
    side = along if two > one else across
    longer, shorter = max(one, two), min(one, two)
    if not longer > 1.0:
        finest = _level(pictures, k, 0)
        if pictures.nearest[k]:
            return _nearest(finest, linear, uv[0], uv[1])
        return _bilinear(finest, linear, uv[0], uv[1])
    shorter = max(shorter, 1.0)
    taps = np.int64(min(np.ceil(np.sqrt(longer / shorter)), MOST_TAPS))
    level, last = min(0.5 * log2(max(longer / (taps * taps), shorter)), 64.0), highest_bit(max(w, h))
    below = min(np.int64(level), last)
    part = np.float32(level - below) if below < last else np.float32(0.0)
    fine, coarse = _level(pictures, k, below), _level(pictures, k, min(below + 1, last))
    red = green = blue = np.float32(0.0)
    step = 1.0 / taps
    for i in range(taps):
        at = (i + 0.5) * step - 0.5
        u, v = uv[0] + at * side[0], uv[1] + at * side[1]
        light = _bilinear(fine, linear, u, v)
        if part > np.float32(0.0):
            light = _mix(light, _bilinear(coarse, linear, u, v), part)
        red, green, blue = red + light[0], green + light[1], blue + light[2]
    scale = np.float32(step)
    return red * scale, green * scale, blue * scale


@inlined
def _squared(x, y):
    return x * x + y * y


# --- Base colours: from faces, or from materials, textures and vertex colours -----------------------------------------

_FAR = 1e4  # distance of the eye of an orthographic camera, in heights of its picture
_GRAZING = 0.02  # smallest cosine of a footprint, which limits its length


class FaceColours(NamedTuple):
    """The colours, materials and textures of faces, for kernels."""

    colour: np.ndarray  # (m, 3) float32: colours of the triangles that `Places.face` indexes
    material: np.ndarray  # (n,) int32: materials of the scene's faces; -1: the face has a plain colour
    factors: np.ndarray  # (k, 3) float32: colour factors of materials
    texture: np.ndarray  # (k,) bool: whether the material has a decoded texture
    textured: np.ndarray  # (n,) bool: whether the face shows the texture of its material
    uv: np.ndarray  # (n, 3, 2) float32, or (0, 3, 2)
    colours: np.ndarray  # (n, 3, 4) float32, or (0, 3, 4)
    pictures: MippedTextures  # entry i is the texture of material i


class Eye(NamedTuple):
    """The viewpoint of a picture, and the widths of its pixels."""

    x: float
    y: float
    z: float
    pixel: float  # width of a pixel at depth 1
    least: float  # width of a pixel at depth 0


def eye_of(rays: CameraRays | ExplicitRays, parts: int) -> Eye:
    """The eye of a camera, in the frame of the triangles; `parts`: sub-pixels per side of a pixel."""
    if isinstance(rays, CameraRays):
        return _eye(rays.origin, float(length(rays.dy)) / parts, 0.0)
    if rays.extent is None:
        return _eye(rays.origin, np.pi / rays.height / parts, 0.0)
    far = rays.origin - _FAR * rays.extent * rays.axes[2]  # about where parallel rays come from
    return _eye(far, 0.0, rays.extent / rays.height / parts)


def _eye(place: np.ndarray, pixel: float, least: float) -> Eye:
    x, y, z = map(float, place)
    return Eye(x, y, z, pixel, least)


@inlined
def _footprint(frame, n, p, eye, depth):
    """The sides of a pixel's footprint around point p, two vectors in the plane of a triangle with unit normal n."""
    size = eye.pixel * depth + eye.least
    d = _minus(p, (eye.x, eye.y, eye.z))
    towards, d2 = dot(d, n), dot(d, d)
    a = _minus(d, _times(n, towards))
    a2 = dot(a, a)
    if a2 <= 1e-12 * d2:  # seen perpendicularly: any direction in the plane
        a = frame.e1
        a2 = dot(a, a)
    distance, scale = np.sqrt(d2), size / np.sqrt(a2)
    stretch = distance / max(abs(towards), _GRAZING * distance)
    return _times(cross(n, a), scale), _times(a, scale * stretch)


@inlined
def _in_texture(frame, uv, face, d):
    """Changes of the texture coordinates along the vector d; `uv` is a pointer."""
    b1, b2 = dot(d, frame.q1), dot(d, frame.q2)
    s0, t0 = get(uv, 6 * face), get(uv, 6 * face + 1)
    s1, t1 = get(uv, 6 * face + 2) - s0, get(uv, 6 * face + 3) - t0
    s2, t2 = get(uv, 6 * face + 4) - s0, get(uv, 6 * face + 5) - t0
    return b1 * s1 + b2 * s2, b1 * t1 + b2 * t2


@inlined
def _interpolate(values, at, step, b, c):
    """Interpolate component c of the three corners, which have `step` values each from `at` on."""
    return b[0] * get(values, at + c) + b[1] * get(values, at + step + c) + b[2] * get(values, at + 2 * step + c)


@inlined
def _material_colour(places, face_colours, eye, at, frame, k, material):
    """(red, green, blue) of pixel `at`, which sees the triangle of `frame`, face k of the scene."""
    p = three_at(ptr(places.position), at)
    b = barycentric_weights(frame, p)
    factors = ptr(face_colours.factors)
    r, g, blue = get(factors, 3 * material), get(factors, 3 * material + 1), get(factors, 3 * material + 2)
    red, green, blue = np.float64(r), np.float64(g), np.float64(blue)
    if face_colours.textured[k] and face_colours.texture[material] and frame.g2 > 0.0:
        uv, depth = ptr(face_colours.uv), np.float64(get(ptr(places.depth), at))
        across, stretched = _footprint(frame, three_at(ptr(places.normal), at), p, eye, depth)
        light = sample_texture(
            face_colours.pictures,
            np.int64(material),
            (_interpolate(uv, 6 * k, 2, b, 0), _interpolate(uv, 6 * k, 2, b, 1)),
            _in_texture(frame, uv, k, across),
            _in_texture(frame, uv, k, stretched),
        )
        red, green, blue = red * light[0], green * light[1], blue * light[2]
    if len(face_colours.colours) > 0:
        colours = ptr(face_colours.colours)
        red *= _interpolate(colours, 12 * k, 4, b, 0)
        green *= _interpolate(colours, 12 * k, 4, b, 1)
        blue *= _interpolate(colours, 12 * k, 4, b, 2)
    return red, green, blue


@kernel
def _albedo_rows(ticket, places, face_colours, eye, out):
    w = places.ids.shape[1]
    ids, faces, materials, colours = (
        ptr(places.ids),
        ptr(places.face),
        ptr(face_colours.material),
        ptr(face_colours.colour),
    )
    albedos, corners = ptr(out), ptr(places.corners)
    for y0, last in shares(ticket):
        frame = NO_FRAME
        for at in range(y0 * w, last * w):
            red = green = blue = 0.0
            k = get(ids, at)
            if k >= 0:
                i, material = get(faces, at), get(materials, k)
                if material >= 0:
                    if i != frame.triangle:  # neighbouring pixels often see the same triangle
                        frame = triangle_frame(corners, i)
                    red, green, blue = _material_colour(places, face_colours, eye, at, frame, k, material)
                else:
                    red = np.float64(get(colours, 3 * i))
                    green = np.float64(get(colours, 3 * i + 1))
                    blue = np.float64(get(colours, 3 * i + 2))
            put(albedos, 3 * at, np.float32(red))
            put(albedos, 3 * at + 1, np.float32(green))
            put(albedos, 3 * at + 2, np.float32(blue))


def albedo(
    places: SurfacePoints, colour: np.ndarray, appearance: Appearance, eye: Eye, threads: int | None = None
) -> NDArray[np.float32]:
    """(H, W, 3) float32: linear base colours; 0 in the background.

    colour : (m, 3) float32, the colour of each triangle that `places.face` indexes

    Textures are decoded when they are first seen. Raises InputError if decoding fails.
    """
    materials = appearance.materials
    textures = seen_only(places, appearance, [material.texture for material in materials])
    face_colours = FaceColours(
        colour,
        appearance.material_of_face,
        np.array([m.factor[:3] for m in materials], np.float32),
        np.array([t is not None for t in textures]),
        appearance.textured,
        np.empty((0, 3, 2), np.float32) if appearance.uv is None else appearance.uv,
        np.empty((0, 3, 4), np.float32) if appearance.colours is None else appearance.colours,
        decoded_textures(textures, "render without textures", threads),
    )
    return colours_of_pixels(places, face_colours, eye, threads)


def colours_of_pixels(
    places: SurfacePoints, face_colours: FaceColours, eye: Eye, threads: int | None = None
) -> NDArray[np.float32]:
    """(H, W, 3) float32: the factors of materials times textures and vertex colours; 0 in the background."""
    out = np.empty(places.position.shape, np.float32)
    run(_albedo_rows, thread_count(threads), new_ticket(len(out), 8), places, face_colours, eye, out)
    return out


def seen_only(
    places: SurfacePoints, appearance: Appearance, textures: Sequence[Texture | None]
) -> list[Texture | None]:
    """The textures of materials, with None for those that no pixel shows: they are not decoded."""
    counts = np.bincount(appearance.material_of_face[places.ids[places.ids >= 0]] + 1, minlength=len(textures) + 1)
    return [texture if count else None for texture, count in zip(textures, counts[1:])]


def decoded_textures(
    textures: list[Texture | None], cure: str, threads: int | None = None, table: NDArray[np.float32] = LINEAR
) -> MippedTextures:
    """Decode textures and their mip levels, in parallel, as input of kernels; the textures cache both.

    cure : end of the InputError if a texture cannot be decoded
    table : (256,) float32, the values of bytes
    """

    def decode(texture: Texture) -> None:
        try:
            texture.mips  # noqa: B018
        except ValueError as error:
            raise InputError(f"{texture.name} cannot be decoded ({error}); {cure}") from error

    with ThreadPoolExecutor(thread_count(threads)) as pool:
        list(pool.map(decode, dict.fromkeys(t for t in textures if t is not None)))
    return mipped_textures(textures, table)


# --- Shading normals: interpolated normals of corners -----------------------------------------------------------------


@inlined
def evaluate_normal(frame, products):
    """The normal, of any length, that `scene.appearance.normals_in_frames` stores as `products`.

    Two of them are its products with the edges, to which the gradients of the weights are dual.
    """
    # g is |g| long, and products[2] is |g|^(1/2) times the product
    z = products[2] / (np.sqrt(frame.g2) * np.sqrt(np.sqrt(frame.g2)))
    a, b, c = _times(frame.q1, products[0]), _times(frame.q2, products[1]), _times(frame.g, z)
    return a[0] + b[0] + c[0], a[1] + b[1] + c[1], a[2] + b[2] + c[2]


@kernel
def _normal_rows(ticket, places, corner_normals, bends, out):
    w = places.ids.shape[1]
    ids, faces, corners, normals = ptr(places.ids), ptr(places.face), ptr(places.corners), ptr(corner_normals)
    positions, geometric, shading = ptr(places.position), ptr(places.normal), ptr(out.normal)
    sines, ends = ptr(bends), ptr(out.bend)
    for y0, last in shares(ticket):
        frame = NO_FRAME
        for at in range(y0 * w, last * w):
            n, k, bend = three_at(geometric, at), get(ids, at), 0.0
            if k >= 0:
                if get(faces, at) != frame.triangle:  # neighbouring pixels often see the same triangle
                    frame = triangle_frame(corners, get(faces, at))
                b0, b1, b2 = barycentric_weights(frame, three_at(positions, at))
                p, q, r = three_at(normals, 3 * k), three_at(normals, 3 * k + 1), three_at(normals, 3 * k + 2)
                m = evaluate_normal(
                    frame,
                    (
                        b0 * p[0] + b1 * q[0] + b2 * r[0],
                        b0 * p[1] + b1 * q[1] + b2 * r[1],
                        b0 * p[2] + b1 * q[2] + b2 * r[2],
                    ),
                )
                length = np.sqrt(dot(m, m))
                if length > 0.0 and length < np.inf:
                    scale = (1.0 if dot(m, n) >= 0.0 else -1.0) / length  # towards the visible side
                    n = m[0] * scale, m[1] * scale, m[2] * scale
                    bend = b0 * get(sines, 3 * k) + b1 * get(sines, 3 * k + 1) + b2 * get(sines, 3 * k + 2)
                    bend /= max(length, 0.5)  # a mean of unit vectors is shorter, see docs/design/shading.md
            put(ends, at, np.float32(bend))
            put(shading, 3 * at, np.float32(n[0]))
            put(shading, 3 * at + 1, np.float32(n[1]))
            put(shading, 3 * at + 2, np.float32(n[2]))


def shading_normals(places: SurfacePoints, appearance: Appearance, threads: int | None = None) -> ShadingNormals:
    """Interpolated normals; geometric normals where a face has none. The scene must have normals."""
    out = ShadingNormals(np.empty(places.normal.shape, np.float32), np.empty(places.ids.shape, np.float32))
    ticket = new_ticket(len(places.ids), 8)
    run(_normal_rows, thread_count(threads), ticket, places, appearance.normals, appearance.bends, out)
    return out
