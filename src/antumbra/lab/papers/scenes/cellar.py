"""Vaulted cellars on several levels: a maze of rooms with very little visible from any point."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from ....generate import palette as p
from ....generate.atrium import EMBED, column, doorway, stairs, tiles, vault, voussoirs
from ....generate.props import barrel, bottle, crate, shelf, vase
from ....generate.shapes import (
    PaletteMesh,
    ScenePart,
    assemble,
    box,
    boxes,
    count,
    fitted,
    merge,
    place_copies,
    shell,
    steps,
)

ROOM, WALL, HEIGHT = 6.0, 0.5, 3.5  # metres from room to room; thickness and height of the walls
LEVEL = 4.2  # metres from floor to floor
CROWN = 3.2  # height of the vaults' crowns
DOOR, DOOR_SPRING = 0.75, 1.95  # half the width of a doorway, and the height of its springing line
FULL_ROOM = 9_000  # triangles per room; a larger budget adds rooms


class _Maze(NamedTuple):
    """Rooms on a grid of levels x nx x nz, and the openings between them."""

    rooms: np.ndarray  # (n, 3) int: level, i, j
    east: np.ndarray  # (n,) bool: a doorway leads to room (level, i + 1, j)
    south: np.ndarray  # (n,) bool: a doorway leads to room (level, i, j + 1)
    stairs: np.ndarray  # (n,) bool: stairs lead up from the room
    shape: tuple[int, int, int]  # levels, nx, nz

    def centres(self) -> np.ndarray:
        """(n, 3) float: the floors' centres; each level is centred at x = z = 0."""
        _, nx, nz = self.shape
        level, i, j = self.rooms.T
        return np.stack(
            [(i - (nx - 1) / 2) * ROOM, (level - self.shape[0] // 2) * LEVEL, (j - (nz - 1) / 2) * ROOM], axis=1
        )


def _maze(n: int, rng: np.random.Generator) -> _Maze:
    """A random maze: a spanning tree on every level (each room opens east or south), and stairs between levels."""
    levels = 1 if n < 8 else 2 if n < 24 else 3 if n < 200 else 5
    nx = max(2, round(np.sqrt(n / levels)))
    nz = max(2, round(n / levels / nx))
    level, i, j = (a.ravel() for a in np.indices((levels, nx, nz)))
    east = rng.random(len(i)) < 0.5
    east = np.where(i == nx - 1, False, east | (j == nz - 1))
    south = np.where(j == nz - 1, False, ~east | (rng.random(len(i)) < 0.12))
    here = (level == levels // 2) & (i == (nx - 1) // 2)
    east |= here & (j == nz // 2)  # doorways in the camera's view
    south |= here & (j == nz // 2 - 1)
    up = (level < levels - 1) & (rng.random(len(i)) < 0.09) & ~((i == (nx - 1) // 2) & (j == nz // 2))
    grid = up.reshape(levels, nx, nz)
    grid[1:] &= ~grid[:-1]  # no stairs directly above stairs
    return _Maze(np.stack([level, i, j], axis=1), east, south, grid.ravel(), (levels, nx, nz))


def cellar(triangles: int, seed: int) -> tuple[PaletteMesh, dict[str, Any], dict[str, Any]]:
    """Mesh, camera and light of the cellar, with about `triangles` triangles."""
    maze = _maze(max(4, round(triangles / FULL_ROOM)), np.random.default_rng([seed, 0]))
    each = triangles / len(maze.rooms) / FULL_ROOM
    parts = fitted(lambda d: _structure(maze, d, np.random.default_rng([seed, 1])), round(0.5 * triangles), each**0.5)
    parts += _furniture(maze, each**0.5, triangles - count(parts), [seed, 2])
    level, nx, nz = maze.shape
    here = maze.centres()[(level // 2 * nx + (nx - 1) // 2) * nz + nz // 2]
    camera = {
        "position": tuple(here + [-1.9, 1.6, 2.4]),
        "target": tuple(here + [1.4, 1.2, -0.55]),
        "up": (0.0, 1.0, 0.0),
        "vfov": 66.0,
    }
    light = {"corner": tuple(here + [-1.2, 1.2, -2.35]), "u": (-1.0, 0.0, 0.7), "v": (0.0, 1.1, 0.0)}
    return assemble(parts), camera, light


def _structure(maze: _Maze, d: float, rng: np.random.Generator) -> list[ScenePart]:
    """Floors, walls with and without doorways, piers, vaults, pillars, stairs."""
    at, (_, nx, nz), (_, i, j) = maze.centres(), maze.shape, maze.rooms.T
    hole = np.zeros(len(at), bool)  # rooms without a floor, where stairs come up
    hole[nx * nz :] = maze.stairs[: -nx * nz] if len(at) > nx * nz else False
    half = ROOM / 2
    n = steps(7, d, 2)
    floor = tiles((-half, half, n), (-half, half, n), rng, p.SLATE)
    closed = _wall(rng, d)
    open_, trim = (
        doorway(ROOM - 0.7, DOOR, DOOR_SPRING, HEIGHT, WALL, steps(10, d, 3)),
        voussoirs(DOOR, 0.2, WALL + 0.08, 9, 1, p.LIMESTONE),
    )
    parts = [place_copies(floor, at[~hole], rng.integers(0, 4, np.sum(~hole)) * np.pi / 2)]
    faces = (
        (np.ones(len(at), bool), maze.east, (half, 0.0), np.pi / 2),
        (np.ones(len(at), bool), maze.south, (0.0, half), 0.0),
        (i == 0, np.zeros(len(at), bool), (-half, 0.0), np.pi / 2),
        (j == 0, np.zeros(len(at), bool), (0.0, -half), 0.0),
    )
    for exists, door, (dx, dz), turn in faces:
        place = at + [dx, 0.0, dz]
        parts.append(place_copies(closed, place[exists & ~door], turn))
        parts.append(place_copies(open_, place[exists & door], turn))
        if d > 0.4:
            parts.append(place_copies(trim, place[exists & door] + [0.0, DOOR_SPRING, 0.0], turn))
    return parts + _supports(maze, d, at, hole, rng)


def _supports(maze: _Maze, d: float, at: np.ndarray, hole: np.ndarray, rng: np.random.Generator) -> list[ScenePart]:
    """Vaults, corner piers, central pillars in some rooms, and stairs."""
    _, i, j = maze.rooms.T
    half, above = ROOM / 2, ~maze.stairs
    pier = box((0.84, LEVEL - 0.06, 0.84), (0, (LEVEL - 0.06) / 2 - 2 * EMBED, 0), p.LIMESTONE)
    corners = [at + [half, 0, half], at[i == 0] + [-half, 0, half], at[j == 0] + [half, 0, -half]]
    corners.append(at[(i == 0) & (j == 0)] + [-half, 0, -half])
    roof = vault(half - WALL / 2 + 0.03, CROWN, LEVEL - 0.05, steps(8, d, 2), p.BRICK)
    pillar = column(2.95, 0.24, 10 if d > 0.3 else 6, round(2.2 * d), 0, p.LIMESTONE)
    round_ = merge(pillar, box((0.8, 0.45, 0.8), (0, 3.1, 0), p.LIMESTONE))
    special = _view_room(maze)
    middle = above & ~hole & ((rng.random(len(at)) < 0.3) | special)
    flight = stairs(20, 1.5, LEVEL / 20, 5.0 / 20, p.SLATE)
    steps_at = at[maze.stairs] + [-2.6, 0.0, -1.7]
    landing = boxes([(1.0, 0.2, 5.5), (4.6, 0.2, 0.9)], [(2.3, LEVEL - 0.13, 0), (-0.4, LEVEL - 0.13, 2.3)], p.OAK)
    return [
        place_copies(pier, np.concatenate(corners)),
        place_copies(roof, at[above]),
        place_copies(round_, at[middle]),
        place_copies(flight, steps_at),
        place_copies(landing, at[maze.stairs]),
    ]


def _view_room(maze: _Maze) -> np.ndarray:
    """(n,) bool: True for the camera's room."""
    levels, nx, nz = maze.shape
    here: np.ndarray = (maze.rooms == [levels // 2, (nx - 1) // 2, nz // 2]).all(axis=1)
    return here


def _wall(rng: np.random.Generator, d: float) -> PaletteMesh:
    """A closed wall between two piers along x, in courses of stone on both sides."""
    w, n, m = ROOM - 0.7, steps(6, d, 1), steps(7, d, 1)
    x = np.linspace(-w / 2, w / 2, 2 * n + 1)
    y = np.linspace(-EMBED, HEIGHT, m + 1)
    front = np.stack(np.broadcast_arrays(x[:, None], y, WALL / 2), axis=-1)
    i, j = np.indices((2 * n, m))
    stone = p.shades(rng, (n + 2) * m).reshape(n + 2, m)[(i + j % 2) // 2, j]
    return shell(front, front * [1, 1, -1], p.SANDSTONE + stone)


def _furniture(maze: _Maze, detail: float, triangles: int, seed: Sequence[int]) -> list[ScenePart]:
    """Objects along the walls, in most places and in as much detail as `triangles` allow.

    A small budget gives coarse objects in fewer places.
    """

    def build(d: float, share: float) -> list[ScenePart]:
        return _things(maze, d, share, np.random.default_rng(seed))

    coarse = min(detail, 0.45)
    if count(build(coarse, 0.85)) > triangles:
        return fitted(lambda root: build(coarse, min(root * root, 0.85)), triangles, 0.6)
    return fitted(lambda d: build(d, 0.85), triangles, detail)


def _things(maze: _Maze, d: float, share: float, rng: np.random.Generator) -> list[ScenePart]:
    """Barrels, crates, bottle racks and vases in a `share` of the places, clear of the doorways."""
    at = maze.centres()[~maze.stairs]
    view = _view_room(maze)[~maze.stairs]
    slots = np.array(
        [(x, z) for x in (-2.15, -1.35, 1.35, 2.15) for z in (-2.15, 2.15)]
        + [(x, z) for x in (-2.15, 2.15) for z in (-1.35, 1.35)]
    )
    spots = at[:, None] + np.insert(slots, 1, 0.0, axis=1)
    keep = rng.random(spots.shape[:2]) < share
    keep &= ~(view[:, None] & (slots[:, 0] < 0) & (np.abs(slots[:, 1]) > 1.0))  # places of the camera and the light
    spots = spots[keep] + rng.uniform(-0.03, 0.03, (np.sum(keep), 3)) * [1, 0, 1]
    face = np.broadcast_to(
        np.where(
            np.abs(slots[:, 1]) > 2.0,
            np.where(slots[:, 1] > 0, np.pi, 0.0),
            np.where(slots[:, 0] > 0, -np.pi / 2, np.pi / 2),
        ),
        keep.shape,
    )[keep]
    kinds = rng.choice(4, len(spots), p=[0.36, 0.26, 0.2, 0.18])
    things = [barrel(0.95, 0.36, d), crate((0.68, 0.66, 0.66), round(4 * d)), _rack(d), merge(*_vases(d))]
    parts = []
    for k, thing in enumerate(things):
        places = spots[kinds == k]
        turn = face[kinds == k] + (rng.uniform(-0.06, 0.06, len(places)) if k != 2 else 0.0)
        parts.append(place_copies(thing, places, turn, rng.uniform(0.92, 1.0, len(places))))
    heaped = spots[kinds == 1]
    heaped = heaped[rng.random(len(heaped)) < 0.5] + [0, 0.585, 0]
    parts.append(place_copies(things[1], heaped, rng.uniform(0, 6.3, len(heaped)), rng.uniform(0.6, 0.8, len(heaped))))
    return parts


def _rack(d: float) -> PaletteMesh:
    """A shelf with bottles."""
    boards, w, h = 4, 0.78, 1.9
    if d < 0.3:
        return shelf(w, h, 0.36, boards)
    y = (np.arange(boards) + 0.3) / boards * h
    x = np.linspace(-0.3, 0.3, steps(4, d**0.5, 2))
    places = np.stack([a.ravel() for a in np.meshgrid(x, y, [-0.05])], axis=1)
    glass = place_copies(bottle(0.3, 0.6 * d, p.TEAL), places, shade=np.arange(len(places)) % 5)
    return merge(shelf(w, h, 0.36, boards), assemble([glass]))


def _vases(d: float) -> list[PaletteMesh]:
    """Two vases side by side."""
    pair = vase(0.85, 0.8 * d), vase(0.6, 0.8 * d, p.CLAY, 0.36, 0.14)
    return [
        m._replace(vertices=m.vertices + np.asarray(shift, np.float32))
        for m, shift in zip(pair, ((-0.18, 0, 0.1), (0.26, 0, -0.1)))
    ]
