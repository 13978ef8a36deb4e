"""Arrays that their owner changes: scenes and lights have copies, and queries under way stay within memory."""

import threading
from contextlib import contextmanager
from types import SimpleNamespace

import numpy as np
import pytest

import antumbra as at
from antumbra.engine.store_building import build_store
from antumbra.query.ray_list import RayArrays

VERTICES = np.array([[0, 0, 0], [4, 0, 0], [0, 0, 4], [4, 0, 4]], np.float64)
FACES = np.array([[0, 1, 2], [1, 3, 2]])
DOWN = np.array([0, -1, 0], np.float32)


def arguments(dtype=np.float32, kind=np.int32):
    """Arrays for `Scene.from_arrays` whose dtypes need no conversion."""
    rng = np.random.default_rng(0)
    looks = {"uv": rng.random((4, 2), np.float32), "vertex_colours": rng.random((4, 3), np.float32)}
    more = {"texture": rng.integers(0, 256, (4, 4, 4)).astype(np.uint8), "normals": np.ones((4, 3), np.float32)}
    return {"vertices": VERTICES.astype(dtype), "faces": FACES.astype(kind), **looks, **more}


def spoil(arrays):
    """Overwrite arrays with what would end a kernel that trusts it."""
    for array in arrays:
        array[:] = np.nan if array.dtype.kind == "f" else 255 if array.dtype == np.uint8 else 2**30


def rays(n=50):
    at_ = np.random.default_rng(1).uniform(-1, 5, (n, 2)).astype(np.float32)
    return np.stack([at_[:, 0], np.ones(n, np.float32), at_[:, 1]], 1)


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
@pytest.mark.parametrize("kind", [np.int32, np.uint32, np.int64])
def test_scenes_of_arrays_are_copies(dtype, kind):
    given, kept = arguments(dtype, kind), arguments(dtype, kind)
    scene, same = at.Scene.from_arrays(**given), at.Scene.from_arrays(**kept)
    spoil(given.values())  # before the first query
    hit, expected = scene.closest_hit(rays(), DOWN), same.closest_hit(rays(), DOWN)
    assert np.array_equal(hit.face, expected.face) and {-1, 0, 1} == set(hit.face.tolist())
    for name in "uv", "colours", "normals":
        assert np.array_equal(getattr(scene.appearance, name), getattr(same.appearance, name)), name
    (texture,), (other,) = scene.appearance.textures, same.appearance.textures
    assert np.array_equal(texture.pixels, other.pixels) and np.array_equal(scene.colours, same.colours)


@pytest.mark.parametrize("colours", [np.ones(3, np.float32), np.full((2, 3), 0.5, np.float32)])
def test_soups_and_their_colours_are_copies(colours):
    soup, kept = VERTICES[FACES].astype(np.float32), colours.copy()
    scene = at.Scene.from_arrays(soup, colours=colours)
    spoil([soup, colours])
    assert scene.occluded(rays(), DOWN).any() and np.array_equal(scene.colours, np.broadcast_to(kept, (2, 3)))


def test_meshes_of_other_libraries_are_copies():
    mesh = SimpleNamespace(  # Open3D hands out views of its own memory
        vertices=VERTICES.copy(), triangles=FACES.astype(np.int32), has_vertex_colors=lambda: False
    )
    scene = at.Scene.from_mesh(mesh)
    spoil([mesh.vertices, mesh.triangles])
    assert scene.occluded(rays(), DOWN).any()


def test_lights_and_cameras_are_copies():
    places, colours, powers = np.ones((5, 3)), np.ones((5, 3)), np.ones(5)
    lists = at.PointLights(places, intensities=powers, colours=colours), at.DirectionalLights(-places)
    three = [np.array([0.0, -1.0, 0.0]) for _ in range(8)]
    made = [
        at.DirectionalLight(three[0]), at.PointLight(three[1]), at.SphereLight(three[2], 1.0),
        at.DiskLight(three[3], three[4], 1.0), at.Camera(three[5], [0, 0, 0], [0, 0, 1]),
        at.Camera([0, 0, 0], three[6], [0, 0, 1]), at.Camera([0, 0, 0], [1, 0, 0], three[7]),
    ]  # fmt: skip
    before = [*map(repr, made), *map(repr, lists)], lists[0].points.copy(), lists[0].colours.copy()
    spoil([places, colours, powers, *three])
    assert [*map(repr, made), *map(repr, lists)] == before[0] and "nan" not in repr(made)
    assert np.array_equal(lists[0].points, before[1]) and np.array_equal(lists[0].colours, before[2])


@contextmanager
def editing(array, states):
    """A thread writes one state after the other into an array."""
    done = threading.Event()

    def edit():
        while not done.is_set():
            for state in states:
                np.copyto(array, state)

    thread = threading.Thread(target=edit, daemon=True)
    thread.start()
    try:
        yield
    finally:
        done.set()
        thread.join()


@pytest.mark.parametrize("which", ["origins", "directions", "tmax", "skip"])
@pytest.mark.parametrize("closest", [False, True])
def test_rays_that_change_during_a_query_get_an_old_or_a_new_answer(which, closest):
    scene, n = at.Scene.from_arrays(VERTICES, FACES), 4_000
    rng = np.random.default_rng(2)
    old = {"origins": np.float32([1, 1, 1]) + rng.random((n, 3), np.float32), "directions": np.tile(DOWN, (n, 1)),
           "tmax": np.full(n, 9.0, np.float32), "skip": np.full(n, -1, np.int32)}  # fmt: skip
    new = {"origins": old["origins"] * np.float32([1, -1, 1]), "directions": -old["directions"],
           "tmax": np.full(n, 0.5, np.float32), "skip": rng.integers(0, 2, n).astype(np.int32)}  # fmt: skip
    given = {name: array.copy() for name, array in old.items()}

    def ask(arrays):
        query = scene.closest_hit if closest else scene.occluded
        found = query(arrays["origins"], arrays["directions"], tmax=arrays["tmax"], skip_face=arrays["skip"])
        return found.face if closest else found

    first, second = ask(old), ask({**old, which: new[which]})
    assert (first != second).mean() > 0.3
    with editing(given[which], [new[which], old[which]]):  # each differs in one number of a ray
        for _ in range(8):
            found = ask(given)
            assert ((found == first) | (found == second)).all()


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_rays_that_become_bad_during_a_query_are_an_error_or_a_miss(bad):
    scene, n = at.Scene.from_arrays(VERTICES, FACES), 4_000
    origins = np.float32([1, 1, 1]) + np.random.default_rng(3).random((n, 3), np.float32)
    given, errors = origins.copy(), 0
    with editing(given, [np.full_like(origins, bad), origins]):
        for _ in range(8):
            try:
                assert scene.closest_hit(given, DOWN).face.max() < 2
                at.visibility(scene, given, at.PointLight((1.0, -3.0, 1.0)))
            except at.InputError as error:
                assert "\n" not in str(error)
                errors += 1
    assert scene.closest_hit(origins, DOWN).face.max() >= 0  # it answers as before


@pytest.mark.parametrize("stored", [False, True])
def test_rays_that_are_right_again_are_named(tmp_path, monkeypatch, stored):
    """Kernels stop at the first bad ray, so what they wrote until then is no answer."""
    scene = at.Scene.from_arrays(VERTICES, FACES)
    if stored:
        build_store([scene], tmp_path / "a.antumbra")
        scene = at.load(tmp_path / "a.antumbra")
    bad = np.where(np.arange(50)[:, None] == 30, np.nan, rays()).astype(np.float32)
    monkeypatch.setattr(RayArrays, "check", lambda self: None)  # as if they were right when it looks
    assert scene.occluded(rays(), DOWN) is not None
    with pytest.raises(at.InputError, match="changed during tracing; pass copies"):
        scene.occluded(bad, DOWN)
    assert np.flatnonzero(np.isnan(scene.closest_hit(bad, DOWN).t)).tolist() == [30]


def test_points_that_change_during_a_query():
    scene = at.Scene.from_arrays(VERTICES, FACES)
    old = 1.0 + np.random.default_rng(4).random((2_000, 3))
    new, given, light = old * [1, -1, 1], old.copy(), at.PointLight((1.5, 5.0, 1.5))
    first, second = (at.visibility(scene, points, light).seen for points in (old, new))
    assert first.all() and not second.any()
    with editing(given, [new, old]):
        for _ in range(6):
            assert at.visibility(scene, given, light).bits.shape == (2_000, 1)
