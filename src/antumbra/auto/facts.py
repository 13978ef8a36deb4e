"""What is known of a query before it is traced: the counts and sizes that the cost of a ray depends on."""

from typing import NamedTuple

import numpy as np

from ..query.query_bounds import bounds
from ..query.receivers import NOTHING
from ..query.shadow_query import ShadowQuery
from ..scene.lights import AMBIENT, DIRECTIONAL, SPHERE
from ..trace.packets.ray_tile import sample_extents
from ..trace.tile import tile_shape

_TILES = 96  # tiles that are looked at
_SIDE = 4  # of a tile of a picture
_FARTHER = 4.0  # times as far as the segments in a scene: where samples of distant lights lie
_LEAST, _MOST = 1e-6, 1e3  # of the scene's extents: beyond them, sizes make no difference


class Facts(NamedTuple):
    """Counts of a query and its scene. Sizes are sums over the axes, as shares of the scene's extents."""

    triangles: int
    receivers: int
    samples: int  # of a receiver
    kind: int  # of the light: see `LightPatch.kind`
    tile: float  # mean size of the receivers of a tile of 16
    stratum: float  # mean size of a stratum of the light's samples, half-way to it
    chunk: float  # the same for 16 strata

    @property
    def rays(self) -> int:
        return self.receivers * self.samples


def size_of(box: np.ndarray) -> float:
    """The sum of a scene's extents; `box`: (2, 3) float32."""
    return max(float((box[1].astype(np.float64) - box[0]).sum()), 1e-30)


def facts_of(query: ShadowQuery, triangles: int, box: np.ndarray) -> Facts:
    """The facts of a query of a scene; `box`: (2, 3) float32, around its triangles."""
    size = size_of(box)
    stratum, chunk = (_share(s, size) for s in _sizes_of_light(query))
    receivers = int(np.count_nonzero(query.sides != NOTHING))
    tile = _share(tile_size(query), size)
    return Facts(triangles, receivers, query.samples.shape[1], query.light.kind, tile, stratum, chunk)


def _share(part: float, size: float) -> float:
    return min(max(part / size, _LEAST), _MOST)


def _sizes_of_light(query: ShadowQuery) -> tuple[float, float]:
    """Sizes of (a stratum, a chunk) of the light's samples, half-way from a receiver."""
    light = query.light
    if light.kind == AMBIENT:
        return light.radius, light.radius
    if light.kind == SPHERE:
        return light.radius / _SIDE, light.radius
    stratum, chunk = sample_extents(query)
    far = 2.0 * _FARTHER if light.kind == DIRECTIONAL else 2.0
    return float(stratum) / far, float(chunk) / far


def tile_size(query: ShadowQuery) -> float:
    """Mean size of the box of a tile's receivers, over some tiles."""
    h, w = query.sides.shape
    width, height = tile_shape(query)[:2]
    rows, columns = max(h // height, 1), max(w // width, 1)
    some = np.unique(np.linspace(0, rows * columns - 1, _TILES).astype(int))
    y, x = some // columns * height, some % columns * width
    at = np.s_[(y[:, None] + np.arange(min(height, h)))[:, :, None], (x[:, None] + np.arange(min(width, w)))[:, None]]
    points, there = query.origins[at].reshape(len(some), -1, 3), query.sides[at].reshape(len(some), -1) != NOTHING
    there = there[:, :, None]
    several = there.sum((1, 2)) > 1
    if not several.any():
        return 0.0
    low, high = np.where(there, points, np.inf).min(1), np.where(there, points, -np.inf).max(1)
    return float((high[several].astype(np.float64) - low[several]).sum(1).mean())


def if_sorted(query: ShadowQuery, facts: Facts, size: float) -> Facts:
    """The facts of a row of receivers if it were sorted in space; `size`: of the scene."""
    low, high = bounds(query.origins)
    tile = float((high.astype(np.float64) - low).sum()) / size * (_SIDE * _SIDE / max(facts.receivers, 1)) ** 0.5
    return facts._replace(tile=min(max(tile, _LEAST), facts.tile))
