"""What can be chosen about a ray hierarchy."""

from typing import NamedTuple


class Options(NamedTuple):
    """The parts of a ray hierarchy [Olsson and Assarsson 2011], and ours."""

    nodes: type | None = None  # what bounds rays from a light's centre: None means `boxes.Boxes`
    spheres: bool = False  # nodes are tested against spheres around triangles [Roger et al. 2007]
    wide: bool = False  # sixteen children, not four
    sorted: bool = False  # rays are sorted by direction (Sec. 3.5), not in the order of the screen
    blocks: bool = False  # blocks of 4 x 4 pixels are sorted, see `blocks`; they are leaves of 16 rays
    early_accept: bool = False  # nodes that a triangle covers are done (Sec. 3.3)
    two_pass: bool = False  # good occluders first, then all others for the rays that are left (Sec. 3.4)
    backface: bool = False  # triangles that the query's `cull_faces` lets through are dropped at once (Sec. 3.6)
    shared: bool = False  # one traversal for all samples of a light, not one for each
    shafts: bool = False  # where a light is too wide for one apex, leaves of one sample each, see `wide`
    clustered: bool = False  # triangles in Morton order, so that those of a batch meet the same nodes


FASTEST = Options(wide=True, blocks=True, early_accept=True, backface=True, shared=True, shafts=True)
