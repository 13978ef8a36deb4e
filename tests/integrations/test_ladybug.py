"""`intersection_matrix`: Ladybug's conventions, checked where it is installed, and exact answers."""

import inspect
import sys
from importlib import reload
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import antumbra as at
import city_files
import oracle
from antumbra.integrations.ladybug import intersection_matrix, sky_intersection_matrix
from receivers import receivers_of
from strength import examples

UP = np.array([0.0, 0.0, 1.0])


class Vector(tuple):
    """Like Vector3D and Point3D: three numbers, but no array."""


class Mesh3D:
    """Like Ladybug's: vertices, and faces of three or four corners."""

    def __init__(self, vertices, faces):
        self.vertices, self.faces = [Vector(each) for each in vertices], [tuple(each) for each in faces]


class Face3D:
    """Like Ladybug's: a polygon, with the triangles of which it consists."""

    def __init__(self, vertices, faces, has_holes=False):
        self.vertices, self.has_holes = [Vector(each) for each in vertices], has_holes
        self.triangulated_mesh3d = Mesh3D(vertices, faces)


def boxes(seed=0, n=12):
    """Boxes as one Mesh3D of quads each; and their triangles."""
    rng = np.random.default_rng(seed)
    placed = [city_files.CUBE * rng.uniform(1, 4, 3) + (*rng.uniform(-8, 8, 2), 0) for _ in range(n)]
    meshes = [Mesh3D(each.tolist(), city_files.CUBE_FACES) for each in placed]
    faces = np.array([t for a, b, c, d in city_files.CUBE_FACES for t in ((a, b, c), (a, c, d))])
    return meshes, np.concatenate([each[faces] for each in placed])


def sensors(n, seed=1):
    rng = np.random.default_rng(seed)
    normals = rng.normal(size=(n, 3))
    normals[:, 2] = np.abs(normals[:, 2])
    return rng.uniform((-9, -9, 0.1), (9, 9, 5), (n, 3)), normals / np.linalg.norm(normals, axis=1, keepdims=True)


def directions(k, seed=2):
    return np.random.default_rng(seed).normal(size=(k, 3))


@pytest.mark.parametrize("listed", [False, True], ids=["arrays", "vectors"])
def test_the_matrix_equals_brute_force(listed):
    meshes, soup = boxes()
    (places, normals), vectors = sensors(40), directions(60)
    given = [[Vector(row) for row in each.tolist()] if listed else each for each in (vectors, places, normals)]
    seen = intersection_matrix(*given, meshes)
    assert seen.shape == (40, 60) and seen.dtype == bool and 0.1 < seen.mean() < 0.9
    scene = at.Scene.from_arrays(soup, up="z")
    origins = receivers_of(scene, places, normals)[0]
    towards = vectors / np.linalg.norm(vectors, axis=1, keepdims=True)
    above = normals @ towards.T > 1e-6
    i, j = np.nonzero(above)
    ends = (origins[i] + 1000.0 * towards[j]).astype(np.float32)
    assert (seen[i, j] == ~oracle.occluded(scene.triangles().vertices, origins[i], ends=ends)).all()
    assert not seen[normals @ towards.T < -1e-6].any()


def test_numbers_are_cosines():
    meshes, _ = boxes()
    (places, normals), vectors = sensors(30), directions(20)
    seen = intersection_matrix(vectors, places, normals, meshes)
    cosines = intersection_matrix(3.0 * vectors, places, normals, meshes, numericalize=True)
    towards = vectors / np.linalg.norm(vectors, axis=1, keepdims=True)
    np.testing.assert_allclose(cosines, np.where(seen, normals @ towards.T, 0.0), atol=1e-15)
    assert ((cosines > 0) == seen).all() and seen.any() and not seen.all()


def test_more_vectors_than_a_query_takes():
    meshes, _ = boxes()
    places, normals = sensors(5)
    vectors = directions(1500)
    seen = intersection_matrix(vectors, places, normals, meshes)
    pick = np.random.default_rng(0).permutation(1500)[:64]
    assert (intersection_matrix(vectors[pick], places, normals, meshes) == seen[:, pick]).all() and 0 < seen.mean() < 1


def test_an_offset_lifts_the_points():
    lid = Mesh3D([(-9, -9, 1), (9, -9, 1), (9, 9, 1), (-9, 9, 1)], [(0, 1, 2, 3)])
    below = intersection_matrix([UP], [(0, 0, 0)], [UP], [lid])
    above = intersection_matrix([UP], [(0, 0, 0)], [2 * UP], [lid], offset_distance=1.5)
    assert (below.tolist(), above.tolist()) == ([[False]], [[True]])


def test_points_on_geometry_see_past_it():
    floor = Mesh3D([(-9, -9, 1), (9, -9, 1), (9, 9, 1), (-9, 9, 1)], [(0, 1, 2, 3)])
    assert intersection_matrix([UP, -UP, (1, 0, 0)], [(0.3, 0.7, 1)], [UP], [floor]).tolist() == [[True, False, False]]


def test_holes_are_open():
    corners = [(-2, -2, 1), (2, -2, 1), (2, 2, 1), (-2, 2, 1), (-1, -1, 1), (1, -1, 1), (1, 1, 1), (-1, 1, 1)]
    ring = [(0, 1, 5, 4), (1, 2, 6, 5), (2, 3, 7, 6), (3, 0, 4, 7)]
    frame = Face3D(corners, ring, has_holes=True)
    assert intersection_matrix([UP], [(0, 0, 0), (1.5, 0, 0)], [UP, UP], [frame]).tolist() == [[True], [False]]
    triangle = Face3D([(-2, -2, 1), (2, -2, 1), (0, 4, 1)], [(0, 1, 2)])
    assert intersection_matrix([UP], [(0, 0, 0), (3, 0, 0)], [UP, UP], [triangle]).tolist() == [[False], [True]]


@examples(20)
@given(st.integers(0, 3), st.integers(0, 1000))
def test_concave_quads_are_split_within(turn, seed):
    dart = np.roll(np.array([(0, 0, 0), (4, -4, 0), (1, 0, 0), (4, 4, 0)], float), turn, axis=0)  # notch at (1, 0)
    mesh = Mesh3D((dart + (0, 0, 1)).tolist(), [(0, 1, 2, 3)])
    x, y = np.random.default_rng(seed).uniform((0, -4), (4, 4), (20, 2)).T
    inside = (np.abs(y) < x) & (np.abs(y) > (x - 1) * 4 / 3)
    seen = intersection_matrix([UP], np.stack([x, y, 0 * x], 1), [UP] * 20, [mesh])
    assert (seen[:, 0] == ~inside).all()


def test_without_geometry_everything_above_is_seen():
    seen = intersection_matrix(directions(50), np.zeros((1, 3)), [UP], [])
    assert (seen[0] == (directions(50)[:, 2] > 0)).all()
    assert intersection_matrix(np.empty((0, 3)), np.zeros((1, 3)), [UP], []).shape == (1, 0)
    assert intersection_matrix([UP], [], [], []).shape == (0, 1)


class Dome(Vector):
    """A vector of a sky dome, like Vector3D."""

    def rotate_xy(self, angle):
        x, y, z = self
        return Dome((np.cos(angle) * x - np.sin(angle) * y, np.sin(angle) * x + np.cos(angle) * y, z))


@pytest.mark.parametrize("dense", [False, True])
@pytest.mark.parametrize("north", [0, 30])
def test_patches_of_a_sky(monkeypatch, north, dense):
    rows = [directions(7), directions(11)]
    domes = [[Dome(row) for row in each.tolist()] for each in rows]
    sphere = SimpleNamespace(tregenza_dome_vectors=domes[0], reinhart_dome_vectors=domes[1])
    monkeypatch.setitem(sys.modules, "ladybug", SimpleNamespace())
    monkeypatch.setitem(sys.modules, "ladybug.viewsphere", SimpleNamespace(view_sphere=sphere))
    meshes, _ = boxes()
    places, normals = sensors(30)
    sky = SimpleNamespace(north=north, high_density=dense)
    found = sky_intersection_matrix(sky, places, normals, meshes, numericalize=True)
    turn = np.radians(north)
    turned = rows[dense] @ [[np.cos(turn), np.sin(turn), 0], [-np.sin(turn), np.cos(turn), 0], [0, 0, 1]]
    both = np.concatenate([turned, -turned])
    expected = intersection_matrix(both, places, normals, meshes, numericalize=True)
    assert found.shape == (30, 2 * len(turned)) and 0 < (found > 0).mean() < 1
    np.testing.assert_allclose(found, expected, atol=1e-12)


def test_a_sky_needs_ladybug(monkeypatch):
    monkeypatch.setitem(sys.modules, "ladybug", None)
    with pytest.raises(at.InputError, match="a sky matrix needs ladybug: pip install ladybug-core"):
        sky_intersection_matrix(SimpleNamespace(north=0, high_density=False), np.zeros((1, 3)), [UP], [])


@pytest.mark.parametrize(
    "changes, message",
    [
        ({"vectors": [(0, 0, 0)]}, "vector 0 is zero"),
        ({"vectors": 3}, "vectors are 3"),
        ({"normals": []}, "1 point and 0 normals"),
        ({"normals": [(np.nan, 0, 0)]}, "normals hold NaN"),
        ({"context_geometry": [3]}, "context_geometry holds a int"),
        ({"context_geometry": None}, "give a list of Face3D and Mesh3D"),
        ({"context_geometry": [Mesh3D([(0, 0, 0)] * 5, [(0, 1, 2, 3, 4)])]}, "holds a Mesh3D of polygons"),
        ({"offset_distance": "far"}, "offset_distance is 'far'"),
        ({"numericalize": 2}, "numericalize is 2"),
    ],
)
def test_errors(changes, message):
    arguments = {"vectors": [UP], "points": [(0, 0, 0)], "normals": [UP], "context_geometry": []}
    with pytest.raises(at.InputError, match=message):
        intersection_matrix(**arguments | changes)


# --- Beside Ladybug ---------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def peer():
    reason = "no Ladybug: its conventions are NOT checked; pip install ladybug-radiance"
    geometry = pytest.importorskip("ladybug_geometry.geometry3d", reason=reason, exc_type=ImportError)
    intersection = pytest.importorskip("ladybug_radiance.intersection", reason=reason, exc_type=ImportError)
    return geometry, intersection


def test_signatures(peer):
    for ours, theirs in (
        (intersection_matrix, peer[1].intersection_matrix),
        (sky_intersection_matrix, peer[1].sky_intersection_matrix),
    ):
        bare = [(p.name, p.default) for p in inspect.signature(ours).parameters.values()]
        assert bare == [(p.name, p.default) for p in inspect.signature(theirs).parameters.values()]


def test_geometry_of_ladybug(peer):
    geometry = peer[0]
    ring = [[(-2, -2, 1), (2, -2, 1), (2, 2, 1), (-2, 2, 1)], [(-1, -1, 1), (1, -1, 1), (1, 1, 1), (-1, 1, 1)]]
    outer, hole = ([geometry.Point3D(*corner) for corner in each] for each in ring)
    places = [geometry.Point3D(x, 0, 0) for x in (0, 1.5, 3)]
    normals, up = [geometry.Vector3D(0, 0, 1)] * 3, [geometry.Vector3D(0, 0, 2)]
    frame = geometry.Face3D(outer, holes=[hole])
    assert intersection_matrix(up, places, normals, [frame])[:, 0].tolist() == [True, False, True]
    mesh = geometry.Mesh3D(outer, [(0, 1, 2, 3)])
    assert intersection_matrix(up, places, normals, [mesh])[:, 0].tolist() == [False, False, True]


@pytest.mark.parametrize("numericalize", [False, True])
def test_answers_of_radiance(peer, numericalize, tmp_path):
    pyradiance = pytest.importorskip("pyradiance", reason="no Radiance: Ladybug's answers are NOT compared")
    folders = pytest.importorskip("ladybug_radiance.config").folders
    folders.radiance_path = str(Path(pyradiance.__file__).parent)
    theirs = reload(peer[1]).intersection_matrix  # it reads the path when it is imported
    geometry = peer[0]
    meshes, _ = boxes()
    (places, normals), vectors = sensors(60), directions(80)
    lists = [geometry.Vector3D(*v) for v in vectors], [geometry.Point3D(*p) for p in places]
    given = *lists, [geometry.Vector3D(*n) for n in normals]
    context = [geometry.Mesh3D([geometry.Point3D(*v) for v in mesh.vertices], mesh.faces) for mesh in meshes]
    ours = intersection_matrix(*given, context, 0.01, numericalize)
    of_radiance = theirs(*given, context, 0.01, numericalize, str(tmp_path))
    assert ours.shape == of_radiance.shape and ours.dtype == of_radiance.dtype
    towards = vectors / np.linalg.norm(vectors, axis=1, keepdims=True)
    compared = np.abs(normals @ towards.T) > np.sin(np.radians(1.0))  # Radiance leaves out lower vectors
    np.testing.assert_allclose(ours[compared].astype(float), of_radiance[compared].astype(float), atol=1e-5)
    assert 0.1 < (ours[compared] > 0).mean() < 0.9
