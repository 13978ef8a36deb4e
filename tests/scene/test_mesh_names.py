"""Objects keep their names from a file of any kind to every answer that names one."""

import json

import numpy as np
import OpenEXR
import pytest
import trimesh

import antumbra as at
from antumbra.city.sight.sightlines import PairList, sight_table
from city_files import CUBE, CUBE_FACES, building, city, polygons, put, solid
from gltf_files import Gltf

PLACES = {"left": (0, 0, 0), "middle": (4, 0, 0), "right": (8, 0, 0)}
TRIANGLES = np.array([corners for a, b, c, d in CUBE_FACES for corners in ([a, b, c], [a, c, d])])


def city_scene(folder):
    vertices = np.concatenate([CUBE + place for place in PLACES.values()])
    things = {}
    for k, name in enumerate(PLACES):
        faces = (np.array(CUBE_FACES) + 8 * k).tolist()
        things[name] = building({**solid(), "boundaries": [polygons(faces)]})
    return at.load(put(folder, city(things, vertices)))


def gltf_scene(folder):
    made = Gltf()
    mesh = made.mesh(made.primitive(CUBE.astype(np.float32), TRIANGLES.astype(np.uint16)))
    for name, place in PLACES.items():
        made.node(mesh=mesh, name=name, translation=list(place))
    return at.load(made.write(folder), up="z")


def obj_scene(folder):
    lines = [f"v {x} {y} {z}" for place in PLACES.values() for x, y, z in (CUBE + place).tolist()]
    for k, name in enumerate(PLACES):
        lines += [f"usemtl {name}", *(f"f {a} {b} {c}" for a, b, c in (TRIANGLES + 8 * k + 1).tolist())]
    (folder / "a.mtl").write_text("".join(f"newmtl {name}\nKd 1 1 1\n" for name in PLACES))
    (folder / "a.obj").write_text("mtllib a.mtl\n" + "\n".join(lines))
    return at.load(folder / "a.obj", up="z")


def trimesh_scene(folder):
    made = trimesh.Scene()
    for name, place in PLACES.items():
        made.add_geometry(trimesh.Trimesh(CUBE + place, TRIANGLES, process=False), node_name=name, geom_name=name)
    return at.load(made, up="z")


def by_hits(scene, folder):
    hit = scene.closest_hit([[x + 0.3, 0.4, 9] for x, _, _ in PLACES.values()], [0, 0, -1])
    return [scene.objects[k].name for k in hit.object.tolist()]


def by_lines(scene, folder):
    observers = np.array([[x + 0.3, 0.4, 9] for x, _, _ in PLACES.values()])
    targets = observers - [0, 0, 20]
    found = at.line_of_sight(scene, observers, targets)
    table = sight_table(scene, PairList(observers, targets, None, None, None, None), found)
    table.save(folder / "a.json")
    assert not found.visible.any()
    return json.loads((folder / "a.json").read_text())["rows"]["name"]


def from_above(scene):
    """A camera 90 pixels wide: pixel column 10 x + 3 shows x + 0.3, over the cubes from x = 0 to 9."""
    place = [4.5, 0.5, 20], [4.5, 0.5, 0], [0, 1, 0]
    return at.Camera(*place, width=90, height=10, projection="orthographic", extent=1.0)


def shown(ids, scene):
    found = [ids[5, 10 * x + 3] for x, _, _ in PLACES.values()]
    assert set(ids.ravel().tolist()) - set(found)  # the background
    return [scene.objects[k].name for k in found]


def by_pictures(scene, folder):
    frame = at.render(scene, from_above(scene), [at.DirectionalLight((0, 0, -1))], spp=1, layers=True)
    frame.save(folder / "a.exr")
    return shown(exr(folder / "a.exr", "object.id"), scene)


def by_data_sets(scene, folder):
    at.dataset(scene, folder / "set", [from_above(scene)], [at.DirectionalLight((0, 0, -1))], spp=1)
    told = json.loads((folder / "set" / "manifest.json").read_text())["objects"]
    assert [each["name"] for each in told] == [each.name for each in scene.objects]
    return shown(exr(folder / "set" / "frames" / "0000.exr", "ViewLayer.IndexOB.X"), scene)


def exr(path, name):
    with OpenEXR.File(str(path), separate_channels=True) as file:
        return file.channels()[name].pixels.view(np.int32)


@pytest.mark.parametrize("kind", [city_scene, gltf_scene, obj_scene, trimesh_scene])
def test_every_answer_names_the_object(tmp_path, kind):
    scene = kind(tmp_path)
    assert sorted(each.name for each in scene.objects) == sorted(PLACES)
    assert [scene.meshes[each.mesh].triangles for each in scene.objects] == [12] * 3
    for answer in by_hits, by_lines, by_pictures, by_data_sets:
        assert answer(scene, tmp_path) == [*PLACES], answer.__name__
