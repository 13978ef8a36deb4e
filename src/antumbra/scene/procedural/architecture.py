"""Columns, arches, vaults, walls, floors, stairs: parts of buildings around their own origin, standing on y = 0."""

import numpy as np

from . import palette as p
from .parts import assemble, put
from .plants import blades
from .shapes import PaletteMesh, arc, block, box, grid, heightfield, lofts, merge, prism, revolve, steps

EMBED = 0.02  # metres that parts reach into their neighbours, against gaps and coplanar faces


def column(height: float, radius: float, flutes: int, n: int, leaves=0, colour=p.LIMESTONE) -> PaletteMesh:
    """A column with plinth, attic base, tapered shaft, bell capital with `leaves` around it, and abacus.

    `n` sets the facets of the mouldings. A flute has `n` facets for `n` >= 3, and three for `n` = 2. The shaft is plain
    for `n` = 1. For `n` = 0 the column has its simplest form.
    """
    r, per = radius, 1 if n < 2 else max(3, n)
    low, high = 1.4 * r, height - 2.0 * r
    plinth, abacus = (0.03 * r, 0.08 * r) if n else (0.0, 0.0)
    ends = [
        box((2.75 * r, 0.5 * r, 2.75 * r), (0, 0.25 * r - EMBED, 0), colour, plinth),
        box((2.7 * r, 0.45 * r, 2.7 * r), (0, height - 0.225 * r + EMBED, 0), colour, abacus),
    ]
    if n == 0:
        profile = [(1.2 * r, 0.4 * r), (r, 0.8 * r), (0.87 * r, high), (1.25 * r, height - 0.3 * r)]
        return merge(*ends, revolve(profile, flutes, colour))
    base = [
        [(1.3 * r, 0.4 * r)],
        arc((1.08 * r, 0.68 * r), 0.24 * r, -70, 80, n),
        arc((1.02 * r, 1.12 * r), 0.13 * r, -70, 70, max(1, n - 1)),
    ]
    t = np.linspace(0.0, 1.0, max(2, n) + 1)
    shaft = np.stack([r * (1.0 - 0.13 * t**1.6), low + t * (high - low)], axis=1)
    t = np.linspace(0.0, 1.0, n + 1)
    bell = np.stack([r * (0.87 + 0.42 * t**2.4), high + 0.25 * r + t * 1.35 * r], axis=1)
    astragal = arc((0.9 * r, high + 0.12 * r), 0.1 * r, -60, 60, max(1, n - 2))
    scale = np.ones((1, flutes * per))
    if per > 1:
        scale = 1.0 - 0.085 * np.tile(np.sin(np.pi * np.arange(per) / per) ** 0.6, flutes)
        first, last = shaft[:1].copy(), shaft[-1:].copy()
        shaft[[0, -1], 1] += 0.12 * r, -0.12 * r  # flutes end a little before the shaft
        fluted = [np.ones((len(np.concatenate(base)) + 1, len(scale))), np.tile(scale, (len(shaft), 1))]
        shaft = np.concatenate([first, shaft, last])
        fluted.append(np.ones((len(astragal) + len(bell) + 2, len(scale))))
        scale = np.concatenate(fluted)
    profile = np.concatenate([*base, shaft, astragal, bell, [(1.25 * r, height - 0.3 * r)]])
    meshes = [*ends, revolve(profile, flutes * per, colour, scale)]
    if leaves:
        meshes.append(_acanthus(r, high + 0.25 * r, leaves, n + 1, colour))
    return merge(*meshes)


def _acanthus(r: float, y: float, leaves: int, segments: int, colour) -> PaletteMesh:
    """Two rows of leaves that curl away from a capital's bell."""
    rows = []
    for row, length, phase in ((0.0, 0.75 * r, 0.0), (0.45 * r, 0.95 * r, 0.5)):
        angle = (np.arange(leaves) + phase) * 2.0 * np.pi / leaves
        out = np.stack([np.cos(angle), np.zeros(leaves), -np.sin(angle)], axis=1)
        along = 0.98 * np.array([0, 1, 0]) + 0.2 * out
        width = np.full(leaves, 1.5 * np.pi * r / leaves)
        shape = blades(
            out * 0.86 * r + [0, y + row, 0],
            along,
            out,
            np.full(leaves, length),
            width,
            -0.4,
            segments,
            3,
            colour,
        )
        rows.append(shape)
    return merge(*rows)


def baluster(height: float, detail: float, colour=p.LIMESTONE) -> PaletteMesh:
    """A turned baluster."""
    h, n = height, steps(2, detail)
    profile = np.concatenate(
        [
            [(0.055, -EMBED), (0.055, 0.08 * h), (0.03, 0.12 * h)],
            arc((0.03, 0.34 * h), (0.042, 0.2 * h), -75, 65, n),
            arc((0.025, 0.78 * h), (0.03, 0.1 * h), -60, 60, n),
            [(0.055, 0.93 * h), (0.055, h + EMBED)],
        ]
    )
    return revolve(profile, steps(6, detail, 4), colour)


def arch(radius: float, top: float, depth: float, n: int, colour=p.SANDSTONE) -> PaletteMesh:
    """The wall along x above a round arch of `radius`, from its springing at y = 0 to y = `top`, `depth` thick in z."""
    curve = arc((0, 0), radius, 180, 0, n)
    end = np.array([[radius + EMBED, 0.0]])
    lower = np.concatenate([end * [-1, 1], curve, end])
    return prism(lower, np.stack([lower[:, 0], np.full(len(lower), top)], axis=1), depth, colour)


def doorway(
    width: float, half: float, spring: float, height: float, depth: float, n: int, colour=p.SANDSTONE
) -> PaletteMesh:
    """A wall along x, `width` by `height`, with a doorway 2 `half` wide under a round arch that springs at `spring`."""
    curve = arc((0.0, spring), half, 180, 0, n)
    sill = np.array([(width / 2, -EMBED), (half, -EMBED)])
    lower = np.concatenate([sill * [-1, 1], curve, sill[::-1]])
    x = np.concatenate([[-width / 2, -1.2 * half], curve[:, 0], [1.2 * half, width / 2]])
    x[[2, -3]] = -1.1 * half, 1.1 * half  # not above the jambs, against flat triangles
    return prism(lower, np.stack([x, np.full(len(x), height)], axis=1), depth, colour)


def voussoirs(radius: float, width: float, depth: float, stones: int, n: int, colour=p.LIMESTONE) -> PaletteMesh:
    """The stones of a round arch that springs at y = 0, light and dark in turn, with open joints."""
    joint = 0.012 / radius
    edges = np.linspace(np.pi, 0.0, stones + 1)
    angle = np.linspace(edges[:-1] - joint, edges[1:] + joint, n + 1).T  # (stones, n + 1)
    inner, outer = radius - 0.03, np.full(stones, radius + width)
    outer[stones // 2] += 0.35 * width  # the keystone
    r = np.stack([np.full(stones, inner), outer, outer, np.full(stones, inner)], axis=1)[:, None]
    z = np.broadcast_to(np.array([1, 1, -1, -1]) * depth / 2, (stones, n + 1, 4))
    sections = np.stack([np.cos(angle)[..., None] * r, np.sin(angle)[..., None] * r, z], axis=-1)
    return lofts(sections[:, :, ::-1], colour + np.array([0, 1] * stones)[:stones])


def vault(half: float, crown: float, top: float, n: int, colour=p.PLASTER) -> PaletteMesh:
    """A groin vault over a square bay of half width `half`, `crown` high in the middle, solid up to y = `top`."""
    radius = 1.2 * half  # less than half circles, so the corners stay blunt
    x = half * np.sin(np.linspace(-np.pi / 2, np.pi / 2, 2 * n + 1))
    barrel = crown - radius + np.sqrt(radius**2 - x**2)
    y = np.maximum(barrel[:, None], barrel)
    points = np.stack(np.broadcast_arrays(x[:, None], y, x), axis=-1)
    side = np.arange(2 * n) < n
    mesh = block(points, top, colour)
    mesh.faces[: 8 * n * n] = grid(points, colour, flip=side[:, None] != side).faces[:, ::-1]
    return mesh


def tiles(x0, x1, z0, z1, nx, nz, rng, colour=p.TRAVERTINE, accent=None, joint=0.03, relief=0.008) -> PaletteMesh:
    """A floor of nx x nz tiles with tops within `relief` / 2 of y = 0, bevelled into the joints."""
    lines = []
    for a, b, n in ((x0, x1, nx), (z0, z1, nz)):
        corner = np.linspace(a, b, n + 1)
        inner = np.stack([corner[:-1], corner[:-1] + joint / 2, corner[1:] - joint / 2], axis=1)
        lines.append(np.append(inner, b))
    height = np.full((nx, 3, nz, 3), -1.5 * relief)
    height[:, 1:, :, 1:] = (
        rng.uniform(-relief, relief, (nx, 2, nz, 2)) / 8 + rng.uniform(-3, 3, (nx, 1, nz, 1)) * relief / 8
    )
    height = np.pad(height.reshape(3 * nx, 3 * nz), ((0, 1), (0, 1)), constant_values=-1.5 * relief)
    kind = np.full((nx, nz), colour)
    if accent is not None:
        i, j = np.indices((nx, nz))
        kind = np.where((i + j) % 2 == 0, accent, colour)
    shade = kind + p.shades(rng, nx * nz).reshape(nx, nz) % 4
    return heightfield(lines[0], lines[1], height, np.repeat(np.repeat(shade, 3, axis=0), 3, axis=1))


def ashlar(width: float, height: float, depth: float, course: float, rng, colour=p.SANDSTONE) -> PaletteMesh:
    """A wall along x in running bond, shown by shades. Its face at z = 0 looks to +z, and its back is at -depth."""
    nx, ny = max(2, round(width / course)), max(1, round(height / course))
    i, j = np.indices((nx, ny))
    stone = (i + j % 2) // 2
    shade = p.shades(rng, (nx + 2) * ny).reshape(nx + 2, ny)[stone, j]
    x, y = np.linspace(-width / 2, width / 2, nx + 1), np.linspace(0.0, height, ny + 1)[::-1]
    points = np.stack(np.broadcast_arrays(x[:, None], 0.0, -y), axis=-1)
    lying = block(points, -depth, (colour + shade)[:, ::-1])
    return assemble([put(lying, tilt=np.pi / 2)])


def stairs(n: int, width: float, rise: float, run: float, colour=p.SANDSTONE) -> PaletteMesh:
    """A flight of n steps that rises along +x from the origin, `width` wide in z, with a sloping underside."""
    i = np.arange(2 * n + 1)
    upper = np.stack([i // 2 * run, (i + 1) // 2 * rise], axis=1)
    soffit = np.maximum(i / 2 * rise - 2.0 * rise, -EMBED)
    return prism(upper, np.stack([i / 2 * run, soffit], axis=1), width, colour)  # this order avoids flat triangles
