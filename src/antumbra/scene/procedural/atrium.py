"""A courtyard with arcades on two storeys under an open roof. It is the default scene."""

import numpy as np

from . import palette as p
from .courtyard import BAY, COARSE, HALF_X, HALF_Z, LEVEL, RADIUS, SKETCH, SPRING, STEP, architecture, around, at_height
from .parts import ScenePart, assemble, count, fitted, put
from .plants import agave, bush, ivy, shrub
from .props import SINK, bench, cloth, crate, pot, vase
from .shapes import PaletteMesh, arc, loft, merge, raised, revolve, steps
from .trees import palm

CAMERA = {"position": (2.6, 1.7, 11.2), "target": (-0.7, 3.0, -2.0), "up": (0.0, 1.0, 0.0), "vfov": 56.0}
LIGHT = {"corner": (-3.2, 7.6, 7.6), "u": (2.2, 0.0, 0.0), "v": (0.0, 1.5, -1.7)}


def atrium(triangles: int, seed: int) -> tuple[PaletteMesh, dict, dict]:
    """Mesh, camera and light of the atrium with about `triangles` triangles."""

    def build(detail):
        return architecture(detail, np.random.default_rng([seed, 0])) + _furniture(
            detail, np.random.default_rng([seed, 1])
        )

    greenery = 0.06 + 0.1 * min(1.0, triangles / 1e6)
    parts = fitted(build, round((1.0 - greenery) * triangles), np.sqrt(triangles / 370_000), near=0.87)
    parts.append(_hanging_plants(np.random.default_rng([seed, 2]), (triangles - count(parts)) // 4))
    return assemble(parts), CAMERA, LIGHT


def _furniture(d: float, rng) -> list[ScenePart]:
    """The fountain, pots with plants, amphorae, benches, crates, curtains and banners."""
    pots = np.array([(-2.9, 5.6), (4.3, 4.2), (-4.2, -1.4), (4.3, -6.6), (-4.1, -8.8), (3.9, 9.0)])
    leaves = palm(rng, steps(15, d, 4), steps(18, d, 3), 2.3, 1.75, d)
    kinds = [merge(raised(leaves, 0.55), pot(0.65, 0.42, d))]
    if d > SKETCH:
        leaves = agave(rng, steps(26, d**0.5, 6), 0.95, steps(6, d, 2))
        kinds.append(merge(raised(leaves, 0.5), pot(0.6, 0.45, d, p.CLAY)))
    parts = _fountain(d)
    for k, kind in enumerate(kinds):
        at = pots[k::2]
        parts.append(put(kind, at_height(at, 0.0), rng.uniform(0, 6.3, len(at)), rng.uniform(0.9, 1.12, len(at))))
    if d > SKETCH:
        parts += _clutter(d, rng)
    return parts + _cloths(d, rng)


def _fountain(d: float) -> list[ScenePart]:
    """An octagonal basin, a bowl on a stem, and water in both."""
    n = steps(5, d, 2)
    r, inner, h = 1.75, 1.45, 0.55
    wall = [
        (inner, -SINK),
        (r, -SINK),
        (r, 0.1),
        (r - 0.1, 0.14),
        (r - 0.1, h - 0.12),
        (r, h - 0.08),
        (r, h),
        (inner, h),
    ]
    angle = np.arange(8) * np.pi / 4 + np.pi / 8
    radius, y = np.array(wall).T
    sections = np.stack(
        [radius * np.cos(angle)[:, None], np.broadcast_to(y, (8, 8)), radius * np.sin(angle)[:, None]], axis=-1
    )
    basin = loft(sections, p.MARBLE, closed=True)
    bowl = np.concatenate(
        [
            [(0.0, 0.0), (0.34, 0.0), (0.34, 0.16), (0.2, 0.22)],
            arc((0.12, 0.7), (0.1, 0.45), -70, 70, n),
            arc((0.12, 1.62), 0.5, -80, -5, 2 * n) * [1.6, 1.0],
            [(0.98, 1.64), (0.86, 1.6), (0.0, 1.52)],
        ]
    )
    jet = [(0.0, 1.5), (0.12, 1.5), (0.09, 1.7), (0.16, 1.85), (0.05, 1.98), (0.11, 2.1), (0.06, 2.22), (0.0, 2.26)]
    water = revolve([(0.0, 0.02), (inner + 0.08, 0.02), (inner + 0.08, 0.36), (0.0, 0.36)], 8, p.WATER)
    turned_water = put(water, (0, 0, FOUNTAIN[1]), np.pi / 8)
    segments = steps(24, d, 8)
    at = [(FOUNTAIN[0], 0.0, FOUNTAIN[1])]
    return [
        put(basin, at),
        put(revolve(bowl, segments, p.MARBLE), at),
        put(revolve(jet, steps(14, d, 6), p.BRONZE), at),
        turned_water,
    ]


FOUNTAIN = (0.0, 0.6)


def _clutter(d: float, rng) -> list[ScenePart]:
    """Amphorae in groups, benches between the columns, crates in a corner, clipped bushes."""
    many = max(1, round(d**0.5))
    spots, turns = around(BAY, HALF_X + 0.1, HALF_Z + 0.1, corners=False)
    seats = bench(1.7, bevel=0.015 if d > COARSE else 0.0)
    corner = np.array([(-2.1, 7.3), (-4.7, 3.0), (4.7, -1.6), (-4.6, -10.4), (4.6, 6.9)])
    near = np.repeat(corner, 2 * many, axis=0) + rng.normal(0.0, 0.33, (10 * many, 2))
    size = rng.uniform(0.55, 1.15, len(near))
    parts = [put(seats, at_height(spots[::3], STEP + 0.05), turns[::3])]
    for k, shape in enumerate((vase(1.0, d), vase(1.0, d, p.CLAY, 0.36, 0.14), vase(1.0, d, p.BLUE, 0.25, 0.1))):
        at = near[k::3]
        parts.append(
            put(shape, at_height(at, 0.0), rng.uniform(0, 6.3, len(at)), size[k::3], shade=p.shades(rng, len(at)) % 4)
        )
    stack = np.array(
        [(3.95, 0.0, 11.0), (4.9, 0.0, 10.9), (4.4, 0.68, 10.95), (4.7, 0.0, 2.1), (-4.7, 0.0, -5.2), (-4.7, 0.0, -4.3)]
    )
    turn = np.array([0.1, -0.2, 0.35, 0.5, 0.15, 0.9])
    parts.append(put(crate((0.8, 0.68, 0.75), round(4 * d**0.5)), stack, turn, [1, 1, 0.8, 1, 1, 0.8]))
    balls = np.array([(x, z) for x in (-1.9, 1.9) for z in (FOUNTAIN[1] - 2.1, FOUNTAIN[1] + 2.1)])
    parts.append(put(merge(raised(bush(rng, 0.36, d), 0.38), pot(0.45, 0.3, d, p.MARBLE)), at_height(balls, 0.0)))
    green = merge(
        raised(shrub(rng, steps(260, d * d, 12), 0.42, 0.8, 0.15 / max(1.0, d**0.5)), 0.42), pot(0.5, 0.34, d)
    )
    tubs, _ = around(BAY, HALF_X + 0.1, HALF_Z + 0.1, corners=False)
    if d > COARSE:
        parts.append(put(green, at_height(tubs[1::3], STEP + 0.04), rng.uniform(0, 6.3, len(tubs[1::3]))))
    return parts


def _cloths(d: float, rng) -> list[ScenePart]:
    """Banners over the balustrade and curtains gathered in some of the lower arches."""
    nx, ny = steps(16, d, 3), steps(12, d, 2)
    middles, facing = around(BAY, corners=False)
    out = np.stack([np.sin(facing), np.cos(facing)], axis=1)
    parts = []
    for colour, banners, curtains in ((p.RED, (1, 6, 13, 17), (5, 10, 16)), (p.BLUE, (4, 8, 11, 15), (2, 7, 14))):
        banner = cloth(1.25, 2.2, nx, ny, rng, 2.5, 0.05, colour=colour, trim=p.OCHRE)
        k = list(banners)
        parts.append(put(banner, at_height(middles[k] + 0.72 * out[k], LEVEL + 0.86), facing[k]))
        cut = 2 * RADIUS - 0.1, SPRING - STEP - 0.1
        shade = p.RED if colour == p.RED else p.OCHRE
        curtain = cloth(*cut, 2 * nx, ny, rng, 6.0, 0.07, 0.95, shade, p.OCHRE)
        k = list(curtains)
        parts.append(put(curtain, at_height(middles[k], SPRING), facing[k]))
    return parts


def _hanging_plants(rng, leaves: int) -> ScenePart:
    """Ivy that hangs from the balustrade in tufts, of exactly `leaves` leaves."""
    edge, _ = around(BAY / 2, corners=False)
    edge = edge[rng.permutation(len(edge))[: max(1, len(edge) * 2 // 5)]]
    per = 9
    strand = np.repeat(edge, per, axis=0) + rng.uniform(-0.6, 0.6, (len(edge) * per, 2))
    limit = np.array([HALF_X, HALF_Z]) - 0.68
    strand = np.where(np.abs(strand) > limit - 0.9, np.sign(strand) * limit, strand)
    start = at_height(strand, LEVEL + 0.06)
    size = np.clip(0.16 * np.sqrt(4000 / max(leaves, 1)), 0.05, 0.22)
    return put(ivy(rng, start, rng.uniform(0.4, 2.2, len(start)), max(1, leaves), size))
