"""Promises of all builders, tested for every builder in the registry. Builders for rays get some."""

from functools import cache

import hypothesis.strategies as st
import numpy as np
import pytest
from hypothesis import given

import antumbra
from antumbra.base.errors import InputError
from antumbra.bvh import lbvh
from antumbra.bvh.nodes import EMPTY, MAX_DEPTH
from antumbra.bvh.tree_quality import sah_cost, statistics, validate
from antumbra.bvh.triangle_bounds import MAX_COORDINATE
from antumbra.engine.method_registry import BUILDERS
from bvh_scenes import HAZARDS, LARGE, integer_grid, scattered, terrain
from reference_sah import binned_sah
from scenes import scene_path
from shadow_rays import met_in
from strategies import point_arrays, soups
from strength import examples

WORSE = {lbvh.build: 1.35, lbvh.build63: 1.35}  # the largest cost of a tree relative to greedy binning


def _rays(vertices):
    """The intersections of segments through the triangles, or through others if these cannot be built."""
    good = vertices.shape[1:] == (3, 3) and vertices.dtype == np.float32 and (abs(vertices) < MAX_COORDINATE).all()
    return met_in(vertices if good else scattered(len(vertices)))


def _shown(builder):
    """The `build` of a builder, with rays through the triangles if it takes rays."""
    if not builder.wants_rays:
        return builder.build
    return lambda vertices, threads=None, **options: builder.build(vertices, threads, rays=_rays(vertices), **options)


pytestmark = pytest.mark.parametrize("build", [_shown(b) for b in BUILDERS.values()], ids=list(BUILDERS))
OF_AREAS = [b.build for b in BUILDERS.values() if not b.wants_rays]


@pytest.mark.parametrize("name", HAZARDS)
def test_hazards(build, name):
    vertices = np.ascontiguousarray(HAZARDS[name], np.float32)
    bvh = build(vertices)
    validate(bvh, vertices)
    shape = statistics(bvh)
    assert shape.leaf_sizes @ np.arange(len(shape.leaf_sizes)) == len(vertices)
    assert shape.leaf_sizes[5:].sum() == 0  # max_leaf is 4
    assert shape.depth <= MAX_DEPTH
    if len(vertices) > 1:
        assert shape.leaves == shape.nodes + 1
    if len(vertices) > 64:
        assert np.isfinite(sah_cost(bvh))


def test_no_triangle_and_one(build):
    empty, one = build(np.zeros((0, 3, 3), np.float32)), build(scattered(1))
    assert empty.links[0, 12:14].tolist() == [EMPTY, EMPTY]
    assert one.links[0, 12:14].tolist() == [~0, EMPTY]
    assert np.all(empty.nodes[0, :12].reshape(3, 2, 2) == [[[np.inf], [-np.inf]]])


@examples(60)
@given(vertices=soups(200) | point_arrays((30, 3)) | point_arrays((3, 3)), max_leaf=st.integers(1, 8))
def test_any_soup(build, vertices, max_leaf):
    bvh = build(vertices, 1, max_leaf=max_leaf)
    validate(bvh, vertices)
    assert statistics(bvh).leaf_sizes[max_leaf + 1 :].sum() == 0


@pytest.mark.parametrize("max_leaf", [1, 2, 4, 8])
def test_leaf_sizes(build, max_leaf):
    vertices = terrain(1000)
    sizes = statistics(build(vertices, max_leaf=max_leaf)).leaf_sizes
    assert sizes[max_leaf + 1 :].sum() == 0
    assert sizes[1] == len(vertices) if max_leaf == 1 else sizes[2 : max_leaf + 1].sum() > 0


@pytest.mark.parametrize("name", ["large, scattered", "large, terrain", "large, identical", "many copies of a few"])
def test_same_bits_for_any_number_of_threads(build, name):
    vertices = np.ascontiguousarray(HAZARDS[name], np.float32)
    first = build(vertices, 1)
    for threads in (2, 5):
        again = build(vertices, threads)
        assert all(a.tobytes() == b.tobytes() for a, b in zip(first, again, strict=True))


SHAPES = {"terrain": terrain(800), "scattered": scattered(700), "grid": integer_grid(512)}


@cache
def _greedy_cost(name):
    return binned_sah(SHAPES[name])[0]


@pytest.mark.parametrize("name", SHAPES)
def test_cost_is_that_of_a_good_tree(build, name):
    if build not in OF_AREAS:
        pytest.skip("made for its rays, not for those that the surface area heuristic assumes")
    assert sah_cost(build(SHAPES[name])) <= WORSE.get(build, 1.05) * _greedy_cost(name)


def test_real_scene(build):
    vertices = antumbra.load(scene_path("sponza_crytek/scene.glb")).triangles(0.0).vertices
    bvh = build(vertices)
    validate(bvh, vertices)
    assert statistics(bvh).leaf_sizes[1:5] @ [1, 2, 3, 4] == len(vertices) > 200_000


def test_memory(build):
    vertices = terrain(LARGE)
    bvh = build(vertices)
    assert statistics(bvh).bytes_per_triangle <= 104
    assert bvh.nodes.ctypes.data % 64 == 0 and np.shares_memory(bvh.nodes, bvh.links)


def test_input_is_left_alone_and_may_be_read_only(build):
    vertices = scattered(100)
    before = vertices.copy()
    vertices.setflags(write=False)
    bvh = build(vertices)
    assert np.array_equal(vertices, before) and not np.shares_memory(bvh.corners, vertices)


def test_any_memory_layout(build):
    vertices = np.asfortranarray(scattered(50))
    validate(build(vertices), vertices)


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf, 1e38])
def test_coordinates_out_of_range_are_named(build, bad):
    for n, row in ((6000, 5000), (1, 0)):
        vertices = scattered(n)
        vertices[row, 1, 2] = bad
        with pytest.raises(InputError, match=f"triangle {row} "):
            build(vertices)


@pytest.mark.parametrize(
    "arguments",
    [
        dict(vertices=np.zeros((4, 9), np.float32)),
        dict(vertices=np.zeros((4, 3, 3))),
        dict(vertices=scattered(4), threads=0),
        dict(vertices=scattered(4), max_leaf=0),
        dict(vertices=scattered(4), max_leaf=9),
    ],
    ids=["shape", "dtype", "no threads", "empty leaves", "leaves too large"],
)
def test_bad_arguments(build, arguments):
    with pytest.raises(InputError):
        build(**arguments)
