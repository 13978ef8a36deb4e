"""The rays of a light that is too wide for one apex, as leaves of `shafts`.

Adjacent pixels use different sample sets, sixteen in all. So a leaf has nearby receivers of one set, and one sample:
all its segments end at nearly the same point. Leaves follow a space-filling curve over receivers and samples, so a
node's shaft is equally narrow at both ends.
"""

import numpy as np

from .beams import PARALLEL, PERSPECTIVE, Beam
from .memory import Empty
from .order import Order
from .packed import rays_of
from .rays import LeafRays

_BITS = 10  # per coordinate of the receivers' Morton codes


def receivers_of(query, beam: Beam, rays: LeafRays, bits: np.ndarray, threads: int, empty: Empty) -> LeafRays:
    """Make the `LeafRays` of the unfinished receivers: each leaf has sixteen nearby receivers of one sample set."""
    w = query.sides.shape[1]
    left = (rays.lanes & ~np.bitwise_and.reduce(rays.dead, 1))[:, None] >> np.arange(rays.ways) & 1
    places = rays.blocks[:, None] * rays.ways + np.arange(rays.ways)
    ids = rays.ids[places[left.astype(bool)]]
    sets = (ids % w & 3) + 4 * (ids // w & 3)
    key = sets.astype(np.int64) << 3 * _BITS | _morton(query.origins.reshape(-1, 3)[ids], _BITS)
    order = np.argsort(key, kind="stable")
    counts = np.bincount(sets, minlength=1)
    some = np.flatnonzero(counts)
    starts = np.append(0, np.cumsum(counts[some])).astype(np.int64)
    return rays_of(query, beam, Order(ids[order], starts, some, False), 16, bits, threads, empty)


def shafts_of(query, beam: Beam, rays: LeafRays) -> tuple[LeafRays, np.ndarray]:
    """(leaves of one sample each, their places in the flat `dead` of the rays from `receivers_of`)."""
    live = rays.lanes[:, None] & ~rays.dead  # leaf, sample
    leaf, sample = np.nonzero(live)
    sets = np.repeat(rays.faces, np.diff(rays.starts))
    spread = query.samples[:, beam.first : beam.first + beam.count, :2]
    at = _rank(_morton(spread.reshape(-1, 2), 16)).reshape(spread.shape[:2])[sets[leaf], sample]
    points = rays.origins[: 48 * len(rays.blocks)].reshape(-1, 3, 16)[rays.blocks, :, _first_lane(rays.lanes)]
    size = float(np.ptp(points.astype(np.float64), axis=0).max()) if len(points) else 0.0
    key = _woven(_rank(_morton(points, 16))[leaf], at, len(points), at.max(initial=0) + 1, size, _width(beam, size))
    order = np.argsort(key, kind="stable")
    leaf, sample = leaf[order].astype(np.int32), sample[order].astype(np.int32)
    dead = rays.dead[leaf, sample][:, None]
    made = rays._replace(
        blocks=rays.blocks[leaf], lanes=rays.lanes[leaf] & ~dead[:, 0], dead=dead, count=1, samples=sample,
        starts=np.array([0, len(leaf)]), faces=np.zeros(1, np.int64),
    )  # fmt: skip
    return made, leaf.astype(np.int64) * rays.count + sample


def _first_lane(lanes: np.ndarray) -> np.ndarray:
    return np.bitwise_count((lanes & -lanes) - 1) & 15


def _width(beam: Beam, size: float) -> float:
    """The width of the light at the receivers, which have the extent `size`."""
    if beam.kind == PERSPECTIVE:
        return 2.0 * beam.radius / beam.unit
    if beam.kind == PARALLEL:
        return 2.0 * beam.radius * size
    return 2.0 * min(beam.radius / beam.unit, size)


def _morton(points: np.ndarray, bits: int) -> np.ndarray:
    """(n,) int64: Morton codes of (n, d) points, with interleaved bits of the coordinates; cells are cubes."""
    points = points.astype(np.float64)
    low = points.min(0, initial=np.inf)
    side = max(float((points - low).max(initial=0.0)), 1e-300)
    cells = np.minimum((points - low) / side * 2**bits, 2**bits - 1).astype(np.int64)
    code, d = np.zeros(len(points), np.int64), points.shape[1]
    for k in range(bits):
        for axis in range(d):
            code |= (cells[:, axis] >> k & 1) << d * k + axis
    return code


def _rank(codes: np.ndarray) -> np.ndarray:
    """The rank of each code."""
    rank = np.empty(len(codes), np.int64)
    rank[np.argsort(codes, kind="stable")] = np.arange(len(codes))
    return rank


def _woven(a: np.ndarray, b: np.ndarray, n: int, m: int, size: float, width: float) -> np.ndarray:
    """Sorting keys that interleave the bits of receivers a < n and samples b < m, the highest first.

    Each bit comes from the wider of the two: receivers of extent `size`, or the light of extent `width`. A bit halves
    an area, so two bits halve a width.
    """
    key, left, right = np.zeros(len(a), np.int64), max(n - 1, 0).bit_length(), int(m - 1).bit_length()
    while left or right:
        if right == 0 or (left and size >= width):
            left, size = left - 1, size * 0.5**0.5
            key = key << 1 | (a >> left & 1)
        else:
            right, width = right - 1, width * 0.5**0.5
            key = key << 1 | (b >> right & 1)
    return key
