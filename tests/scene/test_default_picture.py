"""The sun of default pictures: low over what is flat, so that its relief shows; bakes and pages have the same one."""

from functools import partial

import numpy as np
import pytest

import antumbra as at
from antumbra.baking.bake_input import default_bake_lights
from antumbra.scene.default_picture import KINDS, DefaultView, framed_points, view_of_bounds
from antumbra.scene.scene_bounds import corners_within, detail_box


def elevation_of(sun, up):
    towards = -np.asarray(sun.direction)
    return np.degrees(np.arcsin(towards["xyz".index(up)] / np.linalg.norm(towards)))


def box_of(width, depth, height, up):
    return np.array([[0.0, 0.0, 0.0], [width, depth, height] if up == "z" else [width, height, depth]])


@pytest.mark.parametrize("up", "yz")
@pytest.mark.parametrize(
    "size, elevation", [((100, 60, 10), 28), ((60, 100, 10), 28), ((100, 60, 17), 48), ((1, 1, 3), 48)], ids=str
)
def test_the_sun_is_low_over_what_is_flat_however_it_is_turned(size, elevation, up):
    sun = view_of_bounds(box_of(*size, up), up).sun()
    assert elevation_of(sun, up) == pytest.approx(elevation)


def test_level_ground_alone_keeps_the_high_sun():
    """Nothing casts a shadow there."""
    assert elevation_of(view_of_bounds(box_of(100, 60, 0, "z"), "z").sun(), "z") == pytest.approx(48)


def test_the_size_of_a_scene_does_not_move_its_sun():
    suns = [view_of_bounds(scale * box_of(100, 60, 10, "z"), "z").sun() for scale in (1e-3, 1.0, 1e6)]
    assert all(np.array_equal(sun.direction, suns[0].direction) for sun in suns)


def test_default_lights_and_bakes_have_the_same_sun():
    heights = np.linspace(0.0, 2.0, 80).reshape(8, 10)
    scene = at.from_raster((heights, (2.0, 0.0, 0.0, 0.0, -2.0, 0.0)))
    shown, baked = scene.default_lights()[0], default_bake_lights(scene, "sun", 0.0)[0]
    assert elevation_of(shown, "z") == pytest.approx(28)
    assert np.array_equal(shown.direction, baked.direction)


def test_a_store_has_the_sun_of_its_scene_in_memory(tmp_path):
    """A tower on a wide plain: cameras in memory show the tower, and those of a store its bounds."""
    rng = np.random.default_rng(0)
    tower = rng.uniform((-20, 0, -20), (20, 30, 20), (2000, 1, 3)) + rng.normal(0, 0.7, (2000, 3, 3))
    a, b, c, d = np.array([[-500.0, 0, -500], [500, 0, -500], [500, 0, 500], [-500, 0, 500]])
    scene = at.Scene.from_arrays(np.concatenate([tower, [[a, b, c], [a, c, d]]]))
    at.build_store(scene, tmp_path / "tower.antumbra")
    stored = at.load(tmp_path / "tower.antumbra").default_lights()[0]
    assert np.array_equal(stored.direction, scene.default_lights()[0].direction)


def grid(n):
    x, z = np.meshgrid(np.arange(n), np.arange(n))
    corners = np.stack([x, 0 * x, z], -1).reshape(-1, 1, 3)
    return corners + np.array([[0, 0, 0], [0, 0, 1], [1, 0, 0]])


FACES = {
    "a triangle": np.array([[[0, 0, 0], [1, 2, 0], [3, 0, 1]]]),
    "a point": np.ones((1, 3, 3)),
    "a floor": grid(40),
    "a tower on a floor": np.concatenate([grid(40), 20 + (grid(20) - 10) @ [[1, 0, 0], [0, 0, 1], [0, 1, 0]]]),
    "noise": np.random.default_rng(0).normal(0, 1, (3000, 3, 3)),
    "a distant city": at.procedural("city", triangles=4000).data.sampled_faces() + (1e5, 50, -3e6),
}


@pytest.mark.parametrize("up", "yz")
@pytest.mark.parametrize("faces", FACES.values(), ids=FACES)
def test_few_points_have_the_cameras_of_all(faces, up):
    faces = np.asarray(faces, np.float64)
    points, bounds = corners_within(faces, detail_box(faces)), np.stack([faces.min((0, 1)), faces.max((0, 1))])
    few = framed_points(faces, up)
    assert len(few) <= min(len(points), 300)
    both = [DefaultView(each, up, None, bounds) for each in (few, points)]
    for kind in KINDS:
        for size in ((1, 1), (1024, 1024), (1920, 1080), (90, 1200), (4000, 31)):
            one, other = ((v.camera if kind == "perspective" else partial(v.other_camera, kind))(*size) for v in both)
            for name in ("position", "target", "up", "vfov", "extent"):
                assert np.array_equal(getattr(one, name), getattr(other, name)), (kind, size)
