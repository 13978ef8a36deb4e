"""The atrium, the default scene: a courtyard with arcades on two storeys under an open roof, and its furniture.

Its detail is fitted to the triangle budget; hanging ivy uses up the remainder.
"""

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..kernels.elementary import cos, power, sin
from . import palette as p
from .props import SINK, Blade, agave, bench, blades, bush, cloth, crate, ivy, palm, pot, shrub, vase
from .shapes import (
    PaletteMesh,
    ScenePart,
    arc,
    assemble,
    block,
    box,
    count,
    fitted,
    frame_ring,
    grid,
    heightfield,
    loft,
    lofts,
    merge,
    place_copies,
    prism,
    raise_mesh,
    revolve,
    steps,
)

# --- Building parts: columns, arches, vaults, walls, floors and stairs, standing on y = 0 -----------------------------


EMBED = 0.02  # metres by which parts extend into their neighbours, against gaps and coplanar faces


def column(
    height: float, radius: float, flutes: int, n: int, leaves: int = 0, colour: int = p.LIMESTONE
) -> PaletteMesh:
    """A column with plinth, attic base, tapered shaft, bell capital with `leaves` around it, and abacus.

    `n` sets the number of facets of the mouldings. A flute has `n` facets for `n` >= 3 and three for `n` = 2. For
    `n` = 1 the shaft is plain, and for `n` = 0 the column has its simplest form.
    """
    r, per = radius, 1 if n < 2 else max(3, n)
    low, high = 1.4 * r, height - 2.0 * r
    plinth, abacus = (0.03 * r, 0.08 * r) if n else (0.0, 0.0)
    ends = [
        box((2.75 * r, 0.5 * r, 2.75 * r), (0, 0.25 * r - EMBED, 0), colour, plinth),
        box((2.7 * r, 0.45 * r, 2.7 * r), (0, height - 0.225 * r + EMBED, 0), colour, abacus),
    ]
    if n == 0:
        profile = [(1.2 * r, 0.4 * r), (r, 0.8 * r), (0.87 * r, high), (1.25 * r, height - 0.3 * r)]
        return merge(*ends, revolve(profile, flutes, colour))
    base = [
        np.array([(1.3 * r, 0.4 * r)]),
        arc((1.08 * r, 0.68 * r), 0.24 * r, -70, 80, n),
        arc((1.02 * r, 1.12 * r), 0.13 * r, -70, 70, max(1, n - 1)),
    ]
    t = np.linspace(0.0, 1.0, max(2, n) + 1)
    shaft = np.stack([r * (1.0 - 0.13 * power(t, 1.6)), low + t * (high - low)], axis=1)
    t = np.linspace(0.0, 1.0, n + 1)
    bell = np.stack([r * (0.87 + 0.42 * t**2.4), high + 0.25 * r + t * 1.35 * r], axis=1)
    astragal = arc((0.9 * r, high + 0.12 * r), 0.1 * r, -60, 60, max(1, n - 2))
    scale = np.ones((1, flutes * per))
    if per > 1:
        scale = 1.0 - 0.085 * np.tile(power(sin(np.pi * np.arange(per) / per), 0.6), flutes)
        first, last = shaft[:1].copy(), shaft[-1:].copy()
        shaft[[0, -1], 1] += 0.12 * r, -0.12 * r  # flutes end a little before the shaft
        fluted = [np.ones((len(np.concatenate(base)) + 1, len(scale))), np.tile(scale, (len(shaft), 1))]
        shaft = np.concatenate([first, shaft, last])
        fluted.append(np.ones((len(astragal) + len(bell) + 2, len(scale))))
        scale = np.concatenate(fluted)
    outline = np.concatenate([*base, shaft, astragal, bell, [(1.25 * r, height - 0.3 * r)]])
    meshes = [*ends, revolve(outline, flutes * per, colour, scale)]
    if leaves:
        meshes.append(_acanthus(r, high + 0.25 * r, leaves, n + 1, colour))
    return merge(*meshes)


def _acanthus(r: float, y: float, leaves: int, segments: int, colour: int) -> PaletteMesh:
    """Two rows of leaves that curl away from a capital's bell."""
    rows = []
    for row, length, phase in ((0.0, 0.75 * r, 0.0), (0.45 * r, 0.95 * r, 0.5)):
        angle = (np.arange(leaves) + phase) * 2.0 * np.pi / leaves
        out = np.stack([cos(angle), np.zeros(leaves), -sin(angle)], axis=1)
        along = 0.98 * np.array([0, 1, 0]) + 0.2 * out
        width = np.full(leaves, 1.5 * np.pi * r / leaves)
        shape = blades(
            out * 0.86 * r + [0, y + row, 0],
            along,
            out,
            Blade(np.full(leaves, length), width, -0.4, segments, 3),
            colour,
        )
        rows.append(shape)
    return merge(*rows)


def baluster(height: float, detail: float, colour: int = p.LIMESTONE) -> PaletteMesh:
    """A turned baluster."""
    h, n = height, steps(2, detail)
    profile = np.concatenate(
        [
            [(0.055, -EMBED), (0.055, 0.08 * h), (0.03, 0.12 * h)],
            arc((0.03, 0.34 * h), (0.042, 0.2 * h), -75, 65, n),
            arc((0.025, 0.78 * h), (0.03, 0.1 * h), -60, 60, n),
            [(0.055, 0.93 * h), (0.055, h + EMBED)],
        ]
    )
    return revolve(profile, steps(6, detail, 4), colour)


def arch(radius: float, top: float, depth: float, n: int, colour: int = p.SANDSTONE) -> PaletteMesh:
    """The wall along x above a round arch of `radius`, from the springing at y = 0 to y = `top`; `depth`: along z."""
    curve = arc((0, 0), radius, 180, 0, n)
    end = np.array([[radius + EMBED, 0.0]])
    lower = np.concatenate([end * [-1, 1], curve, end])
    return prism(lower, np.stack([lower[:, 0], np.full(len(lower), top)], axis=1), depth, colour)


def doorway(
    width: float, half: float, spring: float, height: float, depth: float, n: int, colour: int = p.SANDSTONE
) -> PaletteMesh:
    """A wall along x, `width` by `height`, with a doorway 2 `half` wide under a round arch that springs at `spring`."""
    curve = arc((0.0, spring), half, 180, 0, n)
    sill = np.array([(width / 2, -EMBED), (half, -EMBED)])
    lower = np.concatenate([sill * [-1, 1], curve, sill[::-1]])
    x = np.concatenate([[-width / 2, -1.2 * half], curve[:, 0], [1.2 * half, width / 2]])
    x[[2, -3]] = -1.1 * half, 1.1 * half  # not directly above the jambs, against degenerate triangles
    return prism(lower, np.stack([x, np.full(len(x), height)], axis=1), depth, colour)


def voussoirs(radius: float, width: float, depth: float, stones: int, n: int, colour: int = p.LIMESTONE) -> PaletteMesh:
    """The stones of a round arch that springs at y = 0, alternately light and dark, with open joints."""
    joint = 0.012 / radius
    edges = np.linspace(np.pi, 0.0, stones + 1)
    angle = np.linspace(edges[:-1] - joint, edges[1:] + joint, n + 1).T  # (stones, n + 1)
    inner, outer = radius - 0.03, np.full(stones, radius + width)
    outer[stones // 2] += 0.35 * width  # the keystone
    r = np.stack([np.full(stones, inner), outer, outer, np.full(stones, inner)], axis=1)[:, None]
    z = np.broadcast_to(np.array([1, 1, -1, -1]) * depth / 2, (stones, n + 1, 4))
    sections = np.stack([cos(angle)[..., None] * r, sin(angle)[..., None] * r, z], axis=-1)
    return lofts(sections[:, :, ::-1], colour + np.array([0, 1] * stones)[:stones])


def vault(half: float, crown: float, top: float, n: int, colour: int = p.PLASTER) -> PaletteMesh:
    """A groin vault over a square bay of half width `half`, with its crown at y = `crown`, solid up to y = `top`."""
    radius = 1.2 * half  # less than a semicircle, so that the corners stay blunt
    x = half * sin(np.linspace(-np.pi / 2, np.pi / 2, 2 * n + 1))
    barrel = crown - radius + np.sqrt(radius**2 - x**2)
    y = np.maximum(barrel[:, None], barrel)
    points = np.stack(np.broadcast_arrays(x[:, None], y, x), axis=-1)
    side = np.arange(2 * n) < n
    mesh = block(points, top, colour)
    mesh.faces[: 8 * n * n] = grid(points, colour, flip=side[:, None] != side).faces[:, ::-1]
    return mesh


def tiles(
    x: tuple[float, float, int],
    z: tuple[float, float, int],
    rng: np.random.Generator,
    colour: int = p.TRAVERTINE,
    accent: int | None = None,
    joint: float = 0.03,
    relief: float = 0.008,
) -> PaletteMesh:
    """A floor of tiles with tops within `relief` / 2 of y = 0, bevelled into the joints.

    x, z : (start, end, number of tiles) along the axis
    """
    lines, nx, nz = [], x[2], z[2]
    for a, b, n in (x, z):
        corner = np.linspace(a, b, n + 1)
        inner = np.stack([corner[:-1], corner[:-1] + joint / 2, corner[1:] - joint / 2], axis=1)
        lines.append(np.append(inner, b))
    height = np.full((nx, 3, nz, 3), -1.5 * relief)
    height[:, 1:, :, 1:] = (
        rng.uniform(-relief, relief, (nx, 2, nz, 2)) / 8 + rng.uniform(-3, 3, (nx, 1, nz, 1)) * relief / 8
    )
    height = np.pad(height.reshape(3 * nx, 3 * nz), ((0, 1), (0, 1)), constant_values=-1.5 * relief)
    kind = np.full((nx, nz), colour)
    if accent is not None:
        i, j = np.indices((nx, nz))
        kind = np.where((i + j) % 2 == 0, accent, colour)
    shade = kind + p.shades(rng, nx * nz).reshape(nx, nz) % 4
    return heightfield(lines[0], lines[1], height, np.repeat(np.repeat(shade, 3, axis=0), 3, axis=1))


def ashlar(
    width: float, height: float, depth: float, course: float, rng: np.random.Generator, colour: int = p.SANDSTONE
) -> PaletteMesh:
    """A wall along x with shades in running bond. Its front at z = 0 faces +z, and its back is at -depth."""
    nx, ny = max(2, round(width / course)), max(1, round(height / course))
    i, j = np.indices((nx, ny))
    stone = (i + j % 2) // 2
    shade = p.shades(rng, (nx + 2) * ny).reshape(nx + 2, ny)[stone, j]
    x, y = np.linspace(-width / 2, width / 2, nx + 1), np.linspace(0.0, height, ny + 1)[::-1]
    points = np.stack(np.broadcast_arrays(x[:, None], 0.0, -y), axis=-1)
    lying = block(points, -depth, (colour + shade)[:, ::-1])
    return assemble([place_copies(lying, tilt=np.pi / 2)])


def stairs(n: int, width: float, rise: float, run: float, colour: int = p.SANDSTONE) -> PaletteMesh:
    """A flight of n steps rising along +x from the origin, `width` wide in z, with a sloping soffit."""
    i = np.arange(2 * n + 1)
    upper = np.stack([i // 2 * run, (i + 1) // 2 * rise], axis=1)
    soffit = np.maximum(i / 2 * rise - 2.0 * rise, -EMBED)
    return prism(
        upper, np.stack([i / 2 * run, soffit], axis=1), width, colour
    )  # this order avoids degenerate triangles


# --- The building: a court with two storeys of arcades, galleries behind them, and an open roof -----------------------


BAY = 4.0  # metres between columns
HALF_X, HALF_Z = 6.0, 12.0  # half extents of the rectangle of columns: 3 x 6 bays
GALLERY = 4.0  # depth of the galleries around it
STEP = 0.16  # height of the gallery floor above the courtyard
SPRING, LEVEL = 3.6, 5.9  # springing height of the lower arches; height of the upper floor
UPPER_SPRING, EAVES = 8.3, 9.75
PIER, WALL = 0.84, 0.62  # width of the piers above the columns, thickness of the arcade walls
RADIUS, UPPER_RADIUS = (BAY - PIER) / 2, (BAY / 2 - 0.5) / 2
COARSE = 0.24  # up to this detail, voussoirs, small arches and ribs are omitted
SKETCH = 0.12  # up to this detail, all shapes have their plainest form


def arcade_positions(
    spacing: float, half_x: float = HALF_X, half_z: float = HALF_Z, corners: bool = True
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """(positions, (k, 2), every `spacing` metres around the rectangle; rotations that turn +z towards the court)."""
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


def at_height(places: ArrayLike, y: float) -> np.ndarray:
    """Positions (k, 2) as points (k, 3) at height y."""
    return np.insert(np.asarray(places, np.float64), 1, y, axis=1)


def architecture(d: float, rng: np.random.Generator) -> list[ScenePart]:
    """The whole building. Up to a detail of `COARSE`, ornaments are omitted."""
    corners, _ = arcade_positions(BAY)
    middles, facing = arcade_positions(BAY, corners=False)
    box_height = LEVEL - 0.27 - SPRING
    pier = box((PIER, box_height, PIER), (0, box_height / 2, 0), p.SANDSTONE)
    shaft = column(SPRING - STEP, 0.31, 12 if d > COARSE else 5, round(3.4 * d), 8 if d > 0.45 else 0)
    parts = [
        place_copies(shaft, at_height(corners, STEP + 0.04)),
        place_copies(pier, at_height(corners, SPRING - EMBED)),
        place_copies(arch(RADIUS, LEVEL - 0.35 - SPRING, WALL, steps(20, d, 2)), at_height(middles, SPRING), facing),
    ]
    if d > COARSE:
        stones = voussoirs(RADIUS, 0.3, WALL + 0.1, 11, steps(1.6, d))
        parts.append(place_copies(stones, at_height(middles, SPRING), facing))
    return [*parts, *_upper_storey(d), *_floors(d, rng), *_mouldings(d), *_galleries(d, rng)]


def _upper_storey(d: float) -> list[ScenePart]:
    """Slender columns on pedestals, small arches, and the balustrade between them."""
    high = LEVEL + 0.9
    places, _ = arcade_positions(BAY / 2 if d > COARSE else BAY)
    middles, facing = arcade_positions(BAY / 2, corners=False)
    shaft = column(UPPER_SPRING - high, 0.17, steps(9, d, 4), round(1.2 * d + 0.25), 6 if d > 1.5 else 0, p.MARBLE)
    if d <= SKETCH:
        shaft = box((0.3, UPPER_SPRING - high + 0.06, 0.3), (0, (UPPER_SPRING - high) / 2, 0), p.MARBLE)
    parts = [
        place_copies(shaft, at_height(places, high)),
        place_copies(
            box((0.56, high - LEVEL + EMBED, 0.56), (0, (high - LEVEL + EMBED) / 2, 0), p.LIMESTONE),
            at_height(places, LEVEL - EMBED),
        ),
    ]
    if d <= COARSE:
        lintel = [(-0.21, 0.0), (0.21, 0.0), (0.21, 1.2), (-0.21, 1.2)]
        return [*parts, place_copies(frame_ring(lintel, HALF_X, HALF_Z, p.SANDSTONE), (0, UPPER_SPRING - EMBED, 0))]
    parts += [
        place_copies(box((0.5, 1.2, 0.5), (0, 0.6, 0), p.SANDSTONE), at_height(places, UPPER_SPRING - EMBED)),
        place_copies(arch(UPPER_RADIUS, 1.2, 0.42, steps(14, d, 3)), at_height(middles, UPPER_SPRING), facing),
    ]
    if d > 0.4:
        stones = voussoirs(UPPER_RADIUS, 0.14, 0.48, 7, steps(1.5, d))
        parts.append(place_copies(stones, at_height(middles, UPPER_SPRING), facing))
    if d > 0.33:
        per = steps(4, d**0.5, 2)
        along = (np.arange(per) + 1.0) / (per + 1) - 0.5
        side = np.stack([cos(facing), -sin(facing)], axis=1)
        spots = (middles[:, None] + along[:, None] * 1.55 * side[:, None]).reshape(-1, 2)
        parts.append(place_copies(baluster(0.62, d), at_height(spots, LEVEL + 0.12)))
    return parts


def _floors(d: float, rng: np.random.Generator) -> list[ScenePart]:
    """Tiles in the courtyard and the galleries, and a kerb under the columns."""
    edge_x, edge_z = HALF_X - 0.55, HALF_Z - 0.55
    wide = min(0.9, max(0.2, 0.9 / d**0.5)) if d > COARSE else 3.0
    nx, nz = round(2 * edge_x / wide), round(2 * edge_z / wide)
    court = tiles((-edge_x, edge_x, nx), (-edge_z, edge_z, nz), rng, p.SANDSTONE, p.CLAY)
    inner_x, inner_z = HALF_X + 0.45, HALF_Z + 0.45
    outer_x, outer_z = HALF_X + GALLERY, HALF_Z + GALLERY
    wide *= 1.4
    parts = [place_copies(court)]
    for sign in (-1, 1):
        x0, x1 = sorted((sign * inner_x, sign * outer_x))
        z0, z1 = sorted((sign * inner_z, sign * outer_z))
        k = max(1, round(GALLERY / wide))
        parts.append(
            place_copies(
                tiles((x0, x1, k), (-outer_z, outer_z, round(2 * outer_z / wide)), rng, p.TERRACOTTA), (0, STEP, 0)
            )
        )
        parts.append(
            place_copies(
                tiles((-inner_x, inner_x, round(2 * inner_x / wide)), (z0, z1, k), rng, p.TERRACOTTA), (0, STEP, 0)
            )
        )
    kerb = [(-0.56, -0.1), (0.5, -0.1), (0.5, STEP + 0.03), (-0.5, STEP + 0.05), (-0.56, STEP)]
    return [*parts, place_copies(frame_ring(kerb, HALF_X, HALF_Z, p.MARBLE))]


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
    rows: list[tuple[ArrayLike, float, int]] = [
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
        place_copies(
            box((2 * HALF_X + 0.6, 0.3, 0.2), (0, EAVES + 0.2, 0), p.DARK_WOOD), at_height(np.outer(beams, [0, 1]), 0.0)
        ),
        place_copies(box((0.14, 0.16, 2 * HALF_Z), (0, 0, 0), p.OAK), purlins),
    ]
    parts = timber + [
        place_copies(frame_ring(profile, HALF_X, HALF_Z, colour), (0, y, 0)) for profile, y, colour in rows
    ]
    if d > 0.3:
        places, _ = arcade_positions(0.5 if d > 0.75 else 1.0, HALF_X - 0.42, HALF_Z - 0.42)
        parts.append(place_copies(box((0.16, 0.16, 0.2), (0, 0, 0), p.LIMESTONE), at_height(places, LEVEL - 0.24)))
        places, _ = arcade_positions(0.5 if d > 0.75 else 1.0, HALF_X - 0.36, HALF_Z - 0.36)
        parts.append(place_copies(box((0.13, 0.12, 0.13), (0, 0, 0), p.LIMESTONE), at_height(places, EAVES - 0.16)))
    return parts


def _galleries(d: float, rng: np.random.Generator) -> list[ScenePart]:
    """Vaults and transverse arches below, timber ceiling above, and the walls behind."""
    bays, facing = arcade_positions(BAY, HALF_X + GALLERY / 2, HALF_Z + GALLERY / 2)
    half = BAY / 2 - 0.22
    ribs, turns = arcade_positions(BAY)
    first = [0, 3, 9, 12]  # the corners, where two ribs start
    ribs, turns = np.concatenate([ribs, ribs[first]]), np.concatenate([turns, turns[np.roll(first, 1)]])
    out = -np.stack([sin(turns), cos(turns)], axis=1)
    cross = at_height(ribs + out * GALLERY / 2, SPRING)
    n = steps(5, d, 1)
    pilaster = box((0.5, EAVES, 0.36), (0, EAVES / 2 - 3 * EMBED, 0), p.LIMESTONE)
    outside, outside_turns = arcade_positions(BAY, HALF_X + GALLERY, HALF_Z + GALLERY)
    course = min(0.8, max(0.12, 0.65 / d**0.5)) if d > COARSE else 3.2
    long, wide = 2 * (HALF_Z + GALLERY), 2 * (HALF_X + GALLERY)
    wall = place_copies(ashlar(long + 0.1, EAVES - EMBED, 0.4, course, rng), [(0, 0, 0)]).mesh
    end = ashlar(wide + 0.7, EAVES, 0.4, course, rng)
    sides = [(-wide / 2, EMBED / 2, 0), (wide / 2, EMBED / 2, 0)]
    parts = [
        place_copies(wall, sides, [np.pi / 2, -np.pi / 2]),
        place_copies(end, [(0, 0, -long / 2), (0, 0, long / 2)], [0.0, np.pi]),
    ]
    if d > SKETCH:
        shades = p.shades(rng, len(outside)) % 3
        parts.append(place_copies(pilaster, at_height(outside, 0.0), outside_turns, shade=shades))
        parts.append(
            place_copies(vault(half, RADIUS + 0.16, LEVEL - 0.25 - SPRING, n), at_height(bays, SPRING), facing)
        )
    if d > COARSE:
        rib = arch(RADIUS, LEVEL - 0.28 - SPRING, 0.5, steps(10, d, 3), p.LIMESTONE)
        parts.append(place_copies(rib, cross, turns + np.pi / 2))
    if d > 0.4:
        beams, turn = arcade_positions(
            1.0 if d > 0.8 else 2.0, HALF_X + GALLERY / 2, HALF_Z + GALLERY / 2, corners=False
        )
        parts.append(
            place_copies(box((0.16, 0.22, GALLERY + 0.1), (0, 0, 0), p.DARK_WOOD), at_height(beams, EAVES - 0.2), turn)
        )
    return parts


# --- The scene --------------------------------------------------------------------------------------------------------


CAMERA = {"position": (2.6, 1.7, 11.2), "target": (-0.7, 3.0, -2.0), "up": (0.0, 1.0, 0.0), "vfov": 56.0}
LIGHT = {"corner": (-3.2, 7.6, 7.6), "u": (2.2, 0.0, 0.0), "v": (0.0, 1.5, -1.7)}


def atrium(triangles: int, seed: int) -> tuple[PaletteMesh, dict[str, Any], dict[str, Any]]:
    """Mesh, camera and light of the atrium with about `triangles` triangles."""

    def build(detail: float) -> list[ScenePart]:
        return architecture(detail, np.random.default_rng([seed, 0])) + _furniture(
            detail, np.random.default_rng([seed, 1])
        )

    greenery = 0.06 + 0.1 * min(1.0, triangles / 1e6)
    parts = fitted(build, round((1.0 - greenery) * triangles), np.sqrt(triangles / 370_000), near=0.87)
    parts.append(_hanging_plants(np.random.default_rng([seed, 2]), (triangles - count(parts)) // 4))
    return assemble(parts), CAMERA, LIGHT


def _furniture(d: float, rng: np.random.Generator) -> list[ScenePart]:
    """The fountain, pots with plants, amphorae, benches, crates, curtains and banners."""
    pots = np.array([(-2.9, 5.6), (4.3, 4.2), (-4.2, -1.4), (4.3, -6.6), (-4.1, -8.8), (3.9, 9.0)])
    leaves = palm(rng, steps(15, d, 4), steps(18, d, 3), 2.3, 1.75, d)
    kinds = [merge(raise_mesh(leaves, 0.55), pot(0.65, 0.42, d))]
    if d > SKETCH:
        leaves = agave(rng, steps(26, d**0.5, 6), 0.95, steps(6, d, 2))
        kinds.append(merge(raise_mesh(leaves, 0.5), pot(0.6, 0.45, d, p.CLAY)))
    parts = _fountain(d)
    for k, kind in enumerate(kinds):
        places = pots[k::2]
        parts.append(
            place_copies(
                kind, at_height(places, 0.0), rng.uniform(0, 6.3, len(places)), rng.uniform(0.9, 1.12, len(places))
            )
        )
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
        [radius * cos(angle)[:, None], np.broadcast_to(y, (8, 8)), radius * sin(angle)[:, None]], axis=-1
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
    turned_water = place_copies(water, (0, 0, FOUNTAIN[1]), np.pi / 8)
    segments = steps(24, d, 8)
    at = [(FOUNTAIN[0], 0.0, FOUNTAIN[1])]
    return [
        place_copies(basin, at),
        place_copies(revolve(bowl, segments, p.MARBLE), at),
        place_copies(revolve(jet, steps(14, d, 6), p.BRONZE), at),
        turned_water,
    ]


FOUNTAIN = (0.0, 0.6)


def _clutter(d: float, rng: np.random.Generator) -> list[ScenePart]:
    """Groups of amphorae, benches between the columns, crates in corners, clipped shrubs."""
    per_corner = max(1, round(d**0.5))
    spots, turns = arcade_positions(BAY, HALF_X + 0.1, HALF_Z + 0.1, corners=False)
    seats = bench(1.7, bevel=0.015 if d > COARSE else 0.0)
    corner = np.array([(-2.1, 7.3), (-4.7, 3.0), (4.7, -1.6), (-4.6, -10.4), (4.6, 6.9)])
    places = np.repeat(corner, 2 * per_corner, axis=0) + rng.normal(0.0, 0.33, (10 * per_corner, 2))
    size = rng.uniform(0.55, 1.15, len(places))
    parts = [place_copies(seats, at_height(spots[::3], STEP + 0.05), turns[::3])]
    for k, shape in enumerate((vase(1.0, d), vase(1.0, d, p.CLAY, 0.36, 0.14), vase(1.0, d, p.BLUE, 0.25, 0.1))):
        at = places[k::3]
        parts.append(
            place_copies(
                shape, at_height(at, 0.0), rng.uniform(0, 6.3, len(at)), size[k::3], shade=p.shades(rng, len(at)) % 4
            )
        )
    stack = np.array(
        [(3.95, 0.0, 11.0), (4.9, 0.0, 10.9), (4.4, 0.68, 10.95), (4.7, 0.0, 2.1), (-4.7, 0.0, -5.2), (-4.7, 0.0, -4.3)]
    )
    turn = np.array([0.1, -0.2, 0.35, 0.5, 0.15, 0.9])
    parts.append(place_copies(crate((0.8, 0.68, 0.75), round(4 * d**0.5)), stack, turn, [1, 1, 0.8, 1, 1, 0.8]))
    balls = np.array([(x, z) for x in (-1.9, 1.9) for z in (FOUNTAIN[1] - 2.1, FOUNTAIN[1] + 2.1)])
    parts.append(
        place_copies(merge(raise_mesh(bush(rng, 0.36, d), 0.38), pot(0.45, 0.3, d, p.MARBLE)), at_height(balls, 0.0))
    )
    green = merge(
        raise_mesh(shrub(rng, steps(260, d * d, 12), 0.42, 0.8, 0.15 / max(1.0, d**0.5)), 0.42), pot(0.5, 0.34, d)
    )
    tubs, _ = arcade_positions(BAY, HALF_X + 0.1, HALF_Z + 0.1, corners=False)
    if d > COARSE:
        parts.append(place_copies(green, at_height(tubs[1::3], STEP + 0.04), rng.uniform(0, 6.3, len(tubs[1::3]))))
    return parts


def _cloths(d: float, rng: np.random.Generator) -> list[ScenePart]:
    """Banners over the balustrade, and gathered curtains in some of the lower arches."""
    nx, ny = steps(16, d, 3), steps(12, d, 2)
    middles, facing = arcade_positions(BAY, corners=False)
    out = np.stack([sin(facing), cos(facing)], axis=1)
    parts = []
    for colour, banners, curtains in ((p.RED, (1, 6, 13, 17), (5, 10, 16)), (p.BLUE, (4, 8, 11, 15), (2, 7, 14))):
        banner = cloth((1.25, 2.2), (nx, ny), rng, 2.5, 0.05, colour=colour)
        k = list(banners)
        parts.append(place_copies(banner, at_height(middles[k] + 0.72 * out[k], LEVEL + 0.86), facing[k]))
        size = 2 * RADIUS - 0.1, SPRING - STEP - 0.1
        shade = p.RED if colour == p.RED else p.OCHRE
        curtain = cloth(size, (2 * nx, ny), rng, 6.0, 0.07, 0.95, shade)
        k = list(curtains)
        parts.append(place_copies(curtain, at_height(middles[k], SPRING), facing[k]))
    return parts


def _hanging_plants(rng: np.random.Generator, leaves: int) -> ScenePart:
    """Ivy with exactly `leaves` leaves, hanging in tufts from the balustrade."""
    edge, _ = arcade_positions(BAY / 2, corners=False)
    edge = edge[rng.permutation(len(edge))[: max(1, len(edge) * 2 // 5)]]
    per = 9
    strand = np.repeat(edge, per, axis=0) + rng.uniform(-0.6, 0.6, (len(edge) * per, 2))
    limit = np.array([HALF_X, HALF_Z]) - 0.68
    strand = np.where(np.abs(strand) > limit - 0.9, np.sign(strand) * limit, strand)
    start = at_height(strand, LEVEL + 0.06)
    size = np.clip(0.16 * np.sqrt(4000 / max(leaves, 1)), 0.05, 0.22)
    return place_copies(ivy(rng, start, rng.uniform(0.4, 2.2, len(start)), max(1, leaves), size))
