"""The predicate against rational arithmetic. The filters must never be wrong."""

from fractions import Fraction

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

import oracle
from antumbra.kernels.exact.filters import MISS, UNSURE, hit_t, meets, plane_side, verdict, volumes32, volumes64
from antumbra.kernels.exact.predicate import exact_meets, exact_plane_side, ray_along, segment
from antumbra.kernels.jit import kernel
from strategies import point_arrays
from strength import examples

EXACT, MEETS, FAST32, FAST64, SIDE = range(5)


@kernel
def _answers(o, l, corners, out):
    for i in range(len(o)):
        ray = segment(o[i, 0], o[i, 1], o[i, 2], l[i, 0], l[i, 1], l[i, 2])
        d32 = (np.float32(ray.dx), np.float32(ray.dy), np.float32(ray.dz))
        w32 = volumes32((o[i, 0], o[i, 1], o[i, 2]), d32, corners, i)
        out[i, 0] = exact_meets(ray, corners, i)
        out[i, 1] = meets(ray, corners, i)
        out[i, 2] = verdict(w32, np.float32(0.0), np.float32(1.0))
        out[i, 3] = verdict(volumes64(ray, corners, i), ray.tmin, ray.tmax)
        out[i, 4] = plane_side(o[i, 0], o[i, 1], o[i, 2], corners, i)


def _check(o, l, corners):
    out = np.zeros((len(o), 5), np.int64)
    _answers(o, l, corners, out)
    truth = np.zeros(len(o), np.int64)
    for i in range(len(o)):
        direction = oracle.minus(oracle.rational(l[i]), oracle.rational(o[i]))
        truth[i] = oracle.meets_exactly(o[i], direction, corners[i].reshape(3, 3), 0.0, 1.0)[0]
    np.testing.assert_array_equal(out[:, EXACT], truth)
    np.testing.assert_array_equal(out[:, MEETS], truth)
    for column in (FAST32, FAST64):
        sure = out[:, column] != UNSURE
        np.testing.assert_array_equal(out[sure, column], truth[sure])
    sides = [oracle.plane_side(p, c.reshape(3, 3)) for p, c in zip(o, corners)]
    np.testing.assert_array_equal(out[:, SIDE], sides)
    return out, truth


@given(point_arrays((40, 5)))
@examples(60)
def test_segments_meet_triangles_as_rational_arithmetic_says(points):
    o, l = np.ascontiguousarray(points[:, 0]), np.ascontiguousarray(points[:, 1])
    _check(o, l, np.ascontiguousarray(points[:, 2:]).reshape(-1, 9))


def test_both_answers_and_every_stage_occur():
    rng = np.random.default_rng(1)
    corners = rng.normal(size=(3000, 9)).astype(np.float32)
    o = rng.normal(size=(3000, 3)).astype(np.float32)
    mix = rng.dirichlet((1, 1, 1), 3000)
    mix[1000:2000, 0] = 0  # through an edge, up to float32's rounding
    mix[1000:2000] /= mix[1000:2000].sum(1, keepdims=True)
    target = np.einsum("nk,nkc->nc", mix, corners.reshape(-1, 3, 3))
    l = (o + (target - o) * 2).astype(np.float32)
    corners[2000:2500] = np.round(corners[2000:2500])
    o[2000:2500], l[2000:2500] = np.round(o[2000:2500]), np.round(l[2000:2500] * 2)
    out, truth = _check(o, l, corners)
    assert {-1, 0, 1} <= set(truth)
    assert (out[:, FAST32] == MISS).any() and (out[:, FAST32] == UNSURE).any()
    assert (out[:, FAST64] == UNSURE).any() and (out[:, FAST64] == UNSURE).sum() < (out[:, FAST32] == UNSURE).sum()


def test_float32_decides_nearly_everything():
    rng = np.random.default_rng(2)
    n = 200_000
    centre = rng.normal(size=(n, 1, 3))
    corners = (centre + 0.1 * rng.normal(size=(n, 3, 3))).astype(np.float32).reshape(n, 9)
    o, l = rng.normal(size=(2, n, 3)).astype(np.float32)
    out = np.zeros((n, 5), np.int64)
    _answers(o, l, corners, out)
    assert (out[:, FAST32] == UNSURE).mean() < 1e-4
    assert not (out[:, FAST64] == UNSURE).any()


def test_denormal_directions_and_huge_triangles_do_not_fool_float32():
    """The product u d underflows before the triangle's size multiplies it. The error bound must not underflow."""
    rng = np.random.default_rng(3)
    n = 4000
    o = (rng.normal(size=(n, 3)) * 3e11).astype(np.float32)
    corners = (rng.normal(size=(n, 9)) * 3e11).astype(np.float32)
    inside = np.einsum("nk,nkc->nc", rng.dirichlet((1, 1, 0.001), n), corners.reshape(-1, 3, 3).astype(np.float64))
    d = ((inside - o) / np.abs(inside - o).max(1, keepdims=True) * 1.5e-40).astype(np.float32)
    out = np.zeros(n, np.int64)
    _lines32(o, d, corners, out)
    truth = np.array([oracle.meets_exactly(o[i], d[i], corners[i].reshape(3, 3))[0] for i in range(n)])
    sure = out != UNSURE
    np.testing.assert_array_equal(out[sure], truth[sure])
    assert sure.any()


@kernel
def _lines32(o, d, corners, out):
    for i in range(len(o)):
        w = volumes32((o[i, 0], o[i, 1], o[i, 2]), (d[i, 0], d[i, 1], d[i, 2]), corners, i)
        out[i] = verdict(w, np.float32(0.0), np.float32(np.inf))


@kernel
def _distances(o, d, corners, out, sides):
    for i in range(len(o)):
        ray = ray_along(o[i, 0], o[i, 1], o[i, 2], d[i, 0], d[i, 1], d[i, 2], 0.0, np.inf)
        sides[i] = meets(ray, corners, i)
        out[i] = hit_t(ray, corners, i) if sides[i] != 0 else np.inf


@given(point_arrays((30, 5)))
@examples(40)
def test_hit_t_is_accurate_even_for_grazing_rays(points):
    o, d = np.ascontiguousarray(points[:, 0]), np.ascontiguousarray(points[:, 1])
    corners = np.ascontiguousarray(points[:, 2:]).reshape(-1, 9)
    t, sides = np.zeros(len(o)), np.zeros(len(o), np.int64)
    _distances(o, d, corners, t, sides)
    for i in range(len(o)):
        side, exact = oracle.meets_exactly(o[i], d[i], corners[i].reshape(3, 3))
        assert side == sides[i]
        if side:
            assert abs(Fraction(t[i]) - exact) <= exact * Fraction(2) ** -29


@kernel
def _interval(corners, tmin, tmax):
    ray = ray_along(
        np.float32(0.25),
        np.float32(0.25),
        np.float32(-1.0),
        np.float32(0.0),
        np.float32(0.0),
        np.float32(1.0),
        tmin,
        tmax,
    )
    return meets(ray, corners, 0)


def test_the_interval_is_open():
    corners = np.array([[0, 0, 0, 1, 0, 0, 0, 1, 0]], np.float32)
    below, above = np.nextafter(1.0, 0.0), np.nextafter(1.0, 2.0)
    assert _interval(corners, 0.0, np.inf) == 1
    assert _interval(corners, 1.0, np.inf) == 0
    assert _interval(corners, 0.0, 1.0) == 0
    assert _interval(corners, below, above) == 1


@given(st.integers(0, 2**32 - 1))
@examples(40)
def test_triangles_that_share_an_edge_do_not_leak(seed):
    """A closed fan around a vertex: lines through the vertex, its spokes and points nearby meet some triangle."""
    rng = np.random.default_rng(seed)
    k = int(rng.integers(3, 9))
    angles = np.sort(rng.uniform(0, 2 * np.pi, k))
    ring = np.stack([np.cos(angles), np.sin(angles), rng.normal(size=k) * 0.2], 1).astype(np.float32)
    hub = (rng.normal(size=3) * 0.05).astype(np.float32)
    around = np.sort(np.arctan2(ring[:, 1] - hub[1], ring[:, 0] - hub[0]))
    if np.diff(np.append(around, around[0] + 2 * np.pi)).max() > 2.5:  # a tilted view could see past the hub
        return
    fan = np.stack([np.broadcast_to(hub, (k, 3)), ring, np.roll(ring, -1, 0)], 1)
    along = rng.uniform(0, 0.5, (200, 1)) * (rng.uniform(size=(200, 1)) < 0.7)
    target = hub + along * (ring[rng.integers(0, k, 200)] - hub)
    o = (target + rng.normal(size=(200, 3)) * (0.1, 0.1, 0.3) + (0, 0, 3)).astype(np.float32)
    l = (2 * target - o).astype(np.float32)
    hit = np.zeros(200, bool)
    for triangle in fan:
        out = np.zeros((200, 5), np.int64)
        _answers(o, l, np.ascontiguousarray(np.broadcast_to(triangle.reshape(1, 9), (200, 9))), out)
        hit |= out[:, MEETS] != 0
    assert hit.all()


def test_triangles_without_area_never_block():
    rng = np.random.default_rng(5)
    a, b = rng.integers(-3, 4, (2, 300, 3)).astype(np.float32)
    corners = np.concatenate([a, b, a + (b - a) * 0.5], 1).astype(np.float32)
    corners[::3, 3:6] = corners[::3, 0:3]
    target = a + (b - a) * rng.choice([0, 0.25, 0.5, 1], (300, 1))
    o = (target + rng.integers(-2, 3, (300, 3))).astype(np.float32)
    out, truth = _check(o, (2 * target - o).astype(np.float32), np.ascontiguousarray(corners))
    assert not truth.any() and not out[:, MEETS].any()


def test_plane_side_of_a_triangle_without_area_is_zero():
    corners = np.array([[0, 0, 0, 1, 1, 1, 2, 2, 2]], np.float32)
    assert exact_plane_side(3.0, 1.0, 2.0, corners, 0) == 0
