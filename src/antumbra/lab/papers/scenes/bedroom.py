"""A bedroom at low sun, lit only through the Venetian blinds of a wide window, which block most of the light.

The window's wall lies along x with its inner face at z = 0; the room is at z > 0.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np

from ....generate import palette as p
from ....generate.atrium import EMBED, tiles
from ....generate.props import UP, Blade, agave, blades, cloth, palm, pot, shrub, sphere_directions, unit
from ....generate.shapes import (
    PaletteMesh,
    ScenePart,
    arc,
    assemble,
    block,
    box,
    boxes,
    count,
    fitted,
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
from ....kernels.elementary import cos, sin
from .furnishings import (
    SKETCH,
    armchair,
    beach_ball,
    bear,
    bed,
    blocks,
    bookcase,
    chandelier,
    door,
    drawers,
    rings,
    table_lamp,
    train,
)
from .museum_halls import painting

# --- Window and Venetian blinds ---------------------------------------------------------------------------------------


WALL = 0.32  # thickness in metres
SILL, LINTEL, WIDTH = 0.25, 2.62, 4.9  # lower edge, upper edge and width of the opening
PANELS = 4
HANG = 0.1  # metres from the wall's inner face outwards to the centre of the slats
DEPTH = 0.05  # depth of a slat
SLATS = 56  # slats per panel at full detail
COARSE = 0.3  # up to this detail, slats have no ladder rungs


def pierced(
    low: tuple[float, float], high: tuple[float, float], thickness: float, colour: int = p.PLASTER
) -> PaletteMesh:
    """A wall from `low` to `high` ((2,): x, y) with the window opening."""
    hole = np.array([(-WIDTH / 2, SILL), (WIDTH / 2, SILL), (WIDTH / 2, LINTEL), (-WIDTH / 2, LINTEL)])
    edge = np.array([(low[0], low[1]), (high[0], low[1]), (high[0], high[1]), (low[0], high[1])])
    sections = np.zeros((4, 4, 3))
    for k, (outline, z) in enumerate(((hole, 0.0), (edge, 0.0), (edge, -thickness), (hole, -thickness))):
        sections[:, k, :2], sections[:, k, 2] = outline, z
    return loft(sections, colour, closed=True)


def frame(d: float) -> list[ScenePart]:
    """The window frame: mullions behind the gaps between the blinds, a transom, and a window board."""
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


def slat(length: float, width: float, d: float, ladders: Sequence[float] | np.ndarray) -> PaletteMesh:
    """A curved slat along x, centred at the origin, concave side down, above a rung of every ladder (at x)."""
    n, m = steps(12, d), steps(4, d, 2)
    t = sin(np.linspace(-0.5, 0.5, n + 1) * np.pi)[:, None]  # denser at the rounded ends
    s = np.linspace(-0.5, 0.5, m + 1)[None]
    z = width * s * (1.0 - 0.4 * np.abs(t) ** 40 if n > 4 else 1.0)
    sag = 0.04 * width * sin(np.pi * t * length / 2 / ladders[-1]) ** 2 if n > 4 else 0.0  # between the ladders
    y = 0.5 * width * (0.25 - s**2) - sag
    upper = np.stack(np.broadcast_arrays(length / 2 * t, y, z), axis=-1)
    body = shell(upper, upper - [0.0, 0.04 * width, 0.0], p.LIMESTONE)
    if d <= COARSE:
        return body
    across = np.stack(np.broadcast_arrays(0.0, -0.03 * width, np.linspace(-0.5, 0.5, 3) * width), axis=-1)
    rungs = np.array(ladders)[:, None, None] * [1.0, 0.0, 0.0] + across
    return merge(body, tubes(rungs, np.full(3, 0.0014), 3, p.WHITE))


def panel(width: float, height: float, tilt: float, d: float, rng: np.random.Generator) -> list[ScenePart]:
    """One blind around x = z = 0, from y = 0 down to -`height`: head rail, slats tilted by `tilt`, cords, rod."""
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
    return parts if d <= SKETCH else parts + _strings(width, height, 0.5 * chord * cos(tilt), ladders, d)


def _strings(
    width: float, height: float, reach: float, ladders: Sequence[float] | np.ndarray, d: float
) -> list[ScenePart]:
    """The ladder cords in front of and behind the slats, the lift cord, and the tilt rod."""
    y = np.linspace(-0.05, 0.02 - height, steps(12, d, 2) + 1)
    cords = np.stack([np.stack([0.0 * y + x, y, 0.0 * y + s * reach], axis=1) for x in ladders for s in (-1.0, 1.0)])
    front = 0.5 * DEPTH + 0.016
    fall = np.linspace(0.0, 1.0, steps(16, d, 3) + 1)
    x = 0.45 * width + 0.012 * sin(5.0 * fall)
    cord = np.stack([x, -0.03 - 0.62 * height * fall, front + 0.004 * sin(9.0 * fall)], axis=1)
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


def venetian(tilts: np.ndarray, d: float, rng: np.random.Generator) -> list[ScenePart]:
    """A blind per panel, with slats tilted by `tilts` ((PANELS,), radians); positive lowers the room side."""
    each = WIDTH / PANELS
    x = (np.arange(PANELS) - (PANELS - 1) / 2) * each
    parts = []
    for at, tilt in zip(x, tilts):
        parts += move_parts(panel(each - 0.014, LINTEL - SILL - 0.045, tilt, d, rng), (at, LINTEL - 0.006, -HANG))
    return parts


def curtains(top: float, colour: int, d: float, rng: np.random.Generator) -> list[ScenePart]:
    """Two folded curtains, drawn aside, on a rod at height `top`."""
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
        hung = cloth((wide, top - 0.03), (nx, ny), rng, 5.0, 0.045, 0.3, colour)
        parts.append(place_copies(hung, (side * (half + 0.06), top - 0.008, z), 0.0 if side > 0 else np.pi))
    return parts


# --- Bedroom ----------------------------------------------------------------------------------------------------------


HALF_X, HALF_Z, HEIGHT = 2.7, 2.95, 2.85  # half widths and height of the room; the window is in the wall at -HALF_X
RUG = (0.3, 0.85, 2.3, 1.6)  # centre (x, z) and size of the rug
SUN = (21.0, 13.5, 26.0)  # degrees from the window's normal towards +z, degrees up, metres from the window
TILTS = (-18.0, -20.0, -16.0, -21.0)  # degrees, slats of each blind: the side facing the room is raised
WEAVE = ((0.45, 90), (0.32, 64))  # along x and z: (cells of the rug's ground per sqrt of its triangles, most cells)
CAMERA = {"position": (2.3, 1.62, 2.5), "target": (-0.72, 0.76, -1.7), "up": (0.0, 1.0, 0.0), "vfov": 66.0}


def blinds(triangles: int, seed: int) -> tuple[PaletteMesh, dict[str, Any], dict[str, Any]]:
    """Mesh, camera and light of the bedroom, with about `triangles` triangles."""

    def build(d: float) -> list[ScenePart]:
        room = _shell(d, np.random.default_rng([seed, 0])) + _window(d, np.random.default_rng([seed, 1]))
        return room + _furniture(d, np.random.default_rng([seed, 2])) + _clutter(d, np.random.default_rng([seed, 3]))

    parts = fitted(build, round(0.9 * triangles), np.sqrt(triangles / 300_000), near=0.9)
    parts += _rug(np.random.default_rng([seed, 4]), max(100, triangles - count(parts)))
    return assemble(parts), CAMERA, _sun()


def _sun() -> dict[str, Any]:
    """A strip light far outside: four metres long along the slats, and little higher than the sun's apparent size."""
    azimuth, height = np.radians(SUN[:2])
    to = np.array([-cos(azimuth) * cos(height), sin(height), sin(azimuth) * cos(height)])
    u = np.array([0.0, 0.0, 4.0])
    v = 0.16 * unit(np.cross(u, to))
    middle = np.array([-HALF_X, (SILL + LINTEL) / 2, 0.0]) + SUN[2] * to
    return {"corner": tuple(middle - u / 2 - v / 2), "u": tuple(u), "v": tuple(v)}


def _shell(d: float, rng: np.random.Generator) -> list[ScenePart]:
    """Floorboards, the three plain walls, ceiling, skirting, cornice, door."""
    x, z, h = HALF_X, HALF_Z, HEIGHT
    boards = tiles((-x - 0.05, x + 0.05, 3), (-z - 0.05, z + 0.05, steps(40, d, 8)), rng, p.OAK, None, 0.008, 0.003)
    skirting = [(EMBED, -EMBED), (-0.016, -EMBED), (-0.02, 0.07), (-0.012, 0.1), (EMBED, 0.105)]
    cornice = [(EMBED, -0.1), (-0.02, -0.1), (-0.04, -0.05), (-0.09, -0.03), (-0.1, EMBED), (EMBED, EMBED)]
    return [
        place_copies(boards),
        place_copies(box((2 * x + 0.6, 0.23, 2 * z + 0.5), (-0.05, -0.135, 0), p.CONCRETE)),
        place_copies(box((2 * x + 0.62, 0.25, 2 * z + 0.52), (-0.05, h + 0.125, 0), p.PLASTER)),
        place_copies(box((2 * x + 0.35, h + 0.3, 0.2), (0.025, h / 2 - 0.05, -z - 0.1), p.PLASTER)),
        place_copies(box((2 * x + 0.35, h + 0.3, 0.2), (0.025, h / 2 - 0.05, z + 0.1), p.PLASTER)),
        place_copies(box((0.17, h + 0.29, 2 * z + 0.2), (x + 0.085, h / 2 - 0.05, 0), p.PLASTER)),
        place_copies(frame_ring(skirting, x, z, p.WHITE)),
        place_copies(frame_ring(cornice, x, z, p.WHITE), (0, h, 0)),
        place_copies(door(0.9, 2.05, d), (0.4, 0, z), np.pi),
    ]


def _window(d: float, rng: np.random.Generator) -> list[ScenePart]:
    """The window wall with its blinds, each tilted slightly differently, and its curtains."""
    wall = pierced((-HALF_Z - 0.17, -0.19), (HALF_Z + 0.17, HEIGHT + 0.09), WALL)
    tilts = np.radians(TILTS) + rng.normal(0.0, 0.01, len(TILTS))
    parts = [place_copies(wall), *frame(d), *venetian(tilts, d, rng), *curtains(LINTEL + 0.08, p.TEAL, d, rng)]
    return move_parts(parts, (-HALF_X, 0.0, 0.0), np.pi / 2)


def _furniture(d: float, rng: np.random.Generator) -> list[ScenePart]:
    """Furniture along the walls, pictures on them, and a chandelier."""
    back, right = -HALF_Z, HALF_X
    table, low = drawers(0.5, 0.52, 0.4, 2, 1, d), drawers(1.3, 0.84, 0.45, 3, 2, d)
    lamp, n = table_lamp(0.46, d), steps(30, d, 2)
    wide, tall, small = painting(1.2, 0.62, n, rng), painting(0.5, 0.75, n, rng), painting(0.34, 0.44, n, rng)
    sides = [(x, 0.0, back + 0.24) for x in (-1.62, 0.92)]
    return [
        place_copies(bed(1.7, 2.05, d, rng), (-0.35, 0, back + 0.02)),
        place_copies(table, sides),
        place_copies(lamp, [(x, 0.515, z) for x, _, z in sides], [0.0, 0.4]),
        place_copies(low, (right - 0.25, 0, -0.5), -np.pi / 2),
        place_copies(table_lamp(0.56, d, p.OCHRE), (right - 0.26, 0.835, -0.95)),
        place_copies(armchair(d, rng), (-1.72, 0, 0.2), 1.0),
        place_copies(wide, (-0.35, 1.78, back + 0.06)),
        place_copies(small, [(0.92, 1.5, back + 0.06), (-1.62, 1.5, back + 0.06)]),
        place_copies(tall, [(right - 0.06, 1.55, -0.1), (right - 0.06, 1.55, 1.2)], -np.pi / 2),
        *move_parts(bookcase(1.24, 2.0, 0.3, 6, d, rng), (1.96, 0, back + 0.17)),
        *move_parts(chandelier(0.62, d), (0.15, HEIGHT, 0.0)),
    ]


def _clutter(d: float, rng: np.random.Generator) -> list[ScenePart]:
    """Plants and toys."""
    leaves = palm(rng, steps(13, d, 4), steps(16, d, 3), 0.7, 0.62, d)
    ficus = shrub(rng, steps(420, d * d, 14), 0.3, 0.8, 0.13 / max(1.0, d**0.5))
    aloe = agave(rng, steps(18, d**0.5, 5), 0.2, steps(5, d, 2))
    parts = [
        place_copies(merge(raise_mesh(leaves, 0.3), pot(0.36, 0.2, d)), (-2.22, 0, -2.4)),
        place_copies(merge(raise_mesh(ficus, 0.3), pot(0.36, 0.2, d, p.BLUE)), (-2.25, 0, 2.2)),
        place_copies(merge(raise_mesh(aloe, 0.11), pot(0.12, 0.07, d, p.CLAY)), (2.42, 0.835, -0.15)),
    ]
    if d > SKETCH:
        toys = [
            (bear(0.5, d), (0.86, 0.0, -0.42), 0.5),
            (beach_ball(0.16, d), (1.36, 0.0, -1.1), 0.3),
            (blocks(d), (0.1, 0.03, 0.45), 0.0),
            (rings(d), (-0.35, 0.03, 0.62), 0.0),
            (train(d), (0.75, 0.03, 0.6), 0.5),
        ]
        parts += [place_copies(mesh, at, turn) for mesh, at, turn in toys]
    return parts


def _pattern(u: np.ndarray, v: np.ndarray) -> np.ndarray:
    """Materials of the rug at u, v in [-1, 1]: a border around diamonds."""
    edge = np.maximum(np.abs(u) * 1.15, np.abs(v)) + 0.0 * u
    diamond = np.abs((2.2 * u) % 1.0 - 0.5) + np.abs((1.5 * v) % 1.0 - 0.5)
    inside = np.where(diamond < 0.2, p.OCHRE, np.where(diamond < 0.3, p.BLUE, p.RED))
    return np.where(edge > 0.93, p.LIMESTONE, np.where(edge > 0.82, p.BLUE, inside))


def _rug(rng: np.random.Generator, triangles: int) -> list[ScenePart]:
    """A rug of about `triangles` triangles, most of them in its pile, two per fibre."""
    x, z, w, length = RUG
    u, v = (np.linspace(-1.0, 1.0, min(most, steps(share * triangles**0.5, 1.0, 6)) + 1) for share, most in WEAVE)
    ground = np.stack(np.broadcast_arrays(x + w / 2 * u[:, None], 0.012, z + length / 2 * v), axis=-1)
    middles = (u[1:, None] + u[:-1, None]) / 2, (v[1:] + v[:-1]) / 2
    base = place_copies(block(ground, -0.01, _pattern(*middles)))
    n = max(1, (triangles - base.n_triangles) // 2)
    at = rng.uniform(-1.0, 1.0, (n, 2))
    root = np.stack([x + at[:, 0] * (w / 2 - 0.01), np.full(n, 0.008), z + at[:, 1] * (length / 2 - 0.01)], axis=1)
    lean = sphere_directions(rng, n, 0.0)
    size = np.clip(0.03 * np.sqrt(15_000 / n), 0.012, 0.04)
    colour = _pattern(*at.T) + p.shades(rng, n) % 4
    pile = blades(root, 0.6 * UP + lean, UP - lean, Blade(size * rng.uniform(0.7, 1.2, n), 0.3 * size, 0.3, 2), colour)
    return [base, place_copies(pile)]
