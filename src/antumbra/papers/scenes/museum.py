"""Museum halls with sculptures, paintings and display cases. A few small objects have most of the triangles."""

import numpy as np

from ...generate import palette as p
from ...generate.atrium import EMBED, doorway, tiles
from ...generate.props import bench, vase
from ...generate.shapes import (
    PaletteMesh,
    ScenePart,
    assemble,
    box,
    boxes,
    count,
    fitted,
    frame_ring,
    merge,
    place_copies,
    raised,
    revolve,
    steps,
)
from .sculptures import ammonite, blob, knot, painting, rain, ribbon, twist, vortex

WIDTH, DEPTH, HEIGHT = 14.0, 17.0, 6.4  # size of a hall, from wall to wall
WALL = 0.6
SKY_X, SKY_Z = 3.2, 4.2  # half the size of the skylight
FULL_HALL = 110_000  # triangles of a hall; a larger budget makes more halls


def museum(triangles: int, seed: int) -> tuple[PaletteMesh, dict, dict]:
    """Mesh, camera and light of the museum, with about `triangles` triangles."""
    halls = max(1, round(triangles / FULL_HALL))
    nx = max(1, round(np.sqrt(halls / 2.0)))
    nz = max(1, round(halls / nx))
    i, j = (a.ravel() for a in np.indices((nx, nz)))
    at = np.stack([(i - nx // 2) * (WIDTH + WALL), 0.0 * i, -j * (DEPTH + WALL)], axis=1)
    guess = np.sqrt(triangles / len(at) / FULL_HALL)
    grid = i, j, nx, nz
    parts = fitted(lambda d: _halls(at, *grid, d, np.random.default_rng([seed, 0])), round(0.22 * triangles), guess)
    left = triangles - count(parts)
    parts += fitted(lambda d: _exhibits(at, d * d, np.random.default_rng([seed, 1])), left, np.sqrt(max(left, 1)))
    camera = {"position": (4.9, 1.7, 7.4), "target": (-1.1, 2.05, -4.0), "up": (0.0, 1.0, 0.0), "vfov": 60.0}
    light = {"corner": (-3.1, 4.9, 5.4), "u": (1.9, 0.0, 0.6), "v": (0.0, 1.5, -1.1)}
    return assemble(parts), camera, light


def _halls(at, i, j, nx, nz, d, rng) -> list[ScenePart]:
    """Floors, walls, doorways between halls, cornices, ceilings, and skylights with bars."""
    n, m = steps(14, d, 4), steps(17, d, 5)
    hx, hz = WIDTH / 2, DEPTH / 2
    floor = tiles(-hx - 0.05, hx + 0.05, -hz - 0.05, hz + 0.05, n, m, rng, p.MARBLE, p.SANDSTONE, 0.02, 0.004)
    threshold = box((2.6, 0.2, WALL + 0.1), (0, -0.11, 0), p.OAK)
    slabs = boxes(
        [(hx - SKY_X + 0.1, 0.5, DEPTH + 0.2)] * 2 + [(2 * SKY_X + 0.1, 0.49, hz - SKY_Z + 0.1)] * 2,
        [(s * (SKY_X + (hx - SKY_X + 0.1) / 2), HEIGHT + 0.25, 0) for s in (-1, 1)]
        + [(0, HEIGHT + 0.25, s * (SKY_Z + (hz - SKY_Z + 0.1) / 2)) for s in (-1, 1)],
        p.PLASTER,
    )
    bars = boxes(
        [(0.07, 0.12, 2 * SKY_Z + 0.1)] * 5 + [(2 * SKY_X + 0.1, 0.1, 0.07)] * 7,
        [(x, HEIGHT + 0.42, 0) for x in np.linspace(-SKY_X, SKY_X, 7)[1:-1]]
        + [(0, HEIGHT + 0.42, z) for z in np.linspace(-SKY_Z, SKY_Z, 9)[1:-1]],
        p.IRON,
    )
    cornice = [
        (0.03, -0.6),
        (-0.1, -0.6),
        (-0.14, -0.45),
        (-0.3, -0.2),
        (-0.42, -0.12),
        (-0.42, 0.02),
        (0.05, 0.02),
    ]
    parts = [
        place_copies(floor, at),
        place_copies(slabs, at),
        place_copies(bars, at),
        place_copies(frame_ring(cornice, hx, hz, p.PLASTER), at + [0, HEIGHT, 0]),
    ]
    for horizontal in (True, False):
        length, high = (WIDTH if horizontal else DEPTH) + 0.1, HEIGHT + 0.4
        open_ = doorway(length, 1.25, 2.6, high, WALL - 0.02, steps(14, d, 4), p.TEAL)
        closed = box((length, high, WALL - 0.02), (0, high / 2 - EMBED, 0), p.TEAL)
        shift = np.array([0, 0, (DEPTH + WALL) / 2]) if horizontal else np.array([(WIDTH + WALL) / 2, 0, 0])
        turn = 0.0 if horizontal else np.pi / 2
        inner = (j > 0) if horizontal else (i < nx - 1)  # there is a hall behind the wall on this side
        outer = (j == nz - 1) if horizontal else (i == 0)
        parts += [
            place_copies(open_, at[inner] + shift, turn),
            place_copies(closed, at[~inner] + shift, turn),
            place_copies(closed, at[outer] - shift, turn),
        ]
        parts.append(place_copies(threshold, at[inner] + shift, turn))
    return [part for part in parts + _fittings(at, d, rng) if len(part.offset)]


def _fittings(at, d, rng) -> list[ScenePart]:
    """Paintings on the walls, and benches."""
    n = steps(20, d, 2)
    wide, tall = painting(2.3, 1.6, n, rng), painting(1.4, 1.9, n, rng)
    parts = []
    for side, turn in ((-1, np.pi / 2), (1, -np.pi / 2)):
        x = side * (WIDTH / 2 - 0.07)
        for k, (mesh, z) in enumerate(((wide, -5.2), (tall, -2.6), (tall, 2.6), (wide, 5.2))):
            if d > 0.2 or k % 2 == 0:
                parts.append(place_copies(mesh, at + [x, 2.15, z], turn))
    for x in (-4.2, 4.2):
        parts.append(place_copies(tall, at + [x, 2.15, -DEPTH / 2 + 0.07], 0.0))
        parts.append(place_copies(wide, at + [x, 2.15, DEPTH / 2 - 0.07], np.pi))
    parts.append(place_copies(bench(1.8, p.OAK), np.concatenate([at + [0.0, 0.0, 6.4], at + [0.0, 0.0, -6.0]])))
    return parts


def _plinth(width: float, height: float, colour=p.PLASTER) -> PaletteMesh:
    return merge(
        box((width, height, width), (0, height / 2 - EMBED, 0), colour, 0.012),
        box((width + 0.12, 0.1, width + 0.12), (0, 0.04 - EMBED, 0), colour, 0.012),
    )


def _case(treasure: PaletteMesh) -> PaletteMesh:
    """A display case without its glass: base, slender frame, and an exhibit inside."""
    h, w = 0.85, 0.8
    posts = [(s * w / 2, h + 0.35, t * w / 2) for s in (-1, 1) for t in (-1, 1)]
    rails = [(s * w / 2 * (axis == 0), h + 0.72, s * w / 2 * (axis == 1)) for axis in (0, 1) for s in (-1, 1)]
    sizes = [(0.035, 0.78, 0.035)] * 4 + [(0.03, 0.03, w)] * 2 + [(w, 0.03, 0.03)] * 2
    frame = boxes(sizes, posts + rails, p.BRONZE)
    inside = raised(treasure, h)
    return merge(_plinth(w + 0.1, h, p.DARK_WOOD), frame, inside)


def _exhibits(at, budget: float, rng) -> list[ScenePart]:
    """The works of art. Every hall has about the same works, at other angles. A few have most of the triangles."""
    each = budget / len(at)
    shares = np.array([0.2, 0.26, 0.16, 0.12, 0.1, 0.07, 0.05, 0.04]) * each
    works = [
        (merge(_plinth(1.1, 0.5), raised(knot(shares[1], size=0.62), 0.46)), (-4.0, -3.4)),
        (merge(_plinth(0.8, 0.95), raised(blob(shares[2], rng, 0.5), 0.94)), (3.9, 2.4)),
        (merge(_plinth(0.9, 0.35, p.SLATE), raised(twist(shares[3]), 0.33)), (4.3, -3.6)),
        (merge(_plinth(0.9, 0.8), raised(ammonite(shares[4], 0.62), 0.79)), (-3.9, 2.0)),
        (merge(_plinth(1.0, 0.6, p.SLATE), raised(ribbon(shares[5], 0.62), 0.58)), (-1.9, -7.0 + 0.4)),
        (_case(blob(0.5 * shares[6], rng, 0.2, p.TEAL)), (-5.2, 5.4)),
        (_case(vase(0.55, float(np.sqrt(shares[7] / 900.0)), p.BLUE)), (5.5, -0.6)),
    ]
    parts = [place_copies(mesh, at + [x, 0.0, z], rng.uniform(0, 6.3, len(at))) for mesh, (x, z) in works]
    first = np.arange(len(at)) % 2 == 0
    pieces = [(rain(shares[0], ceiling=HEIGHT), first), (vortex(shares[0]), ~first)]
    stand = place_copies(
        revolve([(1.5, -EMBED), (1.5, 0.22), (1.4, 0.26), (0.0, 0.26)], steps(12, (each / 1000) ** 0.5, 8), p.SLATE), at
    )
    for group, chosen in pieces:
        for part in group:
            parts += [part._replace(offset=part.offset + place.astype(np.float32)) for place in at[chosen]]
    return [*parts, stand]
