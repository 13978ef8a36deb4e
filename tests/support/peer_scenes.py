"""A soup, rays through it, and their correct answers."""

import numpy as np

import oracle
from peers.ray_contest import PeerRays

SHAPE = (6, 5, 18)  # not multiples of a packet's width


def soup(n: int = 60) -> np.ndarray:
    """(n, 3, 3) float32 triangles in the unit cube."""
    rng = np.random.default_rng(11)
    return (rng.random((n, 1, 3)) + rng.normal(0, 0.15, (n, 3, 3))).astype(np.float32)


def rays_through(tmax: float) -> PeerRays:
    """Rays from 30 origins. Three quarters of them are asked."""
    rng = np.random.default_rng(12)
    pixels, spp = SHAPE[0] * SHAPE[1], SHAPE[2]
    origins = rng.random((pixels, 3)).astype(np.float32)
    directions = (rng.random((pixels * spp, 3)) - np.repeat(origins, spp, 0)).astype(np.float32)
    return PeerRays(SHAPE, origins, spp, directions, tmax, rng.random(pixels * spp) < 0.75)


def truth(vertices, rays: PeerRays) -> np.ndarray:
    """(rays,) bool: whether each ray is blocked, by brute force; False for a ray that is not asked."""
    origins = np.repeat(rays.origins, rays.each, 0)
    blocked = oracle.occluded(vertices, origins, rays.directions, tmax=rays.tmax) & rays.active
    assert 0.1 < blocked[rays.active].mean() < 0.9
    return blocked
