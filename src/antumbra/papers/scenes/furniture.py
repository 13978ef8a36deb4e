"""Furniture of wood and metal: drawers, lamps, a bookcase, a chandelier, a door. It stands on y = 0 and faces +z."""

import numpy as np

from ...generate import palette as p
from ...generate.atrium import EMBED
from ...generate.props import SINK, shelf, vase
from ...generate.shapes import (
    PaletteMesh,
    ScenePart,
    arc,
    assemble,
    box,
    frame_ring,
    loft,
    merge,
    moved,
    place_copies,
    revolve,
    shell,
    steps,
    tubes,
)

SKETCH = 0.12  # up to this detail, shapes are as plain as possible

SPINES = (p.RED, p.BLUE, p.OCHRE, p.PINE, p.SLATE, p.CLAY, p.TEAL, p.LIMESTONE)


def drawers(width: float, height: float, depth: float, rows: int, columns: int, d: float, colour=p.OAK) -> PaletteMesh:
    """A chest of drawers on tapered legs."""
    leg, bevel = 0.14, 0.006 if d > SKETCH else 0.0
    body = height - leg - 0.02
    meshes = [
        box((width - 0.03, body, depth - 0.02), (0, leg + body / 2, 0), colour, bevel),
        box((width, 0.03, depth + 0.01), (0, height - 0.015, 0), colour + 3, bevel),
    ]
    leg_ = revolve([(0.016, -SINK), (0.026, leg + 0.02), (0.0, leg + 0.02)], steps(8, d, 4), p.DARK_WOOD)
    corners = [(x, 0, z) for x in (0.05 - width / 2, width / 2 - 0.05) for z in (0.05 - depth / 2, depth / 2 - 0.05)]
    w, h = (width - 0.05) / columns, (body - 0.03) / rows
    front = box((w - 0.02, h - 0.02, 0.03), colour=colour + 2, bevel=bevel)
    knob = [(0.009, -0.01), (0.009, 0.012), *arc((0, 0.026), 0.017, -60, 70, steps(6, d, 2)), (0.0, 0.042)]
    places = np.array(
        [
            ((c - (columns - 1) / 2) * w, leg + 0.015 + (r + 0.5) * h, depth / 2 - 0.01)
            for c in range(columns)
            for r in range(rows)
        ]
    )
    parts = [place_copies(leg_, corners), place_copies(front, places)]
    if d > SKETCH:
        parts.append(place_copies(revolve(knob, steps(14, d, 5), p.BRONZE), places + [0, 0, 0.014], tilt=np.pi / 2))
    return merge(*meshes, assemble(parts))


def table_lamp(height: float, d: float, colour=p.TEAL) -> PaletteMesh:
    """A lamp with a turned foot and a pleated shade. The shade is open at the top and at the bottom."""
    h = height
    foot = np.concatenate(
        [
            [(0.0, -0.004), (0.3 * h / 1.2, -0.004), (0.22 * h, 0.03 * h)],
            arc((0.03 * h, 0.28 * h), (0.16 * h, 0.22 * h), -70, 75, steps(12, d, 3)),
            [(0.03 * h, 0.55 * h), (0.015 * h, 0.72 * h), (0.0, 0.72 * h)],
        ]
    )
    k = steps(48, d, 8) // 2 * 2
    angle = np.linspace(0.0, 2.0 * np.pi, k, endpoint=False)[:, None]
    y = np.linspace(0.52, 1.0, steps(6, d) + 1) * h
    r = np.linspace(0.4, 0.26, len(y)) * h * (1.0 + 0.025 * (np.arange(k) % 2))[:, None]
    r = np.concatenate([r, r[:, ::-1] - 0.012 * h], axis=1)
    y = np.broadcast_to(np.concatenate([y, y[::-1]]), r.shape)
    shade = loft(np.stack([r * np.cos(angle), y, r * np.sin(angle)], axis=-1), p.WHITE, closed=True)
    return merge(revolve(foot, steps(24, d, 6), colour), shade)


def book(d: float, colour: int) -> PaletteMesh:
    """A book of size 1 x 1 x 1. It stands on y = 0, and its rounded spine faces +z. Above `SKETCH` it has pages."""
    if d <= SKETCH:
        return box((1, 1, 1), (0, 0.5, 0), colour)
    n = steps(7, d, 2)
    back = arc((0.0, 0.44), (0.5, 0.07), 0, 180, n)
    outer = np.concatenate([[(0.5, -0.5)], back, [(-0.5, -0.5)]])
    inner = outer * [0.8, 1.0] - [0.0, 0.05]
    inner[[0, -1], 1] = -0.5
    heights = np.linspace(0.0, 1.0, steps(4, d) + 1)[None, :, None]
    front, inside = (
        np.concatenate(np.broadcast_arrays(a[:, None, :1], heights, a[:, None, 1:]), axis=-1) for a in (outer, inner)
    )
    pages = box((0.84, 0.95, 0.88), (0, 0.495, -0.04), p.MARBLE)
    band = np.zeros((1, front.shape[1] - 1), int) + (np.arange(front.shape[1] - 1) % 3 == 1)
    return merge(shell(front, inside, colour + 4 * band + np.zeros((len(outer) - 1, 1), int)), pages)


def bookcase(width: float, height: float, depth: float, boards: int, d: float, rng) -> list[ScenePart]:
    """A shelf full of books, with a vase or a gap here and there."""
    share = min(1.0, 1.2 * d**0.5)  # at low detail there are fewer and thicker books
    kinds = [book(d, colour) for colour in SPINES]
    where, size, turn, kind = [], [], [], []
    for board in range(boards):
        y, x = (board + 0.3) / boards * height - 0.004, 0.07 - width / 2
        while x < width / 2 - 0.12:
            thick, tall = rng.uniform(0.022, 0.06) / share, rng.uniform(0.62, 0.86) * height / boards
            if rng.random() < 0.05:
                x += 0.16
            where.append((x + thick / 2, y, depth / 2 - 0.1 - 0.03 * rng.random()))
            size.append((thick * 0.96, min(tall, 0.3), 0.17))
            turn.append(rng.normal(0.0, 0.02))
            kind.append(rng.integers(len(kinds)))
            x += thick
    where, size, turn, kind = (np.array(a) for a in (where, size, turn, kind))
    parts = [place_copies(shelf(width, height, depth, boards))]
    for k, mesh in enumerate(kinds):
        own = kind == k
        parts.append(place_copies(mesh, where[own], turn[own], size[own], shade=p.shades(rng, int(own.sum())) % 4))
    tops = [
        place_copies(vase(0.34, 0.8 * d, p.BLUE), (-0.3 * width, height - 0.03, 0)),
        place_copies(vase(0.22, 0.8 * d, p.CLAY, 0.36, 0.14), (-0.05 * width, height - 0.03, 0.02)),
    ]
    lid = box((width, 0.04, depth), (0, height - 0.03, 0), p.DARK_WOOD)
    return [part for part in [*parts, place_copies(lid), *tops] if len(part.offset)]


def chandelier(drop: float, d: float) -> list[ScenePart]:
    """A chandelier that hangs `drop` metres below y = 0: turned body, curved arms with candles, strings of beads."""
    n, arms, reach = steps(10, d, 2), 8, 0.42
    body = np.concatenate(
        [
            [(0.0, -0.14)],
            arc((0.0, -0.06), 0.07, -80, 70, n),
            arc((0.01, 0.1), (0.045, 0.1), -60, 70, n),
            [(0.03, 0.22), (0.014, 0.26), (0.014, 0.34), (0.0, 0.35)],
        ]
    )
    cup = [(0.0, -0.03), (0.014, -0.03), (0.022, 0.0), (0.05, 0.02), (0.05, 0.026), (0.014, 0.02), (0.0, 0.02)]
    candle = [(0.012, 0.0), (0.012, 0.09), (0.004, 0.1), (0.009, 0.12), (0.007, 0.14), (0.0, 0.165)]
    turn = np.arange(arms) * 2.0 * np.pi / arms
    t = np.linspace(0.0, 1.0, steps(14, d, 3) + 1)
    r, y = 0.04 + (reach - 0.04) * t, -0.1 * np.sin(1.5 * np.pi * t) * (1.0 - 0.2 * t) + 0.02 * t
    path = np.stack([r, y, 0.0 * t], axis=-1)[None]
    arm = tubes(path, 0.011 - 0.003 * t, steps(8, d, 3), p.BRONZE)
    ends = np.stack([r[-1] * np.cos(turn), 0.0 * turn + y[-1] + 0.02, -r[-1] * np.sin(turn)], axis=1)
    k = steps(14, d, 5)
    rose = [(0.0, -0.05), (0.05, -0.05), (0.075, 0.0), (0.07, EMBED), (0.0, EMBED)]
    low = np.array([0.0, -drop, 0.0])
    parts = [
        place_copies(revolve(body, steps(20, d, 6), p.BRONZE)),
        place_copies(arm, np.zeros((arms, 3)), turn),
        place_copies(revolve(cup, k, p.BRONZE), ends),
        place_copies(revolve(candle, k, p.WHITE), ends + [0, 0.015, 0]),
        place_copies(
            tubes(np.array([[(0, 0.33, 0), (0, 0.6 * drop, 0), (0, drop, 0)]]), np.full(3, 0.007), 4, p.BRONZE)
        ),
        *([place_copies(_beads(ends, turn, d))] if d > SKETCH else []),
    ]
    return [*moved(parts, low), place_copies(revolve(rose, steps(20, d, 6), p.PLASTER))]


def _beads(ends, turn, d: float) -> PaletteMesh:
    """Strings of glass beads from arm to arm and from the arms up to the body."""
    n = 9
    t = (np.arange(n) + 0.5)[None, :, None] / n
    to = np.roll(ends, -1, axis=0)
    swags = ends[:, None] * (1 - t) + to[:, None] * t - [0.0, 0.3, 0.0] * t * (1 - t)
    top = np.array([0.0, 0.24, 0.0])
    rising = ends[:, None] * (1 - t) + top * t - [0.0, 0.35, 0.0] * t * (1 - t)
    m = steps(6, d, 2)
    angle = np.linspace(-np.pi / 2, np.pi / 2, m + 1)
    ball = np.stack([np.maximum(np.cos(angle), 0.0) * 0.009, np.sin(angle) * 0.012], axis=1)
    ball[[0, -1], 0] = 0.0
    return assemble(
        [place_copies(revolve(ball, steps(8, d, 4), p.GLASS), np.concatenate([swags, rising]).reshape(-1, 3))]
    )


def door(width: float, height: float, d: float) -> PaletteMesh:
    """A door with four panels, in its frame, in front of the wall at z = 0."""
    bevel = 0.008 if d > SKETCH else 0.0
    ring = frame_ring(
        [(0.0, -0.03), (0.1, -0.03), (0.1, 0.03), (0.02, 0.045), (0.0, 0.02)], width / 2, height / 2, p.WHITE
    )
    edge = frame_ring(
        [(-0.05, -0.02), (0.0, -0.02), (0.0, 0.012), (-0.03, 0.02)], 0.32 * width - 0.1, 0.2 * height, p.WHITE
    )
    panels = [(x, y, 0.012) for x in (-0.235 * width, 0.235 * width) for y in (0.27 * height, 0.74 * height)]
    knob = [(0.01, -0.02), (0.01, 0.03), *arc((0, 0.055), 0.026, -65, 75, steps(8, d, 2)), (0.0, 0.081)]
    return merge(
        box((width + EMBED, height, 0.03), (0, height / 2, 0), p.WHITE, bevel),
        assemble(
            [
                place_copies(ring, (0, height / 2, 0), tilt=np.pi / 2),
                place_copies(edge, panels, tilt=np.pi / 2),
                place_copies(
                    revolve(knob, steps(16, d, 5), p.BRONZE), (0.42 * width, 0.47 * height, 0.01), tilt=np.pi / 2
                ),
            ]
        ),
    )
