import numpy as np
import pytest

import antumbra as at
from antumbra.cli import scene_commands
from city_files import building, city, put, solid, surfaces
from gltf_files import single


def test_a_procedural_scene(cli):
    told = cli("info", "procedural:atrium?triangles=2k", "--json").json()
    scene = at.procedural("atrium", triangles=2000)
    assert told["triangles"] == scene.n_triangles == sum(m["triangles"] * m["instances"] for m in told["meshes"])
    assert np.allclose(told["bounds"], scene.bounds) and np.allclose(told["origin"], scene.origin)
    assert told["up"] == "y" and told["duration"] == 0.0 and told["notes"] == []
    assert len(told["cameras"]) == len(told["lights"]) == 1
    assert told["cameras"][0]["vfov"] == scene.cameras[0].vfov
    assert told["lights"][0]["type"] == "QuadLight" and len(told["lights"][0]["u"]) == 3
    triangles = scene.triangles()
    assert told["triangle_bytes"] == triangles.vertices.nbytes + triangles.face_id.nbytes + triangles.colour.nbytes


def test_for_people(cli, square_obj):
    done = cli("info", square_obj)
    assert done.code == 0
    for words in (
        "square",
        "2 in 1 mesh",
        "(-1, 0, -1) to (1, 0, 1)",
        "+Y is up",
        "animation  none",
        "cameras",
        "lights",
    ):
        assert words in done.out, done.out
    assert "+Z is up" in cli("info", square_obj, "--up", "z").out
    told = cli("info", "procedural:atrium?triangles=2k").out
    assert "camera 0" in told and "light 0" in told and "QuadLight" in told


def test_a_city(cli, tmp_path):
    slopes = {"surfaces": [{"type": "RoofSurface", "slope": 1.5}], "values": [0] * 6}
    house = building(solid("1"), surfaces("2.2", semantics=slopes), attributes={"height": 3, "roof": "flat"})
    objects = {"a": house, "pond": building(surfaces("1"), kind="WaterBody")}
    put(tmp_path, city(objects), "delft.city.json")
    told = cli("info", "delft.city.json", "--json").json()
    assert told["up"] == "z" and told["name"] == "delft"
    assert told["city"] == {
        "crs": "EPSG:7415", "lods": ["1", "2.2"], "objects": {"Building": 1, "WaterBody": 1},
        "surfaces": {"none": 6, "RoofSurface": 1}, "attributes": {"objects": ["height", "roof"], "surfaces": ["slope"]},
    }  # fmt: skip
    assert told["crs"] == "EPSG:7415"
    shown = cli("info", "delft.city.json").out
    assert "2 objects, levels of detail 1, 2.2" in shown and "EPSG:7415" in shown
    assert "height, roof" in shown and "surface data" in shown and "slope" in shown
    assert cli("info", "delft.city.json?lod=2.2", "--json").json()["triangles"] == 12
    cli("info", "delft.city.json?lod=3").refused("no geometry has lod '3'; there are 1, 2.2")
    assert cli("info", "procedural:atrium?triangles=2k", "--json").json()["city"] is None


def test_notes_are_shown_whole(cli, square_obj):
    square_obj.write_text("mtllib none.mtl\n" + square_obj.read_text())
    done = cli("info", square_obj)
    assert done.err == "" and "none.mtl" in done.out
    (note,) = cli("info", square_obj, "--json").json()["notes"]
    assert "none.mtl" in note


def test_many_meshes_are_counted(cli, tmp_path):
    lines = [
        f"usemtl part{i}\nv 0 0 {i}\nv 1 0 {i}\nv 0 1 {i}\nf {3 * i + 1} {3 * i + 2} {3 * i + 3}" for i in range(22)
    ]
    (tmp_path / "parts.obj").write_text("\n".join(lines))
    assert len(cli("info", "parts.obj", "--json").json()["meshes"]) == 22
    assert "2 smaller meshes" in cli("info", "parts.obj").out


def test_a_moving_scene(cli, tmp_path):
    folder = tmp_path / "moving"
    folder.mkdir()
    np.save(folder / "frames.npy", np.zeros((2, 3, 3), np.float32) + np.eye(3, dtype=np.float32))
    np.save(folder / "faces.npy", np.array([[0, 1, 2]], np.int32))
    (folder / "info.json").write_text('{"times": [0.0, 2.5]}')
    assert "2.5 seconds" in cli("info", "moving").out
    assert cli("info", "moving", "--json").json()["duration"] == 2.5


@pytest.mark.parametrize(
    "scene, word", [("none.glb", "none.glb"), (".", "frames.npy"), ("procedural:x", "x"), ("a.txt", "a.txt")]
)
def test_bad_input(cli, scene, word, tmp_path):
    (tmp_path / "a.txt").write_text("x")
    cli("info", scene).refused(word)
    cli("info", scene, "--json").refused(word)


def test_lights_with_names(cli, tmp_path):
    """The name of a light, or of its node, stands among numbers."""
    made = single()
    made.json["extensionsUsed"] = ["KHR_lights_punctual"]
    lights = [{"type": "point", "name": "lamp"}, {"type": "directional"}, {"type": "point"}]
    made.json["extensions"] = {"KHR_lights_punctual": {"lights": lights}}
    for k, name in enumerate("abc"):
        made.node(name=name, extensions={"KHR_lights_punctual": {"light": k}}, translation=[0, 5, 0])
    made.write(tmp_path, "named.gltf")
    done = cli("info", "named.gltf")
    assert done.code == 0 and "name 'lamp'" in done.out and "DirectionalLight" in done.out, done
    assert "(0, 5, 0)" in done.out
    told = cli("info", "named.gltf", "--json").json()
    assert told["lights"][0]["name"] == "lamp"


@pytest.mark.parametrize("light", [
    at.PointLight((0, 3, 0)), at.SphereLight((0, 3, 0), 1.0), at.QuadLight((0, 3, 0), (1, 0, 0), (0, 0, 1)),
    at.DiskLight((0, 3, 0), (0, 1, 0), 1.0), at.DirectionalLight((0, -1, 0)), at.Sky(count=16), at.AmbientOcclusion(),
    at.PointLights([[0, 3, 0]]), at.DirectionalLights([[0, -1, 0]]),
], ids=lambda light: type(light).__name__)  # fmt: skip
def test_every_light_has_words(light):
    for each in (light, light.named("lamp")):
        told = scene_commands.light_text(each)
        assert told.startswith(type(light).__name__) and ("lamp" in told) == (each is not light)
