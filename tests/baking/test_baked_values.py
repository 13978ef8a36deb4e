"""Values at vertices, against closed forms and on scenes whose answer is known."""

import numpy as np
import pytest

import antumbra as at
from baked_files import Glb, box, grid, primitive, scene_file
from gltf_files import Gltf

FAR = 1e4


def wall(height):
    """((v, 3), (f, 3)): a long wall at x = 0 that faces +x."""
    points = np.array([[0, 0, -FAR], [0, 0, FAR], [0, height, FAR], [0, height, -FAR]], np.float32)
    return points, np.array([[0, 2, 1], [0, 3, 2]], np.uint32)


def test_ambient_occlusion_of_a_wall_has_its_closed_form(tmp_path):
    path = scene_file(tmp_path, grid(np.linspace(0.05, 6.0, 40), np.linspace(-3.0, 3.0, 10)), wall(2.0))
    report = at.bake(path, tmp_path / "out.glb", spp=1024, attribute="_AO")
    glb = Glb(tmp_path / "out.glb")
    points, values = glb.attribute("POSITION"), glb.attribute("_AO")[:, 0]
    # the wall covers the angle whose cosine is d / sqrt(d^2 + h^2): (1 - cos) / 2 of the sky, weighted by the cosine
    d = points[:, 0].astype(float)
    expected = 0.5 * (1.0 + d / np.hypot(d, 2.0))
    assert np.ptp(expected) > 0.4
    error = values - expected
    assert np.sqrt((error**2).mean()) < 2.5e-3 and abs(error.mean()) < 5e-4 and np.abs(error).max() < 1e-2
    assert report.receivers == 400 + 4 and report.rays == 404 * 1024


def test_radius_ends_the_rays(tmp_path):
    path = scene_file(tmp_path, grid([0.5, 3.0], [-1.0, 1.0]), wall(50.0))
    at.bake(path, tmp_path / "out.glb", radius=1.0, attribute="_AO", spp=64)
    values = Glb(tmp_path / "out.glb").attribute("_AO")[:, 0]
    assert (values[:2] < 0.95).all() and (values[2:] == 1.0).all()


def test_light_of_a_point_and_of_the_sun(tmp_path):
    path = scene_file(tmp_path, grid([0.0, 1.0, 2.0], [0.0, 1.0]))
    lamp = at.PointLight((0.0, 2.0, 0.0), intensity=8.0, colour=(1.0, 0.5, 0.25))
    at.bake(path, tmp_path / "light.glb", "light", lights=lamp, attribute="_LIGHT")
    glb = Glb(tmp_path / "light.glb")
    points = glb.attribute("POSITION").astype(float)
    squared = points[:, 0] ** 2 + 4.0 + points[:, 2] ** 2
    irradiance = 8.0 * 2.0 / squared**1.5
    np.testing.assert_allclose(glb.attribute("_LIGHT"), irradiance[:, None] * [1.0, 0.5, 0.25], rtol=1e-5)
    sun = at.DirectionalLight((1.0, -1.0, 0.0))
    at.bake(path, tmp_path / "sun.glb", "sun", lights=sun)
    colours = Glb(tmp_path / "sun.glb").attribute("COLOR_0")
    np.testing.assert_allclose(colours[:, :3], 0.5**0.5, atol=1e-4)
    assert (colours[:, 3] == 1.0).all()


def test_shadow_of_a_wall(tmp_path):
    path = scene_file(tmp_path, grid([0.5, 1.0, 3.0, 4.0], [0.0, 1.0]), wall(2.0))
    sun = at.DirectionalLight((1.0, -1.0, 0.0), 0.0)
    at.bake(path, tmp_path / "out.glb", "shadow", lights=sun)
    glb = Glb(tmp_path / "out.glb")
    values = glb.attribute("COLOR_0")[:, 0]
    assert (values == np.repeat([0.0, 0.0, 1.0, 1.0], 2)).all()
    material = glb.json["materials"][glb.primitive()["material"]]
    assert "KHR_materials_unlit" in material["extensions"] and "KHR_materials_unlit" in glb.json["extensionsUsed"]


def test_bent_normals_turn_away_from_a_wall(tmp_path):
    made = Gltf()
    points, faces = grid([0.5, 1000.0], [0.0, 1.0])
    made.node(mesh=made.mesh(primitive(made, points, faces)))
    made.node(mesh=made.mesh(primitive(made, *wall(2.0))))
    made.node(mesh=made.mesh(primitive(made, *grid([0.5, 1.0], [0.0, 1.0]))), rotation=[0.0, 1.0, 0.0, 0.0])
    at.bake(made.write(tmp_path), tmp_path / "out.glb", "bent-normal")
    glb = Glb(tmp_path / "out.glb")
    bent = glb.attribute("_BENT_NORMAL")
    np.testing.assert_allclose(np.linalg.norm(bent, axis=1), 1.0, atol=1e-5)
    assert (bent[:2, 0] > 0.2).all() and (bent[2:, 1] > 0.999).all()
    turned = glb.attribute("_BENT_NORMAL", node=2)  # in its own frame, whose x points to the wall's other way
    assert (turned[:, 0] > 0.2).all()


def test_vertices_inside_solids_take_what_is_visible_nearby(tmp_path):
    floor = grid([-4.0, 0.0, 4.0], [-4.0, 0.0, 4.0])
    path = scene_file(tmp_path, floor, box((-1.0, -0.5, -1.0), (1.0, 2.0, 1.0)))
    kept = at.bake(path, tmp_path / "kept.glb", attribute="_AO", keep_hidden=True)
    moved = at.bake(path, tmp_path / "moved.glb", attribute="_AO")
    before, after = (Glb(tmp_path / f"{n}.glb").attribute("_AO")[:, 0] for n in ("kept", "moved"))
    middle = 4
    assert before[middle] == 0.0 and 0.5 < after[middle] < 1.0
    assert (np.delete(before, middle) == np.delete(after, middle)).all() and (before[:4] > 0.8).all()
    assert kept.hidden == 0 and moved.hidden >= 1


def test_smooth_normals_are_used_without_any_in_the_file(tmp_path):
    """The edge of a roof of two equal slopes has a normal that points up, and sees the whole sky."""
    points = np.array([[-1, 0, -9], [0, 1, -9], [1, 0, -9], [-1, 0, 9], [0, 1, 9], [1, 0, 9]], np.float32)
    faces = np.array([[0, 3, 4], [0, 4, 1], [1, 4, 5], [1, 5, 2]], np.uint32)
    path = scene_file(tmp_path, (points, faces))
    at.bake(path, tmp_path / "out.glb", attribute="_AO")
    values = Glb(tmp_path / "out.glb").attribute("_AO")[:, 0]
    assert (values == 1.0).all()
    at.bake(path, tmp_path / "up.glb", "bent-normal")
    assert (Glb(tmp_path / "up.glb").attribute("_BENT_NORMAL")[[1, 4], 1] > 0.999).all()


@pytest.mark.parametrize("plan", ["bsah+single", "bsah+packet16", "srdh+multifrusta", "grid32+bsah+wide"])
def test_every_plan_bakes_the_same(tmp_path, plan):
    path = scene_file(tmp_path, grid(np.linspace(-3, 3, 7), np.linspace(-3, 3, 7)), box((-1, 0.5, -1), (1, 2, 1)))
    at.bake(path, tmp_path / "auto.glb", spp=32)
    at.bake(path, tmp_path / "plan.glb", spp=32, plan=plan)
    assert (tmp_path / "auto.glb").read_bytes() == (tmp_path / "plan.glb").read_bytes()
