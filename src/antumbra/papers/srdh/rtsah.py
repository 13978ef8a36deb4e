"""Checks RTSAH against what it assumes [Ize and Hansen 2011]: lines that are spread evenly through the scene.

RTSAH predicts by areas which child of a node blocks more of such lines for its cost. Shadow rays are other lines: they
begin on surfaces and end at lights. So the order is counted for both, and the opposite order beside it. An order that
is right for its lines saves box tests, and its opposite wastes some.
"""

from typing import NamedTuple

import numpy as np

from ...bvh import binned_sah
from ...bvh.nodes import LEFT_FIRST, Bvh, aligned_empty
from ...bvh.order import sooner_first
from ...query.light_samples import light_samples
from ...query.query_bounds import reach
from ...query.receivers import FREE
from ...query.shadow_query import ShadowQuery
from ...scene.light_lists import PointLights
from ...scene.triangles import Triangles
from ...trace.rays.ray_traversal import RANDOM, Ordered
from ...trace.rays.single_rays import count_steps
from .measure import Workload

_SHAPE, _ENDS = (16, 24), 256  # of the points at which lines begin and end


class Assumed(NamedTuple):
    """Box tests of RTSAH, and of the opposite order, relative to random order."""

    scene: str
    lines: float  # of lines spread evenly
    lines_reversed: float
    rays: float  # of the shadow rays of a `Workload`
    rays_reversed: float


def even_lines(triangles: Triangles, seed: int = 0) -> ShadowQuery:
    """Segments between random points of a sphere around the scene: they cross its inside evenly, in all directions."""
    corners = triangles.vertices.reshape(-1, 3).astype(np.float64)
    low, high = corners.min(0), corners.max(0)
    rng, middle, radius = np.random.default_rng(seed), (low + high) / 2, 0.501 * np.linalg.norm(high - low)

    def on_sphere(n: int) -> np.ndarray:
        towards = rng.normal(size=(n, 3))
        return middle + radius * towards / np.linalg.norm(towards, axis=1, keepdims=True)

    light = PointLights(on_sphere(_ENDS) + triangles.origin)
    origins = on_sphere(_SHAPE[0] * _SHAPE[1]).astype(np.float32).reshape(*_SHAPE, 3)
    no_faces, sides = np.full(_SHAPE, -1, np.int32), np.full(_SHAPE, FREE, np.int8)
    patch = light.patch(triangles.origin, reach(triangles, origins))
    flat, samples = triangles.vertices.reshape(-1, 9), light_samples(light, 1)
    return ShadowQuery(origins, no_faces, sides, np.empty((0, 0, 3)), flat, patch, samples, 0, no_faces)


def opposite(bvh: Bvh) -> Bvh:
    """The tree with the children of every node exchanged."""
    nodes = aligned_empty(bvh.nodes.shape, "f4")
    nodes[:] = bvh.nodes
    nodes[:, :14] = nodes[:, :14].reshape(-1, 7, 2)[:, :, ::-1].reshape(-1, 14)
    return bvh._replace(nodes=nodes, links=nodes.view(np.int32))


def check_rtsah(work: Workload) -> Assumed:
    """Count the box tests of lines and of shadow rays in a SAH tree with one triangle in a leaf."""
    bvh = binned_sah.build(work.triangles.vertices, work.threads, 1)
    turned = sooner_first(bvh)
    orders = Ordered(bvh, RANDOM), Ordered(turned, LEFT_FIRST), Ordered(opposite(turned), LEFT_FIRST)
    n, shares = len(work.triangles.vertices), list[float]()
    for queries in [even_lines(work.triangles)], work.queries():
        boxes = [sum(int(count_steps(o, query, n, work.threads).boxes.sum()) for query in queries) for o in orders]
        shares += [boxes[1] / boxes[0], boxes[2] / boxes[0]]
    return Assumed(work.view.name, *shares)
