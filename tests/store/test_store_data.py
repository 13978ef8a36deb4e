"""The scene of a store has the objects of its sources."""

import numpy as np
import pytest

import antumbra as at
from antumbra import examples
from antumbra.cli import main
from antumbra.engine.sources.paged_source import Paged, SharedStore
from antumbra.formats import face_ranges
from antumbra.store import read_units
from antumbra.store.store_format import StoredObjects
from cutout_scenes import MASKS, pane, rays, with_masks
from gltf_files import Gltf


def named(scene):
    return [(each.name, each.type, each.parent) for each in scene.objects]


@pytest.mark.filterwarnings("ignore::UserWarning")
def test_a_store_of_several_scenes_has_their_objects(tmp_path):
    scenes = [at.Scene.from_arrays(np.random.default_rng(k).normal(size=(9, 3, 3)), name=f"soup {k}") for k in (1, 2)]
    scenes.insert(1, at.Scene.of_data(examples.mill().data))
    at.build_store(scenes, tmp_path / "a.antumbra", chunk=99)
    store = at.load(tmp_path / "a.antumbra")
    assert named(store) == [each for scene in scenes for each in named(scene)] and len(store.objects) > 4
    firsts = np.cumsum([0, *(len(scene.objects) for scene in scenes)])
    owners = [scene.object_of_face + first for scene, first in zip(scenes, firsts)]
    assert store.object_of_face.tolist() == np.concatenate(owners).tolist()


@pytest.mark.filterwarnings("ignore::UserWarning")
def test_tiles_have_the_objects_of_the_whole(tmp_path):
    village = examples.village()
    at.build_store(village, tmp_path / "a.tiles", chunk=99, tile=1000)
    store = at.load(tmp_path / "a.tiles")
    assert named(store) == named(village) and len(store.store.tiles) > 2
    assert store.object_of_face.tolist() == village.object_of_face.tolist()
    assert at.load(tmp_path / store.store.tiles[1].file).object_of_face.max() == 0


@pytest.mark.filterwarnings("ignore::UserWarning")
def test_too_many_objects_become_one_and_a_note_says_so(tmp_path, monkeypatch):
    monkeypatch.setattr(read_units, "MAX_RUNS", 70)
    village = examples.village()
    at.build_store(village, tmp_path / "a.antumbra")
    store = at.load(tmp_path / "a.antumbra")
    assert len(village.objects) == 71 and len(store.objects) == 1 and store.object_of_face.max() == 0
    assert "71 objects, or the ranges of their faces, are too many" in store.notes[-1]


def test_tiles_of_one_object_keep_it_however_many_triangles_there_are(tmp_path, monkeypatch):
    monkeypatch.setattr(read_units, "MAX_TRIANGLES", 100)
    heights = np.random.default_rng(1).uniform(0.0, 9.0, (20, 30))
    terrain = at.from_raster((heights, (2.0, 0.0, 80_000.0, 0.0, -2.0, 450_000.0)))
    at.build_store(terrain, tmp_path / "a.tiles", chunk=99, tile=500)
    store = at.load(tmp_path / "a.tiles")
    assert named(store) == named(terrain) and len(store.store.tiles) > 1 and store.data.of_heights


@pytest.mark.parametrize(
    "change, fault",
    [
        ({}, ""),
        ({"names": ["a", 3]}, "no proper names"),
        ({"types": ["a"]}, "no proper names"),
        ({"faces": [3, 0, 4]}, "no proper faces"),
        ({"of": [0, 1, 2]}, "no proper faces"),
        ({"of": [0, 1]}, "no proper faces"),
        ({"faces": [3, 3, 5]}, "do not have all faces"),
    ],
)
def test_objects_of_a_file_are_checked(change, fault):
    objects = StoredObjects(["a", "b"], ["", "Building"], ["", ""], [3, 3, 4], [0, 1, 0])._replace(**change)
    found = objects.fault(10)
    assert found.endswith(fault) and bool(found) == bool(fault)


@pytest.mark.filterwarnings("ignore::UserWarning")
def test_units_that_go_on_with_a_scene_have_its_objects(tmp_path, monkeypatch):
    monkeypatch.setattr(face_ranges, "FACES_PER_PIECE", 50)
    monkeypatch.setattr(face_ranges, "PIECES_PER_SPAN", 1)
    rng, made = np.random.default_rng(0), Gltf()
    primitive = made.primitive(rng.random((9, 3)).astype(np.float32), np.arange(9, dtype="<u2").reshape(3, 3))
    made.node(mesh=made.mesh(primitive), name="roof")
    rows = np.zeros(120, [("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("end", "<u2")])
    rows["corners"] = rng.random((120, 3, 3))
    (tmp_path / "b.stl").write_bytes(bytes(80) + np.uint32(120).tobytes() + rows.tobytes())
    files = [str(made.write(tmp_path)), str(tmp_path / "b.stl")]
    main(["build", *files, "-o", str(tmp_path / "two.antumbra"), "--quiet"])
    store = at.load(tmp_path / "two.antumbra")
    assert [each.name for each in store.objects] == ["roof", "b"]
    assert np.bincount(store.object_of_face).tolist() == [3, 120]


@pytest.mark.filterwarnings("ignore::UserWarning")
def test_a_single_object_keeps_its_name_and_tiles_of_terrain_their_type(tmp_path):
    hills = examples.hills()
    at.build_store(hills, tmp_path / "a.tiles", tile=hills.n_triangles // 3)
    tiles = at.load(tmp_path / "a.tiles")
    assert len(tiles.store.tiles) > 2 and [each.type for each in tiles.objects] == ["TINRelief"]
    assert tiles.object_of_face.strides == (0,)
    with pytest.raises(at.InputError, match="has no buildings"):
        at.view_factors(tiles, per="building", samples=64)


def test_sensors_on_faces_of_a_store_are_those_of_the_scene_also_where_all_light_passes(tmp_path):
    scene = with_masks(60, [pane(0.6), MASKS[0], pane(1.0)])
    at.build_store(scene, tmp_path / "a.antumbra", chunk=16)
    store = at.load(tmp_path / "a.antumbra")
    solid, cut = scene.cutouts.solid, scene.cutouts.faces
    assert scene.n_triangles - len(solid) - len(cut) > 9
    for sensors in at.face_sensors, at.vertex_sensors, lambda each: at.grid_sensors(each, 1.0):
        found, wanted = sensors(store), sensors(scene)
        assert len(found) == len(wanted) > 60
        np.testing.assert_allclose(found.points, wanted.points, atol=1e-5)  # float32 of the frame


def test_cut_outs_are_in_memory_before_it_is_measured(tmp_path, monkeypatch):
    at.build_store(with_masks(60, [pane(0.6), MASKS[0]]), tmp_path / "a.antumbra", chunk=16)
    budget, find, order = Paged.budget, SharedStore._find_cutouts, []
    monkeypatch.setattr(Paged, "budget", lambda *given: order.append("measure") or budget(*given))
    monkeypatch.setattr(SharedStore, "_find_cutouts", lambda *given: order.append("read") or find(*given))
    at.load(tmp_path / "a.antumbra").occluded(*rays(99))
    assert order.index("read") < order.index("measure")
