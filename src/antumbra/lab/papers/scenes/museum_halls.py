"""Museum halls with sculptures, paintings and display cases. A few small objects have most of the triangles.

Each work of art has about a given number of triangles, and stands on y = 0 or hangs from above.
"""

from typing import Any

import numpy as np

from ....generate import palette as p
from ....generate.atrium import EMBED, doorway, tiles
from ....generate.props import bench, unit, vase
from ....generate.shapes import (
    PaletteMesh,
    ScenePart,
    assemble,
    block,
    box,
    boxes,
    capped,
    count,
    fitted,
    frame_ring,
    loft,
    merge,
    place_copies,
    raise_mesh,
    revolve,
    rotation_x,
    rotation_y,
    steps,
)
from ....kernels.elementary import cos, exp, power, sin
from ....kernels.small_matrices import product

# --- Works of art -----------------------------------------------------------------------------------------------------


def _resolution(triangles: float, aspect: float, least: int = 4) -> tuple[int, int]:
    """Cells (along, around) of a surface of about `triangles` triangles, with `aspect` times as many cells along."""
    around = max(least, round(np.sqrt(max(triangles, 8.0) / 2.0 / aspect)))
    return max(3 * least, round(triangles / 2.0 / around)), around


def knot(
    triangles: float, turns: int = 2, loops: int = 3, size: float = 1.0, thick: float = 0.26, colour: int = p.BRONZE
) -> PaletteMesh:
    """A torus knot, 3 `size` wide, made of a bar with spiral ribs."""
    n, k = _resolution(triangles, 10.0)
    t = np.linspace(0.0, 2.0 * np.pi, n, endpoint=False)
    r = size * (1.0 + 0.42 * cos(loops * t))
    path = np.stack([r * cos(turns * t), r * sin(turns * t), 0.55 * size * sin(loops * t)], axis=1)
    ahead = unit(np.roll(path, -1, axis=0) - np.roll(path, 1, axis=0))
    hub = np.stack([size * cos(turns * t), size * sin(turns * t), 0.0 * t], axis=1)
    side = path - hub
    u = unit(side - np.sum(side * ahead, axis=1, keepdims=True) * ahead)
    v = np.cross(ahead, u)
    angle = np.linspace(0.0, 2.0 * np.pi, k, endpoint=False)
    rib = thick * size * (1.0 + 0.13 * cos(5 * angle - 24.0 * t[:, None]))
    points = path[:, None] + rib[..., None] * (cos(angle)[:, None] * u[:, None] + sin(angle)[:, None] * v[:, None])
    low = points[..., 1].min()
    return loft(points - [0.0, low, 0.0], colour, closed=True)


def blob(triangles: float, rng: np.random.Generator, size: float = 1.0, colour: int = p.MARBLE) -> PaletteMesh:
    """A smooth lumpy body; `size` is its mean radius."""
    n, k = _resolution(triangles, 0.5)
    n, k = max(4, k), max(6, n)
    theta = np.linspace(-np.pi / 2, np.pi / 2, n + 1)
    phi = np.linspace(0.0, 2.0 * np.pi, k, endpoint=False)
    direction = np.stack(
        np.broadcast_arrays(cos(theta)[:, None] * cos(phi), sin(theta)[:, None], -cos(theta)[:, None] * sin(phi)),
        axis=-1,
    )
    wave = rng.normal(0.0, 2.3, (9, 3))
    scale = 1.0 + 0.11 * sin(product(direction, wave.T) + rng.uniform(0, 6.3, 9)).sum(axis=-1)
    points = direction * scale[..., None] * size * [0.8, 1.25, 0.8]
    points[..., 1] -= points[..., 1].min() + 0.04 * size
    return capped(points[1:-1], points[0, 0], points[-1, 0], colour)


def twist(triangles: float, height: float = 2.4, width: float = 0.5, colour: int = p.MARBLE) -> PaletteMesh:
    """A twisted column with a star-shaped section that narrows towards the top."""
    n, k = _resolution(triangles, 2.0)
    k = max(12, k)
    t = np.linspace(0.0, 1.0, n + 1)[:, None]
    phi = np.linspace(0.0, 2.0 * np.pi, k, endpoint=False)
    r = width * (1.0 + 0.22 * cos(6 * phi)) * (1.0 - 0.55 * t + 0.22 * sin(9.0 * t))
    angle = phi + 3.6 * t
    points = np.stack([r * cos(angle), np.broadcast_to(height * t - 0.02, r.shape), -r * sin(angle)], axis=-1)
    return capped(points, points[0].mean(axis=0), points[-1].mean(axis=0), colour)


def ammonite(triangles: float, size: float = 1.0, colour: int = p.CLAY) -> PaletteMesh:
    """A ribbed spiral shell standing on its rim."""
    n, k = _resolution(triangles, 8.0)
    t = np.linspace(0.0, 1.0, n + 1)
    angle, reach = 2.0 * np.pi * 3.1 * t, size * 0.1 * exp(2.25 * t)
    centre = np.stack([cos(angle) * reach, sin(angle) * reach, 0.0 * t], axis=1)
    out = centre / reach[:, None]
    phi = np.linspace(0.0, 2.0 * np.pi, k, endpoint=False)
    tube = (0.36 * reach * (1.0 + 0.06 * sin(110.0 * t)))[:, None, None]
    points = centre[:, None] + tube * (cos(phi)[:, None] * out[:, None] + 1.15 * sin(phi)[:, None] * [0, 0, 1])
    return loft(points - [0.0, points[..., 1].min() + 0.03 * size, 0.0], colour)


def ribbon(triangles: float, size: float = 1.0, colour: int = p.OCHRE) -> PaletteMesh:
    """A band that twists once around a ring."""
    n = max(12, round(triangles / 8.0))
    t = np.linspace(0.0, 2.0 * np.pi, n, endpoint=False)[:, None]
    out = np.concatenate([cos(t), sin(t), 0.0 * t], axis=1)
    turn = t + 0.6 * sin(3 * t)
    across = cos(turn) * out + sin(turn) * [0.0, 0.0, 1.0]
    up = np.cross(np.roll(out, -1, axis=0) - out, across)
    up = unit(up)
    corners = [(0.42, 0.035), (-0.42, 0.035), (-0.42, -0.035), (0.42, -0.035)]
    ring = size * out * (1.0 + 0.1 * cos(2 * t))
    points = np.stack([ring + size * (a * across + b * up) for a, b in corners], axis=1)
    return loft(points - [0.0, points[..., 1].min() + 0.03, 0.0], colour, closed=True)


def rain(triangles: float, width: float = 5.2, depth: float = 4.2, ceiling: float = 6.2) -> list[ScenePart]:
    """A kinetic sculpture at rest: bronze drops on wires that form a wave."""
    nx, nz = (17, 14) if triangles > 12_000 else (11, 9) if triangles > 3000 else (5, 4)
    each = max(8.0, triangles / (nx * nz) - 12)
    k = int(np.clip(np.sqrt(each), 4, 200))
    n = max(3, k // 2)
    angle = np.linspace(-np.pi / 2, np.pi / 2, n + 1)
    profile = np.stack([cos(angle) * (1.0 - 0.45 * sin(angle)), 1.2 * sin(angle)], axis=1)
    profile[[0, -1], 0] = 0.0
    x, z = (a.ravel() for a in np.meshgrid(np.linspace(-0.5, 0.5, nx) * width, np.linspace(-0.5, 0.5, nz) * depth))
    y = 3.1 + 0.75 * sin(1.5 * x + 0.5 * z) + 0.45 * cos(1.7 * z - 0.6 * x)
    drop = revolve(profile * 0.1, k, p.OCHRE)
    wires = boxes(
        np.stack([0 * x + 0.012, ceiling - y - 0.08, 0 * x + 0.012], axis=1),
        np.stack([x, (ceiling + y + 0.08) / 2, z], axis=1),
        p.IRON,
    )
    tone = np.digitize(y, [2.6, 3.3]) * 2
    rails = boxes((width + 0.3, 0.05, 0.05), np.stack([0 * z[::nx], 0 * z[::nx] + ceiling, z[::nx]], axis=1), p.IRON)
    beams = boxes((0.1, 0.09, 2 * 4.6), [(s * width / 2, ceiling + 0.06, 0) for s in (-1, 1)], p.IRON)
    return [place_copies(drop, np.stack([x, y, z], axis=1), shade=tone), place_copies(merge(wires, rails, beams))]


def vortex(triangles: float, height: float = 4.6) -> list[ScenePart]:
    """Plates that spiral up around a mast and fan out."""
    n = int(np.clip(triangles / 44.0, 12, 4000))
    t = (np.arange(n) + 0.5) / n
    angle = 5.0 * np.pi * t
    matrix = product(rotation_y(angle), rotation_x(0.5 * sin(6.0 * np.pi * t)))
    size = 0.5 + 1.1 * power(sin(np.pi * t), 1.5)
    scale = np.stack(
        [size, np.full(n, 60.0 / n if n > 60 else 1.0), np.full(n, 60.0 / n + 0.3 if n > 60 else 1.0)], axis=1
    )
    plate = box((2.0, 0.05, 0.22), (0, 0, 0), p.RED, 0.008)
    at = np.stack([0 * t, 0.5 + (height - 0.8) * t, 0 * t], axis=1).astype(np.float32)
    whirl = ScenePart(plate, at, (matrix * scale[:, None]).astype(np.float32), (np.arange(n) % 3).astype(np.uint8))
    return [whirl, place_copies(revolve([(0.09, -0.1), (0.05, height)], 10, p.IRON))]


def painting(width: float, height: float, n: int, rng: np.random.Generator) -> PaletteMesh:
    """An abstract picture in a gilded frame, centred at the origin in the x-y plane and facing +z."""
    x, z = np.linspace(-width / 2, width / 2, n + 1), np.linspace(-height / 2, height / 2, n + 1)
    middle = np.stack(np.meshgrid((x[1:] + x[:-1]) / width, (z[1:] + z[:-1]) / height, indexing="ij"), axis=-1)
    centre, radius = rng.uniform(-0.5, 0.5, (9, 2)), rng.uniform(0.15, 0.5, 9)
    colours = rng.choice([p.RED, p.BLUE, p.OCHRE, p.TEAL, p.PLASTER, p.SLATE, p.CLAY, p.YELLOW, p.PINE], 9)
    inside = np.abs(middle[:, :, None] - centre).max(axis=-1) < radius
    top = np.where(inside.any(axis=-1), inside.shape[-1] - 1 - np.argmax(inside[..., ::-1], axis=-1), -1)
    colour = np.where(top < 0, p.LIMESTONE, colours[top]) + p.shades(rng, n * n).reshape(n, n) % 3
    relief = 0.004 * rng.random((n + 1, n + 1))
    canvas = block(np.stack(np.broadcast_arrays(x[:, None], relief, z), axis=-1), -0.05, colour)
    edge = frame_ring(
        [(-0.02, -0.06), (0.12, -0.06), (0.12, 0.05), (0.05, 0.08), (-0.02, 0.03)], width / 2, height / 2, p.OCHRE
    )
    return assemble([place_copies(merge(canvas, edge), tilt=np.pi / 2)])


# --- Halls ------------------------------------------------------------------------------------------------------------


WIDTH, DEPTH, HEIGHT = 14.0, 17.0, 6.4  # size of a hall, from wall to wall
WALL = 0.6
SKY_X, SKY_Z = 3.2, 4.2  # half the size of the skylight
FULL_HALL = 110_000  # triangles per hall; a larger budget adds halls


def museum(triangles: int, seed: int) -> tuple[PaletteMesh, dict[str, Any], dict[str, Any]]:
    """Mesh, camera and light of the museum, with about `triangles` triangles."""
    halls = max(1, round(triangles / FULL_HALL))
    nx = max(1, round(np.sqrt(halls / 2.0)))
    nz = max(1, round(halls / nx))
    i, j = (a.ravel() for a in np.indices((nx, nz)))
    at = np.stack([(i - nx // 2) * (WIDTH + WALL), 0.0 * i, -j * (DEPTH + WALL)], axis=1)
    guess = np.sqrt(triangles / len(at) / FULL_HALL)
    grid = i, j, nx, nz
    parts = fitted(lambda d: _halls(at, *grid, d, np.random.default_rng([seed, 0])), round(0.22 * triangles), guess)
    remaining = triangles - count(parts)
    parts += fitted(
        lambda d: _exhibits(at, d * d, np.random.default_rng([seed, 1])), remaining, np.sqrt(max(remaining, 1))
    )
    camera = {"position": (4.9, 1.7, 7.4), "target": (-1.1, 2.05, -4.0), "up": (0.0, 1.0, 0.0), "vfov": 60.0}
    light = {"corner": (-3.1, 4.9, 5.4), "u": (1.9, 0.0, 0.6), "v": (0.0, 1.5, -1.1)}
    return assemble(parts), camera, light


def _halls(
    at: np.ndarray, i: np.ndarray, j: np.ndarray, nx: int, nz: int, d: float, rng: np.random.Generator
) -> list[ScenePart]:
    """Floors, walls, doorways between halls, cornices, ceilings, and skylights with bars."""
    n, m = steps(14, d, 4), steps(17, d, 5)
    hx, hz = WIDTH / 2, DEPTH / 2
    floor = tiles((-hx - 0.05, hx + 0.05, n), (-hz - 0.05, hz + 0.05, m), rng, p.MARBLE, p.SANDSTONE, 0.02, 0.004)
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


def _fittings(at: np.ndarray, d: float, rng: np.random.Generator) -> list[ScenePart]:
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


def _plinth(width: float, height: float, colour: int = p.PLASTER) -> PaletteMesh:
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
    inside = raise_mesh(treasure, h)
    return merge(_plinth(w + 0.1, h, p.DARK_WOOD), frame, inside)


def _exhibits(at: np.ndarray, budget: float, rng: np.random.Generator) -> list[ScenePart]:
    """The works of art, about the same in every hall but at different angles. A few have most of the triangles."""
    each = budget / len(at)
    shares = np.array([0.2, 0.26, 0.16, 0.12, 0.1, 0.07, 0.05, 0.04]) * each
    works = [
        (merge(_plinth(1.1, 0.5), raise_mesh(knot(shares[1], size=0.62), 0.46)), (-4.0, -3.4)),
        (merge(_plinth(0.8, 0.95), raise_mesh(blob(shares[2], rng, 0.5), 0.94)), (3.9, 2.4)),
        (merge(_plinth(0.9, 0.35, p.SLATE), raise_mesh(twist(shares[3]), 0.33)), (4.3, -3.6)),
        (merge(_plinth(0.9, 0.8), raise_mesh(ammonite(shares[4], 0.62), 0.79)), (-3.9, 2.0)),
        (merge(_plinth(1.0, 0.6, p.SLATE), raise_mesh(ribbon(shares[5], 0.62), 0.58)), (-1.9, -7.0 + 0.4)),
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
