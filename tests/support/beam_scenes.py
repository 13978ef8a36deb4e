"""Receivers, lights and triangles that are hard for a hierarchy over rays, by name. Each is drawn at random."""

from typing import NamedTuple

import numpy as np

import antumbra as at
from antumbra.query.light_samples import light_samples
from antumbra.query.query_bounds import reach
from antumbra.query.receivers import NOTHING, surface_receivers
from antumbra.query.shadow_query import ShadowQuery, segments
from antumbra.scene.triangles import Triangles
from hierarchies import points_query, triangles_of


def units(rng, m):
    """(m, 3) unit vectors in all directions."""
    v = rng.normal(size=(m, 3))
    return v / np.linalg.norm(v, axis=1, keepdims=True)


def _unit(rng):
    return units(rng, 1)[0]


def _narrow(rng, m):
    around = _unit(rng) + units(rng, m) * 10.0 ** rng.uniform(-7, 0)
    return around * (1 + rng.uniform(-1, 1, (m, 1)) * 10.0 ** rng.uniform(-6, 0))


def _wide(rng, m):
    """Vectors in a cone of half-angle pi / 2 or another wide angle. Half of them are on its rim."""
    w, d = _unit(rng), units(rng, m)
    angle = np.pi / 2 + rng.choice([0, 1e-7, -1e-6, 1e-3, -0.2, 0.3, 1.2, 1.57])
    across = d - (d @ w)[:, None] * w
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    angles = np.where(rng.random(m) < 0.5, angle, angle * rng.random(m))[:, None]
    return np.cos(angles) * w + np.sin(angles) * across


RECEIVERS = {
    "a narrow cone": _narrow,
    "a wide cone": _wide,
    "all around": units,
    "near and far": lambda rng, m: units(rng, m) * 10.0 ** rng.uniform(-6, 3, (m, 1)),
    "a grid": lambda rng, m: np.round(rng.normal(size=(m, 3)) * 3),
    "a line": lambda rng, m: (
        _unit(rng) * 10.0 ** rng.uniform(-3, 2, (m, 1)) + units(rng, m) * 10.0 ** rng.uniform(-9, -1)
    ),
    "a plane": lambda rng, m: rng.normal(size=(m, 3)) * (np.arange(3) != rng.integers(3)),
    "one point": lambda rng, m: np.tile(_unit(rng), (m, 1)),
    "at the light, and around": lambda rng, m: units(rng, m) * (np.arange(m) > 0)[:, None],
}
"""Name -> function of (rng, m): (m, 3) receivers at a distance of about 1 from the light at the origin."""

LIGHTS = {
    "point": lambda rng, at_, r: at.PointLight(at_),
    "quad": lambda rng, at_, r: at.QuadLight(at_ - r / 2, _unit(rng) * r, _unit(rng) * r),
    "sphere": lambda rng, at_, r: at.SphereLight(at_, r),
    "list": lambda rng, at_, r: at.PointLights(at_ + rng.normal(size=(4, 3)) * r),
    "interleaved list": lambda rng, at_, r: at.PointLights(at_ + rng.normal(size=(37, 3)) * r, interleave=True),
    "sun": lambda rng, at_, r: at.DirectionalLight(
        _unit(rng) if rng.random() < 0.5 else np.eye(3)[1], rng.choice([0, 0.53, 10, 60, 120, 170, 179.99, 179.9999999])
    ),
    "ambient": lambda rng, at_, r: at.AmbientOcclusion(rng.choice([None, r])),
}
"""Name -> function of (rng, position, extent): a light."""


class Segment(NamedTuple):
    """A segment at which a triangle is aimed, in float64."""

    x: np.ndarray  # (3,) float64: a point of the segment
    o: np.ndarray  # (3,) float64: the segment's receiver
    d: np.ndarray  # (3,) float64: from the receiver to the segment's end
    others: np.ndarray  # (m, 3) float64: all receivers
    size: float  # size of the triangle


def _around(rng, s):
    """A triangle that contains the point."""
    v = rng.normal(size=(3, 3)) * s.size
    return v + s.x - rng.dirichlet([1, 1, 1]) @ v


def _sliver(rng, s):
    u = _unit(rng) * s.size
    third = u * rng.random() + _unit(rng) * s.size * 10.0 ** rng.uniform(-9, -1)
    return s.x + np.stack([-u * rng.random(), u, third])


def _across(rng, s):
    """A large triangle, nearly at a right angle to the segment."""
    w = s.d / max(np.linalg.norm(s.d), 1e-300)
    a = np.cross(w, _unit(rng))
    b = np.cross(w, a)
    v = np.stack([a, -0.5 * a + 0.9 * b, -0.5 * a - 0.9 * b]) + _unit(rng) * rng.choice([0, 0.3])
    return s.x + v * 10.0 ** rng.uniform(-1, 4) * np.linalg.norm(s.d)


def _in_a_plane_with_the_end(rng, s):
    other = s.others[rng.integers(len(s.others))]
    t = rng.uniform(-0.5, 1.5, 2)
    end = s.o + s.d
    return np.stack([s.o + t[0] * s.d, other + t[1] * (end - other), end + _unit(rng) * s.size * rng.choice([0, 1])])


def _between_receivers(rng, s):
    return s.others[rng.integers(0, len(s.others), 3)] + s.d * rng.choice([0, 0.3, 0.5, 0.999])


def _on_a_grid(rng, s):
    v = np.round((s.x + rng.normal(size=(3, 3)) * s.size) / s.size * 2) * s.size / 2
    v[0] = s.x
    return v


TRIANGLES = {
    "a corner on it": lambda rng, s: s.x + rng.normal(size=(3, 3)) * s.size * [[0], [1], [1]],
    "around it": _around,
    "a sliver": _sliver,
    "an edge along it": lambda rng, s: np.stack([s.x, s.o + rng.random() * s.d, s.x + _unit(rng) * s.size]),
    "in a plane with its end": _in_a_plane_with_the_end,
    "large, across it": _across,
    "a corner at its end": lambda rng, s: np.stack([s.o + s.d, *(s.x + rng.normal(size=(2, 3)) * s.size)]),
    "between receivers": _between_receivers,
    "beside it": lambda rng, s: s.x + rng.normal(size=(3, 3)) * s.size,
    "along the axes": lambda rng, s: s.x + rng.normal(size=(3, 3)) * s.size * (np.arange(3) != rng.integers(3)),
    "on a grid": _on_a_grid,
}
"""Name -> function of (rng, `Segment`): a triangle (3, 3) that meets the segment, or nearly does."""


def aimed(rng, origins, ends, n):
    """(n, 3, 3) float32: triangles of all kinds, aimed at segments; origins (m, 3), ends (m, spp, 3)."""
    o, e = origins.astype(np.float64), ends.astype(np.float64)
    extent, kinds, out = np.abs(e - o[:, None]).max() + 1e-44, list(TRIANGLES.values()), []
    for k in range(n):
        i = rng.integers(len(o))
        d = e[i, rng.integers(e.shape[1])] - o[i]
        t = rng.choice([0.5, rng.random(), 1 - 10.0 ** rng.uniform(-8, 0), 10.0 ** rng.uniform(-8, 0)])
        out.append(kinds[k % len(kinds)](rng, Segment(o[i] + t * d, o[i], d, o, extent * 10.0 ** rng.uniform(-5, 2))))
    return np.clip(out, -4e37, 4e37).astype(np.float32)


def lit(seed, light, receivers, scale, m=64, n=33) -> tuple[Triangles, ShadowQuery]:
    """Free-floating receivers, and triangles that are aimed at their segments. `light`, `receivers`: names."""
    rng = np.random.default_rng(seed)
    place = np.float32(rng.normal(size=3) * rng.choice([0, 1, 1], 3) * 10.0 ** rng.uniform(-9, 3) * scale)
    place = place.astype(np.float64)
    points = (place + RECEIVERS[receivers](rng, m) * 10.0 ** rng.uniform(-3, 1) * scale).astype(np.float32)
    far = max(float(np.abs(points - place).max()), 1e-40)
    made = LIGHTS[light](rng, place, far * 10.0 ** rng.uniform(-6, 0.5))
    normals = units(rng, m) if light == "ambient" else None
    spp = int(rng.choice([1, 4, 9]))
    room = triangles_of(place + rng.normal(size=(3, 3, 3)) * far)
    first = points_query(room, points, made, spp, normals)
    triangles = triangles_of(aimed(rng, points, segments(first)[0][0], n))
    return triangles, points_query(triangles, points, made, spp, normals)


def beside_a_small_light(seed, m=64, n=20) -> tuple[Triangles, ShadowQuery]:
    """Triangles with corners at all magnitudes of distance from a small light; receivers just behind their edges."""
    rng = np.random.default_rng(seed)
    place = rng.normal(size=3) * rng.choice([0, 1, 1], 3) * 10.0 ** rng.uniform(-14, 2, 3)
    place, far = np.float32(place).astype(np.float64), 10.0 ** rng.uniform(-2, 4)
    r, corners = far * 10.0 ** rng.uniform(-15, -1), np.empty((n, 3, 3))
    for k in range(n):
        w, a, b = _unit(rng), 10.0 ** rng.uniform(-13, 0) * far, 10.0 ** rng.uniform(-3, 0) * far
        near = w * a + _unit(rng) * a * 10.0 ** rng.uniform(-9, 0)
        third = (
            _unit(rng) * b,
            w * b * rng.uniform(-1, 2) + _unit(rng) * a,
            w * a + _unit(rng) * a * 10.0 ** rng.uniform(-7, 0),
        )
        corners[k] = place + [near, w * b * rng.choice([1, 1, -1]), third[k % 3]]
    corners = corners.astype(np.float32).astype(np.float64)
    weights = rng.dirichlet([1, 1, 1], m) * np.where(
        np.arange(3) == rng.integers(0, 3, (m, 1)), 10.0 ** rng.uniform(-9, 0, (m, 1)), 1
    )
    weights[::3] = np.eye(3)[rng.integers(0, 3, len(weights[::3]))]
    on = np.einsum("mk,mki->mi", weights / weights.sum(1, keepdims=True), corners[rng.integers(0, n, m)])
    kind = list(LIGHTS)[rng.integers(0, 3)]
    from_ = place + rng.normal(size=(m, 3)) * (0 if kind == "point" else 0.4 * r)
    points = from_ + (on - from_) * (1 + 10.0 ** rng.uniform(-5, 3, (m, 1)))
    triangles = triangles_of(corners)
    return triangles, points_query(triangles, points, LIGHTS[kind](rng, place, r), 4)


def on_surfaces(seed, light, shape=(13, 18), n=40, offset=0.0, spp=5, cull_faces=0) -> tuple[Triangles, ShadowQuery]:
    """A picture whose receivers lie on both sides of triangles of a soup. Some pixels see nothing."""
    rng = np.random.default_rng(seed)
    size = rng.choice([0.1, 0.5, 3.0])
    soup = rng.normal(size=(n, 1, 3)) + rng.normal(size=(n, 3, 3)) * size
    if rng.random() < 0.5:
        soup = np.round(soup * 4) / 4
    soup[n // 2 :: 5, 2] = soup[n // 2 :: 5, 1]  # no area
    triangles = triangles_of(soup + offset)
    corners, m = triangles.vertices.astype(np.float64), shape[0] * shape[1]
    faces = rng.integers(0, n // 2, m).astype(np.int32)
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])[faces]
    length = np.linalg.norm(normals, axis=1, keepdims=True)
    sides = np.where(rng.random(m) < 0.1, NOTHING, rng.choice([-1, 1], m)).astype(np.int8)
    sides[length[:, 0] == 0.0] = NOTHING
    normals = (normals * sides[:, None] / np.maximum(length, 1e-300)).astype(np.float32)
    weights = rng.dirichlet([1, 1, 1], m)
    weights[::4] = np.round(weights[::4])  # on corners and on edges
    positions = np.einsum("mk,mki->mi", weights / np.maximum(weights.sum(1, keepdims=True), 0.5), corners[faces])
    flat = triangles.vertices.reshape(-1, 9)
    origins = surface_receivers(positions.astype(np.float32), normals, faces, sides, flat, 1)
    made = LIGHTS[light](rng, offset + rng.normal(size=3), 10.0 ** rng.uniform(-3, 0.5))
    query = ShadowQuery(
        origins.reshape(*shape, 3),
        faces.reshape(shape),
        sides.reshape(shape),
        normals.astype(np.float64).reshape(*shape, 3),
        flat,
        made.patch(triangles.origin, reach(triangles, origins)),
        light_samples(made, spp),
        cull_faces,
        faces.reshape(shape),
    )
    return triangles, query
