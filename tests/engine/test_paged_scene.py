"""The scene that `load` gives for a store."""

import pickle

import numpy as np
import pytest

import antumbra as at
from antumbra.engine.scene import AnyScene, Scene
from bvh_scenes import scattered
from stores import built, soup_scene


@pytest.fixture(scope="module")
def both(tmp_path_factory):
    scene = at.procedural("atrium", triangles=2000)
    return scene, at.load(built(tmp_path_factory.mktemp("paged"), scene).path)


def test_it_is_like_the_scene(both):
    scene, paged = both
    for name in ("name", "up", "n_triangles", "duration", "animated", "notes"):
        assert getattr(paged, name) == getattr(scene, name)
    assert (paged.bounds == scene.bounds).all() and (paged.origin == scene.origin).all()
    assert repr(paged.cameras) == repr(scene.cameras) and repr(paged.lights) == repr(scene.lights)
    assert repr(paged.camera(0, 1.0)) == repr(scene.camera(0)) and repr(paged.light(0)) == repr(scene.light(0))
    assert repr(paged.default_camera()) == repr(scene.default_camera()) and len(paged.view.points) < 200
    assert repr(paged.default_light()) == repr(scene.default_light())
    assert paged.meshes == [] and paged.clamped(3.0) == 0.0
    assert len(paged.store) > 1 and "2000" not in repr(paged.store.path)


@pytest.mark.parametrize(
    "ask",
    [
        lambda scene: scene.colours,
        lambda scene: at.build_store(scene, scene.store.path.with_name("again.antumbra")),
    ],
    ids=["colours", "build"],
)
def test_all_triangles_are_not_to_be_had(both, ask):
    with pytest.raises(at.InputError, match=r"a store cannot be used for this; use the file that it was built from"):
        ask(both[1])


def test_triangles_that_fit_in_memory_are_those_of_the_scene(both):
    scene, paged = both
    triangles, stored = scene.triangles(), paged.triangles()
    edges = triangles.vertices[:, 1:] - triangles.vertices[:, :1]
    with_area = np.cross(edges[:, 0], edges[:, 1]).any(1)
    assert with_area.sum() > 1900
    assert np.array_equal(triangles.vertices[with_area], stored.vertices[with_area])
    assert np.array_equal(triangles.colour[with_area], stored.colour[with_area])
    for faces in (None, np.arange(scene.n_triangles), np.array([1900, 3, 3, 77])):
        corners, expected = paged.data.corners(0.0, faces), scene.data.corners(0.0, faces)
        some = with_area if faces is None else with_area[faces]
        assert some.sum() > 3 and np.array_equal(corners[some], expected[some])
    paged = at.load(paged.store.path, max_memory=1 << 20)
    with pytest.raises(at.InputError, match=r"needs all [\d,]+ triangles at once, .* raise max_memory"):
        paged.triangles()
    assert np.array_equal(paged.data.corners(0.0, np.arange(9)), scene.data.corners(0.0, np.arange(9)))


def test_it_stands_beside_scenes_in_memory(both):
    scene, paged = both
    assert isinstance(scene, AnyScene) and isinstance(paged, AnyScene) and not isinstance(paged, Scene)
    assert {name for name in dir(scene) if name[0] != "_"} - {
        "from_arrays",
        "from_instances",
        "from_mesh",
        "source",
    } <= set(dir(paged))


def test_what_is_not_there(both):
    for ask in (both[1].camera, both[1].light):
        with pytest.raises(at.InputError, match="there is no"):
            ask(5)


def test_up_is_kept(tmp_path):
    store = built(tmp_path, Scene.from_arrays(np.float64(scattered(9)), up="z"))
    assert at.load(store.path).up == "z" == at.load(store.path, up="y").up


def test_a_pickle_opens_the_store_again(tmp_path, monkeypatch):
    scene = soup_scene(np.random.default_rng(1).normal(size=(200, 3, 3)))
    at.build_store(scene, tmp_path / "a.antumbra", chunk=16)
    monkeypatch.chdir(tmp_path)
    paged = at.load("a.antumbra")
    paged.max_memory = 1 << 32
    origins, directions = np.random.default_rng(2).normal(size=(2, 100, 3))
    first = paged.closest_hit(3 * origins, directions)
    data = pickle.dumps(paged)
    assert len(data) < 1 << 13
    monkeypatch.chdir("/")
    again = pickle.loads(data)
    assert again.max_memory == 1 << 32 and repr(again) == repr(paged) and again.data is not paged.data
    second = again.closest_hit(3 * origins, directions)
    assert (first.face >= 0).any() and (first.face < 0).any()
    assert np.array_equal(first.face, second.face) and np.array_equal(first.t, second.t)
    at.build_store(soup_scene(np.random.default_rng(3).normal(size=(200, 3, 3))), tmp_path / "a.antumbra", chunk=16)
    with pytest.raises(at.InputError, match=r"a\.antumbra: was written again after it was pickled; load it again"):
        pickle.loads(data)
    (tmp_path / "a.antumbra").unlink()
    with pytest.raises(at.InputError, match=r"a\.antumbra"):
        pickle.loads(data)


@pytest.mark.parametrize("size", [0, -1, 1.5, "1G", 1 << 61, True])
def test_the_memory_limit_is_checked_where_it_is_set(tmp_path, size):
    at.build_store(soup_scene(np.random.default_rng(1).normal(size=(20, 3, 3))), tmp_path / "a.antumbra")
    scene = at.load(tmp_path / "a.antumbra")
    with pytest.raises(at.InputError, match="max_memory is"):
        scene.max_memory = size
    assert scene.max_memory is None
