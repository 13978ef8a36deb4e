"""Multi-frusta primary rays equal tracing the BVH ray by ray, bit for bit."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from antumbra.base.errors import InputError
from antumbra.bvh.block_tree import block_tree
from antumbra.bvh.nodes import tree_of
from antumbra.engine.method_registry import BUILDERS
from antumbra.kernels.exact.filters import hit_t
from antumbra.kernels.jit import kernel
from antumbra.query.gbuffer import pixel_ray
from antumbra.trace.primary.primary_rays import trace_primary
from antumbra.trace.rays.ray_traversal import CLOSEST, walk
from raster_scenes import FAMILIES, SHAPES, lattices, scattered, view
from strength import examples


@kernel
def _walk_all(bvh, rays, face, t):
    for y in range(rays.height):
        for x in range(rays.width):
            ray, tree = pixel_ray(rays, x, y), tree_of(bvh)
            slot, _ = walk(tree, ray, np.int64(-1), 0, CLOSEST, None, None)
            face[y, x] = -1 if slot < 0 else bvh.prim_ids[slot]
            t[y, x] = np.inf if slot < 0 else hit_t(ray, tree.corners, slot)


def check(triangles, rays, **options):
    """Check that the result equals `walk`; return (face, t), so that a test can also check the picture's contents."""
    triangles = np.ascontiguousarray(triangles, np.float32).reshape(-1, 3, 3)
    bvh = BUILDERS["bsah"].build(triangles, 1)
    true_face, true_t = np.empty((rays.height, rays.width), np.int32), np.empty((rays.height, rays.width))
    _walk_all(bvh, rays, true_face, true_t)
    face, t = trace_primary(block_tree(bvh, 1), rays, **options)
    assert face.dtype == np.int32 and t.dtype == np.float64
    assert np.array_equal(face, true_face)
    assert np.array_equal(t, true_t)
    return face, t


@pytest.mark.parametrize("family", FAMILIES)
@examples(60)
@given(
    seed=st.integers(0, 2**32 - 1),
    n=st.integers(0, 60),
    scale=st.sampled_from([1.0, 1e-6, 1e6]),
    shape=st.sampled_from(SHAPES),
    vfov=st.sampled_from([1.0, 60.0, 90.0, 170.0]),
    target=st.sampled_from([(0, 0, -1), (0.3, -0.2, -1), (1e-4, 1e-3, -1)]),
)
def test_hard_scenes_are_as_walked(family, seed, n, scale, shape, vfov, target):
    """Shared edges and vertices, duplicates, slivers, no area, planes through the eye, the eye between triangles."""
    rays = view(target=target, vfov=vfov, width=shape[0], height=shape[1])
    triangles = family(np.random.default_rng(seed), n, rays)
    check(scale * np.asarray(triangles, float).reshape(-1, 3, 3), rays, threads=1)


@examples(100)
@given(lattices())
def test_lattice(lattice):
    check(*lattice, threads=1)


@pytest.mark.parametrize("away", [0.0, 1e3])
@pytest.mark.parametrize("position", [(0, 0, 0), (0.2, -0.1, -4.0)])
def test_soup_of_many_blocks(position, away):
    """Many blocks in a tile. The eye is also inside the soup, and far from the origin, where coordinates are coarse."""
    rng = np.random.default_rng(5)
    triangles = rng.normal(size=(4000, 1, 3)) * (3, 3, 2) + rng.normal(size=(4000, 3, 3)) * 0.2 + (0, 0, -4)
    triangles[::7, 2] = triangles[::7, 1]  # without area
    triangles[3::50] = triangles[4::50]  # duplicates
    rays = view(np.add(position, away), np.add((0.1, 0.2, -5.0), away), width=150, height=90)
    face, _ = check(triangles + away, rays)
    assert len(np.unique(face)) > 200


def test_subpixel_triangles():
    """A height field of triangles smaller than a pixel, with shared edges, has no holes."""
    x, z = np.meshgrid(np.linspace(-40, 40, 160), np.linspace(-1, -60, 160))
    points = np.stack([x, -3 + 0.3 * np.sin(x) * np.cos(z), z], -1)
    a, b, c, d = points[:-1, :-1], points[1:, :-1], points[:-1, 1:], points[1:, 1:]
    triangles = np.concatenate([np.stack([a, b, c], -2).reshape(-1, 3, 3), np.stack([c, b, d], -2).reshape(-1, 3, 3)])
    face, _ = check(triangles, view(target=(0, -3, -20), vfov=30.0, width=70, height=50))
    assert (face >= 0).mean() > 0.5 and len(np.unique(face)) > 1000


def test_of_duplicates_the_first_is_seen():
    triangle = np.array([[[-2, -2, -3], [3, -2, -4], [0, 3, -3.5]]])
    face, _ = check(np.repeat(triangle, 40, 0), view(width=40, height=40))
    assert set(np.unique(face)) == {-1, 0}


@pytest.mark.parametrize("up", [(0, 1, 0), (1, 0, 0)])
@pytest.mark.parametrize("axis", [0, 1, 2])
@pytest.mark.parametrize("sign", [1, -1])
def test_views_along_the_axes(axis, sign, up):
    """Frusta whose directions change sign along two axes."""
    target = sign * np.eye(3)[axis]
    if abs(np.dot(up, target)) > 0.5:
        up = (0, 0, 1)
    triangles = 3 * sign * np.eye(3)[axis] + np.random.default_rng(axis).normal(size=(200, 3, 3))
    face, _ = check(triangles, view(target=target, up=up, width=48, height=48))
    assert len(np.unique(face)) > 10


@pytest.mark.parametrize("vfov", [1e-9, 1e-4, 179.9, 179.999999])
def test_extreme_fields_of_view(vfov):
    triangles = np.concatenate(
        [scattered(np.random.default_rng(0), 20, None), [[[-3e11, -2e11, -2], [3e11, -2e11, -3], [0, 4e11, -2]]]]
    )
    face, _ = check(triangles, view(target=(0.1, 0.05, -1), vfov=vfov, width=24, height=20))
    assert (face >= 0).any()


@pytest.mark.parametrize("scale", [1e-34, 1e-30, 1e-12, 1e12])
def test_extreme_scales(scale):
    """Scales down to values where float32 decides nothing."""
    rng = np.random.default_rng(1)
    face, _ = check(scale * (rng.normal(size=(40, 3, 3)) + (0, 0, -3)), view())
    assert len(np.unique(face)) > 5


def test_threads_and_trees_do_not_change_the_picture():
    rng = np.random.default_rng(2)
    triangles = rng.normal(size=(3000, 1, 3)) * (3, 3, 1) + rng.normal(size=(3000, 3, 3)) * 0.3 + (0, 0, -4)
    rays = view(width=200, height=130)
    first = check(triangles, rays, threads=1)
    bvh = BUILDERS["bsah"].build(triangles.astype(np.float32), 2)
    for tree in (bvh, block_tree(bvh, 2, 8)):
        for threads in (2, 5, None):
            assert all(np.array_equal(a, b) for a, b in zip(trace_primary(tree, rays, threads), first))


def test_nothing_to_see():
    face, t = check(np.empty((0, 3, 3)), view(width=5, height=3))
    assert (face == -1).all() and np.isinf(t).all()


def test_pixels_that_cannot_be_told_apart_are_refused():
    bvh = BUILDERS["bsah"].build(np.zeros((1, 3, 3), np.float32), 1)
    with pytest.raises(InputError, match="vfov"):
        trace_primary(bvh, view(vfov=1e-40))
