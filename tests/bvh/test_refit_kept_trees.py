"""The part of a tree with some triangles is a correct tree of these, with the splits of the whole tree."""

import hypothesis.strategies as st
import numpy as np
import pytest
from hypothesis import given

from antumbra.bvh import binned_sah, refit, tree_layout
from antumbra.bvh.nodes import MAX_LEAF
from antumbra.bvh.refit import filter_tree
from antumbra.bvh.tree_quality import validate
from antumbra.engine.method_registry import BUILDERS
from bvh_scenes import HAZARDS, terrain
from strategies import soups
from strength import examples


def check(bvh, vertices, chosen, threads=1):
    """Take the part of a tree with the chosen triangles, and validate it; returns the part."""
    part, before = filter_tree(bvh, chosen, threads), [array.copy() for array in bvh]
    assert sorted(part.prim_ids) == sorted(chosen)
    validate(part._replace(prim_ids=np.searchsorted(chosen, part.prim_ids).astype(np.int32)), vertices[chosen])
    assert all(a.tobytes() == b.tobytes() for a, b in zip(before, bvh, strict=True))
    return part


@given(
    soup=soups(150), name=st.sampled_from(sorted(BUILDERS)), max_leaf=st.integers(1, 8), seed=st.integers(0, 2**32 - 1),
    share=st.sampled_from([0.0, 0.05, 0.3, 0.9, 1.0]),
)  # fmt: skip
@examples(60)
def test_any_part_of_any_soup(soup, name, max_leaf, seed, share):
    chosen = np.flatnonzero(np.random.default_rng(seed).random(len(soup)) < share).astype(np.int32)
    check(BUILDERS[name].build(soup, 1, max_leaf=max_leaf), soup, chosen)


@pytest.mark.parametrize("name", [n for n in HAZARDS if n != "largest allowed"])
def test_hazards(name, monkeypatch):
    monkeypatch.setattr(tree_layout, "PART", 100)
    monkeypatch.setattr(refit, "NODES_PER_SHARE", 64)
    vertices = np.ascontiguousarray(HAZARDS[name], np.float32)
    bvh = binned_sah.build(vertices)
    check(bvh, vertices, np.arange(0, len(vertices), 3, dtype=np.int32), 2)
    check(bvh, vertices, np.arange(len(vertices) // 5, dtype=np.int32), 2)


def test_all_triangles_are_the_tree_itself():
    vertices = terrain(2000)
    bvh = binned_sah.build(vertices)
    part = check(bvh, vertices, np.arange(len(vertices), dtype=np.int32))
    assert all(a.tobytes() == b.tobytes() for a, b in zip(part, bvh, strict=True))


def test_triangles_of_one_leaf():
    vertices = terrain(2000)
    bvh = binned_sah.build(vertices, 1, max_leaf=MAX_LEAF)
    leaf = next(link for link in bvh.links[:, 12:14].ravel() if link < 0 and (~link & 7) > 0)
    first = ~leaf >> 3
    part = check(bvh, vertices, np.sort(bvh.prim_ids[first : first + (~leaf & 7) + 1]))
    assert len(part.nodes) >= 1


def test_same_bits_for_any_number_of_threads():
    vertices = terrain(20_000)
    bvh, chosen = binned_sah.build(vertices), np.arange(0, 20_000, 2, dtype=np.int32)
    first = check(bvh, vertices, chosen)
    for threads in (2, 3):
        assert all(a.tobytes() == b.tobytes() for a, b in zip(first, filter_tree(bvh, chosen, threads), strict=True))
