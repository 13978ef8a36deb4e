"""The rasteriser's bounds hold: bounds of rounding errors, against rational arithmetic, and boxes on the screen."""

from fractions import Fraction

import numpy as np
import pytest

from antumbra.kernels.exact.filters import hit_t, meets
from antumbra.kernels.jit import kernel
from antumbra.kernels.simd import get, ptr, stack_f32, stack_i32
from antumbra.query.gbuffer import pixel_direction, pixel_ray
from antumbra.query.raster_bins import BLOCK, careful_box, make_padding, quick_boxes, transpose
from antumbra.query.raster_setup import edge_functions, eye_plane, make_view, plane_t
from raster_scenes import FAMILIES, view

LANES, BOXES = 9 * BLOCK, 4 * BLOCK


def corners_of(family, seed, n, rays):
    return np.ascontiguousarray(family(np.random.default_rng(seed), n, rays), np.float32).reshape(-1, 9)


@kernel
def _functions(view, corners, i, x0, y0, reach):
    return edge_functions(view, ptr(corners), i, x0, y0, reach, reach)


def _determinant(a, b, c):
    cross = [b[k - 2] * c[k - 1] - b[k - 1] * c[k - 2] for k in range(3)]
    return sum(x * y for x, y in zip(a, cross))


def _exact(v):
    return [Fraction(float(x)) for x in v]


@pytest.mark.parametrize("family", FAMILIES)
def test_edge_functions_and_depth_keys_are_within_their_bounds(family):
    """Each value, in exact arithmetic, is compared with the contract's determinants of the rounded direction."""
    rng, sure = np.random.default_rng(5), 0
    for seed, vfov in ((1, 60.0), (2, 90.0), (3, 0.01), (4, 170.0)):
        rays = view(target=(0.1, -0.05, -1), vfov=vfov, width=300, height=200)
        screen, corners = make_view(rays), corners_of(family, seed, 30, rays)
        for i in range(len(corners)):
            x0, y0 = (int(k) for k in rng.integers(0, 60, 2))
            turn, f = _functions(screen, corners, i, x0, y0, 40)
            v = [_exact(corners[i, 3 * k : 3 * k + 3]) for k in range(3)]
            a, b, c = ([x - e for x, e in zip(p, _exact(rays.origin))] for p in v)
            volume = _determinant(a, b, c)
            assert turn == 0 or turn * screen.turn * volume > 0
            for x, y in rng.integers(0, 40, (4, 2)):
                d = _exact(pixel_direction.py_func(rays, x0 + x, y0 + y))
                e = _determinant(d, b, c), _determinant(d, c, a), _determinant(d, a, b)
                for k, exact in enumerate(e):
                    k_a, k_b, k_c = _exact(f[3 * k : 3 * k + 3])
                    value = (k_c + k_a * int(x) + k_b * int(y)) * (turn or 1) * screen.turn
                    assert abs(value) <= 1 or value * exact > 0
                    sure += abs(value) > 1
                if volume != 0 and np.isfinite(f.key_error):
                    key_a, key_b, key_c = _exact(f[9:12])
                    assert abs(key_c + key_a * int(x) + key_b * int(y) - sum(e) / volume) <= Fraction(f.key_error)
    assert sure > 100


@kernel
def _boxes(view, padding, corners, quick, careful):
    """Fill the boxes of both methods, (n, 4) each. An empty box has x0 > x1.

    Quick boxes are -2 where the quick method finds float32 insufficient.
    """
    lanes, boxes, nearest = stack_f32(LANES), stack_i32(BOXES), stack_f32(BLOCK)
    p = ptr(corners)
    for i in range(len(corners)):
        transpose(p, i, 1, lanes)
        sure, unsure = quick_boxes(view, padding, lanes, 0, boxes, nearest)
        x0, y0, x1, y1 = careful_box(view, padding, p, i)
        careful[i, 0], careful[i, 1], careful[i, 2], careful[i, 3] = x0, y0, x1, y1
        for k in range(4):
            quick[i, k] = -2 if unsure & 1 else get(boxes, k * BLOCK) if sure & 1 else (1, 1, 0, 0)[k]


@kernel
def _covered(rays, corners, i, box):
    """(whether triangle i covers a pixel outside the box, number of pixels that it covers)."""
    outside, n = False, 0
    for y in range(rays.height):
        for x in range(rays.width):
            if meets(pixel_ray(rays, x, y), corners, i) != 0:
                n += 1
                outside |= not (box[0] <= x <= box[2] and box[1] <= y <= box[3])
    return outside, n


@pytest.mark.parametrize("family", FAMILIES)
def test_boxes_hold_all_covered_pixels(family):
    """This holds for corners in front of the camera, beside it and behind it. Many boxes are small."""
    quick_ones = careful_ones = small = 0
    for seed in range(12):
        rays = view((0, 0, 0), (0.1 * seed, 0.2, -1), vfov=(2.0, 60.0, 150.0)[seed % 3], width=37, height=30)
        screen, corners = make_view(rays), corners_of(family, seed, 25, rays)
        quick, careful = np.empty((len(corners), 4), np.int64), np.empty((len(corners), 4), np.int64)
        _boxes(screen, make_padding(screen), corners, quick, careful)
        for i in range(len(corners)):
            outside, n = _covered(rays, corners, i, careful[i])
            assert not outside
            if quick[i, 0] != -2:
                assert not _covered(rays, corners, i, quick[i])[0]
                quick_ones += n > 0
            else:
                careful_ones += n > 0
            width, height = careful[i, 2:] - careful[i, :2] + 1
            small += not 0 < width * height == rays.width * rays.height
    assert quick_ones + careful_ones > 3 and small > 30


@kernel
def _both_t(rays, corners, i, x, y):
    p, ray = ptr(corners), pixel_ray(rays, x, y)
    return plane_t(eye_plane(p, i, rays.origin), ray, p), hit_t(ray, p, i), meets(ray, p, i)


@pytest.mark.parametrize("family", FAMILIES)
def test_depth_by_plane_is_hit_t(family):
    rays, compared = view(width=24, height=24), 0
    corners = np.concatenate([corners_of(family, seed, 30, rays) for seed in range(4)])
    for i in range(len(corners)):
        for x, y in np.random.default_rng(i).integers(0, 24, (20, 2)):
            mine, contract, side = _both_t(rays, corners, i, x, y)
            if side != 0 or np.isfinite(contract):
                assert mine == contract
                compared += 1
    assert compared > 100
