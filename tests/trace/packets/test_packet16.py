"""Packets of rays and the paper's frusta: their counters, and large numbers of cases that float32 cannot decide."""

import numpy as np
import pytest

import antumbra as at
from antumbra.engine.plan import Plan
from antumbra.trace.counters import as_dict, new_counters
from antumbra.trace.triangle_tests import DEFERRED
from asking import answer, query_of

TRACERS = ("packet16", "packet16:samples", "packet256", "multifrusta:paper")
SHRINKING = ("multifrusta:leaf-boxes", "multifrusta:corners", "multifrusta:full")


@pytest.fixture(scope="module")
def counted():
    """Tracer -> counters of one query of a forest. All bits are the same."""
    scene = at.procedural("forest", triangles=10_000)
    triangles, query = query_of(scene, scene.cameras[0].resized(64, 48), scene.lights[0], 16)
    truth, counts = answer(Plan(), triangles, query), {}
    assert 0.1 < truth.mean() < 0.9
    for name in TRACERS + SHRINKING:
        counters = new_counters()
        np.testing.assert_array_equal(answer(Plan(trace=name), triangles, query, counters=counters), truth)
        counts[name] = as_dict(counters)
    return counts


def test_all_ask_the_same_rays(counted):
    assert len({(c["rays"], c["below_horizon"]) for c in counted.values()}) == 1


def test_frusta_test_fewer_boxes_than_packets(counted):
    paper = counted["multifrusta:paper"]
    for packets in ("packet16", "packet16:samples", "packet256"):
        assert counted[packets]["box_tests"] > 3 * paper["box_tests"]
    assert counted["packet256"]["triangles"] < paper["triangles"]  # rays are tighter than the frusta around them


def test_corner_rays_cull_at_leaves(counted):
    paper = counted["multifrusta:paper"]
    assert 0 < paper["candidates"] < 2 / 3 * paper["triangles"]  # leaves of four triangles leave less to cull
    assert paper["triangle_tests"] < 16 * paper["candidates"]


def test_what_each_way_of_shrinking_saves_and_costs(counted):
    paper, boxes, corners, full = (counted[n] for n in ("multifrusta:paper", *SHRINKING))
    assert paper["shrinks"] == boxes["shrinks"] == 0 < corners["shrinks"]
    assert boxes["box_tests"] > paper["box_tests"] and boxes["triangle_tests"] < paper["triangle_tests"]
    assert (corners["nodes"], corners["triangles"]) == (paper["nodes"], paper["triangles"])
    assert corners["triangle_tests"] < paper["triangle_tests"]
    assert full["triangles"] < corners["triangles"] and full["triangle_tests"] <= corners["triangle_tests"]


@pytest.mark.parametrize("name", [*TRACERS, "wide", "wide:samples", *SHRINKING])
def test_more_uncertain_segments_than_can_be_put_deferred(name):
    """Triangles with hardly an area, and one real occluder. They are so long that float32 cannot decide any ray."""
    far = np.random.default_rng(1).uniform(4e4, 5e4, 400)
    start, end = np.stack([-far, 0 * far + 2, -far], -1), np.stack([far, 0 * far + 2, far], -1)
    slivers = np.stack([start, end, end + (0, 0.004, 0)], 1)
    floor = [[[-3, 0, -3], [-3, 0, 3], [3, 0, 3]], [[-3, 0, -3], [3, 0, 3], [3, 0, -3]]]
    occluder = [[[0.02, 1, -3], [0.02, 1, 3], [4, 1, 0]]]
    scene = at.Scene.from_arrays(np.concatenate([slivers, floor, occluder]))
    camera = at.Camera((0, 0.5, 0.01), (0, 0, 0), width=8, height=4, vfov=20)
    triangles, query = query_of(scene, camera, at.QuadLight((-0.1, 4, -0.1), (0.2, 0, 0), (0, 0, 0.2)), 16)
    counters = new_counters()
    found = answer(Plan(trace=name), triangles, query, counters=counters)
    assert as_dict(counters)["uncertain"] > 4 * DEFERRED
    assert 0.1 < found.mean() < 0.9
    np.testing.assert_array_equal(found, answer(Plan(), triangles, query))
