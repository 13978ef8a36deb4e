"""Options of ray hierarchies and of CHC+RT, apart from the tracers so that the method registry need not import them."""

from typing import NamedTuple

# --- Options of a ray hierarchy ---------------------------------------------------------------------------------------


class RayHierarchyOptions(NamedTuple):
    """Features of the ray hierarchy of Olsson and Assarsson [2011], and additions to it."""

    nodes: type | None = None  # bounding volume of rays from a light's centre; None: `box_nodes.Boxes`
    spheres: bool = False  # test nodes against bounding spheres of triangles [Roger et al. 2007]
    wide: bool = False  # sixteen children per node instead of four
    sorted: bool = False  # sort rays by direction (Sec. 3.5) instead of keeping them in screen order
    blocks: bool = False  # sort blocks of 4 x 4 pixels and make them leaves of 16 rays, see `leaf_packing`
    early_accept: bool = False  # finish nodes that a single triangle covers (Sec. 3.3)
    two_pass: bool = False  # good occluders first, then all others for the remaining rays (Sec. 3.4)
    backface: bool = False  # drop triangles that cannot block, by `cull_faces`, before the traversal (Sec. 3.6)
    shared: bool = False  # one traversal for all samples of a light instead of one per sample
    shafts: bool = False  # shafts with one sample per leaf for lights too wide for one apex, see `ray_hierarchy`
    clustered: bool = False  # triangles in Morton order, so that the triangles of a batch meet the same nodes


FASTEST_RAY_HIERARCHY = RayHierarchyOptions(
    wide=True, blocks=True, early_accept=True, backface=True, shared=True, shafts=True
)

# --- Options of CHC+RT ------------------------------------------------------------------------------------------------


WHOLE_SCREEN = 1 << 16
"""A tile size that covers any screen, which disables the hierarchy of screen tiles."""


class ChcRtOptions(NamedTuple):
    """Parameters of [Mattausch et al. 2015], adapted to the cores and caches of a CPU."""

    tile: int = 128  # side of the smallest screen tile in pixels, a multiple of 32 (Sec. 5.2: 200)
    triangles: int = 1 << 20  # maximum number of triangles per part (Sec. 5.2: 1 M); a store's parts are its chunks
    height: int = 24  # maximum number of levels per part (Sec. 5.2)
    weight: float = 0.5  # t_q: weight of a tile's share of the screen against a node's share of the scene (Sec. 4.4)
    every: int = 3  # frames between two queries of a visible pair (Sec. 5.1: n)
    batch: int = 24  # newly visible parts of a tile that are traced together (Sec. 5.2)
    threshold: int = 0  # skip pairs with at most this many rays; 0: conservative (Sec. 7: 20, 100 and 200)
    keep: bool = True  # False: start each frame without the fronts of the previous frame (Sec. 4.5)
    pull_up: bool = True  # False: never merge pairs that were split (Sec. 5.1)
