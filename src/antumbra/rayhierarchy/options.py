"""Options of a ray hierarchy."""

from typing import NamedTuple


class Options(NamedTuple):
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


FASTEST = Options(wide=True, blocks=True, early_accept=True, backface=True, shared=True, shafts=True)
