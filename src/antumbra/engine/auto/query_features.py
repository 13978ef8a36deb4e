"""Query features: the counts and sizes that determine the cost per ray, computed before a query is traced.

The module also sorts scattered receivers spatially, so that packets and shafts share work among neighbours, and cuts
small samples from a query. Strategies are timed on such a sample because their rates depend on the scene.
"""

import weakref
from collections import deque
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...query.equal_samples import have_equal_samples
from ...query.query_bounds import bounds, morton_codes
from ...query.receivers import NOTHING
from ...query.shadow_query import ShadowQuery, with_receivers
from ...scene.lights import AMBIENT, DIRECTIONAL, LIST, SPHERE, LightPatch
from ...trace.light_table import STRATA
from ...trace.packets.ray_tile import is_incoherent, sample_extents
from ...trace.tile import tile_shape
from ...trace.tracer_cost import QueryFeatures

# --- features ---------------------------------------------------------------------------------------------------------

_MEASURED_TILES = 96
_FACING_STEP, _FACING_POINTS = 8, 4  # one in so many receivers of measured tiles; points of the light
_FEW_RAYS = 1 << 14  # rays that take less time than looking at their receivers would save
_TILE_SIDE = 4  # receivers along each side of an image tile
_DISTANT = 4.0  # distance of the samples of distant lights, relative to that of other lights
_SCATTERED = 0.7  # least share of the scene's extent along each axis
_YZX, _ZXY = [1, 2, 0], [2, 0, 1]  # axes
_MIN_SIZE, _MAX_SIZE = 1e-6, 1e3  # relative to the scene's extents; sizes are clamped to this range


def size_of(box: NDArray[np.float32]) -> float:
    """The sum of a scene's extents; `box`: (2, 3) float32."""
    return max(float((box[1].astype(np.float64) - box[0]).sum()), 1e-30)


class _Known(NamedTuple):
    """The features of a recent query, which are needed twice: to choose what is built, and how it is traced."""

    origins: weakref.ref[NDArray[np.float32]]
    light: LightPatch
    samples: int
    features: QueryFeatures


_recent: deque[_Known] = deque(maxlen=32)


def features_of(query: ShadowQuery, triangles: int, box: NDArray[np.float32]) -> QueryFeatures:
    """The features of a query; `box`: (2, 3) float32, the bounds of the scene's triangles."""
    samples = query.samples.shape[1]
    for known in list(_recent):  # a copy, because other threads may add to it
        if known.origins() is query.origins and known.light is query.light and known.samples == samples:
            return known.features._replace(triangles=triangles)
    features = _features_of(query, triangles, box)
    _recent.append(_Known(weakref.ref(query.origins), query.light, samples, features))
    return features


def _features_of(query: ShadowQuery, triangles: int, box: NDArray[np.float32]) -> QueryFeatures:
    size, seen = size_of(box), places_of(query)
    stratum, chunk = (_relative(extent, size) for extent in _light_sizes(query))
    receivers = int(np.count_nonzero(query.sides))  # NOTHING is 0; a comparison would need memory of its own
    tile, kind = _relative(tile_size(query, seen), size), query.light.kind
    if kind == DIRECTIONAL and is_incoherent(query):
        kind = LIST
    facing = facing_share(query, seen)
    return QueryFeatures(triangles, receivers, query.samples.shape[1], kind, tile, stratum, chunk, facing)


def _relative(extent: float, size: float) -> float:
    return min(max(extent / size, _MIN_SIZE), _MAX_SIZE)


def _light_sizes(query: ShadowQuery) -> tuple[float, float]:
    """Sizes of (a stratum, a chunk) of the light's samples, halfway from a receiver."""
    light = query.light
    if light.kind == AMBIENT:
        return light.radius, light.radius
    if light.kind == SPHERE:
        return light.radius / _TILE_SIDE, light.radius
    if query.samples.shape[1] == 1 and have_equal_samples(light, query.samples):
        return 0.0, 0.0
    stratum, chunk = sample_extents(query)
    divisor = 2.0 * _DISTANT if light.kind == DIRECTIONAL else 2.0
    return float(stratum) / divisor, float(chunk) / divisor


def places_of(query: ShadowQuery) -> NDArray[np.int64]:
    """(16, k) int64: flat indices of the receivers of a few tiles, at most `_MEASURED_TILES`; do not write to it."""
    shape = tile_shape(query)
    return _places(*query.sides.shape, shape.height, shape.width)


@lru_cache(8)
def _places(h: int, w: int, height: int, width: int) -> NDArray[np.int64]:
    rows, columns = max(h // height, 1), max(w // width, 1)
    count = min(rows * columns, _MEASURED_TILES)
    tiles = np.arange(count) * (rows * columns - 1) // max(count - 1, 1)
    lanes = np.arange(min(height, h))[:, None] * w + np.arange(min(width, w))
    return lanes.reshape(-1, 1) + (tiles // columns * height * w + tiles % columns * width)


def tile_size(query: ShadowQuery, places: NDArray[np.int64]) -> float:
    """Mean size of the box of a tile's receivers; `places`: those of tiles, from `places_of`."""
    if len(places) < 2:
        return 0.0
    points, there = query.origins.reshape(-1, 3).take(places, 0), query.sides.reshape(-1).take(places) != NOTHING
    if there.all():  # as in most pictures
        low, high = points.min(0), points.max(0)
    else:
        inside, several = there[:, :, None], there.sum(0) > 1
        low, high = np.where(inside, points, np.inf).min(0), np.where(inside, points, -np.inf).max(0)
        low, high = low[several], high[several]
    return float(np.subtract(high, low, dtype=np.float64).sum()) / max(len(low), 1)


def facing_share(query: ShadowQuery, places: NDArray[np.int64]) -> float:
    """The share of the receivers that face the light, estimated from a few of them and a few points of the light.

    places : those of tiles, from `places_of`
    """
    light, some = query.light, places[::_FACING_STEP].reshape(-1)
    if light.kind == AMBIENT or query.sides.size * query.samples.shape[1] < _FEW_RAYS:
        return 1.0
    sides, faces = query.sides.reshape(-1).take(some), query.faces.reshape(-1).take(some)
    there = (sides != NOTHING) & (faces >= 0)
    if not there.all():
        some, sides, faces = some[there], sides[there], faces[there]
        if not len(some):
            return 1.0
    corners = np.ascontiguousarray(query.corners.take(faces, 0).T)  # NumPy is slow for rows of three
    u, v = corners[3:6] - corners[:3], corners[6:] - corners[:3]
    normals = (u[_YZX] * v[_ZXY] - u[_ZXY] * v[_YZX]) * sides  # np.cross takes three times that
    samples = query.samples[0, :: -(-query.samples.shape[1] // _FACING_POINTS)]
    points = light.base + (0.0 if light.kind == SPHERE else samples @ np.stack((light.u, light.v, light.w)))
    points = points.reshape(-1, 3, 1)
    towards = points if light.kind == DIRECTIONAL else points - query.origins.reshape(-1, 3).take(some, 0).T
    return float(((normals * towards).sum(1) > 0.0).mean())


def if_sorted(query: ShadowQuery, features: QueryFeatures, size: float) -> QueryFeatures:
    """The features of a row of receivers once it is spatially sorted; `size`: of the scene."""
    lower, upper = bounds(query.origins)
    extent = float((upper.astype(np.float64) - lower).sum())
    tile = extent / size * (_TILE_SIDE * _TILE_SIDE / max(features.receivers, 1)) ** 0.5
    return features._replace(tile=min(max(tile, _MIN_SIZE), features.tile))


# --- spatial order ----------------------------------------------------------------------------------------------------
#
# Receiver i of a row uses sample set i mod 4. The receivers of each set are therefore sorted separately along a Morton
# curve and then interleaved again. Each receiver keeps its sample set, and so its bits.


def is_scattered(query: ShadowQuery, box: NDArray[np.float32]) -> bool:
    """Whether the receivers are points all over the scene, so that their segments pass through most of it.

    box : (2, 3) float32, bounds of the scene
    """
    if len(query.origins) != 1 or not query.origins.size:
        return False
    low, high = np.maximum(query.origins.min((0, 1)), box[0]), np.minimum(query.origins.max((0, 1)), box[1])
    return bool((high - low >= _SCATTERED * (box[1] - box[0])).all())


_SETS = 4  # sample sets of a row of receivers


def spatial_order(origins: NDArray[np.float32]) -> NDArray[np.int64]:
    """(n,) int64: the index of the receiver at each place of the sorted row; `origins`: (n, 3)."""
    codes, places = morton_codes(origins), np.empty(len(origins), np.int64)
    for k in range(_SETS):
        places[k::_SETS] = k + _SETS * np.argsort(codes[k::_SETS])
    return places


def reorder_query(query: ShadowQuery, places: NDArray[np.int64]) -> ShadowQuery:
    """The query of a row of receivers, reordered so that receiver ``places[i]`` is at place i."""
    return with_receivers(query, lambda array: array[:, places])


# --- samples of a query -----------------------------------------------------------------------------------------------

_WINDOW_SIDE, _WINDOW_ROW = 16, 256  # receivers along each side of an image window, and of a window of a row


def sample_of(query: ShadowQuery, windows: int) -> ShadowQuery:
    """A query of about `windows` windows that have receivers, stacked vertically, or concatenated for a row.

    It has only the first 16 samples, because the samples of a receiver are traced 16 at a time.
    """
    h, w = query.sides.shape
    height, width = (min(_WINDOW_SIDE, h), min(_WINDOW_SIDE, w)) if h > 1 else (1, min(_WINDOW_ROW, w))
    rows, columns = h // height, w // width
    places = np.arange(rows * columns)
    y, x = places // columns * height, places % columns * width
    occupied = query.sides[y + height // 2, x + width // 2] != NOTHING
    places = places[occupied] if occupied.any() else places
    # a stride of the golden ratio spreads even a few windows over all rows and columns
    chosen = _distinct(places[(np.arange(1, windows + 1) * 0.618034 % 1.0 * len(places)).astype(int)])
    lanes = np.arange(height)[:, None] * w + np.arange(width)
    shape = (len(chosen) * height, width) if h > 1 else (1, len(chosen) * width)
    joined = ((y * w + x)[chosen, None, None] + lanes).reshape(shape)
    windows_of = lambda a: a.reshape(-1, *a.shape[2:]).take(joined, 0)
    return with_receivers(query, windows_of)._replace(samples=np.ascontiguousarray(query.samples[:, :STRATA]))


def _distinct(numbers: NDArray[np.integer]) -> NDArray[np.integer]:
    """The distinct numbers of an array, in order; ``np.unique`` would import numpy.ma, which takes long."""
    numbers = np.sort(numbers)
    new = np.ones(len(numbers), bool)
    np.not_equal(numbers[1:], numbers[:-1], out=new[1:])
    return numbers[new]


def tile_of(query: ShadowQuery) -> ShadowQuery:
    """The query of the first tile: at most 16 receivers."""
    shape = tile_shape(query)
    return with_receivers(query, lambda a: a[: shape.height, : shape.width])
