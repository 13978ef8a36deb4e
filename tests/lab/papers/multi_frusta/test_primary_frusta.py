"""Packets and frusta of primary rays have the hits of the ordinary primary tracer, bit for bit."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from antumbra.bvh import binned_sah
from antumbra.bvh.block_tree import block_tree
from antumbra.engine.scene import procedural
from antumbra.lab.papers.multi_frusta.moeller_trumbore import deep_tree, trace_packets
from antumbra.lab.papers.multi_frusta.primary_frusta import trace_frusta
from antumbra.lab.papers.multi_frusta.published_frusta import BLOCK
from antumbra.trace.counters import as_dict, new_counters
from antumbra.trace.primary.primary_rays import trace_primary
from raster_scenes import FAMILIES, SHAPES, view
from strength import examples


def hits_of_all(triangles, rays):
    """The hits of the ordinary tracer, after a comparison with all others, and the counters of each by name."""
    bvh = binned_sah.build(np.ascontiguousarray(triangles, np.float32).reshape(-1, 3, 3), 1)
    deep, shallow = deep_tree(bvh, 1), block_tree(bvh, 1, BLOCK)
    counters = {name: new_counters() for name in ("packets", "frusta", "entries")}
    truth = trace_primary(block_tree(bvh, 1), rays, 1)
    for hits in (
        trace_packets(deep, rays, 1, counters["packets"]),
        trace_frusta(shallow, rays, 1, counters["frusta"]),
        trace_frusta(shallow, rays, 1, counters["entries"], entries=True),
    ):
        for ours, theirs in zip(hits, truth):
            np.testing.assert_array_equal(ours, theirs)
    return truth, {name: as_dict(values) for name, values in counters.items()}


@pytest.mark.parametrize("family", FAMILIES)
@examples(20)
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
    hits_of_all(scale * np.asarray(triangles, float).reshape(-1, 3, 3), rays)


@pytest.fixture(scope="module")
def cellar():
    scene = procedural("cellar", triangles=3000)
    triangles = scene.triangles()
    return triangles, scene.cameras[0].resized(150, 70).rays(triangles.origin)


def test_a_scene_and_its_counts(cellar):
    triangles, rays = cellar
    (face, t), counts = hits_of_all(triangles.vertices, rays)
    packets, frusta, entries = counts.values()
    assert (face >= 0).any() and np.isfinite(t[face >= 0]).all()
    assert all(each["rays"] == 150 * 70 for each in counts.values())
    assert packets["triangles"] == packets["triangle_tests"] > 0
    assert frusta["box_tests"] == 2 * frusta["nodes"] < packets["box_tests"]
    assert 0 < frusta["candidates"] < frusta["triangles"] < packets["triangles"]
    assert 0 < entries["box_tests"] < frusta["box_tests"]


def test_threads_do_not_matter(cellar):
    triangles, rays = cellar
    bvh = binned_sah.build(triangles.vertices)
    for trace, tree in (trace_packets, deep_tree(bvh)), (trace_frusta, block_tree(bvh)):
        for ours, theirs in zip(trace(tree, rays, 3), trace(tree, rays, 1)):
            np.testing.assert_array_equal(ours, theirs)
