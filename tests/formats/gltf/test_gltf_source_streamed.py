"""Large glTF files are stored range by range, with the bytes of the scene in memory."""

import shutil

import numpy as np
import pytest

import antumbra as at
from antumbra.base.memory import reading_limit
from antumbra.engine.scene_reading import read_scene_data
from antumbra.formats import face_ranges
from antumbra.formats.gltf import gltf_file, gltf_source
from antumbra.formats.scene_format import ReadOptions
from formats.gltf.test_gltf_file_meshopt import FOLDER
from formats.gltf.test_gltf_meshes_draco import textured
from gltf_files import Gltf, png
from web_scene import garden

RNG = np.random.default_rng(11)
N_VERTICES, N_FACES = 300, 211
POINTS = RNG.normal(size=(N_VERTICES, 3)).astype(np.float32)
POINTS[-20:] += 50.0  # unused
FACES = RNG.integers(0, N_VERTICES - 20, (N_FACES, 3))
TURNED = {"rotation": [0.5, 0.5, 0.5, 0.5], "scale": [1.0, 2.0, 0.3], "translation": [448262.5, 4.0, -1.1]}


@pytest.fixture
def on_disk(monkeypatch):
    """Even small files stay on the disk, and are read in small ranges."""
    monkeypatch.setattr(gltf_file, "FEW_ELEMENTS", 0)
    monkeypatch.setattr(gltf_source, "FACES_PER_PIECE", 23)
    monkeypatch.setattr(face_ranges, "_WINDOW", 600)
    monkeypatch.setattr(face_ranges, "_GAP", 30)


def mesh_of(made: Gltf, kind="<u2", points=POINTS, faces=FACES, **fields) -> int:
    return made.mesh(made.primitive(points, None if faces is None else faces.astype(kind), **fields))


def several_meshes_and_nodes() -> Gltf:
    made = Gltf()
    plain = made.add("materials", name="clay", pbrMetallicRoughness={"baseColorFactor": [0.2, 0.5, 0.9, 1.0]})
    first, second = mesh_of(made, material=plain), mesh_of(made, "<u4", POINTS * 2, FACES[::2], name="second")
    small = made.mesh(made.primitive(POINTS, FACES[:5].astype("<u1") // 2), made.primitive(POINTS[:60]))
    made.node(mesh=first, children=[made.node(root=False, mesh=second, **TURNED)], scale=[1e-3] * 3)
    for k in range(3):
        made.node(mesh=small, translation=[k, 0.1, 0.0], name=f"copy {k}")
    made.node(mesh=first, **TURNED)
    made.node(mesh=first, **TURNED)  # which a note tells
    made.node(camera=made.add("cameras", type="perspective", perspective={"yfov": 1.0, "znear": 0.1}))
    return made


def instanced() -> Gltf:
    made = several_meshes_and_nodes()
    moved = {"TRANSLATION": made.accessor(RNG.random((7, 3), np.float32) * 9)}
    for mesh in (0, 2):  # read in ranges, and at once
        made.node(mesh=mesh, extensions={"EXT_mesh_gpu_instancing": {"attributes": moved}}, **TURNED)
    return made


def strips_and_fans() -> Gltf:
    made, order = Gltf(), np.arange(N_VERTICES - 20)[::-1].astype("<u2")
    for mode in (5, 6):
        made.node(mesh=mesh_of(made, mode=mode, faces=order), **TURNED)
        made.node(mesh=mesh_of(made, mode=mode, faces=None, points=POINTS[:200]))
    made.node(mesh=made.mesh(made.primitive(POINTS), made.primitive(POINTS, mode=1)))  # a list of corners; lines
    return made


def quantized_and_interleaved() -> Gltf:
    rows = np.zeros(N_VERTICES, [("at", "<i2", 3), ("gap", "<u2"), ("rgb", "u1", 3), ("end", "u1"), ("uv", "<f4", 2)])
    rows["at"], rows["rgb"], rows["uv"] = POINTS * 300, RNG.integers(0, 256, (N_VERTICES, 3)), POINTS[:, :2]
    made = Gltf()
    view = made.view(rows.tobytes(), byteStride=rows.dtype.itemsize)
    of = lambda offset, code, kind, **more: made.add(
        "accessors", bufferView=view, byteOffset=offset, componentType=code, count=N_VERTICES, type=kind, **more
    )
    at = of(0, 5122, "VEC3", normalized=True)
    attributes = {"COLOR_0": of(8, 5121, "VEC3", normalized=True), "TEXCOORD_0": of(12, 5126, "VEC2")}
    image = made.add("images", bufferView=made.view(png(RNG.integers(0, 256, (8, 8, 3)))), mimeType="image/png")
    texture = {"baseColorTexture": {"index": made.add("textures", source=image)}}
    for material in (made.add("materials", pbrMetallicRoughness=texture), made.add("materials")):
        made.node(mesh=made.mesh(made.primitive(at, FACES.astype("<u2"), attributes=attributes, material=material)))
    return made


def sparse_and_morphed() -> Gltf:
    made = Gltf()
    replaced = {"count": 2, "indices": {"bufferView": made.view(np.array([3, 250], "<u2").tobytes())}}
    replaced["indices"]["componentType"] = 5123
    replaced["values"] = {"bufferView": made.view(np.full((2, 3), 7.0, "<f4").tobytes())}
    points, moved = made.accessor(POINTS, sparse=replaced), made.accessor(POINTS[::-1].copy())
    zeros = made.add("accessors", componentType=5126, count=N_VERTICES, type="VEC3", sparse=replaced)
    targets = [{"POSITION": moved}, {"POSITION": zeros}]
    primitive = made.primitive(points, FACES.astype("<u2"), targets=targets, attributes={"NORMAL": moved})
    made.node(mesh=made.mesh(primitive, weights=[0.25, 0.5]), **TURNED)
    made.node(mesh=made.mesh(made.primitive(zeros, FACES.astype("<u2"))))
    return made


def skinned() -> Gltf:
    made = Gltf()
    joints = RNG.integers(0, 2, (N_VERTICES, 4)).astype("u1")
    influences = {
        "JOINTS_0": made.accessor(joints),
        "WEIGHTS_0": made.accessor(RNG.random((N_VERTICES, 4), np.float32)),
    }
    bones = [made.node(translation=[0.0, k, 0.0]) for k in range(2)]
    made.node(mesh=mesh_of(made, attributes=influences), skin=made.add("skins", joints=bones))
    return made


FILES = {
    "several meshes and nodes": several_meshes_and_nodes,
    "instanced": instanced,
    "strips and fans": strips_and_fans,
    "quantized and interleaved": quantized_and_interleaved,
    "sparse and morphed": sparse_and_morphed,
    "skinned": skinned,
    "Draco": lambda: textured(True),
    "animated": garden,
}


def streamed(path):
    return read_scene_data(path, ReadOptions(streamed=True))


def check_same_store(path, folder):
    """A store of the file on the disk has the bytes of that of the scene in memory."""
    scene, data = at.load(path), streamed(path)
    notes = tuple(note for note in scene.notes if "instances have one colour" not in note)  # stores have no materials
    assert not data.source.in_memory and data.notes == notes and data.bounds.tolist() == scene.bounds.tolist()
    at.build_store(scene, folder / "whole.antumbra", chunk=64)
    at.build_store(path, folder / "streamed.antumbra", chunk=64)
    assert (folder / "streamed.antumbra").read_bytes() == (folder / "whole.antumbra").read_bytes()
    return data


@pytest.mark.parametrize("name", FILES)
@pytest.mark.filterwarnings("ignore::UserWarning")
def test_a_store_of_a_file_on_the_disk_has_the_bytes_of_the_scene_in_memory(tmp_path, on_disk, name):
    path = FILES[name]().write(tmp_path)
    data = check_same_store(path, tmp_path)
    if name != "Draco":
        assert max(len(piece.faces) for piece in data.source.pieces(0.0) if piece.faces is not None) <= 23
    if name in ("several meshes and nodes", "instanced"):
        assert "repeats another" in "".join(data.notes)


@pytest.mark.parametrize("file", ["ext.glb", "khr.glb", "fallback.gltf"])
@pytest.mark.filterwarnings("ignore::UserWarning")
def test_views_compressed_by_meshoptimizer_go_to_a_scratch_file(tmp_path, on_disk, file):
    for name in {file, file.replace("gltf", "bin")}:
        shutil.copy(FOLDER / name, tmp_path)
    check_same_store(tmp_path / file, tmp_path)


@pytest.mark.parametrize("uri", ["many bytes.bin", None])
@pytest.mark.filterwarnings("ignore::UserWarning")
def test_buffers_beside_the_file_and_inside_it(tmp_path, on_disk, uri):
    made = several_meshes_and_nodes()
    (tmp_path / "many bytes.bin").write_bytes(bytes(made.data))
    (tmp_path / "a.gltf").write_bytes(made.gltf(uri))
    check_same_store(tmp_path / "a.gltf", tmp_path)


@pytest.mark.filterwarnings("ignore::UserWarning")
def test_copies_that_memory_keeps_as_instances(tmp_path, on_disk, monkeypatch):
    monkeypatch.setattr("antumbra.scene.instance_data.FEW_BYTES", 0)
    check_same_store(instanced().write(tmp_path), tmp_path)


def test_small_files_are_read_whole(tmp_path):
    assert streamed(several_meshes_and_nodes().write(tmp_path)).source.in_memory


def damaged(change) -> Gltf:
    """A file whose only mesh uses all but the first vertices, after a change of its points and faces."""
    points, faces = np.concatenate([np.full((9, 3), 5.0, np.float32), POINTS]), FACES + 9
    change(points, faces)
    made = Gltf()
    made.node(mesh=mesh_of(made, points=points, faces=faces))
    return made


def cut_buffer() -> Gltf:
    made = damaged(lambda points, faces: None)
    made.data = made.data[:-40]
    return made


def other_count(name: str) -> Gltf:
    made = damaged(lambda points, faces: None)
    made.json["meshes"][0]["primitives"][0]["attributes"][name] = made.accessor(POINTS[:90])
    return made


def corners_in_floats() -> Gltf:
    made = damaged(lambda points, faces: None)
    made.json["meshes"][0]["primitives"][0]["indices"] = 0
    return made


DAMAGED = {
    "a missing vertex": (
        damaged(lambda points, faces: faces.__setitem__((177, 1), 999)),
        "face 177 uses the vertices ",
    ),
    "not a number": (damaged(lambda points, faces: points.__setitem__((faces[60, 0], 1), np.nan)), ": vertex "),
    "a buffer that is cut": (cut_buffer(), "the data is cut short"),
    "too few normals": (other_count("NORMAL"), "309 positions but 90 of another attribute"),
    "corners in floats": (corners_in_floats(), "'VEC3'"),
}


@pytest.mark.parametrize("name", DAMAGED)
def test_damage_is_named_as_in_memory(tmp_path, on_disk, name):
    made, words = DAMAGED[name]
    path = made.write(tmp_path)
    with pytest.raises(at.InputError) as in_memory:
        at.load(path)
    with pytest.raises(at.InputError) as on_its_way:
        at.build_store(path, tmp_path / "a.antumbra")
    assert str(on_its_way.value) == str(in_memory.value) and words in str(in_memory.value)
    assert [each.name for each in tmp_path.iterdir()] == [path.name]


def test_vertices_that_are_not_numbers_have_their_number_in_the_file(tmp_path):
    made, _ = DAMAGED["not a number"]
    with pytest.raises(at.InputError, match=f"vertex {FACES[60, 0] + 9} is"):
        at.load(made.write(tmp_path))


def test_a_file_that_shrinks_is_refused(tmp_path, on_disk):
    path = several_meshes_and_nodes().write(tmp_path)
    source = streamed(path).source
    path.write_bytes(path.read_bytes()[:-2000])
    with pytest.raises(at.InputError, match=r"made\.glb: was cut short while it was read"):
        list(source.pieces(0.0))


@pytest.mark.parametrize("name, cure", [("Draco", "gltf-transform"), ("sparse and morphed", "binary PLY")])
def test_what_must_be_decoded_whole_is_refused_with_a_cure(tmp_path, on_disk, name, cure):
    path = FILES[name]().write(tmp_path)
    with reading_limit(1000), pytest.raises(at.InputError, match=cure) as refused:
        at.build_store(path, tmp_path / "a.antumbra")
    assert "more than the limit (1.0 kB)" in str(refused.value) and "\n" not in str(refused.value)


def test_views_that_are_too_large_to_decompress_are_refused_with_a_cure(tmp_path, on_disk):
    path = tmp_path / "ext.glb"
    shutil.copy(FOLDER / path.name, path)
    with reading_limit(100), pytest.raises(at.InputError, match="gltf-transform"):
        at.build_store(path, tmp_path / "a.antumbra")


def test_scratch_files_are_removed_with_the_scene(tmp_path, on_disk, monkeypatch):
    (tmp_path / "scratch").mkdir()
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path / "scratch"))
    data = streamed(textured(True).write(tmp_path))
    assert any(each.name == "decompressed" for each in (tmp_path / "scratch").rglob("*"))
    del data
    assert not any(each.is_file() for each in (tmp_path / "scratch").rglob("decompressed"))
