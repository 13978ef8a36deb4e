"""Ray sets for peers: the rays of our queries, in orders that suit the peers."""

from typing import NamedTuple

import numpy as np

from ...query.receivers import NOTHING
from ...query.shadow_query import ShadowQuery, segments
from ...scene.camera import CameraRays

BLOCK = 4  # pixels along each side of a block; its 16 pixels make a packet
LANES = BLOCK * BLOCK
ORDERS = ("pixels", "samples")
"""The packets: one light sample of 4 x 4 pixels (8 lanes: 4 x 2, 4 lanes: 4 x 1), or 16 (8, 4) samples of one pixel."""


class RaySet(NamedTuple):
    """Rays of an (h, w) picture, spp for each pixel. The id of ray s of pixel (y, x) is (y * w + x) * spp + s."""

    shape: tuple[int, int, int]  # (h, w, spp)
    origins: np.ndarray  # (m, 3) float32; ray i starts at origins[i // each]
    each: int  # rays of each origin
    directions: np.ndarray  # (h * w * spp, 3) float32, of any length; t is in units of this length
    tmax: float  # tmin is 0
    asked: np.ndarray  # (h * w * spp,) bool: the rays that peers get


def shadow_rays(query: ShadowQuery) -> RaySet:
    """The segments of a query, receiver to light sample, over (0, 1).

    The rays asked are those that our tracers trace. So peers do not trace samples below their receiver's horizon, or
    rays of pixels that see nothing. Directions are rounded to float32; ours are the exact difference of the two ends.
    """
    ends, above = segments(query)
    ends -= query.origins[:, :, None]
    asked = above & (query.sides != NOTHING)[..., None]
    return RaySet(above.shape, query.origins.reshape(-1, 3), above.shape[2], ends.reshape(-1, 3), 1.0, asked.ravel())


def primary_rays(rays: CameraRays) -> RaySet:
    """The rays through the centres of a camera's pixels, over (0, inf), with the bits of `pixels.pixel_direction`."""
    y, x = np.mgrid[: rays.height, : rays.width][..., None]
    directions = ((rays.corner + (x + 0.5) * rays.dx) + (y + 0.5) * rays.dy).astype(np.float32).reshape(-1, 3)
    shape, asked = (rays.height, rays.width, 1), np.ones(len(directions), bool)
    return RaySet(shape, rays.origin.reshape(1, 3), len(directions), directions, np.inf, asked)


def ray_set(origins, directions, tmax=np.inf) -> RaySet:
    """Any rays, (n, 3) each, as a picture of one row."""
    origins, directions = (np.ascontiguousarray(a, np.float32) for a in (origins, directions))
    return RaySet((1, len(origins), 1), origins, 1, directions, float(tmax), np.ones(len(origins), bool))


def blocks(h: int, w: int) -> np.ndarray:
    """(n, 16) int64: pixels y * w + x of blocks of 4 x 4, with the blocks in Morton order; -1: not in the picture."""
    rows, columns = -(-h // BLOCK), -(-w // BLOCK)
    y, x = np.mgrid[:rows, :columns].reshape(2, -1)
    code = sum(((x >> k) & 1) << (2 * k) | ((y >> k) & 1) << (2 * k + 1) for k in range(16))
    order = np.argsort(code, kind="stable")
    lane = np.arange(LANES)
    y, x = y[order, None] * BLOCK + lane // BLOCK, x[order, None] * BLOCK + lane % BLOCK
    return np.where((y < h) & (x < w), y * w + x, -1)


def packets(rays: RaySet, order: str, lanes: int = LANES) -> np.ndarray:
    """(n, lanes) int32: ray ids of packets in one of ORDERS; -1 in a lane without a ray. No packet is empty.

    lanes : 16, 8 or 4
    """
    h, w, spp = rays.shape
    pixels = blocks(h, w)
    if order == "pixels":
        pixel, sample = pixels[:, None, :], np.arange(spp)[:, None]
    else:
        pixel, sample = pixels[:, :, None], np.arange(-(-spp // LANES) * LANES)
    ids = pixel * spp + sample
    ids[(pixel < 0) | (sample >= spp) & np.ones_like(ids, bool)] = -1
    ids[~rays.asked[ids] | (ids < 0)] = -1
    ids = ids.reshape(-1, lanes)
    return ids[(ids >= 0).any(1)].astype(np.int32)


def one_by_one(ids: np.ndarray) -> np.ndarray:
    """(n,) int32: the ray ids of packets, in order, without the empty lanes."""
    return ids[ids >= 0]


def gathered(rays: RaySet, ids: np.ndarray) -> np.ndarray:
    """(n, 6) float32: origins and directions of the rays with these ids, (n,)."""
    return np.concatenate([rays.origins[ids // rays.each], rays.directions[ids]], 1)
