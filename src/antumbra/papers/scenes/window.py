"""A wide window and its Venetian blinds. The wall lies along x with its inner face at z = 0; the room is at z > 0."""

import numpy as np

from ...generate import palette as p
from ...generate.atrium import EMBED
from ...generate.props import cloth
from ...generate.shapes import (
    PaletteMesh,
    ScenePart,
    arc,
    box,
    boxes,
    loft,
    merge,
    moved,
    place_copies,
    revolve,
    shell,
    steps,
    tubes,
)
from .furniture import SKETCH

WALL = 0.32  # thickness in metres
SILL, LINTEL, WIDTH = 0.25, 2.62, 4.9  # lower edge, upper edge and width of the opening
PANELS = 4
HANG = 0.1  # metres from the wall's inner face outwards to the centre of the slats
DEPTH = 0.05  # depth of a slat
SLATS = 56  # slats of a panel at full detail
COARSE = 0.3  # up to this detail, slats have no rungs below them


def pierced(low, high, thickness: float, colour=p.PLASTER) -> PaletteMesh:
    """A wall from `low` to `high` ((2,): x, y) with the opening of the window."""
    hole = np.array([(-WIDTH / 2, SILL), (WIDTH / 2, SILL), (WIDTH / 2, LINTEL), (-WIDTH / 2, LINTEL)])
    edge = np.array([(low[0], low[1]), (high[0], low[1]), (high[0], high[1]), (low[0], high[1])])
    sections = np.zeros((4, 4, 3))
    for k, (outline, z) in enumerate(((hole, 0.0), (edge, 0.0), (edge, -thickness), (hole, -thickness))):
        sections[:, k, :2], sections[:, k, 2] = outline, z
    return loft(sections, colour, closed=True)


def frame(d: float) -> list[ScenePart]:
    """The window's frame: mullions behind the gaps between the blinds, a transom, and a board on the sill."""
    middle, height, bevel = (SILL + LINTEL) / 2, LINTEL - SILL, 0.008 if d > SKETCH else 0.0
    x = np.linspace(-WIDTH / 2, WIDTH / 2, PANELS + 1)
    post = box((0.07, height + EMBED, 0.06), colour=p.WHITE, bevel=bevel)
    rail = box((WIDTH + EMBED, 0.07, 0.054), colour=p.WHITE, bevel=bevel)
    transom = box((WIDTH, 0.03, 0.03), colour=p.WHITE)
    board = box((WIDTH + 0.2, 0.035, 0.2), (0, SILL + 0.01, 0.02), p.MARBLE, bevel)
    back = 0.06 - WALL
    return [
        place_copies(post, [(at, middle, back) for at in x]),
        place_copies(rail, [(0, SILL + 0.03, back), (0, LINTEL - 0.03, back)]),
        place_copies(transom, [(0, SILL + 0.72 * height, back)]),
        place_copies(board),
    ]


def slat(length: float, width: float, d: float, ladders) -> PaletteMesh:
    """A curved slat along x, centred at the origin, hollow side down, with a rung of every ladder (at x) below it."""
    n, m = steps(12, d), steps(4, d, 2)
    t = np.sin(np.linspace(-0.5, 0.5, n + 1) * np.pi)[:, None]  # denser at the rounded ends
    s = np.linspace(-0.5, 0.5, m + 1)[None]
    z = width * s * (1.0 - 0.4 * np.abs(t) ** 40 if n > 4 else 1.0)
    sag = 0.04 * width * np.sin(np.pi * t * length / 2 / ladders[-1]) ** 2 if n > 4 else 0.0  # between the ladders
    y = 0.5 * width * (0.25 - s**2) - sag
    upper = np.stack(np.broadcast_arrays(length / 2 * t, y, z), axis=-1)
    body = shell(upper, upper - [0.0, 0.04 * width, 0.0], p.LIMESTONE)
    if d <= COARSE:
        return body
    across = np.stack(np.broadcast_arrays(0.0, -0.03 * width, np.linspace(-0.5, 0.5, 3) * width), axis=-1)
    rungs = np.array(ladders)[:, None, None] * [1.0, 0.0, 0.0] + across
    return merge(body, tubes(rungs, np.full(3, 0.0014), 3, p.WHITE))


def panel(width: float, height: float, tilt: float, d: float, rng) -> list[ScenePart]:
    """One blind, around x = z = 0, from y = 0 down to -`height`: head rail, slats turned by `tilt`, cords, rod."""
    n = min(SLATS, steps(SLATS, d**0.5, 12))
    rail, foot = 0.06, 0.03
    pitch = (height - rail - foot) / n
    chord = 1.18 * pitch
    y = -rail - pitch * (np.arange(n) + 0.5)
    ladders = np.array([-0.38, 0.0, 0.38]) * width
    one = slat(width, chord, d, ladders)
    each = tilt + rng.normal(0.0, 0.012, n)
    place = np.stack([rng.normal(0.0, 0.0012, n), y, 0.0 * y], axis=1)
    head = box((width, rail, DEPTH + 0.012), (0, -rail / 2, 0), p.LIMESTONE, 0.004 if d > SKETCH else 0.0)
    bottom = box((width, foot, 0.6 * DEPTH), (0, foot / 2 - height, 0), p.LIMESTONE, 0.006 if d > SKETCH else 0.0)
    parts = [
        place_copies(one, place, rng.normal(0.0, 0.0015, n), tilt=each, shade=rng.integers(0, 3, n)),
        place_copies(head),
        place_copies(bottom),
    ]
    return parts if d <= SKETCH else parts + _strings(width, height, 0.5 * chord * np.cos(tilt), ladders, d)


def _strings(width: float, height: float, reach: float, ladders, d: float) -> list[ScenePart]:
    """The ladders' cords in front of and behind the slats, the lift cord, and the tilt rod."""
    y = np.linspace(-0.05, 0.02 - height, steps(12, d, 2) + 1)
    cords = np.stack([np.stack([0.0 * y + x, y, 0.0 * y + s * reach], axis=1) for x in ladders for s in (-1.0, 1.0)])
    front = 0.5 * DEPTH + 0.016
    fall = np.linspace(0.0, 1.0, steps(16, d, 3) + 1)
    x = 0.45 * width + 0.012 * np.sin(5.0 * fall)
    cord = np.stack([x, -0.03 - 0.62 * height * fall, front + 0.004 * np.sin(9.0 * fall)], axis=1)
    rod = np.stack([0.0 * fall - 0.46 * width, -0.03 - 0.55 * height * fall, front + 0.01 * fall], axis=1)
    sides, turns = steps(4, d, 3), steps(9, d, 4)
    tassel = revolve([(0.0, -0.05), (0.012, -0.045), (0.005, 0.0), (0.0, 0.004)], turns, p.OAK)
    knob = revolve([(0.0, -0.1), (0.008, -0.09), (0.006, 0.0), (0.0, 0.004)], turns, p.WHITE)
    return [
        place_copies(tubes(cords, np.full(len(y), 0.0016), sides, p.WHITE)),
        place_copies(tubes(cord[None], np.full(len(fall), 0.0018), sides, p.WHITE)),
        place_copies(tubes(rod[None], np.full(len(fall), 0.005), steps(6, d, 4), p.WHITE)),
        place_copies(tassel, cord[-1]),
        place_copies(knob, rod[-1]),
    ]


def venetian(tilts, d: float, rng) -> list[ScenePart]:
    """A blind in each part of the opening. `tilts` (PANELS,), radians, turn the slats; above 0 room sides hang down."""
    each = WIDTH / PANELS
    x = (np.arange(PANELS) - (PANELS - 1) / 2) * each
    parts = []
    for at, tilt in zip(x, tilts):
        parts += moved(panel(each - 0.014, LINTEL - SILL - 0.045, tilt, d, rng), (at, LINTEL - 0.006, -HANG))
    return parts


def curtains(top: float, colour: int, d: float, rng) -> list[ScenePart]:
    """Two curtains, drawn aside in folds, on a rod at height `top`."""
    nx, ny, wide = steps(64, d, 6), steps(40, d, 3), 0.5
    half, z = WIDTH / 2 + 0.14, 0.15
    rod = np.stack([np.linspace(-1.0, 1.0, 5) * (half + 0.3), 0 * np.ones(5) + top, 0 * np.ones(5) + z], axis=1)
    ball = np.concatenate([[(0.0, -0.035)], arc((0, 0), 0.035, -80, 80, steps(8, d, 2)), [(0.0, 0.035)]])
    parts = [
        place_copies(tubes(rod[None], np.full(5, 0.014), steps(10, d, 4), p.BRONZE)),
        place_copies(revolve(ball, steps(14, d, 5), p.BRONZE), [rod[0], rod[-1]]),
        place_copies(
            boxes((0.02, 0.02, z + EMBED), [(s * (half + 0.22), top, (z - EMBED) / 2) for s in (-1, 0, 1)], p.BRONZE)
        ),
    ]
    for side in (-1, 1):
        hung = cloth(wide, top - 0.03, nx, ny, rng, 5.0, 0.045, 0.3, colour, p.OCHRE)
        parts.append(place_copies(hung, (side * (half + 0.06), top - 0.008, z), 0.0 if side > 0 else np.pi))
    return parts
