"""A bedroom at low sun. All light comes through the Venetian blinds of one wide window, and they block most of it."""

import numpy as np

from ...generate import palette as p
from ...generate.atrium import EMBED, tiles
from ...generate.props import UP, agave, blades, palm, pot, shrub, sphere_directions, unit
from ...generate.shapes import (
    PaletteMesh,
    ScenePart,
    assemble,
    block,
    box,
    count,
    fitted,
    frame_ring,
    merge,
    moved,
    place_copies,
    raised,
    steps,
)
from .bedding import armchair, bed
from .furniture import SKETCH, bookcase, chandelier, door, drawers, table_lamp
from .sculptures import painting
from .toys import beach_ball, bear, blocks, rings, train
from .window import LINTEL, SILL, WALL, curtains, frame, pierced, venetian

HALF_X, HALF_Z, HEIGHT = 2.7, 2.95, 2.85  # half widths and height of the room; the window is in the wall at -HALF_X
RUG = (0.3, 0.85, 2.3, 1.6)  # centre (x, z) and size of the rug
SUN = (21.0, 13.5, 26.0)  # degrees from the window's normal towards +z, degrees up, metres from the window
TILTS = (-18.0, -20.0, -16.0, -21.0)  # degrees, slats of each blind: their room sides are raised
WEAVE = ((0.45, 90), (0.32, 64))  # for x and z: (cells of the rug's ground per root of its triangles, most cells)
CAMERA = {"position": (2.3, 1.62, 2.5), "target": (-0.72, 0.76, -1.7), "up": (0.0, 1.0, 0.0), "vfov": 66.0}


def blinds(triangles: int, seed: int) -> tuple[PaletteMesh, dict, dict]:
    """Mesh, camera and light of the bedroom, with about `triangles` triangles."""

    def build(d):
        room = _shell(d, np.random.default_rng([seed, 0])) + _window(d, np.random.default_rng([seed, 1]))
        return room + _furniture(d, np.random.default_rng([seed, 2])) + _clutter(d, np.random.default_rng([seed, 3]))

    parts = fitted(build, round(0.9 * triangles), np.sqrt(triangles / 300_000), near=0.9)
    parts += _rug(np.random.default_rng([seed, 4]), max(100, triangles - count(parts)))
    return assemble(parts), CAMERA, _sun()


def _sun() -> dict:
    """A strip light far outside: four metres along the slats, and little higher than the sun looks."""
    azimuth, height = np.radians(SUN[:2])
    to = np.array([-np.cos(azimuth) * np.cos(height), np.sin(height), np.sin(azimuth) * np.cos(height)])
    u = np.array([0.0, 0.0, 4.0])
    v = 0.16 * unit(np.cross(u, to))
    middle = np.array([-HALF_X, (SILL + LINTEL) / 2, 0.0]) + SUN[2] * to
    return {"corner": tuple(middle - u / 2 - v / 2), "u": tuple(u), "v": tuple(v)}


def _shell(d: float, rng) -> list[ScenePart]:
    """Floor of boards, the three plain walls, ceiling, skirting, cornice, door."""
    x, z, h = HALF_X, HALF_Z, HEIGHT
    boards = tiles(-x - 0.05, x + 0.05, -z - 0.05, z + 0.05, 3, steps(40, d, 8), rng, p.OAK, None, 0.008, 0.003)
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


def _window(d: float, rng) -> list[ScenePart]:
    """The wall with the window, its blinds and its curtains. Each blind has a slightly different tilt."""
    wall = pierced((-HALF_Z - 0.17, -0.19), (HALF_Z + 0.17, HEIGHT + 0.09), WALL)
    tilts = np.radians(TILTS) + rng.normal(0.0, 0.01, len(TILTS))
    parts = [place_copies(wall), *frame(d), *venetian(tilts, d, rng), *curtains(LINTEL + 0.08, p.TEAL, d, rng)]
    return moved(parts, (-HALF_X, 0.0, 0.0), np.pi / 2)


def _furniture(d: float, rng) -> list[ScenePart]:
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
        *moved(bookcase(1.24, 2.0, 0.3, 6, d, rng), (1.96, 0, back + 0.17)),
        *moved(chandelier(0.62, d), (0.15, HEIGHT, 0.0)),
    ]


def _clutter(d: float, rng) -> list[ScenePart]:
    """Plants and toys."""
    leaves = palm(rng, steps(13, d, 4), steps(16, d, 3), 0.7, 0.62, d)
    ficus = shrub(rng, steps(420, d * d, 14), 0.3, 0.8, 0.13 / max(1.0, d**0.5))
    aloe = agave(rng, steps(18, d**0.5, 5), 0.2, steps(5, d, 2))
    parts = [
        place_copies(merge(raised(leaves, 0.3), pot(0.36, 0.2, d)), (-2.22, 0, -2.4)),
        place_copies(merge(raised(ficus, 0.3), pot(0.36, 0.2, d, p.BLUE)), (-2.25, 0, 2.2)),
        place_copies(merge(raised(aloe, 0.11), pot(0.12, 0.07, d, p.CLAY)), (2.42, 0.835, -0.15)),
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


def _pattern(u, v) -> np.ndarray:
    """Materials of the rug at u, v in [-1, 1]: a border around diamonds."""
    edge = np.maximum(np.abs(u) * 1.15, np.abs(v)) + 0.0 * u
    diamond = np.abs((2.2 * u) % 1.0 - 0.5) + np.abs((1.5 * v) % 1.0 - 0.5)
    inside = np.where(diamond < 0.2, p.OCHRE, np.where(diamond < 0.3, p.BLUE, p.RED))
    return np.where(edge > 0.93, p.LIMESTONE, np.where(edge > 0.82, p.BLUE, inside))


def _rug(rng, triangles: int) -> list[ScenePart]:
    """A rug of about `triangles` triangles. Most of them are its pile, two triangles for each fibre."""
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
    pile = blades(root, 0.6 * UP + lean, UP - lean, size * rng.uniform(0.7, 1.2, n), 0.3 * size, 0.3, 2, 2, colour)
    return [base, place_copies(pile)]
