"""Random cameras and lights: they depend on their number and the seed alone, and stand in free space."""

import numpy as np
import pytest

import antumbra as at
from antumbra.datasets import random_views
from antumbra.datasets.random_views import orbit_camera, random_camera, random_light, sampling_region
from antumbra.engine.primary_visibility import primary_visibility
from antumbra.scene.camera import bounding_sphere
from engine.test_default_view import BOXES, MAP

ATRIUM = sampling_region(at.procedural("atrium", triangles=2000), 0.0, None)
SIZE = 16, 12
CORNERS = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], float)
OUTWARD = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]


def box(lower, upper, inward=False) -> np.ndarray:
    """(12, 3, 3): the faces of a box, seen from outside or from inside."""
    faces = [f for a, b, c, d in OUTWARD for f in ((a, b, c), (a, c, d))]
    corners = np.asarray(lower) + CORNERS * (np.asarray(upper) - np.asarray(lower))
    soup = corners[np.array(faces)]
    return soup[:, ::-1] if inward else soup


def same(a: at.Camera, b: at.Camera) -> bool:
    return all((getattr(a, n) == getattr(b, n)).all() for n in ("position", "target", "up")) and a.vfov == b.vfov


def test_boxes_face_outwards():
    soup = box((0, 0, 0), (1, 2, 3))
    normals = np.cross(soup[:, 1] - soup[:, 0], soup[:, 2] - soup[:, 0])
    assert ((soup.mean(axis=1) - (0.5, 1, 1.5)) * normals).sum(axis=1).min() > 0


def test_a_camera_depends_on_its_number_and_the_seed():
    first = [random_camera(ATRIUM, 3, k, SIZE) for k in range(4)]
    again = [random_camera(ATRIUM, 3, k, SIZE) for k in (2, 0)]
    assert same(first[2], again[0]) and same(first[0], again[1])
    assert not same(first[0], first[1]) and not same(first[0], random_camera(ATRIUM, 4, 0, SIZE))
    threaded = random_camera(ATRIUM._replace(threads=1), 3, 1, SIZE)
    assert same(first[1], threaded)


def test_cameras_see_much_of_the_scene():
    for k in range(8):
        camera = random_camera(ATRIUM, 1, k, (32, 32))
        face = at.render(ATRIUM.scene, camera, at.PointLight((0, 3, 0)), spp=1).gbuffer.face
        assert (face >= 0).mean() > 0.2 and len(np.unique(face)) > 8


def test_a_wide_ground_of_few_faces_is_left_out():
    rng = np.random.default_rng(0)
    town = np.concatenate([box(p, p + 1.0) for p in rng.uniform(-10, 10, (200, 3)) * (1, 0, 1)])
    ground = box((-1000, -2, -1000), (1000, -1, 1000))
    place = sampling_region(at.Scene.from_arrays(np.concatenate([town, ground])), 0.0, None)
    assert np.abs(place.bounds).max() < 15 and np.ptp(place.bounds, axis=0).min() > 0.5
    cameras = [random_camera(place, 0, k, SIZE) for k in range(4)]
    assert max(np.abs(c.position).max() for c in cameras) < 30


@pytest.mark.parametrize("inward", [False, True])
def test_cameras_stand_outside_solids_and_inside_rooms(inward):
    place = sampling_region(at.Scene.from_arrays(box((0, 0, 0), (2, 3, 4), inward)), 0.0, None)
    for k in range(6):
        p = random_camera(place, 0, k, SIZE).position
        assert ((p > 0) & (p < (2, 3, 4))).all() == inward


def test_no_view_is_an_error_that_names_the_cure(monkeypatch):
    monkeypatch.setattr(random_views, "TRIES", 4)
    monkeypatch.setattr(random_views, "MIN_HIT_SHARE", 2.0)
    with pytest.raises(at.InputError, match=r"no view for random camera 5 in 4 tries \(4 see little\).*--camera"):
        random_camera(ATRIUM, 0, 5, SIZE)
    solid = sampling_region(at.Scene.from_arrays(box((0, 0, 0), (2, 3, 4))), 0.0, None)
    with pytest.raises(
        at.InputError, match=r"no place for random light 1 in 4 tries \(4 are in or at a wall\).*--light"
    ):
        random_light(solid, 0, 1)


@pytest.mark.parametrize("up", ["y", "z"])
def test_an_orbit_goes_around_at_equal_angles(up):
    scene = at.Scene.from_arrays(box((0, 0, 0), (2, 3, 4)), up=up)
    centre, radius = bounding_sphere(scene.bounds)
    views = [orbit_camera(sampling_region(scene, 0.0, None), k, 6, SIZE) for k in range(6)]
    towards = np.array([v.position - centre for v in views])
    axis = "xyz".index(up)
    assert np.allclose(towards[:, axis], towards[0, axis]) and towards[0, axis] > 0
    assert np.allclose(np.linalg.norm(towards, axis=1), np.linalg.norm(towards[0]))
    flat = np.delete(towards, axis, axis=1)
    turned = (flat * np.roll(flat, 1, axis=0)).sum(axis=1) / (flat**2).sum(axis=1)
    assert np.allclose(turned, np.cos(np.radians(60.0)))
    assert np.allclose(flat.sum(axis=0), 0.0, atol=1e-9 * radius)
    assert all((at.render(scene, v, at.PointLight((9, 9, 9)), spp=1).gbuffer.face >= 0).any() for v in views)


@pytest.mark.parametrize("up", ["y", "z"])
@pytest.mark.parametrize("inward", [True, False])
@pytest.mark.parametrize("name", BOXES)
def test_an_orbit_in_a_closed_box_stands_inside_and_shows_what_the_box_encloses(name, inward, up):
    lower, upper = np.array(BOXES[name], float)
    soup = np.concatenate([box(lower, upper, inward), MAP])
    soup = soup if up == "y" else soup[..., [0, 2, 1]] * (1, -1, 1)
    scene = at.Scene.from_arrays(soup, up=up)
    lower, upper = scene.bounds
    place, directions = sampling_region(scene, 0.0, None), []
    for size in ((32, 32), (64, 16), (16, 64)):
        for k in range(5):
            camera = orbit_camera(place, k, 5, size)
            assert (camera.position > lower).all() and (camera.position < upper).all()
            face = primary_visibility(scene.triangles(), camera, None).face
            assert (face >= 12).mean() > 0.03, (size, k)
            directions.append(camera.axes[2])
    flat = np.delete(np.array(directions[:5]), "xyz".index(up), axis=1)
    flat /= np.linalg.norm(flat, axis=1)[:, None]
    assert np.allclose(flat.sum(0), 0.0)


def test_an_orbit_in_a_furnished_room_stands_between_the_furniture_and_its_middle():
    chairs = np.concatenate([box((x, 0, z), (x + 0.4, 1, z + 0.4)) for x in (-3, 1, 2.5) for z in (-2, 0.3, 1.5)])
    scene = at.Scene.from_arrays(np.concatenate([box((-4, 0, -3), (4, 2.5, 3), inward=True), chairs]))
    place = sampling_region(scene, 0.0, None)
    for k in range(8):
        camera = orbit_camera(place, k, 8, (32, 24))
        assert ((camera.position > (-4, 0, -3)) & (camera.position < (4, 2.5, 3))).all()
        assert not place.walled(camera.position, 1e-3)
        assert len(np.unique(primary_visibility(scene.triangles(), camera, None).face)) > 8


def test_lights_are_suns_above_the_horizon_and_spheres_in_free_space():
    lights = [random_light(ATRIUM, 2, k) for k in range(8)]
    assert [type(s) for s in lights] == [at.DirectionalLight, at.SphereLight] * 4
    heights = [np.degrees(np.arcsin(-s.direction[1])) for s in lights[::2]]
    assert 10.0 <= min(heights) < max(heights) <= 80.0
    lower, upper = ATRIUM.bounds
    radius = bounding_sphere(ATRIUM.bounds)[1]
    for sphere in lights[1::2]:
        assert (sphere.center >= lower).all() and (sphere.center <= upper).all()
        assert 0.01 * radius <= sphere.radius <= 0.05 * radius
    assert (random_light(ATRIUM, 2, 4).direction == lights[4].direction).all()
    assert (random_light(ATRIUM, 3, 4).direction != lights[4].direction).any()
