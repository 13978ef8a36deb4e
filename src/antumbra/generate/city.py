"""The city: blocks of buildings, streets and parks, generated in one piece or streamed at sizes beyond memory.

Streaming uses worker processes, which generate groups of blocks and send them through pipes. This module is also their
main program.
"""

import os
import subprocess
import sys
from collections.abc import Generator, Iterable, Iterator
from contextlib import suppress
from functools import lru_cache
from itertools import chain, cycle
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..kernels.elementary import exp
from ..kernels.small_matrices import length
from . import palette as p
from .palette import check_request
from .props import BareTree, bare_tree, bush, tree
from .shapes import (
    PaletteMesh,
    ScenePart,
    arc,
    assemble,
    box,
    boxes,
    capped,
    count,
    grid,
    merge,
    place_copies,
    prism,
    revolve,
    shell,
    steps,
    tubes,
)

# --- Towers, houses, cars and street furniture, each standing on y = 0 around its own origin --------------------------


FLOOR = 3.4  # metres between floors
_RECESS, _REVEAL = 0.28, 0.07  # depth of windows in the wall, and slant of their sides


class Style(NamedTuple):
    """The style of a facade."""

    bay: float  # metres between windows
    share: float  # fraction of the bay taken up by the window
    relief: bool  # whether windows are recessed, not just coloured
    wall: int  # palette index
    glass: int  # palette index
    ledge: float  # projection of a ledge at every floor, metres; 0: none
    roof: int = p.CONCRETE  # palette index
    parapet: float = 1.0  # metres


class Lines(NamedTuple):
    """Grid lines of a facade along one direction."""

    at: np.ndarray  # (n,) metres
    inset: np.ndarray  # (n,) 1 for recessed lines, else 0
    pane: NDArray[np.bool_]  # (n,) bool: whether a pane follows the line


def tower_cost(width: float, depth: float, floors: int, style: Style) -> int:
    """The number of triangles of a `tower`."""
    bays = 2 * (max(1, round(width / style.bay)) + max(1, round(depth / style.bay)))
    lines = (4 if style.relief else 2) + (3 if style.ledge > 0.0 else 0)
    return 2 * (bays * (4 if style.relief else 2) + 4) * (floors * lines + 6)


def _side(length: float, style: Style) -> Lines:
    """The vertical lines of a side, including its first corner."""
    n = max(1, round(length / style.bay))
    step = length / n
    a = max(0.5 * step * (1.0 - style.share), min(0.5, 0.3 * step))
    if style.relief:
        offsets, inset, pane = [a, a + _REVEAL, step - a - _REVEAL, step - a], [0, 1, 1, 0], [0, 1, 0, 0]
    else:
        offsets, inset, pane = [a, step - a], [0, 0], [1, 0]
    along = (np.arange(n)[:, None] * step + offsets).ravel()
    return Lines(
        np.append(0.0, along) - length / 2, np.append(0, np.tile(inset, n)), np.append(0, np.tile(pane, n)) > 0
    )


def _rises(floors: int, style: Style) -> tuple[Lines, NDArray[np.float64]]:
    """(horizontal lines from below the ground to the roof, outward offset of the wall at each)."""
    sill, head, d = 0.8, FLOOR - 0.6, style.ledge
    if style.relief:
        y, inset, pane = [sill, sill + _REVEAL, head - _REVEAL, head], [0, 1, 1, 0], [0, 1, 0, 0]
    else:
        y, inset, pane = [sill, head], [0, 0], [1, 0]
    out = [0.0] * len(y)
    if d > 0.0:
        y, inset, pane, out = (
            [*y, FLOOR - 0.35, FLOOR - 0.3, FLOOR - 0.05],
            [*inset, 0, 0, 0],
            [*pane, 0, 0, 0],
            [*out, 0, d, d],
        )
    top = floors * FLOOR
    heights = (np.arange(floors)[:, None] * FLOOR + y).ravel()
    heights = np.concatenate([[-0.2], heights, top + style.parapet * np.array([0.0, 0.12, 0.9, 0.95, 0.2])])
    insets, panes, offsets = (np.concatenate([[0], np.tile(a, floors), [0] * 5]) for a in (inset, pane, out))
    offsets[-5:] = 0.3, 0.35, 0.1, -0.25, -0.3
    return Lines(heights, insets, panes > 0), offsets


def tower(
    width: float,
    depth: float,
    floors: int,
    style: Style,
    rng: np.random.Generator,
    base: float = 0.0,
) -> PaletteMesh:
    """A rectangular building with windows all around, ledges, and a parapet around a flat roof."""
    x, z = _side(width, style), _side(depth, style)
    hx, hz = width / 2, depth / 2
    sides = [
        np.stack([0 * z.at + hx, -z.at], axis=1),
        np.stack([-x.at, 0 * x.at - hz], axis=1),
        np.stack([0 * z.at - hx, z.at], axis=1),
        np.stack([x.at, 0 * x.at + hz], axis=1),
    ]
    sizes = [len(s) for s in sides]
    normal = np.repeat([(1.0, 0.0), (0.0, -1.0), (-1.0, 0.0), (0.0, 1.0)], sizes, axis=0)
    corner = np.cumsum([0, *sizes[:-1]])
    normal[corner] = [(1, 1), (1, -1), (-1, -1), (-1, 1)]
    rise, out = _rises(floors, style)
    inset = np.concatenate([z.inset, x.inset] * 2)
    shift = out[:, None] - _RECESS * rise.inset[:, None] * inset
    points = np.empty((len(rise.at), len(normal), 3))
    points[..., ::2] = np.concatenate(sides) + normal * shift[..., None]
    points[..., 1] = (rise.at + base)[:, None]
    window = rise.pane[:-1, None] & np.concatenate([z.pane, x.pane] * 2)
    glass = style.glass + p.shades(rng, window.size).reshape(window.shape)
    glass = np.where(rng.random(window.shape) < 0.06, p.YELLOW, glass)
    k = len(normal)
    colour = np.concatenate(
        [np.where(window, glass, style.wall).ravel(), np.full(k, style.wall), np.full(k, style.roof)]
    )
    return capped(points, (0, points[0, 0, 1], 0), (0, points[-1, 0, 1], 0), colour)


def round_tower(
    radius: float, floors: int, segments: int, rng: np.random.Generator, glass: int = p.GLASS
) -> PaletteMesh:
    """A round tower with a ledge at every floor and a flat conical roof."""
    y = (np.arange(floors)[:, None] * FLOOR + [0.3, FLOOR - 0.5, FLOOR - 0.45, FLOOR - 0.02]).ravel()
    r = radius + np.tile([0.0, 0.0, 0.45, 0.45], floors)
    top = floors * FLOOR
    profile = np.concatenate(
        [
            [(radius, -0.2)],
            np.stack([r, y], axis=1),
            [(0.7 * radius, top + 1.0), (0.7 * radius, top + 2.2), (0.0, top + 3.0)],
        ]
    )
    mesh = revolve(profile, segments, p.CONCRETE)
    cells = len(y) + 3
    pane = np.zeros((cells, segments, 2), bool)
    pane[1 : 4 * floors : 4] = (np.arange(segments) % 3 != 0)[:, None]
    shade = np.repeat(p.shades(rng, cells * segments), 2)
    mesh.colour[: pane.size] = np.where(pane.ravel()[: len(mesh.colour)], glass + shade, p.CONCRETE)[: pane.size]
    return mesh


def house(
    width: float, depth: float, floors: int, style: Style, rng: np.random.Generator, roof: int = p.TERRACOTTA
) -> PaletteMesh:
    """A house with a gabled roof along x, eaves, and a chimney."""
    body = tower(width, depth, floors, style._replace(parapet=0.3), rng)
    top, rise = floors * FLOOR + 0.45, 0.42 * depth
    y = np.array([[-depth / 2 - 0.6, -0.3], [0.0, rise], [depth / 2 + 0.6, -0.3]])
    half = (width + 1.0) / 2
    under = y - [0.0, 0.22]
    sections = np.stack(
        [
            np.stack([0 * y[:, 0] + x, line[:, 1] + top, line[:, 0]], axis=1)
            for line in (y, under)
            for x in (-half, half)
        ]
    )
    upper, lower = sections[:2], sections[2:]
    gable = prism(
        [(-depth / 2, top - 0.4), (0, top - 0.4), (depth / 2, top - 0.4)],
        [(-depth / 2, top - 0.3), (0, top + rise - 0.3), (depth / 2, top - 0.3)],
        width - 0.3,
        style.wall,
    )
    gable = gable._replace(vertices=gable.vertices[:, [2, 1, 0]] * np.array([1, 1, -1], np.float32))
    stack = box((0.8, 2.2, 0.8), (0.28 * width, top + rise * 0.6 + 0.6, 0.2 * depth), p.BRICK)
    return merge(body, shell(upper, lower, roof), gable, stack)


def car(colour: int, detail: float) -> PaletteMesh:
    """A car along +x, 4.3 m long."""
    n = steps(2, detail)
    lower = [(-2.1, 0.35), (-1.6, 0.22), (0.0, 0.22), (1.6, 0.22), (2.15, 0.35)]
    upper = [(-2.12, 0.72), (-1.7, 0.93), (0.0, 0.95), (1.1, 0.9), (2.18, 0.68)]
    cabin = (
        [(-1.75, 0.9), (-1.2, 0.9), (0.2, 0.9), (1.15, 0.86)],
        [(-1.72, 0.95), (-1.15, 1.4), (0.15, 1.44), (1.1, 0.92)],
    )
    meshes = [
        prism(lower, upper, 1.75, colour),
        prism(*cabin, 1.45, p.GLASS),
        box((1.25, 0.05, 1.4), (-0.5, 1.44, 0), colour),
    ]
    rim = revolve([(0.33, -0.1), (0.33, 0.1)], 6 + 2 * n, p.IRON)
    wheel = rim.vertices[:, [0, 2, 1]] * np.array([1, 1, -1], np.float32)
    meshes += [
        rim._replace(vertices=wheel + np.array([x, 0.32, z], np.float32)) for x in (-1.35, 1.4) for z in (-0.8, 0.8)
    ]
    return merge(*meshes)


def lamp(detail: float) -> PaletteMesh:
    """A street lamp with its arm along +x."""
    bend = arc((0.9, 5.2), 0.9, 180, 90, steps(3, detail))
    path = np.concatenate([[(0.0, -0.1), (0.0, 2.5)], bend, [(1.5, 6.1)]])
    pole = tubes(
        np.insert(path, 2, 0.0, axis=1)[None], np.linspace(0.09, 0.045, len(path)), steps(5, detail, 3), p.IRON
    )
    return merge(pole, box((0.7, 0.12, 0.28), (1.7, 6.06, 0), p.IRON))


def tank(detail: float) -> PaletteMesh:
    """A rooftop water tank on legs."""
    k = steps(10, detail, 6)
    drum = revolve([(1.25, 1.5), (1.3, 3.6), (1.4, 3.65), (0.0, 4.6)], k, p.OAK)
    legs = boxes((0.16, 1.8, 0.16), [(x, 0.75, z) for x in (-0.8, 0.8) for z in (-0.8, 0.8)], p.IRON)
    return merge(drum, legs)


def cooler() -> PaletteMesh:
    """A rooftop air conditioner."""
    return merge(box((1.6, 1.3, 1.1), (0, 0.6, 0), p.CONCRETE + 3), box((1.0, 0.3, 0.8), (0.1, 1.35, 0), p.IRON))


def antenna() -> PaletteMesh:
    """A rooftop mast with cross bars."""
    bars = boxes(
        [(0.12, 8.2, 0.12), (1.8, 0.08, 0.08), (0.08, 0.08, 1.4)], [(0, 3.9, 0), (0, 6.6, 0), (0, 5.6, 0)], p.IRON
    )
    return merge(bars, box((1.2, 0.6, 1.2), (0, 0.12, 0), p.CONCRETE))


def billboard() -> PaletteMesh:
    """A rooftop billboard on two posts."""
    posts = boxes((0.2, 2.6, 0.2), [(-2.2, 1.1, 0), (2.2, 1.1, 0)], p.IRON)
    return merge(posts, box((6.0, 3.0, 0.25), (0, 3.2, 0), p.OCHRE))


# --- Blocks -----------------------------------------------------------------------------------------------------------


PITCH, STREET = 70.0, 15.0  # metres between blocks; width of the streets
KERB = 0.16
FULL_BLOCK = 20_000  # triangles; larger budgets add blocks
GROUP = 64  # blocks that share a budget: unused triangles of a block go to later blocks
_WALLS = (p.BRICK, p.SANDSTONE, p.PLASTER, p.TERRACOTTA, p.LIMESTONE, p.CONCRETE)
_PAINTS = (p.RED, p.BLUE, p.WHITE, p.IRON, p.OCHRE, p.TEAL)


class _Plan(NamedTuple):
    """Data shared by all blocks."""

    n: int  # blocks along each side
    budget: int  # triangles for each block
    detail: float  # of props and plants, at most 1
    props: list[PaletteMesh]  # cars, then lamp, tank, cooler, antenna, billboard
    trees: list[BareTree]


@lru_cache(maxsize=2)
def _plan(triangles: int) -> _Plan:
    n = max(2, round(np.sqrt(triangles / FULL_BLOCK)))
    budget = triangles // (n * n)
    detail = min(1.0, np.sqrt(budget / FULL_BLOCK))
    props = [car(c, detail) for c in _PAINTS] + [lamp(detail), tank(detail), cooler(), antenna(), billboard()]
    trees = [bare_tree(np.random.default_rng(k), 7.5, 0.3 * detail) for k in range(2)]
    return _Plan(n, budget, detail, props, trees)


def city_view(triangles: int) -> tuple[dict[str, Any], dict[str, Any]]:
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
    size = 0.14 * length(middle)
    u, v = (size * a / length(a) for a in (u, v))
    return camera, {"corner": tuple(middle - (u + v) / 2.0), "u": tuple(u), "v": tuple(v)}


def city_blocks(triangles: int, seed: int = 0) -> Iterator[tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """The pieces of a city with about `triangles` triangles, block by block.

    Yields
    ------
    vertices : (v, 3) float32, metres, world
    faces : (f, 3) int32
        Indices into the vertices of this piece.
    colour : (f,) uint8
        Indices into `palette.PALETTE`.

    Raises
    ------
    InputError
        On a number of triangles or a seed out of range.

    Notes
    -----
    Only one block is in memory at a time. `city_view` gives the camera and the light.
    """
    return _pieces(*check_request("city", triangles, seed))


def city_groups(triangles: int, seed: int, first: int = 0, step: int = 1) -> Iterator[Iterator[PaletteMesh]]:
    """The pieces of every `step`-th group of blocks, from group `first` on.

    Groups are independent, so several processes can generate a city. The arguments must have been checked.
    """
    plan = _plan(triangles)
    for k in range(first * GROUP, plan.n**2, step * GROUP):
        yield _group(plan, triangles, seed, range(k, min(k + GROUP, plan.n**2)))


def n_groups(triangles: int) -> int:
    """The number of groups of blocks of a city."""
    return -(-(_plan(triangles).n ** 2) // GROUP)


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


def city(triangles: int, seed: int) -> tuple[PaletteMesh, dict[str, Any], dict[str, Any]]:
    """Mesh, camera and light of the city with about `triangles` triangles."""
    return merge(*_pieces(triangles, seed)), *city_view(triangles)


def _block(plan: _Plan, i: int, j: int, budget: int, rng: np.random.Generator) -> PaletteMesh:
    """A block at its position, with the streets on two of its sides, with about `budget` triangles."""
    middle = (np.array([i, j]) - (plan.n - 1) / 2.0) * PITCH
    central = exp(-((length(middle) / (0.45 * plan.n * PITCH)) ** 2))
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
    """Asphalt, the pavement with its kerb, and road markings."""
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
    return [place_copies(road), place_copies(pavement)] + ([place_copies(lines)] if plan.detail > 0.4 else [])


def _street(plan: _Plan, rng: np.random.Generator) -> list[ScenePart]:
    """Cars along the streets and lamps on the pavement."""
    q = (PITCH - STREET) / 2
    n = round(7 * plan.detail)
    if n == 0:
        return []
    along = (np.arange(n) + 0.5) / n * (PITCH - STREET - 8.0) - (PITCH - STREET) / 2 + 4.0
    lanes = [(q + 1.3, 0.0), (q + 5.2, np.pi), (q + STREET - 1.3, np.pi)]
    lane_spots, lane_turns = [], []
    for lane, turn in lanes:
        for across in (0, 1):
            positions = along[rng.random(n) < 0.55] + rng.uniform(-0.8, 0.8)
            lane_positions = np.full(len(positions), lane if lane < PITCH / 2 else lane - PITCH)
            lane_spots.append(
                np.stack(
                    [positions, 0 * positions, lane_positions]
                    if across == 0
                    else [lane_positions, 0 * positions, positions],
                    axis=1,
                )
            )
            lane_turns.append(np.full(len(positions), turn + across * np.pi / 2))
    spots, turns = np.concatenate(lane_spots), np.concatenate(lane_turns)
    paint = rng.integers(0, len(_PAINTS), len(spots))
    parts = [
        place_copies(
            plan.props[c], spots[paint == c], turns[paint == c], shade=p.shades(rng, int(np.sum(paint == c))) % 4
        )
        for c in range(len(_PAINTS))
    ]
    if plan.detail > 0.4:
        poles = [(-14, q - 0.6, -np.pi / 2), (14, q - 0.6, -np.pi / 2), (q - 0.6, -14, 0.0), (q - 0.6, 14, 0.0)]
        x, z, turn = np.array(poles).T
        parts.append(place_copies(plan.props[6], np.stack([x, 0 * x + KERB, z], axis=1), turn))
    return [part for part in parts if len(part.offset)]


def _lots(
    rng: np.random.Generator, x0: float, x1: float, z0: float, z1: float, least: float
) -> list[tuple[float, float, float, float]]:
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


def _buildings(plan: _Plan, rng: np.random.Generator, central: float, budget: float) -> list[ScenePart]:
    q = (PITCH - STREET) / 2 - 4.0
    lots = _lots(rng, -q, q, -q, q, max(10.0 + 3.0 * central, 2.0 * q / np.sqrt(max(budget, 400.0) / 400.0)))
    parts, roofs = [], []
    for x0, x1, z0, z1 in lots:
        w, d = x1 - x0 - rng.uniform(0.8, 2.5), z1 - z0 - rng.uniform(0.8, 2.5)
        mesh, spots = _building(rng, w, d, central, budget / len(lots))
        at = np.array([(x0 + x1) / 2, KERB, (z0 + z1) / 2])
        parts.append(place_copies(mesh, at))
        roofs += [np.asarray(s) + at for s in spots]
    return parts + (_roof_things(plan, rng, np.array(roofs).reshape(-1, 3)) if plan.detail > 0.3 else [])


def _building(
    rng: np.random.Generator, w: float, d: float, central: float, budget: float
) -> tuple[PaletteMesh, Iterable[ArrayLike]]:
    """(mesh of a building on a lot of w x d metres, free positions on its roof)."""
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
        return _stepped_tower(rng, w, d, floors, budget, wall)
    ledge = 0.25 if floors < 8 and rng.random() < 0.6 else 0.0
    share = 0.5 if floors < 9 else 0.8
    style = _affordable(budget, w, d, floors, Style(3.2, share, True, wall, glass, ledge))
    top = floors * FLOOR + 0.2
    spots = rng.uniform(-0.34, 0.34, (3, 2)) * [w, d]
    roof = (p.CONCRETE, p.SLATE, p.TERRACOTTA, p.TRAVERTINE)[rng.integers(4)]
    return tower(w, d, floors, style._replace(roof=roof), rng), np.insert(spots, 1, top, axis=1)


def _affordable(budget: float, w: float, d: float, floors: int, style: Style) -> Style:
    """`style`, with flat windows or wider bays if needed to stay within `budget`."""
    for relief in (True, False):
        for bay in (style.bay, 1.3 * style.bay):
            choice = style._replace(relief=relief, bay=bay)
            if tower_cost(w, d, floors, choice) <= budget:
                return choice
    choice = choice._replace(ledge=0.0)
    while choice.bay < max(w, d) and tower_cost(w, d, floors, choice) > budget:
        choice = choice._replace(bay=1.4 * choice.bay)
    return choice


def _stepped_tower(
    rng: np.random.Generator, w: float, d: float, floors: int, budget: float, wall: int
) -> tuple[PaletteMesh, NDArray[np.float64]]:
    """(mesh of a tower with three tiers, a position on its roof)."""
    meshes, base = [], 0.0
    tiers = np.maximum(1, np.round(floors * np.array([0.45, 0.33, 0.22])).astype(int))
    for n, size in zip(tiers, (1.0, 0.76, 0.5)):
        style = _affordable(budget * n / floors, size * w, size * d, int(n), Style(2.8, 0.7, True, wall, p.GLASS, 0.0))
        meshes.append(tower(size * w, size * d, int(n), style, rng, base))
        base += n * FLOOR + 0.2
    return merge(*meshes), np.array([[0.0, base, 0.0]])


def _roof_things(plan: _Plan, rng: np.random.Generator, spots: np.ndarray) -> list[ScenePart]:
    kind = rng.choice(4, len(spots), p=[0.25, 0.5, 0.15, 0.1])
    turn = rng.integers(0, 4, len(spots)) * np.pi / 2
    pairs = [(plan.props[7 + k], kind == k) for k in range(4)]
    return [place_copies(mesh, spots[chosen], turn[chosen]) for mesh, chosen in pairs if chosen.any()]


def _park(plan: _Plan, rng: np.random.Generator) -> list[ScenePart]:
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
    hedges = place_copies(bush(rng, 0.8, 0.25 * plan.detail), at, scale=rng.uniform(0.6, 1.2, k))
    return [place_copies(lawn), place_copies(paths), place_copies(rim), place_copies(water), place_copies(jet), hedges]


def _trees(plan: _Plan, rng: np.random.Generator, spots: np.ndarray, budget: int) -> list[ScenePart]:
    """Trees, whose leaves use up the block's budget."""
    bare = len(plan.trees[0].wood.faces)
    n = int(np.clip(budget / (bare + 4 * 40), 0, len(spots)))
    parts: list[ScenePart] = []
    for k, colour in enumerate((p.LEAF, p.PINE) if n > 3 else (p.LEAF,) if n else ()):
        at = np.insert(spots[k : n : 2 if n > 3 else 1], 1, KERB, axis=1)
        share = budget / n if k == 0 and n > 3 else (budget - count(parts)) / len(at)
        leaves = max(8, int(share - bare) // 4)
        mesh = tree(rng, plan.trees[k], leaves, float(np.clip(12.0 / np.sqrt(leaves), 0.12, 1.6)), colour)
        parts.append(place_copies(mesh, at, rng.uniform(0, 6.3, len(at)), rng.uniform(0.85, 1.3, len(at))))
    return parts


# --- Streaming from worker processes ----------------------------------------------------------------------------------
#
# Workers take groups of blocks in turn and send each block through a pipe. They are started by module name: unlike fork
# or spawn, this does not interfere with the threads or the main module of this process.


_PACKAGE = Path(__file__).parents[2]
_MOST = 1 << 28  # vertices or faces of a block: more are not sizes


def stream_blocks(triangles: int, seed: int, processes: int, first: int = 0) -> Generator[PaletteMesh, None, None]:
    """The blocks of `city_groups` from group `first` on, generated by `processes` processes.

    The arguments must have been checked.
    """
    workers = [start_worker(triangles, seed, first + k, processes) for k in range(processes)]
    try:
        for worker in cycle(workers):
            blocks = 0
            while blocks < GROUP and (block := _receive(worker.stdout)) is not None:
                yield block
                blocks += 1
            if blocks < GROUP:  # the last group
                break
        if worker.wait() != 0:
            raise RuntimeError("a worker process of the city generator has failed")
    finally:
        for worker in workers:
            worker.kill()
            if worker.stdout is not None:
                worker.stdout.close()
            worker.wait()


def start_worker(triangles: int, seed: int, first: int, step: int) -> subprocess.Popen[bytes]:
    """Start a process that generates every `step`-th group. Ctrl-C reaches only its parent, which terminates it."""
    paths = [str(_PACKAGE), *os.environ.get("PYTHONPATH", "").split(os.pathsep)]
    env = {**os.environ, "PYTHONPATH": os.pathsep.join(p for p in paths if p), "OPENBLAS_NUM_THREADS": "1"}
    command = [sys.executable, "-m", __name__, *map(str, (triangles, seed, first, step))]
    return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, env=env, start_new_session=True)


def _receive(pipe: Any) -> PaletteMesh | None:
    """The next block from a pipe, preceded by its numbers of vertices and faces; None at the end."""
    sizes = np.zeros(2, np.int64)
    if (read := pipe.readinto(sizes.view(np.uint8).data)) == 0:
        return None
    if read == sizes.nbytes and 0 <= sizes.min() <= sizes.max() < _MOST:
        v, f = sizes
        block = PaletteMesh(np.empty((v, 3), np.float32), np.empty((f, 3), np.int32), np.empty(f, np.uint8))
        if all(pipe.readinto(array.reshape(-1).view(np.uint8).data) == array.nbytes for array in block):
            return block
    raise RuntimeError("a worker process of the city generator has ended too early")


def _send(pipe: int, triangles: int, seed: int, first: int, step: int) -> None:
    """In a worker: write the blocks of its groups to a pipe. A group is complete before it is sent.

    Python's buffered files lose bytes if a stopped process goes on in the middle of a write.
    """
    for group in city_groups(triangles, seed, first, step):
        for block in list(group):
            sizes = np.array([len(block.vertices), len(block.faces)], np.int64)
            for array in (sizes, *block):
                left = np.ascontiguousarray(array).reshape(-1).view(np.uint8).data
                while left:
                    left = left[os.write(pipe, left) :]


if __name__ == "__main__":
    with suppress(BrokenPipeError):  # the parent has gone
        _send(sys.stdout.fileno(), *map(int, sys.argv[1:]))
