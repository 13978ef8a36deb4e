"""The bedroom behind blinds: light comes only through its window, and the blinds block most of it."""

import numpy as np
import pytest

import antumbra as at
from antumbra.lab.papers.scenes import bedroom as bedroom_module
from antumbra.lab.papers.scenes.bedroom import HALF_X, HALF_Z, HEIGHT


@pytest.fixture(scope="module")
def bedroom():
    return at.procedural("blinds", triangles=60_000)


@pytest.fixture(scope="module")
def corners(bedroom):
    """(n, 3, 3) float32: the triangles of the bedroom."""
    return (bedroom.triangles().vertices + bedroom.origin).astype(np.float32)


@pytest.fixture(scope="module")
def of_blinds(corners):
    """(n,) bool: whether each triangle lies where the blinds hang: in the opening, between the frame and the room."""
    behind = np.abs(corners[..., 0] + HALF_X + bedroom_module.HANG) < 0.09
    inside = (np.abs(corners[..., 2]) < bedroom_module.WIDTH / 2) & (corners[..., 1] > bedroom_module.SILL)
    return (behind & inside).all(axis=1)


def test_light_comes_through_the_window_only(corners, of_blinds):
    rng = np.random.default_rng(0)
    n, half = 20_000, np.array([HALF_X - 0.2, 0.0, HALF_Z - 0.2])
    start = rng.uniform(-half + [0, 0.1, 0], half + [0, HEIGHT - 0.3, 0], (n, 3))
    way = rng.normal(size=(n, 3))
    way /= np.linalg.norm(way, axis=1, keepdims=True)
    out = ~at.Scene.from_arrays(corners[~of_blinds]).occluded(start, way, tmax=50.0)
    assert 300 < out.sum() < n / 4
    for x in (-HALF_X, -HALF_X - bedroom_module.WALL):  # both ends of the opening
        crossing = start[out] + way[out] * ((x - start[out, 0]) / way[out, 0])[:, None]
        assert (way[out, 0] < 0.0).all()
        assert (np.abs(crossing[:, 2]) < bedroom_module.WIDTH / 2).all()
        assert (crossing[:, 1] > bedroom_module.SILL).all() and (crossing[:, 1] < bedroom_module.LINTEL).all()


def test_most_light_is_stopped_and_mostly_by_the_blinds(bedroom, corners, of_blinds):
    assert 0.1 < of_blinds.mean() < 0.3
    camera, (light,) = bedroom.cameras[0].resized(128, 128), bedroom.lights
    surface = at.render(bedroom, camera, light, spp=1).gbuffer
    seen = surface.face >= 0
    assert seen.mean() > 0.9
    points, normals = surface.position[seen] + bedroom.origin, surface.normal[seen]
    normals = normals * np.sign(np.sum((camera.position - points) * normals, axis=1, keepdims=True))
    place = np.random.default_rng(1).random((2, len(points), 1))
    to_light = light.corner + place[0] * light.u + place[1] * light.v - points
    asked = np.sum(to_light * normals, axis=1) > 0.0  # the others are below the surface's horizon
    start, way = (points + 1e-4 * normals)[asked], to_light[asked]
    by_blinds, by_others = (
        at.Scene.from_arrays(corners[which]).occluded(start, way, tmax=1.0) for which in (of_blinds, ~of_blinds)
    )
    blocked = by_blinds | by_others
    assert 0.4 < asked.mean() < 0.9
    assert 0.8 < blocked.mean() < 0.95
    assert by_blinds.sum() > 0.5 * blocked.sum()
    assert (by_blinds & ~by_others).sum() > (~blocked).sum(), "without blinds there is more than twice the light"
