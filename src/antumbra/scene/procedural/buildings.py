"""Towers, houses, cars and street furniture for the city. Each stands on y = 0 around its own origin."""

from typing import NamedTuple

import numpy as np

from . import palette as p
from .shapes import PaletteMesh, arc, box, boxes, capped, merge, prism, revolve, shell, steps, tubes

FLOOR = 3.4  # metres between floors
_RECESS, _REVEAL = 0.28, 0.07  # depth of windows in the wall, and slant of their sides


class Style(NamedTuple):
    """The style of a facade."""

    bay: float  # metres between windows
    share: float  # fraction of the bay that is window
    relief: bool  # whether windows are recessed; else they are only coloured
    wall: int  # row of the palette
    glass: int  # row of the palette
    ledge: float  # metres that a ledge at every floor stands out; 0: none


class Lines(NamedTuple):
    """Grid lines of a facade along one direction."""

    at: np.ndarray  # (n,) metres
    inset: np.ndarray  # (n,) 1 for recessed lines, else 0
    pane: np.ndarray  # (n,) bool: whether a pane follows the line


def tower_cost(width: float, depth: float, floors: int, style: Style) -> int:
    """The number of triangles of a `tower`."""
    bays = 2 * (max(1, round(width / style.bay)) + max(1, round(depth / style.bay)))
    lines = (4 if style.relief else 2) + (3 if style.ledge > 0.0 else 0)
    return 2 * (bays * (4 if style.relief else 2) + 4) * (floors * lines + 6)


def _side(length: float, style: Style) -> Lines:
    """The vertical lines of a side, with its first corner."""
    n = max(1, round(length / style.bay))
    step = length / n
    a = max(0.5 * step * (1.0 - style.share), min(0.5, 0.3 * step))
    if style.relief:
        offsets, inset, pane = [a, a + _REVEAL, step - a - _REVEAL, step - a], [0, 1, 1, 0], [0, 1, 0, 0]
    else:
        offsets, inset, pane = [a, step - a], [0, 0], [1, 0]
    along = (np.arange(n)[:, None] * step + offsets).ravel()
    return Lines(
        np.append(0.0, along) - length / 2, np.append(0, np.tile(inset, n)), np.append(0, np.tile(pane, n)) > 0
    )


def _rises(floors: int, style: Style, parapet: float) -> tuple[Lines, np.ndarray]:
    """(horizontal lines from below the ground to the roof, outward offset of the wall at each)."""
    sill, head, d = 0.8, FLOOR - 0.6, style.ledge
    if style.relief:
        y, inset, pane = [sill, sill + _REVEAL, head - _REVEAL, head], [0, 1, 1, 0], [0, 1, 0, 0]
    else:
        y, inset, pane = [sill, head], [0, 0], [1, 0]
    out = [0.0] * len(y)
    if d > 0.0:
        y, inset, pane, out = (
            [*y, FLOOR - 0.35, FLOOR - 0.3, FLOOR - 0.05],
            [*inset, 0, 0, 0],
            [*pane, 0, 0, 0],
            [*out, 0, d, d],
        )
    top = floors * FLOOR
    y = (np.arange(floors)[:, None] * FLOOR + y).ravel()
    y = np.concatenate([[-0.2], y, top + parapet * np.array([0.0, 0.12, 0.9, 0.95, 0.2])])
    inset, pane, out = (np.concatenate([[0], np.tile(a, floors), [0] * 5]) for a in (inset, pane, out))
    out[-5:] = 0.3, 0.35, 0.1, -0.25, -0.3
    return Lines(y, inset, pane > 0), out


def tower(
    width: float, depth: float, floors: int, style: Style, rng, base=0.0, roof=p.CONCRETE, parapet=1.0
) -> PaletteMesh:
    """A rectangular building with windows all around, ledges, and a parapet around a flat roof."""
    x, z = _side(width, style), _side(depth, style)
    hx, hz = width / 2, depth / 2
    sides = [
        np.stack([0 * z.at + hx, -z.at], axis=1),
        np.stack([-x.at, 0 * x.at - hz], axis=1),
        np.stack([0 * z.at - hx, z.at], axis=1),
        np.stack([x.at, 0 * x.at + hz], axis=1),
    ]
    sizes = [len(s) for s in sides]
    normal = np.repeat([(1.0, 0.0), (0.0, -1.0), (-1.0, 0.0), (0.0, 1.0)], sizes, axis=0)
    corner = np.cumsum([0, *sizes[:-1]])
    normal[corner] = [(1, 1), (1, -1), (-1, -1), (-1, 1)]
    rise, out = _rises(floors, style, parapet)
    inset = np.concatenate([z.inset, x.inset] * 2)
    shift = out[:, None] - _RECESS * rise.inset[:, None] * inset
    points = np.empty((len(rise.at), len(normal), 3))
    points[..., ::2] = np.concatenate(sides) + normal * shift[..., None]
    points[..., 1] = (rise.at + base)[:, None]
    window = rise.pane[:-1, None] & np.concatenate([z.pane, x.pane] * 2)
    glass = style.glass + p.shades(rng, window.size).reshape(window.shape)
    glass = np.where(rng.random(window.shape) < 0.06, p.YELLOW, glass)
    k = len(normal)
    colour = np.concatenate([np.where(window, glass, style.wall).ravel(), np.full(k, style.wall), np.full(k, roof)])
    return capped(points, (0, points[0, 0, 1], 0), (0, points[-1, 0, 1], 0), colour)


def round_tower(radius: float, floors: int, segments: int, rng, glass=p.GLASS) -> PaletteMesh:
    """A round tower with a ledge at every floor and a roof in the form of a flat cone."""
    y = (np.arange(floors)[:, None] * FLOOR + [0.3, FLOOR - 0.5, FLOOR - 0.45, FLOOR - 0.02]).ravel()
    r = radius + np.tile([0.0, 0.0, 0.45, 0.45], floors)
    top = floors * FLOOR
    profile = np.concatenate(
        [
            [(radius, -0.2)],
            np.stack([r, y], axis=1),
            [(0.7 * radius, top + 1.0), (0.7 * radius, top + 2.2), (0.0, top + 3.0)],
        ]
    )
    mesh = revolve(profile, segments, p.CONCRETE)
    cells = len(y) + 3
    pane = np.zeros((cells, segments, 2), bool)
    pane[1 : 4 * floors : 4] = (np.arange(segments) % 3 != 0)[:, None]
    shade = np.repeat(p.shades(rng, cells * segments), 2)
    mesh.colour[: pane.size] = np.where(pane.ravel()[: len(mesh.colour)], glass + shade, p.CONCRETE)[: pane.size]
    return mesh


def house(width: float, depth: float, floors: int, style: Style, rng, roof=p.TERRACOTTA) -> PaletteMesh:
    """A house with a gabled roof along x, eaves, and a chimney."""
    body = tower(width, depth, floors, style, rng, parapet=0.3)
    top, rise = floors * FLOOR + 0.45, 0.42 * depth
    y = np.array([[-depth / 2 - 0.6, -0.3], [0.0, rise], [depth / 2 + 0.6, -0.3]])
    half = (width + 1.0) / 2
    under = y - [0.0, 0.22]
    sections = np.stack(
        [
            np.stack([0 * y[:, 0] + x, line[:, 1] + top, line[:, 0]], axis=1)
            for line in (y, under)
            for x in (-half, half)
        ]
    )
    upper, lower = sections[:2], sections[2:]
    gable = prism(
        [(-depth / 2, top - 0.4), (0, top - 0.4), (depth / 2, top - 0.4)],
        [(-depth / 2, top - 0.3), (0, top + rise - 0.3), (depth / 2, top - 0.3)],
        width - 0.3,
        style.wall,
    )
    gable = gable._replace(vertices=gable.vertices[:, [2, 1, 0]] * np.float32([1, 1, -1]))
    stack = box((0.8, 2.2, 0.8), (0.28 * width, top + rise * 0.6 + 0.6, 0.2 * depth), p.BRICK)
    return merge(body, shell(upper, lower, roof), gable, stack)


def car(colour: int, detail: float) -> PaletteMesh:
    """A car along +x, 4.3 m long."""
    n = steps(2, detail)
    lower = [(-2.1, 0.35), (-1.6, 0.22), (0.0, 0.22), (1.6, 0.22), (2.15, 0.35)]
    upper = [(-2.12, 0.72), (-1.7, 0.93), (0.0, 0.95), (1.1, 0.9), (2.18, 0.68)]
    cabin = (
        [(-1.75, 0.9), (-1.2, 0.9), (0.2, 0.9), (1.15, 0.86)],
        [(-1.72, 0.95), (-1.15, 1.4), (0.15, 1.44), (1.1, 0.92)],
    )
    meshes = [
        prism(lower, upper, 1.75, colour),
        prism(*cabin, 1.45, p.GLASS),
        box((1.25, 0.05, 1.4), (-0.5, 1.44, 0), colour),
    ]
    rim = revolve([(0.33, -0.1), (0.33, 0.1)], 6 + 2 * n, p.IRON)
    wheel = rim.vertices[:, [0, 2, 1]] * np.float32([1, 1, -1])
    meshes += [rim._replace(vertices=wheel + np.float32([x, 0.32, z])) for x in (-1.35, 1.4) for z in (-0.8, 0.8)]
    return merge(*meshes)


def lamp(detail: float) -> PaletteMesh:
    """A street lamp that reaches out along +x."""
    bend = arc((0.9, 5.2), 0.9, 180, 90, steps(3, detail))
    path = np.concatenate([[(0.0, -0.1), (0.0, 2.5)], bend, [(1.5, 6.1)]])
    pole = tubes(
        np.insert(path, 2, 0.0, axis=1)[None], np.linspace(0.09, 0.045, len(path)), steps(5, detail, 3), p.IRON
    )
    return merge(pole, box((0.7, 0.12, 0.28), (1.7, 6.06, 0), p.IRON))


def tank(detail: float) -> PaletteMesh:
    """A water tank on legs for a roof."""
    k = steps(10, detail, 6)
    drum = revolve([(1.25, 1.5), (1.3, 3.6), (1.4, 3.65), (0.0, 4.6)], k, p.OAK)
    legs = boxes((0.16, 1.8, 0.16), [(x, 0.75, z) for x in (-0.8, 0.8) for z in (-0.8, 0.8)], p.IRON)
    return merge(drum, legs)


def cooler() -> PaletteMesh:
    """An air conditioner for a roof."""
    return merge(box((1.6, 1.3, 1.1), (0, 0.6, 0), p.CONCRETE + 3), box((1.0, 0.3, 0.8), (0.1, 1.35, 0), p.IRON))


def antenna() -> PaletteMesh:
    """A mast with cross bars for a roof."""
    bars = boxes(
        [(0.12, 8.2, 0.12), (1.8, 0.08, 0.08), (0.08, 0.08, 1.4)], [(0, 3.9, 0), (0, 6.6, 0), (0, 5.6, 0)], p.IRON
    )
    return merge(bars, box((1.2, 0.6, 1.2), (0, 0.12, 0), p.CONCRETE))


def billboard() -> PaletteMesh:
    """A board on two posts for a roof."""
    posts = boxes((0.2, 2.6, 0.2), [(-2.2, 1.1, 0), (2.2, 1.1, 0)], p.IRON)
    return merge(posts, box((6.0, 3.0, 0.25), (0, 3.2, 0), p.OCHRE))
