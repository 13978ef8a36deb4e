"""Triangles of a store in the order of their faces."""

import errno

import numpy as np
import pytest

import antumbra as at
from antumbra.scene.alpha_masks import cutouts_of
from antumbra.store import face_order
from antumbra.store.face_order import FaceCorners, every_triangle, gather_triangles
from cutout_scenes import MASKS, scene_with_cutouts


@pytest.fixture(scope="module", params=[False, True], ids=["solid faces", "cut-outs among them"])
def both(tmp_path_factory, request):
    """The corners of a soup with a face without area, in its frame, and its store."""
    random = np.random.default_rng(4)
    corners = random.integers(-99, 99, (700, 3, 3)).astype(np.float32)
    corners[300] = corners[300, 0]
    scene, path = at.Scene.from_arrays(corners), tmp_path_factory.mktemp("order") / "a.antumbra"
    if request.param:
        uv, mask = random.uniform(-1.5, 2.5, (700, 3, 2)).astype(np.float32), random.integers(-4, len(MASKS), 700)
        mask[[0, 300]] = 0, -1  # the first face, of which a chunk has a point, is a cut-out
        scene.data.cutouts = cutouts_of(uv, mask.clip(-1).astype(np.int32), MASKS)
    at.build_store(scene, path, chunk=50)
    store = at.load(path).store
    expected = scene.triangles().vertices.copy()
    expected[300] = store.meta.box[0]  # in no chunk
    if request.param:
        solid, cut = scene.cutouts.solid, scene.cutouts.faces
        clear = np.setdiff1d(np.arange(700), np.concatenate([solid, cut]))
        assert min(len(solid), len(cut)) > 99 and len(clear) > 9 and cut[0] == 0
    return expected, store


def test_all_triangles_are_gathered_in_order(both):
    corners, store = both
    found = gather_triangles(store, store.cutouts())
    assert len(store) > 9 and np.array_equal(found.vertices, corners) and found.colour.shape == (700, 3)


def test_every_step_th_triangle_is_one_of_them(both):
    corners, store = both
    for step in (1, 3, 701):
        assert np.array_equal(every_triangle(store, store.cutouts(), step), corners[::step])


def test_any_faces_are_read_from_buckets(both, monkeypatch, tmp_path):
    corners, store = both
    monkeypatch.setattr(face_order, "_BUCKET", 64)
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    faces = FaceCorners(store, store.cutouts())
    for some in (np.arange(700), np.array([699, 0, 300, 64, 63, 0]), np.empty(0, int)):
        assert np.array_equal(faces.of(some), corners[some])
    assert list(tmp_path.rglob("faces"))
    del faces
    assert not list(tmp_path.rglob("faces"))


def test_a_full_disk_is_named_with_the_cure(both, monkeypatch, tmp_path):
    def full(*_):
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    monkeypatch.setattr(FaceCorners, "_add", full)
    with pytest.raises(at.InputError, match=r"a\.antumbra: its faces take .* GB in .*No space left.*set TMPDIR"):
        FaceCorners(both[1], None)
    assert not list(tmp_path.rglob("faces"))


def test_triangles_of_a_store_have_the_cut_outs_of_the_scene(tmp_path):
    scene = scene_with_cutouts()
    at.build_store(scene, tmp_path / "a.antumbra", chunk=16)
    found, wanted = at.load(tmp_path / "a.antumbra").triangles(), scene.triangles()
    assert np.array_equal(found.cutouts.faces, wanted.cutouts.faces)
    assert np.array_equal(found.solid, wanted.cutouts.solid)
    met = np.concatenate([wanted.cutouts.solid, wanted.cutouts.faces])
    assert np.array_equal(found.vertices[met], wanted.vertices[met])


def test_the_first_face_of_a_file_is_one_face_of_its_bucket(tmp_path, monkeypatch):
    corners = np.random.default_rng(4).integers(-99, 99, (100, 3, 3)).astype(np.float32)
    scene = at.Scene.from_arrays(corners)
    uv, mask = np.tile(np.float32([[0, 0], [3, 0], [0, 3]]), (100, 1, 1)), np.full(100, -1, np.int32)
    mask[0] = 0  # a chunk has a point for this cut-out
    scene.data.cutouts = cutouts_of(uv, mask, MASKS)
    at.build_store(scene, tmp_path / "a.antumbra")
    monkeypatch.setattr(face_order, "_BUCKET", 64)
    store = at.load(tmp_path / "a.antumbra").store
    found = FaceCorners(store, store.cutouts()).of(np.arange(100))
    assert len(scene.cutouts.faces) == 1 and np.array_equal(found, scene.triangles().vertices)
