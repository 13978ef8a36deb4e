"""Depths of leaves, and counted steps. `tests/picture/test_traversal_steps.py` tests the figures derived from them."""

import numpy as np
import pytest

import antumbra as at
from antumbra.bvh import binned_sah
from antumbra.engine.method_registry import BUILDERS
from antumbra.query.shadow_query import segments
from antumbra.trace.rays.ray_traversal import BUILT, RANDOM, Ordered
from antumbra.trace.rays.single_rays import FALSE, PATH, UNOCCLUDED, add_steps, count_steps, hit_depths, leaf_depths
from asking import query_of, true_occlusion
from bvh_scenes import HAZARDS
from shadow_rays import nested, walked


def _depths(tree, depth, found):
    """Triangle -> number of boxes on the path to its leaf, without the root's box."""
    if isinstance(tree, list):
        found.update(dict.fromkeys(tree, depth))
    else:
        for side in tree[:2]:
            _depths(side, depth + 1, found)
    return found


@pytest.mark.parametrize("name", ["two", "three", "all identical", "receding", "nested clusters", "integer grid"])
@pytest.mark.parametrize("max_leaf", [1, 4])
def test_leaf_depths(name, max_leaf):
    bvh = binned_sah.build(np.ascontiguousarray(HAZARDS[name], np.float32), 1, max_leaf)
    found = _depths(nested(bvh), 0, {})
    assert dict(zip(bvh.prim_ids.tolist(), leaf_depths(bvh).tolist())) == found and min(found.values()) >= 1


def test_leaf_depths_of_few_triangles():
    for name, depths in (("none", []), ("one", [1])):
        assert leaf_depths(binned_sah.build(np.ascontiguousarray(HAZARDS[name], np.float32), 1)).tolist() == depths


@pytest.fixture(scope="module")
def asked():
    scene = at.procedural("cellar", triangles=1500)
    triangles, query = query_of(scene, scene.cameras[0].resized(24, 16), scene.lights[0], 4)
    return triangles, query, BUILDERS["bsah"].build(triangles.vertices)


@pytest.mark.parametrize("order", [BUILT, RANDOM])
def test_steps_are_those_of_each_ray(asked, order):
    triangles, query, bvh = asked
    n = len(triangles.vertices)
    steps = count_steps(Ordered(bvh, order), query, n, 2)
    ends, above = segments(query)
    y, x, _ = np.nonzero(above)
    prim, _, tests = walked(bvh, order, query.origins[y, x], ends[above])  # no ray meets the surface that it starts on
    truth = (true_occlusion(triangles, query)[0] & above)[above]
    np.testing.assert_array_equal(prim >= 0, truth)
    depths = np.zeros(n, int)
    depths[bvh.prim_ids] = leaf_depths(bvh)
    wanted = np.zeros((*query.sides.shape, 3), int)
    np.add.at(wanted, (y, x, np.where(truth, PATH, UNOCCLUDED)), np.where(truth, depths[prim], tests))
    np.add.at(wanted, (y[truth], x[truth], FALSE), (tests - depths[prim])[truth])
    np.testing.assert_array_equal(steps.boxes, wanted)
    np.testing.assert_array_equal(steps.rays, above.sum(-1))
    assert steps.blocked.sum() == truth.sum() and 0 < truth.mean() < 1
    np.testing.assert_array_equal(steps.hits, np.bincount(prim[truth], minlength=n))
    np.testing.assert_array_equal(
        hit_depths(bvh, steps.hits), np.bincount(depths[prim[truth]], minlength=depths.max() + 1)
    )


def test_threads_and_sums(asked):
    triangles, query, bvh = asked
    one, three = (count_steps(Ordered(bvh, BUILT), query, len(triangles.vertices), t) for t in (1, 3))
    for a, b, both in zip(one, three, add_steps([one, three])):
        np.testing.assert_array_equal(a, b)
        np.testing.assert_array_equal(both, 2 * a)
        assert a.any()
