"""A refitted wide BVH is correct: boxes and groups are those of the moved triangles, in the same nodes."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from antumbra.bvh import wide_refit as wide_refit_module
from antumbra.bvh.nodes import LINKS
from antumbra.bvh.tree_quality import validate
from antumbra.bvh.wide_bvh import widen
from antumbra.bvh.wide_refit import refit_wide, wide_refit
from antumbra.engine.method_registry import BUILDERS
from antumbra.kernels.array_pool import ArrayPool
from bvh_scenes import HAZARDS
from strategies import soups
from strength import examples
from wide_trees import check_tree


@given(
    vertices=soups(200), seed=st.integers(0, 99), threads=st.integers(1, 3), builder=st.sampled_from(sorted(BUILDERS)),
    part=st.sampled_from([1, 2, 7, 512]),
)  # fmt: skip
@examples(60)
def test_refitted_to_any_soup(vertices, seed, threads, builder, part):
    """Moved triangles, some of them without area, in the same nodes and groups."""
    bvh = BUILDERS[builder].build(vertices, 2)
    if len(vertices) < 2:
        return
    wide, rng, pool = widen(bvh, 2), np.random.default_rng(seed), ArrayPool()
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(wide_refit_module, "_PART", part)
        prepared = wide_refit(wide)
    for _ in range(3):
        moved = vertices[rng.permutation(len(vertices))] * np.float32(rng.uniform(-2, 2))
        moved[rng.random(len(moved)) < 0.1] = moved[0, 0]
        wide = refit_wide(prepared, moved, threads, pool)
        validate(wide.bvh, moved)
        check_tree(wide, wide.bvh, moved)


def test_refitting_to_the_same_triangles_changes_nothing():
    vertices = np.ascontiguousarray(HAZARDS["large, scattered"], np.float32)
    bvh = BUILDERS["bsah"].build(vertices)
    wide = widen(bvh)
    again = refit_wide(wide_refit(wide), vertices, 2, ArrayPool())
    order = np.argsort(wide.slots[:, 0])
    assert wide.nodes[:, :LINKS].tobytes() == again.nodes[:, :LINKS].tobytes() and wide.reach == again.reach
    assert wide.groups[order].tobytes() == again.groups.tobytes() and np.array_equal(wide.slots[order], again.slots)
    assert len(again.bvh.nodes) == len(wide.groups) - 1  # each group is a leaf
