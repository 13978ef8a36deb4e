"""Occlusion queries count rays: as many as meet the boxes of a node's children before their hits so far."""

import numpy as np
import pytest

import antumbra as at
from antumbra.bvh.block_tree import block_tree
from antumbra.bvh.nodes import boxes_of
from antumbra.engine.method_registry import BUILDERS
from antumbra.query.ray_passes import RayPass
from antumbra.query.shadow_query import segments
from antumbra.techniques.chcrt.occlusion_queries import Pairs
from antumbra.techniques.chcrt.picture_ray_sets import (
    CameraRaySet,
    CombinedRaySets,
    PassRaySet,
    SegmentRaySets,
    segments_of,
)
from antumbra.techniques.chcrt.ray_bundles import pass_rays
from antumbra.techniques.chcrt.tree_parts import parts_of
from antumbra.techniques.tracer_options import ChcRtOptions
from asking import query_of

OPTIONS = ChcRtOptions(tile=32, triangles=64)
EVERYTHING = 1 << 30


@pytest.fixture(scope="module")
def atrium():
    scene = at.procedural("atrium", triangles=4000)
    camera = scene.cameras[0].resized(70, 40)
    triangles, query = query_of(scene, camera, at.QuadLight((-2, 9, -2), (4, 0, 0), (0, 0, 4)), 6)
    tree = block_tree(BUILDERS["bsah"].build(triangles.vertices, 2), 2)
    return camera.rays(triangles.origin), query, parts_of(tree, OPTIONS)


def _counts(boxes, origins, directions, live, grow):
    """(rows, n) bool: which rays from `origins` along `directions`, up to 1, meet which boxes grown by `grow`."""
    low, high = boxes[:, 0, None] - grow, boxes[:, 1, None] + grow
    with np.errstate(divide="ignore", invalid="ignore"):
        a, b = (low - origins) / directions, (high - origins) / directions
        near, far = np.fmin(a, b), np.fmax(a, b)
    inside = (directions != 0) | ((low <= origins) & (origins <= high))
    meets = (
        np.fmax.reduce(np.where(directions != 0, near, 0), 2) <= np.fmin.reduce(np.where(directions != 0, far, 1), 2)
    ) & (np.where(directions != 0, near, -1).max(2) <= 1)
    return meets & inside.all(2) & (np.where(directions != 0, far, 1).min(2) >= 0) & live


def _check(rays, parts, origins, directions, live, per_tile):
    """Compare the counts of pairs of a smallest tile and every fourth row with rays tested one by one."""
    n, some = rays.tiles.smallest, np.arange(0, len(parts.lines), 4)
    tile, row = (a.ravel().astype(np.int32) for a in np.meshgrid(np.arange(n), some, indexing="ij"))
    lines = parts.lines[some]
    answers = rays.answer(Pairs(tile, np.zeros_like(tile), row), EVERYTHING)
    left = np.stack([lines[:, 0:12:4], lines[:, 2:12:4]], 1).astype(np.float64)
    right = np.stack([lines[:, 1:12:4], lines[:, 3:12:4]], 1).astype(np.float64)
    size = np.ptp(boxes_of(parts.lines[:1])[0], axis=0).max()
    got = answers.counts.reshape(n, -1)
    for t in range(n):
        mine = per_tile == t
        exact, grown = (
            (
                _counts(left, origins[mine], directions[mine], live[mine], g)
                | _counts(right, origins[mine], directions[mine], live[mine], g)
            ).sum(1)
            for g in (0.0, 1e-4 * size)
        )
        assert (exact <= got[t]).all() and (got[t] <= grown).all()
    assert 0.05 < (got > 0).mean() < 0.95
    return got


def _tile_of(h, w, rays):
    y, x = np.mgrid[:h, :w]
    return (y // OPTIONS.tile * rays.tiles.across + x // OPTIONS.tile).ravel()


def test_camera_rays(atrium):
    camera, _, parts = atrium
    reach = 4.0 * float(np.abs(parts.boxes).max())
    rays = CameraRaySet(parts, OPTIONS, camera, slice(0, camera.height), reach, 2)
    y, x = np.mgrid[: camera.height, : camera.width] + 0.5
    directions = (camera.corner + x[..., None] * camera.dx + y[..., None] * camera.dy).reshape(-1, 3) * rays.length
    origins = np.broadcast_to(camera.origin.astype(np.float64), directions.shape)
    _check(
        rays, parts, origins, directions, np.ones(len(directions), bool), _tile_of(camera.height, camera.width, rays)
    )


@pytest.mark.parametrize("alike", ["neighbours", "every fourth"])
def test_passes(atrium, alike):
    _, query, parts = atrium
    rng, (h, w) = np.random.default_rng(2), query.sides.shape
    directions = rng.normal(size=(h, w, 3))
    if alike == "every fourth":
        directions = np.tile(rng.normal(size=(4, 4, 3)), (h // 4 + 1, w // 4 + 1, 1))[:h, :w]
    directions[rng.random((h, w)) < 0.1] = 0.0
    flat = RayPass(
        query.origins.reshape(-1, 3), directions.astype(np.float32).reshape(-1, 3), np.full(h * w, -1, np.int32)
    )
    rays = PassRaySet(parts, OPTIONS, pass_rays(flat, h, w, 100.0), 2)
    assert rays.rays.picture.spread == (alike == "every fourth")
    rays.hits.t[: h // 2] = 3.0 + rng.random((h // 2, w))  # how far rays look counts
    there = (flat.directions != 0).any(1)
    ends = np.minimum(rays.hits.t.reshape(-1, 1), 1e3) * flat.directions.astype(np.float64)
    _check(rays, parts, flat.origins.astype(np.float64), ends, there, _tile_of(h, w, rays))


@pytest.mark.parametrize("spp, size", [(6, (70, 40)), (70, (40, 6))])
def test_segments(atrium, spp, size):
    _, _, parts = atrium
    scene = at.procedural("atrium", triangles=4000)
    _, query = query_of(scene, scene.cameras[0].resized(*size), at.QuadLight((-2, 9, -2), (4, 0, 0), (0, 0, 4)), spp)
    h, w = query.sides.shape
    bits = np.random.default_rng(1).integers(0, 1 << min(spp, 63), (h, w, -(-spp // 64))).astype(np.uint64)
    (step,) = segments_of(parts, query)
    rays = SegmentRaySets(parts, OPTIONS, step, bits, 2)
    ends, _ = segments(query)
    origins = np.broadcast_to(query.origins[:, :, None], ends.shape).reshape(-1, 3).astype(np.float64)
    sample = np.arange(spp)
    blocked = (bits[..., sample // 64] >> (sample % 64).astype(np.uint64) & np.uint64(1)).astype(bool).ravel()
    live = ~blocked & np.repeat(query.sides.ravel() != 0, spp)
    directions = (ends.reshape(-1, 3) - query.origins[:, :, None].repeat(spp, 2).reshape(-1, 3)).astype(np.float64)
    _check(rays, parts, origins, directions, live, np.repeat(_tile_of(h, w, rays), spp))


def test_several_ray_sets_answer_as_each_by_itself(atrium):
    _, query, parts = atrium
    rng, (h, w) = np.random.default_rng(7), query.sides.shape
    made = [
        RayPass(
            query.origins.reshape(-1, 3),
            rng.normal(size=(h * w, 3)).astype(np.float32),
            np.full(h * w, -1, np.int32),
        )
        for _ in range(3)
    ]
    members = [PassRaySet(parts, OPTIONS, pass_rays(rays, h, w, 100.0), 2) for rays in made]
    both = CombinedRaySets(members)
    n = 4000
    tile, set_, row = (
        rng.integers(0, both.tiles.smallest, n),
        rng.integers(0, 3, n),
        rng.integers(0, len(parts.lines), n),
    )
    answers = both.answer(Pairs(*(a.astype(np.int32) for a in (tile, set_, row))), 5)
    for k, member in enumerate(members):
        mine = set_ == k
        own = Pairs(*(a[mine].astype(np.int32) for a in (tile, np.zeros(n), row)))
        np.testing.assert_array_equal(member.answer(own, 5).counts, answers.counts[mine])
    assert len(np.unique(answers.counts > 5)) == 2
