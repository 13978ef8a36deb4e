"""A refitted tree is a correct tree of the moved triangles. A bad tree is built again."""

import hypothesis.strategies as st
import numpy as np
import pytest
from hypothesis import given

from antumbra.base.errors import InputError
from antumbra.bvh import binned_sah, tree_layout
from antumbra.bvh.refit import LIMIT, DeformingTree, refit
from antumbra.bvh.tree_quality import sah_cost, validate
from antumbra.engine.method_registry import BUILDERS
from bvh_scenes import HAZARDS, scattered, terrain
from strategies import soups
from strength import examples


def moved(vertices, seed=0, by=0.3):
    rng = np.random.default_rng(seed)
    size = np.ptp(vertices.astype(float), axis=(0, 1)).max(initial=0.0) if len(vertices) else 0.0
    return (vertices + by * size * rng.uniform(-1, 1, vertices.shape)).astype(np.float32)


@given(
    soup=soups(150), name=st.sampled_from(sorted(BUILDERS)), max_leaf=st.integers(1, 8), seed=st.integers(0, 2**32 - 1)
)
@examples(60)
def test_any_soup_that_moves(soup, name, max_leaf, seed):
    bvh, after = BUILDERS[name].build(soup, 1, max_leaf=max_leaf), moved(soup, seed)
    validate(refit(bvh, after, 1), after)
    validate(bvh, soup)  # the old tree is unchanged


@pytest.mark.parametrize("name", [n for n in HAZARDS if n != "largest allowed"])
def test_hazards(name, monkeypatch):
    monkeypatch.setattr(tree_layout, "PART", 100)
    vertices = np.ascontiguousarray(HAZARDS[name], np.float32)
    bvh = binned_sah.build(vertices)
    validate(refit(bvh, moved(vertices), 2), moved(vertices))
    again = refit(bvh, vertices)
    assert np.array_equal(again.nodes[:, :12], bvh.nodes[:, :12]) and np.array_equal(
        again.links[:, 12:], bvh.links[:, 12:]
    )


def test_same_bits_for_any_number_of_threads():
    vertices = terrain(20_000)
    bvh, after = binned_sah.build(vertices), moved(vertices, by=0.01)
    first = refit(bvh, after, 1)
    for threads in (2, 3, None):
        assert all(a.tobytes() == b.tobytes() for a, b in zip(first, refit(bvh, after, threads), strict=True))


@pytest.mark.parametrize("bad", [np.nan, np.inf, 1e38])
@pytest.mark.parametrize("n", [1, 300])
def test_errors_of_builders(bad, n):
    vertices = scattered(n)
    bvh = binned_sah.build(vertices)
    vertices[n - 1, 1, 1] = bad
    with pytest.raises(InputError, match=f"triangle {n - 1} "):
        refit(bvh, vertices)
    with pytest.raises(InputError, match="it must be float32"):
        refit(bvh, scattered(n).astype(np.float64))
    with pytest.raises(InputError, match=rf"has {n + 1} triangles; the BVH is of {n}"):
        refit(bvh, scattered(n + 1))


class Count:
    """A builder that counts how often it builds."""

    def __init__(self):
        self.builds = 0

    def __call__(self, vertices, threads=None):
        self.builds += 1
        return binned_sah.build(vertices, threads)


def test_small_changes_are_refitted_and_large_ones_built():
    count, vertices = Count(), terrain(2000)
    deforming = DeformingTree(count)
    for shift in (0.0, 1.0, 2.0):  # a rigid move costs nothing
        after = (vertices + np.float32(shift)).astype(np.float32)
        validate(deforming.update(after), after)
    assert count.builds == 1
    after = vertices[np.random.default_rng(0).permutation(len(vertices))]
    assert sah_cost(refit(deforming.bvh, after)) > LIMIT * deforming.cost
    validate(deforming.update(after), after)
    assert count.builds == 2
    assert deforming.cost == sah_cost(deforming.bvh)


def test_another_number_of_triangles_is_built():
    count = Count()
    deforming = DeformingTree(count)
    for n in (50, 51, 51, 1, 1, 0, 0, 50):
        vertices = scattered(n)
        validate(deforming.update(vertices), vertices)
    assert count.builds == 5


def test_after_an_error_all_goes_on():
    deforming, vertices = DeformingTree(Count()), scattered(50)
    deforming.update(vertices)
    with pytest.raises(InputError):
        deforming.update(np.full_like(vertices, np.nan))
    validate(deforming.update(vertices), vertices)


def test_cost_is_the_same_for_any_number_of_threads():
    bvh = binned_sah.build(terrain(60_000))
    assert len({sah_cost(bvh, threads=threads) for threads in (1, 2, 3, None)}) == 1
