"""Props of procedural scenes: plants, trees, and furniture such as vases, benches and crates.

Leaves are thin, open, two-sided surfaces; everything else is closed.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..kernels.elementary import cos, exp, power, sin
from . import palette as p
from .shapes import PaletteMesh, arc, box, boxes, cross, lofts, merge, revolve, shell, steps, tubes

# --- Leaves, shrubs, ivy, ferns, grass and bushes ---------------------------------------------------------------------


UP = np.array([0.0, 1.0, 0.0])


def unit(v: NDArray[np.float64]) -> NDArray[np.float64]:
    """Vectors along the last axis, scaled to length 1."""
    out: NDArray[np.float64] = v / np.maximum(np.linalg.norm(v, axis=-1, keepdims=True), 1e-12)
    return out


def sphere_directions(rng: np.random.Generator, n: int, low: float = -1.0) -> NDArray[np.float64]:
    """(n, 3) random unit vectors with y >= low."""
    y, angle = rng.uniform(low, 1.0, n), rng.uniform(0.0, 2.0 * np.pi, n)
    flat = np.sqrt(1.0 - y * y)
    return np.stack([flat * cos(angle), y, flat * sin(angle)], axis=1)


class Blade(NamedTuple):
    """The shape of k leaves of 2 (segments - 1) triangles each, or of 4 (segments - 1) with a midrib."""

    length: ArrayLike  # scalar or (k,), like the next two
    width: ArrayLike
    droop: ArrayLike  # the tip bends away from the upper side by droop x length
    segments: int  # at least 2
    ribs: int = 2  # 2: flat; 3: with a folded midrib


def blades(
    base: NDArray[np.float64],
    along: NDArray[np.float64],
    facing: NDArray[np.float64],
    blade: Blade,
    colour: ArrayLike = p.LEAF,
) -> PaletteMesh:
    """k leaves: pointed ribbons that grow from `base` in the direction `along`.

    base, along, facing : (k, 3)
        Start, direction of growth, and approximate direction of the upper side.
    colour : scalar or (k,), palette indices
    """
    along = unit(np.asarray(along, np.float64))
    side = unit(cross(along, facing))
    normal = cross(side, along)
    length, width, droop = (
        np.broadcast_to(np.asarray(a, np.float64), len(base))[:, None, None]
        for a in (blade.length, blade.width, blade.droop)
    )
    t = np.linspace(0.0, 1.0, blade.segments + 1)[None, :, None]
    centre = np.asarray(base)[:, None] + length * (
        along[:, None] * (t - 0.35 * droop**2 * t**2) - normal[:, None] * droop * t**2
    )
    half = width / 2.0 * sin(np.pi * power(t, 0.75))
    inner, half = centre[:, 1:-1], half[:, 1:-1]
    columns = [inner - half * side[:, None], inner + half * side[:, None]]
    if blade.ribs == 3:
        columns.insert(1, inner - 0.45 * half * normal[:, None])
    k, rings = len(base), np.stack(columns, axis=2)
    vertices = np.concatenate([centre[:, :1], rings.reshape(k, -1, 3), centre[:, -1:]], axis=1)
    faces = _blade_faces(blade.segments, blade.ribs)
    starts = np.arange(k, dtype=np.int32)[:, None, None] * vertices.shape[1]
    colour = np.broadcast_to(np.asarray(colour, np.uint8), k)
    return PaletteMesh(
        vertices.reshape(-1, 3).astype(np.float32),
        (faces + starts).reshape(-1, 3),
        np.repeat(colour, len(faces)),
    )


def _blade_faces(segments: int, ribs: int) -> np.ndarray:
    ring = np.arange((segments - 1) * ribs).reshape(segments - 1, ribs) + 1
    tip, faces = ring[-1, -1] + 1, []
    for j in range(ribs - 1):
        faces.append((0, ring[0, j], ring[0, j + 1]))
        for i in range(segments - 2):
            a, b, c, d = ring[i, j], ring[i, j + 1], ring[i + 1, j + 1], ring[i + 1, j]
            faces += [(a, d, c), (a, c, b)]
        faces.append((tip, ring[-1, j + 1], ring[-1, j]))
    return np.array(faces, np.int32)


def agave(rng: np.random.Generator, leaves: int, length: float, segments: int, colour: int = p.MOSS) -> PaletteMesh:
    """A rosette of long pointed leaves on the ground."""
    angle = np.arange(leaves) * 2.39996  # the golden angle
    rise = np.linspace(0.25, 1.4, leaves)
    flat = np.stack([cos(angle), np.zeros(leaves), sin(angle)], axis=1)
    along = flat * cos(rise)[:, None] + UP * sin(rise)[:, None]
    facing = UP * cos(rise)[:, None] - flat * sin(rise)[:, None]
    size = length * rng.uniform(0.8, 1.1, leaves)
    return blades(
        flat * 0.03,
        along,
        facing,
        Blade(size, 0.16 * length, rng.uniform(0.15, 0.5, leaves), segments, 3),
        colour + p.shades(rng, leaves),
    )


def shrub(
    rng: np.random.Generator, leaves: int, radius: float, height: float, size: float, colour: int = p.LEAF
) -> PaletteMesh:
    """A dense ball of leaves on stems; 4 triangles per leaf."""
    out = sphere_directions(rng, leaves, -0.5)
    reach = rng.uniform(0.55, 1.0, leaves)[:, None]
    base = out * reach * [radius, 0.5 * height, radius] + UP * 0.5 * height
    along = unit(out + 0.5 * sphere_directions(rng, leaves) - 0.15 * UP)
    foliage = blades(
        base,
        along,
        UP + 0.3 * out,
        Blade(size * rng.uniform(0.7, 1.3, leaves), 0.5 * size, 0.3, 2, 3),
        colour + p.shades(rng, leaves),
    )
    k = 5
    tip = sphere_directions(rng, k, 0.2) * [0.6 * radius, 0.35 * height, 0.6 * radius] + UP * 0.5 * height
    t = np.linspace(0.0, 1.0, 3)[None, :, None]
    paths = (tip[:, None] * [1, 0, 1]) * power(t, 1.5) + tip[:, None] * [0, 1, 0] * t - UP * 0.03
    return merge(foliage, tubes(paths, np.array([0.025, 0.018, 0.008]) * max(1.0, radius), 4, p.BARK))


def ivy(
    rng: np.random.Generator, start: NDArray[np.float64], fall: NDArray[np.float64], leaves: int, size: float
) -> PaletteMesh:
    """Leaves along strands that hang down (k,) metres from (k, 3) points; 4 triangles per leaf."""
    which = rng.integers(0, len(start), leaves)
    drop = power(rng.uniform(0.0, 1.0, leaves), 1.2)
    base = start[which] - UP * (drop * fall[which])[:, None]
    base[:, [0, 2]] += rng.normal(0.0, 0.05, (leaves, 2)) * (1.0 + drop)[:, None]
    along = unit(sphere_directions(rng, leaves) * [1, 0.4, 1] - 0.7 * UP)
    colour = np.where(rng.random(leaves) < 0.3, p.LIME, p.LEAF) + p.shades(rng, leaves)
    return blades(
        base,
        along,
        sphere_directions(rng, leaves, 0.0),
        Blade(size * rng.uniform(0.6, 1.3, leaves), 0.7 * size, 0.3, 2, 3),
        colour,
    )


def fern(rng: np.random.Generator, fronds: int, pairs: int, length: float) -> PaletteMesh:
    """Arching fronds with `pairs` pairs of pinnae; 2 triangles per pinna."""
    angle = np.arange(fronds) * 2.39996 + rng.uniform(-0.3, 0.3, fronds)
    flat = np.stack([cos(angle), np.zeros(fronds), sin(angle)], axis=1)
    t = np.linspace(0.12, 1.0, pairs)[None, :, None]
    reach = length * rng.uniform(0.75, 1.1, fronds)[:, None, None]
    base = reach * (flat[:, None] * (0.75 * t + 0.2 * t**2) + UP * (0.85 * t - 0.6 * t**2))
    along = unit(np.gradient(base, axis=1))
    across = unit(cross(flat, UP))[:, None]
    size = (0.3 * reach * sin(np.pi * (0.1 + 0.88 * t)) + 0.01)[..., 0].ravel()
    colour = np.repeat(p.LEAF + p.shades(rng, fronds), pairs)
    stem = blades(
        np.zeros((fronds, 3)),
        flat * 0.66 + 0.75 * UP,
        UP - 0.7 * flat,
        Blade(1.02 * reach[:, 0, 0], 0.012, 0.42, 5),
        p.LIME,
    )
    meshes = [stem]
    for sign in (-1.0, 1.0):
        direction = unit(sign * across + 0.45 * along)
        facing = np.broadcast_to(cross(along, across), direction.shape)
        meshes.append(
            blades(
                base.reshape(-1, 3),
                direction.reshape(-1, 3),
                facing.reshape(-1, 3),
                Blade(size, 0.34 * size + 0.012, 0.2, 2),
                colour,
            )
        )
    return merge(*meshes)


def grass(rng: np.random.Generator, n_blades: int, height: float, spread: float, segments: int) -> PaletteMesh:
    """A tuft of grass."""
    place = rng.normal(0.0, spread, (n_blades, 2))
    base = np.stack([place[:, 0], np.full(n_blades, -0.03), place[:, 1]], axis=1)
    lean = sphere_directions(rng, n_blades, 0.0)
    along = unit(UP * 1.6 + lean)
    size = height * rng.uniform(0.5, 1.1, n_blades)
    return blades(
        base,
        along,
        UP - lean,
        Blade(size, 0.05 * height + 0.004, rng.uniform(0.1, 0.6, n_blades), segments),
        p.GRASS + p.shades(rng, n_blades),
    )


def bush(rng: np.random.Generator, size: float, detail: float, colour: int = p.PINE) -> PaletteMesh:
    """A clipped shrub: a lumpy solid ball."""
    n = steps(22, detail, 3)
    angle = np.linspace(-np.pi / 2, np.pi / 2, n + 1)
    profile = np.stack([cos(angle) * size, (sin(angle) + 0.95) * size], axis=1)
    profile[[0, -1], 0] = 0.0
    segments = 2 * n
    return revolve(profile, segments, colour, 1.0 + rng.normal(0.0, 0.03, (n + 1, segments)))


# --- Palms, broadleaf trees and spruces -------------------------------------------------------------------------------


def palm(
    rng: np.random.Generator, fronds: int, leaflets: int, height: float, length: float, detail: float
) -> PaletteMesh:
    """A curved trunk with arching fronds of `leaflets` pairs of leaflets."""
    t = np.linspace(0.0, 1.0, steps(10, detail, 3) + 1)
    lean = rng.uniform(-0.08, 0.08, 2) * height
    trunk = np.stack([lean[0] * t**2, height * t - 0.05, lean[1] * t**2], axis=1)
    radius = height * (0.035 - 0.012 * t + 0.004 * (np.arange(len(t)) % 2))
    meshes = [tubes(trunk[None], radius, steps(9, detail, 5), p.BARK)]
    angle = np.arange(fronds) * 2.39996 + rng.uniform(-0.2, 0.2, fronds)
    rise = np.linspace(-0.1, 1.2, fronds)
    flat = np.stack([cos(angle), np.zeros(fronds), sin(angle)], axis=1)
    s = np.linspace(0.0, 1.0, max(2, leaflets // 3) + 1)[None, :, None]
    reach = (length * rng.uniform(0.85, 1.1, fronds))[:, None, None]
    climb = sin(rise)[:, None, None] * s - (0.35 + 0.35 * cos(rise)[:, None, None]) * s**2
    rachis = trunk[-1] + reach * (flat[:, None] * (cos(rise)[:, None, None] * s + 0.25 * s**2) + UP * climb)
    meshes.append(tubes(rachis, 0.008 * length * (1.15 - s[0, :, 0]), 3, p.LIME))
    at = np.linspace(0.12, 0.99, leaflets)
    low = np.minimum((at * (rachis.shape[1] - 1)).astype(int), rachis.shape[1] - 2)
    part = (at * (rachis.shape[1] - 1) - low)[:, None]
    base = rachis[:, low] * (1 - part) + rachis[:, low + 1] * part
    along = unit(rachis[:, low + 1] - rachis[:, low])
    across = unit(cross(along, UP + 0.0 * along))
    size = length * 0.34 * sin(np.pi * (0.15 + 0.8 * at)) + 0.02
    colour = np.repeat(p.LEAF + p.shades(rng, fronds), leaflets)
    for sign in (-1.0, 1.0):
        direction = unit(sign * across + 0.75 * along - 0.25 * UP)
        facing = cross(across, along)
        meshes.append(
            blades(
                base.reshape(-1, 3),
                direction.reshape(-1, 3),
                facing.reshape(-1, 3),
                Blade(np.tile(size, fronds), 0.045 * min(1.0, 12.0 / leaflets) * length, 0.25, 3),
                colour,
            )
        )
    return merge(*meshes)


def grow_branches(
    rng: np.random.Generator, base: NDArray[np.float64], along: NDArray[np.float64], length: float, number: int, n: int
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Branch paths, (k * number, n + 1, 3), and their directions: `number` from each (k, m, 3) path in `base`."""
    k, m = base.shape[:2]
    where = rng.uniform(0.35, 1.0, (k, number)) * (m - 1)
    low = np.minimum(where.astype(int), m - 2)
    part = (where - low)[..., None]
    rows = np.arange(k)[:, None]
    start = base[rows, low] * (1 - part) + base[rows, low + 1] * part
    turn = sphere_directions(rng, k * number, -0.3).reshape(k, number, 3)
    direction = unit(along[:, None] * 0.55 + turn)
    reach = np.asarray(length) * rng.uniform(0.6, 1.1, (k, number)) * (1.25 - 0.6 * where / (m - 1))
    t = np.linspace(0.0, 1.0, n + 1)[:, None]
    path = start[..., None, :] + reach[..., None, None] * (direction[..., None, :] * t + UP * 0.18 * t**2)
    return path.reshape(-1, n + 1, 3), direction.reshape(-1, 3)


class BareTree(NamedTuple):
    """A tree without its leaves."""

    wood: PaletteMesh
    twigs: np.ndarray  # (k, 3, 3) paths of three points
    tips: np.ndarray  # (k, 3) directions of the twigs
    height: float


def bare_tree(rng: np.random.Generator, height: float, detail: float, bark: int = p.BARK) -> BareTree:
    """A trunk and two orders of branches."""
    n = steps(5, detail, 2)
    t = np.linspace(0.0, 1.0, n + 1)
    sway = rng.normal(0.0, 0.035 * height, 2)
    trunk = np.stack([sway[0] * sin(2.2 * t), 0.75 * height * t - 0.2, sway[1] * sin(2.6 * t)], axis=1)[None]
    flare = height * (0.028 * (1.0 - 0.75 * t) + 0.02 * exp(-9.0 * t))
    first, directions = grow_branches(
        rng, trunk, UP[None], 0.42 * height, steps(9, detail**0.5, 5), steps(3, detail, 2)
    )
    second, tips = grow_branches(rng, first, directions, 0.2 * height, steps(5, detail**0.5, 3), 2)
    thin = np.linspace(1.0, 0.3, first.shape[1])
    wood = merge(
        tubes(trunk, flare, steps(9, detail, 5), bark),
        tubes(first, 0.011 * height * thin, steps(5, detail, 3), bark),
        tubes(second, 0.0045 * height * np.array([1.0, 0.7, 0.3]), 3, bark),
    )
    return BareTree(wood, second, tips, height)


def tree(rng: np.random.Generator, bare: BareTree, leaves: int, size: float, colour: int = p.LEAF) -> PaletteMesh:
    """A broadleaf tree: leaves of 4 triangles around the twigs, with one shade per twig."""
    twigs = bare.twigs
    which = rng.integers(0, len(twigs), leaves)
    along = rng.uniform(0.15, 1.0, leaves)[:, None]
    base = twigs[which, 0] * (1 - along) + twigs[which, 2] * along + rng.normal(0.0, 0.022 * bare.height, (leaves, 3))
    out = unit(bare.tips[which] + 1.2 * sphere_directions(rng, leaves) - 0.2 * UP)
    shade = p.shades(rng, len(twigs))[which]
    facing = UP + 0.7 * sphere_directions(rng, leaves)
    blade = Blade(size * rng.uniform(0.7, 1.2, leaves), 0.55 * size, 0.25, 2, 3)
    foliage = blades(base, out, facing, blade, colour + shade)
    return merge(bare.wood, foliage)


def conifer(rng: np.random.Generator, height: float, leaves: int, detail: float) -> PaletteMesh:
    """A spruce: whorls of drooping boughs made of long blades, 4 triangles each."""
    t = np.linspace(0.0, 1.0, steps(4, detail, 2) + 1)
    trunk = np.stack([0.0 * t, height * t - 0.2, 0.0 * t], axis=1)
    y = 1.0 - power(rng.uniform(0.0, 1.0, leaves), 0.6) * 0.88
    angle = rng.uniform(0.0, 2.0 * np.pi, leaves)
    flat = np.stack([cos(angle), np.zeros(leaves), sin(angle)], axis=1)
    reach = 0.24 * height * (1.04 - y)
    start = rng.uniform(0.0, 0.65, leaves) * reach
    base = flat * start[:, None] + UP * (y * height - 0.28 * start)[:, None]
    size = np.minimum(0.5 * reach + 0.1, 0.09 * height)
    along = flat * 0.9 - 0.25 * UP + 0.35 * sphere_directions(rng, leaves)
    boughs = blades(
        base,
        along,
        UP + 0.3 * sphere_directions(rng, leaves),
        Blade(size, 0.3 * size, 0.2, 2, 3),
        p.PINE + p.shades(rng, leaves),
    )
    return merge(tubes(trunk[None], height * 0.022 * (1.06 - t), steps(7, detail, 4), p.BARK), boughs)


# --- Vases, pots, crates, barrels, benches, bottles, shelves and cloth, standing on y = 0 -----------------------------


SINK = 0.015  # metres by which props extend into the floor, against gaps and coplanar faces


def vase(
    height: float, detail: float, colour: int = p.TERRACOTTA, belly: float = 0.3, neck: float = 0.11
) -> PaletteMesh:
    """A hollow amphora with two handles."""
    h, n = height, steps(7, detail, 2)
    t = np.linspace(0.0, 1.0, n + 1)
    radius = 0.1 + (belly - 0.1) * power(np.maximum(sin(np.pi * np.minimum(power(t, 0.85), 1.0)), 0.0), 1.2)
    radius = np.where(t > 0.75, np.maximum(radius, neck), radius)
    radius[-1] = neck
    outside = np.stack([radius, 0.05 + 0.77 * t], axis=1)
    profile = np.concatenate(
        [
            [(0.0, 0.0), (0.15, 0.0), (0.15, 0.03)],
            outside,
            [
                (neck, 0.92),
                (neck + 0.05, 0.97),
                (neck + 0.05, 1.0),
                (neck - 0.01, 1.0),
                (neck - 0.03, 0.9),
                (neck - 0.03, 0.8),
                (0.0, 0.7),
            ],
        ]
    )
    profile[:, 1] -= SINK / h
    body = revolve(profile * h, steps(20, detail, 5), colour)
    if detail < 0.3:
        return body
    bend = arc((neck - 0.01, 0.78), (0.16, 0.13), -70, 80, steps(6, detail, 3))
    side = np.stack([bend[:, 0], bend[:, 1], 0.0 * bend[:, 0]], axis=1) * h
    handles = tubes(np.stack([side, side * [-1, 1, 1]]), np.full(len(side), 0.018 * h), steps(5, detail, 3), colour)
    return merge(body, handles)


def pot(height: float, radius: float, detail: float, colour: int = p.TERRACOTTA) -> PaletteMesh:
    """A flower pot, filled with earth to just below its rim."""
    h, r = height, radius
    wall = [
        (0.0, -SINK),
        (0.72 * r, -SINK),
        (0.95 * r, 0.8 * h),
        (1.05 * r, 0.82 * h),
        (1.08 * r, h),
        (0.93 * r, h),
        (0.9 * r, 0.86 * h),
    ]
    segments = steps(18, detail, 6)
    body = revolve([*wall, (0.0, 0.86 * h)], segments, colour)
    body.colour[-segments:] = p.EARTH  # the fan on the axis
    return body


def crate(size: tuple[float, float, float], planks: int, colour: int = p.OAK) -> PaletteMesh:
    """A wooden box: a core with `planks` planks on every side but the bottom. With fewer than 2, a plain box."""
    w, h, d = size
    if planks < 2:
        return box((w, h + SINK, d), (0, (h - SINK) / 2, 0), colour)
    t = 0.06 * min(size)
    meshes = [box((w - 1.8 * t, h - 1.8 * t, d - 1.8 * t), (0, h / 2, 0), p.DARK_WOOD)]
    edge, y = (np.arange(planks) + 0.5) / planks, h / planks * 0.94
    for sign in (-1, 1):
        front = np.stack([0 * edge, edge * h - SINK, 0 * edge + sign * (d - t) / 2], axis=1)
        meshes.append(boxes((w - t, y, t), front, colour + np.arange(planks) % 4))
        side = np.stack([0 * edge + sign * (w - t) / 2, edge * h - SINK, 0 * edge], axis=1)
        meshes.append(boxes((t * 0.98, y, d - 2.04 * t), side, colour + np.arange(planks) % 3))
        meshes.append(box((1.1 * t, h + SINK, 1.1 * t), (sign * (w / 2), (h - SINK) / 2, d / 2), p.DARK_WOOD))
        meshes.append(box((1.1 * t, h + SINK, 1.1 * t), (sign * (w / 2), (h - SINK) / 2, -d / 2), p.DARK_WOOD))
    top = np.stack([0 * edge, 0 * edge + h - t / 2 + 0.002, (edge - 0.5) * (d - t)], axis=1)
    meshes.append(boxes((w - 0.9 * t, t, 0.94 * (d - t) / planks), top, colour + np.arange(planks) % 4))
    return merge(*meshes)


def barrel(height: float, radius: float, detail: float) -> PaletteMesh:
    """A barrel of staves with three iron hoops."""
    n, segments = steps(6, detail, 2), steps(18, detail, 6)
    y = np.linspace(-1.0, 1.0, n + 1)
    bulge = radius * (1.0 - 0.2 * y * y)
    profile = np.concatenate(
        [
            [(0.0, 0.04), (0.75 * radius, 0.04), (0.76 * radius, -SINK)],
            np.stack([bulge, (y + 1) / 2 * (height + SINK) - SINK], axis=1),
            [(0.75 * radius, height), (0.74 * radius, height - 0.04), (0.0, height - 0.04)],
        ]
    )
    stave = 1.0 - 0.015 * (np.arange(segments) % 2)
    scale = np.broadcast_to(stave, (len(profile), segments))
    meshes = [revolve(profile, segments, p.OAK, scale)]
    meshes[0].colour[:] += (np.arange(len(meshes[0].colour)) // 2 % 4).astype(np.uint8)
    for level in (0.12, 0.5, 0.88) if detail > 0.3 else ():
        middle = radius * (1.0 - 0.2 * (2 * level - 1) ** 2) * 1.012
        half = 0.03 * height
        tilt = 0.4 * (0.5 - level) * radius * 0.06
        ring = [(middle * 0.9, -half), (middle - tilt, -half), (middle + tilt, half), (middle * 0.9, half)]
        angle = np.linspace(0.0, 2.0 * np.pi, segments, endpoint=False)[:, None]
        r, dy = np.array(ring).T
        sections = np.stack(
            [r * cos(angle), np.broadcast_to(dy + level * height, (segments, 4)), r * sin(angle)],
            axis=-1,
        )
        meshes.append(lofts(sections[None], p.IRON, closed=True))
    return merge(*meshes)


def bench(length: float, colour: int = p.MARBLE, bevel: float = 0.015) -> PaletteMesh:
    """A bench."""
    foot = box((0.14, 0.42, 0.36), (0, 0.21 - SINK / 2, 0), colour, bevel)
    shift = np.array([0.36 * length, 0, 0], np.float32)
    feet = [foot._replace(vertices=foot.vertices + sign * shift) for sign in (-1, 1)]
    return merge(*feet, box((length, 0.09, 0.46), (0, 0.45, 0), colour, bevel))


def bottle(height: float, detail: float, colour: int = p.GLASS) -> PaletteMesh:
    """A bottle."""
    h = height
    profile = [
        (0.0, 0.002),
        (0.13 * h, 0.002),
        (0.13 * h, 0.55 * h),
        (0.1 * h, 0.66 * h),
        (0.045 * h, 0.76 * h),
        (0.045 * h, h),
        (0.0, h),
    ]
    return revolve(profile, steps(10, detail, 5), colour)


def shelf(width: float, height: float, depth: float, boards: int) -> PaletteMesh:
    """An open shelf with its back to -z; board tops at fractions (i + 0.3) / boards of the height."""
    side = boxes((0.05, height, depth), [(s * (width / 2 - 0.025), height / 2 - SINK, 0) for s in (-1, 1)], p.DARK_WOOD)
    y = (np.arange(boards) + 0.3) / boards * height
    board = boxes((width - 0.08, 0.04, depth * 0.98), np.stack([0 * y, y - 0.02, 0 * y], axis=1), p.OAK)
    back = box((width - 0.09, 0.94 * height, 0.02), (0, height / 2, -depth / 2 + 0.03), p.DARK_WOOD + 1)
    return merge(side, board, back)


def cloth(
    size: tuple[float, float],
    cells: tuple[int, int],
    rng: np.random.Generator,
    folds: float = 5.0,
    depth: float = 0.07,
    sway: float = 0.0,
    colour: int = p.RED,
) -> PaletteMesh:
    """A hanging cloth, 1 cm thick, with its top edge along x at y = 0.

    size : width and height
    cells : quads along the width and the height
    sway : gathers the cloth to one side at half height
    """
    (width, height), (nx, ny) = size, cells
    u, v = np.linspace(-0.5, 0.5, nx + 1)[:, None], np.linspace(0.0, 1.0, ny + 1)[None]
    phase = rng.uniform(0.0, 2.0 * np.pi, 3)
    wave = sin(2 * np.pi * folds * u + phase[0] + 0.6 * v) + 0.4 * sin(2 * np.pi * folds * 1.7 * u + phase[1] - v)
    gather = sway * exp(-(((v - 0.55) / 0.28) ** 2))
    x = width * (u * (1.0 - 0.72 * gather) + 0.34 * gather)
    z = depth * (0.35 + 0.65 * v) * (1 + gather) * wave + 0.02 * sin(3.0 * v + phase[2])
    front = np.stack(np.broadcast_arrays(x, -height * v, z), axis=-1)
    normal = np.cross(np.gradient(front, axis=1), np.gradient(front, axis=0))
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
    band = (np.arange(ny) > 0.86 * ny) & (np.arange(ny) < 0.95 * ny) if ny > 8 else np.zeros(ny, bool)
    return shell(front, front - 0.01 * normal, np.where(band, p.OCHRE, colour) + np.zeros((nx, 1), int))
