"""Promises of `srdh` beyond those of all builders. `test_builders` tests it with rays too."""

import hypothesis.strategies as st
import numpy as np
import pytest
from hypothesis import given

import oracle
from antumbra.base.errors import InputError
from antumbra.bvh import binned_sah, top_down
from antumbra.bvh.nodes import BACK_TO_FRONT, FRONT_TO_BACK, LEFT_FIRST, MAX_DEPTH, UNORDERED
from antumbra.bvh.refit import refit
from antumbra.bvh.tree_quality import statistics, validate
from antumbra.engine.method_registry import BUILDERS
from antumbra.techniques.srdh import srdh_builder
from antumbra.techniques.srdh.srdh_builder import KERNELS, SrdhOptions
from antumbra.trace.rays.ray_hits import Intersections
from antumbra.trace.rays.ray_traversal import BUILT, RANDOM, SRDH
from antumbra.trace.rays.single_rays import leaf_depths
from bvh_scenes import HAZARDS, nested_clusters, scattered, terrain
from reference_srdh import FAR, LEFT, NEAR, RIGHT, candidates, ray_sets, scene_of
from reference_srdh import srdh as heuristic
from shadow_rays import met, met_in, nested, segments_in, walked
from strategies import point_arrays, soups
from strength import examples

CHOICES = {"constant": [LEFT, RIGHT], "distance": [NEAR, FAR], "all": [LEFT, RIGHT, NEAR, FAR]}
KERNEL_OF = {LEFT_FIRST: LEFT, FRONT_TO_BACK: NEAR, BACK_TO_FRONT: FAR, UNORDERED: None}
WORDS = {"constant": {LEFT_FIRST}, "distance": {FRONT_TO_BACK, BACK_TO_FRONT}}
WORDS["all"] = WORDS["constant"] | WORDS["distance"]


def same(a, b):
    return all(x.tobytes() == y.tobytes() for x, y in zip(a, b, strict=True))


def words(bvh):
    return set(np.unique(bvh.links[:, 14]).tolist())


# Correct trees


@examples(120)
@given(
    vertices=soups(150) | point_arrays((30, 3)) | point_arrays((3, 3)),
    max_leaf=st.sampled_from([1, 4, 8]),
    kernels=st.sampled_from(sorted(KERNELS)),
    prior=st.sampled_from([0.0, 16.0]),
    linear=st.booleans(),
    reorder=st.booleans(),
    m=st.integers(1, 80),
    seed=st.integers(0, 2**32 - 1),
)
def test_any_soup_and_rays(vertices, max_leaf, kernels, prior, linear, reorder, m, seed):
    rays = met_in(vertices, m, seed)
    bvh = srdh_builder.build(vertices, 1, max_leaf, rays=rays, options=SrdhOptions(kernels, prior, linear, reorder))
    validate(bvh, vertices)
    assert statistics(bvh).leaf_sizes[max_leaf + 1 :].sum() == 0
    assert words(bvh) <= WORDS[kernels] | {UNORDERED}
    assert (bvh.links[:, 15] == 0).all()


@pytest.mark.parametrize("name", HAZARDS)
@pytest.mark.parametrize("max_leaf, options", [(4, SrdhOptions()), (1, SrdhOptions("all", 0.0, True))], ids=str)
def test_hazards(name, max_leaf, options, monkeypatch):
    monkeypatch.setattr(top_down, "MIN_PARALLEL_RANGE", 200)
    vertices = np.ascontiguousarray(HAZARDS[name], np.float32)
    bvh = srdh_builder.build(vertices, 2, max_leaf, rays=met_in(vertices), options=options)
    validate(bvh, vertices)
    assert statistics(bvh).depth <= MAX_DEPTH


def _one_ray_through_all(n):
    vertices = np.repeat(np.float32([[[-1, -1, 0], [2, -1, 0], [-1, 2, 0]]]), n, axis=0)
    vertices[:, :, 2] = np.linspace(0, 1, n, dtype=np.float32)[:, None]
    return vertices, np.float32([[0, 0, -1]]), np.float32([[0.1, 0, 2]])


RAYS = {
    "many alike": lambda v: [np.repeat(a[:1], 500, axis=0) for a in segments_in(v, 4)],
    "without length": lambda v: [segments_in(v, 30)[0]] * 2,
    "far outside": lambda v: [a + np.float32(1e7) for a in segments_in(v, 30)],
    "huge": lambda v: [a * np.float32(1e30) for a in segments_in(v, 30)],
    "parallel to axes": lambda v: (np.zeros((30, 3), np.float32), np.tile(np.eye(3, dtype=np.float32) * 9, (10, 1))),
    "one": lambda v: segments_in(v, 1),
}


@pytest.mark.parametrize("kernels", KERNELS)
@pytest.mark.parametrize("name", RAYS)
def test_odd_rays(name, kernels, monkeypatch):
    monkeypatch.setattr(top_down, "MIN_PARALLEL_RANGE", 500)
    vertices = terrain(2000)
    rays = met(vertices, *RAYS[name](vertices))
    assert (len(rays.prims) > 0) == (name not in ("without length", "far outside", "huge"))
    for prior in (0.0, 16.0):
        bvh = srdh_builder.build(vertices, 2, rays=rays, options=SrdhOptions(kernels, prior))
        validate(bvh, vertices)
        assert (words(bvh) == {UNORDERED}) == (len(rays.prims) == 0)


@pytest.mark.parametrize("max_leaf", [1, 4])
def test_a_ray_that_meets_everything(max_leaf, monkeypatch):
    monkeypatch.setattr(top_down, "MIN_PARALLEL_RANGE", 300)
    vertices, *segment = _one_ray_through_all(3000)
    rays = met(vertices, *segment)
    assert len(rays.prims) == 3000
    bvh = srdh_builder.build(vertices, 2, max_leaf, rays=rays)
    validate(bvh, vertices)
    prim, _, tests = walked(bvh, SRDH, *segment)
    assert prim[0] >= 0 and tests[0] <= 2 * statistics(bvh).depth + 2


def test_ranges_that_find_no_room_for_their_rays_go_on_by_the_sah(monkeypatch):
    """A row of triangles. Half of the rays meet all of them; the others only enter all of their boxes."""
    n, rng = 300, np.random.default_rng(1)
    vertices = np.repeat(np.float32([[[0, 0, 0], [1, 0, 0], [0, 1, 0]]]), n, axis=0)
    vertices[:, :, 2] = np.arange(n)[:, None]
    origins, ends = rng.uniform(0.55, 0.95, (2, 60, 3)).astype(np.float32)
    origins[:, 2], ends[:, 2] = -1, n
    shift = np.float32([0.5, 0.5, 0])
    rays = met(vertices, np.concatenate([origins, origins - shift]), np.concatenate([ends, ends - shift]))
    assert len(rays.prims) == 60 * n
    roomy = srdh_builder.build(vertices, 1, rays=rays)
    monkeypatch.setattr(srdh_builder, "MAX_WAITING_RAYS", 0)
    cramped = srdh_builder.build(vertices, 1, rays=rays)
    validate(cramped, vertices)
    assert not same(cramped, roomy) and words(cramped) == words(roomy) == {UNORDERED, LEFT_FIRST}


def test_deep_trees_end_in_time():
    sizes = 8.0 ** np.repeat(np.arange(-41, 40), 3)
    vertices = (sizes[:, None, None] * (1 + np.random.default_rng(0).random((len(sizes), 3, 3)))).astype(np.float32)
    for soup in (vertices, nested_clusters()):
        for linear in (False, True):
            bvh = srdh_builder.build(soup, 1, 1, rays=met_in(soup, 200), options=SrdhOptions(prior=0.0, linear=linear))
            validate(bvh, soup)
            assert statistics(bvh).depth <= MAX_DEPTH


# The same tree for any number of threads


@pytest.mark.parametrize("kernels", KERNELS)
@pytest.mark.parametrize("small", [300, 4096])
def test_same_bits_for_any_number_of_threads(kernels, small, monkeypatch):
    monkeypatch.setattr(top_down, "MIN_PARALLEL_RANGE", small)
    vertices = terrain(20_000) if small == 4096 else scattered(4000)
    rays = met_in(vertices, 500)
    first = srdh_builder.build(vertices, 1, rays=rays, options=SrdhOptions(kernels))
    validate(first, vertices)
    assert words(first) >= WORDS[kernels] and not same(first, binned_sah.build(vertices, 1))
    for threads in (1, 2, 5):
        assert same(first, srdh_builder.build(vertices, threads, rays=rays, options=SrdhOptions(kernels)))


def test_a_top_of_all_threads_changes_no_triangle_of_a_leaf(monkeypatch):
    """All threads together split a range by the same rule as one thread."""
    vertices, trees = scattered(3000), []
    rays = met_in(vertices, 300)
    for small in (100, 4096):
        monkeypatch.setattr(top_down, "MIN_PARALLEL_RANGE", small)
        trees.append(srdh_builder.build(vertices, 2, rays=rays, options=SrdhOptions("all")))
    one, other = (
        [sorted(t.prim_ids[~k >> 3 :][: (~k & 7) + 1]) for k in t.links[:, 12:14].flat if k < 0] for t in trees
    )
    assert sorted(one) == sorted(other)


@pytest.mark.parametrize("name", [n for n in BUILDERS if n.startswith("srdh")])
def test_without_rays_the_tree_is_that_of_bsah(name):
    none = Intersections(*np.zeros((2, 0, 3), np.float32), np.zeros(1, np.int64), np.zeros(0, np.int32))
    for vertices in (terrain(6000), scattered(1), np.zeros((0, 3, 3), np.float32)):
        plain = binned_sah.build(vertices, 2, max_leaf=4)
        for rays in (None, none):
            assert same(BUILDERS[name].build(vertices, 2, max_leaf=4, rays=rays), plain)


def test_rays_that_come_to_nothing_leave_the_tree_to_the_sah():
    vertices = terrain(3000)
    away = np.full((5, 3), 1e3, np.float32), np.full((5, 3), 2e3, np.float32)
    far = srdh_builder.build(vertices, 1, rays=met(vertices, *away))
    assert words(far) == {UNORDERED}
    validate(far, vertices)


def test_left_children_come_right_behind_their_parents():
    vertices = terrain(20_000)
    left = srdh_builder.build(vertices, rays=met_in(vertices, 500)).links[:, 12]
    inner = np.flatnonzero(left >= 0)
    assert len(inner) > 100 and np.array_equal(left[inner], inner + 1)


def test_refitting_keeps_the_orders():
    vertices = terrain(6000)
    bvh = srdh_builder.build(vertices, 2, rays=met_in(vertices, 500), options=SrdhOptions("all"))
    moved = (vertices * np.float32(1.5)).astype(np.float32)
    for threads in (1, 3):
        after = refit(bvh, moved, threads)
        validate(after, moved)
        assert np.array_equal(after.links[:, 12:], bvh.links[:, 12:]) and len(words(after)) == 4


@pytest.mark.parametrize("kernels", ["", "constants", None, 3])
def test_unknown_kernels(kernels):
    with pytest.raises(InputError, match="choose one of constant, distance, all"):
        srdh_builder.build(scattered(3), options=SrdhOptions(kernels))


# Good trees


@pytest.mark.parametrize("kernels", KERNELS)
@pytest.mark.parametrize("prior, linear", [(0.0, True), (16.0, False)], ids=["paper", "ours"])
@pytest.mark.parametrize("small", [60, 4096], ids=["with a top", "alone"])
def test_every_node_is_split_as_the_paper_says(kernels, prior, linear, small, monkeypatch):
    """At every node, with the ray sets of Sec. 3.4, no plane and kernel costs less than the builder's choice."""
    monkeypatch.setattr(top_down, "MIN_PARALLEL_RANGE", small)
    vertices = scattered(260, 5)
    origins, ends = segments_in(vertices, 40, 6)
    options = SrdhOptions(kernels, prior, linear, reorder=False)
    bvh = srdh_builder.build(vertices, 2, 1, rays=met(vertices, origins, ends), options=options)
    scene, checked = scene_of(vertices, origins, ends, oracle.all_hits(vertices, origins, ends)), []

    def ids_of(tree):
        return tree if isinstance(tree, list) else ids_of(tree[0]) + ids_of(tree[1])

    def check(tree, rays):
        if isinstance(tree, list) or len(rays) == 0:
            return
        left, right, kernel = np.array(ids_of(tree[0])), np.array(ids_of(tree[1])), KERNEL_OF[tree[2]]
        ids = np.concatenate([left, right])
        assert (kernel is None) == (not scene.hits[np.ix_(rays, ids)].any())
        price = lambda a, b, kernels: srdh_of(a, b, rays, kernels).values()
        mine = min(least for least, _ in price(left, right, [kernel or LEFT]))
        others = [c for side in candidates(vertices[ids]) for c in price(ids[side], ids[~side], CHOICES[kernels])]
        if others:  # otherwise all centroids fall into one bin, and the range is halved
            assert mine <= min(most for _, most in others) * (1 + 2e-6)
            checked.append(kernel)
        first, second = ray_sets(scene, left, right, rays, kernel)
        check(tree[0], first)
        check(tree[1], second)

    def srdh_of(a, b, rays, kernels):
        return heuristic(scene, a, b, rays, kernels, prior, linear)

    check(nested(bvh), np.arange(len(origins)))
    assert len(checked) > 80 and None in checked
    assert {k for k in checked if k} <= {KERNEL_OF[w] for w in WORDS[kernels]}
    assert kernels == "constant" or len({*checked}) > 2


def _window():
    """A few triangles that close a window, and many small ones around it. No ray meets the small ones."""
    rng = np.random.default_rng(1)
    pane = np.array([[-1, 8, -1], [0.9, 8, -1], [-1, 8, 0.9]]), np.array([[1, 8, 1], [1, 8, -0.9], [-0.9, 8, 1]])
    centre = rng.uniform((-8, 6, -8), (8, 9, 8), (12_000, 1, 3))
    wall = (centre + rng.normal(0, 0.05, (12_000, 3, 3)))[(abs(centre[:, 0, [0, 2]]) > 1.5).any(1)]
    vertices = np.concatenate([wall, np.stack(pane)]).astype(np.float32)
    origins, ends = (rng.uniform((-1, y, -1), (1, y, 1), (600, 3)).astype(np.float32) for y in (0, 10))
    return vertices, len(wall), origins, ends


@pytest.mark.parametrize("name", [n for n in BUILDERS if n.startswith("srdh")])
def test_frequent_blockers_lie_high_and_few_boxes_are_tested(name):
    vertices, first, origins, ends = _window()
    plain = BUILDERS["bsah"].build(vertices, 2, max_leaf=1)
    tree = BUILDERS[name].build(vertices, 2, max_leaf=1, rays=met(vertices, origins[:200], ends[:200]))
    validate(tree, vertices)
    high, deep = (leaf_depths(bvh)[np.argsort(bvh.prim_ids)][first:].mean() for bvh in (tree, plain))
    assert high < 0.8 * deep
    others = origins[200:], ends[200:]  # rays that are not in the representative set
    prim, _, few = walked(tree, BUILT, *others)
    assert (prim >= 0).mean() > 0.8
    for order, times in ((BUILT, 0.9), (RANDOM, 0.8)):
        same_prim, _, many = walked(plain, order, *others)
        assert np.array_equal(same_prim >= 0, prim >= 0) and few.sum() < times * many.sum()
