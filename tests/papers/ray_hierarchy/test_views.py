"""Views of the ray hierarchy benchmark."""

import json

import numpy as np
import pytest
import trimesh

from antumbra.engine.scene import procedural
from antumbra.errors import InputError
from antumbra.papers.benchmark_views import scene_view
from antumbra.papers.ray_hierarchy.ray_hierarchy_measurements import (
    MUSEUM,
    ROBOTS,
    SCENES,
    pictures,
    times_of,
    with_point,
)
from antumbra.scene.lights import PointLight

INFO = {
    "up": [0, 1, 0], "camera": {"position": [0, 1, 5], "target": [0, 1, 0], "vfov": 50},
    "light": [1.0, 2.0, 3.0], "frames": "3 frames, t=0.0..2.0",
}  # fmt: skip


@pytest.fixture
def scenes(tmp_path, monkeypatch):
    """Writes a moving scene to a folder of $ANTUMBRA_SCENES: scenes("bart_robots", fields of info.json) -> folder."""
    monkeypatch.setenv("ANTUMBRA_SCENES", str(tmp_path))
    box = trimesh.creation.box(extents=(3, 4, 12))  # a diagonal of 13

    def write(name: str, **more):
        folder = tmp_path / name
        folder.mkdir()
        np.save(folder / "frames.npy", np.stack([box.vertices + [k, 0, 0] for k in range(3)]).astype(np.float32))
        np.save(folder / "faces.npy", box.faces.astype(np.uint32))
        box.export(folder / "scene.glb")
        (folder / "info.json").write_text(json.dumps({**INFO, **more}))
        return folder

    return write


def test_scenes_that_are_there(scenes, monkeypatch):
    assert SCENES.default_names() == list(SCENES.without_real)
    scenes("synthetic_garden_foxes")
    scenes(ROBOTS)
    assert SCENES.default_names() == [ROBOTS, "synthetic_garden_foxes"]
    monkeypatch.delenv("ANTUMBRA_SCENES")
    assert SCENES.default_names() == list(SCENES.without_real)


def test_robots_move(scenes):
    scenes(ROBOTS)
    shown = pictures(SCENES.view(ROBOTS, (40, 30)), 5)
    assert [p.time for p in shown] == [0.0, 0.5, 1.0, 1.5, 2.0] and [p.frame for p in shown] == list(range(5))
    assert len({p.name for p in shown}) == 5 and {p.of for p in shown} == {ROBOTS}
    assert all(p.camera.position.tolist() == [0, 1, 5] and p.light.position.tolist() == [1, 2, 3] for p in shown)
    assert not np.array_equal(shown[0].scene.triangles(0.0).vertices, shown[0].scene.triangles(2.0).vertices)


def test_the_museum_is_seen_from_four_places(scenes):
    scenes(MUSEUM)
    shown = pictures(SCENES.view(MUSEUM, (40, 30)), 5)
    assert len({p.name for p in shown}) == 4 and {p.frame for p in shown} == {None}
    assert len({tuple(p.camera.position) for p in shown}) == 4
    assert shown[0].camera.position.tolist() == [0, 1, 5]
    assert {(p.camera.width, p.camera.height) for p in shown} == {(40, 30)}
    assert len(times_of(shown[0].scene, 5)) == 5


def test_other_scenes_stand_still(scenes):
    scenes("synthetic_garden_foxes", light=[0.0, 3.0, 4.0, 0.0])
    (only,) = pictures(SCENES.view("synthetic_garden_foxes", (40, 30)), 5)
    assert (only.frame, only.time, times_of(only.scene, 5)) == (None, 0.0, [0.0])
    assert np.allclose(only.light.position, 13 * np.array([0, 0.6, 0.8]))


def test_folders_of_vertex_frames_by_path(scenes):
    folder = scenes("walk")
    view = SCENES.view(str(folder), (40, 30))
    assert view.name == "walk" and len(pictures(view, 2)) == 2
    with pytest.raises(InputError, match=r"none: .*atrium"):
        SCENES.view("none", (40, 30))


def test_points_in_the_middle_of_lights():
    view = scene_view("cellar", procedural("cellar", triangles=2000), (40, 30))
    (light,) = view.lights
    (point,) = with_point(view).lights
    assert isinstance(point, PointLight)
    np.testing.assert_allclose(point.position, light.corner + (light.u + light.v) / 2, atol=1e-9)
    (again,) = with_point(view._replace(lights=[point])).lights
    np.testing.assert_allclose(again.position, point.position, atol=1e-9)
