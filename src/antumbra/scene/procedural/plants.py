"""Leaves, shrubs, palms, trees, ferns and grass. Leaves are thin: open, two-sided surfaces."""

from typing import NamedTuple

import numpy as np

from . import palette as p
from .shapes import Mesh, cross, merge, revolve, steps, tubes

UP = np.array([0.0, 1.0, 0.0])


def unit(v) -> np.ndarray:
    """Vectors along the last axis at length 1."""
    return v / np.maximum(np.linalg.norm(v, axis=-1, keepdims=True), 1e-12)


def sphere_directions(rng, n: int, low=-1.0) -> np.ndarray:
    """(n, 3) random unit vectors with y >= low."""
    y, angle = rng.uniform(low, 1.0, n), rng.uniform(0.0, 2.0 * np.pi, n)
    flat = np.sqrt(1.0 - y * y)
    return np.stack([flat * np.cos(angle), y, flat * np.sin(angle)], axis=1)


def blades(base, along, facing, length, width, droop, segments: int, ribs=2, colour=p.LEAF) -> Mesh:
    """k leaves: pointed ribbons that start at `base` and grow `along`.

    base, along, facing : (k, 3)
        `facing` is about where their upper sides look.
    length, width, droop : (k,) or one
        The tip bends against `facing` by droop x length.
    segments : int >= 2; ribs : 2 flat, or 3 with a folded midrib
        2 (segments - 1) triangles, or 4 (segments - 1).
    colour : one, or (k,)
    """
    along = unit(np.asarray(along, np.float64))
    side = unit(cross(along, facing))
    normal = cross(side, along)
    length, width, droop = (
        np.broadcast_to(np.asarray(a, np.float64), len(base))[:, None, None] for a in (length, width, droop)
    )
    t = np.linspace(0.0, 1.0, segments + 1)[None, :, None]
    centre = np.asarray(base)[:, None] + length * (
        along[:, None] * (t - 0.35 * droop**2 * t**2) - normal[:, None] * droop * t**2
    )
    half = width / 2.0 * np.sin(np.pi * t**0.75)
    inner, half = centre[:, 1:-1], half[:, 1:-1]
    columns = [inner - half * side[:, None], inner + half * side[:, None]]
    if ribs == 3:
        columns.insert(1, inner - 0.45 * half * normal[:, None])
    k, rings = len(base), np.stack(columns, axis=2)
    vertices = np.concatenate([centre[:, :1], rings.reshape(k, -1, 3), centre[:, -1:]], axis=1)
    faces = _blade_faces(segments, ribs)
    starts = np.arange(k, dtype=np.int32)[:, None, None] * vertices.shape[1]
    colour = np.broadcast_to(np.asarray(colour, np.uint8), k)
    return Mesh(
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


def agave(rng, leaves: int, length: float, segments: int, colour=p.MOSS) -> Mesh:
    """A rosette of long pointed leaves on the ground."""
    angle = np.arange(leaves) * 2.39996  # the golden angle
    rise = np.linspace(0.25, 1.4, leaves)
    flat = np.stack([np.cos(angle), np.zeros(leaves), np.sin(angle)], axis=1)
    along = flat * np.cos(rise)[:, None] + UP * np.sin(rise)[:, None]
    facing = UP * np.cos(rise)[:, None] - flat * np.sin(rise)[:, None]
    size = length * rng.uniform(0.8, 1.1, leaves)
    return blades(
        flat * 0.03,
        along,
        facing,
        size,
        0.16 * length,
        rng.uniform(0.15, 0.5, leaves),
        segments,
        3,
        colour + p.shades(rng, leaves),
    )


def shrub(rng, leaves: int, radius: float, height: float, size: float, colour=p.LEAF) -> Mesh:
    """A dense ball of leaves on stems; 4 triangles a leaf."""
    out = sphere_directions(rng, leaves, -0.5)
    reach = rng.uniform(0.55, 1.0, leaves)[:, None]
    base = out * reach * [radius, 0.5 * height, radius] + UP * 0.5 * height
    along = unit(out + 0.5 * sphere_directions(rng, leaves) - 0.15 * UP)
    foliage = blades(
        base,
        along,
        UP + 0.3 * out,
        size * rng.uniform(0.7, 1.3, leaves),
        0.5 * size,
        0.3,
        2,
        3,
        colour + p.shades(rng, leaves),
    )
    k = 5
    tip = sphere_directions(rng, k, 0.2) * [0.6 * radius, 0.35 * height, 0.6 * radius] + UP * 0.5 * height
    t = np.linspace(0.0, 1.0, 3)[None, :, None]
    paths = (tip[:, None] * [1, 0, 1]) * t**1.5 + tip[:, None] * [0, 1, 0] * t - UP * 0.03
    return merge(foliage, tubes(paths, np.array([0.025, 0.018, 0.008]) * max(1.0, radius), 4, p.BARK))


def palm(rng, fronds: int, leaflets: int, height: float, length: float, detail: float) -> Mesh:
    """A curved trunk with arching fronds of `leaflets` pairs of leaflets."""
    t = np.linspace(0.0, 1.0, steps(10, detail, 3) + 1)
    lean = rng.uniform(-0.08, 0.08, 2) * height
    trunk = np.stack([lean[0] * t**2, height * t - 0.05, lean[1] * t**2], axis=1)
    radius = height * (0.035 - 0.012 * t + 0.004 * (np.arange(len(t)) % 2))
    meshes = [tubes(trunk[None], radius, steps(9, detail, 5), p.BARK)]
    angle = np.arange(fronds) * 2.39996 + rng.uniform(-0.2, 0.2, fronds)
    rise = np.linspace(-0.1, 1.2, fronds)
    flat = np.stack([np.cos(angle), np.zeros(fronds), np.sin(angle)], axis=1)
    s = np.linspace(0.0, 1.0, max(2, leaflets // 3) + 1)[None, :, None]
    reach = (length * rng.uniform(0.85, 1.1, fronds))[:, None, None]
    climb = np.sin(rise)[:, None, None] * s - (0.35 + 0.35 * np.cos(rise)[:, None, None]) * s**2
    rachis = trunk[-1] + reach * (flat[:, None] * (np.cos(rise)[:, None, None] * s + 0.25 * s**2) + UP * climb)
    meshes.append(tubes(rachis, 0.008 * length * (1.15 - s[0, :, 0]), 3, p.LIME))
    at = np.linspace(0.12, 0.99, leaflets)
    low = np.minimum((at * (rachis.shape[1] - 1)).astype(int), rachis.shape[1] - 2)
    part = (at * (rachis.shape[1] - 1) - low)[:, None]
    base = rachis[:, low] * (1 - part) + rachis[:, low + 1] * part
    along = unit(rachis[:, low + 1] - rachis[:, low])
    across = unit(cross(along, UP + 0.0 * along))
    size = length * 0.34 * np.sin(np.pi * (0.15 + 0.8 * at)) + 0.02
    colour = np.repeat(p.LEAF + p.shades(rng, fronds), leaflets)
    for sign in (-1.0, 1.0):
        direction = unit(sign * across + 0.75 * along - 0.25 * UP)
        facing = cross(across, along)
        meshes.append(
            blades(
                base.reshape(-1, 3),
                direction.reshape(-1, 3),
                facing.reshape(-1, 3),
                np.tile(size, fronds),
                0.045 * min(1.0, 12.0 / leaflets) * length,
                0.25,
                3,
                2,
                colour,
            )
        )
    return merge(*meshes)


def ivy(rng, start, fall, leaves: int, size: float) -> Mesh:
    """Leaves along strings that hang from (k, 3) places by (k,) metres; 4 triangles a leaf."""
    which = rng.integers(0, len(start), leaves)
    down = rng.uniform(0.0, 1.0, leaves) ** 1.2
    base = start[which] - UP * (down * fall[which])[:, None]
    base[:, [0, 2]] += rng.normal(0.0, 0.05, (leaves, 2)) * (1.0 + down)[:, None]
    along = unit(sphere_directions(rng, leaves) * [1, 0.4, 1] - 0.7 * UP)
    colour = np.where(rng.random(leaves) < 0.3, p.LIME, p.LEAF) + p.shades(rng, leaves)
    return blades(
        base,
        along,
        sphere_directions(rng, leaves, 0.0),
        size * rng.uniform(0.6, 1.3, leaves),
        0.7 * size,
        0.3,
        2,
        3,
        colour,
    )


def branches(rng, base, along, length, number: int, n: int):
    """`number` curved paths (k * number, n + 1, 3) from each of the (k, m, 3) paths in `base`, and their directions."""
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

    wood: Mesh
    twigs: np.ndarray  # (k, 3, 3) paths
    tips: np.ndarray  # (k, 3) directions of the twigs
    height: float


def bare_tree(rng, height: float, detail: float, bark=p.BARK) -> BareTree:
    """Trunk and two orders of branches."""
    n = steps(5, detail, 2)
    t = np.linspace(0.0, 1.0, n + 1)
    sway = rng.normal(0.0, 0.035 * height, 2)
    trunk = np.stack([sway[0] * np.sin(2.2 * t), 0.75 * height * t - 0.2, sway[1] * np.sin(2.6 * t)], axis=1)[None]
    flare = height * (0.028 * (1.0 - 0.75 * t) + 0.02 * np.exp(-9.0 * t))
    first, way = branches(rng, trunk, UP[None], 0.42 * height, steps(9, detail**0.5, 5), steps(3, detail, 2))
    second, tips = branches(rng, first, way, 0.2 * height, steps(5, detail**0.5, 3), 2)
    thin = np.linspace(1.0, 0.3, first.shape[1])
    wood = merge(
        tubes(trunk, flare, steps(9, detail, 5), bark),
        tubes(first, 0.011 * height * thin, steps(5, detail, 3), bark),
        tubes(second, 0.0045 * height * np.array([1.0, 0.7, 0.3]), 3, bark),
    )
    return BareTree(wood, second, tips, height)


def tree(rng, bare: BareTree, leaves: int, size: float, colour=p.LEAF) -> Mesh:
    """A broadleaf tree: leaves of 4 triangles around the twigs, each twig in its own shade."""
    twigs = bare.twigs
    which = rng.integers(0, len(twigs), leaves)
    along = rng.uniform(0.15, 1.0, leaves)[:, None]
    base = twigs[which, 0] * (1 - along) + twigs[which, 2] * along + rng.normal(0.0, 0.022 * bare.height, (leaves, 3))
    out = unit(bare.tips[which] + 1.2 * sphere_directions(rng, leaves) - 0.2 * UP)
    shade = p.shades(rng, len(twigs))[which]
    facing = UP + 0.7 * sphere_directions(rng, leaves)
    foliage = blades(base, out, facing, size * rng.uniform(0.7, 1.2, leaves), 0.55 * size, 0.25, 2, 3, colour + shade)
    return merge(bare.wood, foliage)


def conifer(rng, height: float, leaves: int, detail: float) -> Mesh:
    """A spruce: whorls of drooping boughs made of long blades, 4 triangles each."""
    t = np.linspace(0.0, 1.0, steps(4, detail, 2) + 1)
    trunk = np.stack([0.0 * t, height * t - 0.2, 0.0 * t], axis=1)
    y = 1.0 - rng.uniform(0.0, 1.0, leaves) ** 0.6 * 0.88
    angle = rng.uniform(0.0, 2.0 * np.pi, leaves)
    flat = np.stack([np.cos(angle), np.zeros(leaves), np.sin(angle)], axis=1)
    reach = 0.24 * height * (1.04 - y)
    start = rng.uniform(0.0, 0.65, leaves) * reach
    base = flat * start[:, None] + UP * (y * height - 0.28 * start)[:, None]
    size = np.minimum(0.5 * reach + 0.1, 0.09 * height)
    along = flat * 0.9 - 0.25 * UP + 0.35 * sphere_directions(rng, leaves)
    boughs = blades(
        base,
        along,
        UP + 0.3 * sphere_directions(rng, leaves),
        size,
        0.3 * size,
        0.2,
        2,
        3,
        p.PINE + p.shades(rng, leaves),
    )
    return merge(tubes(trunk[None], height * 0.022 * (1.06 - t), steps(7, detail, 4), p.BARK), boughs)


def fern(rng, fronds: int, pairs: int, length: float) -> Mesh:
    """Arching fronds with `pairs` pairs of pinnae of 2 triangles."""
    angle = np.arange(fronds) * 2.39996 + rng.uniform(-0.3, 0.3, fronds)
    flat = np.stack([np.cos(angle), np.zeros(fronds), np.sin(angle)], axis=1)
    t = np.linspace(0.12, 1.0, pairs)[None, :, None]
    reach = length * rng.uniform(0.75, 1.1, fronds)[:, None, None]
    base = reach * (flat[:, None] * (0.75 * t + 0.2 * t**2) + UP * (0.85 * t - 0.6 * t**2))
    along = unit(np.gradient(base, axis=1))
    across = unit(cross(flat, UP))[:, None]
    size = (0.3 * reach * np.sin(np.pi * (0.1 + 0.88 * t)) + 0.01)[..., 0].ravel()
    colour = np.repeat(p.LEAF + p.shades(rng, fronds), pairs)
    stem = blades(
        np.zeros((fronds, 3)),
        flat * 0.66 + 0.75 * UP,
        UP - 0.7 * flat,
        1.02 * reach[:, 0, 0],
        0.012,
        0.42,
        5,
        2,
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
                size,
                0.34 * size + 0.012,
                0.2,
                2,
                2,
                colour,
            )
        )
    return merge(*meshes)


def grass(rng, blades_: int, height: float, spread: float, segments: int) -> Mesh:
    """A tuft of grass."""
    place = rng.normal(0.0, spread, (blades_, 2))
    base = np.stack([place[:, 0], np.full(blades_, -0.03), place[:, 1]], axis=1)
    lean = sphere_directions(rng, blades_, 0.0)
    along = unit(UP * 1.6 + lean)
    size = height * rng.uniform(0.5, 1.1, blades_)
    return blades(
        base,
        along,
        UP - lean,
        size,
        0.05 * height + 0.004,
        rng.uniform(0.1, 0.6, blades_),
        segments,
        2,
        p.GRASS + p.shades(rng, blades_),
    )


def bush(rng, size: float, detail: float, colour=p.PINE) -> Mesh:
    """A clipped ball: a lumpy solid."""
    n = steps(22, detail, 3)
    angle = np.linspace(-np.pi / 2, np.pi / 2, n + 1)
    profile = np.stack([np.cos(angle) * size, (np.sin(angle) + 0.95) * size], axis=1)
    profile[[0, -1], 0] = 0.0
    segments = 2 * n
    return revolve(profile, segments, colour, 1.0 + rng.normal(0.0, 0.03, (n + 1, segments)))
