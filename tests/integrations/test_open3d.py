"""`RaycastingScene`: the conventions of Open3D's, checked where it is installed, and exact answers."""

import inspect

import numpy as np
import pytest
import trimesh

import antumbra as at
import oracle
from antumbra.integrations.open3d import RaycastingScene

STEP = 2.0**-12  # coordinates are multiples of it, so all scenes here are exact in float32
NONE = RaycastingScene.INVALID_ID


def arrays(rings: int = 2, scale: float = 1.0) -> tuple[np.ndarray, np.ndarray]:
    """Vertices (v, 3) float32 and triangles (m, 3) uint32 of a ball around the origin."""
    sphere = trimesh.creation.icosphere(rings)
    return (np.round(scale * sphere.vertices / STEP) * STEP).astype(np.float32), sphere.faces.astype(np.uint32)


def rays(n: int, seed: int = 1) -> np.ndarray:
    """(n, 6) float32: rays from a cube twice as wide as the ball to one as wide."""
    rng = np.random.default_rng(seed)
    origins = np.round(rng.uniform(-2, 2, (n, 3)) / STEP) * STEP
    return np.concatenate([origins, rng.uniform(-0.9, 0.9, (n, 3)) - origins], axis=1).astype(np.float32)


def two(scene):
    """A ball, geometry 0, with a smaller one inside, geometry 1."""
    assert [scene.add_triangles(*arrays()), scene.add_triangles(*arrays(1, 0.5))] == [0, 1]
    return scene


@pytest.fixture(scope="module")
def o3d():
    return pytest.importorskip(
        "open3d", reason="no Open3D: the conventions of its RaycastingScene are NOT checked", exc_type=ImportError
    )


def test_methods_are_those_of_open3d(o3d):
    """Names and positions of parameters, from the first lines of Open3D's docstrings."""
    theirs = o3d.t.geometry.RaycastingScene
    names = {name for name in dir(theirs) if not name.startswith("_")}
    assert names == {name for name in dir(RaycastingScene) if not name.startswith("_")}
    assert theirs.INVALID_ID == NONE
    for name in "cast_rays", "test_occlusions", "count_intersections", "list_intersections", "compute_occupancy":
        ours = list(inspect.signature(getattr(RaycastingScene, name)).parameters)
        text = getattr(theirs, name).__doc__
        places = [text.index(f"{each}: ") for each in ours]
        assert places == sorted(places) and text.partition(")")[0].count(": ") == len(ours), name


def check_same(mine, other):
    other = other.numpy()
    assert (mine.shape, mine.dtype) == (other.shape, other.dtype)
    if mine.dtype.kind == "f":
        np.testing.assert_allclose(mine, other, rtol=1e-4, atol=1e-5)
    else:
        assert (mine == other).all()


@pytest.mark.parametrize("shape", [(240,), (4, 60)])
def test_results_are_those_of_open3d(o3d, shape):
    ours, theirs = two(RaycastingScene()), two(o3d.t.geometry.RaycastingScene())
    query = rays(240).reshape(*shape, 6)
    mine, other = ours.cast_rays(query), theirs.cast_rays(query)
    assert list(mine) and set(mine) == set(other)
    for name in mine:
        check_same(mine[name], other[name])
    assert set(np.unique(mine["geometry_ids"])) == {0, 1, NONE}
    check_same(ours.test_occlusions(query), theirs.test_occlusions(query))
    check_same(ours.test_occlusions(query, 0.5, 0.75), theirs.test_occlusions(query, 0.5, 0.75))
    check_same(ours.count_intersections(query), theirs.count_intersections(query))
    check_same(ours.compute_occupancy(query[..., :3]), theirs.compute_occupancy(query[..., :3]))
    mine, other = ours.list_intersections(query), theirs.list_intersections(query)
    assert set(mine) == set(other) and len(mine["t_hit"]) > 240
    check_same(mine["ray_splits"], other["ray_splits"])
    check_same(mine["ray_ids"], other["ray_ids"])
    order = np.lexsort((other["t_hit"].numpy(), other["ray_ids"].numpy()))  # Open3D does not sort them
    for name in "t_hit", "geometry_ids", "primitive_ids", "primitive_uvs":
        check_same(mine[name], o3d.core.Tensor(other[name].numpy()[order]))


def test_rays_of_pinholes_are_those_of_open3d(o3d):
    theirs, ours = o3d.t.geometry.RaycastingScene.create_rays_pinhole, RaycastingScene.create_rays_pinhole
    view = {"fov_deg": 60, "center": [0.5, 0.25, 0.5], "eye": [-1, -2, 3], "up": [0, 0.1, 1]}
    size = {"width_px": 8, "height_px": 6}
    mine = ours(**view, **size)
    assert np.ptp(mine[..., 3:], axis=(0, 1)).all()
    check_same(mine, theirs(**view, **size))
    check_same(ours(*view.values(), 8, 6), theirs(*view.values(), 8, 6))
    intrinsic, extrinsic = np.array([[9.0, 0.5, 4], [0, 8, 3], [0, 0, 1]]), np.eye(4)
    extrinsic[:3] = np.linalg.qr(np.random.default_rng(1).normal(size=(3, 3)))[0] @ np.eye(3, 4) + [[0, 0, 0, 2]] * 3
    matrices = o3d.core.Tensor(intrinsic), o3d.core.Tensor(extrinsic)
    check_same(ours(intrinsic, extrinsic, 8, 6), theirs(*matrices, 8, 6))
    check_same(ours(*matrices, **size), theirs(*matrices, 8, 6))


def test_meshes_and_tensors_of_open3d_are_accepted(o3d):
    vertices, triangles = arrays()
    tensors = o3d.core.Tensor(vertices), o3d.core.Tensor(triangles)
    mesh = o3d.t.geometry.TriangleMesh(tensors[0], o3d.core.Tensor(triangles.astype(np.int64)))
    scene = RaycastingScene()
    added = [
        scene.add_triangles(mesh),
        scene.add_triangles(mesh=mesh.to_legacy()),
        scene.add_triangles(vertex_positions=tensors[0], triangle_indices=tensors[1]),
        scene.add_triangles(trimesh.Trimesh(vertices, triangles, process=False)),
    ]
    assert added == [0, 1, 2, 3]
    query = rays(50)
    found = scene.list_intersections(o3d.core.Tensor(query))
    for i in range(4):
        of_one = found["geometry_ids"] == i
        alone = RaycastingScene()
        alone.add_triangles(vertices, triangles)
        wanted = alone.list_intersections(query)
        assert (found["primitive_ids"][of_one] == wanted["primitive_ids"]).all() and of_one.sum() > 10


def test_hits_are_exact_at_vertices_and_edges():
    """Each is one hit in the list, by the lowest triangle, and one crossing."""
    vertices, triangles = arrays()
    ends = vertices[triangles[::7, :2]]
    targets = np.concatenate([vertices[::5], ends.mean(axis=1)]).astype(np.float64)
    origins = np.round(np.random.default_rng(2).uniform(-0.2, 0.2, targets.shape) / STEP) * STEP
    query = np.concatenate([origins, targets - origins], axis=1)
    scene = RaycastingScene()
    scene.add_triangles(vertices, triangles)
    t, face = oracle.closest_hit(vertices[triangles], *np.split(query.astype(np.float32), 2, axis=1))
    hit, listed = scene.cast_rays(query), scene.list_intersections(query)
    assert (face >= 0).all() and (t == 1.0).any()
    assert (hit["primitive_ids"] == face).all() and (hit["t_hit"] == t.astype(np.float32)).all()
    assert listed["ray_splits"].tolist() == list(range(len(query) + 1))
    assert (listed["primitive_ids"] == face).all() and (scene.count_intersections(query) == 1).all()
    assert scene.compute_occupancy(origins).all() and scene.test_occlusions(query).all()


def test_an_empty_scene_and_misses():
    scene = RaycastingScene()
    found = scene.cast_rays(rays(4).reshape(2, 2, 6))
    assert found["t_hit"].shape == (2, 2) and np.isinf(found["t_hit"]).all()
    assert (found["geometry_ids"] == NONE).all() and (found["primitive_ids"] == NONE).all()
    assert not found["primitive_uvs"].any() and found["primitive_normals"].shape == (2, 2, 3)
    assert not found["primitive_normals"].any() and not scene.test_occlusions(rays(3)).any()
    assert scene.list_intersections(rays(3))["ray_splits"].tolist() == [0, 0, 0, 0]
    assert not scene.count_intersections(rays(3)).any() and not scene.compute_occupancy(rays(3)[:, :3]).any()
    two(scene)  # after a query
    assert scene.test_occlusions(rays(30)).any() and scene.count_intersections(rays(30)).dtype == np.int32


def test_normals_follow_the_winding_order():
    scene = RaycastingScene()
    scene.add_triangles([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]])
    found = scene.cast_rays([[0.25, 0.5, 1, 0, 0, -2], [0.25, 0.5, -1, 0, 0, 1]])
    assert found["primitive_normals"].tolist() == [[0, 0, 1]] * 2
    assert found["t_hit"].tolist() == [0.5, 1.0] and found["primitive_uvs"].tolist() == [[0.25, 0.5]] * 2


@pytest.mark.parametrize("name", ["compute_distance", "compute_signed_distance", "compute_closest_points"])
def test_distances_are_refused_by_name(name):
    with pytest.raises(at.InputError, match=f"rays do not measure distances; use Open3D's own .*{name}"):
        getattr(two(RaycastingScene()), name)(np.zeros((1, 3)), nthreads=1)


@pytest.mark.parametrize(
    "call, words",
    [
        (lambda s: s.add_triangles("ball.ply"), "add_triangles got a str; give a mesh of trimesh"),
        (lambda s: s.add_triangles(np.zeros((3, 3)), [[0, 1, 3]]), "face 0 uses vertex 0, 1, 3"),
        (lambda s: s.add_triangles(np.zeros((3, 2)), [[0, 1, 2]]), r"vertex_positions must be numbers \(n, 3\)"),
        (lambda s: s.cast_rays(np.zeros((2, 3))), r"rays must be numbers \(\.\.\., 6\)"),
        (lambda s: s.compute_occupancy(np.zeros((2, 6))), r"query_points must be numbers \(\.\.\., 3\)"),
        (lambda s: s.compute_occupancy(np.zeros((2, 3)), nsamples=2), "nsamples is 2; it must be odd"),
        (lambda s: s.cast_rays(rays(2), nthreads=-1), "nthreads is -1"),
        (lambda s: s.test_occlusions(rays(2), tnear=-1.0), "tnear is -1.0"),
        (lambda s: s.create_rays_pinhole(60, [0, 0, 0], [0, 0, 0], [0, 0, 1], 8, 8), "the view from eye to center"),
        (lambda s: s.create_rays_pinhole(60, [0, 0, 1], [0, 0, 0], [0, 0, 1], 8, 8), "up, seen from eye, is zero"),
        (lambda s: s.create_rays_pinhole(np.eye(4), np.eye(4), 8, 8), r"\(3, 3\) and \(4, 4\)"),
    ],
)
def test_wrong_values_are_refused(call, words):
    with pytest.raises(at.InputError, match=words):
        call(two(RaycastingScene()))
