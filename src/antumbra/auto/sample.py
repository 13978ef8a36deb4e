"""A small query cut from a query: windows all over it. Ways are tried on it, because rates depend on the scene."""

import numpy as np

from ..query.receivers import NOTHING
from ..query.shadow_query import ShadowQuery, with_receivers
from ..trace.light_table import STRATA
from ..trace.tile import tile_shape

_SIDE, _ROW = 16, 256  # receivers of a window: of a picture, both ways, and of a row


def sample_of(query: ShadowQuery, windows: int) -> ShadowQuery:
    """The query of about so many windows that have receivers, below one another; or beside one another in a row.

    It has the first 16 samples, because the samples of a receiver are traced 16 at a time.
    """
    h, w = query.sides.shape
    height, width = (min(_SIDE, h), min(_SIDE, w)) if h > 1 else (1, min(_ROW, w))
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
    length, side = (h, min(_SIDE, w)) if h > 1 else (w, min(_ROW, w))
    middle = length // side // 2 * side
    if middle == 0:
        return [sample]
    cut = (lambda piece: lambda a: a[piece]) if h > 1 else (lambda piece: lambda a: a[:, piece])
    return [with_receivers(sample, cut(piece)) for piece in (slice(0, middle), slice(middle, length))]


def tile_of(query: ShadowQuery) -> ShadowQuery:
    """The query of the first tile, 16 receivers or fewer: hardly any rays."""
    shape = tile_shape(query)
    return with_receivers(query, lambda a: a[: shape.height, : shape.width])
