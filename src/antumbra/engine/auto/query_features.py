"""Query features: the counts and sizes on which the cost of a ray depends, known before the query is traced.

Also the spatial order of scattered receivers, so that packets and shafts can share work among neighbours, and a small
query cut from a query. Strategies are tried on such a sample, because rates depend on the scene.
"""

from typing import NamedTuple

import numpy as np

from ...query.query_bounds import bounds, morton_codes
from ...query.receivers import NOTHING
from ...query.shadow_query import ShadowQuery, with_receivers
from ...scene.lights import AMBIENT, DIRECTIONAL, SPHERE
from ...trace.light_table import STRATA
from ...trace.packets.ray_tile import sample_extents
from ...trace.tile import tile_shape

# --- What is known of a query before it is traced: the counts and sizes that the cost of a ray depends on -------------


_TILES = 96  # tiles that are looked at
_TILE_SIDE = 4  # of a tile of a picture
_FARTHER = 4.0  # times as far as the segments in a scene: where samples of distant lights lie
_LEAST, _MOST = 1e-6, 1e3  # of the scene's extents: beyond them, sizes make no difference


class QueryFeatures(NamedTuple):
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


def features_of(query: ShadowQuery, triangles: int, box: np.ndarray) -> QueryFeatures:
    """The facts of a query of a scene; `box`: (2, 3) float32, around its triangles."""
    size = size_of(box)
    stratum, chunk = (_share(s, size) for s in _sizes_of_light(query))
    receivers = int(np.count_nonzero(query.sides != NOTHING))
    tile = _share(tile_size(query), size)
    return QueryFeatures(triangles, receivers, query.samples.shape[1], query.light.kind, tile, stratum, chunk)


def _share(part: float, size: float) -> float:
    return min(max(part / size, _LEAST), _MOST)


def _sizes_of_light(query: ShadowQuery) -> tuple[float, float]:
    """Sizes of (a stratum, a chunk) of the light's samples, half-way from a receiver."""
    light = query.light
    if light.kind == AMBIENT:
        return light.radius, light.radius
    if light.kind == SPHERE:
        return light.radius / _TILE_SIDE, light.radius
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


def if_sorted(query: ShadowQuery, facts: QueryFeatures, size: float) -> QueryFeatures:
    """The facts of a row of receivers if it were sorted in space; `size`: of the scene."""
    low, high = bounds(query.origins)
    tile = (
        float((high.astype(np.float64) - low).sum()) / size * (_TILE_SIDE * _TILE_SIDE / max(facts.receivers, 1)) ** 0.5
    )
    return facts._replace(tile=min(max(tile, _LEAST), facts.tile))


# ---------------------------------------------------------------------------------------------------------------------
# Scattered receivers in an order in which neighbours are near, so that packets and shafts can share their work.
#
# Sample sets belong to places: receiver i of a row uses set i mod 4. So each of the four sets' receivers is sorted
# alone, along a Morton curve, and they take turns again. Each receiver keeps its set, and its bits.


_SETS = 4  # of a row of receivers


def spatial_order(origins: np.ndarray) -> np.ndarray:
    """(n,) int64: the receiver that comes to each place of the sorted row; `origins`: (n, 3)."""
    codes, places = morton_codes(origins), np.empty(len(origins), np.int64)
    for k in range(_SETS):
        places[k::_SETS] = k + _SETS * np.argsort(codes[k::_SETS])
    return places


def reorder_query(query: ShadowQuery, places: np.ndarray) -> ShadowQuery:
    """The query of a row of receivers, with receiver ``places[i]`` at place i."""
    return with_receivers(query, lambda array: array[:, places])


# --- A small query cut from a query: windows all over it. Ways are tried on it, because rates depend on the scene -----


_WINDOW_SIDE, _WINDOW_ROW = 16, 256  # receivers of a window: of a picture, both ways, and of a row


def sample_of(query: ShadowQuery, windows: int) -> ShadowQuery:
    """The query of about so many windows that have receivers, below one another; or beside one another in a row.

    It has the first 16 samples, because the samples of a receiver are traced 16 at a time.
    """
    h, w = query.sides.shape
    height, width = (min(_WINDOW_SIDE, h), min(_WINDOW_SIDE, w)) if h > 1 else (1, min(_WINDOW_ROW, w))
    rows, columns = h // height, w // width
    places = np.arange(rows * columns)
    y, x = places // columns * height, places % columns * width
    full = query.sides[y + height // 2, x + width // 2] != NOTHING
    places = places[full] if full.any() else places
    # a stride of the golden ratio spreads few windows over all rows and columns
    chosen = np.unique(places[(np.arange(1, windows + 1) * 0.618034 % 1.0 * len(places)).astype(int)])
    y, x = y[chosen], x[chosen]
    join = lambda a: np.concatenate([a[i : i + height, j : j + width] for i, j in zip(y, x)], axis=0 if h > 1 else 1)
    return with_receivers(query, join)._replace(samples=np.ascontiguousarray(query.samples[:, :STRATA]))


def halves_of(sample: ShadowQuery) -> list[ShadowQuery]:
    """The two halves of a sample; the sample itself if it is one window."""
    h, w = sample.sides.shape
    length, side = (h, min(_WINDOW_SIDE, w)) if h > 1 else (w, min(_WINDOW_ROW, w))
    middle = length // side // 2 * side
    if middle == 0:
        return [sample]
    cut = (lambda piece: lambda a: a[piece]) if h > 1 else (lambda piece: lambda a: a[:, piece])
    return [with_receivers(sample, cut(piece)) for piece in (slice(0, middle), slice(middle, length))]


def tile_of(query: ShadowQuery) -> ShadowQuery:
    """The query of the first tile, 16 receivers or fewer: hardly any rays."""
    shape = tile_shape(query)
    return with_receivers(query, lambda a: a[: shape.height, : shape.width])
