"""A store with plants in memory gives the results of the scene in memory with the same plants."""

import pickle

import numpy as np
import pytest

import antumbra as at
from antumbra.store import extended_store
from baked_files import box, grid
from cutout_scenes import scene_with_cutouts

gpd = pytest.importorskip("geopandas", reason="vegetation needs antumbra[gis]: NOT checked")
shapely = pytest.importorskip("shapely")

MONTHS = [0.7, 0.7, 0.6, 0.4, 0.2, 0.1, 0.1, 0.1, 0.2, 0.5, 0.6, 0.7]


def plants(places=((2.0, 2.0), (-2.5, 1.0), (1.5, -2.5)), **columns):
    table = {"height": [2.0] * len(places), "radius": [0.8] * len(places)} | columns
    return gpd.GeoDataFrame(table, geometry=[shapely.Point(*place) for place in places])


def town(up="z"):
    """A ground with a tower that is higher than all plants, so that these are within the bounds."""
    (ground, faces), (tower, walls) = grid(np.arange(-5.0, 6.0), np.arange(-5.0, 6.0)), box((-1, 0, -1), (1, 6, 1))
    vertices = np.concatenate([ground, tower]).astype(np.float64) * 1.1  # of float64, as the plants are
    if up == "z":
        vertices = vertices[:, [0, 2, 1]] * (1, -1, 1)
    return at.Scene.from_arrays(vertices, np.concatenate([faces, walls + len(ground)]), up=up, unit="ft")


@pytest.fixture(params=["opaque", "leaves", "months", "clear", "no trunks", "y up"])
def pair(request, tmp_path):
    """The scene in memory, and the store, with the same plants."""
    options = {
        "leaves": {"transmittance": 0.3},
        "months": {"transmittance": MONTHS},
        "clear": {"transmittance": "share"},
        "no trunks": {"trunk_radius": 0.0},
    }.get(request.param, {})
    scene, trees = town("y" if request.param == "y up" else "z"), plants(share=[1.0, 0.5, 0.0])
    at.build_store(scene, tmp_path / "a.antumbra", chunk=16)
    return tuple(at.from_trees(trees, scene=each, **options) for each in (scene, at.load(tmp_path / "a.antumbra")))


def rays(scene, n=4000):
    rng = np.random.default_rng(0)
    low, high = scene.bounds
    origins = rng.uniform(low - 1, high + 1, (n, 3))
    return origins, rng.uniform(low, high, (n, 3)) - origins


def test_the_faces_are_those_of_the_scene_in_memory(pair):
    scene, store = pair
    assert store.n_triangles == scene.n_triangles and isinstance(store, at.PagedScene)
    for name in ("bounds", "origin", "object_of_face"):
        np.testing.assert_array_equal(getattr(store, name), getattr(scene, name), err_msg=name)
    assert [each.name for each in store.objects] == [each.name for each in scene.objects]
    assert (store.unit, store.crs, store.up) == (scene.unit, scene.crs, scene.up)
    one, other = scene.triangles(), store.triangles()
    for name in ("vertices", "colour"):
        np.testing.assert_array_equal(getattr(one, name), getattr(other, name), err_msg=name)
    faces = np.array([scene.n_triangles - 1, 0, scene.n_triangles - 40, 7])
    np.testing.assert_array_equal(store.data.corners(0.0, faces)[::2], scene.data.corners(0.0, faces)[::2])
    for step in (1, 3, 7):
        np.testing.assert_array_equal(store.data.every(step, 0.0), scene.data.every(step, 0.0))


@pytest.mark.parametrize("cull", [None, "front", "back"])
def test_rays_have_the_same_hits(pair, cull):
    scene = pair[0]
    origins, directions = rays(scene)
    one, other = (each.closest_hit(origins, directions, cull_faces=cull) for each in pair)
    for name in ("t", "face", "u", "v"):
        np.testing.assert_array_equal(getattr(one, name), getattr(other, name), err_msg=name)
    met = one.face >= scene.n_triangles - 100
    assert met.any() and (one.face[one.face >= 0] < 200).any()
    again = [each.closest_hit(origins, directions, skip_face=one.face, cull_faces=cull).face for each in pair]
    np.testing.assert_array_equal(*again)
    np.testing.assert_array_equal(*(each.occluded(origins, directions, cull_faces=cull) for each in pair))
    np.testing.assert_array_equal(*(each.count_hits(origins, directions) for each in pair))
    lists = [each.all_hits(origins, directions) for each in pair]
    np.testing.assert_array_equal(lists[0].face, lists[1].face)
    np.testing.assert_array_equal(lists[0].t, lists[1].t)


def test_shadows_and_pictures_are_the_same(pair):
    scene = pair[0]
    points = np.random.default_rng(1).uniform(scene.bounds[0], scene.bounds[1], (300, 3))
    for light in (at.DirectionalLight((0.3, -0.5, -1)), at.PointLight(scene.bounds[1] + 1)):
        one, other = (at.visibility(each, points, light, spp=4) for each in pair)
        np.testing.assert_array_equal(one.bits, other.bits)
        np.testing.assert_array_equal(one.fraction, other.fraction)
    options = {"spp": 4, "adaptive": 16, "bounce": 1, "ground": True}
    camera = scene.default_camera(48, 36)
    one, other = (at.render(each, camera, each.default_lights(), **options) for each in pair)
    np.testing.assert_array_equal(one.image, other.image)
    np.testing.assert_array_equal(one.ground.share, other.ground.share)


def test_plants_join_the_cut_outs_and_looks_of_a_store(tmp_path):
    scene = scene_with_cutouts()
    at.build_store(scene, tmp_path / "a.antumbra", chunk=16)
    low, high = scene.bounds
    place = ((low + high) / 2)[[0, 2]] * (1, -1)
    height = 0.9 * (high - low)[1]
    trees = plants([tuple(place)], height=[height], radius=[height / 4])
    options = {"transmittance": 0.4, "base": float(low[1]), "unit": scene.unit.name}
    pair = [at.from_trees(trees, scene=each, **options) for each in (scene, at.load(tmp_path / "a.antumbra"))]
    origins, directions = rays(pair[0])
    np.testing.assert_array_equal(*(each.occluded(origins, directions) for each in pair))
    points = np.random.default_rng(1).uniform(low, high, (300, 3))
    one, other = (at.visibility(each, points, at.PointLight(high + 1), spp=4).fraction for each in pair)
    np.testing.assert_array_equal(one, other)
    assert ((one > 0.0) & (one < 1.0)).any()
    camera = scene.default_camera(40, 30)
    np.testing.assert_array_equal(*(at.render(each, camera, at.PointLight(high + 1)).image for each in pair))


def test_plants_higher_than_the_store_keep_its_frame(tmp_path):
    """The scene in memory has another origin, so answers differ by rounding at most."""
    scene, trees = town(), plants(height=[20.0, 30.0, 25.0])
    at.build_store(scene, tmp_path / "a.antumbra", chunk=16)
    stored = at.load(tmp_path / "a.antumbra")
    memory, store = (at.from_trees(trees, scene=each) for each in (scene, stored))
    np.testing.assert_array_equal(store.bounds, memory.bounds)
    np.testing.assert_array_equal(store.origin, stored.origin)
    origins, directions = rays(memory)
    one, other = (each.closest_hit(origins, directions) for each in (memory, store))
    same = one.face == other.face
    assert same.mean() > 0.999
    np.testing.assert_allclose(one.t[same], other.t[same], rtol=1e-4)


def test_it_survives_pickling_and_its_digest_has_the_plants(tmp_path):
    at.build_store(town(), tmp_path / "a.antumbra", chunk=16)
    stored = at.load(tmp_path / "a.antumbra")
    one, other = (at.from_trees(plants(), scene=stored, transmittance=share) for share in (0.3, 0.4))
    again = pickle.loads(pickle.dumps(one))
    origins, directions = rays(one)
    np.testing.assert_array_equal(
        again.closest_hit(origins, directions).face, one.closest_hit(origins, directions).face
    )
    digest = lambda scene: b"".join(bytes(part) for part in scene.data.content(0.0))
    assert digest(again) == digest(one) != digest(other)


def test_what_int32_cannot_number_is_refused(tmp_path, monkeypatch):
    at.build_store(town(), tmp_path / "a.antumbra", chunk=16)
    stored = at.load(tmp_path / "a.antumbra")
    monkeypatch.setattr("antumbra.store.store_checks.MAX_TRIANGLES", stored.n_triangles + 10)
    with pytest.raises(at.InputError, match=r"triangles, some of which let light pass; at most \d+ may"):
        at.from_trees(plants(), scene=stored)
    with pytest.raises(at.InputError, match="a store cannot be used for this"):
        extended_store.ExtendedStoreData.source.fget(stored.data)


def test_a_limit_that_is_raised_later_counts_for_the_store_below(tmp_path):
    at.build_store(town(), tmp_path / "a.antumbra", chunk=16)
    below = at.load(tmp_path / "a.antumbra")
    joined = at.from_trees(plants(), scene=below)
    below.max_memory = 1
    assert len(joined.data.corners()) == joined.n_triangles
    joined.max_memory = 1
    with pytest.raises(at.InputError, match="raise max_memory"):
        joined.data.corners()
    joined.max_memory = None
    copied = pickle.loads(pickle.dumps(joined))
    assert len(copied.data.corners()) == len(joined.data.corners()) == joined.n_triangles
