"""Traversal orders: they change no answer, and the work equals the cost metric exactly."""

import hypothesis.strategies as st
import numpy as np
import pytest
from hypothesis import given

import antumbra as at
import oracle
from antumbra.bvh import binned_sah
from antumbra.bvh.nodes import BACK_TO_FRONT, FRONT_TO_BACK, LEFT_FIRST, UNORDERED
from antumbra.bvh.tree_quality import validate
from antumbra.engine.method_registry import BUILDERS, TRACERS
from antumbra.lab.papers.published_methods import ORDERS
from antumbra.techniques.srdh import srdh_builder
from antumbra.trace.rays.ray_traversal import BUILT, CLOSEST, NEAREST, RANDOM, SRDH, Ordered
from antumbra.trace.rays.single_rays import leaf_depths
from bvh_scenes import scattered, terrain
from reference_srdh import FAR, NEAR, box_of, left_first, pierces, scene_of, visit
from shadow_rays import met, nested, segments_in, walked
from strategies import soups
from strength import examples

VALUES = {"as built": BUILT, "nearest": NEAREST, **{name: order.value for name, order in ORDERS.items()}}


def test_every_order_is_a_tracer_of_its_own():
    bvh = binned_sah.build(scattered(50), 1)
    for name, order in ORDERS.items():
        made = TRACERS[f"single:{name}"].prepare(bvh, 1)
        assert isinstance(made, Ordered) and made.order == order.value
        assert (made.bvh is bvh) == (name != "rtsah")
    assert TRACERS["single"].prepare(bvh, 1) == Ordered(bvh, BUILT)
    assert len({t.description for t in TRACERS.values()}) == len(TRACERS)


@examples(40)
@given(vertices=soups(60), seed=st.integers(0, 2**32 - 1), kernels=st.sampled_from([None, "constant", "all"]))
def test_any_hit_equals_the_oracle(vertices, seed, kernels):
    origins, ends = segments_in(vertices, 100, seed)
    shown = met(vertices, origins[:20], ends[:20]) if kernels else None
    bvh = srdh_builder.build(vertices, 1, rays=shown, options=srdh_builder.SrdhOptions(kernels or "constant"))
    truth = oracle.all_hits(vertices, origins, ends)
    for name, value in VALUES.items():
        tree = ORDERS[name].prepare(bvh) if name in ORDERS else bvh
        prim, _, _ = walked(tree, value, origins, ends)
        np.testing.assert_array_equal(prim >= 0, truth.any(1), err_msg=name)
        assert truth[np.arange(100), prim][prim >= 0].all(), name


@pytest.mark.parametrize("plan", ["bsah+single:random", "lbvh+single:back-to-front", "srdh:all+single:srdh"])
def test_pictures_are_the_same(plan):
    scene = at.procedural("cellar", triangles=2000)
    camera = scene.cameras[0].resized(32, 24)
    frame, plain = (at.render(scene, camera, scene.lights[0], spp=4, plan=p) for p in (plan, "bsah+single"))
    np.testing.assert_array_equal(frame.bits[0], plain.bits[0])
    assert 0 < frame.bits[0].any(axis=-1).mean() < 1


# The counts equal the cost metric [Feltman et al. 2012, Sec. 3.2].


@pytest.fixture(scope="module", params=["srdh", "srdh:distance", "srdh:all", "bsah"])
def case(request):
    """(bvh, reference scene, origins, ends), with one triangle in a leaf. Trees of `srdh` are built for all rays."""
    vertices = scattered(150, 2)
    origins, ends = segments_in(vertices, 300, 4)
    rays = dict(rays=met(vertices, origins, ends)) if BUILDERS[request.param].wants_rays else {}
    bvh = BUILDERS[request.param].build(vertices, 1, max_leaf=1, **rays)
    scene = scene_of(vertices, origins, ends, oracle.all_hits(vertices, origins, ends))
    assert 0.2 < scene.hits.any(1).mean() < 0.9
    return bvh, scene, origins, ends


def _kappa(scene, order, unordered=0.5):
    """The kernel of an order, or of the word in each node. `unordered`: the kernel of nodes without an order."""

    def first(word, left, right):
        chosen = {SRDH: word if word != UNORDERED else RANDOM}.get(order, order)
        if chosen in (LEFT_FIRST, RANDOM):
            return np.full(len(scene.origins), 1.0 if chosen == LEFT_FIRST else unordered)
        kernel = {FRONT_TO_BACK: NEAR, BACK_TO_FRONT: FAR}[chosen]
        return left_first(kernel, left, right, scene.origins)[0].astype(float)

    return first


def _below_the_root(costs, scene):
    """C of the root without the test of its own box, which no walk makes. A ray that misses it tests both children."""
    enters = pierces(box_of(scene, slice(None)), scene.origins, scene.ends)
    assert 0.5 < enters.mean() <= 1
    return (np.where(enters, c - 1, 2) for c in costs[:3])


@pytest.mark.parametrize("order", [LEFT_FIRST, FRONT_TO_BACK, BACK_TO_FRONT])
def test_boxes_tested_are_the_cost_of_each_ray(case, order):
    bvh, scene, origins, ends = case
    prim, _, tests = walked(bvh, order, origins, ends)
    costs, _ = visit(scene, nested(bvh), _kappa(scene, order))
    np.testing.assert_array_equal(prim >= 0, costs.hit)
    np.testing.assert_array_equal(tests, next(_below_the_root(costs, scene)))


def test_boxes_tested_in_the_order_of_the_builder_are_the_cost_of_each_ray(case):
    """At a node without a chosen order, no ray meets a triangle, unless the builder chose orders again."""
    bvh, scene, origins, ends = case
    prim, _, tests = walked(bvh, SRDH, origins, ends)
    one, other = (visit(scene, nested(bvh), _kappa(scene, SRDH, unordered))[0] for unordered in (0.0, 1.0))
    np.testing.assert_array_equal(prim >= 0, one.hit)
    (expected, least, most), (same, *_) = _below_the_root(one, scene), _below_the_root(other, scene)
    assert ((least <= tests) & (tests <= most)).all()
    if bvh.links[:, 14].any():
        sure = expected == same
        assert sure.mean() > 0.95
        np.testing.assert_array_equal(tests[sure], expected[sure])


@pytest.mark.parametrize("order", [RANDOM, NEAREST, BUILT])
def test_boxes_tested_lie_between_the_best_and_the_worst_order(case, order):
    bvh, scene, origins, ends = case
    prim, _, tests = walked(bvh, order, origins, ends)
    costs, _ = visit(scene, nested(bvh), _kappa(scene, RANDOM))
    np.testing.assert_array_equal(prim >= 0, costs.hit)
    expected, least, most = _below_the_root(costs, scene)
    assert ((least <= tests) & (tests <= most)).all() and (least < most).any()
    assert (tests[~costs.hit] == most[~costs.hit]).all()
    if order == RANDOM:
        assert tests.sum() == pytest.approx(expected.sum(), rel=0.03)


def test_a_tree_that_knows_its_rays_costs_less(case):
    bvh, _, origins, ends = case
    if bvh.links[:, 14].any():
        counts = {order: walked(bvh, order, origins, ends)[2].sum() for order in (SRDH, RANDOM, BACK_TO_FRONT)}
        plain = walked(binned_sah.build(bvh.corners.reshape(-1, 3, 3), 1, 1), RANDOM, origins, ends)[2].sum()
        assert counts[SRDH] < min(counts[RANDOM], plain)


# Single orders


def _pair(ray_meets_both=True):
    """Two triangles in two leaves; segments along z meet both."""
    one = np.float32([[-5, -5, 0], [5, -5, 0], [0, 5, 0]])
    vertices = np.stack([one, one + np.float32([0, 0, 4])])
    bvh = binned_sah.build(vertices, 1, 1)
    assert len(bvh.nodes) == 1
    rng = np.random.default_rng(0)
    from_, to = (np.column_stack([rng.uniform(-1, 1, (4000, 2)), np.full(4000, z)]).astype(np.float32) for z in (-1, 9))
    return bvh, from_, to


def test_a_coin_falls_on_both_sides_and_in_the_same_way_each_time():
    bvh, origins, ends = _pair()
    prim, _, tests = walked(bvh, RANDOM, origins, ends)
    assert (tests == 1).all() and abs((prim == 0).mean() - 0.5) < 0.03
    np.testing.assert_array_equal(prim, walked(bvh, RANDOM, origins, ends)[0])
    np.testing.assert_array_equal(prim, walked(bvh, SRDH, origins, ends)[0])  # the builder has chosen no order
    np.testing.assert_array_equal(prim[::-1], walked(bvh, RANDOM, origins[::-1], ends[::-1])[0])


def test_coins_of_the_nodes_on_a_rays_way_have_nothing_to_do_with_each_other():
    """Copies of one triangle: each blocks the rays that the coin tosses on the path send to it."""
    vertices = np.tile(np.float32([[[-5, -5, 0], [5, -5, 0], [0, 5, 0]]]), (16, 1, 1))
    bvh, (_, origins, ends) = binned_sah.build(vertices, 1, 1), _pair()
    found = np.bincount(walked(bvh, RANDOM, origins, ends)[0], minlength=16)[bvh.prim_ids]
    expected = len(origins) * 0.5 ** leaf_depths(bvh)
    assert (abs(found - expected) < 5 * np.sqrt(expected)).all()


def test_the_word_of_a_node_is_what_is_done():
    bvh, origins, ends = _pair()
    left = bvh.prim_ids[~bvh.links[0, 12] >> 3]
    centres = bvh.nodes[0, [8, 9]]
    assert centres.max() == 4 and centres[0] < centres[1]
    right = 1 - left
    for word, forth, back in ((LEFT_FIRST, left, left), (FRONT_TO_BACK, left, right), (BACK_TO_FRONT, right, left)):
        bvh.links[0, 14] = word
        for order in (BUILT, SRDH, word):
            assert (walked(bvh, order, origins, ends)[0] == forth).all()
            assert (walked(bvh, order, ends, origins)[0] == back).all()
        assert (walked(bvh, NEAREST, ends, origins)[0] == right).all()
    bvh.links[0, 14] = UNORDERED
    assert (walked(bvh, BUILT, origins, ends)[0] == left).all()
    assert (walked(bvh, BUILT, ends, origins)[0] == right).all()


def test_the_closest_hit_does_not_look_at_orders():
    vertices = terrain(1500)
    origins, ends = segments_in(vertices, 400, 8)
    bvh = srdh_builder.build(vertices, 1, rays=met(vertices, origins, ends), options=srdh_builder.SrdhOptions("all"))
    assert len(np.unique(bvh.links[:, 14])) > 2
    found = walked(bvh, CLOSEST, origins, ends)
    bvh.links[:, 14] = UNORDERED
    for one, other in zip(found, walked(bvh, CLOSEST, origins, ends)):
        np.testing.assert_array_equal(one, other)
    plain = walked(ORDERS["rtsah"].prepare(binned_sah.build(vertices, 1)), CLOSEST, origins, ends)
    np.testing.assert_array_equal(found[0], plain[0])
    np.testing.assert_array_equal(found[1], plain[1])
    validate(bvh, vertices)
