"""RTSAH saves box tests of lines that are spread evenly, as it assumes, and the opposite order wastes some."""

import numpy as np
import pytest

from antumbra.bvh import binned_sah
from antumbra.bvh.tree_quality import validate
from antumbra.engine.scene import procedural
from antumbra.papers.benchmark_views import scene_view
from antumbra.papers.srdh.srdh_measurements import Workload, check_rtsah, even_lines, opposite
from antumbra.query.shadow_query import segments


@pytest.fixture(scope="module", params=["cellar", "atrium", "blinds"])
def work(request):
    return Workload(scene_view(request.param, procedural(request.param, triangles=3000), (24, 24)), 1, None)


def test_the_order_is_right_for_its_lines(work):
    found = check_rtsah(work)
    assert found.lines < 0.97 and found.lines_reversed > 1.03
    assert 0.3 < found.rays < 3.0 and 0.3 < found.rays_reversed < 3.0


def test_lines_go_between_points_of_a_sphere_around_the_scene(work):
    query = even_lines(work.triangles)
    ends, above = segments(query)
    assert above.all() and np.prod(above.shape) > 50_000
    corners = work.triangles.vertices.reshape(-1, 3).astype(float)
    middle, reach = (corners.min(0) + corners.max(0)) / 2, np.linalg.norm(np.ptp(corners, axis=0)) / 2
    for points in query.origins, ends:
        away = np.linalg.norm(points - middle, axis=-1)
        np.testing.assert_allclose(away, 1.002 * reach, rtol=1e-3)


def test_the_opposite_order_is_the_same_tree(work):
    vertices = work.triangles.vertices
    bvh = binned_sah.build(vertices, 1)
    turned = opposite(bvh)
    validate(turned, vertices)
    np.testing.assert_array_equal(turned.links[:, 12], bvh.links[:, 13])
    np.testing.assert_array_equal(opposite(turned).nodes, bvh.nodes)
