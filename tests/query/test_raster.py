"""The rasteriser gives what tracing the exact ray of every pixel against every triangle gives, bit for bit."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from antumbra.jit import kernel
from antumbra.predicate.exact import ray_along
from antumbra.predicate.filters import hit_t, meets
from antumbra.query.pixels import pixel_direction
from antumbra.query.raster import rasterise
from antumbra.scene.camera import Camera


@kernel
def _trace_all(corners, rays, cull_faces, face, t):
    for y in range(rays.height):
        for x in range(rays.width):
            dx, dy, dz = pixel_direction(rays, x, y)
            o = rays.origin
            ray = ray_along(o[0], o[1], o[2], dx, dy, dz, 0.0, np.inf)
            face[y, x], t[y, x] = -1, np.inf
            for i in range(len(corners)):
                side = meets(ray, corners, i)
                if side != 0 and side != cull_faces:
                    ti = hit_t(ray, corners, i)
                    if ti < t[y, x]:
                        face[y, x], t[y, x] = i, ti


def traced(corners, rays, cull_faces=0):
    """The contract, as it is written: every pixel's ray against every triangle."""
    shape = (rays.height, rays.width)
    face, t = np.empty(shape, np.int32), np.empty(shape)
    _trace_all(corners, rays, cull_faces, face, t)
    return face, t


def check(corners, rays, **options):
    """Equal to the contract; returns the picture so that a test can also say what must be in it."""
    corners = np.ascontiguousarray(corners, np.float32).reshape(-1, 9)
    face, t = rasterise(corners, rays, **options)
    true_face, true_t = traced(corners, rays, options.get("cull_faces", 0))
    assert np.array_equal(face, true_face)
    assert np.array_equal(t, true_t)
    return face, t


def view(position=(0, 0, 0), target=(0, 0, -1), up=(0, 1, 0), vfov=90.0, width=32, height=32):
    return Camera(position, target, up, vfov, width, height).rays(np.zeros(3))


def soup(rng, n, centre, spread, size):
    """n random triangles about `size` large, their middles about `spread` from `centre`."""
    middles = centre + spread * rng.normal(size=(n, 1, 3))
    return middles + size * rng.normal(size=(n, 3, 3))


SIZES = ((32, 32), (33, 17), (1, 1), (7, 65), (64, 40), (100, 3))


@settings(max_examples=150, deadline=None)
@given(
    seed=st.integers(0, 2**32 - 1),
    n=st.integers(0, 40),
    centre=st.sampled_from([(0, 0, -5), (0, 0, 0), (0.5, 0, -1), (0, 0, 5), (3, -2, -1)]),
    spread=st.sampled_from([0.0, 0.1, 1.0, 10.0]),
    size=st.sampled_from([1e-6, 0.01, 0.3, 2.0, 50.0, 1e6]),
    scale=st.sampled_from([1e-6, 1.0, 1e6]),
    shape=st.sampled_from(SIZES),
    vfov=st.sampled_from([1.0, 60.0, 90.0, 170.0]),
    culling=st.sampled_from([0, 1, -1]),
)
def test_random_soups(seed, n, centre, spread, size, scale, shape, vfov, culling):
    rng = np.random.default_rng(seed)
    corners = scale * soup(rng, n, np.array(centre, float), spread, size)
    target = rng.normal(size=3) * 0.3 + (0, 0, -1)
    check(corners, view((0, 0, 0), target, vfov=vfov, width=shape[0], height=shape[1]), cull_faces=culling)


lattice = st.integers(-3, 3)
point = st.tuples(lattice, lattice, lattice)


@settings(max_examples=150, deadline=None)
@given(
    corners=st.lists(st.tuples(point, point, point), max_size=12),
    eye=point,
    axis=st.sampled_from([(0, 0, -1), (1, 0, 0), (0, -1, 0), (1, 0, 1)]),
    shape=st.sampled_from([(16, 16), (8, 12), (33, 5)]),
    half=st.sampled_from([0.0, 0.5]),
)
def test_lattice(corners, eye, axis, shape, half):
    """Whole numbers everywhere, so edges run through pixel centres, depths tie, and planes hold the eye."""
    up = (0, 0, 1) if axis[1] else (0, 1, 0)
    eye = np.array(eye) + half
    rays = view(eye, eye + axis, up, 90.0, *shape)
    check(np.array(corners, np.float32), exact_grid(rays), threads=1)


def exact_grid(rays):
    """The same camera with directions that are exact in float32, without the rounding of its tangent."""
    grid = lambda v: np.round(np.asarray(v) * rays.height * 4) / (rays.height * 4)
    return rays._replace(corner=grid(rays.corner), dx=grid(rays.dx), dy=grid(rays.dy))
