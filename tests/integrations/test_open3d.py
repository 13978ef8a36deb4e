"""`RaycastingScene`: the conventions of Open3D's, checked where it is installed, and exact answers."""

import inspect
import sys

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
def library():
    return pytest.importorskip(
        "open3d", reason="no Open3D: the conventions of its RaycastingScene are NOT checked", exc_type=ImportError
    )


@pytest.fixture(autouse=True)
def without_open3d(monkeypatch):
    """The program of a test has imported Open3D only if the test takes `o3d`."""
    monkeypatch.delitem(sys.modules, "open3d", raising=False)


@pytest.fixture
def o3d(library, without_open3d, monkeypatch):
    monkeypatch.setitem(sys.modules, "open3d", library)
    return library


def test_methods_are_those_of_open3d(o3d):
    """Names and positions of parameters, from the first lines of Open3D's docstrings."""
    theirs = o3d.t.geometry.RaycastingScene
    names = {name for name in dir(theirs) if not name.startswith("_")}
    assert names == {name for name in dir(RaycastingScene) if not name.startswith("_")}
    assert theirs.INVALID_ID == NONE
    queries = [name for name in names if name.split("_")[0] in ("cast", "test", "count", "list", "compute")]
    assert len(queries) == 8
    for name in queries:
        ours = list(inspect.signature(getattr(RaycastingScene, name)).parameters)
        text = getattr(theirs, name).__doc__
        places = [text.index(f"{each}: ") for each in ours]
        assert places == sorted(places) and text.partition(")")[0].count(": ") == len(ours), name


def check_same(mine, other):
    assert type(mine) is type(other)
    mine, other = mine.numpy(), other.numpy()
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
    assert set(np.unique(mine["geometry_ids"].numpy())) == {0, 1, NONE}
    check_same(ours.test_occlusions(query), theirs.test_occlusions(query))
    check_same(ours.test_occlusions(query, 0.5, 0.75), theirs.test_occlusions(query, 0.5, 0.75))
    check_same(ours.count_intersections(query), theirs.count_intersections(query))
    check_same(ours.compute_occupancy(query[..., :3]), theirs.compute_occupancy(query[..., :3]))
    mine, other = ours.list_intersections(query), theirs.list_intersections(query)
    assert set(mine) == set(other) and len(mine["t_hit"].numpy()) > 240
    check_same(mine["ray_splits"], other["ray_splits"])
    check_same(mine["ray_ids"], other["ray_ids"])
    order = np.lexsort((other["t_hit"].numpy(), other["ray_ids"].numpy()))  # Open3D does not sort them
    for name in "t_hit", "geometry_ids", "primitive_ids", "primitive_uvs":
        check_same(mine[name], o3d.core.Tensor(other[name].numpy()[order]))
    points = query[..., :3].copy()
    check_same(ours.compute_distance(points), theirs.compute_distance(points))
    check_same(ours.compute_signed_distance(points), theirs.compute_signed_distance(points))
    mine, other = ours.compute_closest_points(points), theirs.compute_closest_points(points)
    assert set(mine) == set(other) and mine["primitive_ids"].shape == mine["geometry_ids"].shape
    check_same(mine["points"], other["points"])
    check_same(mine["geometry_ids"], other["geometry_ids"])
    same = mine["primitive_ids"].numpy() == other["primitive_ids"].numpy()  # elsewhere, on an edge or a corner
    assert same.mean() > 0.3
    for name in "primitive_uvs", "primitive_normals":
        check_same(o3d.core.Tensor(mine[name].numpy()[same]), o3d.core.Tensor(other[name].numpy()[same]))


def test_rays_of_pinholes_are_those_of_open3d(o3d):
    theirs, ours = o3d.t.geometry.RaycastingScene.create_rays_pinhole, RaycastingScene.create_rays_pinhole
    view = {"fov_deg": 60, "center": [0.5, 0.25, 0.5], "eye": [-1, -2, 3], "up": [0, 0.1, 1]}
    size = {"width_px": 8, "height_px": 6}
    mine = ours(**view, **size)
    assert np.ptp(mine.numpy()[..., 3:], axis=(0, 1)).all()
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
        of_one = found["geometry_ids"].numpy() == i
        alone = RaycastingScene()
        alone.add_triangles(vertices, triangles)
        wanted = alone.list_intersections(query)
        assert (found["primitive_ids"].numpy()[of_one] == wanted["primitive_ids"].numpy()).all() and of_one.sum() > 10


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


# --- Tensors ----------------------------------------------------------------------------------------------------------


def test_results_are_tensors_that_share_the_memory_of_arrays(o3d):
    """So `.numpy()`, `.cpu()`, `.isfinite()` and masks work, whether the rays are a tensor or an array."""
    scene, query = two(RaycastingScene()), rays(20)
    for given in query, o3d.core.Tensor(query):
        found = scene.cast_rays(given)
        hit = found["t_hit"].isfinite()
        assert 0 < hit.cpu().numpy().sum() < 20
        assert (found["primitive_ids"][hit].cpu() != NONE).all()
        assert scene.test_occlusions(given).any() and scene.compute_occupancy(given[:, :3]).shape == [20]
    found = {name: tensor.numpy() for name, tensor in scene.cast_rays(query).items()}
    alone = found["t_hit"].copy()
    for _ in range(50):
        scene.cast_rays(rays(20, seed=2))
    assert (found["t_hit"] == alone).all()  # the memory still belongs to the first result
    assert scene.create_rays_pinhole(60, [0, 0, 0], [0, 0, 3], [0, 1, 0], 4, 2).shape == [2, 4, 6]


def test_results_are_arrays_in_programs_without_open3d():
    scene = two(RaycastingScene())
    assert all(type(each) is np.ndarray for each in scene.cast_rays(rays(3)).values())
    assert type(scene.compute_distance(rays(3)[:, :3])) is np.ndarray


@pytest.mark.parametrize("shape", [(9,), (1, 2, 3), (4, 2), (0,)])
def test_results_have_the_shape_of_the_rays(shape):
    scene, (query, n) = two(RaycastingScene()), (rays(24), int(np.prod(shape)))
    query = query[:n].reshape(*shape, 6)
    ends = {"primitive_uvs": (2,), "primitive_normals": (3,), "points": (3,)}
    for result in scene.cast_rays(query), scene.compute_closest_points(query[..., :3]):
        assert all(each.shape == shape + ends.get(name, ()) for name, each in result.items())
    for name in "compute_distance", "compute_signed_distance", "compute_occupancy":
        assert getattr(scene, name)(query[..., :3]).shape == shape
    counts, listed = scene.count_intersections(query), scene.list_intersections(query)
    assert counts.shape == scene.test_occlusions(query).shape == shape and listed["ray_splits"].shape == (n + 1,)
    hits = {name: each for name, each in listed.items() if name != "ray_splits"}
    assert all(each.shape == (counts.sum(), *ends.get(name, ())) for name, each in hits.items())


# --- Hits and misses --------------------------------------------------------------------------------------------------


def no_rays() -> np.ndarray:
    """Rays that are not valid, between some that hit the ball."""
    good = np.array([[0.1, 0.2, -3, 0, 0, 1]] * 10, np.float32)
    bad = good.copy()
    bad[0, 0], bad[1, 4], bad[2, 2], bad[3, 3], bad[4, 3:] = np.nan, np.nan, -np.inf, np.inf, 0.0
    bad[5, :], bad[6, 3:] = np.nan, (np.inf, -np.inf, np.nan)
    return np.concatenate([good[:2], bad[:7], good[:3]])


VALID = np.array([True] * 2 + [False] * 7 + [True] * 3)


def test_rays_that_are_not_numbers_or_have_no_direction_miss():
    scene = two(RaycastingScene())
    found, listed = scene.cast_rays(no_rays()), scene.list_intersections(no_rays())
    assert (np.isfinite(found["t_hit"]) == VALID).all() and ((found["primitive_ids"] != NONE) == VALID).all()
    assert (scene.test_occlusions(no_rays()) == VALID).all()
    assert (scene.count_intersections(no_rays()) == np.where(VALID, 4, 0)).all()
    assert (np.diff(listed["ray_splits"].astype(int)) == np.where(VALID, 4, 0)).all()
    assert np.isin(listed["ray_ids"], np.flatnonzero(VALID)).all()


def test_rays_that_are_not_numbers_miss_as_in_open3d(o3d):
    ours, theirs = two(RaycastingScene()), two(o3d.t.geometry.RaycastingScene())
    query = no_rays()
    for name in "test_occlusions", "count_intersections":
        check_same(getattr(ours, name)(query), getattr(theirs, name)(query))
    mine, other = ours.cast_rays(query), theirs.cast_rays(query)
    for name in mine:
        check_same(mine[name], other[name])


def test_points_that_are_not_numbers_have_no_closest_point():
    scene, points = two(RaycastingScene()), np.zeros((4, 3), np.float32)
    points[1, 0], points[2, 1], points[3] = np.nan, np.inf, (2, 0, 0)
    found = scene.compute_closest_points(points)
    assert found["primitive_ids"][1:3].tolist() == found["geometry_ids"][1:3].tolist() == [NONE, NONE]
    assert np.isnan(found["points"][1:3]).all() and not found["primitive_normals"][1:3].any()
    assert (found["geometry_ids"][[0, 3]] == [1, 0]).all()
    for name in "compute_distance", "compute_signed_distance":
        distances = getattr(scene, name)(points)
        assert np.isnan(distances[1]) and distances[2] == np.inf and 0.9 < distances[3] <= 1.0
    assert scene.compute_occupancy(points)[1:].tolist() == [0.0, 0.0, 0.0]


SQUARE = np.array([[-1.0, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]]), np.array([[0, 1, 2], [0, 2, 3]])


@pytest.mark.parametrize(
    "tnear, tfar, blocked",
    [
        (0.0, np.inf, [True, False, False]),
        (-3.0, np.inf, [True, True, True]),
        (-1.0, np.inf, [True, False, True]),
        (-3.0, -1.0, [False, True, False]),
        (-1.0, 1.5, [False, False, True]),
        (-np.inf, np.inf, [True, True, True]),
        (2.5, np.inf, [False, False, False]),
        (1.0, 1.0, [False, False, False]),
        (3.0, 1.0, [False, False, False]),
        (np.nan, np.inf, [False, False, False]),
        (0.0, np.nan, [False, False, False]),
        (np.inf, np.inf, [False, False, False]),
        (0.0, -1.0, [False, False, False]),
    ],
)
def test_ends_of_rays_may_be_negative_equal_or_no_numbers(tnear, tfar, blocked):
    """Rays that reach a square at t = 2, -2 and 0."""
    scene = RaycastingScene()
    scene.add_triangles(*SQUARE)
    query = np.array([[0.5, 0.25, -2, 0, 0, 1], [0.5, 0.25, 2, 0, 0, 1], [0.5, 0.25, 0, 0, 0, 1]], np.float32)
    assert scene.test_occlusions(query, tnear, tfar).tolist() == blocked


def test_ends_of_rays_are_those_of_open3d(o3d):
    ours, theirs, query = two(RaycastingScene()), two(o3d.t.geometry.RaycastingScene()), rays(200)
    ends = [(0.0, 0.5), (0.5, 0.5), (0.75, np.inf), (2.0, 1.0), (0.0, -1.0), (np.nan, 1.0), (0.0, np.nan)]
    for tnear, tfar in ends:
        check_same(ours.test_occlusions(query, tnear, tfar), theirs.test_occlusions(query, tnear, tfar))


def test_counts_are_those_of_the_list_where_faces_meet_or_coincide():
    """On the edges and corners of a box, and on a ball whose faces are there twice."""
    box, ball = trimesh.creation.box((2, 2, 2)), arrays()
    along = np.array([[x, y, -5, 0, 0, 1] for x in (-1, 0, 1) for y in (-1, 0, 1)], np.float32)
    for vertices, triangles, query in (
        (box.vertices, box.faces, along),
        (ball[0], np.concatenate([ball[1], ball[1][:, ::-1]]), rays(100)),
    ):
        scene = RaycastingScene()
        scene.add_triangles(vertices, triangles)
        counts, listed = scene.count_intersections(query), scene.list_intersections(query)
        assert (counts == np.diff(listed["ray_splits"].astype(int))).all() and counts.max() == 2
        assert ((counts > 0) == scene.test_occlusions(query)).all()
    assert scene.count_intersections(along).sum() < 18


# --- Distances --------------------------------------------------------------------------------------------------------


def test_distances_from_a_cube():
    """At its centre, beyond a corner and on the corner."""
    scene = RaycastingScene()
    box = trimesh.creation.box((1, 1, 1))
    scene.add_triangles(box.vertices, box.faces)
    points = np.array([[0, 0, 0], [-1, -1, -1], [-0.5, -0.5, -0.5]], np.float32)
    away = np.float32(np.sqrt(0.75))
    assert scene.compute_distance(points).tolist() == [0.5, away, 0.0]
    assert scene.compute_signed_distance(points).tolist() == [-0.5, away, 0.0]
    assert scene.compute_signed_distance(points, 1, 3).dtype == np.float32
    assert scene.compute_occupancy(points[:2], nsamples=3).tolist() == [1.0, 0.0]
    assert scene.compute_closest_points(points)["points"][1:].tolist() == [[-0.5, -0.5, -0.5]] * 2


def test_a_lattice_in_a_sphere_is_occupied_as_a_sphere_is():
    """Rays from some of these points meet vertices and edges."""
    sphere = trimesh.creation.uv_sphere(0.8, count=(20, 40))
    scene = RaycastingScene()
    scene.add_triangles(sphere.vertices, sphere.faces)
    points = np.stack(np.meshgrid(*[np.linspace(-0.88, 0.88, 6)] * 3), axis=-1).astype(np.float32)
    inside = np.linalg.norm(points, axis=-1) < 0.79
    assert (scene.compute_occupancy(points) == inside).all() and 20 < inside.sum() < 100
    assert ((scene.compute_signed_distance(points) < 0) == inside).all()


# --- Cameras ----------------------------------------------------------------------------------------------------------


def test_a_field_of_view_of_zero_gives_rays_along_the_axis():
    found = RaycastingScene.create_rays_pinhole(0, [0, 0, 0], [0, 0, 3], [0, 1, 0], 3, 2)
    assert found.shape == (2, 3, 6) and (found == [0, 0, 3, 0, 0, -1]).all()


def test_cameras_without_a_view_have_rays_that_miss():
    scene = two(RaycastingScene())
    for center, up in (([0, 0, 0], [0, 1, 0]), ([0, 0, 1], [0, 0, 1])):  # no direction ahead; none to the right
        found = scene.create_rays_pinhole(60, center, [0, 0, 0], up, 4, 2)
        assert np.isnan(found[..., 3:]).all() and not scene.test_occlusions(found).any()


@pytest.mark.parametrize("fov", [0, 1, 90, 179, 200, -60])
def test_any_field_of_view_is_that_of_open3d(o3d, fov):
    theirs, ours = o3d.t.geometry.RaycastingScene.create_rays_pinhole, RaycastingScene.create_rays_pinhole
    view = fov, [0.5, 0.25, 0.5], [-1, -2, 3], [0, 0.1, 1], 5, 4
    np.testing.assert_allclose(ours(*view).numpy(), theirs(*view).numpy(), rtol=1e-5, atol=1e-5)


# --- Wrong arguments --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "call, words",
    [
        (lambda s: s.add_triangles("ball.ply"), "add_triangles got a str; give a mesh of trimesh"),
        (lambda s: s.add_triangles(np.zeros((3, 3)), [[0, 1, 3]]), "face 0 uses the vertices 0, 1, 3"),
        (lambda s: s.add_triangles(np.zeros((3, 2)), [[0, 1, 2]]), r"vertex_positions must be numbers \(n, 3\)"),
        (lambda s: s.cast_rays(np.zeros((2, 3))), r"rays must be numbers \(\.\.\., 6\)"),
        (lambda s: s.compute_occupancy(np.zeros((2, 6))), r"query_points must be numbers \(\.\.\., 3\)"),
        (lambda s: s.compute_occupancy(np.zeros((2, 3)), nsamples=2), "nsamples is 2; it must be odd"),
        (lambda s: s.compute_distance(np.zeros((2, 6))), r"query_points must be numbers \(\.\.\., 3\)"),
        (lambda s: s.cast_rays(rays(2), nthreads=0.5), "nthreads is 0.5"),
        (lambda s: s.create_rays_pinhole("wide", [0, 0, 1], [0, 0, 0], [0, 1, 0], 8, 8), "fov_deg is 'wide'"),
        (lambda s: s.create_rays_pinhole(np.eye(4), np.eye(4), 8, 8), r"\(3, 3\) and \(4, 4\)"),
    ],
)
def test_wrong_values_are_refused(call, words):
    with pytest.raises(at.InputError, match=words):
        call(two(RaycastingScene()))
