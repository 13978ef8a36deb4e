"""The stand-in for pictures."""

import json
import struct

import numpy as np
import pytest

import antumbra as at
from antumbra.scene.materials import linear_to_srgb
from antumbra.viewer.progressive_pictures import Step, trace_picture
from antumbra.viewer.proxy_mesh import before_aces, glb_of, proxy_colours, proxy_light, proxy_mesh
from antumbra.viewer.viewer_model import Model
from pages import CAMERA, SUN, box_on_floor


def area(corners):
    return np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1).sum() / 2


def test_large_faces_are_divided():
    scene = box_on_floor()
    triangles = scene.triangles()
    pieces = proxy_mesh(triangles, 3000)
    assert 700 < len(pieces.points) <= 3000
    assert area(pieces.corners) == pytest.approx(area(triangles.vertices), rel=1e-5)
    own = triangles.vertices[pieces.faces]
    normals = np.cross(own[:, 1] - own[:, 0], own[:, 2] - own[:, 0])
    away = ((pieces.points - scene.origin) - own[:, 0]) * normals
    np.testing.assert_allclose(away.sum(1), 0.0, atol=1e-5)  # each point lies on its face


def test_many_faces_become_few():
    scene = at.procedural("city", triangles=30_000)
    pieces = proxy_mesh(scene.triangles(), 4000)
    assert 1500 < len(pieces.points) <= 4000
    low, high = pieces.corners.reshape(-1, 3).min(0) + scene.origin, pieces.corners.reshape(-1, 3).max(0) + scene.origin
    extent = np.ptp(scene.bounds, axis=0).max()
    assert np.abs(low - scene.bounds[0]).max() < 0.1 * extent and np.abs(high - scene.bounds[1]).max() < 0.1 * extent


def test_faces_without_area_are_left_out():
    flat = at.Scene.from_arrays(np.array([[[0, 0, 0], [1, 1, 1], [2, 2, 2]], [[0, 0, 0], [1, 0, 0], [0, 1, 0.0]]]))
    assert set(proxy_mesh(flat.triangles(), 50).faces.tolist()) == {1}
    empty = at.Scene.from_arrays(np.array([[[0, 0, 0], [1, 1, 1], [2, 2, 2.0]]]))
    assert not len(proxy_mesh(empty.triangles(), 50).faces)


@pytest.mark.parametrize("lights", [[SUN], [SUN, at.Sky()]], ids=["sun", "sun and sky"])
def test_the_stand_in_looks_as_the_picture_does(lights):
    model = Model(box_on_floor(), lights, CAMERA)
    camera = CAMERA.resized(120, 120)
    picture = trace_picture(model, camera, Step(1, 16)).image
    pieces = proxy_mesh(model.scene.triangles(), 6000)
    colours = proxy_colours(proxy_light(model, pieces), pieces.normals, model.scene.colours[pieces.faces], model)
    shown = np.round(255 * linear_to_srgb(colours[0])).astype(int)
    from antumbra.city.tables.false_colours import project_points

    at_pixel = np.floor(project_points(camera, pieces.points)).astype(int)
    up = pieces.normals[:, 1] > 0.5
    x, y = at_pixel[up & (np.abs(pieces.points[:, [0, 2]]) < 5.5).all(1)].T
    here = shown[up & (np.abs(pieces.points[:, [0, 2]]) < 5.5).all(1)]
    differ = np.abs(picture[y, x].astype(int) - here).max(1)
    assert len(differ) > 500 and np.median(differ) <= 12 and (differ < 40).mean() > 0.8
    assert (here.sum(1) < 250).any() and (here.sum(1) > 450).any()  # shadow and light


def test_light_is_that_of_each_side():
    model = Model(box_on_floor(), SUN, CAMERA)
    pieces = proxy_mesh(model.scene.triangles(), 200)
    front, back = proxy_light(model, pieces)
    floor = (pieces.points[:, 1] == 0.0) & (pieces.points[:, 2] > 2.0)
    assert floor.any() and front[floor].min() > 1.0 and back[floor].max() == 0.0
    with pytest.raises(ZeroDivisionError):
        proxy_light(model, pieces, lambda *_: 1 // 0)


def aces(x):
    """The curve as three.js has it."""
    into = np.array([[0.59719, 0.35458, 0.04823], [0.076, 0.90834, 0.01566], [0.0284, 0.13383, 0.83777]])
    out = np.array([[1.60475, -0.53108, -0.07367], [-0.10208, 1.10813, -0.00605], [-0.00327, -0.07276, 1.07602]])
    v = x / 0.6 @ into.T
    v = (v * (v + 0.0245786) - 0.000090537) / (v * (0.983729 * v + 0.432951) + 0.238081)
    return np.clip(v @ out.T, 0.0, 1.0)


def test_colours_come_out_of_the_browsers_tone_curve():
    grey = np.linspace(0.0, 0.95, 20)[:, None] * np.ones(3)
    coloured = np.array([[0.4, 0.1, 0.1], [0.2, 0.3, 0.5], [0.05, 0.4, 0.1]])
    for wanted in grey, coloured:
        np.testing.assert_allclose(aces(before_aces(wanted)), wanted, atol=2e-3)


def test_the_file_has_both_sides():
    corners = np.array([[[0, 0, 0], [1, 0, 0], [0, 1, 0]]], np.float32)
    data = glb_of(corners, np.array([[[0.5, 0.1, 0.1]], [[0.1, 0.1, 0.5]]], np.float32))
    length = struct.unpack_from("<I", data, 12)[0]
    root = json.loads(data[20 : 20 + length])
    assert root["accessors"][0]["count"] == 6 and "KHR_materials_unlit" in root["extensionsUsed"]
    values = np.frombuffer(data[28 + length :], np.float32)[:36].reshape(2, 2, 3, 3)
    assert (values[0, 1] == corners[0, ::-1]).all()
    assert values[1, 0, 0].argmax() == 0 and values[1, 1, 0].argmax() == 2
