"""A refitted wide BVH is correct: boxes and groups are those of the moved triangles, in the same nodes."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from antumbra.bvh import wide_refit as wide_refit_module
from antumbra.bvh.nodes import LINKS
from antumbra.bvh.tree_quality import validate
from antumbra.bvh.wide_bvh import wide_cost, widen
from antumbra.bvh.wide_refit import MovedVertices, refit_wide, vertices_of_slots, wide_refit
from antumbra.engine.method_registry import BUILDERS
from antumbra.kernels.array_pool import ArrayPool
from antumbra.scene.indexed_triangles import padded_rows
from antumbra.scene.triangle_setup import rows_with_area
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
        wide, cost, all_have_area = refit_wide(prepared, corners_of(prepared, moved, pool), threads, pool)
        validate(wide.bvh, moved)
        check_tree(wide, wide.bvh, moved)
        np.testing.assert_allclose(cost, wide_cost(wide, 1), rtol=1e-12)
        assert all_have_area == (rows_with_area(moved, 1) is None)


def corners_of(prepared, vertices, pool):
    """Vertices of which each triangle has three of its own."""
    positions = padded_rows(3 * len(vertices), pool)
    positions[:] = vertices.reshape(-1, 3)
    return MovedVertices(positions, vertices_of_slots(prepared.wide, None))


@pytest.mark.parametrize("threads", [1, 3])
def test_faces_that_share_vertices(threads):
    rng, pool = np.random.default_rng(5), ArrayPool()
    faces = np.stack([np.arange(2000) % 600, rng.integers(0, 600, 2000), rng.integers(0, 600, 2000)], 1).astype(
        np.int32
    )
    faces = faces[(faces[:, 0] != faces[:, 1]) & (faces[:, 1] != faces[:, 2]) & (faces[:, 2] != faces[:, 0])]
    positions = padded_rows(600, pool)
    positions[:] = rng.normal(size=(600, 3))
    prepared = wide_refit(widen(BUILDERS["bsah"].build(positions[faces]), 2))
    for flat in (False, True):
        positions[:] = rng.normal(size=(600, 3))
        if flat:
            positions[faces[7, 1]] = positions[faces[7, 0]]
        moved = MovedVertices(positions, vertices_of_slots(prepared.wide, faces))
        refitted, expected = (
            refit_wide(prepared, each, threads, pool) for each in (moved, corners_of(prepared, positions[faces], pool))
        )
        check_tree(refitted.wide, refitted.wide.bvh, positions[faces])
        assert refitted.wide.groups.tobytes() == expected.wide.groups.tobytes()
        assert refitted.all_have_area == expected.all_have_area == (not flat)


def test_refitting_to_the_same_triangles_changes_nothing():
    vertices = np.ascontiguousarray(HAZARDS["large, scattered"], np.float32)
    bvh = BUILDERS["bsah"].build(vertices)
    wide = widen(bvh)
    prepared, pool = wide_refit(wide), ArrayPool()
    again, cost, all_have_area = refit_wide(prepared, corners_of(prepared, vertices, pool), 2, pool)
    assert all_have_area == (rows_with_area(vertices, 1) is None)
    np.testing.assert_allclose(cost, wide_cost(wide, 2), rtol=1e-12)
    order = np.argsort(wide.slots[:, 0])
    assert wide.nodes[:, :LINKS].tobytes() == again.nodes[:, :LINKS].tobytes() and wide.reach == again.reach
    assert wide.groups[order].tobytes() == again.groups.tobytes() and np.array_equal(wide.slots[order], again.slots)
    assert len(again.bvh.nodes) == len(wide.groups) - 1  # each group is a leaf
