"""Scenes in float32 answer for the caller's own numbers: no vertex, and no ray in float32, is rounded."""

from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import antumbra as at
import oracle

OFFSETS = {
    "at 0": (0, 0, 0),
    "beside 0": (1.3, -0.2, 3),
    "ten widths away": (20, -20, 1),
    "a map grid": (448262.5, 5411932.0, 3.1),
}


def rays_at(triangles, seed, n=8):
    """Rays in float32 from around triangles to their corners, the middles of their edges, and beside them."""
    rng = np.random.default_rng(seed)
    corners = triangles.reshape(-1, 3).astype(float)
    weights = rng.dirichlet(np.ones(3) * 0.3, n)
    weights[: n // 2, 2] = 0
    weights /= weights.sum(1, keepdims=True)
    aims = np.einsum("nk,nkx->nx", weights, triangles[rng.integers(len(triangles), size=n)].astype(float))
    origins = (corners.mean(0) + rng.uniform(-3, 3, (n, 3))).astype(np.float32)
    return origins, (aims - origins).astype(np.float32)


def truth_of(triangles, origins, directions):
    """(n,) bool, by rational arithmetic of the given numbers."""
    return [any(oracle.meets_exactly(o, d, t)[0] for t in triangles) for o, d in zip(origins, directions)]


def soup_at(offset, seed, n=1):
    return (np.random.default_rng(seed).uniform(0, 2, (n, 3, 3)) + offset).astype(np.float32)


def doors(triangles, folder):
    """Ways to ask whether rays meet the triangles."""
    from antumbra.integrations.open3d import RaycastingScene

    faces = np.arange(3 * len(triangles)).reshape(-1, 3)
    vertices = triangles.reshape(-1, 3)
    memory = at.Scene.from_arrays(vertices, faces)
    wide = at.Scene.from_arrays(vertices.astype(float), faces)
    at.build_store(memory, folder / "a.antumbra")
    open3d = RaycastingScene()
    open3d.add_triangles(vertices, faces.astype(np.uint32))
    store = at.load(folder / "a.antumbra")
    return {
        "float32 arrays": memory.occluded,
        "float64 arrays": wide.occluded,
        "counts": lambda o, d: memory.count_hits(o, d) > 0,
        "a store": store.occluded,
        "Open3D": lambda o, d: np.asarray(open3d.test_occlusions(np.concatenate([o, d], axis=-1))),
    }


@pytest.mark.parametrize("offset", OFFSETS.values(), ids=OFFSETS)
def test_rays_in_float32_meet_the_triangles_of_real_arithmetic(offset, tmp_path):
    wrong, hits = {}, 0
    for seed in range(12):
        triangles = soup_at(offset, seed)
        origins, directions = rays_at(triangles, seed, 16)
        truth = truth_of(triangles, origins, directions)
        hits += sum(truth)
        folder = tmp_path / str(seed)
        folder.mkdir()
        for name, occluded in doors(triangles, folder).items():
            wrong[name] = wrong.get(name, 0) + int((occluded(origins, directions) != truth).sum())
    assert hits > 30
    assert not any(wrong.values()), wrong


@settings(deadline=None, max_examples=200)
@given(
    st.lists(st.tuples(*[st.floats(width=32, min_value=-1e9, max_value=1e9)] * 3), min_size=3, max_size=9),
    st.sampled_from([0.0, 1e3, -3e5, 1e9]),
)
def test_no_vertex_in_float32_is_rounded(points, offset):
    soup = (np.array(points[: len(points) // 3 * 3]).reshape(-1, 3, 3) + offset).astype(np.float32)
    soup[np.abs(soup) < 1e-30] = 0
    if not (np.ptp(soup.reshape(-1, 3), axis=0).max() > 1e-20):
        return
    scene = at.Scene.from_arrays(soup)
    local, origin = scene.triangles().vertices.reshape(-1, 3), scene.origin
    for row, given_row in zip(local, soup.reshape(-1, 3)):
        for x, o, y in zip(row, origin, given_row):
            assert Fraction(float(x)) + Fraction(float(o)) == Fraction(float(y))


@pytest.mark.parametrize("far", [1e3, 1e5, 1e7])
def test_rays_from_many_radii_away_hit_what_they_hit_in_real_arithmetic(far):
    triangles = soup_at((0, 0, 0), 5, 20)
    rng = np.random.default_rng(int(far))
    away = rng.normal(size=(60, 3))
    aims = triangles[rng.integers(20, size=60), rng.integers(3, size=60)].astype(float)
    directions = (-away / np.abs(away).max(1, keepdims=True)).astype(np.float32)
    origins = (aims - far * directions.astype(float)).astype(np.float32)
    truth = truth_of(triangles, origins, directions)
    assert far == 1e7 or sum(truth) > 5
    np.testing.assert_array_equal(at.Scene.from_arrays(triangles).occluded(origins, directions), truth)


def test_one_vertex_beyond_float32_recentres_the_scene():
    soup = soup_at((1, 1, 1), 0, 4)
    np.testing.assert_array_equal(at.Scene.from_arrays(soup).origin, 0.0)
    wide = soup.astype(float)
    wide[0, 0, 0] += 1e-12
    assert (at.Scene.from_arrays(wide).origin > 1.0).all()
