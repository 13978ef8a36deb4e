"""Wooden and metal furniture, upholstery, and toys. Everything stands on y = 0; furniture faces +z."""

from collections.abc import Sequence

import numpy as np

from ....generate import palette as p
from ....generate.atrium import EMBED
from ....generate.props import SINK, shelf, vase
from ....generate.shapes import (
    PaletteMesh,
    ScenePart,
    arc,
    assemble,
    box,
    boxes,
    frame_ring,
    loft,
    merge,
    move_parts,
    place_copies,
    raise_mesh,
    revolve,
    shell,
    steps,
    tubes,
)
from ....kernels.elementary import atan2, cos, exp, power, sin

# --- Wood and metal ---------------------------------------------------------------------------------------------------


SKETCH = 0.12  # up to this detail, shapes are as plain as possible

SPINES = (p.RED, p.BLUE, p.OCHRE, p.PINE, p.SLATE, p.CLAY, p.TEAL, p.LIMESTONE)


def drawers(
    width: float, height: float, depth: float, rows: int, columns: int, d: float, colour: int = p.OAK
) -> PaletteMesh:
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


def table_lamp(height: float, d: float, colour: int = p.TEAL) -> PaletteMesh:
    """A lamp with a turned foot and a pleated shade, open at the top and bottom."""
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
    shade = loft(np.stack([r * cos(angle), y, r * sin(angle)], axis=-1), p.WHITE, closed=True)
    return merge(revolve(foot, steps(24, d, 6), colour), shade)


def book(d: float, colour: int) -> PaletteMesh:
    """A book of size 1 x 1 x 1 on y = 0, with its rounded spine facing +z; above `SKETCH` it has pages."""
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


def bookcase(
    width: float, height: float, depth: float, boards: int, d: float, rng: np.random.Generator
) -> list[ScenePart]:
    """A shelf full of books, with a vase or a gap here and there."""
    share = min(1.0, 1.2 * d**0.5)  # fewer and thicker books at low detail
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
    places, sizes, turns, book_kinds = (np.array(a) for a in (where, size, turn, kind))
    parts = [place_copies(shelf(width, height, depth, boards))]
    for k, mesh in enumerate(kinds):
        same_kind = book_kinds == k
        parts.append(
            place_copies(
                mesh,
                places[same_kind],
                turns[same_kind],
                sizes[same_kind],
                shade=p.shades(rng, int(same_kind.sum())) % 4,
            )
        )
    tops = [
        place_copies(vase(0.34, 0.8 * d, p.BLUE), (-0.3 * width, height - 0.03, 0)),
        place_copies(vase(0.22, 0.8 * d, p.CLAY, 0.36, 0.14), (-0.05 * width, height - 0.03, 0.02)),
    ]
    lid = box((width, 0.04, depth), (0, height - 0.03, 0), p.DARK_WOOD)
    return [part for part in [*parts, place_copies(lid), *tops] if len(part.offset)]


def chandelier(drop: float, d: float) -> list[ScenePart]:
    """A chandelier `drop` metres below y = 0: turned body, curved arms with candles, strings of beads."""
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
    r, y = 0.04 + (reach - 0.04) * t, -0.1 * sin(1.5 * np.pi * t) * (1.0 - 0.2 * t) + 0.02 * t
    path = np.stack([r, y, 0.0 * t], axis=-1)[None]
    arm = tubes(path, 0.011 - 0.003 * t, steps(8, d, 3), p.BRONZE)
    ends = np.stack([r[-1] * cos(turn), 0.0 * turn + y[-1] + 0.02, -r[-1] * sin(turn)], axis=1)
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
    return [*move_parts(parts, low), place_copies(revolve(rose, steps(20, d, 6), p.PLASTER))]


def _beads(ends: np.ndarray, turn: np.ndarray, d: float) -> PaletteMesh:
    """Strings of glass beads between the arms and from the arms up to the body."""
    n = 9
    t = (np.arange(n) + 0.5)[None, :, None] / n
    to = np.roll(ends, -1, axis=0)
    swags = ends[:, None] * (1 - t) + to[:, None] * t - [0.0, 0.3, 0.0] * t * (1 - t)
    top = np.array([0.0, 0.24, 0.0])
    rising = ends[:, None] * (1 - t) + top * t - [0.0, 0.35, 0.0] * t * (1 - t)
    m = steps(6, d, 2)
    angle = np.linspace(-np.pi / 2, np.pi / 2, m + 1)
    ball = np.stack([np.maximum(cos(angle), 0.0) * 0.009, sin(angle) * 0.012], axis=1)
    ball[[0, -1], 0] = 0.0
    return assemble(
        [place_copies(revolve(ball, steps(8, d, 4), p.GLASS), np.concatenate([swags, rising]).reshape(-1, 3))]
    )


def door(width: float, height: float, d: float) -> PaletteMesh:
    """A framed door with four panels, in front of the wall at z = 0."""
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


# --- Upholstery -------------------------------------------------------------------------------------------------------


def creases(rng: np.random.Generator, x: np.ndarray, z: np.ndarray, waves: int = 9) -> np.ndarray:
    """Heights, 0 to about 1, of a creased cloth at x, z (metres). The ridges bend, and fade in places."""
    total: np.ndarray = np.zeros(())
    for _ in range(waves):
        angle, metres, a, b = rng.uniform((0.0, 0.18, 0.0, 0.0), (np.pi, 0.75, 6.3, 6.3))
        along, across = x * cos(angle) + z * sin(angle), z * cos(angle) - x * sin(angle)
        ridge = (1.0 - np.abs(sin(np.pi * across / metres + 0.9 * sin(3.1 * along + a) + b))) ** 2
        total = total + metres * ridge * (0.5 + 0.5 * sin(4.3 * along - a) * sin(3.7 * across + b))
    return total / (0.2 * waves)


def cushion(
    size: tuple[float, float, float], n: int, rng: np.random.Generator, edge: float, wrinkle: float, colour: int
) -> PaletteMesh:
    """A stuffed cushion of `size` (3,) on y = 0, with n cells along its longer side.

    edge : sharpness of the edge where its faces meet: 2 for a pillow, 8 for upholstery
    wrinkle : height of the creases in metres
    """
    w, h, length = size
    m, k = (max(3, round(n * side / max(w, length))) for side in (w, length))
    u = sin(np.linspace(-0.5, 0.5, m + 1) * np.pi)[:, None]
    v = sin(np.linspace(-0.5, 0.5, k + 1) * np.pi)[None]
    full = power((1.0 - power(np.abs(u), edge)) * (1.0 - power(np.abs(v), edge)), 0.9 / power(edge, 0.4))
    seam, tuck = 0.05 * h, 0.16 / edge
    x = w / 2 * u * (1.0 - tuck * (1.0 - v**2) * np.abs(u * u * u))
    z = length / 2 * v * (1.0 - tuck * (1.0 - u**2) * np.abs(v * v * v))
    upper, lower = ((h / 2 - seam) * full + wrinkle * creases(rng, x, z) * full**0.5 for _ in range(2))
    front = np.stack([x, h / 2 + seam + upper, z], axis=-1)
    back = np.stack([x, h / 2 - seam - lower, z], axis=-1)
    return shell(front, back, colour + np.int32(0))


def _over(s: np.ndarray, half: float, r: float) -> tuple[np.ndarray, np.ndarray]:
    """(outward offset, drop) at arc length s of a cloth over an edge of radius r at `half`."""
    beyond = np.maximum(np.abs(s) - (half - r), 0.0)
    angle = np.minimum(beyond / r, np.pi / 2)
    hanging = np.maximum(beyond - r * np.pi / 2, 0.0)
    out = np.minimum(np.abs(s), half - r) + r * sin(angle) + 0.08 * hanging
    return np.sign(s) * out, r * (1.0 - cos(angle)) + hanging


def cover(
    size: tuple[float, float], drop: float, n: int, rng: np.random.Generator, rise: float, colours: tuple[int, int]
) -> PaletteMesh:
    """A quilted cover over a mattress of `size` ((2,): x, z) with its top at y = 0 and its head at z = 0.

    The cover hangs `drop` metres over the sides and the foot, and has creases `rise` high and n cells across.

    colours : two colours for broad stripes
    """
    w, length = size
    k = max(3, round(n * (length + drop) / (w + 2 * drop)))
    s = np.linspace(-w / 2 - drop, w / 2 + drop, n + 1)[:, None]
    t = np.linspace(0.0, length + drop, k + 1)[None]
    x, side = _over(s, w / 2 + 0.02, 0.07)
    z, foot = _over(t, length + 0.02, 0.07)
    hang = np.hypot(side, foot)
    quilt = 0.012 * np.abs(sin(np.pi * s / 0.22) * sin(np.pi * t / 0.22)) ** 0.5
    fold = 0.07 * np.minimum(hang / drop, 1.0)
    x = x + fold * np.sign(s) * (side > 0.0) * (0.45 + 0.55 * sin(17.0 * t + 2.0 * sin(3.0 * t)))
    z = z + fold * (foot > 0.0) * (0.45 + 0.55 * sin(15.0 * s + 2.0 * sin(4.0 * s)))
    y = 0.035 + quilt + rise * creases(rng, s, t, 14) * exp(-4.0 * hang / drop) - hang
    front = np.stack(np.broadcast_arrays(x, y, z), axis=-1)
    normal = np.cross(np.gradient(front, axis=1), np.gradient(front, axis=0))
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
    stripe = sin(6.5 * (t[:, 1:] + t[:, :-1])) > 0.55
    colour = np.where(stripe, colours[1], colours[0]) + np.zeros((n, 1), int)
    return shell(front, front - 0.022 * normal, colour)


def headboard(width: float, height: float, n: int, colour: int) -> PaletteMesh:
    """An upholstered board with diamond-pattern buttons; its back lies in the plane z = 0."""
    m = max(2, round(n * height / width))
    x = np.linspace(-width / 2, width / 2, n + 1)[:, None]
    y = np.linspace(0.0, height, m + 1)[None]
    top = y * (1.0 + 0.12 * cos(np.pi * x / width) * (y / height * (y / height) * (y / height)))  # a curved upper edge
    a, b = (np.abs(sin(np.pi * (x / 0.3 + s * y / 0.26))) for s in (1, -1))
    edge_distance = np.minimum(np.abs(np.abs(x) - width / 2), np.minimum(y, height - y))
    z = 0.07 + 0.045 * np.sqrt(a * b) * np.minimum(edge_distance / 0.05, 1.0)
    front = np.stack(np.broadcast_arrays(x, top, z), axis=-1)
    return shell(front, front * [1.0, 1.0, 0.0], colour)


def bed(width: float, length: float, d: float, rng: np.random.Generator) -> PaletteMesh:
    """A bed with its head at z = 0: frame, mattress, cover, turned-down sheet, pillows and a throw at the foot."""
    top, bevel = 0.52, 0.01 if d > SKETCH else 0.0
    foot = box((width + 0.1, 0.5, 0.06), (0, 0.25, length + 0.2), p.DARK_WOOD, bevel)
    rails = [
        box((0.04, 0.2, length + 0.2), (s * (width / 2 + 0.02), 0.22, length / 2 + 0.1), p.DARK_WOOD, bevel)
        for s in (-1, 1)
    ]
    legs = boxes(
        (0.09, 0.2 + SINK, 0.09),
        [(s * (width / 2 - 0.05), 0.1 - SINK / 2, z) for s in (-1, 1) for z in (0.1, length + 0.1)],
        p.DARK_WOOD,
    )
    mattress = cushion((width, 0.26, length), steps(24, d, 4), rng, 24.0, 0.0, p.WHITE)
    quilt = cover((width, length - 0.66), 0.3, steps(130, d, 8), rng, 0.075, (p.BLUE, p.BLUE + 2))
    sheet = cover((width + 0.05, 0.3), 0.22, steps(70, d, 5), rng, 0.03, (p.WHITE, p.WHITE + 1))
    throw = cover((width + 0.08, 0.42), 0.26, steps(80, d, 5), rng, 0.05, (p.OCHRE, p.CLAY))
    n = steps(34, d, 4)
    back = cushion((0.74, 0.2, 0.52), n, rng, 2.6, 0.035, p.WHITE)
    before = cushion((0.66, 0.18, 0.44), n, rng, 2.6, 0.03, p.TEAL)
    small = cushion((0.4, 0.15, 0.36), n, rng, 2.2, 0.02, p.OCHRE)
    x = width / 4
    return merge(
        foot,
        *rails,
        legs,
        headboard(width + 0.16, 1.12, steps(60, d, 4), p.CLAY),
        assemble(
            [
                place_copies(mattress, (0, top - 0.25, length / 2 + 0.06)),
                place_copies(quilt, (0, top, 0.72)),
                place_copies(sheet, (0, top + 0.045, 0.62)),
                place_copies(throw, (0, top + 0.075, length - 0.62)),
                place_copies(back, [(-x, top + 0.12, 0.27), (x, top + 0.12, 0.28)], [0.06, -0.04], tilt=0.95),
                place_copies(
                    before, [(-x - 0.02, top + 0.08, 0.47), (x - 0.05, top + 0.08, 0.46)], [-0.1, 0.08], tilt=0.75
                ),
                place_copies(small, (0.05, top + 0.07, 0.66), 0.15, tilt=0.7),
            ]
        ),
    )


def armchair(d: float, rng: np.random.Generator) -> PaletteMesh:
    """An armchair: an upholstered seat, back and arms, a small cushion, turned feet."""
    n = steps(30, d, 4)
    seat = cushion((0.62, 0.2, 0.64), n, rng, 8.0, 0.02, p.TERRACOTTA)
    base = cushion((0.84, 0.2, 0.76), steps(16, d, 4), rng, 12.0, 0.0, p.TERRACOTTA + 3)
    back = cushion((0.84, 0.22, 0.74), n, rng, 6.0, 0.02, p.TERRACOTTA)
    arm = cushion((0.17, 0.3, 0.74), n, rng, 7.0, 0.008, p.TERRACOTTA + 1)
    loose = cushion((0.42, 0.14, 0.42), n, rng, 2.2, 0.02, p.YELLOW)
    leg = revolve([(0.016, -SINK), (0.03, 0.1), (0.034, 0.2), (0.0, 0.2)], steps(10, d, 4), p.DARK_WOOD)
    return assemble(
        [
            place_copies(base, (0, 0.14, 0)),
            place_copies(seat, (0, 0.3, 0.06)),
            place_copies(back, (0, 0.66, -0.34), tilt=1.32),
            place_copies(arm, [(-0.37, 0.28, 0.03), (0.37, 0.28, 0.03)]),
            place_copies(loose, (0.06, 0.6, -0.1), 0.2, tilt=1.0),
            place_copies(leg, [(x, 0, z) for x in (-0.33, 0.33) for z in (-0.28, 0.3)]),
        ]
    )


# --- Toys -------------------------------------------------------------------------------------------------------------


COLOURS = (p.RED, p.YELLOW, p.BLUE, p.LIME, p.TEAL, p.OCHRE)


def _ball(radius: Sequence[float], segments: int, colour: int) -> PaletteMesh:
    """An ellipsoid of `radius` (3,) around zero."""
    n = max(3, segments // 2)
    angle = np.linspace(-np.pi / 2, np.pi / 2, n + 1)
    profile = np.stack([cos(angle), sin(angle)], axis=1)
    profile[[0, -1], 0] = 0.0
    round_ = revolve(profile, segments, colour)
    return round_._replace(vertices=round_.vertices * np.asarray(radius, np.float32))


def bear(height: float, d: float) -> PaletteMesh:
    """A sitting teddy bear that faces +z."""
    k = steps(22, d, 6)
    fur, pale = p.CLAY, p.LIMESTONE
    pieces: list[tuple[tuple[float, float, float], tuple[float, float, float], int]] = [
        ((0.21, 0.25, 0.19), (0, 0.24, 0), fur),
        ((0.14, 0.17, 0.06), (0, 0.24, 0.15), pale),
        ((0.2, 0.18, 0.18), (0, 0.62, 0.01), fur),
        ((0.09, 0.07, 0.08), (0, 0.57, 0.17), pale),
        ((0.03, 0.022, 0.02), (0, 0.6, 0.245), p.SLATE + 6),
    ]
    for s in (-1, 1):
        pieces += [
            ((0.075, 0.075, 0.04), (s * 0.16, 0.79, 0), fur),
            ((0.045, 0.045, 0.03), (s * 0.16, 0.79, 0.025), pale),
            ((0.022, 0.022, 0.016), (s * 0.075, 0.66, 0.172), p.SLATE + 6),
            ((0.07, 0.17, 0.075), (s * 0.235, 0.3, 0.06), fur),
            ((0.095, 0.08, 0.18), (s * 0.15, 0.08, 0.2), fur),
            ((0.07, 0.07, 0.02), (s * 0.155, 0.085, 0.37), pale),
        ]
    body = assemble([place_copies(_ball(r, k if max(r) > 0.1 else max(5, k // 2), c), at) for r, at, c in pieces])
    return body._replace(vertices=(body.vertices * height / 0.87).astype(np.float32))


def beach_ball(radius: float, d: float) -> PaletteMesh:
    """A ball in six colours."""
    k = steps(30, d, 6) // 6 * 6
    ball = _ball((radius,) * 3, k, 0)
    middle = ball.vertices[ball.faces].mean(axis=1)
    wedge = np.floor((atan2(middle[:, 2], middle[:, 0]) + np.pi) / (2.0 * np.pi) * 6.0).astype(int) % 6
    return raise_mesh(ball._replace(colour=np.array(COLOURS, np.uint8)[wedge]), radius - SINK / 4)


def blocks(d: float) -> PaletteMesh:
    """Seven wooden blocks: a stack of three, and four on the floor."""
    cube = box((0.07, 0.07, 0.07), (0, 0.034, 0), 0, 0.005 if d > SKETCH else 0.0)
    at = [
        (0, 0, 0),
        (0.004, 0.068, 0.003),
        (-0.004, 0.136, 0),
        (0.1, 0, 0.03),
        (0.14, 0, -0.09),
        (-0.13, 0, 0.05),
        (-0.02, 0, 0.17),
    ]
    return assemble(
        [place_copies(cube, at, [0.1, 0.4, -0.2, 0.9, 0.3, 1.3, 0.6], shade=[COLOURS[k % 6] for k in range(7)])]
    )


def rings(d: float) -> PaletteMesh:
    """Stacking rings on a rod, the largest at the bottom."""
    m, k = steps(8, d, 2), steps(22, d, 6)
    meshes = [revolve([(0.012, -SINK / 4), (0.012, 0.24), (0.02, 0.25), (0.012, 0.28), (0.0, 0.285)], k, p.WHITE)]
    for i in range(5):
        thick, reach = 0.022, 0.065 - 0.009 * i
        profile = [(0.0, 0.0), *arc((reach, thick), thick, -85, 85, m), (0.0, 2 * thick)]
        meshes.append(raise_mesh(revolve(profile, k, COLOURS[i]), 0.042 * i))
    return merge(*meshes)


def train(d: float) -> PaletteMesh:
    """A wooden engine with two wagons, along x."""
    bevel = 0.004 if d > SKETCH else 0.0
    wheel = revolve(
        [(0.0, -0.012), (0.026, -0.012), (0.026, 0.012), (0.008, 0.016), (0.0, 0.016)], steps(16, d, 5), p.RED
    )
    boiler = revolve([(0.0, 0.0), (0.03, 0.0), (0.033, 0.01), (0.033, 0.09), (0.0, 0.1)], steps(16, d, 5), p.TEAL)
    funnel = revolve([(0.009, 0.0), (0.009, 0.03), (0.017, 0.05), (0.0, 0.05)], steps(12, d, 5), p.SLATE)
    x = np.array([0.0, -0.19, -0.38])
    axles = [(c + a, 0.025, s * 0.042) for c in x for a in (-0.045, 0.045) for s in (-1, 1)]
    bodies = [box((0.16, 0.02, 0.07), (c, 0.042, 0), p.OAK, bevel) for c in x]
    load = [box((0.14, 0.05, 0.064), (c, 0.075, 0), colour, bevel) for c, colour in zip(x[1:], (p.YELLOW, p.BLUE))]
    cab = [
        box((0.055, 0.08, 0.066), (-0.045, 0.09, 0), p.RED, bevel),
        box((0.07, 0.012, 0.08), (-0.045, 0.134, 0), p.BLUE, bevel),
    ]
    return merge(
        *bodies,
        *load,
        *cab,
        assemble(
            [
                place_copies(wheel, axles, tilt=np.pi / 2),
                place_copies(boiler, (-0.02, 0.085, 0), np.pi / 2, tilt=np.pi / 2),
                place_copies(funnel, (0.05, 0.112, 0)),
            ]
        ),
    )
