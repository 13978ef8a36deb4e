"""A courtyard of two storeys of arcades under an open roof: the scene that is shown when none is named."""

import numpy as np

from . import palette as p
from .architecture import EMBED, arch, ashlar, baluster, column, tiles, vault, voussoirs
from .parts import Part, assemble, count, fitted, put
from .plants import agave, bush, ivy, palm, shrub
from .props import SINK, bench, cloth, crate, pot, vase
from .shapes import Mesh, arc, block, box, boxes, frame_ring, loft, merge, prism, revolve, steps

BAY = 4.0  # metres from column to column
HALF_X, HALF_Z = 6.0, 12.0  # of the rectangle on which the columns stand: 3 x 6 bays
GALLERY = 4.0  # depth of the galleries around it
STEP = 0.16  # height of the galleries' floor over the courtyard's
SPRING, LEVEL = 3.6, 5.9  # where the lower arches spring; the upper floor
UPPER_SPRING, EAVES = 8.3, 9.75
PIER, WALL = 0.84, 0.62  # width of the piers over the columns, thickness of the arcade walls
RADIUS, UPPER_RADIUS = (BAY - PIER) / 2, (BAY / 2 - 0.5) / 2

CAMERA = {"position": (2.6, 1.7, 11.2), "target": (-0.7, 3.0, -2.0), "up": (0.0, 1.0, 0.0), "vfov": 56.0}
LIGHT = {"corner": (-3.2, 7.6, 7.6), "u": (2.2, 0.0, 0.0), "v": (0.0, 1.5, -1.7)}


def atrium(triangles: int, seed: int) -> tuple[Mesh, dict, dict]:
    """Mesh, camera and light of the atrium with about `triangles` triangles."""

    def build(detail):
        return _architecture(detail, np.random.default_rng([seed, 0])) + _furniture(detail, np.random.default_rng([seed, 1]))

    greenery = 0.06 + 0.1 * min(1.0, triangles / 1e6)
    parts = fitted(build, round((1.0 - greenery) * triangles), np.sqrt(triangles / 370_000))
    parts.append(_hanging_plants(np.random.default_rng([seed, 2]), (triangles - count(parts)) // 4))
    return assemble(parts), CAMERA, LIGHT


def _around(spacing: float, half_x=HALF_X, half_z=HALF_Z, corners=True):
    """Places (k, 2) every `spacing` metres around the rectangle, and the turn that makes +z look to the court."""
    nx, nz = round(2 * half_x / spacing), round(2 * half_z / spacing)
    start = 0.0 if corners else 0.5
    x = -half_x + spacing * (np.arange(nx) + start)
    z = -half_z + spacing * (np.arange(nz) + start)
    sides = [
        np.stack([x, 0 * x - half_z], axis=1),
        np.stack([0 * z + half_x, z], axis=1),
        np.stack([-x, 0 * x + half_z], axis=1),
        np.stack([0 * z - half_x, -z], axis=1),
    ]
    turns = np.repeat([0.0, -np.pi / 2, np.pi, np.pi / 2], [nx, nz, nx, nz])
    return np.concatenate(sides), turns


def _at(places, y) -> np.ndarray:
    return np.insert(np.asarray(places, np.float64), 1, y, axis=1)


def _architecture(d: float, rng) -> list[Part]:
    corners, turns = _around(BAY)
    middles, facing = _around(BAY, corners=False)
    upper, upper_turns = _around(BAY / 2)
    upper_middles, upper_facing = _around(BAY / 2, corners=False)
    n = steps(20, d, 4)
    stones = 11 if d > 0.4 else 5
    high = LEVEL + 0.9
    parts = _floors(d, rng) + _mouldings(d)
    parts += [
        put(column(SPRING - STEP, 0.31, 12, steps(3.4, d), 8 if d > 0.45 else 0), _at(corners, STEP + 0.04)),
        put(
            box((PIER, LEVEL - 0.3 - SPRING, PIER), (0, (LEVEL - 0.3 - SPRING) / 2, 0), p.SANDSTONE),
            _at(corners, SPRING),
        ),
        put(arch(RADIUS, LEVEL - 0.35 - SPRING, WALL, n), _at(middles, SPRING), facing),
        put(voussoirs(RADIUS, 0.3, WALL + 0.1, stones, steps(1.6, d)), _at(middles, SPRING), facing),
        put(
            column(UPPER_SPRING - high, 0.17, steps(9, d, 5), steps(1.2, d), 6 if d > 1.5 else 0, p.MARBLE),
            _at(upper, high),
        ),
        put(box((0.56, high - LEVEL, 0.56), (0, (high - LEVEL) / 2, 0), p.LIMESTONE), _at(upper, LEVEL)),
        put(box((0.5, 1.2, 0.5), (0, 0.6, 0), p.SANDSTONE), _at(upper, UPPER_SPRING)),
        put(arch(UPPER_RADIUS, 1.2, 0.42, steps(14, d, 3)), _at(upper_middles, UPPER_SPRING), upper_facing),
        put(
            voussoirs(UPPER_RADIUS, 0.14, 0.48, 7 if d > 0.4 else 3, steps(1.5, d)),
            _at(upper_middles, UPPER_SPRING),
            upper_facing,
        ),
    ]
    if d > 0.35:
        per = steps(4, d**0.5, 2)
        along = (np.arange(per) + 1.0) / (per + 1) - 0.5
        side = np.stack([np.cos(upper_facing), -np.sin(upper_facing)], axis=1)
        spots = (upper_middles[:, None] + along[:, None] * 1.55 * side[:, None]).reshape(-1, 2)
        parts.append(put(baluster(0.62, d), _at(spots, LEVEL + 0.12)))
    return parts + _galleries(d, rng)


def _floors(d: float, rng) -> list[Part]:
    """Courtyard and galleries: tiles; a kerb under the columns; the slab and the beams over the galleries."""
    edge_x, edge_z = HALF_X - 0.55, HALF_Z - 0.55
    wide = min(0.9, max(0.2, 0.9 / d**0.5)) if d > 0.3 else 2.5
    nx, nz = round(2 * edge_x / wide), round(2 * edge_z / wide)
    court = tiles(-edge_x, edge_x, -edge_z, edge_z, nx, nz, rng, p.SANDSTONE, p.CLAY)
    inner_x, inner_z = HALF_X + 0.45, HALF_Z + 0.45
    outer_x, outer_z = HALF_X + GALLERY, HALF_Z + GALLERY
    wide *= 1.4
    parts = [put(court)]
    for sign in (-1, 1):
        x, z = sorted((sign * inner_x, sign * outer_x)), sorted((sign * inner_z, sign * outer_z))
        k = max(1, round(GALLERY / wide))
        parts.append(put(tiles(*x, -outer_z, outer_z, k, round(2 * outer_z / wide), rng, p.TERRACOTTA), (0, STEP, 0)))
        parts.append(put(tiles(-inner_x, inner_x, *z, round(2 * inner_x / wide), k, rng, p.TERRACOTTA), (0, STEP, 0)))
    kerb = [(-0.56, -0.1), (0.5, -0.1), (0.5, STEP + 0.03), (-0.5, STEP + 0.05), (-0.56, STEP)]
    return [*parts, put(frame_ring(kerb, HALF_X, HALF_Z, p.MARBLE))]


def _mouldings(d: float) -> list[Part]:
    """Cornices, floor slab, rails and roof: profiles around the whole court."""
    n = steps(4, d)
    cornice = np.concatenate(
        [
            [(0.6, -0.4), (-0.36, -0.4), (-0.36, -0.3)],
            arc((-0.56, -0.3), (0.2, 0.14), 0, 90, n)[1:],
            [(-0.62, -0.14), (-0.62, 0.0), (0.6, 0.0)],
        ]
    )
    slab = [(0.4, -0.3), (GALLERY + 0.2, -0.3), (GALLERY + 0.2, -0.02), (0.4, -0.02)]
    rail = [(-0.14, 0.0), (0.14, 0.0), (0.17, 0.06), (0.14, 0.13), (-0.14, 0.13), (-0.17, 0.06)]
    roof = [(-0.62, 0.0), (GALLERY + 0.9, 1.9), (GALLERY + 0.9, 1.75), (-0.55, -0.1)]
    ceiling = [(0.2, -0.12), (GALLERY + 0.1, -0.12), (GALLERY + 0.1, -0.02), (0.2, -0.02)]
    low_rail = [(-0.12, 0.0), (0.12, 0.0), (0.12, 0.14), (-0.12, 0.14)]
    rows = [
        (cornice, LEVEL, p.LIMESTONE),
        (slab, LEVEL, p.OAK),
        (low_rail, LEVEL - EMBED, p.LIMESTONE),
        (rail, LEVEL + 0.72, p.LIMESTONE),
        (cornice * [0.8, 0.7], EAVES, p.LIMESTONE),
        (ceiling, EAVES, p.OAK),
        (roof, EAVES + 0.12, p.TERRACOTTA),
    ]
    beams = np.linspace(-HALF_Z + 1.0, HALF_Z - 1.0, 12)
    purlins = np.array([(x, EAVES + 0.42, 0) for x in (-4.0, -2.0, 0.0, 2.0, 4.0)])
    timber = [
        put(box((2 * HALF_X + 0.6, 0.3, 0.2), (0, EAVES + 0.2, 0), p.DARK_WOOD), _at(np.outer(beams, [0, 1]), 0.0)),
        put(box((0.14, 0.16, 2 * HALF_Z), (0, 0, 0), p.OAK), purlins),
    ]
    parts = timber + [put(frame_ring(profile, HALF_X, HALF_Z, colour), (0, y, 0)) for profile, y, colour in rows]
    if d > 0.3:
        places, _ = _around(0.5 if d > 0.75 else 1.0, HALF_X - 0.42, HALF_Z - 0.42)
        parts.append(put(box((0.16, 0.16, 0.2), (0, 0, 0), p.LIMESTONE), _at(places, LEVEL - 0.24)))
        places, _ = _around(0.5 if d > 0.75 else 1.0, HALF_X - 0.36, HALF_Z - 0.36)
        parts.append(put(box((0.13, 0.12, 0.13), (0, 0, 0), p.LIMESTONE), _at(places, EAVES - 0.16)))
    return parts


def _galleries(d: float, rng) -> list[Part]:
    """Vaults and transverse arches below, timber ceiling above, and the walls behind."""
    bays, facing = _around(BAY, HALF_X + GALLERY / 2, HALF_Z + GALLERY / 2)
    half = BAY / 2 - 0.22
    ribs, turns = _around(BAY)
    first = [0, 3, 9, 12]  # the corners: two ribs start there
    ribs, turns = np.concatenate([ribs, ribs[first]]), np.concatenate([turns, turns[np.roll(first, 1)]])
    out = -np.stack([np.sin(turns), np.cos(turns)], axis=1)
    cross = _at(ribs + out * GALLERY / 2, SPRING)
    n = steps(5, d, 2)
    pilaster = box((0.5, EAVES, 0.36), (0, EAVES / 2 - EMBED, 0), p.LIMESTONE)
    outside, looking = _around(BAY, HALF_X + GALLERY, HALF_Z + GALLERY)
    course = min(0.8, max(0.12, 0.65 / d**0.5)) if d > 0.35 else 2.0
    long, wide = 2 * (HALF_Z + GALLERY), 2 * (HALF_X + GALLERY)
    wall = put(ashlar(long, EAVES, 0.4, course, rng), [(0, 0, 0)]).mesh
    end = ashlar(wide + 0.7, EAVES, 0.4, course, rng)
    sides = [(-wide / 2, 0, 0), (wide / 2, 0, 0)]
    parts = [
        put(vault(half, RADIUS + 0.16, LEVEL - 0.25 - SPRING, n), _at(bays, SPRING), facing),
        put(arch(RADIUS, LEVEL - 0.28 - SPRING, 0.5, steps(10, d, 3), p.LIMESTONE), cross, turns + np.pi / 2),
        put(pilaster, _at(outside, 0.0), looking, shade=p.shades(rng, len(outside)) % 3),
        put(wall, sides, [np.pi / 2, -np.pi / 2]),
        put(end, [(0, 0, -long / 2), (0, 0, long / 2)], [0.0, np.pi]),
    ]
    if d > 0.4:
        beams, turn = _around(1.0 if d > 0.8 else 2.0, HALF_X + GALLERY / 2, HALF_Z + GALLERY / 2, corners=False)
        parts.append(put(box((0.16, 0.22, GALLERY), (0, 0, 0), p.DARK_WOOD), _at(beams, EAVES - 0.2), turn))
    return parts


def _furniture(d: float, rng) -> list[Part]:
    """The fountain, pots with plants, amphorae, benches, crates, curtains and banners."""
    many = max(1, round(d**0.5))
    parts = _fountain(d)
    pots = np.array([(-2.9, 5.6), (4.3, 4.2), (-4.2, -1.4), (4.3, -6.6), (-4.1, -8.8), (3.9, 9.0)])
    kinds = (
        merge(_lifted(palm(rng, steps(15, d, 6), steps(18, d, 4), 2.3, 1.75, d), 0.55), pot(0.65, 0.42, d)),
        merge(_lifted(agave(rng, steps(26, d**0.5, 9), 0.95, steps(6, d, 2)), 0.5), pot(0.6, 0.45, d, p.CLAY)),
    )
    for k, kind in enumerate(kinds):
        at = pots[k::2]
        parts.append(put(kind, _at(at, 0.0), rng.uniform(0, 6.3, len(at)), rng.uniform(0.9, 1.12, len(at))))
    return parts + _clutter(d, many, rng) + _cloths(d, rng)


def _lifted(mesh, y: float):
    return mesh._replace(vertices=mesh.vertices + np.float32([0, y, 0]))


def _fountain(d: float) -> list[Part]:
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


def _clutter(d: float, many: int, rng) -> list[Part]:
    """Amphorae in groups, benches between the columns, crates in a corner, clipped bushes."""
    spots, turns = _around(BAY, HALF_X + 0.1, HALF_Z + 0.1, corners=False)
    seats = bench(1.7)
    corner = np.array([(-2.1, 7.3), (-4.7, 3.0), (4.7, -1.6), (-4.6, -10.4), (4.6, 6.9)])
    near = np.repeat(corner, 2 * many, axis=0) + rng.normal(0.0, 0.33, (10 * many, 2))
    size = rng.uniform(0.55, 1.15, len(near))
    parts = [put(seats, _at(spots[::3], STEP + 0.05), turns[::3])]
    for k, shape in enumerate((vase(1.0, d), vase(1.0, d, p.CLAY, 0.36, 0.14), vase(1.0, d, p.BLUE, 0.25, 0.1))):
        at = near[k::3]
        parts.append(
            put(shape, _at(at, 0.0), rng.uniform(0, 6.3, len(at)), size[k::3], shade=p.shades(rng, len(at)) % 4)
        )
    stack = np.array(
        [(3.95, 0.0, 11.0), (4.9, 0.0, 10.9), (4.4, 0.68, 10.95), (4.7, 0.0, 2.1), (-4.7, 0.0, -5.2), (-4.7, 0.0, -4.3)]
    )
    turn = np.array([0.1, -0.2, 0.35, 0.5, 0.15, 0.9])
    parts.append(put(crate((0.8, 0.68, 0.75), steps(4, d**0.5, 2)), stack, turn, [1, 1, 0.8, 1, 1, 0.8]))
    balls = np.array([(x, z) for x in (-1.9, 1.9) for z in (FOUNTAIN[1] - 2.1, FOUNTAIN[1] + 2.1)])
    parts.append(put(merge(_lifted(bush(rng, 0.36, d), 0.38), pot(0.45, 0.3, d, p.MARBLE)), _at(balls, 0.0)))
    green = merge(
        _lifted(shrub(rng, steps(260, d * d, 12), 0.42, 0.8, 0.15 / max(1.0, d**0.5)), 0.42), pot(0.5, 0.34, d)
    )
    tubs, _ = _around(BAY, HALF_X + 0.1, HALF_Z + 0.1, corners=False)
    parts.append(put(green, _at(tubs[1::3], STEP + 0.04), rng.uniform(0, 6.3, len(tubs[1::3]))))
    return parts


def _cloths(d: float, rng) -> list[Part]:
    """Banners over the balustrade and curtains gathered in some of the lower arches."""
    nx, ny = steps(16, d, 4), steps(12, d, 3)
    middles, facing = _around(BAY, corners=False)
    out = np.stack([np.sin(facing), np.cos(facing)], axis=1)
    parts = []
    for colour, banners, curtains in ((p.RED, (1, 6, 13, 17), (5, 10, 16)), (p.BLUE, (4, 8, 11, 15), (2, 7, 14))):
        banner = cloth(1.25, 2.2, nx, ny, rng, 2.5, 0.05, colour=colour, trim=p.OCHRE)
        k = list(banners)
        parts.append(put(banner, _at(middles[k] + 0.72 * out[k], LEVEL + 0.86), facing[k]))
        cut = 2 * RADIUS - 0.1, SPRING - STEP - 0.1
        shade = p.RED if colour == p.RED else p.OCHRE
        curtain = cloth(*cut, 2 * nx, ny, rng, 6.0, 0.07, 0.95, shade, p.OCHRE)
        k = list(curtains)
        parts.append(put(curtain, _at(middles[k], SPRING), facing[k]))
    return parts


def _hanging_plants(rng, leaves: int) -> Part:
    """Ivy that falls from the balustrade in tufts, made of exactly `leaves` leaves."""
    edge, facing = _around(BAY / 2, corners=False)
    edge = edge[rng.permutation(len(edge))[: max(1, len(edge) * 2 // 5)]]
    per = 9
    strand = np.repeat(edge, per, axis=0) + rng.uniform(-0.6, 0.6, (len(edge) * per, 2))
    limit = np.array([HALF_X, HALF_Z]) - 0.68
    strand = np.where(np.abs(strand) > limit - 0.9, np.sign(strand) * limit, strand)
    start = _at(strand, LEVEL + 0.06)
    size = np.clip(0.16 * np.sqrt(4000 / max(leaves, 1)), 0.05, 0.22)
    return put(ivy(rng, start, rng.uniform(0.4, 2.2, len(start)), max(1, leaves), size))
