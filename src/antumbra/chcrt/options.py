"""What can be chosen about CHC+RT."""

from typing import NamedTuple


class Options(NamedTuple):
    """The parameters of [Mattausch et al. 2015], adapted to a processor's cores and caches."""

    tile: int = 128  # pixels along the side of the smallest screen tile, a multiple of 32 (Sec. 5.2: 200)
    triangles: int = 1 << 20  # of a subtree that is traced whole, at most (Sec. 5.2: 1 M); a store has its chunks
    height: int = 24  # levels of such a subtree, at most (Sec. 5.2)
    weight: float = 0.5  # t_q: of the tile's share of the screen, against the node's share of the scene (Sec. 4.4)
    every: int = 3  # frames between two queries of a visible pair (Sec. 5.1: n)
    batch: int = 24  # newly visible subtrees of a tile that are traced together (Sec. 5.2)
    threshold: int = 0  # rays of a tile that may be neglected; 0: conservative (Sec. 7: 20, 100 and 200)
