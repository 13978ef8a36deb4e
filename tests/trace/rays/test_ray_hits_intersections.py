"""All intersections of segments."""

import hypothesis.strategies as st
import numpy as np
import pytest
from hypothesis import given

import oracle
from antumbra.engine.method_registry import BUILDERS
from antumbra.trace.rays.ray_hits import MOST_HITS, intersections
from bvh_scenes import terrain
from shadow_rays import segments_in
from strategies import point_arrays, soups
from strength import examples

BUILD = BUILDERS["bsah"].build


def as_matrix(found, n):
    """(m, n) bool: whether each segment meets each triangle. Checks that each hit is listed once."""
    out = np.zeros((len(found.origins), n), int)
    np.add.at(out, (np.repeat(np.arange(len(out)), np.diff(found.first)), found.prims), 1)
    assert found.first[0] == 0 and found.first[-1] == len(found.prims) and out.max(initial=0) <= 1
    return out.astype(bool)


def check(vertices, origins, ends, skip):
    found = intersections(BUILD(vertices, 1), origins, ends, skip, 2)
    truth = oracle.all_hits(vertices, origins, ends, skip)
    np.testing.assert_array_equal(as_matrix(found, len(vertices)), truth)
    return truth


@examples(60)
@given(vertices=soups(60) | point_arrays((20, 3)), seed=st.integers(0, 2**32 - 1), aimed=st.booleans())
def test_any_soup_equals_the_oracle(vertices, seed, aimed):
    rng = np.random.default_rng(seed)
    origins, ends = segments_in(vertices, 100, seed)
    if aimed:  # through vertices and edges
        origins[:50] = vertices[rng.integers(0, len(vertices), 50), 0]
        ends[20:70] = (
            vertices[rng.integers(0, len(vertices), 50)].mean(1) if seed & 1 else vertices[seed % len(vertices), 1]
        )
    skip = np.where(rng.random(100) < 0.5, rng.integers(0, len(vertices), 100), -1).astype(np.int32)
    check(vertices, origins, ends, skip)


def test_what_meets_at_a_vertex_and_at_an_edge_is_met():
    """A fan of eight triangles around the origin, with a bent rim."""
    angle = np.arange(9) * np.pi / 4
    rim = np.column_stack([np.cos(angle), np.sin(angle), np.arange(9) % 2 / 8]).astype(np.float32)
    rim[8] = rim[0]
    fan = np.stack([np.zeros((8, 3), np.float32), rim[:-1], rim[1:]], 1)
    origins = np.float32([[0, 0, 1], [0.5, 0, 1], [0.25, 0.125, 1], [0, 0, 1], [0, 0, 0]])
    ends = np.float32([[0, 0, -1], [0.5, 0, -1], [0.25, 0.125, -1], [0, 0, 0], [0, 0, 1]])
    skip = np.int32([-1, -1, -1, -1, -1])
    truth = check(fan, origins, ends, skip)
    assert truth.sum(1).tolist() == [8, 2, 1, 0, 0]  # hits at the ends do not count
    assert check(fan, origins, ends, np.int32([3, 0, 0, 3, 3])).sum(1).tolist() == [7, 1, 0, 0, 0]


def _stack(n):
    vertices = np.repeat(np.float32([[[-1, -1, 0], [2, -1, 0], [-1, 2, 0]]]), n, axis=0)
    vertices[:, :, 2] = np.arange(n, dtype=np.float32)[:, None]
    return vertices


@pytest.mark.parametrize("n", [15, 16, 17, 500])
def test_more_hits_than_there_is_room_for_at_first(n):
    vertices, m = _stack(n), 70
    origins, ends = np.zeros((m, 3), np.float32), np.zeros((m, 3), np.float32)
    origins[:, 2], ends[:, 2] = -0.5, np.arange(m)
    truth = check(vertices, origins, ends, np.full(m, -1, np.int32))
    assert truth.sum(1).tolist() == np.minimum(np.arange(m), n).tolist()
    ends[:, 2] = n
    assert check(vertices, origins, ends, np.full(m, -1, np.int32)).all()


def test_a_segment_keeps_no_more_hits_than_the_most():
    n = MOST_HITS + 1000
    origins, ends = np.float32([[0, 0, -1], [0, 0, -1], [0, 0, n - 2.5]]), np.float32([[0, 0, n], [9, 9, 9], [0, 0, n]])
    found = intersections(BUILD(_stack(n)), origins, ends, np.full(3, -1, np.int32), 2)
    assert np.diff(found.first).tolist() == [MOST_HITS, 0, 2]
    assert len(set(found.prims[:MOST_HITS].tolist())) == MOST_HITS
    assert sorted(found.prims[MOST_HITS:].tolist()) == [n - 2, n - 1]


def test_the_same_for_any_number_of_threads():
    vertices = terrain(5000)
    origins, ends = segments_in(vertices, 2000, 1)
    skip, bvh = np.full(2000, -1, np.int32), BUILD(vertices)
    first = intersections(bvh, origins, ends, skip, 1)
    assert len(first.prims) > 1000
    for threads in (2, 3, None):
        again = intersections(bvh, origins, ends, skip, threads)
        assert all(a.tobytes() == b.tobytes() for a, b in zip(first, again, strict=True))


@pytest.mark.parametrize("n", [0, 1])
def test_few_triangles_and_no_segments(n):
    vertices = _stack(n)
    none = intersections(BUILD(vertices), *np.zeros((2, 0, 3), np.float32), np.zeros(0, np.int32))
    assert none.first.tolist() == [0] and len(none.prims) == 0
    still = np.zeros((3, 3), np.float32)  # segments without length, on the triangle
    assert intersections(BUILD(vertices), still, still, np.full(3, -1, np.int32)).first.tolist() == [0, 0, 0, 0]
