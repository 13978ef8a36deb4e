"""Children stand in the order in which they are worth visiting."""

import numpy as np
import pytest

from antumbra.bvh import BUILDERS
from antumbra.bvh.wide import LINKS, NO_CHILD, WIDTH
from antumbra.bvh.widen import widen
from bvh_scenes import HAZARDS


def _half_surface(low, high):
    x, y, z = high.astype(float) - low
    return x * y + y * z + z * x


def _visit(wide, areas, node, found):
    """(share of the rays through a node that are blocked, steps of such a ray); its children's shares per step."""
    links = [k for k in wide.links[node, LINKS : LINKS + WIDTH].tolist() if k != NO_CHILD]
    planes = wide.nodes[node, :LINKS].reshape(3, 2, WIDTH)[:, :, : len(links)]
    whole = _half_surface(planes[:, 0].min(1), planes[:, 1].max(1))
    children = []
    for lane, link in enumerate(links):
        surface = _half_surface(planes[:, 0, lane], planes[:, 1, lane])
        leaf = link < 0
        share = (1 - np.exp(-areas[~link >> 4] / surface), 1.0) if leaf else _visit(wide, areas, link, found)
        children.append((surface / whole, *share))
    found.append([blocked / cost for _, blocked, cost in children])
    passing, steps = 1.0, 1.0
    for enter, blocked, cost in children[::-1]:
        steps += passing * enter * cost
        passing *= 1 - enter * blocked
    return 1 - passing, steps


@pytest.mark.parametrize("name", ["large, terrain", "large, scattered"])
def test_wide_nodes_end_with_the_child_that_blocks_a_ray_soonest(name):
    vertices = np.ascontiguousarray(HAZARDS[name], np.float32)
    wide = widen(BUILDERS["bsah"].build(vertices, 2), 2)
    faces = wide.bvh.prim_ids[wide.slots]
    corners = vertices[faces].astype(float)
    areas = 0.5 * np.linalg.norm(
        np.cross(corners[:, :, 1] - corners[:, :, 0], corners[:, :, 2] - corners[:, :, 0]), axis=2
    )
    found = []
    _visit(wide, np.where(wide.slots >= 0, areas, 0).sum(1), 0, found)
    assert len(found) == len(wide.nodes)
    for shares in found:
        assert (np.diff(shares) >= -1e-9 * np.array(shares[1:])).all()
