"""Packets of 16 primary rays see what multi-frusta see, bit for bit, and both count their work."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from antumbra.bvh import binned_sah
from antumbra.bvh.block_tree import block_tree
from antumbra.engine.scene import procedural
from antumbra.papers.multi_frusta.packet_baselines import deep_tree, trace_packets
from antumbra.trace.counters import as_dict, new_counters
from antumbra.trace.primary.primary_rays import trace_primary
from raster_scenes import FAMILIES, SHAPES, view


def seen_by_both(triangles, rays):
    """The hits of packets, after a comparison with those of multi-frusta, and the counters of both."""
    bvh = binned_sah.build(np.ascontiguousarray(triangles, np.float32).reshape(-1, 3, 3), 1)
    packets, frusta = new_counters(), new_counters()
    hits = trace_packets(deep_tree(bvh, 1), rays, 1, packets)
    for ours, truth in zip(hits, trace_primary(block_tree(bvh, 1), rays, 1, frusta)):
        np.testing.assert_array_equal(ours, truth)
    return hits, as_dict(packets), as_dict(frusta)


@pytest.mark.parametrize("family", FAMILIES)
@settings(max_examples=20, deadline=None)
@given(
    seed=st.integers(0, 2**32 - 1),
    n=st.integers(0, 40),
    scale=st.sampled_from([1.0, 1e-6, 1e6]),
    shape=st.sampled_from(SHAPES),
    vfov=st.sampled_from([1.0, 60.0, 170.0]),
)
def test_hard_scenes(family, seed, n, scale, shape, vfov):
    rays = view(target=(0.3, -0.2, -1), vfov=vfov, width=shape[0], height=shape[1])
    triangles = family(np.random.default_rng(seed), n, rays)
    seen_by_both(scale * np.asarray(triangles, float).reshape(-1, 3, 3), rays)


def test_a_scene_and_its_counts():
    scene = procedural("cellar", triangles=3000)
    triangles, camera = scene.triangles(), scene.cameras[0].resized(45, 38)
    (face, t), packets, frusta = seen_by_both(triangles.vertices, camera.rays(triangles.origin))
    assert (face >= 0).any() and np.isfinite(t[face >= 0]).all()
    assert packets["rays"] == 45 * 38 and packets["triangles"] == packets["triangle_tests"] > 0
    assert frusta["box_tests"] == 2 * frusta["nodes"] < packets["box_tests"]
    assert 0 < frusta["candidates"] < frusta["triangles"]


def test_threads_do_not_matter():
    scene = procedural("cellar", triangles=3000)
    triangles, camera = scene.triangles(), scene.cameras[0].resized(45, 38)
    tree, rays = deep_tree(binned_sah.build(triangles.vertices)), camera.rays(triangles.origin)
    for ours, theirs in zip(trace_packets(tree, rays, 3), trace_packets(tree, rays, 1)):
        np.testing.assert_array_equal(ours, theirs)
