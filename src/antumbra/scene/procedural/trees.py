"""Palms, broadleaf trees and spruces: closed trunks and branches, thin leaves."""

from typing import NamedTuple

import numpy as np

from . import palette as p
from .plants import UP, blades, sphere_directions, unit
from .shapes import PaletteMesh, cross, merge, steps, tubes


def palm(rng, fronds: int, leaflets: int, height: float, length: float, detail: float) -> PaletteMesh:
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


def branches(rng, base, along, length, number: int, n: int):
    """(curved paths, (k * number, n + 1, 3); their directions): `number` from each of the (k, m, 3) paths `base`."""
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


def tree(rng, bare: BareTree, leaves: int, size: float, colour=p.LEAF) -> PaletteMesh:
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


def conifer(rng, height: float, leaves: int, detail: float) -> PaletteMesh:
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
