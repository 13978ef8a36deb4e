"""A store of a scene whose faces let light pass answers as the scene does, however it was built."""

import zlib

import numpy as np
import pytest

import antumbra as at
from antumbra.engine import store_building
from antumbra.formats import obj_stream
from antumbra.formats.gltf import gltf_file
from antumbra.scene.streamed_data import StreamedData
from antumbra.store import store_build
from antumbra.store.store_build import PieceSizes
from antumbra.store.store_file import open_store
from antumbra.store.store_format import CutoutSection
from antumbra.store.tiled_store import manifest_from_json, manifest_to_json
from cutout_scenes import MASKS, pane, rays, same, scene_with_cutouts, with_masks
from forged_stores import ForgedStore
from gltf_files import Gltf, png
from stores import with_small_chunks

LIGHT = at.QuadLight((-2, 5, -2), (4, 1, 0), (0, 0, 4))

# --- Builds -----------------------------------------------------------------------------------------------------------


def _quads(rng, n):
    """(4 n, 3) corners, (4 n, 2) texture coordinates and (2 n, 3) faces of quads."""
    corners = rng.uniform((-3, 0, -3), (3, 2.5, 3), (n, 1, 3)) + rng.normal(0, 0.7, (n, 4, 3))
    uv = np.tile(np.float32([[0, 0], [1, 0], [1, 1], [0, 1]]), (n, 1)) * rng.choice([0.2, 1.0, 2.0], (4 * n, 1))
    faces = (4 * np.arange(n)[:, None, None] + np.array([[0, 1, 2], [0, 2, 3]])).reshape(-1, 3)
    return corners.reshape(-1, 3).astype(np.float32), uv.astype(np.float32), faces


def _leaf(rng):
    return png(np.dstack([np.full((8, 8, 3), 90, np.uint8), 255 * (rng.random((8, 8)) < 0.5).astype(np.uint8)]))


def gltf(folder, name):
    """Leaves with holes, in two copies; glass; veils with so many alphas that these are rounded; and a wall."""
    rng, made = np.random.default_rng(7), Gltf()
    image = made.add("images", bufferView=made.view(_leaf(rng)), mimeType="image/png")
    leaf = {"baseColorTexture": {"index": made.add("textures", source=image)}}
    materials = {
        "leaf": {"alphaMode": "MASK", "pbrMetallicRoughness": leaf},
        "glass": {"extensions": {"KHR_materials_transmission": {"transmissionFactor": 0.8}}},
        "veil": {"alphaMode": "BLEND"},
        "wall": {},
    }
    for key, fields in materials.items():
        corners, uv, faces = _quads(rng, 150)
        attributes = {"TEXCOORD_0": made.accessor(uv)}
        if key == "veil":
            attributes["COLOR_0"] = made.accessor(rng.random((len(corners), 4)).astype(np.float32))
        material = made.add("materials", name=key, **fields)
        mesh = made.mesh(made.primitive(corners, faces.astype("<u2"), attributes=attributes, material=material))
        made.node(mesh=mesh)
        if key == "leaf":
            made.node(mesh=mesh, translation=[1.0, 0.5, 0.0])
    (folder / name).write_bytes(made.glb() if name.endswith(".glb") else made.gltf())


def obj(folder, name):
    """Leaves with holes, glass and a wall."""
    rng, lines, first = np.random.default_rng(7), ["mtllib its.mtl"], 1
    (folder / "leaf.png").write_bytes(_leaf(rng))
    (folder / "its.mtl").write_text(
        "newmtl leaf\nmap_Kd leaf.png\nmap_d leaf.png\nnewmtl glass\nd 0.4\nnewmtl wall\nKd 0.5 0.5 0.5\n"
    )
    for key in ("leaf", "glass", "wall"):
        corners, uv, faces = _quads(rng, 150)
        lines += [f"usemtl {key}", *(f"v {x} {y} {z}" for x, y, z in corners), *(f"vt {u} {v}" for u, v in uv)]
        lines += ["f " + " ".join(f"{k}/{k}" for k in face) for face in faces + first]
        first += len(corners)
    (folder / name).write_text("\n".join(lines) + "\n")


FILES = {"a.glb": gltf, "a.gltf": gltf, "a.obj": obj}
PATHS = {"as one piece": (), "from the disk": ((gltf_file, "FEW_ELEMENTS", 0), (obj_stream, "_PART", 4096))}


@pytest.fixture(params=FILES)
def file(request, tmp_path):
    FILES[request.param](tmp_path, request.param)
    return tmp_path / request.param


@pytest.fixture
def whole(file, tmp_path):
    """(scene in memory, the bytes of its store)."""
    scene = at.load(file)
    at.build_store(scene, tmp_path / "whole.antumbra", chunk=16)
    assert len(scene.cutouts.faces) > 100 and len(scene.cutouts.solid) >= 300
    return scene, (tmp_path / "whole.antumbra").read_bytes()


@pytest.mark.filterwarnings("ignore::UserWarning")
@pytest.mark.parametrize("path", PATHS)
def test_streamed_files_are_the_store_of_the_scene_in_memory(file, whole, tmp_path, monkeypatch, path):
    for module, name, value in PATHS[path]:
        monkeypatch.setattr(module, name, value)
    opened = []
    begin = StreamedData.__init__
    monkeypatch.setattr(StreamedData, "__init__", lambda self, *a, **k: opened.append(begin(self, *a, **k)))
    for sizes in (None, PieceSizes(staged=30, run=40, unit=150)):
        monkeypatch.setattr(store_build, "USUAL_SIZES", sizes or store_build.USUAL_SIZES)
        at.build_store(file, tmp_path / "a.antumbra", chunk=16)
        assert (tmp_path / "a.antumbra").read_bytes() == whole[1]
    assert len(opened) == 2


@pytest.mark.filterwarnings("ignore::UserWarning")
def test_tiles_and_shards_have_the_cutouts_of_the_scene(cli, file, whole, tmp_path, monkeypatch):
    monkeypatch.setattr(store_build, "USUAL_SIZES", PieceSizes(staged=30, run=40, unit=150))
    monkeypatch.setattr(store_building, "write_store", with_small_chunks)
    for k in range(2):
        assert cli("build", file.name, "-o", "b.antumbra", "--shard", f"{k}/2", "-q").code == 0
    assert cli("merge", "b.shards", "-q").code == 0
    assert (tmp_path / "b.antumbra").read_bytes() == whole[1]
    at.build_store(file, tmp_path / "c.tiles", tile=200)
    tiles, scene = at.load(tmp_path / "c.tiles"), whole[0]
    assert len(tiles.store.tiles) > 3 and tiles.store.has_cutouts
    same(tiles.closest_hit(*rays()), scene.closest_hit(*rays()))
    light = LIGHT
    found = [at.visibility(each, rays(200)[0], light, spp=20).fraction for each in (tiles, scene)]
    np.testing.assert_array_equal(*found)
    assert 0.0 < found[1].mean() < 1.0


@pytest.mark.filterwarnings("ignore::UserWarning")
@pytest.mark.parametrize("options", ["cutouts=off", "transmittance=glass:0.3&transmittance=wall:0.7,0.6,0.5"])
def test_options_of_a_scene_hold_for_its_store(cli, file, options):
    assert cli("build", f"{file.name}?{options}", "-o", "b.antumbra", "-q").code == 0
    shares = {"glass": 0.3, "wall": (0.7, 0.6, 0.5)}
    scene = at.load(file, cutouts=False) if options == "cutouts=off" else at.load(file, transmittance=shares)
    stored = at.load("b.antumbra")
    assert (stored.cutouts is None) == (scene.cutouts is None) == (options == "cutouts=off")
    points = rays(200)[0]
    found = [at.visibility(each, points, LIGHT, spp=20).fraction for each in (stored, scene)]
    np.testing.assert_array_equal(*found)


def test_several_scenes_in_one_store_keep_their_masks(tmp_path):
    scenes = [scene_with_cutouts(90), with_masks(80, [pane(0.6), *MASKS[:2]])]
    at.build_store(scenes, tmp_path / "a.antumbra", chunk=64)
    stored, n = at.load(tmp_path / "a.antumbra"), scenes[0].n_triangles
    faces = np.concatenate([scenes[0].cutouts.faces, scenes[1].cutouts.faces + n])
    assert np.array_equal(stored.cutouts.faces, faces)
    uv = np.concatenate([each.cutouts.uv for each in scenes])
    assert np.array_equal(stored.cutouts.uv, uv) and len(stored.cutouts.shapes) < 8  # equal ones are one


# --- What a file may say ----------------------------------------------------------------------------------------------


@pytest.fixture
def small(tmp_path):
    """(path, its bytes) of a store with cut-outs."""
    at.build_store(scene_with_cutouts(90), tmp_path / "a.antumbra", chunk=64)
    return tmp_path / "a.antumbra", (tmp_path / "a.antumbra").read_bytes()


def test_changed_bytes_are_found(small, cli):
    path, data = small
    section = open_store(path).meta.cutouts
    changed = bytearray(data)
    changed[section.offset + section.bytes // 2] ^= 1
    path.write_bytes(changed)
    with pytest.raises(at.InputError, match=r"a\.antumbra: its cut-outs are damaged; copy the file again"):
        at.load(path).occluded([[0, 1, 0]], [[0, 1, 0]])
    cli("info", path.name, "--check").refused("its cut-outs are damaged")


NUMBERS = 0, -1, 1, 2**31 - 1, 2**40, 2**62


@pytest.mark.parametrize("field", CutoutSection._fields)
def test_forged_numbers_of_the_section(small, field):
    path, data = small
    k = CutoutSection._fields.index(field)
    right = ForgedStore(data).meta["cutouts"][k]
    for value in {*NUMBERS, right + 1, right - 1, right + 4096, right - 4096} - {right}:
        forged = ForgedStore(data)
        forged.meta["cutouts"][k] = value
        path.write_bytes(forged.data)
        if field == "texels" and value == right + 1:  # one of the padding, which no mask has
            open_store(path).cutouts()
            continue
        with pytest.raises(at.InputError, match=r"^a\.antumbra: "):
            open_store(path).cutouts()


def test_forged_arrays_of_the_section(small):
    """Words anywhere in the arrays are changed: what is not refused is read without harm."""
    path, data = small
    size, rng, refused = ForgedStore(data).meta["cutouts"][1], np.random.default_rng(1), 0
    for place in rng.choice(size // 4, 60, replace=False):
        for word in (-1, 2**31 - 1, 7, 0x7FC00000):
            forged = ForgedStore(data)
            words = np.frombuffer(forged.cutouts, np.int32).copy()
            words[place] = word
            forged.cutouts = words.tobytes()
            forged.meta["cutouts"][-1] = zlib.crc32(forged.cutouts)
            path.write_bytes(forged.data)
            try:
                at.load(path).closest_hit(*rays(50))
            except at.InputError as error:
                assert str(error).startswith("a.antumbra: its cut-outs are not consistent"), error
                refused += 1
    assert refused > 100


def test_stores_of_the_earlier_version_are_solid_and_say_so_if_materials_were_lost(tmp_path):
    gltf(tmp_path, "a.glb")
    at.build_store(at.load(tmp_path / "a.glb", cutouts=False), tmp_path / "a.antumbra")
    at.build_store(at.procedural("cellar", triangles=2000), tmp_path / "b.antumbra")
    for name, expected in (("a", 1), ("b", 0)):
        path = tmp_path / f"{name}.antumbra"
        assert not any("earlier version" in note for note in at.load(path).notes)
        forged = ForgedStore(path.read_bytes())
        forged.header["version"] = 2
        if name == "a":  # as that version noted
            forged.meta["notes"].append("a: a store keeps the mean colour of each face, without textures and normals")
        path.write_bytes(forged.data)
        assert sum("made all faces solid; build it again" in note for note in at.load(path).notes) == expected


def test_holes_of_a_store_stay(small):
    path, _ = small
    with pytest.raises(at.InputError, match=r"keeps the holes of its scene; build it again with \?cutouts=off"):
        at.load(path, cutouts=False)
    with pytest.raises(at.InputError, match="a store keeps the transmittance of its scene; build it again"):
        at.load(path, transmittance={"leaf": 0.5})


def test_cutouts_that_do_not_fit_in_memory_are_refused(small, monkeypatch):
    monkeypatch.setattr("antumbra.store.store_file.CUTOUT_BYTES", 1 << 28)
    with pytest.raises(at.InputError, match=r"cut: 4096M of memory is not enough for the faces that let light pass"):
        at.load(small[0]).occluded([[0, 1, 0]], [[0, 1, 0]])


def test_cutouts_among_more_faces_than_int32_numbers_are_refused(tmp_path, monkeypatch):
    scene = scene_with_cutouts(90)
    at.build_store(scene, tmp_path / "a.tiles", chunk=64, tile=30)
    path = tmp_path / "a.tiles"
    meta, tiles = manifest_from_json(path.read_bytes(), path.name)
    far = [tile._replace(first=tile.first + 2**31) for tile in tiles[1:]]
    meta = meta._replace(n_triangles=far[-1].first + far[-1].triangles)
    path.write_bytes(manifest_to_json(meta, [tiles[0], *far]))
    with pytest.raises(at.InputError, match=r"a\.tiles: 2147483740 triangles, some of which let light pass; at most"):
        at.load(path)
    for module in ("store_checks", "tiled_store"):
        monkeypatch.setattr(f"antumbra.store.{module}.MAX_TRIANGLES", 80)
    with pytest.raises(at.InputError, match=r"b\.tiles: 92 triangles, some of which let light pass; at most 80 may"):
        at.build_store(scene, tmp_path / "b.tiles", tile=30)
    assert not (tmp_path / "b.tiles").exists()
