"""Rays that are hard to decide: through corners and edges, along planes, and many hits at the same t."""

from fractions import Fraction

import numpy as np

import antumbra as at
import oracle

N = 48  # rays


def _stack(rng):
    """Sheets across the rays: at random depths, twice at the same depth, apart by single bits, and nearly edge-on."""
    depth = rng.uniform(0.5, 3.0, 12)
    depth[6:8] = depth[5]
    depth[8] = np.nextafter(np.float32(depth[5]), np.float32(9))
    sheet = np.array([[-2.0, -2, 0], [6, -2, 0], [-2, 6, 0]])
    soup = sheet + rng.normal(0, 0.1, (12, 3, 3)) * (1, 1, 0) + depth[:, None, None] * (0, 0, 1)
    soup[9:] += rng.normal(0, 0.3, (3, 3, 3))
    steep = np.array([[-1.0, 0.1, 0], [1, 0.1, 0.3], [0, 0.12, 4]]) + rng.normal(0, 1e-3, (4, 1, 3))
    return (
        np.concatenate([soup, steep]),
        rng.normal(0, 0.1, (N, 3)) - (0, 0, 1),
        rng.normal(0, 0.02, (N, 3)) + (0, 0, 1),
    )


def _grid(rng):
    """Small whole numbers: rays through corners and along edges, t that float64 holds, triangles twice."""
    soup = rng.integers(-2, 3, (30, 3, 3)).astype(float)
    origins, ends = rng.integers(-3, 4, (N, 3)), rng.integers(-3, 4, (N, 3))
    directions = ends - origins
    directions[~directions.any(1)] = 1
    return np.concatenate([soup, soup[:6]]), origins, directions


def _slivers(rng):
    """Long triangles of hardly any width, each aimed at from afar and along its plane; and sheets behind them."""
    along = rng.normal(size=(40, 1, 3)) * 10 ** rng.uniform(-2, 1, (40, 1, 1))
    width = rng.normal(size=(40, 3, 3)) * 10 ** rng.uniform(-5, -2, (40, 1, 1))
    soup = rng.normal(0, 3, (40, 1, 3)) + along * rng.uniform(-1, 1, (40, 3, 1)) + width
    weights, pick = rng.dirichlet((1, 1, 1), N), rng.integers(0, 40, N)
    aims = np.einsum("nk,nkc->nc", weights, soup[pick])
    origins = rng.normal(size=(N, 3)) * 10 ** rng.uniform(0, 1.5, (N, 1))
    beside = np.einsum("nk,nkc->nc", rng.dirichlet((1, 1, 1), N), soup[pick])
    origins[::2] = (aims + (beside - aims) * 9 + rng.normal(0, 1e-3, (N, 3)))[::2]
    sheets = 30 * np.array([[0.5, 0, 0], [0, 0.5, 0], [0, 0, 0.5]]) * np.array([-1.0, -1.1, 1, 1.1])[:, None, None]
    return np.concatenate([soup, sheets]), origins, aims - np.float32(origins)


KINDS = {"stack": _stack, "grid": _grid, "slivers": _slivers}


def rays_of_kind(kind, coherent):
    """(scene, world origins, directions); not coherent: no tracer can make packets of neighbours."""
    soup, origins, directions = KINDS[kind](np.random.default_rng(7))
    scene = at.Scene.from_arrays(np.asarray(soup, np.float32))
    world = np.asarray(origins, np.float32).astype(np.float64)
    order = np.arange(N) if coherent else np.random.default_rng(8).permutation(N)
    return scene, world[order], np.ascontiguousarray(np.asarray(directions, np.float32)[order])


_EPSILON = Fraction(1, 1 << 500)


def displaced_meets(origin, direction, triangle):
    """Whether a really displaced line meets a triangle, in rational arithmetic."""
    o, d = oracle.rational(origin), oracle.rational(direction)
    d = [x + _EPSILON ** (k + 1) for k, x in enumerate(d)]
    o = [x + _EPSILON ** (k + 4) for k, x in enumerate(o)]
    a, b, c = (oracle.minus(oracle.rational(v), o) for v in triangle)
    edges = [oracle.dot(d, oracle.cross(p, q)) for p, q in ((b, c), (c, a), (a, b))]
    return all(e > 0 for e in edges) or all(e < 0 for e in edges)
