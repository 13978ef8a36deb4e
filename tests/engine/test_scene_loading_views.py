"""Cameras and lights of files, and the defaults of a scene."""

import numpy as np
import pytest

from antumbra.base.errors import InputError
from antumbra.engine.scene_loading import load
from antumbra.scene.lights import DirectionalLight, PointLight, QuadLight
from gltf_files import TETRAHEDRON, TETRAHEDRON_FACES, Gltf, single, trs

Q = np.array([0.1, 0.7, -0.2, 0.4]) / np.linalg.norm([0.1, 0.7, -0.2, 0.4])


def with_camera(perspective, **node) -> Gltf:
    made = single(TETRAHEDRON, TETRAHEDRON_FACES)
    made.node(camera=made.add("cameras", type="perspective", perspective=perspective), **node)
    return made


def test_cameras_look_along_minus_z(tmp_path):
    made = with_camera({"yfov": 0.7, "znear": 0.1, "aspectRatio": 1.5}, translation=[1, 2, 3], rotation=Q.tolist())
    (camera,) = load(made.write(tmp_path)).cameras
    matrix = trs((1, 2, 3), Q)
    np.testing.assert_allclose(camera.position, [1, 2, 3])
    np.testing.assert_allclose(camera.target - camera.position, -matrix[:3, 2], atol=1e-12)
    np.testing.assert_allclose(camera.up, matrix[:3, 1], atol=1e-12)
    assert camera.vfov == pytest.approx(np.degrees(0.7))
    assert (camera.width, camera.height) == (1536, 1024)


def test_cameras_move_with_their_nodes(tmp_path):
    made = with_camera({"yfov": 1.0, "znear": 0.1})
    made.animate(1, "translation", [0, 1], [[0, 0, 5], [0, 0, 9]])
    scene = load(made.write(tmp_path))
    np.testing.assert_array_equal(scene.cameras[0].position, [0, 0, 5])
    np.testing.assert_array_equal(scene.camera(0, 0.5).position, [0, 0, 7])
    with pytest.raises(InputError, match="there is no camera 1; it has one camera, 0"):
        scene.camera(1)


def test_orthographic_cameras(tmp_path):
    made = with_camera({"yfov": 1.0, "znear": 0.1})
    flat = made.add("cameras", type="orthographic", orthographic={"xmag": 3, "ymag": 1.5, "zfar": 9, "znear": 1})
    made.node(camera=flat, translation=[1, 2, 3], rotation=Q.tolist())
    camera = load(made.write(tmp_path)).cameras[1]
    assert (camera.projection, camera.extent, camera.width, camera.height) == ("orthographic", 3.0, 2048, 1024)
    np.testing.assert_allclose(camera.position, [1, 2, 3])
    np.testing.assert_allclose(camera.axes[2], -trs((1, 2, 3), Q)[:3, 2], atol=1e-12)


def test_cameras_of_no_known_kind_are_left_out_and_noted(tmp_path):
    made = with_camera({"yfov": 1.0, "znear": 0.1})
    made.node(camera=made.add("cameras", type="orthographic"))
    with pytest.warns(UserWarning, match=r"cameras\[1\] is neither perspective nor orthographic"):
        scene = load(made.write(tmp_path))
    assert len(scene.cameras) == 1


def test_punctual_lights(tmp_path):
    made = single(TETRAHEDRON, TETRAHEDRON_FACES)
    lights = [
        {"type": "point", "intensity": 7.5, "color": [1, 0.5, 0.25]},
        {"type": "directional"},
        {"type": "spot", "spot": {}, "intensity": 2},
    ]
    made.json["extensions"] = {"KHR_lights_punctual": {"lights": lights}}
    for k in range(3):
        made.node(translation=[k, 1, 0], rotation=Q.tolist(), extensions={"KHR_lights_punctual": {"light": k}})
    made.animate(1, "translation", [0, 1], [[0, 1, 0], [4, 1, 0]])
    with pytest.warns(UserWarning, match="spot light"):
        scene = load(made.write(tmp_path))
    point, sun, spot = scene.lights
    assert isinstance(point, PointLight) and isinstance(sun, DirectionalLight) and isinstance(spot, PointLight)
    np.testing.assert_array_equal(point.position, [0, 1, 0])
    assert point.intensity == 7.5 and tuple(point.colour) == (1, 0.5, 0.25)
    np.testing.assert_allclose(sun.direction, -trs(rotation=Q)[:3, 2], atol=1e-12)
    assert sun.intensity == 1.0
    np.testing.assert_array_equal(spot.position, [2, 1, 0])
    np.testing.assert_array_equal(scene.light(0, 0.5).position, [2, 1, 0])
    with pytest.raises(InputError, match="no light 3"):
        scene.light(3)


@pytest.mark.parametrize("up", ["y", "z"])
@pytest.mark.parametrize("size", [(1024, 1024), (400, 1000), (1600, 200)])
@pytest.mark.parametrize("offset", [0.0, 5e6])
def test_the_default_camera_fits_the_scene(tmp_path, up, size, offset):
    scene = load(single(TETRAHEDRON * 3, TETRAHEDRON_FACES, translation=[offset, -offset, 0]).write(tmp_path), up=up)
    camera = scene.default_camera(*size)
    assert (camera.width, camera.height) == size
    corners = scene.triangles().vertices.reshape(-1, 3) + scene.origin
    rays = camera.rays(camera.position)
    axes = np.stack([rays.dx, rays.dy, rays.corner], axis=1)
    x, y, depth = np.linalg.solve(axes, (corners - camera.position).T)
    assert (depth > 0).all()
    shares = [np.ptp(x / depth) / size[0], np.ptp(y / depth) / size[1]]
    # One side is filled, with a margin. Far from the origin, the camera keeps a distance that float32 resolves.
    assert max(shares) > (0.85 if offset == 0.0 else 0.5)
    assert (x / depth > 0).all() and (x / depth < size[0]).all()
    assert (y / depth > 0).all() and (y / depth < size[1]).all()
    view, upward = camera.target - camera.position, np.eye(3)["xyz".index(up)]
    assert view @ upward < 0 and camera.up @ upward > 0  # from a little above


@pytest.mark.parametrize("up", ["y", "z"])
def test_the_default_light_is_above_the_scene(tmp_path, up):
    scene = load(single(TETRAHEDRON * 3, TETRAHEDRON_FACES).write(tmp_path), up=up)
    light, axis = scene.default_light(), "xyz".index(up)
    assert isinstance(light, QuadLight) and light.intensity > 0
    corners = light.corner + np.array([np.zeros(3), light.u, light.v, light.u + light.v])
    assert (corners[:, axis] > scene.bounds[1, axis]).all()
    assert np.cross(light.u, light.v)[axis] < 0
    assert np.linalg.norm(light.u) == pytest.approx(np.linalg.norm(np.ptp(scene.bounds, axis=0)) / 2)


def test_a_scene_of_one_point_still_has_a_camera_and_a_light(tmp_path):
    scene = load(single(np.full((3, 3), 2.0)).write(tmp_path))
    assert np.isfinite(scene.default_camera().position).all() and scene.default_light().area() > 0
    np.testing.assert_array_equal(scene.triangles().vertices, 0)
    np.testing.assert_array_equal(scene.origin, [2, 2, 2])


def test_up_is_recorded_and_coordinates_stay(tmp_path):
    path = single(TETRAHEDRON, TETRAHEDRON_FACES).write(tmp_path)
    assert load(path).up == "y" and load(path, up="z").up == "z"
    np.testing.assert_array_equal(load(path).triangles().vertices, load(path, up="z").triangles().vertices)
    with pytest.raises(InputError, match='must be "y" or "z"'):
        load(path, up="Z")
