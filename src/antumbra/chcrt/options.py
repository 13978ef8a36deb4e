"""The options of CHC+RT."""

from typing import NamedTuple

WHOLE = 1 << 16
"""A tile as large as any screen: without a hierarchy over the screen."""


class Options(NamedTuple):
    """The parameters of [Mattausch et al. 2015], adapted to a processor's cores and caches."""

    tile: int = 128  # pixels along the side of the smallest screen tile, a multiple of 32 (Sec. 5.2: 200)
    triangles: int = 1 << 20  # most triangles of a part (Sec. 5.2: 1 M); a store's parts are its chunks
    height: int = 24  # most levels of a part (Sec. 5.2)
    weight: float = 0.5  # t_q: weight of a tile's share of the screen against a node's share of the scene (Sec. 4.4)
    every: int = 3  # frames between two queries of a visible pair (Sec. 5.1: n)
    batch: int = 24  # newly visible parts of a tile that are traced together (Sec. 5.2)
    threshold: int = 0  # a pair with at most this many rays is skipped; 0: conservative (Sec. 7: 20, 100 and 200)
    keep: bool = True  # False: each frame forgets the fronts of the frame before (Sec. 4.5)
    pull_up: bool = True  # False: pairs that were split are never merged (Sec. 5.1)
