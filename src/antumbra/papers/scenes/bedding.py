"""Soft furniture: cushions, a bed with its cover, an armchair. They stand on y = 0 and face +z."""

import numpy as np

from ...generate import palette as p
from ...generate.props import SINK
from ...generate.shapes import PaletteMesh, assemble, box, boxes, merge, place_copies, revolve, shell, steps
from .furniture import SKETCH


def creases(rng, x, z, waves: int = 9) -> np.ndarray:
    """Heights, 0 to about 1, of a cloth with folds at x, z (metres). The ridges bend, and fade in places."""
    total = 0.0
    for _ in range(waves):
        angle, metres, a, b = rng.uniform((0.0, 0.18, 0.0, 0.0), (np.pi, 0.75, 6.3, 6.3))
        along, across = x * np.cos(angle) + z * np.sin(angle), z * np.cos(angle) - x * np.sin(angle)
        ridge = (1.0 - np.abs(np.sin(np.pi * across / metres + 0.9 * np.sin(3.1 * along + a) + b))) ** 2
        total = total + metres * ridge * (0.5 + 0.5 * np.sin(4.3 * along - a) * np.sin(3.7 * across + b))
    return total / (0.2 * waves)


def cushion(size, n: int, rng, edge: float, wrinkle: float, colour: int) -> PaletteMesh:
    """A stuffed cushion of `size` (3,), with n cells along its longer side. It lies on y = 0.

    edge : sharpness of the edge where its faces meet: 2 for a pillow, 8 for upholstery
    wrinkle : height of the creases in metres
    """
    w, h, length = size
    m, k = (max(3, round(n * side / max(w, length))) for side in (w, length))
    u = np.sin(np.linspace(-0.5, 0.5, m + 1) * np.pi)[:, None]
    v = np.sin(np.linspace(-0.5, 0.5, k + 1) * np.pi)[None]
    full = ((1.0 - np.abs(u) ** edge) * (1.0 - np.abs(v) ** edge)) ** (0.9 / edge**0.4)
    seam, tuck = 0.05 * h, 0.16 / edge
    x = w / 2 * u * (1.0 - tuck * (1.0 - v**2) * np.abs(u) ** 3)
    z = length / 2 * v * (1.0 - tuck * (1.0 - u**2) * np.abs(v) ** 3)
    upper, lower = ((h / 2 - seam) * full + wrinkle * creases(rng, x, z) * full**0.5 for _ in range(2))
    front = np.stack([x, h / 2 + seam + upper, z], axis=-1)
    back = np.stack([x, h / 2 - seam - lower, z], axis=-1)
    return shell(front, back, colour + np.int32(0))


def _over(s, half: float, r: float):
    """(outward offset, drop) at arc length s of a cloth that lies over an edge of radius r at `half`."""
    beyond = np.maximum(np.abs(s) - (half - r), 0.0)
    angle = np.minimum(beyond / r, np.pi / 2)
    rest = np.maximum(beyond - r * np.pi / 2, 0.0)
    out = np.minimum(np.abs(s), half - r) + r * np.sin(angle) + 0.08 * rest
    return np.sign(s) * out, r * (1.0 - np.cos(angle)) + rest


def cover(size, drop: float, n: int, rng, rise: float, colours) -> PaletteMesh:
    """A quilted cover over a mattress of `size` ((2,): x, z). The mattress has its top at y = 0 and its head at z = 0.

    The cover hangs `drop` metres over the sides and the foot. Its creases are `rise` high. It has n cells across.

    colours : two colours, in broad stripes
    """
    w, length = size
    k = max(3, round(n * (length + drop) / (w + 2 * drop)))
    s = np.linspace(-w / 2 - drop, w / 2 + drop, n + 1)[:, None]
    t = np.linspace(0.0, length + drop, k + 1)[None]
    x, side = _over(s, w / 2 + 0.02, 0.07)
    z, foot = _over(t, length + 0.02, 0.07)
    hang = np.hypot(side, foot)
    quilt = 0.012 * np.abs(np.sin(np.pi * s / 0.22) * np.sin(np.pi * t / 0.22)) ** 0.5
    fold = 0.07 * np.minimum(hang / drop, 1.0)
    x = x + fold * np.sign(s) * (side > 0.0) * (0.45 + 0.55 * np.sin(17.0 * t + 2.0 * np.sin(3.0 * t)))
    z = z + fold * (foot > 0.0) * (0.45 + 0.55 * np.sin(15.0 * s + 2.0 * np.sin(4.0 * s)))
    y = 0.035 + quilt + rise * creases(rng, s, t, 14) * np.exp(-4.0 * hang / drop) - hang
    front = np.stack(np.broadcast_arrays(x, y, z), axis=-1)
    normal = np.cross(np.gradient(front, axis=1), np.gradient(front, axis=0))
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
    stripe = np.sin(6.5 * (t[:, 1:] + t[:, :-1])) > 0.55
    colour = np.where(stripe, colours[1], colours[0]) + np.zeros((n, 1), int)
    return shell(front, front - 0.022 * normal, colour)


def headboard(width: float, height: float, n: int, colour: int) -> PaletteMesh:
    """An upholstered board with buttons in a diamond pattern. Its back lies in the plane z = 0."""
    m = max(2, round(n * height / width))
    x = np.linspace(-width / 2, width / 2, n + 1)[:, None]
    y = np.linspace(0.0, height, m + 1)[None]
    top = y * (1.0 + 0.12 * np.cos(np.pi * x / width) * (y / height) ** 3)  # a curved upper edge
    a, b = (np.abs(np.sin(np.pi * (x / 0.3 + s * y / 0.26))) for s in (1, -1))
    near = np.minimum(np.abs(np.abs(x) - width / 2), np.minimum(y, height - y))
    z = 0.07 + 0.045 * np.sqrt(a * b) * np.minimum(near / 0.05, 1.0)
    front = np.stack(np.broadcast_arrays(x, top, z), axis=-1)
    return shell(front, front * [1.0, 1.0, 0.0], colour)


def bed(width: float, length: float, d: float, rng) -> PaletteMesh:
    """A bed with its head at z = 0: frame, mattress, cover, turned sheet, pillows and a throw at the foot."""
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


def armchair(d: float, rng) -> PaletteMesh:
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
