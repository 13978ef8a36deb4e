"""The frame of a bake: lights are those of the scene, whatever frame the written file has."""

import numpy as np
import pytest

import antumbra as at
import city_files
from baked_files import Glb, grid, primitive, scene_file
from gltf_files import Gltf, png

FLAT = np.array([[0, 0, 1], [1, 0, 1], [1, 1, 1], [0, 1, 1]], float), [[0, 1, 2], [0, 2, 3]]
NOON = at.DirectionalLight((0, 0, -1), 0.0)


def values_of(path, name="_X"):
    """(positions, values) of all nodes of a file, in the frame of the meshes."""
    glb = Glb(path)
    shown = [i for i, node in enumerate(glb.json["nodes"]) if "mesh" in node]
    return tuple(np.concatenate([glb.attribute(key, i) for i in shown]) for key in ("POSITION", name))


@pytest.mark.parametrize("what", ["sun", "light", "shadow"])
def test_a_level_square_below_a_vertical_sun_is_fully_lit(tmp_path, what):
    scene = at.Scene.from_arrays(*FLAT, up="z")
    assert at.bake(scene, tmp_path / "out.glb", what, lights=NOON, attribute="_X").mean == 1.0
    np.testing.assert_array_equal(at.load(tmp_path / "out.glb").bounds, [[0, 1, -1], [1, 1, 0]])  # +Y is up there


@pytest.mark.parametrize("suffix", ["obj", "glb"])
def test_files_whose_z_axis_points_up(tmp_path, cli, suffix):
    points, faces = FLAT
    path = scene_file(tmp_path, (points.astype(np.float32), np.array(faces, np.uint32)))
    if suffix == "obj":
        path = tmp_path / "scene.obj"
        path.write_text("v 0 0 1\nv 1 0 1\nv 1 1 1\nv 0 1 1\nf 1 2 3\nf 1 3 4\n")
    told = cli("bake", path, "--up", "z", "-o", "a.glb", "--what", "sun", "--light", "sun:0,0,-1:0", "--json").json()
    assert told["mean"] == 1.0
    assert at.bake(path, tmp_path / "b.glb", "sun", lights=NOON, up="z").mean == 1.0
    assert (tmp_path / "a.glb").read_bytes() == (tmp_path / "b.glb").read_bytes()
    assert at.bake(path, tmp_path / "c.glb", "sun", up="z").mean > 0.5  # by the sun of default pictures
    turned = at.load(tmp_path / "b.glb").bounds[1, 1] == at.load(tmp_path / "b.glb").bounds[0, 1]
    assert turned == (suffix == "obj")  # a glTF file keeps its frame, and all that is in it


def test_a_city_of_boxes(tmp_path, cli):
    """Two boxes of CityJSON, whose z axis points up: roofs are lit, and nothing else."""
    pytest.importorskip("pyproj")
    vertices = np.concatenate([city_files.CUBE * (4, 4, 3), city_files.CUBE * (2, 2, 8) + (7, 1, 0)]).tolist()
    second = [[8 + i for i in face] for face in city_files.CUBE_FACES]
    objects = {"a": city_files.building(city_files.solid())}
    objects["b"] = city_files.building({"type": "Solid", "lod": "1", "boundaries": [city_files.polygons(second)]})
    path = city_files.put(tmp_path, city_files.city(objects, vertices))
    options = "--what", "sun", "--light", "sun:0,0,-1:0", "--attribute", "_X"
    assert cli("bake", path, "-o", "a.glb", *options).code == 0
    at.bake(path, tmp_path / "b.glb", "sun", lights=NOON, attribute="_X")
    assert (tmp_path / "a.glb").read_bytes() == (tmp_path / "b.glb").read_bytes()
    written = at.load(tmp_path / "a.glb")
    np.testing.assert_allclose(written.bounds, [[0, 0, -4], [9, 8, 0]], atol=1e-6)
    # corners of roofs get the mean normal of a roof and two walls: its cosine to the sun
    points, values = values_of(tmp_path / "a.glb")
    roof = points[:, 2] + at.load(path).origin[2] > 1.0
    np.testing.assert_allclose(values[roof], 3**-0.5, atol=1e-6)
    assert roof.sum() == 8 and not values[~roof].any()


def test_bent_normals_are_in_the_frame_of_the_meshes(tmp_path):
    at.bake(at.Scene.from_arrays(*FLAT, up="z"), tmp_path / "out.glb", "bent-normal")
    _, values = values_of(tmp_path / "out.glb", "_BENT_NORMAL")
    assert (values[:, 2] > 0.999).all()
    pytest.importorskip("xatlas")
    at.bake(at.Scene.from_arrays(*FLAT, up="z"), tmp_path / "out.glb", "bent-normal", texture=16)
    image = Glb(tmp_path / "out.glb").image().astype(float)
    assert (image[..., 2] > 252).all() and np.abs(image[..., :2] - 127.5).max() < 4


def test_a_scene_without_lights_of_the_call_has_its_own(tmp_path):
    scene = at.procedural("atrium", triangles=2000)
    own = at.bake(scene, tmp_path / "own.glb", "light", attribute="_X", spp=16)
    given = at.bake(scene, tmp_path / "given.glb", "light", attribute="_X", spp=16, lights=scene.lights)
    assert own.mean == given.mean > 0.0


def leaf_file(folder):
    """A floor, and over it a leaf whose right half alpha cuts away."""
    made = Gltf()
    texels = np.full((8, 8, 4), 255)
    texels[:, 4:, 3] = 0
    made.add("textures", source=made.add("images", bufferView=made.view(png(texels)), mimeType="image/png"))
    look = {"pbrMetallicRoughness": {"baseColorTexture": {"index": 0}}, "alphaMode": "MASK", "doubleSided": True}
    leaf = np.array([[-3, 1, -3], [3, 1, -3], [3, 1, 3], [-3, 1, 3]], np.float32)
    uv = np.array([[0, 0], [1, 0], [1, 1], [0, 1]], np.float32)
    cut = primitive(made, leaf, np.array([[0, 1, 2], [0, 2, 3]], np.uint32), TEXCOORD_0=uv)
    made.node(mesh=made.mesh({**cut, "material": made.add("materials", **look)}))
    made.node(mesh=made.mesh(primitive(made, *grid(np.arange(-2.0, 2.5, 0.5), np.arange(-2.0, 2.5, 0.5)))))
    return made.write(folder, "leaf.glb")


@pytest.mark.parametrize("kept", [True, False])
def test_cut_outs_let_light_through_in_files_and_in_scenes(tmp_path, kept):
    """The scene of a file is written without its texture. Its rays pass the leaf all the same."""
    path = leaf_file(tmp_path)
    scene, sun = at.load(path), at.DirectionalLight((0, -1, 0), 0.0)
    at.bake(path if kept else scene, tmp_path / "out.glb", "shadow", lights=sun, attribute="_X")
    (points, values), height = values_of(tmp_path / "out.glb"), 0.0 if kept else scene.origin[1]
    below, x = points[:, 1] + height < 0.5, points[:, 0]
    assert (values[below & (x < -0.2)] == 0.0).all() and (values[below & (x > 0.2)] == 1.0).all()
    assert below.sum() == 81


def test_the_command_closes_holes(tmp_path, cli):
    path = leaf_file(tmp_path)
    options = "-o", "out.glb", "--what", "shadow", "--light", "sun:0,-1,0:0", "--json"
    means = [cli("bake", f"{path}{how}", *options).json()["mean"] for how in ("", "?cutouts=off")]
    assert means[0] > means[1] + 0.2
