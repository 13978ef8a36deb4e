"""Scattered receivers in an order in which neighbours are near, so that packets and shafts can share their work.

Sample sets belong to places: receiver i of a row uses set i mod 4. So each of the four sets' receivers is sorted alone,
along a Morton curve, and they take turns again. Each receiver keeps its set, and its bits.
"""

import numpy as np

from ..query.query_bounds import morton_codes
from ..query.shadow_query import ShadowQuery, with_receivers

_SETS = 4  # of a row of receivers


def sorted_places(origins: np.ndarray) -> np.ndarray:
    """(n,) int64: the receiver that comes to each place of the sorted row; `origins`: (n, 3)."""
    codes, places = morton_codes(origins), np.empty(len(origins), np.int64)
    for k in range(_SETS):
        places[k::_SETS] = k + _SETS * np.argsort(codes[k::_SETS])
    return places


def in_order(query: ShadowQuery, places: np.ndarray) -> ShadowQuery:
    """The query of a row of receivers, with receiver ``places[i]`` at place i."""
    return with_receivers(query, lambda array: array[:, places])
