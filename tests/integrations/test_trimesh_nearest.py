"""`trimesh_nearest`: distances as trimesh's own queries give them, their error bound, copies, and pickles."""

import copy
import inspect
import pickle

import numpy as np
import pytest
import trimesh

import antumbra as at

BOUND = 2.0**-23  # of the largest distance of a vertex from the middle of the mesh


def points(n=300, seed=1):
    return np.random.default_rng(seed).uniform(-2, 2, (n, 3))


def meshes():
    torus = trimesh.creation.torus(1.0, 0.3)
    far = trimesh.creation.icosphere(3)
    far.apply_translation((1e3 / 3, -2e2 / 7, 0.1))
    return {"torus": torus, "box": trimesh.creation.box((1.0, 2.0, 3.0)), "far ball": far}


@pytest.mark.parametrize("name", meshes())
def test_distances_faces_and_places_are_those_of_trimesh(name):
    mesh = meshes()[name]
    query = points() + mesh.bounds.mean(0)
    theirs = trimesh.proximity.closest_point_naive(mesh, query)
    closest, distance, face = at.trimesh_nearest(mesh).on_surface(query)
    error = BOUND * np.linalg.norm(mesh.vertices - mesh.bounds.mean(0), axis=1).max()
    assert (distance >= theirs[1] - 1e-12).all() and (distance <= theirs[1] + error).all()
    np.testing.assert_allclose(np.linalg.norm(closest - query, axis=1), distance, rtol=1e-12)
    assert (
        (face != theirs[2]).mean() < 0.5 and face.dtype == np.int64 and closest.dtype == np.float64
    )  # edges are shared
    on_face = trimesh.triangles.closest_point(mesh.triangles[face], closest)
    np.testing.assert_allclose(on_face, closest, atol=1e-12)


@pytest.mark.parametrize("turns", [0, 1])
def test_distances_of_a_box_have_their_closed_form(turns):
    turn = np.linalg.matrix_power(np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]]), turns)
    mesh = trimesh.creation.box((2.0, 2.0, 2.0))
    mesh.apply_transform(np.block([[turn, np.zeros((3, 1))], [np.zeros((1, 3)), np.ones((1, 1))]]))
    query = points(500)
    outside = np.maximum(np.abs(query) - 1.0, 0.0)
    truth = np.where((outside > 0).any(1), -np.linalg.norm(outside, axis=1), (1.0 - np.abs(query)).min(1))
    np.testing.assert_allclose(at.trimesh_nearest(mesh).signed_distance(query), truth, rtol=0, atol=1e-12)
    assert 30 < (truth > 0).sum() < 200


def test_signs_are_those_of_trimesh_and_open3d_has_the_distances():
    mesh, query = meshes()["torus"], points()
    pytest.importorskip("rtree", reason="no rtree: trimesh's own signed distances are NOT checked")
    ours = at.trimesh_nearest(mesh).signed_distance(query)
    np.testing.assert_allclose(ours, trimesh.proximity.signed_distance(mesh, query), atol=1e-6)
    open3d = pytest.importorskip("open3d", reason="no Open3D: its distances are NOT checked", exc_type=ImportError)
    scene = open3d.t.geometry.RaycastingScene()
    scene.add_triangles(np.asarray(mesh.vertices, np.float32), np.asarray(mesh.faces, np.uint32))
    theirs = scene.compute_signed_distance(query.astype(np.float32)).numpy()
    np.testing.assert_allclose(ours, -theirs, atol=1e-5)


def test_the_methods_are_those_of_trimesh():
    theirs, ours = trimesh.proximity.ProximityQuery, type(at.trimesh_nearest(trimesh.creation.box()))
    for name, _ in inspect.getmembers(theirs, inspect.isfunction):
        if not name.startswith("_"):
            assert list(inspect.signature(getattr(ours, name)).parameters) == ["self", "points"]
    mesh = trimesh.creation.box()
    for one, other in zip(at.trimesh_nearest(mesh).vertex(points(9)), mesh.nearest.vertex(points(9))):
        np.testing.assert_array_equal(one, other)
    assert [each.shape for each in at.trimesh_nearest(mesh).on_surface(np.zeros((0, 3)))] == [(0, 3), (0,), (0,)]


def test_functions_of_trimesh_use_the_queries():
    mesh = trimesh.creation.icosphere(2)
    mesh.ray, mesh.nearest = at.trimesh_ray(mesh), at.trimesh_nearest(mesh)
    _, radii = trimesh.proximity.max_tangent_sphere(mesh, mesh.triangles_center[:20])
    assert ((radii > 0.8) & (radii < 1.01)).all()


@pytest.mark.parametrize("duplicate", [lambda m: m.copy(), copy.copy, copy.deepcopy, lambda m: m.copy().copy()])
def test_copies_keep_the_engine_and_its_trees(duplicate):
    mesh = trimesh.creation.torus(1.0, 0.3)
    mesh.ray, mesh.nearest = at.trimesh_ray(mesh), at.trimesh_nearest(mesh)
    scene = mesh.ray.scene
    other = duplicate(mesh)
    assert type(other.ray) is type(mesh.ray) and type(other.nearest) is type(mesh.nearest)
    assert other.ray.mesh is other and other.nearest.mesh is other and other.ray.scene is scene
    inside = points(60)
    assert (other.contains(inside) == mesh.contains(inside)).all() and mesh.contains(inside).any()
    other.apply_scale(2.0)
    assert (other.contains(2 * inside) == mesh.contains(inside)).all() and mesh.ray.scene is scene
    np.testing.assert_allclose(other.nearest.signed_distance(2 * inside), 2 * mesh.nearest.signed_distance(inside))


def test_a_copy_of_a_mesh_with_queries_of_trimesh_has_those_of_trimesh():
    mesh = trimesh.creation.box()
    unused, theirs = at.trimesh_ray(mesh), type(mesh.ray)
    assert type(mesh.copy().ray) is theirs and type(unused) is not theirs


def test_meshes_and_their_queries_can_be_pickled():
    mesh = trimesh.creation.box()
    mesh.ray, mesh.nearest = at.trimesh_ray(mesh), at.trimesh_nearest(mesh)
    mesh.nearest.on_surface(points(3))
    again = pickle.loads(pickle.dumps(mesh))
    assert (again.nearest.signed_distance(points(9)) == mesh.nearest.signed_distance(points(9))).all()
    assert again.nearest.mesh is again and type(again.copy().ray) is type(mesh.ray)


def test_new_meshes_have_the_queries_on_request():
    theirs = trimesh.proximity.ProximityQuery
    with at.use_in_trimesh():
        mesh = trimesh.creation.box()
        assert type(mesh.nearest) is type(at.trimesh_nearest(mesh))
        assert mesh.nearest.on_surface([[2.0, 0, 0]])[1].tolist() == [1.5]
    assert trimesh.proximity.ProximityQuery is theirs and type(trimesh.creation.box().nearest) is theirs


def test_what_has_no_distance_is_refused():
    with pytest.raises(at.InputError, match=r"give a trimesh\.Trimesh"):
        at.trimesh_nearest(3)
    flat = trimesh.Trimesh([[0, 0, 0], [1, 0, 0], [2, 0, 0]], [[0, 1, 2]], process=False)
    with pytest.raises(at.InputError, match="no face with area"):
        at.trimesh_nearest(flat).on_surface([[0.0, 0, 1]])
    with pytest.raises(at.InputError, match="points"):
        at.trimesh_nearest(trimesh.creation.box()).on_surface([0.0, 0, 1])
    with pytest.raises(at.InputError, match="NaN"):
        at.trimesh_nearest(trimesh.creation.box()).on_surface([[np.nan, 0, 1]])


def test_a_point_that_is_not_a_number_fails_alone():
    points = np.array([[0.0, 0.0, 0.0], [np.nan, 0.0, 0.0], [3.0, 0.0, 0.0]])
    near = at.trimesh_nearest(trimesh.creation.box())
    closest, distance, face = near.on_surface(points)
    np.testing.assert_array_equal(distance, [0.5, np.nan, 2.5])
    assert np.isnan(closest[1]).all() and face[1] == -1 and (face[[0, 2]] >= 0).all()
    np.testing.assert_array_equal(near.signed_distance(points), [0.5, np.nan, -2.5])
