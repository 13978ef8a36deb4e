"""Props: vases, pots, crates, barrels, benches, bottles, shelves, cloth. They stand on y = 0."""

import numpy as np

from . import palette as p
from .shapes import PaletteMesh, arc, box, boxes, lofts, merge, revolve, shell, steps, tubes

SINK = 0.015  # metres that props reach into the floor, against gaps and coplanar faces


def vase(height: float, detail: float, colour=p.TERRACOTTA, belly=0.3, neck=0.11) -> PaletteMesh:
    """A hollow amphora with two handles."""
    h, n = height, steps(7, detail, 2)
    t = np.linspace(0.0, 1.0, n + 1)
    radius = 0.1 + (belly - 0.1) * np.sin(np.pi * np.minimum(t**0.85, 1.0)) ** 1.2
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


def pot(height: float, radius: float, detail: float, colour=p.TERRACOTTA) -> PaletteMesh:
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


def crate(size, planks: int, colour=p.OAK) -> PaletteMesh:
    """A wooden box: a core with `planks` planks on every side but the bottom. Below 2 planks it is a plain box."""
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
            [r * np.cos(angle), np.broadcast_to(dy + level * height, (segments, 4)), r * np.sin(angle)],
            axis=-1,
        )
        meshes.append(lofts(sections[None], p.IRON, closed=True))
    return merge(*meshes)


def bench(length: float, colour=p.MARBLE, bevel=0.015) -> PaletteMesh:
    """A bench."""
    foot = box((0.14, 0.42, 0.36), (0, 0.21 - SINK / 2, 0), colour, bevel)
    shift = np.float32([0.36 * length, 0, 0])
    feet = [foot._replace(vertices=foot.vertices + sign * shift) for sign in (-1, 1)]
    return merge(*feet, box((length, 0.09, 0.46), (0, 0.45, 0), colour, bevel))


def bottle(height: float, detail: float, colour=p.GLASS) -> PaletteMesh:
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
    """An open shelf with its back to -z; board tops at (i + 0.3) / boards of the height."""
    side = boxes((0.05, height, depth), [(s * (width / 2 - 0.025), height / 2 - SINK, 0) for s in (-1, 1)], p.DARK_WOOD)
    y = (np.arange(boards) + 0.3) / boards * height
    board = boxes((width - 0.08, 0.04, depth * 0.98), np.stack([0 * y, y - 0.02, 0 * y], axis=1), p.OAK)
    back = box((width - 0.09, 0.94 * height, 0.02), (0, height / 2, -depth / 2 + 0.03), p.DARK_WOOD + 1)
    return merge(side, board, back)


def cloth(
    width: float,
    height: float,
    nx: int,
    ny: int,
    rng,
    folds=5.0,
    depth=0.07,
    sway=0.0,
    colour=p.RED,
    trim=p.OCHRE,
) -> PaletteMesh:
    """A hanging cloth 1 cm thick, with its top edge at y = 0 along x. `sway` gathers it to one side at half height."""
    u, v = np.linspace(-0.5, 0.5, nx + 1)[:, None], np.linspace(0.0, 1.0, ny + 1)[None]
    phase = rng.uniform(0.0, 2.0 * np.pi, 3)
    wave = np.sin(2 * np.pi * folds * u + phase[0] + 0.6 * v) + 0.4 * np.sin(2 * np.pi * folds * 1.7 * u + phase[1] - v)
    gather = sway * np.exp(-(((v - 0.55) / 0.28) ** 2))
    x = width * (u * (1.0 - 0.72 * gather) + 0.34 * gather)
    z = depth * (0.35 + 0.65 * v) * (1 + gather) * wave + 0.02 * np.sin(3.0 * v + phase[2])
    front = np.stack(np.broadcast_arrays(x, -height * v, z), axis=-1)
    normal = np.cross(np.gradient(front, axis=1), np.gradient(front, axis=0))
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
    band = (np.arange(ny) > 0.86 * ny) & (np.arange(ny) < 0.95 * ny) if ny > 8 else np.zeros(ny, bool)
    return shell(front, front - 0.01 * normal, np.where(band, trim, colour) + np.zeros((nx, 1), int))
