"""Views of the SRDH benchmark."""

import json

import numpy as np
import pytest
import trimesh

from antumbra.errors import InputError
from antumbra.papers import benchmark_views as views
from antumbra.papers.srdh.srdh_measurements import SCENES

INFO = {"up": [0, 1, 0], "camera": {"position": [0, 1, 5], "target": [0, 1, 0], "vfov": 50}, "light": [1.0, 2.0, 3.0]}


@pytest.fixture
def scenes(tmp_path, monkeypatch):
    """A folder of scenes with a single scene, zdm2. Its info.json can be changed."""
    monkeypatch.setenv("ANTUMBRA_SCENES", str(tmp_path))
    folder = tmp_path / "zdm2"
    folder.mkdir()
    trimesh.creation.box(extents=(3, 4, 12)).export(folder / "scene.glb")  # a diagonal of 13

    def tell(**more):
        (folder / "info.json").write_text(json.dumps({**INFO, **more}))
        return folder

    tell()
    return tell


def test_real_scenes_where_they_are(scenes, monkeypatch):
    assert SCENES.default_names() == ["zdm2", *SCENES.beside_real]
    monkeypatch.delenv("ANTUMBRA_SCENES")
    assert SCENES.default_names() == list(SCENES.without_real)


def test_camera_and_light_are_those_of_info(scenes):
    view = SCENES.view("zdm2", (40, 30))
    assert (view.camera.width, view.camera.height, view.camera.vfov) == (40, 30, 50)
    assert view.camera.position.tolist() == [0, 1, 5]
    (light,) = view.lights
    assert np.allclose(light.corner + (light.u + light.v) / 2, [1, 2, 3])
    assert np.isclose(np.linalg.norm(light.u), 1.3) and np.isclose(np.linalg.norm(light.v), 1.3)
    assert np.allclose(np.cross(light.u, light.v) / 1.69, [0, 1, 0])


def test_a_direction_is_a_square_far_away_that_faces_the_scene(scenes):
    scenes(light=[0.0, 3.0, 4.0, 0.0])
    (light,) = SCENES.view("zdm2", (40, 30)).lights
    middle = light.corner + (light.u + light.v) / 2
    assert np.allclose(middle, 13 * np.array([0, 0.6, 0.8]))
    assert np.allclose(np.abs(np.cross(light.u, light.v)) / 1.69, [0, 0.6, 0.8])


def test_z_up(scenes):
    scenes(up=[0, 0, 1], camera={"position": [5, 0, 1], "target": [0, 0, 1], "vfov": 50})
    view = SCENES.view("zdm2", (40, 30))
    assert view.scene.up == "z" and view.camera.up.tolist() == [0, 0, 1]


def test_files_without_notes_have_default_lights(scenes, tmp_path):
    folder = scenes()
    (folder / "info.json").unlink()
    view = SCENES.view(str(folder / "scene.glb"), (40, 30))
    assert view.camera.height == 30 and len(view.lights) == 1


def test_procedural_scenes_have_their_own(monkeypatch):
    whole = views.procedural
    monkeypatch.setattr(views, "procedural", lambda name: whole(name, triangles=2000))
    view = SCENES.view("cellar", (40, 30))
    assert view.scene.name == "cellar" and (view.camera.width, view.camera.height) == (40, 30)


def test_what_is_not_there_is_named(scenes):
    with pytest.raises(InputError, match=r"sponza_crytek: .*zdm2.*cellar"):
        SCENES.view("sponza_crytek", (40, 30))
