"""The rasteriser equals tracing the exact ray of every pixel against every triangle, bit for bit."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from antumbra.base.errors import InputError
from antumbra.kernels.exact.filters import hit_t, meets, rounded_t
from antumbra.kernels.jit import kernel
from antumbra.query.gbuffer import pixel_ray
from antumbra.query.rasteriser import RASTER_COUNTERS, new_raster_counters, rasterise
from raster_scenes import FAMILIES, SHAPES, directions, exact_grid, lattices, scattered, view
from strength import examples


@kernel
def _trace_all(corners, rays, cull_faces, face, t):
    for y in range(rays.height):
        for x in range(rays.width):
            ray = pixel_ray(rays, x, y)
            face[y, x], t[y, x], best_t, best_side = -1, np.inf, np.inf, 2
            for i in range(len(corners)):
                side = meets(ray, corners, i)
                if side != 0 and side != cull_faces:
                    ti = rounded_t(ray, corners, i)
                    if ti < best_t or (ti == best_t and side < best_side):
                        face[y, x], t[y, x], best_t, best_side = i, hit_t(ray, corners, i), ti, side


def traced(corners, rays, cull_faces=0):
    """The contract, computed literally: every pixel's ray against every triangle."""
    face, t = np.empty((rays.height, rays.width), np.int32), np.empty((rays.height, rays.width))
    _trace_all(corners, rays, cull_faces, face, t)
    return face, t


def check(triangles, rays, **options):
    """Check the contract; return (face, t), so that a test can also check the contents of the picture."""
    corners = np.ascontiguousarray(triangles, np.float32).reshape(-1, 9)
    face, t = rasterise(corners, rays, **options)
    true_face, true_t = traced(corners, rays, options.get("cull_faces", 0))
    assert np.array_equal(face, true_face)
    assert np.array_equal(t, true_t)
    return face, t


def sphere(n, radius=1.0):
    """A closed mesh of 8 n**2 triangles: an octahedron with divided faces, projected onto the sphere and rounded."""
    i, j = np.array([(i, j) for i in range(n) for j in range(n - i)]).T
    up = np.stack([np.stack([i, j], -1), np.stack([i + 1, j], -1), np.stack([i, j + 1], -1)], 1)
    inner = i + j < n - 1
    down = np.stack([np.stack([i + 1, j], -1), np.stack([i + 1, j + 1], -1), np.stack([i, j + 1], -1)], 1)[inner]
    flat = np.concatenate([up, down])
    face = np.concatenate([flat, n - flat.sum(-1, keepdims=True)], -1) / n
    signs = np.array([(a, b, c) for a in (1, -1) for b in (1, -1) for c in (1, -1)])
    points = (face * signs[:, None, None]).reshape(-1, 3, 3)
    return (radius * points / np.linalg.norm(points, axis=-1, keepdims=True)).astype(np.float32)


@pytest.mark.parametrize("family", FAMILIES)
@examples(60)
@given(
    seed=st.integers(0, 2**32 - 1),
    n=st.integers(0, 40),
    scale=st.sampled_from([1.0, 1e-6, 1e6]),
    shape=st.sampled_from(SHAPES),
    vfov=st.sampled_from([1.0, 60.0, 90.0, 170.0]),
    culling=st.sampled_from([0, 0, 1, -1]),
    duplicates=st.booleans(),
)
def test_families(family, seed, n, scale, shape, vfov, culling, duplicates):
    rng = np.random.default_rng(seed)
    rays = view((0, 0, 0), rng.normal(size=3) * 0.3 + (0, 0, -1), vfov=vfov, width=shape[0], height=shape[1])
    triangles = scale * family(rng, n, rays)
    if duplicates and len(triangles):
        triangles = triangles[rng.integers(0, len(triangles), 2 * len(triangles))][:, rng.permutation(3)]
    check(triangles, rays, cull_faces=culling)


@pytest.mark.parametrize("family", FAMILIES)
def test_families_cover_and_miss_pixels(family):
    rays, hits = view(width=48, height=48), 0
    for seed in range(8):
        face, _ = check(family(np.random.default_rng(seed), 30, rays), rays)
        hits += (face >= 0).sum()
    assert 0 < hits < 8 * face.size


@examples(200)
@given(lattices())
def test_lattice(lattice):
    check(*lattice, threads=1)


def test_edges_through_pixel_centres_belong_to_the_first_triangle():
    """Four quads around the picture's centre, at the same depth. Every seam and diagonal runs through pixel centres."""
    rays = exact_grid(view(width=16, height=16))
    steps = directions(rays, [0, 7, 15], [0, 7, 15])[:, :2].T  # x and y of columns and rows 0, 7, 15
    xs, ys = steps[0], steps[1]
    quads = []
    for y0, y1 in ((ys[0], ys[1]), (ys[1], ys[2])):
        for x0, x1 in ((xs[0], xs[1]), (xs[1], xs[2])):
            a, b, c, d = ([x, y, -1.0] for x, y in ((x0, y0), (x1, y0), (x0, y1), (x1, y1)))
            quads += [[a, b, d], [a, d, c]]
    counters = new_raster_counters()
    face, t = check(np.array(quads), rays, counters=counters)
    assert (face >= 0).all() and (t == 1.0).all()
    assert face[7, 7] == 0 and face[3, 3] == 0 and face[7, 12] == 3 and face[12, 7] == 4
    assert counters[RASTER_COUNTERS.index("uncertain")] > 40


def test_of_duplicates_the_first_is_seen():
    rays = view(width=40, height=40)
    triangle = np.array([[[-2, -2, -3], [3, -2, -4], [0, 3, -3.5]]])
    counters = new_raster_counters()
    face, _ = check(np.repeat(triangle, 5, 0), rays, counters=counters)
    assert set(np.unique(face)) == {-1, 0}
    assert counters[RASTER_COUNTERS.index("ties")] >= 4 * (face == 0).sum()


def test_floor_under_the_eye_reaches_the_horizon():
    """Two triangles under the camera, far larger than the view, cover exactly the lower half of the picture."""
    floor = np.array([[-1, -1, 1], [1, -1, 1], [1, -1, -1], [-1, -1, -1]]) * (1e6, 1.0, 1e6)
    face, _ = check([floor[[0, 1, 2]], floor[[0, 2, 3]]], view(width=64, height=64))
    assert (face[:32] == -1).all() and (face[32:] >= 0).all()


def test_what_is_behind_or_holds_the_eye_is_not_seen():
    behind = [[[-9, -9, 1e-3], [9, -9, 1e-3], [0, 9, 1e-3]]]
    through_eye = [
        [[-1, 0, -2], [1, 0, -2], [0, 0, 3]],
        [[0, 0, 0], [1, 0, -1], [0, 1, -1]],
        [[-1, -1, 0], [1, -1, 0], [0, 2, 0]],
    ]
    rays = view(width=33, height=33)
    for triangles in (behind, through_eye):
        face, t = check(triangles, rays)
        assert (face == -1).all() and np.isinf(t).all()


def test_facing():
    """The normal of a triangle that faces the camera points against the ray: side -1."""
    front = np.array([[[-1, -1, -2], [1, -1, -2], [0, 1, -2.0]]])
    back, rays = front[:, ::-1] + (0, 0, 0.5), view()
    face = lambda cull: set(np.unique(check([*back, *front], rays, cull_faces=cull)[0]))
    assert face(0) == {-1, 0} and face(1) == {-1, 1} and face(-1) == {-1, 0}


@pytest.mark.parametrize("n", [1, 2, 9])
@pytest.mark.parametrize("shape", [(65, 64), (150, 70)])
def test_closed_mesh_from_inside_has_no_hole(n, shape):
    triangles = sphere(n, 10.0)
    for target in ((0, 0, -1), (1, 1, 1), (1, 0, 0), (3, 2, 1)):
        face, t = check(triangles, view((0.5, -0.25, 0.125), target, (0.1, 1, 0), 100.0, *shape))
        assert (face >= 0).all() and np.isfinite(t).all()


def test_subpixel_mesh_has_no_hole():
    triangles = sphere(60)
    assert len(triangles) == 8 * 60**2
    face, _ = check(triangles, view(width=20, height=20))
    assert (face >= 0).all() and len(np.unique(face)) == face.size


def test_layers_are_seen_front_to_back():
    """Large layers in any order, split by tiles, hide the layers behind them."""
    rng = np.random.default_rng(3)
    depths = rng.permutation(np.arange(1, 60)) / 7.0
    quad = np.array([[-9, -9, -1], [9, -9, -1], [0, 15, -1.0]])
    counters = new_raster_counters()
    face, _ = check(depths[:, None, None] * quad, view(width=130, height=70), counters=counters)
    assert set(np.unique(face)) == {np.argmin(depths)}
    listed, drawn = counters[:2]
    assert listed == 59 * 6 and drawn < listed / 5


@pytest.mark.parametrize("vfov", [1e-9, 1e-4, 179.9, 179.999999])
def test_extreme_fields_of_view(vfov):
    """Directions of neighbouring pixels coincide in float32, or lie almost in the camera's plane."""
    rng = np.random.default_rng(0)
    triangles = np.concatenate([scattered(rng, 20, None), [[[-3e11, -2e11, -2], [3e11, -2e11, -3], [0, 4e11, -2]]]])
    face, _ = check(triangles, view(target=(0.1, 0.05, -1), vfov=vfov, width=24, height=20))
    assert (face >= 0).any()


@pytest.mark.parametrize("scale", [1e-30, 1e-12, 1e12])
def test_extreme_scales(scale):
    rng = np.random.default_rng(1)
    face, _ = check(scale * (rng.normal(size=(40, 3, 3)) + (0, 0, -3)), view())
    assert len(np.unique(face)) > 5


def test_threads_do_not_change_the_picture():
    rng = np.random.default_rng(2)
    corners = (rng.normal(size=(3000, 1, 3)) * (3, 3, 1) + rng.normal(size=(3000, 3, 3)) * 0.3 + (0, 0, -4)).astype(
        np.float32
    )
    corners, rays = corners.reshape(-1, 9), view(width=200, height=130)
    first, first_counts = traced(corners, rays), None
    for threads in (1, 2, 5, None):
        counters = new_raster_counters()
        face, t = rasterise(corners, rays, threads, counters=counters)
        assert np.array_equal(face, first[0]) and np.array_equal(t, first[1])
        first_counts = counters if first_counts is None else first_counts
        assert np.array_equal(counters, first_counts)
    named = dict(zip(RASTER_COUNTERS, first_counts))
    assert named["uncertain"] + named["ties"] < 1e-3 * named["pixels"]


def test_nothing_to_see():
    face, t = rasterise(np.empty((0, 9), np.float32), view(width=5, height=3))
    assert face.shape == t.shape == (3, 5)
    assert (face == -1).all() and np.isinf(t).all() and face.dtype == np.int32 and t.dtype == np.float64


@pytest.mark.parametrize(
    "corners, options, message",
    [
        (np.zeros((2, 3, 3), np.float32), {}, r"\(n, 9\)"),
        ([[0.0] * 9], {}, r"\(n, 9\)"),
        (np.zeros((2, 9)), {}, "float32"),
        (np.zeros((9, 2), np.float32).T, {}, "contiguous"),
        (np.zeros((2, 9), np.float32), {"cull_faces": 2}, "cull_faces"),
        (np.zeros((2, 9), np.float32), {"threads": 0}, "threads"),
    ],
)
def test_bad_input_is_named(corners, options, message):
    with pytest.raises(InputError, match=message):
        rasterise(corners, view(), **options)


def test_pixels_that_cannot_be_told_apart_are_refused():
    with pytest.raises(InputError, match="vfov"):
        rasterise(np.zeros((1, 9), np.float32), view(vfov=1e-40))
