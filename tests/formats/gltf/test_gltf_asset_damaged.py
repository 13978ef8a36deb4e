"""Unusable glTF files: each gives one line that names the file, the field and the cure."""

import base64
import json
import struct

import numpy as np
import pytest

from antumbra.base.errors import InputError
from antumbra.engine.scene_loading import load
from gltf_files import TETRAHEDRON, TETRAHEDRON_FACES, TRIANGLE, Gltf, everything, single


def message_of(path) -> str:
    with pytest.raises(InputError) as caught:
        load(path)
    message = str(caught.value)
    assert message.startswith(path.name) and "\n" not in message and len(message) < 400
    assert "is the file damaged" not in message, "the last fence caught it: it deserves its own check"
    return message


def spoiled(change, made=None) -> Gltf:
    """A valid file (one tetrahedron) after `change(json)`."""
    made = made or single(TETRAHEDRON, TETRAHEDRON_FACES)
    change(made.json)
    return made


def put(key, value, *path):
    """A change that sets json[path...][key] = value."""

    def change(document):
        for step in path:
            document = document[step]
        document[key] = value

    return change


PRIMITIVE = ("meshes", 0, "primitives", 0)
JSON = {
    "index out of range": (put("indices", 7, *PRIMITIVE), "meshes[0].primitives[0].indices is 7"),
    "mesh out of range": (
        put("mesh", 1, "nodes", 0),
        "nodes[0].mesh is 1; it must be a whole number from 0 to 0",
    ),
    "mesh of text": (put("mesh", "0", "nodes", 0), "nodes[0].mesh is '0'"),
    "mesh true": (put("mesh", True, "nodes", 0), "nodes[0].mesh is True"),
    "negative": (put("mesh", -1, "nodes", 0), "nodes[0].mesh is -1"),
    "child out of range": (put("children", [5], "nodes", 0), "nodes[0].children is 5"),
    "children of text": (put("children", "none", "nodes", 0), "nodes[0].children is 'none'"),
    "own child": (put("children", [0], "nodes", 0), "nodes[0] is its own ancestor"),
    "camera missing": (put("camera", 0, "nodes", 0), "nodes[0].camera is 0"),
    "skin missing": (put("skin", 2, "nodes", 0), "nodes[0].skin is 2"),
    "short translation": (
        put("translation", [1, 2], "nodes", 0),
        "nodes[0].translation is a list of 2; it must be",
    ),
    "translation of text": (put("translation", [1, 2, "3"], "nodes", 0), "nodes[0].translation holds '3'"),
    "huge translation": (
        put("translation", [1, 2, 10**400], "nodes", 0),
        "nodes[0].translation holds a huge number",
    ),
    "zero rotation": (put("rotation", [0, 0, 0, 0], "nodes", 0), "nodes[0].rotation"),
    "flat scale": (put("scale", [1, 0, 1], "nodes", 0), "nodes[0] has a transform without inverse"),
    "flat matrix": (
        put("matrix", [1, 0, 0, 0] * 3 + [0, 0, 0, 1], "nodes", 0),
        "nodes[0] has a transform without",
    ),
    "perspective matrix": (
        put("matrix", [1] * 16, "nodes", 0),
        "nodes[0].matrix is a list of 16; it must be affine",
    ),
    "scene out of range": (put("scene", 3), "scene is 3"),
    "scene node out of range": (put("nodes", [9], "scenes", 0), "scenes[0].nodes is 9"),
    "nothing in the scene": (put("nodes", [], "scenes", 0), "no triangles"),
    "no meshes": (lambda j: (j.pop("meshes"), j["nodes"][0].pop("mesh")), "no triangles"),
    "only lines": (put("mode", 1, *PRIMITIVE), "no triangles"),
    "unknown mode": (put("mode", 9, *PRIMITIVE), "mode is 9"),
    "meshes no list": (put("meshes", {}), "meshes is an object; it must be a list"),
    "mesh no object": (put("meshes", [3]), "meshes[0] is 3; it must be a JSON object"),
    "attributes no object": (
        put("attributes", [], *PRIMITIVE),
        "attributes is a list of 0; it must be a JSON object",
    ),
    "position out of range": (put("POSITION", 99, *PRIMITIVE, "attributes"), "attributes.POSITION is 99"),
    "scalar positions": (put("POSITION", 1, *PRIMITIVE, "attributes"), "accessors[1].type is 'SCALAR'"),
    "corners no multiple of 3": (put("count", 11, "accessors", 1), "11 corners, not a multiple of 3"),
    "no count": (lambda j: j["accessors"][0].pop("count"), "accessors[0].count is missing"),
    "count beyond the view": (
        put("count", 10**12, "accessors", 0),
        "accessors[0] needs 12000000000000 bytes",
    ),
    "count without a view": (
        lambda j: (j["accessors"][0].pop("bufferView"), j["accessors"][0].update(count=10**12)),
        "accessors[0].count is 1000000000000; it must be at most",
    ),
    "view beyond the buffer": (
        put("byteLength", 10**9, "bufferViews", 0),
        "bufferViews[0] ends at byte 1000000000",
    ),
    "view starts beyond": (put("byteOffset", 10**9, "bufferViews", 0), "bufferViews[0] ends at byte"),
    "offset beyond the view": (put("byteOffset", 999, "accessors", 0), "accessors[0] needs"),
    "offset not whole": (put("byteOffset", 0.5, "accessors", 0), "accessors[0].byteOffset is 0.5"),
    "narrow stride": (
        put("byteStride", 4, "bufferViews", 0),
        "bufferViews[0].byteStride is 4; it must be at least 12",
    ),
    "no such buffer": (put("buffer", 4, "bufferViews", 0), "bufferViews[0].buffer is 4"),
    "component type": (put("componentType", 5130, "accessors", 0), "accessors[0].componentType is 5130"),
    "float indices": (put("componentType", 5126, "accessors", 1), "accessors[1]"),
    "signed indices": (put("componentType", 5122, "accessors", 1), "accessors[1].componentType is 5122"),
    "draco without a view": (
        lambda j: (
            j["accessors"][0].pop("bufferView"),
            put("extensions", {"KHR_draco_mesh_compression": {"bufferView": 9, "attributes": {}}}, *PRIMITIVE)(j),
        ),
        "KHR_draco_mesh_compression.bufferView is 9",
    ),
    "draco that is none": (
        lambda j: (
            j["accessors"][0].pop("bufferView"),
            put("extensions", {"KHR_draco_mesh_compression": {"bufferView": 0, "attributes": {}}}, *PRIMITIVE)(j),
        ),
        "Draco data cannot be decoded",
    ),
    "unknown extension": (put("extensionsRequired", ["A_b"]), "extensionsRequired has 'A_b'"),
    "old version": (put("asset", {"version": "1.0"}), "asset.version is '1.0'"),
    "no version": (put("asset", {}), "asset.version is missing"),
    "material out of range": (
        put("material", 0, *PRIMITIVE),
        "material is 0; it must be a whole number absent",
    ),
    "bad factor": (
        lambda j: (
            j.update(materials=[{"pbrMetallicRoughness": {"baseColorFactor": [1, 1]}}]),
            j["meshes"][0]["primitives"][0].update(material=0),
        ),
        "materials[0].pbrMetallicRoughness.baseColorFactor is a list of 2",
    ),
}


@pytest.mark.parametrize("case", JSON)
def test_bad_fields(tmp_path, case):
    change, words = JSON[case]
    assert words in message_of(spoiled(change).write(tmp_path, "case.glb"))


def test_names_are_told(tmp_path):
    made = single(TETRAHEDRON, np.array([[0, 1, 9]], np.uint16), name="Door")
    made.json["meshes"][0]["name"] = "Handle"
    message = message_of(made.write(tmp_path))
    assert 'meshes[0] "Handle".primitives[0]: face 0 uses the vertices 0, 1, 9, and the mesh has 4 vertices' in message
    made.json["nodes"][0]["scale"] = [0, 0, 0]
    made.json["meshes"][0]["primitives"][0].pop("indices")
    made.json["accessors"][0]["count"] = 3
    assert 'nodes[0] "Door" has a transform without inverse' in message_of(made.write(tmp_path))


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_vertices_that_are_not_finite(tmp_path, value):
    points = TETRAHEDRON.copy()
    points[2, 1] = value
    message = message_of(single(points, TETRAHEDRON_FACES).write(tmp_path))
    assert f"meshes[0].primitives[0]: vertex 2 is (0.0, {value}, 0.0)" in message


def test_a_parent_that_is_flat_is_named(tmp_path):
    made = Gltf()
    child = made.node(root=False, mesh=made.mesh())
    made.node(children=[child], scale=[1, 1, 0])
    made.node(scale=[0, 0, 0], name="nothing hangs on this one")
    assert "nodes[1] has a transform without inverse" in message_of(made.write(tmp_path))


def test_circles_and_two_parents(tmp_path):
    made = single()
    made.json["nodes"] += [{"children": [2]}, {"children": [3]}, {"children": [1]}]
    assert "is its own ancestor" in message_of(made.write(tmp_path))
    made.json["nodes"][3]["children"] = [0]
    made.json["nodes"][1]["children"] = [2, 0]
    assert "nodes[0] has two parents, nodes 1 and 3" in message_of(made.write(tmp_path))


def test_a_long_chain_of_nodes_is_no_hang(tmp_path):
    made = Gltf()
    made.json["nodes"] = [{"children": [i + 1]} for i in range(3000)] + [{"mesh": made.mesh()}]
    made.json["scenes"][0]["nodes"] = [0]
    assert load(made.write(tmp_path)).n_triangles == 1


SPARSE = ("accessors", -1, "sparse")


@pytest.mark.parametrize(
    "change, words",
    [
        (put("count", 4, *SPARSE), "sparse.count is 4"),
        (put("indices", None, *SPARSE), "needs indices and values"),
        (put("componentType", 5126, *SPARSE, "indices"), "bufferView has"),
        (put("bufferView", 77, *SPARSE, "indices"), "sparse.indices.bufferView is 77"),
    ],
)
def test_bad_sparse_accessors(tmp_path, change, words):
    made = Gltf()
    rows = made.view(np.array([0, 9], np.uint8).tobytes())
    sparse = {"count": 2, "indices": {"bufferView": rows, "componentType": 5121}}
    sparse["values"] = {"bufferView": made.view(np.zeros((2, 3), np.float32).tobytes())}
    accessor = made.add("accessors", componentType=5126, count=3, type="VEC3", sparse=sparse)
    made.node(mesh=made.mesh(made.primitive(accessor)))
    assert "sparse.indices reaches beyond the 3 elements" in message_of(made.write(tmp_path))
    change(made.json)
    assert words in message_of(made.write(tmp_path))


def animated() -> Gltf:
    made = single()
    made.animate(0, "translation", [0, 1], np.zeros((2, 3)))
    return made


CHANNEL = ("animations", 0, "channels", 0)
SAMPLER = ("animations", 0, "samplers", 0)


@pytest.mark.parametrize(
    "change, words",
    [
        (
            put("interpolation", "CUBIC", *SAMPLER),
            "interpolation is 'CUBIC'; it must be STEP, LINEAR or CUBICSPLINE",
        ),
        (put("sampler", 3, *CHANNEL), "channels[0].sampler is 3"),
        (put("node", 3, *CHANNEL, "target"), "target.node is 3"),
        (put("input", 99, *SAMPLER), "samplers[0].input is 99"),
        (put("output", 1, *SAMPLER), "accessors[1].type is 'SCALAR'"),
        (put("interpolation", "CUBICSPLINE", *SAMPLER), "has 6 numbers for 2 keys; 18 are needed"),
        (put("matrix", np.eye(4).reshape(-1).tolist(), "nodes", 0), "nodes[0], which has a matrix"),
        (put("count", 1, "accessors", 2), "has 3 numbers for 2 keys; 6 are needed"),
    ],
)
def test_bad_animations(tmp_path, change, words):
    made = animated()
    change(made.json)
    assert words in message_of(made.write(tmp_path))


@pytest.mark.parametrize(
    "times, values, words",
    [
        ([1, 0], np.zeros((2, 4)) + 1, "go backwards"),
        ([0, np.nan], np.zeros((2, 4)) + 1, "holds NaN or infinity"),
        ([0, 1], np.full((2, 4), np.inf), "holds NaN or infinity"),
        ([0, 1], np.zeros((2, 4)), "rotation key that is zero"),
    ],
)
def test_bad_keys(tmp_path, times, values, words):
    made = single()
    made.animate(0, "rotation", times, values)
    assert words in message_of(made.write(tmp_path))


def test_bad_skins(tmp_path):
    made = everything()
    made.json["skins"][0]["joints"] = [0]
    assert "uses joint 1, but made.glb: skins[0] has 1" in message_of(made.write(tmp_path))
    made.json["skins"][0]["joints"] = [0, 1, 2]
    assert "skins[0] has 3 joints but 2 inverseBindMatrices" in message_of(made.write(tmp_path))
    made.json["skins"][0]["joints"] = [0, 99]
    assert "skins[0].joints is 99" in message_of(made.write(tmp_path))


def test_bad_morph_targets(tmp_path):
    made = Gltf()
    short = {"POSITION": made.accessor(TRIANGLE[:2])}
    made.node(mesh=made.mesh(made.primitive(targets=[short])))
    assert "3 positions but 2 of another attribute" in message_of(made.write(tmp_path))
    made.json["meshes"][0]["primitives"].append(made.primitive())
    assert "different numbers of morph targets" in message_of(made.write(tmp_path))
    made.json["meshes"][0]["primitives"][0] = made.primitive()
    made.json["nodes"][0]["weights"] = [1.0]
    assert "nodes[0].weights is a list of 1; it must be 0 numbers" in message_of(made.write(tmp_path))


def test_bad_instancing(tmp_path):
    made = single()
    names = {"SCALE": made.accessor(np.array([[1, 1, 1], [0, 1, 1]], np.float32))}
    made.json["nodes"][0]["extensions"] = {"EXT_mesh_gpu_instancing": {"attributes": names}}
    assert "instance 1 has a transform without inverse" in message_of(made.write(tmp_path))
    names["TRANSLATION"] = made.accessor(np.zeros((3, 3), np.float32))
    assert "all with the same count" in message_of(made.write(tmp_path))
    names.clear()
    assert "needs TRANSLATION, ROTATION or SCALE" in message_of(made.write(tmp_path))


@pytest.mark.parametrize(
    "perspective, words",
    [
        ({}, "yfov is missing"),
        ({"yfov": 0}, "yfov is 0; it must be an angle between 0 and pi"),
        ({"yfov": 4.0}, "yfov is 4.0"),
        ({"yfov": 1.0, "aspectRatio": 0}, "aspectRatio is 0"),
        ({"yfov": 1.0, "aspectRatio": 1e9}, "aspectRatio is 1000000000.0"),
    ],
)
def test_bad_cameras(tmp_path, perspective, words):
    made = single()
    made.node(camera=made.add("cameras", type="perspective", perspective=perspective))
    assert "cameras[0].perspective" in message_of(made.write(tmp_path))
    assert words in message_of(made.write(tmp_path))


@pytest.mark.parametrize(
    "light, words",
    [
        ({"type": "area"}, "lights[0].type is 'area'"),
        ({}, "lights[0].type is missing"),
        ({"type": "point", "intensity": -1}, "lights[0].intensity is -1"),
        ({"type": "point", "color": [1]}, "lights[0].color is a list of 1"),
    ],
)
def test_bad_lights(tmp_path, light, words):
    made = single()
    made.json["extensions"] = {"KHR_lights_punctual": {"lights": [light]}}
    node = made.node(extensions={"KHR_lights_punctual": {"light": 0}})
    assert words in message_of(made.write(tmp_path))
    light.update(type="point", intensity=1, color=[1, 1, 1])
    made.json["nodes"][node]["scale"] = [0, 0, 0]
    assert "nodes[1] has a transform without inverse" in message_of(made.write(tmp_path))


REMOTE = [
    "http://example.org/a.bin",
    "https://h/a.bin",
    "file:///etc/passwd",
    "ftp://h/a",
    "//host/a.bin",
    "C:\\a.bin",
]
OUTSIDE = [
    "../a.bin",
    "sub/../../a.bin",
    "%2e%2e/a.bin",
    "/etc/passwd",
    "%2Fetc%2Fpasswd",
    "\\\\host\\a.bin",
    "a\0.bin",
    "",
]


@pytest.mark.parametrize("uri", REMOTE + OUTSIDE)
@pytest.mark.parametrize("key", ["buffers", "images"])
def test_uris_that_leave_the_folder(tmp_path, uri, key):
    (tmp_path / "a.bin").write_bytes(bytes(1000))
    folder = tmp_path / "in"
    folder.mkdir()
    made = single(TETRAHEDRON, TETRAHEDRON_FACES)
    document = json.loads(made.gltf())
    document.setdefault(key, []).append({"uri": uri, "byteLength": 10})
    path = folder / "a.gltf"
    path.write_text(json.dumps(document))
    message = message_of(path)
    number = 1 if key == "buffers" else 0
    assert f"a.gltf: {key}[{number}].uri is" in message
    assert "the scene's folder" in message


def test_links_that_leave_the_folder(tmp_path):
    made = single(TETRAHEDRON, TETRAHEDRON_FACES)
    (tmp_path / "a.bin").write_bytes(made.data)
    folder = tmp_path / "in"
    folder.mkdir()
    try:
        (folder / "link.bin").symlink_to(tmp_path / "a.bin")
    except OSError:
        pytest.skip("this system makes no symbolic links")
    (folder / "a.gltf").write_bytes(made.gltf("link.bin"))
    assert "outside the scene's folder" in message_of(folder / "a.gltf")


def test_external_buffers_that_are_missing_or_short(tmp_path):
    made = single(TETRAHEDRON, TETRAHEDRON_FACES)
    path = tmp_path / "a.gltf"
    path.write_bytes(made.gltf("a.bin"))
    assert "buffers[0].uri 'a.bin': no such file" in message_of(path)
    (tmp_path / "a.bin").mkdir()
    assert "not a regular file" in message_of(path)
    path.write_bytes(made.gltf("b.bin"))
    (tmp_path / "b.bin").write_bytes(made.data[:-1])
    assert f"buffers[0].byteLength says {len(made.data)} bytes, but there are {len(made.data) - 1}" in message_of(path)


@pytest.mark.parametrize(
    "uri, words",
    [
        ("data:application/octet-stream;base64,####", "not base64"),
        ("data:nothing", "without a comma"),
        ("data:;base64,AAAA", "byteLength says"),
        ("data:,abc", "byteLength says"),
    ],
)
def test_bad_data_uris(tmp_path, uri, words):
    path = tmp_path / "a.gltf"
    path.write_bytes(single().gltf(uri))
    assert words in message_of(path)


def test_data_uris_without_base64(tmp_path):
    made = single()
    path = tmp_path / "a.gltf"
    path.write_bytes(made.gltf("data:," + "".join(f"%{b:02x}" for b in made.data)))
    assert load(path).n_triangles == 1


def test_a_buffer_without_data(tmp_path):
    made = spoiled(put("buffers", [{"byteLength": 72}, {"byteLength": 72}]))
    made.json["bufferViews"][0]["buffer"] = 1
    assert "buffers[1] has no data" in message_of(made.write(tmp_path))


GOOD = single(TETRAHEDRON, TETRAHEDRON_FACES).glb()
CONTAINERS = {
    "empty": (b"", "is empty"),
    "magic only": (b"glTF", "GLB header is cut short"),
    "truncated": (GOOD[:-9], "it is truncated"),
    "half": (GOOD[: len(GOOD) // 2], "it is truncated"),
    "version 1": (GOOD[:4] + struct.pack("<I", 1) + GOOD[8:], "GLB version is 1"),
    "chunk too long": (GOOD[:12] + struct.pack("<I", 2**31) + GOOD[16:], "GLB chunk 0 says 2147483648 bytes"),
    "first chunk no JSON": (GOOD[:16] + b"BIN\0" + GOOD[20:], "first GLB chunk is not JSON"),
    "JSON cut": (b'{"asset": {"version"', "JSON cannot be read"),
    "JSON list": (b"[]", "is a list of 0; it must be a JSON object"),
    "no text": (bytes(range(256)), "is not a glTF file"),
    "NaN": (b'{"asset": NaN}', "NaN is not JSON"),
    "deep": (b'{"a":' * 100_000, "nested too deeply"),
    "huge number": (b'{"scene": ' + b"9" * 5000 + b"}", "JSON cannot be read"),
    "other JSON": (b"{}", "asset.version is missing"),
}


@pytest.mark.parametrize("suffix", [".glb", ".gltf"])
@pytest.mark.parametrize("case", CONTAINERS)
def test_bad_containers(tmp_path, case, suffix):
    content, words = CONTAINERS[case]
    path = tmp_path / f"case{suffix}"
    path.write_bytes(content)
    assert words in message_of(path)


def test_glb_sizes_are_checked_against_the_file(tmp_path):
    made = single(TETRAHEDRON, TETRAHEDRON_FACES)
    document = {**made.json, "buffers": [{"byteLength": 4_000_000_000}]}
    made.json = document
    assert "buffers[0].byteLength says 4000000000 bytes, but there are" in message_of(made.write(tmp_path))
    document["buffers"] = [{"byteLength": 72, "uri": "data:;base64," + base64.b64encode(made.data).decode()}]
    assert load(made.write(tmp_path)).n_triangles == 4  # a GLB may hold data URIs too
