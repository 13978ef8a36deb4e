"""The heuristic's split has the least cost by the paper's formula."""

import hypothesis.strategies as st
import numpy as np
import pytest
from hypothesis import given

import oracle
from antumbra.bvh.binned_split import BIN_BOXES, BIN_COUNTS, Bins, clear_bins, fill_bins, make_mapping
from antumbra.bvh.nodes import BACK_TO_FRONT, FRONT_TO_BACK, LEFT_FIRST, UNORDERED, aligned_empty
from antumbra.bvh.triangle_bounds import area_scale_for, make_records
from antumbra.kernels.jit import kernel
from antumbra.kernels.simd import load8, ptr, stack_f32, stack_i32
from antumbra.techniques.srdh.ray_split import HeuristicSettings, SetSize, ray_hit_set, ray_split, rays_of
from antumbra.techniques.srdh.srdh_builder import KERNELS
from bvh_scenes import scattered, terrain
from reference_srdh import FAR, LEFT, NEAR, RIGHT, candidates, scene_of, srdh
from shadow_rays import met, segments_in
from strategies import soups
from strength import examples

CLOSE = 1 + 2e-6  # areas are float32, so costs of the package and of the reference differ by a few roundings
CHOICES = {"constant": [LEFT, RIGHT], "distance": [NEAR, FAR], "all": [LEFT, RIGHT, NEAR, FAR]}
ORDERS = {(LEFT_FIRST, False): LEFT, (LEFT_FIRST, True): RIGHT, (FRONT_TO_BACK, False): NEAR}
ORDERS[BACK_TO_FRONT, False] = FAR


@kernel
def _split(records, bounds, set_, settings):
    bins = Bins(stack_f32(BIN_BOXES), stack_i32(BIN_COUNTS))
    mapping = make_mapping(load8(ptr(bounds), 8), len(records))
    clear_bins(bins, mapping.n_bins)
    fill_bins(ptr(records), 0, len(records), mapping, bins)
    rays, box = rays_of(set_, SetSize(np.int64(0), np.int64(0))), load8(ptr(bounds), 0)
    chosen = ray_split(bins, rays, np.int64(len(set_.rays)), mapping, box, settings)
    return chosen.split.axis, chosen.split.place, chosen.order, chosen.swapped, chosen.cost, mapping.n_bins


def split(vertices, found, kernels, prior, linear):
    """(left side or None, order, swapped, cost): the package's choice for all triangles and all rays."""
    flat, records = vertices.reshape(-1, 9), aligned_empty((len(vertices), 8), "f4")
    box, centroids = make_records(flat, records, 1)
    chosen = HeuristicSettings(area_scale_for(box), np.int64(KERNELS[kernels]), np.float64(prior), bool(linear))
    axis, place, order, swapped, cost, n_bins = _split(
        records, np.concatenate([box, centroids]), ray_hit_set(found, flat), chosen
    )
    if axis < 0:
        return None, order, swapped, cost
    centre, f = (vertices.min(1) + vertices.max(1))[:, axis], np.float32
    factor = f(n_bins) * f(1 - 2.0**-20) / (centre.max() - centre.min())
    return (centre - centre.min()) * factor < f(place), order, swapped, cost


def check(vertices, origins, ends, kernels, prior, linear):
    """Compare with all planes and kernels of the reference; return (share of unambiguous costs, kernel chosen)."""
    found = met(vertices, origins, ends)
    scene = scene_of(vertices, origins, ends, oracle.all_hits(vertices, origins, ends))
    rays, all_ids = np.arange(len(origins)), np.arange(len(vertices))
    side, order, swapped, cost = split(vertices, found, kernels, prior, linear)
    splits = list(candidates(vertices))
    if side is None:
        assert not splits and np.isinf(cost) and order == UNORDERED
        return 1.0, None
    price = lambda left: srdh(scene, all_ids[left], all_ids[~left], rays, CHOICES[kernels], prior, linear)
    costs = [price(left) for left in splits]
    if not scene.hits.any():
        assert order == UNORDERED and not swapped
        chosen = CHOICES[kernels][0]  # all kernels cost the same
    else:
        chosen = ORDERS[order, bool(swapped)]
        assert chosen in CHOICES[kernels]
    least, most = price(side)[chosen]
    assert least / CLOSE <= cost <= most * CLOSE
    assert least <= min(c[k][1] for c in costs for k in c) * CLOSE
    return np.mean([c[k][0] == c[k][1] for c in costs for k in c]), chosen


@examples(60)
@given(
    vertices=soups(60),
    seed=st.integers(0, 2**32 - 1),
    m=st.integers(1, 40),
    kernels=st.sampled_from(sorted(KERNELS)),
    prior=st.sampled_from([0.0, 0.0, 1.0, 16.0]),
    linear=st.booleans(),
)
def test_no_split_of_any_soup_costs_less(vertices, seed, m, kernels, prior, linear):
    check(vertices, *segments_in(vertices, m, seed), kernels, prior, linear)


@pytest.mark.parametrize("kernels", KERNELS)
@pytest.mark.parametrize("n", [3, 60, 300, 700], ids=lambda n: f"{min(32, 4 + n // 16)} bins")
def test_no_split_costs_less(n, kernels):
    """Positions where rounding decides little, with 4 to 32 bins."""
    clear, chosen = [], []
    for seed, (prior, linear) in enumerate([(0.0, True), (0.0, False), (16.0, True), (2.5, False)] * 3):
        vertices = scattered(n, seed) if seed % 2 else terrain(n, seed) + np.float32(0.1)
        from_, to = segments_in(vertices, 50, seed)
        counts = check(vertices, *((to, from_) if seed % 3 else (from_, to)), kernels, prior, linear)
        clear.append(counts[0])
        chosen.append(counts[1])
    assert np.mean(clear) > 0.98
    assert len(set(chosen)) > 1 or n == 3


def test_the_cost_is_that_of_hand():
    """The formula of Sec. 3.3 by hand, for two triangles, one on each side, and a few known rays."""
    left = np.float32([[0, 0, 0], [1, 0, 0], [0, 1, 0]])
    vertices = np.stack([left, left + np.float32([10, 0, 0])])
    origins = np.float32([[0.2, 0.2, 1], [0.2, 0.2, 1], [10.2, 0.2, 1], [5, 5, 1], [0.9, 0.9, 1]])
    ends = np.float32([[0.2, 0.2, -1], [0.2, 0.2, -1], [10.2, 0.2, -1], [5, 5, -1], [0.9, 0.9, -1]])
    # two rays meet the left triangle, one meets the right one, one misses all, and one only enters the left box
    side, order, _, cost = split(vertices, met(vertices, origins, ends), "constant", 0.0, True)
    assert side.tolist() == [True, False] and order == LEFT_FIRST and cost == 4.0


def test_the_order_is_that_in_which_a_ray_ends_soonest():
    vertices = np.float32([[[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[10, 0, -1], [11, 0, 0], [10, 1, 0]]])
    origins, ends = np.float32([[0.2, 0.2, 0.01]]), np.float32([[10.1, 0.2, -0.46]])  # enters both boxes, meets one
    for mirror in (1, -1):
        flip = np.float32([mirror, 1, 1])
        found = met(vertices * flip, origins * flip, ends * flip)
        assert found.prims.tolist() == [0]
        side, order, swapped, cost = split(vertices * flip, found, "constant", 0.0, True)
        assert side.tolist() == [mirror > 0, mirror < 0] and order == LEFT_FIRST
        assert swapped == (mirror < 0) and cost == 1.0


@pytest.mark.parametrize("kernels", KERNELS)
def test_rays_that_meet_nothing_choose_no_order(kernels):
    vertices = scattered(100)
    away = np.float32([[50, 50, 50]] * 3), np.float32([[60, 50, 50]] * 3)
    side, order, swapped, cost = split(vertices, met(vertices, *away), kernels, 0.0, True)
    assert side is not None and order == UNORDERED and not swapped and cost == 0.0
    near = segments_in(vertices, 400, 1)
    near = [a[met(vertices, *near).first[1:] == met(vertices, *near).first[:-1]] for a in near]
    assert len(near[0]) > 50
    side, order, swapped, cost = split(vertices, met(vertices, *near), kernels, 0.0, True)
    assert order == UNORDERED and not swapped and cost > 0.0
