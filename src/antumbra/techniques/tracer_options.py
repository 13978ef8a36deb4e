"""Options of ray hierarchies and of CHC+RT. The registry of methods reads them without importing the tracers."""

from typing import NamedTuple

# --- Options of a ray hierarchy ---------------------------------------------------------------------------------------


class RayHierarchyOptions(NamedTuple):
    """Features of a ray hierarchy from Olsson and Assarsson [2011], and additions."""

    nodes: type | None = None  # bounding volume of rays from a light's centre; None means `boxes.Boxes`
    spheres: bool = False  # nodes are tested against spheres around triangles [Roger et al. 2007]
    wide: bool = False  # sixteen children per node instead of four
    sorted: bool = False  # rays are sorted by direction (Sec. 3.5) instead of in screen order
    blocks: bool = False  # blocks of 4 x 4 pixels are sorted and become leaves of 16 rays, see `blocks`
    early_accept: bool = False  # nodes that one triangle covers are finished (Sec. 3.3)
    two_pass: bool = False  # good occluders first, then all others for the remaining rays (Sec. 3.4)
    backface: bool = False  # triangles that do not block by `cull_faces` are dropped at once (Sec. 3.6)
    shared: bool = False  # one traversal for all samples of a light instead of one per sample
    shafts: bool = False  # leaves of one sample each if a light is too wide for one apex, see `wide`
    clustered: bool = False  # triangles in Morton order, so triangles of a batch meet the same nodes


FASTEST_RAY_HIERARCHY = RayHierarchyOptions(
    wide=True, blocks=True, early_accept=True, backface=True, shared=True, shafts=True
)

# --- The options of CHC+RT --------------------------------------------------------------------------------------------


WHOLE_SCREEN = 1 << 16
"""A tile as large as any screen: without a hierarchy over the screen."""


class ChcRtOptions(NamedTuple):
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
