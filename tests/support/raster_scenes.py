"""Cameras and families of triangles that are hard for a rasteriser."""

import numpy as np
from hypothesis import strategies as st

from antumbra.scene.camera import Camera

SHAPES = ((32, 32), (33, 17), (1, 1), (7, 65), (64, 40), (130, 5))  # (width, height): full, cut and single tiles


def view(position=(0, 0, 0), target=(0, 0, -1), up=(0, 1, 0), vfov=90.0, width=32, height=32):
    return Camera(position, target, up, vfov, width, height).rays(np.zeros(3))


def exact_grid(rays):
    """The camera with directions that float32 represents exactly, without the rounding of its tangent."""
    grid = lambda v: np.round(np.asarray(v) * rays.height * 4) / (rays.height * 4)
    return rays._replace(corner=grid(rays.corner), dx=grid(rays.dx), dy=grid(rays.dy))


def directions(rays, x, y):
    """Directions of pixels, in float64."""
    return rays.corner + (np.asarray(x) + 0.5)[..., None] * rays.dx + (np.asarray(y) + 0.5)[..., None] * rays.dy


# --- families of triangles in front of, around and behind an eye at the origin that looks along -z -------------------


def scattered(rng, n, rays):
    """Triangles of one size near a point. It is in front of the eye, at the eye, or behind it."""
    centre = np.array([(0, 0, -5), (0, 0, 0), (0.5, 0, -1), (0, 0, 5), (3, -2, -1)][rng.integers(5)], float)
    size = 10.0 ** rng.uniform(-6, 6)
    return centre + rng.choice([0.0, 0.1, 1.0, 10.0]) * rng.normal(size=(n, 1, 3)) + size * rng.normal(size=(n, 3, 3))


def on_pixel_rays(rng, n, rays):
    """Triangles whose corners lie on rays of a small window's pixels, up to float32's rounding.

    So edges graze pixel centres everywhere.
    """
    pixels = rng.integers(0, rng.integers(2, 12), (2, n, 3))
    return directions(rays, *pixels) * 10.0 ** rng.uniform(-1, 1, (n, 3, 1))


def coplanar(rng, n, rays):
    """Triangles in one plane, up to float32's rounding. All depths are nearly equal."""
    middle, axes = np.array([0, 0, -3.0]), rng.normal(size=(2, 3))
    return middle + (rng.normal(size=(n, 3, 2)) * rng.choice([0.3, 3.0])) @ axes


def slivers(rng, n, rays):
    """Long triangles that are far thinner than a pixel. Some have no area."""
    a, b = (rng.normal(size=(2, n, 1, 3)) * 3 + (0, 0, -3)).astype(np.float32)
    thickness = rng.choice([0.0, 1e-7, 1e-4, 1e-2])
    corners = np.concatenate([a, b, (a + b) / 2 + thickness * rng.normal(size=(n, 1, 3))], 1)
    return corners


def edge_on(rng, n, rays):
    """Triangles whose planes contain the eye, exactly or nearly."""
    spine = directions(rays, *rng.integers(0, 8, (2, n)))[:, None]
    off = rng.choice([0.0, 1e-12, 1e-7, 1e-4]) * rng.normal(size=(n, 3, 3))
    return spine * rng.uniform(0.5, 4, (n, 3, 1)) + np.array([0.1, 0.3, -0.2]) * rng.normal(size=(n, 3, 1)) + off


def mesh(rng, n, rays):
    """A bumpy sheet of triangles that share corners. It hides parts of itself."""
    side = max(2, int(np.sqrt(n / 2)) + 1)
    p = np.stack([*np.meshgrid(np.linspace(-2, 2, side), np.linspace(-2, 2, side)), np.zeros((side, side))], -1)
    p += rng.normal(size=p.shape) * rng.choice([0.0, 0.1, 1.0]) + (0, 0, -rng.choice([0.5, 2.0, 20.0]))
    a, b, c, d = p[:-1, :-1], p[:-1, 1:], p[1:, :-1], p[1:, 1:]
    return np.concatenate([np.stack([a, b, d], 2).reshape(-1, 3, 3), np.stack([a, d, c], 2).reshape(-1, 3, 3)])


FAMILIES = (scattered, on_pixel_rays, coplanar, slivers, edge_on, mesh)


_coordinate = st.integers(-3, 3)
_point = st.tuples(_coordinate, _coordinate, _coordinate)


@st.composite
def lattices(draw):
    """(triangles, rays) with integer coordinates.

    They have edges through pixel centres, equal depths, and the eye in planes and on edges.
    """
    triangles = np.array(draw(st.lists(st.tuples(_point, _point, _point), max_size=20)), np.float32)
    axis = draw(st.sampled_from([(0, 0, -1), (1, 0, 0), (0, -1, 0), (1, 0, 1)]))
    eye = np.array(draw(_point)) + draw(st.sampled_from([0.0, 0.5]))
    up = (0, 0, 1) if axis[1] else (0, 1, 0)
    shape = draw(st.sampled_from([(16, 16), (8, 12), (33, 5)]))
    return triangles, exact_grid(view(eye, eye + axis, up, 90.0, *shape))
