"""The building of the atrium: a court with arcades on two storeys, galleries behind them, and an open roof."""

import numpy as np

from . import palette as p
from .architecture import EMBED, arch, ashlar, baluster, column, tiles, vault, voussoirs
from .parts import ScenePart, put
from .shapes import arc, box, frame_ring, steps

BAY = 4.0  # metres between columns
HALF_X, HALF_Z = 6.0, 12.0  # half sides of the rectangle of columns: 3 x 6 bays
GALLERY = 4.0  # depth of the galleries around it
STEP = 0.16  # height of the galleries' floor over the courtyard's
SPRING, LEVEL = 3.6, 5.9  # height at which the lower arches spring; height of the upper floor
UPPER_SPRING, EAVES = 8.3, 9.75
PIER, WALL = 0.84, 0.62  # width of the piers over the columns, thickness of the arcade walls
RADIUS, UPPER_RADIUS = (BAY - PIER) / 2, (BAY / 2 - 0.5) / 2
COARSE = 0.24  # up to this detail, there are no voussoirs, small arches or ribs
SKETCH = 0.12  # up to this detail, there are only the plainest forms


def around(spacing: float, half_x=HALF_X, half_z=HALF_Z, corners=True):
    """(places, (k, 2), every `spacing` metres around the rectangle; turns that make +z look to the court)."""
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


def at_height(places, y) -> np.ndarray:
    """Places (k, 2) as points (k, 3) at height y."""
    return np.insert(np.asarray(places, np.float64), 1, y, axis=1)


def architecture(d: float, rng) -> list[ScenePart]:
    """The whole building. Below a detail of `COARSE`, its ornaments are left out."""
    corners, _ = around(BAY)
    middles, facing = around(BAY, corners=False)
    box_height = LEVEL - 0.27 - SPRING
    pier = box((PIER, box_height, PIER), (0, box_height / 2, 0), p.SANDSTONE)
    shaft = column(SPRING - STEP, 0.31, 12 if d > COARSE else 5, round(3.4 * d), 8 if d > 0.45 else 0)
    parts = [
        put(shaft, at_height(corners, STEP + 0.04)),
        put(pier, at_height(corners, SPRING - EMBED)),
        put(arch(RADIUS, LEVEL - 0.35 - SPRING, WALL, steps(20, d, 2)), at_height(middles, SPRING), facing),
    ]
    if d > COARSE:
        stones = voussoirs(RADIUS, 0.3, WALL + 0.1, 11, steps(1.6, d))
        parts.append(put(stones, at_height(middles, SPRING), facing))
    return [*parts, *_upper_storey(d), *_floors(d, rng), *_mouldings(d), *_galleries(d, rng)]


def _upper_storey(d: float) -> list[ScenePart]:
    """Slender columns on pedestals, small arches, and the balustrade between them."""
    high = LEVEL + 0.9
    places, _ = around(BAY / 2 if d > COARSE else BAY)
    middles, facing = around(BAY / 2, corners=False)
    shaft = column(UPPER_SPRING - high, 0.17, steps(9, d, 4), round(1.2 * d + 0.25), 6 if d > 1.5 else 0, p.MARBLE)
    if d <= SKETCH:
        shaft = box((0.3, UPPER_SPRING - high + 0.06, 0.3), (0, (UPPER_SPRING - high) / 2, 0), p.MARBLE)
    parts = [
        put(shaft, at_height(places, high)),
        put(
            box((0.56, high - LEVEL + EMBED, 0.56), (0, (high - LEVEL + EMBED) / 2, 0), p.LIMESTONE),
            at_height(places, LEVEL - EMBED),
        ),
    ]
    if d <= COARSE:
        lintel = [(-0.21, 0.0), (0.21, 0.0), (0.21, 1.2), (-0.21, 1.2)]
        return [*parts, put(frame_ring(lintel, HALF_X, HALF_Z, p.SANDSTONE), (0, UPPER_SPRING - EMBED, 0))]
    parts += [
        put(box((0.5, 1.2, 0.5), (0, 0.6, 0), p.SANDSTONE), at_height(places, UPPER_SPRING - EMBED)),
        put(arch(UPPER_RADIUS, 1.2, 0.42, steps(14, d, 3)), at_height(middles, UPPER_SPRING), facing),
    ]
    if d > 0.4:
        stones = voussoirs(UPPER_RADIUS, 0.14, 0.48, 7, steps(1.5, d))
        parts.append(put(stones, at_height(middles, UPPER_SPRING), facing))
    if d > 0.33:
        per = steps(4, d**0.5, 2)
        along = (np.arange(per) + 1.0) / (per + 1) - 0.5
        side = np.stack([np.cos(facing), -np.sin(facing)], axis=1)
        spots = (middles[:, None] + along[:, None] * 1.55 * side[:, None]).reshape(-1, 2)
        parts.append(put(baluster(0.62, d), at_height(spots, LEVEL + 0.12)))
    return parts


def _floors(d: float, rng) -> list[ScenePart]:
    """The tiles of courtyard and galleries, and a kerb under the columns."""
    edge_x, edge_z = HALF_X - 0.55, HALF_Z - 0.55
    wide = min(0.9, max(0.2, 0.9 / d**0.5)) if d > COARSE else 3.0
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


def _mouldings(d: float) -> list[ScenePart]:
    """Cornices, floor slab, rails and roof: profiles around the whole court."""
    n = steps(4, d)
    cornice = np.concatenate(
        [
            [(0.6, -0.4), (-0.37, -0.4), (-0.37, -0.3)],
            arc((-0.56, -0.3), (0.2, 0.14), 0, 90, n)[1:],
            [(-0.62, -0.14), (-0.62, 0.0), (0.6, 0.0)],
        ]
    )
    slab = [(0.4, -0.3), (GALLERY + 0.2, -0.3), (GALLERY + 0.2, -0.02), (0.4, -0.02)]
    rail = [(-0.14, 0.0), (0.14, 0.0), (0.17, 0.06), (0.14, 0.13), (-0.14, 0.13), (-0.17, 0.06)]
    roof = [(-0.62, 0.0), (GALLERY + 0.9, 1.9), (GALLERY + 0.9, 1.75), (-0.55, -0.1)]
    ceiling = [(0.2, -0.12), (GALLERY + 0.1, -0.12), (GALLERY + 0.1, -0.02), (0.2, -0.02)]
    low_rail = [(-0.12, 0.0), (0.12, 0.0), (0.12, 0.15), (-0.12, 0.15)]
    rows = [
        (cornice, LEVEL, p.LIMESTONE),
        (slab, LEVEL, p.OAK),
        (low_rail, LEVEL - 2 * EMBED, p.LIMESTONE),
        (rail, LEVEL + 0.72, p.LIMESTONE),
        (cornice * [0.8, 0.7], EAVES, p.LIMESTONE),
        (ceiling, EAVES, p.OAK),
        (roof, EAVES + 0.12, p.TERRACOTTA),
    ]
    beams = np.linspace(-HALF_Z + 1.0, HALF_Z - 1.0, 12)
    purlins = np.array([(x, EAVES + 0.42, 0) for x in (-4.0, -2.0, 0.0, 2.0, 4.0)])
    timber = [
        put(
            box((2 * HALF_X + 0.6, 0.3, 0.2), (0, EAVES + 0.2, 0), p.DARK_WOOD), at_height(np.outer(beams, [0, 1]), 0.0)
        ),
        put(box((0.14, 0.16, 2 * HALF_Z), (0, 0, 0), p.OAK), purlins),
    ]
    parts = timber + [put(frame_ring(profile, HALF_X, HALF_Z, colour), (0, y, 0)) for profile, y, colour in rows]
    if d > 0.3:
        places, _ = around(0.5 if d > 0.75 else 1.0, HALF_X - 0.42, HALF_Z - 0.42)
        parts.append(put(box((0.16, 0.16, 0.2), (0, 0, 0), p.LIMESTONE), at_height(places, LEVEL - 0.24)))
        places, _ = around(0.5 if d > 0.75 else 1.0, HALF_X - 0.36, HALF_Z - 0.36)
        parts.append(put(box((0.13, 0.12, 0.13), (0, 0, 0), p.LIMESTONE), at_height(places, EAVES - 0.16)))
    return parts


def _galleries(d: float, rng) -> list[ScenePart]:
    """Vaults and transverse arches below, timber ceiling above, and the walls behind."""
    bays, facing = around(BAY, HALF_X + GALLERY / 2, HALF_Z + GALLERY / 2)
    half = BAY / 2 - 0.22
    ribs, turns = around(BAY)
    first = [0, 3, 9, 12]  # the corners, where two ribs start
    ribs, turns = np.concatenate([ribs, ribs[first]]), np.concatenate([turns, turns[np.roll(first, 1)]])
    out = -np.stack([np.sin(turns), np.cos(turns)], axis=1)
    cross = at_height(ribs + out * GALLERY / 2, SPRING)
    n = steps(5, d, 1)
    pilaster = box((0.5, EAVES, 0.36), (0, EAVES / 2 - 3 * EMBED, 0), p.LIMESTONE)
    outside, looking = around(BAY, HALF_X + GALLERY, HALF_Z + GALLERY)
    course = min(0.8, max(0.12, 0.65 / d**0.5)) if d > COARSE else 3.2
    long, wide = 2 * (HALF_Z + GALLERY), 2 * (HALF_X + GALLERY)
    wall = put(ashlar(long + 0.1, EAVES - EMBED, 0.4, course, rng), [(0, 0, 0)]).mesh
    end = ashlar(wide + 0.7, EAVES, 0.4, course, rng)
    sides = [(-wide / 2, EMBED / 2, 0), (wide / 2, EMBED / 2, 0)]
    parts = [
        put(wall, sides, [np.pi / 2, -np.pi / 2]),
        put(end, [(0, 0, -long / 2), (0, 0, long / 2)], [0.0, np.pi]),
    ]
    if d > SKETCH:
        shades = p.shades(rng, len(outside)) % 3
        parts.append(put(pilaster, at_height(outside, 0.0), looking, shade=shades))
        parts.append(put(vault(half, RADIUS + 0.16, LEVEL - 0.25 - SPRING, n), at_height(bays, SPRING), facing))
    if d > COARSE:
        rib = arch(RADIUS, LEVEL - 0.28 - SPRING, 0.5, steps(10, d, 3), p.LIMESTONE)
        parts.append(put(rib, cross, turns + np.pi / 2))
    if d > 0.4:
        beams, turn = around(1.0 if d > 0.8 else 2.0, HALF_X + GALLERY / 2, HALF_Z + GALLERY / 2, corners=False)
        parts.append(put(box((0.16, 0.22, GALLERY + 0.1), (0, 0, 0), p.DARK_WOOD), at_height(beams, EAVES - 0.2), turn))
    return parts
