"""Meshes compressed by meshoptimizer give the scene of the uncompressed file."""

import json
import shutil
import sys

import meshopt
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial import cKDTree

import antumbra as at
from antumbra.formats.gltf.gltf_file import MAX_RATIO
from gltf_files import Gltf
from repository import ROOT
from strength import examples
from web_scene import COPIES, PACKED, TIMES, garden, hill

FOLDER = ROOT / "tests" / "data" / "compressed"
EXTENSIONS = "EXT_meshopt_compression", "KHR_meshopt_compression"


def json_of(path):
    data = path.read_bytes()
    return json.loads(data[20 : 20 + int.from_bytes(data[12:16], "little")] if data[:4] == b"glTF" else data)


def world(scene, time=0.0):
    return scene.triangles(time).vertices.astype(float) + scene.origin


def same_triangles(first, second) -> bool:
    """Whether triangles, (n, 3, 3), are equal; the codec TRIANGLES may turn their corners."""
    turns = np.array([np.roll(first, k, axis=1) for k in range(3)])
    return first.shape == second.shape and (turns == second).all((2, 3)).any(0).all()


# --- Files of gltfpack ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("file", PACKED)
def test_files_of_gltfpack_show_the_garden(file, tmp_path):
    used = json_of(FOLDER / file)["extensionsUsed"]
    assert len(set(used) & set(EXTENSIONS)) == 1 and ("EXT_mesh_gpu_instancing" in used) == ("-mi" in PACKED[file])
    packed = at.load(FOLDER / file, instances=False)
    plain = at.load(garden(at_rest="-mi" in PACKED[file]).write(tmp_path))
    assert packed.n_triangles == plain.n_triangles == 864 and packed.duration == plain.duration
    for time in np.linspace(0.0, plain.duration, 5):
        first, second = world(packed, time), world(plain, time)
        distance, nearest = cKDTree(second.mean(1)).query(first.mean(1))
        assert distance.max() < 1e-3 and len(set(nearest.tolist())) == 864
        areas = [np.linalg.norm(np.cross(v[:, 1] - v[:, 0], v[:, 2] - v[:, 0]), axis=1) for v in (first, second)]
        np.testing.assert_allclose(areas[0], areas[1][nearest], rtol=0.02)
    colours = np.abs(packed.colours - plain.colours[nearest])
    assert colours.max() < 0.02 and np.ptp(plain.colours, axis=0).max() > 0.5
    normals = [scene.appearance.normals.reshape(864, -1) for scene in (packed, plain)]
    assert normals[0].any() and normals[1].any()
    if plain.duration:
        assert np.abs(world(plain, TIMES[1]) - world(plain)).max() > 0.5


def test_all_codecs_and_filters_are_covered():
    views = [view for file in PACKED for view in json_of(FOLDER / file)["bufferViews"]]
    packed = [next(iter(view["extensions"].values())) for view in views if "extensions" in view]
    assert {each["mode"] for each in packed} == {"ATTRIBUTES", "TRIANGLES"}
    filters = {each.get("filter", "NONE") for each in packed}
    assert filters == {"NONE", "OCTAHEDRAL", "QUATERNION", "EXPONENTIAL", "COLOR"}


def test_objects_keep_the_names_of_the_nodes_above_them():
    for file in ("ext.glb", "khr.glb", "fallback.gltf"):
        assert [each.name for each in at.load(FOLDER / file).objects] == ["hill 0", "hill 1", "hill 2"]


def test_fallback_buffers(tmp_path, monkeypatch):
    for name in ("fallback.gltf", "fallback.bin"):
        shutil.copy(FOLDER / name, tmp_path)
    decoded = at.load(tmp_path / "fallback.gltf")  # the fallback is missing
    monkeypatch.setitem(sys.modules, "meshopt", None)
    with pytest.raises(at.InputError, match=r"compressed with meshopt, needs meshopt: pip install 'antumbra\[comp"):
        at.load(tmp_path / "fallback.gltf")
    plain = at.load(FOLDER / "fallback.gltf")  # without the library
    for time in (0.0, 0.7):
        assert same_triangles(decoded.triangles(time).vertices, plain.triangles(time).vertices)


# --- Views that Python compresses -------------------------------------------------------------------------------------


def pack(made: Gltf, extension: str, modes=(), filters=(), version=0) -> Gltf:
    """The file with compressed views.

    modes : {view: mode}, ATTRIBUTES by default
    filters : {view: (name, filtered rows, (n, stride) uint8)}
    """
    modes, filters = dict(modes), dict(filters)
    views, data = made.json["bufferViews"], bytes(made.data)
    made.data = bytearray()
    for i, view in enumerate(views):
        accessor = next(a for a in made.json["accessors"] if a["bufferView"] == i)
        first, count, length = view["byteOffset"], accessor["count"], view["byteLength"]
        rows = np.frombuffer(data[first : first + length], np.uint8).reshape(count, -1)
        mode, (name, rows) = modes.get(i, "ATTRIBUTES"), filters.get(i, ("NONE", rows))
        values = rows if mode == "ATTRIBUTES" else rows.view({2: "<u2", 4: "<u4"}[rows.shape[1]]).reshape(-1)
        packed = meshopt.encode_gltf_buffer(values, mode, version)
        made.data += bytes(-len(made.data) % 4)
        fields = {"buffer": 0, "byteOffset": len(made.data), "byteLength": len(packed), "byteStride": length // count}
        more = {} if name == "NONE" else {"filter": name}
        view |= {"buffer": 1, "extensions": {extension: {**fields, "count": count, "mode": mode, **more}}}
        made.data += packed
    fallback = {"byteLength": len(data), "extensions": {extension: {"fallback": True}}}
    made.json |= {"buffers": [{"byteLength": len(made.data)}, fallback]}
    made.json |= {"extensionsUsed": [extension], "extensionsRequired": [extension]}
    return made


def soup(positions, indices):
    made = Gltf()
    made.node(mesh=made.mesh(made.primitive(positions, indices)))
    return made


@examples(40)
@given(
    seed=st.integers(0, 2**32 - 1),
    n=st.integers(3, 400),
    dtype=st.sampled_from(["<u2", "<u4"]),
    newer=st.booleans(),
)
def test_codecs_are_lossless(seed, n, dtype, newer, tmp_path_factory):
    rng, folder = np.random.default_rng(seed), tmp_path_factory.mktemp("meshopt")
    positions = rng.normal(size=(n, 3)).astype(np.float32)
    indices = rng.integers(0, n, 3 * n).astype(dtype)
    plain = world(at.load(soup(positions, indices).write(folder, "plain.glb")))
    for extension in EXTENSIONS:
        for mode in ("INDICES", "TRIANGLES"):
            version = int(newer and extension.startswith("KHR"))
            packed = pack(soup(positions, indices), extension, {1: mode}, version=version).write(folder)
            decoded = world(at.load(packed))
            assert (decoded == plain).all() if mode == "INDICES" else same_triangles(decoded, plain)


def shared_exponents(rows: np.ndarray) -> np.ndarray:
    """(n, k) float64: the EXPONENTIAL filter, as the extension specifies it."""
    bits = rows.view("<i4")
    return np.ldexp((bits << 8 >> 8).astype(float), bits >> 24)


def test_exponents(tmp_path):
    positions = hill()[0]
    filtered = meshopt.encode_filter_exp(positions, 15)
    made = pack(soup(positions, np.arange(168, dtype="<u4")), EXTENSIONS[0], filters={0: ("EXPONENTIAL", filtered)})
    expected = shared_exponents(filtered).astype(np.float32)[:168].reshape(-1, 3, 3)
    scene = at.load(made.write(tmp_path))
    assert (expected != positions[:168].reshape(-1, 3, 3)).any()
    np.testing.assert_array_equal(scene.triangles().vertices, (expected - scene.origin).astype(np.float32))


def test_quaternions_and_octahedra(tmp_path):
    rng = np.random.default_rng(0)
    turns = rng.normal(size=(20, 4))
    turns = (turns / np.linalg.norm(turns, axis=1, keepdims=True)).astype(np.float32)
    positions, normals, _, faces = hill(2)
    stored = meshopt.encode_filter_oct(np.c_[normals, np.ones(len(normals))], 4, 8)
    scenes = []
    for compress in (False, True):
        made = Gltf()
        rotation = np.round(turns * 32767).astype(np.int16)
        attributes = {"ROTATION": made.accessor(rotation, normalized=True)}
        attributes["TRANSLATION"] = made.accessor(np.repeat(np.arange(20.0), 3).reshape(-1, 3).astype(np.float32))
        normal = np.c_[np.round(normals * 127), 0 * normals[:, 0]].astype(np.int8)
        more = {} if compress else {"NORMAL": made.accessor(normals)}
        primitive = made.primitive(positions, faces.reshape(-1), attributes=more)
        filters = {0: ("QUATERNION", meshopt.encode_filter_quat(turns, 8, 16))}
        if compress:
            view = made.view(normal.tobytes(), byteStride=4)
            fields = {"bufferView": view, "componentType": 5120, "count": len(normals), "type": "VEC3"}
            primitive["attributes"]["NORMAL"] = made.add("accessors", normalized=True, **fields)
            filters[view] = "OCTAHEDRAL", stored
        made.node(mesh=made.mesh(primitive), extensions={"EXT_mesh_gpu_instancing": {"attributes": attributes}})
        if compress:
            pack(made, EXTENSIONS[0], {3: "INDICES"}, filters)
        scenes.append(at.load(made.write(tmp_path)))
    plain, packed = scenes
    np.testing.assert_allclose(packed.triangles().vertices, plain.triangles().vertices, atol=2e-3)
    assert plain.n_triangles == 160 and len(np.unique(plain.triangles().vertices)) > 100
    np.testing.assert_allclose(packed.appearance.normals, plain.appearance.normals, atol=0.05)
    assert (packed.appearance.normals != plain.appearance.normals).any()


# --- Damage -----------------------------------------------------------------------------------------------------------


def spoil(change) -> Gltf:
    made = pack(soup(*[a for a in (hill()[0], hill()[3].reshape(-1))]), EXTENSIONS[0], {1: "TRIANGLES"})
    view = made.json["bufferViews"][0]
    change(view, view["extensions"][EXTENSIONS[0]], made)
    return made


DAMAGE = {
    "sizes": (lambda v, e, m: e.update(count=2), "bufferViews[0] has 2028 bytes, its compressed data 2 * 12"),
    "stride": (lambda v, e, m: e.update(byteStride=6, count=2 * e["count"]), "cannot be decoded (a row must be 4"),
    "mode": (lambda v, e, m: e.update(mode="POINTS"), "cannot be decoded (mode must be"),
    "filter": (lambda v, e, m: e.update(filter="QUATERNION"), "cannot be decoded (quaternion"),
    "no mode": (lambda v, e, m: e.pop("mode"), "EXT_meshopt_compression.mode is missing"),
    "range": (lambda v, e, m: e.update(byteOffset=1 << 20), "buffers[0] has 0 bytes; copy it again"),
    "no data": (lambda v, e, m: e.update(buffer=1), "buffers[1] has no data; copy it again"),
    "bomb": (
        lambda v, e, m: (v.update(byteLength=12 << 30), e.update(count=1 << 30)),
        "which no encoder writes; export it again",
    ),
    "data": (lambda v, e, m: m.data.__setitem__(slice(0, 40), bytes(40)), "meshopt data cannot be decoded ("),
}


@pytest.mark.parametrize("case", DAMAGE)
def test_damage_is_named(case, tmp_path):
    change, words = DAMAGE[case]
    with pytest.raises(at.InputError) as caught:
        at.load(spoil(change).write(tmp_path))
    assert words in str(caught.value) and str(caught.value).startswith("made.glb: bufferViews[0]")


def test_the_densest_code_is_within_the_bound():
    for size in (4, 16, 32):
        rows = np.zeros((1 << 16, size), np.uint8)
        packed = min(len(meshopt.encode_vertex_buffer_level(rows, 3, version)) for version in (0, 1))
        assert MAX_RATIO / 4 < rows.size / packed <= MAX_RATIO


def test_random_bytes_are_refused_or_read(tmp_path):
    rng, outcomes = np.random.default_rng(0), set()
    good = (FOLDER / "ext.glb").read_bytes()
    for _ in range(60):
        data = bytearray(good)
        at_byte = int(rng.integers(len(good) - 2536, len(good) - 4))
        data[at_byte : at_byte + 4] = rng.bytes(4)
        (tmp_path / "a.glb").write_bytes(data)
        try:
            outcomes.add(at.load(tmp_path / "a.glb").n_triangles > 0)
        except at.InputError as error:
            outcomes.add(str(error)[:7])
    assert outcomes == {True, "a.glb: "}


# --- Baking -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("file", PACKED)
def test_a_bake_is_not_compressed(file, tmp_path, monkeypatch):
    at.bake(FOLDER / file, tmp_path / "baked.glb", attribute="_AO", spp=4)
    written = json_of(tmp_path / "baked.glb")
    assert not set(EXTENSIONS) & set(written["extensionsUsed"]) and len(written["buffers"]) == 1
    assert "meshopt" not in json.dumps(written) and "fallback" not in json.dumps(written)
    stored = sum(view["byteLength"] for view in written["bufferViews"])
    assert written["buffers"][0]["byteLength"] - stored < 4 * len(written["bufferViews"])  # nothing unused remains
    monkeypatch.setitem(sys.modules, "meshopt", None)
    first, second = at.load(FOLDER / "fallback.gltf"), at.load(tmp_path / "baked.glb")
    assert second.n_triangles == 864 and second.duration == (0.0 if "-mi" in PACKED[file] else 2.0)
    np.testing.assert_allclose(first.bounds, second.bounds, atol=1e-3)
    assert len(COPIES) == len(second.objects)
