"""Triangles of polygons, against areas, and against random points by the even-odd rule."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from antumbra.city.cityjson.city_polygons import Rings, triangulate


def cut(*polygons):
    """The triangulation of polygons, each a list of rings of points; with all points, (v, 3)."""
    rings = [np.asarray(ring, np.float64).reshape(-1, 3) for polygon in polygons for ring in polygon]
    points = np.concatenate(rings)
    sizes = np.array([len(ring) for ring in rings])
    return triangulate(points, Rings(np.arange(len(points)), sizes, np.array([len(p) for p in polygons]))), points


def vector_areas(found, points):
    a, b, c = (points[found.faces[:, k]] for k in range(3))
    return np.cross(b - a, c - a) / 2.0


def flat(ring, z=0.0):
    return [[x, y, z] for x, y in ring]


SQUARE = [(0, 0), (10, 0), (10, 10), (0, 10)]
HOLE = [(2, 2), (2, 8), (8, 8), (8, 2)]
ELL = [(0, 0), (10, 0), (10, 4), (4, 4), (4, 10), (0, 10)]
DART = [(0, 0), (10, 0), (3, 3), (0, 10)]


def rotation(seed):
    return np.linalg.qr(np.random.default_rng(seed).normal(size=(3, 3)))[0]


@pytest.mark.parametrize("turn", [np.eye(3), *(rotation(k) for k in range(6))])
@pytest.mark.parametrize(
    "rings, area, count",
    [
        ([SQUARE[:3]], 50, 1),
        ([SQUARE], 100, 2),
        ([DART], 30, 2),
        ([DART[1:] + DART[:1]], 30, 2),
        ([ELL], 64, 4),
        ([SQUARE, HOLE], 64, 8),
        ([SQUARE, HOLE[::-1]], 64, 8),
        ([SQUARE, [(1, 1), (1, 3), (3, 1)], [(6, 6), (6, 9), (9, 6)]], 100 - 2 - 4.5, 12),
    ],
)
def test_areas_and_orientation(rings, area, count, turn):
    far = np.array([4e5, 5.4e6, 100.0])
    for backwards in (False, True):
        outer = rings[0][::-1] if backwards else rings[0]
        polygon = [np.array(flat(ring)) @ turn.T + far for ring in [outer, *rings[1:]]]
        found, points = cut(polygon)
        normal = turn[:, 2] * np.linalg.det(turn) * (-1.0 if backwards else 1.0)
        areas = vector_areas(found, points) @ normal
        assert (areas > 0).all() and areas.sum() == pytest.approx(area, rel=1e-7)
        assert len(found.faces) == count and found.crossed == found.flat == 0


def inside(rings, points):
    """The even-odd rule."""
    odd = np.zeros(len(points), bool)
    for ring in rings:
        for (x0, y0), (x1, y1) in zip(ring, ring[1:] + ring[:1]):
            crosses = (y0 > points[:, 1]) != (y1 > points[:, 1])
            with np.errstate(divide="ignore", invalid="ignore"):
                odd ^= crosses & (points[:, 0] < (x1 - x0) * (points[:, 1] - y0) / (y1 - y0) + x0)
    return odd


def _left(p, q, x, y):
    """Positive where (x, y) is left of the line from p to q."""
    return (q - p)[:, 0] * (y - p[:, 1]) - (q - p)[:, 1] * (x - p[:, 0])


@given(st.integers(5, 40), st.integers(0, 2**32 - 1), st.booleans())
def test_random_stars_cover_what_the_even_odd_rule_says(corners, seed, hole):
    rng = np.random.default_rng(seed)
    angle = (np.arange(corners) + rng.uniform(0, 0.9, corners)) * (2 * np.pi / corners)
    radius = rng.uniform(1.0, 5.0, corners)
    rings = [list(zip((radius * np.cos(angle)).tolist(), (radius * np.sin(angle)).tolist()))]
    if hole:
        rings.append([(0.4 * x, 0.4 * y) for x, y in rings[0]][::-1])
    found, points = cut([flat(ring) for ring in rings])
    probes = rng.uniform(-5, 5, (400, 2))
    a, b, c = (points[found.faces[:, k], :2] for k in range(3))
    x, y = probes[:, None].transpose(2, 0, 1)
    sides = np.stack([_left(a, b, x, y), _left(b, c, x, y), _left(c, a, x, y)])
    clear = np.abs(sides).min(axis=(0, 2)) > 1e-9  # not on the line of any edge
    covering = (sides > 0).all(axis=0).sum(axis=1)
    np.testing.assert_array_equal(covering[clear], inside(rings, probes)[clear].astype(int))
    assert covering.max() == 1


def test_many_polygons_stay_in_order():
    star = [(0, 0), (5, 1), (10, 0), (9, 5), (10, 10), (5, 9), (0, 10), (1, 5)]
    kinds = [[SQUARE[:3]], [SQUARE], [SQUARE, HOLE], [DART], [star], [[(0, 0), (1, 1), (2, 2)]], [SQUARE]]
    found, points = cut(*[[flat(r, z) for r in rings] for z, rings in enumerate(kinds)])
    assert (np.diff(found.polygon) >= 0).all() and found.flat == 1
    np.testing.assert_array_equal(np.unique(found.polygon), [0, 1, 2, 3, 4, 6])
    np.testing.assert_array_equal(points[found.faces][:, :, 2], np.repeat(found.polygon[:, None], 3, axis=1))
    areas = np.bincount(found.polygon, vector_areas(found, points)[:, 2])
    np.testing.assert_allclose(areas, [50, 100, 64, 30, 80, 0, 100])


def test_a_wall_that_is_not_quite_flat():
    wall = [[0, 0, 0], [10, 0.01, 0], [10, -0.01, 6], [5, 0.02, 9], [5, 0, 6], [0, 0.01, 6]]
    found, points = cut([wall])
    assert len(found.faces) == 4 and found.crossed == 0
    areas = vector_areas(found, points)
    assert (areas[:, 1] < 0).all()  # towards -y, as the ring turns
    np.testing.assert_allclose(areas.sum(axis=0)[1], -67.5, rtol=1e-3)


def test_rings_with_too_few_corners_and_rings_that_cross():
    bow = [(0, 0), (10, 10), (10, 0), (0, 6)]
    polygons = [[flat(SQUARE[:2])], [flat(SQUARE), flat(HOLE[:2])], [flat(SQUARE[:2]), flat(HOLE)], [flat(bow)]]
    found, points = cut(*polygons)
    assert set(found.polygon.tolist()) >= {1} and not {0, 2} & set(found.polygon.tolist())
    assert found.flat == 2 and found.crossed == 1
    assert vector_areas(found, points)[found.polygon == 1].sum(axis=0)[2] == 100


def test_a_closed_ring_may_repeat_its_first_corner():
    for ring in (SQUARE, SQUARE[:3], ELL):
        once, more = (vector_areas(*cut([flat(r)]))[:, 2] for r in (ring, ring + ring[:1]))
        assert (more > 0).all() and more.sum() == once.sum()


def test_nothing():
    found = triangulate(np.empty((0, 3)), Rings(*(np.empty(0, np.int64) for _ in range(3))))
    assert found.faces.shape == (0, 3) and len(found.polygon) == 0
