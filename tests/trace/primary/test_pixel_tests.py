"""Blocks of triangles against the cells and pixels of a tile: what is certain agrees with float64."""

import numpy as np
import pytest

import antumbra as at
from antumbra.bvh import binned_sah
from antumbra.bvh.block_tree import block_pointers, block_tree
from antumbra.kernels.jit import kernel
from antumbra.kernels.simd import ptr
from antumbra.query.raster_setup import make_view
from antumbra.trace.primary.pixel_tests import (
    BOX,
    CELLS,
    EDGES,
    HEIGHT,
    KEY,
    KEY_ERROR,
    WIDTH,
    WORK,
    cull_cell,
    first_pixel,
    frame_of,
    set_up_block,
)
from antumbra.trace.primary.primary_rays import primary_picture

F = np.float32
PIXELS = np.stack(np.meshgrid(np.arange(WIDTH), np.arange(HEIGHT)), -1).astype(float)  # (h, w, 2): x, y


@kernel
def _set_up(camera, tree, x0, y0, scale, triangles, work):
    return set_up_block(frame_of(camera, x0, y0, scale), block_pointers(tree), np.int64(0), triangles, ptr(work))


@kernel
def _cull_cells(work, candidates, least, culled, corners):
    for cell in range(CELLS):
        x, y = first_pixel(cell)
        corners[cell, 0], corners[cell, 1] = x, y
        culled[cell] = cull_cell(ptr(work), candidates, F(x), F(y), least)


def block(size, seed=0):
    """A block of triangles set up for a tile: (corners by lane, from the eye; lanes in use; directions; rest; work)."""
    rng = np.random.default_rng(seed)
    soup = (rng.uniform(-1, 1, (16, 1, 3)) + size * rng.normal(size=(16, 3, 3))).astype(F)
    camera = at.Camera((0, 0, 4), (0, 0, 0), width=64, height=48, vfov=30.0)
    rays = camera.rays(np.zeros(3))
    tree = block_tree(binned_sah.build(soup, 1), 1)
    picture = primary_picture(rays, np.stack([soup.min((0, 1)), soup.max((0, 1))]), None)
    work = np.zeros(WORK, F)
    n = np.count_nonzero(tree.slots[0] >= 0)
    remaining = _set_up(make_view(rays), tree, 16, 16, picture.scale, n, work)
    corners = tree.corners[tree.slots[0]].reshape(16, 3, 3).astype(float) - camera.position
    directions = rays.corner + (PIXELS[..., :1] + 16.5) * rays.dx + (PIXELS[..., 1:] + 16.5) * rays.dy
    return corners, tree.slots[0] >= 0, directions, lanes_of(remaining), work.reshape(-1, 16)


def lanes_of(mask):
    return mask >> np.arange(16) & 1 != 0


def at_pixels(rows):
    """(h, w, 16): linear functions, rows of c.x, c.y and c.z, at all pixels."""
    return PIXELS[..., :1] * rows[0] + PIXELS[..., 1:] * rows[1] + rows[2]


def truth(corners, directions):
    """((h, w, 16) bool: whether rays meet the triangles; (h, w, 16): 1 / t)."""
    a, p, q = corners[:, 0], corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    normal = np.cross(p, q)
    d = directions[:, :, None]
    det = (d * normal).sum(-1)
    u, v = ((d * np.cross(x, y)).sum(-1) / det for x, y in ((q, a), (a, p)))
    return (u >= 0) & (v >= 0) & (u + v <= 1), det / (a * normal).sum(-1)


@pytest.mark.parametrize("size", [0.05, 0.4, 3.0])
def test_certain_edges_and_depths_agree_with_float64(size):
    inside = outside = 0
    for seed in range(20):
        corners, present, directions, remaining, work = block(size, seed)
        hit, inverse = truth(corners, directions)
        hit &= (inverse > 0) & present
        assert not hit[..., ~remaining].any(), "triangles that were dropped are visible nowhere"
        edges = np.min([at_pixels(work[(EDGES + 48 * k) // 16 :]) for k in range(3)], axis=0)
        sure_in, sure_out = (edges > 1) & remaining, (edges < -1) & remaining
        assert hit[sure_in & (inverse > 0)].all() and not hit[sure_out].any()
        box = work[BOX // 16 :]
        x, y = PIXELS[..., :1], PIXELS[..., 1:]
        covered = (box[0] <= x) & (x <= box[1]) & (box[2] <= y) & (y <= box[3])
        assert covered[hit & remaining].all(), "pixel ranges hold all pixels of a triangle"
        finite = np.isfinite(work[KEY_ERROR // 16]) & remaining
        key, scale = at_pixels(work[KEY // 16 :]), inverse
        some = finite & (np.abs(scale) > 0)
        ratio = key[some] / scale[some]
        if ratio.size:
            np.testing.assert_allclose(ratio, np.median(ratio), rtol=2e-2, atol=0)
        inside, outside = inside + sure_in.sum(), outside + sure_out.sum()
    assert inside > 20 and outside > 1000


@pytest.mark.parametrize("size", [0.05, 0.4])
def test_no_cell_misses_a_triangle_that_is_visible_in_it(size):
    seen, dropped, corners_of_cells = 0, 0, np.zeros((CELLS, 2), np.int64)
    for seed in range(20):
        corners, _, directions, remaining, work = block(size, seed)
        hit, inverse = truth(corners, directions)
        hit &= (inverse > 0) & remaining
        culled = np.zeros(CELLS, np.int64)
        mask = int((remaining << np.arange(16)).sum())
        _cull_cells(work.ravel(), mask, F(-np.inf), culled, corners_of_cells)
        for (x, y), bits in zip(corners_of_cells, culled):
            met = hit[y : y + 4, x : x + 4].any((0, 1))
            assert lanes_of(bits)[met].all()
            seen, dropped = seen + met.sum(), dropped + (remaining & ~lanes_of(bits)).sum()
    assert seen > 20 and dropped > 500
    assert len(np.unique(corners_of_cells, axis=0)) == CELLS and not (corners_of_cells % 4).any()


def test_cells_behind_what_is_visible_are_culled():
    *_, remaining, work = block(0.4)
    culled, places = np.zeros(CELLS, np.int64), np.zeros((CELLS, 2), np.int64)
    _cull_cells(work.ravel(), int((remaining << np.arange(16)).sum()), F(1e30), culled, places)
    assert remaining.any() and not culled.any()
