"""Triangle soups that are hard for BVH builders, by name."""

import numpy as np

from antumbra.bvh.nodes import Bvh, aligned_empty

LARGE = 20_000  # triangles, enough for all threads to work on one range together


def terrain(n, seed=0):
    """About n triangles of a bumpy surface, with some long thin triangles across it."""
    rng = np.random.default_rng(seed)
    side = max(1, round((n / 2) ** 0.5))
    x, y = np.meshgrid(np.linspace(0, 10, side + 1), np.linspace(0, 10, side + 1))
    p = np.stack([x, y, np.sin(x * 2) * np.cos(y) + rng.normal(0, 0.02, x.shape)], -1)
    a, b, c, d = p[:-1, :-1], p[:-1, 1:], p[1:, :-1], p[1:, 1:]
    ground = np.concatenate([np.stack([a, b, d], 2).reshape(-1, 3, 3), np.stack([a, d, c], 2).reshape(-1, 3, 3)])
    sticks = rng.random((max(1, n // 50), 1, 3)) * [10, 10, 2] + rng.normal(0, 1, (max(1, n // 50), 3, 3)) * [1, 1, 0.1]
    return np.concatenate([ground, sticks]).astype(np.float32)


def scattered(n, seed=0):
    rng = np.random.default_rng(seed)
    return (rng.normal(size=(n, 1, 3)) + rng.normal(scale=0.05, size=(n, 3, 3))).astype(np.float32)


def integer_grid(n):
    k = np.arange(n)
    corner = np.stack([k % 8, k // 8 % 8, k // 64], -1)
    return (corner[:, None] + np.eye(3)).astype(np.float32)


def receding(n):
    """Each triangle has half the size and half the distance of the last. The cheapest splits have a small side."""
    scale = 2.0 ** -np.arange(n)
    return (scale[:, None, None] * (1 + np.eye(3))).astype(np.float32)


def nested_clusters(depth=60, at_each=40):
    """Clusters around a point, at 4, 4 ** -1, 4 ** -2, ... The depth of a greedy tree grows with their number."""
    cloud = scattered(at_each)
    return np.concatenate([cloud * np.float32(4.0**-k) for k in range(depth)]) + np.float32(0)


def chain(n):
    """A tree whose depth alone is wrong: each node has one triangle on the left and all others on the right."""
    vertices = scattered(n)
    nodes = aligned_empty((n - 1, 16), "f4")
    nodes[:] = 0
    links = nodes.view(np.int32)
    for node in range(n - 1):
        last = node == n - 2
        for side, range_ in ((0, slice(node, node + 1)), (1, slice(node + 1, n))):
            nodes[node, [side, 4 + side, 8 + side]] = vertices[range_].min((0, 1))
            nodes[node, [2 + side, 6 + side, 10 + side]] = vertices[range_].max((0, 1))
            links[node, 12 + side] = ~((node + side) * 8) if side == 0 or last else node + 1
    return Bvh(nodes, links, np.arange(n, dtype=np.int32), vertices.reshape(n, 9).copy()), vertices


HAZARDS = {
    "none": np.zeros((0, 3, 3)),
    "one": scattered(1),
    "two": scattered(2),
    "three": scattered(3),
    "one point": np.full((37, 3, 3), 2.5),
    "two, identical": np.tile(scattered(1), (2, 1, 1)),
    "all identical": np.tile(scattered(1), (5001, 1, 1)),
    "many copies of a few": np.tile(scattered(7), (800, 1, 1)),
    "one centroid, many sizes": scattered(1)[0, :1] + np.linspace(0.1, 5, 300)[:, None, None] * (np.eye(3) - 1 / 3),
    "on a line": np.linspace(0, 1, 900).reshape(-1, 3, 1) * [1.0, 0, 0],
    "in a plane": scattered(500) * [1, 1, 0],
    "zero area": np.repeat(scattered(400)[:, :1], 3, axis=1),
    "integer grid": integer_grid(2000),
    "huge": scattered(500) * 1e30,
    "tiny": scattered(500) * 1e-30,
    "denormal": scattered(500) * 1e-42,
    "largest allowed": scattered(500) / np.abs(scattered(500)).max() * 4.2e37,
    "huge and tiny": np.concatenate([scattered(300) * 1e30, scattered(300) * 1e-30]),
    "far from the origin": scattered(500) + [5e6, -3e6, 1e5],
    "receding": receding(140),
    "nested clusters": nested_clusters(),
    "one very large among many": np.concatenate([scattered(600), scattered(1) * 1e6]),
    "large, scattered": scattered(LARGE),
    "large, terrain": terrain(LARGE),
    "large, identical": np.tile(scattered(1), (LARGE, 1, 1)),
    "large, one dense spot": np.concatenate([scattered(LARGE) * 1e-6, scattered(500) * 100]),
}
