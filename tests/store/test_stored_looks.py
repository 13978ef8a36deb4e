"""Pictures of a store show the textures, normals and materials of the scene in memory, however it was built."""

import zlib
from types import SimpleNamespace

import numpy as np
import pytest

import antumbra as at
from antumbra.engine import store_building
from antumbra.engine.sources.paged_source import Paged
from antumbra.engine.sources.source_protocols import FrameMemory
from antumbra.formats import obj_stream
from antumbra.formats.gltf import gltf_file
from antumbra.scene import shared_vertices
from antumbra.scene.face_looks import StreamedLooks
from antumbra.store import store_build, stored_looks
from antumbra.store.store_build import PieceSizes
from antumbra.store.system_resources import TRIANGLE_BYTES
from forged_stores import ForgedStore
from looks_scenes import CAMERA, FILES, LIGHTS, scene_with_pixels
from stores import with_small_chunks

SMALL = PieceSizes(staged=30, run=40, unit=150)
OPTIONS = [
    {},
    {"materials": "diffuse", "spp": 4},
    {"textures": False, "bounce": 1},
    {"smooth_normals": False, "layers": True},
    {"adaptive": 16, "spp": 4},
]
pytestmark = pytest.mark.filterwarnings("ignore::UserWarning")


def images(scene, options=OPTIONS):
    return [at.render(scene, CAMERA, LIGHTS, **each).image for each in options]


def assert_same_pictures(scene, store, options=OPTIONS):
    for each, found, expected in zip(options, images(store, options), images(scene, options)):
        assert (found == expected).all(), each


@pytest.fixture(params=FILES)
def file(request, tmp_path):
    FILES[request.param](tmp_path, request.param)
    return tmp_path / request.param


@pytest.fixture
def blocks(monkeypatch):
    """Blocks so small that there are several."""
    monkeypatch.setattr(stored_looks, "BLOCK", 48)


@pytest.fixture
def whole(blocks, file, tmp_path):
    """(scene in memory, the bytes of its store)."""
    scene = at.load(file)
    at.build_store(scene, tmp_path / "whole.antumbra", chunk=16)
    return scene, (tmp_path / "whole.antumbra").read_bytes()


@pytest.fixture
def built(tmp_path):
    """The path of a store of the glTF scene."""
    FILES["a.glb"](tmp_path, "a.glb")
    at.build_store(tmp_path / "a.glb", tmp_path / "a.antumbra")
    return tmp_path / "a.antumbra"


# --- Pictures and bytes -----------------------------------------------------------------------------------------------


def test_pictures_are_those_of_the_scene_in_memory(whole, tmp_path):
    scene, store = whole[0], at.load(tmp_path / "whole.antumbra")
    assert store.notes == scene.notes and scene.appearance.normals is not None
    assert_same_pictures(scene, store)
    with_all, plain = images(store, [{}, {"textures": False, "smooth_normals": False, "materials": "diffuse"}])
    assert (with_all != plain).any(-1).mean() > 0.2


def test_pixels_of_arrays_are_kept(tmp_path):
    scene = scene_with_pixels()
    at.build_store(scene, tmp_path / "a.antumbra")
    assert_same_pictures(scene, at.load(tmp_path / "a.antumbra"), OPTIONS[:2])


def test_a_moved_scene_keeps_its_looks(file, tmp_path):
    scene = at.load(file)
    scene.update(transform=[[0.8, 0, 0.6, 0], [0, 1, 0, 0.2], [-0.6, 0, 0.8, 0], [0, 0, 0, 1]])
    at.build_store(scene, tmp_path / "a.antumbra")
    assert (scene.appearance.second_uv is not None) == (file.suffix == ".glb")
    found = at.load(tmp_path / "a.antumbra").data.stored_looks.of(np.arange(scene.n_triangles))
    expected = scene.appearance
    for name in ("uv", "colours", "normals", "bends", "textured", "mapped", "tangents", "hands", "second_uv"):
        assert np.array_equal(getattr(found, name), getattr(expected, name)), name
    of_face = lambda each: [each.materials[k]._replace(texture=None, pbr=None) for k in each.material_of_face]
    factors = lambda each: [(m.name, m.factor) for m in of_face(each)]
    assert factors(found) == factors(expected)


@pytest.mark.parametrize("path", [(), ((gltf_file, "FEW_ELEMENTS", 0), (obj_stream, "_PART", 1 << 20))])
def test_streamed_files_are_the_store_of_the_scene_in_memory(file, whole, tmp_path, monkeypatch, path):
    for module, name, value in path:
        monkeypatch.setattr(module, name, value)
    for sizes in (store_build.USUAL_SIZES, SMALL):
        monkeypatch.setattr(store_build, "USUAL_SIZES", sizes)
        at.build_store(file, tmp_path / "a.antumbra", chunk=16)
        assert (tmp_path / "a.antumbra").read_bytes() == whole[1]
    assert not any("ranges of faces" in note for note in at.load(tmp_path / "a.antumbra").notes)


def test_shards_write_the_same_bytes_and_tiles_show_the_same_pictures(cli, file, whole, tmp_path, monkeypatch):
    monkeypatch.setattr(store_build, "USUAL_SIZES", SMALL)
    monkeypatch.setattr(store_building, "write_store", with_small_chunks)
    for k in range(2):
        assert cli("build", file.name, "-o", "b.antumbra", "--shard", f"{k}/2", "-q").code == 0
    assert cli("merge", "b.shards", "-q").code == 0
    assert (tmp_path / "b.antumbra").read_bytes() == whole[1]
    at.build_store(file, tmp_path / "a.tiles", tile=100)
    tiles = at.load(tmp_path / "a.tiles")
    assert len(tiles.store.tiles) > 2
    assert_same_pictures(whole[0], tiles, OPTIONS[:2])


def test_a_mesh_read_in_ranges_has_the_bytes_of_the_whole(file, whole, tmp_path, monkeypatch):
    """Shading at the borders of ranges depends on the faces of several, which are added up by numbers of vertices.

    In an OBJ file whose corners name normals by numbers of their own, vertices have none, as a note says.
    """
    monkeypatch.setattr(gltf_file, "FEW_ELEMENTS", 0)
    monkeypatch.setattr("antumbra.formats.gltf.gltf_source.FACES_PER_PIECE", 100)
    monkeypatch.setattr(obj_stream, "FACES_PER_PIECE", 100)
    for gap, window in ((1 << 8, 1 << 18), (3, 16)):
        monkeypatch.setattr(shared_vertices, "_GAP", gap)
        monkeypatch.setattr(shared_vertices, "_WINDOW", window)
        at.build_store(file, tmp_path / "a.antumbra", chunk=16)
        store = at.load(tmp_path / "a.antumbra")
        borders = "was read in ranges of faces, at whose borders smooth shading may differ slightly"
        if not any(note.startswith(f"{file.name}: {borders}") for note in store.notes):
            assert (tmp_path / "a.antumbra").read_bytes() == whole[1]
            continue
        assert file.suffix == ".obj"
        assert_same_pictures(whole[0], store, [{"smooth_normals": False, "materials": "diffuse"}])
        found, expected = store.data.stored_looks.of(np.arange(whole[0].n_triangles)), whole[0].appearance
        for name in ("uv", "second_uv", "colours", "normals", "textured", "mapped", "hands"):
            assert np.array_equal(getattr(found, name), getattr(expected, name)), name
        assert 0.0 < (found.bends != expected.bends).any(1).mean() < 0.9


def test_an_obj_file_whose_normals_have_the_numbers_of_vertices(tmp_path, monkeypatch):
    monkeypatch.setattr(obj_stream, "FACES_PER_PIECE", 50)
    n = 20
    x, z = (each.ravel() for each in np.meshgrid(np.arange(n), np.arange(n)))
    y, slope = np.sin(x / 2.0) + 0.1 * (x * z % 3), -np.cos(x / 2.0) / 2.0
    lines = [f"v {a} {b:.6f} {c}" for a, b, c in zip(x, y, z)] + [f"vn {a:.6f} 1 0" for a in slope]
    a = (np.arange(n - 1)[:, None] * n + np.arange(n - 1)).ravel() + 1
    faces = np.concatenate([np.stack([a, a + n, a + 1], 1), np.stack([a + 1, a + n, a + n + 1], 1)])
    lines += [" ".join(["f", *(f"{k}//{k}" for k in face)]) for face in faces.tolist()]
    (tmp_path / "a.obj").write_text("\n".join(lines) + "\n")
    scene = at.load(tmp_path / "a.obj")
    at.build_store(scene, tmp_path / "whole.antumbra", chunk=64)
    at.build_store(tmp_path / "a.obj", tmp_path / "a.antumbra", chunk=64)
    assert (tmp_path / "a.antumbra").read_bytes() == (tmp_path / "whole.antumbra").read_bytes()
    assert scene.appearance.bends.any()


def test_a_disk_without_room_for_shared_vertices(tmp_path, monkeypatch):
    def full(*_):
        raise OSError(28, "No space left on device")

    FILES["a.glb"](tmp_path, "a.glb")
    monkeypatch.setattr(gltf_file, "FEW_ELEMENTS", 0)
    monkeypatch.setattr("antumbra.formats.gltf.gltf_source.FACES_PER_PIECE", 100)
    monkeypatch.setattr(shared_vertices, "_write", full)
    with pytest.raises(at.InputError, match=r"a.glb: its vertices have no room in .* \(No space left on device\)"):
        at.build_store(tmp_path / "a.glb", tmp_path / "a.antumbra")


def test_space_for_looks_is_asked_for_before_it_is_taken(file, tmp_path, monkeypatch):
    scene = at.load(file)
    bare = TRIANGLE_BYTES * scene.n_triangles
    for given, looks in ((file, StreamedLooks(scene.data.looks().attributes)), (scene, scene.data.looks())):
        need = bare + 2 * looks.face_bytes * scene.n_triangles
        monkeypatch.setattr("shutil.disk_usage", lambda _, free=need - 1: SimpleNamespace(free=free))
        with pytest.raises(at.InputError, match=r"a.antumbra: .* triangles take about .* while they are built"):
            at.build_store(given, tmp_path / "a.antumbra")
        monkeypatch.setattr("shutil.disk_usage", lambda _, free=need: SimpleNamespace(free=free))
        at.build_store(given, tmp_path / "a.antumbra")


def test_images_are_stored_once_and_as_they_were(built):
    section = at.load(built).store.meta.looks
    data = built.read_bytes()
    assert len(section.images) == 6 and len(section.materials) >= 3
    for offset, size in section.images.values():
        image = data[section.offset + offset :][:size]
        assert image.startswith(b"\x89PNG") and image in built.with_name("a.glb").read_bytes()


def test_bare_pictures_are_those_of_the_file(cli, file, tmp_path):
    for name in ("s.antumbra", "s.tiles"):
        assert cli("build", file.name, "-o", name, "-q").code == 0
    for size in ("64x48", "30x70"):
        for k, name in enumerate((file.name, "s.antumbra", "s.tiles")):
            assert cli("render", name, "-o", f"{k}.png", "--size", size, "-q").code == 0
        whole, store, tiles = ((tmp_path / f"{k}.png").read_bytes() for k in range(3))
        assert whole == store == tiles


def test_a_scene_of_plain_colours_has_no_looks(tmp_path):
    at.build_store(at.procedural("cellar", triangles=2000), tmp_path / "a.antumbra")
    scene = at.load(tmp_path / "a.antumbra")
    assert scene.store.meta.looks is None and scene.data.stored_looks is None


# --- Memory -----------------------------------------------------------------------------------------------------------


def test_textures_that_do_not_fit_are_refused(built, monkeypatch):
    scene = at.load(built)
    monkeypatch.setattr("antumbra.store.stored_materials.BYTES_PER_PIXEL", 1 << 24)
    with pytest.raises(
        at.InputError, match=r"not enough for the textures of this picture; render without textures, or"
    ):
        at.render(scene, CAMERA, LIGHTS)
    assert at.render(scene, CAMERA, LIGHTS, textures=False, materials="diffuse").image.any()


def _textures(looks):
    return [material.texture for material in looks.materials if material.texture is not None]


def test_room_for_rows_is_that_of_the_last_ones(built):
    memory = at.load(built).engine.source.memory
    memory.begin(FrameMemory(0, 0, 0))
    whole = memory.residency.budget
    for _ in range(50):
        memory.make_room(whole // 10, "rows")
    assert whole // 2 < memory.residency.budget < whole
    with pytest.raises(at.InputError, match=r"M of memory is not enough for textures, or give \d+M"):
        for _ in range(50):
            memory.make_room(whole // 10, "textures", stays=True)


def test_textures_of_earlier_pictures_are_released_for_others(built, monkeypatch):
    scene = at.load(built)
    first, looks = at.render(scene, CAMERA, LIGHTS).image, scene.data.stored_looks
    decoded = _textures(looks)
    assert len(decoded) == 2 and looks.decoding_bytes(decoded, 2) == 0
    assert looks.forget(decoded[:1]) >= decoded[1].pixels.nbytes
    assert decoded[0] in _textures(looks) and decoded[1] not in _textures(looks)
    monkeypatch.setattr(Paged, "has_room", lambda self, size: False)
    assert (at.render(scene, CAMERA, LIGHTS).image == first).all()


# --- Damage -----------------------------------------------------------------------------------------------------------


def test_any_damage_is_detected(cli, built):
    data, rng = built.read_bytes(), np.random.default_rng(1)
    section = at.load(built).store.meta.looks
    for place in rng.integers(section.offset, section.offset + section.bytes, 60).tolist():
        damaged = bytearray(data)
        damaged[place] ^= 1 << rng.integers(8)
        built.write_bytes(damaged)
        told = cli("info", str(built), "--check")
        assert told.code == 2 and "a.antumbra: its looks are damaged; copy the file again" in told.err, place


def test_forged_looks_are_refused_or_harmless(built):
    data, rng, refused = built.read_bytes(), np.random.default_rng(2), 0
    section = at.load(built).store.meta.looks
    words = np.frombuffer(data, np.int32, section.table // 4, section.offset)
    for place in rng.integers(0, len(words), 40).tolist():
        forged = ForgedStore(data)
        looks = bytearray(forged.looks)
        looks[4 * place : 4 * place + 4] = int(rng.integers(-(2**31), 2**31)).to_bytes(4, "little", signed=True)
        table = np.frombuffer(bytes(looks[section.table :]), stored_looks.ROW, 1).copy()
        table["crc"] = zlib.crc32(looks[int(table["offset"][0]) :][: int(table["bytes"][0])])
        looks[section.table : section.table + table.nbytes] = table.tobytes()
        forged.meta["looks"]["crc"] = zlib.crc32(looks[section.table :])
        forged.looks = bytes(looks)
        built.write_bytes(forged.data)
        try:
            at.render(at.load(built), CAMERA, LIGHTS[:1], spp=1)
        except at.InputError as error:
            assert str(error).startswith(("a.antumbra: its looks", "a.glb")), error
            refused += 1
    assert refused > 3


@pytest.mark.parametrize(
    "change",
    [
        lambda looks: looks.update(table=-1),
        lambda looks: looks.update(bytes=looks["bytes"] + 4096),
        lambda looks: looks.update(attributes=["uv", "smell"]),
        lambda looks: looks.update(is_textured=2),
        lambda looks: looks["images"].update({"0" * 64: [0, 1 << 40]}),
        lambda looks: looks.update(images={}),
        lambda looks: looks["materials"].append("{}"),
        lambda looks: looks["materials"].append('{"name": "x", "factor": [1, 2]}'),
        lambda looks: looks["materials"].append("["),
        lambda looks: looks.update(materials=None),
    ],
)
def test_a_forged_section_is_refused(built, change):
    forged = ForgedStore(built.read_bytes())
    change(forged.meta["looks"])
    built.write_bytes(forged.data)
    with pytest.raises(at.InputError, match=r"^a\.antumbra: (its directory is not consistent|describes its scene)"):
        at.load(built)


def test_stores_of_the_version_before_show_mean_colours_and_say_so(built):
    forged = ForgedStore(built.read_bytes())
    forged.header["version"] = 3
    del forged.meta["looks"]
    forged.looks = b""
    forged.meta["notes"].append("a: a store keeps the mean colour of each face, without textures and normals")
    built.write_bytes(forged.data)
    scene = at.load(built)
    assert any("earlier version, without textures; build it again" in note for note in scene.notes)
    assert at.render(scene, CAMERA, LIGHTS).image.any()
