"""Leaves, shrubs, ivy, ferns, grass and bushes. Leaves are thin: open, two-sided surfaces."""

import numpy as np

from . import palette as p
from .shapes import PaletteMesh, cross, merge, revolve, steps, tubes

UP = np.array([0.0, 1.0, 0.0])


def unit(v) -> np.ndarray:
    """Vectors along the last axis, scaled to length 1."""
    return v / np.maximum(np.linalg.norm(v, axis=-1, keepdims=True), 1e-12)


def sphere_directions(rng, n: int, low=-1.0) -> np.ndarray:
    """(n, 3) random unit vectors with y >= low."""
    y, angle = rng.uniform(low, 1.0, n), rng.uniform(0.0, 2.0 * np.pi, n)
    flat = np.sqrt(1.0 - y * y)
    return np.stack([flat * np.cos(angle), y, flat * np.sin(angle)], axis=1)


def blades(base, along, facing, length, width, droop, segments: int, ribs=2, colour=p.LEAF) -> PaletteMesh:
    """k leaves: pointed ribbons that start at `base` and grow `along`.

    base, along, facing : (k, 3)
        Start, direction of growth, and approximate direction of the upper side.
    length, width, droop : (k,) or one
        The tip bends away from `facing` by droop x length.
    segments : int, at least 2
    ribs : 2 for flat leaves, or 3 for a folded midrib
        A leaf has 2 (segments - 1) triangles, or 4 (segments - 1) with a midrib.
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


def agave(rng, leaves: int, length: float, segments: int, colour=p.MOSS) -> PaletteMesh:
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


def shrub(rng, leaves: int, radius: float, height: float, size: float, colour=p.LEAF) -> PaletteMesh:
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


def ivy(rng, start, fall, leaves: int, size: float) -> PaletteMesh:
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


def fern(rng, fronds: int, pairs: int, length: float) -> PaletteMesh:
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


def grass(rng, blades_: int, height: float, spread: float, segments: int) -> PaletteMesh:
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


def bush(rng, size: float, detail: float, colour=p.PINE) -> PaletteMesh:
    """A clipped ball: a lumpy solid."""
    n = steps(22, detail, 3)
    angle = np.linspace(-np.pi / 2, np.pi / 2, n + 1)
    profile = np.stack([np.cos(angle) * size, (np.sin(angle) + 0.95) * size], axis=1)
    profile[[0, -1], 0] = 0.0
    segments = 2 * n
    return revolve(profile, segments, colour, 1.0 + rng.normal(0.0, 0.03, (n + 1, segments)))
