"""The solid triangles of a scene, which a plan's tree holds: they have an area, and no hole."""

from collections.abc import Callable

import numpy as np

from ..bvh.nodes import Bvh
from ..cull.cull import Culled
from ..scene.areas import solid_vertices
from ..scene.triangles import Triangles


def solid_of(triangles: Triangles, culled: Culled | None, threads: int | None) -> Culled | None:
    """What culling left, without cut-outs, clear faces and triangles without area; None: all triangles."""
    own = triangles.solid
    if own is None:
        return culled
    if culled is None:
        return Culled(own, solid_vertices(triangles, threads), None, None, 0, 0)
    left = np.isin(culled.kept, own, assume_unique=True)
    return culled._replace(kept=culled.kept[left], vertices=np.ascontiguousarray(culled.vertices[left]))


def solid_count(triangles: Triangles) -> int:
    """The number of solid triangles."""
    return len(triangles.vertices if triangles.solid is None else triangles.solid)


def solid_tree(build: Callable, triangles: Triangles, threads: int | None) -> Bvh:
    """A tree of the solid triangles, by a builder's function."""
    bvh = build(solid_vertices(triangles, threads), threads)
    own = triangles.solid
    return bvh if own is None else bvh._replace(prim_ids=own[bvh.prim_ids])
