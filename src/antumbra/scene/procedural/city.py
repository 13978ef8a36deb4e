"""A city, block by block, in one piece or streamed at sizes that do not fit into memory."""

from collections.abc import Iterator
from itertools import chain
from typing import NamedTuple

import numpy as np

from . import palette as p
from .buildings import FLOOR, Style, antenna, billboard, car, cooler, house, lamp, round_tower, tank, tower, tower_cost
from .parts import ScenePart, assemble, count, put
from .plants import bush
from .request import checked
from .shapes import PaletteMesh, arc, box, boxes, grid, merge, revolve, steps
from .trees import BareTree, bare_tree, tree

PITCH, STREET = 70.0, 15.0  # metres between blocks; width of the streets
KERB = 0.16
FULL_BLOCK = 20_000  # triangles; a larger budget makes more blocks
GROUP = 64  # blocks that share a budget: triangles that a block leaves go to later blocks
_WALLS = (p.BRICK, p.SANDSTONE, p.PLASTER, p.TERRACOTTA, p.LIMESTONE, p.CONCRETE)
_PAINTS = (p.RED, p.BLUE, p.WHITE, p.IRON, p.OCHRE, p.TEAL)


class _Plan(NamedTuple):
    """Data shared by all blocks."""

    n: int  # blocks along each side
    budget: int  # triangles for each block
    detail: float  # of props and plants, at most 1
    props: list[PaletteMesh]  # cars, then lamp, tank, cooler, antenna, billboard
    trees: list[BareTree]


def _plan(triangles: int) -> _Plan:
    n = max(2, round(np.sqrt(triangles / FULL_BLOCK)))
    budget = triangles // (n * n)
    detail = min(1.0, np.sqrt(budget / FULL_BLOCK))
    props = [car(c, detail) for c in _PAINTS] + [lamp(detail), tank(detail), cooler(), antenna(), billboard()]
    trees = [bare_tree(np.random.default_rng(k), 7.5, 0.3 * detail) for k in range(2)]
    return _Plan(n, budget, detail, props, trees)


def city_view(triangles: int) -> tuple[dict, dict]:
    """Camera and light of the city with about `triangles` triangles."""
    n = _plan(triangles).n
    half = n * PITCH / 2.0
    r = min(half, 125.0)
    camera = {
        "position": (0.78 * r, 0.82 * r, 0.98 * r),
        "target": (-0.1 * r, 0.0, 0.03 * r),
        "up": (0.0, 1.0, 0.0),
        "vfov": 45.0,
    }
    middle = max(150.0, 1.8 * half) * np.array([-0.66, 0.62, 0.34])
    u = np.cross([0.0, 1.0, 0.0], middle)
    v = np.cross(middle, u)
    size = 0.14 * np.linalg.norm(middle)
    u, v = (size * a / np.linalg.norm(a) for a in (u, v))
    return camera, {"corner": tuple(middle - (u + v) / 2.0), "u": tuple(u), "v": tuple(v)}


def city_blocks(triangles: int, seed: int = 0) -> Iterator[tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """The pieces of a city of about `triangles` triangles, one block after the other.

    Yields
    ------
    vertices : (v, 3) float32, metres, world
    faces : (f, 3) int32
        Into the vertices of this piece.
    colour : (f,) uint8
        Rows of `palette.PALETTE`.

    Raises
    ------
    InputError
        On a number of triangles or a seed out of range.

    Notes
    -----
    Memory use is that of one block. `city_view` gives the camera and the light.
    """
    return _pieces(*checked("city", triangles, seed))


def city_groups(triangles: int, seed: int, first: int = 0, step: int = 1) -> Iterator[Iterator[PaletteMesh]]:
    """The pieces of every `step`-th group of blocks, from group `first` on.

    Groups do not depend on each other, so several processes can make a city. The arguments have been checked.
    """
    plan = _plan(triangles)
    for k in range(first * GROUP, plan.n**2, step * GROUP):
        yield _group(plan, triangles, seed, range(k, min(k + GROUP, plan.n**2)))


def _pieces(triangles: int, seed: int) -> Iterator[PaletteMesh]:
    return chain.from_iterable(city_groups(triangles, seed))


def _group(plan: _Plan, triangles: int, seed: int, blocks: range) -> Iterator[PaletteMesh]:
    done = round(triangles * blocks[0] / plan.n**2)
    for k in blocks:
        i, j = divmod(k, plan.n)
        budget = round(triangles * (k + 1) / plan.n**2) - done
        mesh = _block(plan, i, j, budget, np.random.default_rng([seed, i, j]))
        done += len(mesh.faces)
        yield mesh


def city(triangles: int, seed: int) -> tuple[PaletteMesh, dict, dict]:
    """Mesh, camera and light of the city with about `triangles` triangles."""
    return merge(*_pieces(triangles, seed)), *city_view(triangles)


def _block(plan: _Plan, i: int, j: int, budget: int, rng) -> PaletteMesh:
    """A block in its place, with the streets on two of its sides, of about `budget` triangles."""
    middle = (np.array([i, j]) - (plan.n - 1) / 2.0) * PITCH
    central = np.exp(-((np.linalg.norm(middle) / (0.45 * plan.n * PITCH)) ** 2))
    parts = _ground(plan) + _street(plan, rng)
    if rng.random() < 0.08 or i == j == (plan.n - 1) // 2:
        parts += _park(plan, rng)
        spots = rng.uniform(-22.0, 22.0, (26, 2))
        spots = spots[np.linalg.norm(spots, axis=1) > 9.0]
    else:
        parts += _buildings(plan, rng, central, 0.5 * max(0.0, budget - count(parts)))
        side = np.linspace(-24.0, 24.0, 8)
        edge = np.full(8, PITCH / 2 - STREET / 2 - 1.6)
        spots = np.concatenate(
            [np.stack(a, axis=1) for a in ((side, edge), (side, -edge), (edge, side), (-edge, side))]
        )
        spots = spots[rng.random(len(spots)) < 0.6]
    parts += _trees(plan, rng, spots, budget - count(parts))
    mesh = assemble(parts)
    mesh.vertices[:, ::2] += middle.astype(np.float32)
    return mesh


def _ground(plan: _Plan) -> list[ScenePart]:
    """Asphalt, the pavement with its kerb, and markings."""
    h, q = PITCH / 2, (PITCH - STREET) / 2
    x = np.array([-h, h])
    flat = np.stack(np.broadcast_arrays(x[:, None], 0.0, x), axis=-1)
    road = grid(flat, p.ASPHALT)
    pavement = box((2 * q, 2 * KERB, 2 * q), (0, 0, 0), p.CONCRETE, 0.05)
    dash = (np.arange(12) + 0.5) * PITCH / 12 - h
    marks = np.concatenate(
        [np.stack([dash, 0 * dash, 0 * dash + h - 0.2], axis=1), np.stack([0 * dash + h - 0.2, 0 * dash, dash], axis=1)]
    )
    marks = marks[np.abs(marks[:, [0, 2]]).min(axis=1) < q]
    sizes = np.where(np.abs(marks[:, :1]) > q, [[0.18, 0.03, 2.2]], [[2.2, 0.03, 0.18]])
    stripe = -STREET / 2 + 2.0 + np.arange(7) * 1.9 + 0.8
    stripe = np.where(stripe > 0.0, stripe - PITCH, stripe) + h  # keeps all stripes on this block's ground
    zebra = np.stack([0 * stripe + q - 3.0, 0 * stripe, stripe], axis=1)
    lines = boxes(np.concatenate([sizes, np.tile([[2.8, 0.03, 0.7]], (7, 1))]), np.concatenate([marks, zebra]), p.WHITE)
    return [put(road), put(pavement)] + ([put(lines)] if plan.detail > 0.4 else [])


def _street(plan: _Plan, rng) -> list[ScenePart]:
    """Cars along the streets and lamps on the pavement."""
    q = (PITCH - STREET) / 2
    n = round(7 * plan.detail)
    if n == 0:
        return []
    along = (np.arange(n) + 0.5) / n * (PITCH - STREET - 8.0) - (PITCH - STREET) / 2 + 4.0
    lanes = [(q + 1.3, 0.0), (q + 5.2, np.pi), (q + STREET - 1.3, np.pi)]
    spots, turns = [], []
    for lane, turn in lanes:
        for across in (0, 1):
            keep = along[rng.random(n) < 0.55] + rng.uniform(-0.8, 0.8)
            fixed = np.full(len(keep), lane if lane < PITCH / 2 else lane - PITCH)
            spots.append(np.stack([keep, 0 * keep, fixed] if across == 0 else [fixed, 0 * keep, keep], axis=1))
            turns.append(np.full(len(keep), turn + across * np.pi / 2))
    spots, turns = np.concatenate(spots), np.concatenate(turns)
    paint = rng.integers(0, len(_PAINTS), len(spots))
    parts = [
        put(plan.props[c], spots[paint == c], turns[paint == c], shade=p.shades(rng, int(np.sum(paint == c))) % 4)
        for c in range(len(_PAINTS))
    ]
    if plan.detail > 0.4:
        poles = [(-14, q - 0.6, -np.pi / 2), (14, q - 0.6, -np.pi / 2), (q - 0.6, -14, 0.0), (q - 0.6, 14, 0.0)]
        x, z, turn = np.array(poles).T
        parts.append(put(plan.props[6], np.stack([x, 0 * x + KERB, z], axis=1), turn))
    return [part for part in parts if len(part.offset)]


def _lots(rng, x0, x1, z0, z1, least: float) -> list[tuple]:
    """A rectangle split into lots by random cuts."""
    w, d = x1 - x0, z1 - z0
    if max(w, d) < 2.0 * least or (max(w, d) < 2.8 * least and rng.random() < 0.35):
        return [(x0, x1, z0, z1)]
    t = rng.uniform(0.4, 0.6)
    if w > d:
        m = x0 + t * w
        return _lots(rng, x0, m, z0, z1, least) + _lots(rng, m, x1, z0, z1, least)
    m = z0 + t * d
    return _lots(rng, x0, x1, z0, m, least) + _lots(rng, x0, x1, m, z1, least)


def _buildings(plan: _Plan, rng, central: float, budget: float) -> list[ScenePart]:
    q = (PITCH - STREET) / 2 - 4.0
    lots = _lots(rng, -q, q, -q, q, max(10.0 + 3.0 * central, 2.0 * q / np.sqrt(max(budget, 400.0) / 400.0)))
    parts, roofs = [], []
    for x0, x1, z0, z1 in lots:
        w, d = x1 - x0 - rng.uniform(0.8, 2.5), z1 - z0 - rng.uniform(0.8, 2.5)
        mesh, spots = _building(rng, w, d, central, budget / len(lots))
        at = np.array([(x0 + x1) / 2, KERB, (z0 + z1) / 2])
        parts.append(put(mesh, at))
        roofs += [np.asarray(s) + at for s in spots]
    return parts + (_roof_things(plan, rng, np.array(roofs).reshape(-1, 3)) if plan.detail > 0.3 else [])


def _building(rng, w: float, d: float, central: float, budget: float):
    """(mesh of a building on a lot of w x d metres, free places on its roof)."""
    wall, glass = _WALLS[rng.integers(len(_WALLS))], p.GLASS
    kind = rng.random()
    floors = int(rng.integers(2, 6) + round(rng.gamma(2.0, 1.6) * central))
    if kind > 0.9 and floors > 4:
        r = 0.45 * min(w, d)
        segments = int(np.clip(budget / (floors * 8 + 8), 6, 36))
        return round_tower(r, floors, segments, rng), []
    if kind < 0.45 - 0.2 * central:
        floors = min(floors, 4)
        style = _affordable(budget - 60, w, d, floors, Style(3.0, 0.42, True, wall, glass, 0.0))
        mesh = house(w, d, floors, style, rng, p.TERRACOTTA if rng.random() < 0.7 else p.SLATE)
        return mesh, []
    if floors > 8 and kind < 0.75:
        return _stepped(rng, w, d, floors, budget, wall)
    ledge = 0.25 if floors < 8 and rng.random() < 0.6 else 0.0
    share = 0.5 if floors < 9 else 0.8
    style = _affordable(budget, w, d, floors, Style(3.2, share, True, wall, glass, ledge))
    top = floors * FLOOR + 0.2
    spots = rng.uniform(-0.34, 0.34, (3, 2)) * [w, d]
    roof = (p.CONCRETE, p.SLATE, p.TERRACOTTA, p.TRAVERTINE)[rng.integers(4)]
    return tower(w, d, floors, style, rng, roof=roof), np.insert(spots, 1, top, axis=1)


def _affordable(budget: float, w: float, d: float, floors: int, style: Style) -> Style:
    """`style`, with flat windows or wider bays where needed to cost no more than `budget`."""
    for relief in (True, False):
        for bay in (style.bay, 1.3 * style.bay):
            choice = style._replace(relief=relief, bay=bay)
            if tower_cost(w, d, floors, choice) <= budget:
                return choice
    choice = choice._replace(ledge=0.0)
    while choice.bay < max(w, d) and tower_cost(w, d, floors, choice) > budget:
        choice = choice._replace(bay=1.4 * choice.bay)
    return choice


def _stepped(rng, w: float, d: float, floors: int, budget: float, wall: int):
    """(mesh of a tower of three tiers, a place on its roof)."""
    meshes, base = [], 0.0
    tiers = np.maximum(1, np.round(floors * np.array([0.45, 0.33, 0.22])).astype(int))
    for n, size in zip(tiers, (1.0, 0.76, 0.5)):
        style = _affordable(budget * n / floors, size * w, size * d, int(n), Style(2.8, 0.7, True, wall, p.GLASS, 0.0))
        meshes.append(tower(size * w, size * d, int(n), style, rng, base))
        base += n * FLOOR + 0.2
    return merge(*meshes), np.array([[0.0, base, 0.0]])


def _roof_things(plan: _Plan, rng, spots: np.ndarray) -> list[ScenePart]:
    kind = rng.choice(4, len(spots), p=[0.25, 0.5, 0.15, 0.1])
    turn = rng.integers(0, 4, len(spots)) * np.pi / 2
    pairs = [(plan.props[7 + k], kind == k) for k in range(4)]
    return [put(mesh, spots[chosen], turn[chosen]) for mesh, chosen in pairs if chosen.any()]


def _park(plan: _Plan, rng) -> list[ScenePart]:
    """A lawn with paths around a round pond."""
    q = (PITCH - STREET) / 2 - 2.5
    lawn = box((2 * q, 0.3, 2 * q), (0, 0.1, 0), p.GRASS)
    paths = boxes([(2 * q + 0.6, 0.3, 2.6), (2.6, 0.304, 2 * q + 0.6)], [(0, 0.12, 0), (0, 0.122, 0)], p.TRAVERTINE)
    n = steps(28, plan.detail, 8)
    rim = revolve(
        np.concatenate([[(0, 0.1), (6.2, 0.1)], arc((6.0, 0.5), 0.2, 0, 180, 3), [(5.7, 0.4), (0, 0.4)]]),
        n,
        p.LIMESTONE,
    )
    water = revolve([(0, 0.3), (5.75, 0.3), (5.75, 0.45), (0, 0.45)], n, p.WATER)
    jet = revolve(
        [(0, 0.2), (0.8, 0.2), (0.5, 0.8), (1.6, 1.1), (0.3, 1.2), (0.25, 2.0), (0.9, 2.2), (0, 2.1)], n, p.MARBLE
    )
    k = steps(24, plan.detail)
    at = np.insert(rng.uniform(-q, q, (k, 2)), 1, 0.2, axis=1)
    hedges = put(bush(rng, 0.8, 0.25 * plan.detail), at, scale=rng.uniform(0.6, 1.2, k))
    return [put(lawn), put(paths), put(rim), put(water), put(jet), hedges]


def _trees(plan: _Plan, rng, spots: np.ndarray, budget: int) -> list[ScenePart]:
    """Trees, with leaves that use up the block's budget."""
    bare = len(plan.trees[0].wood.faces)
    n = int(np.clip(budget / (bare + 4 * 40), 0, len(spots)))
    parts: list[ScenePart] = []
    for k, colour in enumerate((p.LEAF, p.PINE) if n > 3 else (p.LEAF,) if n else ()):
        at = np.insert(spots[k : n : 2 if n > 3 else 1], 1, KERB, axis=1)
        share = budget / n if k == 0 and n > 3 else (budget - count(parts)) / len(at)
        leaves = max(8, int(share - bare) // 4)
        mesh = tree(rng, plan.trees[k], leaves, float(np.clip(12.0 / np.sqrt(leaves), 0.12, 1.6)), colour)
        parts.append(put(mesh, at, rng.uniform(0, 6.3, len(at)), rng.uniform(0.85, 1.3, len(at))))
    return parts
