"""Rooms whose faces exist twice, once per side, as many exporters write them."""

from typing import NamedTuple

import numpy as np

SIZE = np.array([4.0, 3.0, 2.5])
OUTSIDE = -1
FLOOR, CEILING = 0, 1
_QUADS = [[0, 1, 2, 3], [7, 6, 5, 4], [0, 4, 5, 1], [1, 5, 6, 2], [2, 6, 7, 3], [3, 7, 4, 0]]  # seen from inside
TURNS = 0.0, 90.0, 27.3
ORDERS = "inner first", "outer first", "side by side", "shuffled"


class Room(NamedTuple):
    vertices: np.ndarray  # (8, 3)
    faces: np.ndarray  # (n, 3)
    walls: np.ndarray  # (n,): 0 to 5, as seen from inside; OUTSIDE: of the outer copy

    @property
    def corners(self):
        return self.vertices[self.faces]


def corners_of_room(turn):
    """The eight corners, turned about the up axis z; upper ones are exactly above lower ones."""
    x, y, z = (np.arange(8)[:, None] & np.array([1, 2, 4]) > 0).T
    unit = np.stack([x ^ y, y, z], 1).astype(float) * SIZE
    if turn == 90.0:
        return unit @ np.array([[0.0, 1, 0], [-1, 0, 0], [0, 0, 1]])
    c, s = np.cos(np.radians(turn)), np.sin(np.radians(turn))
    return unit @ np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]])


def _triangles(quads, rng):
    """Each quad as two triangles, by a random diagonal and with random first corners."""
    split = [np.roll(quad, rng.integers(4))[[[0, 1, 2], [0, 2, 3]]] for quad in quads]
    return np.array([np.roll(triangle, rng.integers(3)) for pair in split for triangle in pair])


def single_room(turn=0.0, seed=0):
    """A room with inner faces only."""
    quads = np.array(_QUADS)
    return Room(corners_of_room(turn), _triangles(quads, np.random.default_rng(seed)), np.repeat(np.arange(6), 2))


def double_room(order, turn=0.0, seed=0):
    """The inner faces of `single_room`, and an outer copy with diagonals of its own, in one of `ORDERS`."""
    vertices, inner, walls = single_room(turn, seed)
    rng = np.random.default_rng(seed + 1)
    outer = _triangles(np.array(_QUADS)[:, ::-1], rng)
    faces, walls = np.concatenate([inner, outer]), np.concatenate([walls, np.full(12, OUTSIDE)])
    places = {
        "inner first": np.arange(24),
        "outer first": np.roll(np.arange(24), 12),
        "side by side": np.arange(24).reshape(2, 12)[::-1].T.ravel(),
        "shuffled": rng.permutation(24),
    }[order]
    return Room(vertices, faces[places], walls[places])


def parallel_rectangles(a, b, distance):
    """The form factor between two equal, opposite rectangles of sides a and b."""
    x, y = a / distance, b / distance
    p, q = np.sqrt(1 + x * x), np.sqrt(1 + y * y)
    sides = x * q * np.arctan(x / q) + y * p * np.arctan(y / p) - x * np.arctan(x) - y * np.arctan(y)
    return 2 / (np.pi * x * y) * (np.log(p * q / np.sqrt(1 + x * x + y * y)) + sides)


def rays_inside(room, n, seed=0):
    """(origins, directions) of n rays from points of the room; some meet edges and corners."""
    rng = np.random.default_rng(seed)
    lower, upper = room.vertices.min(0), room.vertices.max(0)
    middle = room.vertices.mean(0)
    origins = middle + rng.uniform(-0.2, 0.2, (n, 3)) * (upper - lower)
    directions = rng.normal(size=(n, 3))
    directions[: n // 8] = room.vertices[rng.integers(0, 8, n // 8)] - origins[: n // 8]
    return origins.astype(np.float32), directions.astype(np.float32)
