"""Ray sets, and the rays of a set that reach each side of a split."""

import hypothesis.strategies as st
import numpy as np
import pytest
from hypothesis import given

import oracle
from antumbra.bvh.binned_split import Split, make_mapping
from antumbra.bvh.nodes import BACK_TO_FRONT, FRONT_TO_BACK, LEFT_FIRST, UNORDERED, aligned_empty
from antumbra.bvh.triangle_bounds import make_records
from antumbra.kernels.jit import kernel
from antumbra.kernels.simd import load8, ptr
from antumbra.techniques.srdh.ray_split import HIT, RAY, RayHitSet, RaySplit, SetSize, divide_rays, ray_hit_set, rays_of
from bvh_scenes import scattered
from reference_srdh import FAR, LEFT, NEAR, RIGHT, box_of, left_first, pierces, ray_sets, scene_of
from shadow_rays import met, segments_in
from strategies import soups
from strength import examples

ORDERS = {LEFT: (LEFT_FIRST, False), RIGHT: (LEFT_FIRST, True), NEAR: (FRONT_TO_BACK, False)}
ORDERS |= {FAR: (BACK_TO_FRONT, False), None: (UNORDERED, False)}


@kernel
def _divide(set_, n, centroids, split, order, swapped, boxes, left, right):
    none = SetSize(np.int64(0), np.int64(0))
    mapping = make_mapping(load8(ptr(centroids), 0), n)
    chosen = RaySplit(split, order, swapped, np.float32(0.0))
    return divide_rays(
        rays_of(set_, none), len(set_.rays), mapping, chosen, ptr(boxes), rays_of(left, none), rays_of(right, none)
    )


def divide(vertices, found, axis, place, order, swapped):
    """(left side, ray set of the left, ray set of the right); all None if one side is empty."""
    flat, records = vertices.reshape(-1, 9), aligned_empty((len(vertices), 8), "f4")
    _, centroids = make_records(flat, records, 1)
    centre, f = (vertices.min(1) + vertices.max(1))[:, axis], np.float32
    n_bins = min(32, 4 + len(vertices) // 16)
    with np.errstate(divide="ignore", invalid="ignore"):
        left = (centre - centre.min()) * (f(n_bins) * f(1 - 2.0**-20) / np.ptp(centre)) < f(place)
    if left.all() or not left.any():
        return None, None, None
    boxes = np.zeros((2, 8), np.float32)
    for box, side in zip(boxes, (left, ~left)):
        box[:3], box[4:7] = vertices[side].min((0, 1)), -vertices[side].max((0, 1))
    set_ = ray_hit_set(found, flat)
    out = [RayHitSet(np.full_like(set_.rays, np.nan), np.full_like(set_.hits, np.nan)) for _ in range(2)]
    split = Split(np.int64(axis), np.int64(place), f(0.0))
    counts = _divide(set_, len(vertices), centroids, split, np.int64(order), swapped, boxes, *out)
    return left, *(RayHitSet(o.rays[: c.rays], o.hits[: c.hits]) for o, c in zip(out, counts))


def listed(set_):
    """(origin and direction as bytes, [twice the centroids of its hits]) of each ray of a set."""
    words = set_.rays.view(np.int32)
    ends = np.cumsum(words[:, 7])
    assert words[:, 6].tolist() == (ends - words[:, 7]).tolist() and (ends[-1] if len(ends) else 0) == len(set_.hits)
    return [(ray[:6].tobytes(), set_.hits[a : a + n, :3].tolist()) for ray, (a, n) in zip(set_.rays, words[:, 6:8])]


@examples(80)
@given(
    vertices=soups(80),
    seed=st.integers(0, 2**32 - 1),
    m=st.integers(1, 60),
    axis=st.integers(0, 2),
    place=st.integers(1, 8),
    order=st.sampled_from([LEFT, RIGHT, NEAR, FAR]),
)
def test_rays_that_come_to_a_child_of_any_soup(vertices, seed, m, axis, place, order):
    origins, ends = segments_in(vertices, m, seed)
    found = met(vertices, origins, ends)
    left, *sets = divide(vertices, found, axis, place, *ORDERS[order])
    if left is None:
        return
    scene = scene_of(vertices, origins, ends, oracle.all_hits(vertices, origins, ends))
    every = listed(ray_hit_set(found, vertices.reshape(-1, 9)))
    slack, boxes = (
        1e-5 * max(abs(a).max() for a in (vertices, origins, ends)),
        [box_of(scene, s) for s in (left, ~left)],
    )
    kappa, doubtful = left_first(order, *boxes, scene.origins)
    hit = [scene.hits[:, s].any(1) for s in (left, ~left)]
    prims = [found.prims[found.first[i] : found.first[i + 1]] for i in range(m)]
    for k, (set_, goes) in enumerate(zip(sets, (left, ~left))):
        surely, perhaps = (pierces(boxes[k], scene.origins, scene.ends, s) | hit[k] for s in (-slack, slack))
        other_first = kappa if k else ~kappa
        stopped, may_stop = hit[1 - k] & (other_first & ~doubtful), hit[1 - k] & (other_first | doubtful)
        here, next_ = listed(set_), 0
        for i in range(m):  # rays keep their order, so both lists are walked together
            mine = (every[i][0], [c for c, p in zip(every[i][1], prims[i]) if goes[p]])
            came = next_ < len(here) and here[next_] == mine
            next_ += came
            assert came or not surely[i] or may_stop[i]
            assert not came or (perhaps[i] and not stopped[i]) or mine in here[next_:] or every[i] in every[:i]
        assert next_ == len(here)


@pytest.mark.parametrize("order", ORDERS)
def test_ray_sets_are_those_of_the_paper(order):
    vertices = scattered(200)
    origins, ends = segments_in(vertices, 300, 3)
    if order is None:  # chosen only if no ray meets a triangle
        free = np.diff(met(vertices, origins, ends).first) == 0
        origins, ends = origins[free], ends[free]
    found = met(vertices, origins, ends)
    scene, ids = scene_of(vertices, origins, ends, oracle.all_hits(vertices, origins, ends)), np.arange(200)
    every = ray_hit_set(found, vertices.reshape(-1, 9))
    sizes = []
    for axis in range(3):
        left, *sets = divide(vertices, found, axis, 8, *ORDERS[order])
        wanted = ray_sets(scene, ids[left], ids[~left], np.arange(len(origins)), order)
        for set_, rays, goes in zip(sets, wanted, (left, ~left)):
            assert np.array_equal(set_.rays[:, :6], every.rays[rays, :6])
            n = scene.hits[rays][:, goes].sum(1)
            assert np.array_equal(set_.rays.view(np.int32)[:, 7], n) and len(set_.hits) == n.sum()
            sizes.append((len(rays), n.sum()))
    assert all(20 < rays < len(origins) for rays, _ in sizes)
    assert all(hits > 0 for _, hits in sizes) == (order is not None)


def test_words_of_a_set():
    vertices = scattered(50)
    origins, ends = segments_in(vertices, 30, 1)
    found = met(vertices, origins, ends)
    set_ = ray_hit_set(found, vertices.reshape(-1, 9))
    assert set_.rays.shape == (30, RAY) and set_.hits.shape == (len(found.prims), HIT)
    np.testing.assert_array_equal(set_.rays[:, :3], origins)
    np.testing.assert_allclose(set_.rays[:, 3:6], 1 / (ends - origins), rtol=1e-6)
    corners = vertices[found.prims]
    np.testing.assert_array_equal(set_.hits[:, :3], corners.min(1) + corners.max(1))


def test_reciprocals_are_finite():
    origins = np.zeros((4, 3), np.float32)
    ends = np.float32([[0, 0, 0], [1e-30, 0, 0], [1, 0, -1e-30], [1e38, 1, 0]])
    found = met(np.zeros((0, 3, 3), np.float32), origins, ends)
    assert np.isfinite(ray_hit_set(found, np.zeros((0, 9), np.float32)).rays[:, 3:6]).all()
