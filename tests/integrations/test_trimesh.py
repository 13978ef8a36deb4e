"""`trimesh_ray`: the conventions of trimesh's two intersectors, exact answers, and meshes that change."""

import copy
import inspect
import pickle

import numpy as np
import pytest
import trimesh
from trimesh.ray import ray_triangle, ray_util

import antumbra as at
import oracle

STEP = 2.0**-12  # coordinates are multiples of it, so float32 holds them at all places of these tests
KINDS = "embree", "triangle"


def ball(rings: int = 2) -> trimesh.Trimesh:
    """A ball of radius 1 around the origin, in steps."""
    sphere = trimesh.creation.icosphere(rings)
    return trimesh.Trimesh(np.round(sphere.vertices / STEP) * STEP, sphere.faces, process=False)


def shells() -> trimesh.Trimesh:
    """A ball around a smaller one, whose faces point inwards."""
    outer, inner = ball(), ball()
    inner.apply_scale(0.5)
    inner.invert()
    return trimesh.util.concatenate([outer, inner])


def rays(n: int, seed: int = 1) -> tuple[np.ndarray, np.ndarray]:
    """Rays from a cube twice as wide as the ball, of which some hit it."""
    rng = np.random.default_rng(seed)
    return np.round(rng.uniform(-2, 2, (n, 3)) / STEP) * STEP, rng.normal(size=(n, 3)).astype(np.float32)


def corners_of(mesh: trimesh.Trimesh) -> np.ndarray:
    return np.asarray(mesh.triangles, np.float32)


def exact_hits(mesh: trimesh.Trimesh, origins, directions) -> list[list[tuple[float, int]]]:
    """The (t, face) of each ray, ascending, in rational arithmetic."""
    found = []
    for o, d in zip(origins, np.asarray(directions, np.float32)):
        pairs = [(*oracle.meets_exactly(o, d, triangle), face) for face, triangle in enumerate(corners_of(mesh))]
        found.append(sorted((float(t), face) for side, t, face in pairs if side))
    return found


def peer(kind: str, mesh: trimesh.Trimesh):
    """One of trimesh's own intersectors."""
    if kind == "embree":
        pytest.importorskip("embreex", reason="no embreex: the conventions of ray_pyembree are NOT checked")
        from trimesh.ray import ray_pyembree

        return ray_pyembree.RayMeshIntersector(mesh)
    pytest.importorskip("rtree", reason="no rtree: the conventions of ray_triangle are NOT checked")
    return ray_triangle.RayMeshIntersector(mesh)


def parameters_of(method) -> list[str]:
    """The names of a method's parameters, also of one that trimesh has wrapped without its signature."""
    cells = [cell.cell_contents for cell in method.__func__.__closure__ or ()]
    function = next(filter(inspect.isfunction, cells), method.__func__)
    parameters = list(inspect.signature(function).parameters.values())[1:]
    return [each.name for each in parameters if each.kind is each.POSITIONAL_OR_KEYWORD]


def sorted_rows(*columns: np.ndarray) -> np.ndarray:
    table = np.column_stack(columns)
    return table[np.lexsort(table.T[::-1])]


@pytest.mark.parametrize("kind", KINDS)
def test_methods_have_the_names_and_parameters_of_trimesh(kind):
    theirs, ours = peer(kind, ball()), at.trimesh_ray(ball())
    names = {name for name, each in inspect.getmembers(theirs, callable) if not name.startswith("_")}
    assert names == {"intersects_any", "intersects_first", "intersects_id", "intersects_location", "contains_points"}
    for name in names:
        wanted, found = (parameters_of(getattr(each, name)) for each in (theirs, ours))
        assert wanted and set(wanted) <= set(found), name
        assert kind == "triangle" or found[: len(wanted)] == wanted, name  # positions too


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("several", [True, False])
def test_results_are_those_of_trimesh(kind, several):
    mesh = shells()
    theirs, ours = peer(kind, mesh), at.trimesh_ray(mesh)
    origins, directions = rays(300)
    any_hit, first = ours.intersects_any(origins, directions), ours.intersects_first(origins, directions)
    assert 30 < any_hit.sum() < 270 and ((first >= 0) == any_hit).all()
    other = theirs.intersects_any(origins, directions), theirs.intersects_first(origins, directions)
    assert any_hit.dtype == other[0].dtype and (any_hit == other[0]).all() and (first == other[1]).all()
    assert first.dtype == (other[1].dtype if kind == "embree" else np.int32)  # trimesh's own ones differ
    mine = ours.intersects_id(origins, directions, multiple_hits=several, return_locations=True)
    other = theirs.intersects_id(origins, directions, multiple_hits=several, return_locations=True)
    assert [each.dtype for each in mine] == [each.dtype for each in other]
    assert [each.shape for each in mine] == [each.shape for each in other] and len(mine[0]) >= any_hit.sum()
    assert (sorted_rows(mine[1], mine[0]) == sorted_rows(other[1], other[0])).all()
    order = [np.lexsort((each[0], each[1])) for each in (mine, other)]
    np.testing.assert_allclose(mine[2][order[0]], other[2][order[1]], rtol=0, atol=1e-12)
    mine, other = (each.intersects_location(origins, directions, multiple_hits=several) for each in (ours, theirs))
    assert [each.shape for each in mine] == [each.shape for each in other]
    assert (sorted_rows(mine[1], mine[2]) == sorted_rows(other[1], other[2])).all()
    mine, other = (each.intersects_id(origins, directions, multiple_hits=several) for each in (ours, theirs))
    assert len(mine) == len(other) == 2 and (sorted_rows(*mine) == sorted_rows(*other)).all()


def test_hits_are_in_the_order_of_embree():
    mesh = shells()
    origins, directions = rays(300)
    mine = at.trimesh_ray(mesh).intersects_id(origins, directions)
    other = peer("embree", mesh).intersects_id(origins, directions)
    assert all((a == b).all() for a, b in zip(mine, other)) and np.bincount(mine[1]).max() == 4


def test_results_without_hits_are_those_of_embree():
    mesh, origins, away = ball(), np.full((3, 3), 5.0), np.ones((3, 3))
    for name in "intersects_any", "intersects_first", "intersects_id", "intersects_location":
        results = [getattr(each, name)(origins, away) for each in (at.trimesh_ray(mesh), peer("embree", mesh))]
        ours, theirs = (each if isinstance(each, tuple) else (each,) for each in results)
        for mine, other in zip(ours, theirs, strict=True):
            assert (mine.shape, mine.dtype, mine.tolist()) == (other.shape, other.dtype, other.tolist())


def test_rays_through_vertices_and_edges_are_exact():
    mesh, rng = shells(), np.random.default_rng(2)
    ends = mesh.vertices[mesh.edges_unique]
    targets = np.concatenate([mesh.vertices[::9], ends[::20].mean(axis=1)])
    origins = np.round(rng.uniform(-0.2, 0.2, targets.shape) / STEP) * STEP
    directions = targets - origins  # in steps, so float32 holds them
    wanted = exact_hits(mesh, origins, directions)
    ours = at.trimesh_ray(mesh)
    assert ours.intersects_any(origins, directions).all()
    assert ours.intersects_first(origins, directions).tolist() == [hits[0][1] for hits in wanted]
    face, ray = ours.intersects_id(origins, directions)
    lowest = [{t: face for t, face in reversed(hits)} for hits in wanted]  # at each location
    for i, of_ray in enumerate(lowest):
        assert face[ray == i].tolist() == [of_ray[t] for t in sorted(of_ray)]
    assert (ours.intersects_location(origins, directions)[1] == ray).all()
    assert sum(map(len, wanted)) > 2 * len(face) > 2 * len(origins)


def test_locations_lie_in_float64_planes():
    mesh = trimesh.creation.box((1.1, 1.3, 1.7))  # not in float32
    mesh.apply_translation((1e6 / 3, 0.1, 0.1))
    origins = np.array([[1e6 / 3, 0.1, 9.0], [1e6 / 3 + 0.3, -0.2, 9.0]])
    locations, ray, _ = at.trimesh_ray(mesh).intersects_location(origins, np.tile([0.0, 0.0, -2.0], (2, 1)))
    assert ray.tolist() == [0, 1, 0, 1]
    np.testing.assert_allclose(locations[:, 2], np.repeat(mesh.bounds[::-1, 2], 2), rtol=0, atol=1e-14)
    np.testing.assert_allclose(locations[:, :2], origins[[0, 1, 0, 1], :2], rtol=0, atol=1e-9)


def test_a_ray_almost_in_a_plane_has_a_location():
    """trimesh drops it."""
    mesh = trimesh.Trimesh([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]], process=False)
    slope = 2.0**-20
    locations, ray, face = at.trimesh_ray(mesh).intersects_location([[-1.0, 0.25, slope]], [[1.0, 0.0, -slope / 1.5]])
    assert (ray.tolist(), face.tolist()) == ([0], [0])
    np.testing.assert_allclose(locations, [[0.5, 0.25, 0.0]], rtol=0, atol=1e-6)


def test_the_number_of_hits_is_limited_on_request():
    mesh, origins, directions = shells(), np.array([[-2.0, 0.125, 0.25]]), np.array([[1.0, 0.0, 0.0]])
    ours = at.trimesh_ray(mesh)
    faces, _ = ours.intersects_id(origins, directions)
    assert len(set(faces.tolist())) == 4
    for most in 1, 2, 3, 9:
        limited, ray = ours.intersects_id(origins, directions, max_hits=most)
        assert limited.tolist() == faces[:most].tolist() and not ray.any()


def test_a_mesh_contains_points_by_exact_parity():
    """Also of points straight below vertices and edges, where other methods count wrongly."""
    mesh, rng = shells(), np.random.default_rng(3)
    below = mesh.vertices[rng.integers(len(mesh.vertices), size=60)] * [1, 1, 0] + [0, 0, 1 / 32]
    points = np.concatenate([below, rays(120)[0]])
    a, b, c = corners_of(mesh).astype(np.float64).transpose(1, 0, 2)
    heights = ((points[:, None] - a) * np.cross(b - a, c - a)).sum(axis=-1)  # exact, in steps of 2^-36
    points = points[(heights != 0).all(axis=1)]
    inside = at.trimesh_ray(mesh).contains_points(points)
    assert inside.dtype == bool and inside.shape == (len(points),) and 20 < inside.sum() < len(points) - 20
    away = rng.normal(size=points.shape).astype(np.float32)  # in general position
    odd = [len({t for t, _ in hits}) % 2 == 1 for hits in exact_hits(mesh, points, away)]
    assert inside.tolist() == odd
    mesh.ray = at.trimesh_ray(mesh)
    assert (mesh.contains(points) == inside).all()
    on_the_surface = np.concatenate([mesh.vertices, mesh.vertices[mesh.edges_unique[::5]].mean(axis=1)])
    assert mesh.contains(on_the_surface).all()


def test_functions_of_trimesh_use_the_intersector():
    mesh, (points, directions) = ball(), rays(200)
    mesh.ray = at.trimesh_ray(mesh)
    assert (ray_util.contains_points(mesh.ray, points) == mesh.contains(points)).all()
    pytest.importorskip("rtree", reason="no rtree: the functions of trimesh.proximity are NOT checked")
    distance = trimesh.proximity.signed_distance(mesh, points)
    assert ((distance > 0) == mesh.contains(points)).all() and 0 < (distance > 0).sum() < len(points)
    center = np.zeros((len(directions), 3))
    reach = trimesh.proximity.longest_ray(mesh, center, directions / np.linalg.norm(directions, axis=1)[:, None])
    assert ((reach > 0.9) & (reach < 1.001)).all()
    thickness = trimesh.proximity.thickness(mesh, mesh.triangles_center[:9], method="ray")
    assert ((thickness > 1.5) & (thickness < 2.0)).all()


def test_a_changed_mesh_is_read_again_and_no_other():
    mesh = ball()
    ours = at.trimesh_ray(mesh)
    ray = [[-3.0, 0.125, 0.25]], [[1.0, 0.0, 0.0]]
    scene = ours.scene
    before = ours.intersects_location(*ray)[0]
    assert ours.scene is scene and len(before) == 2
    mesh.apply_translation((8, 0, 0))
    assert ours.scene is not scene
    np.testing.assert_allclose(ours.intersects_location(*ray)[0], before + [8, 0, 0], rtol=0, atol=1e-12)
    scene = ours.scene
    mesh.vertices[:, 0] += 1
    assert ours.scene is not scene
    np.testing.assert_allclose(ours.intersects_location(*ray)[0], before + [9, 0, 0], rtol=0, atol=1e-12)
    scene = ours.scene
    mesh.update_faces(np.arange(len(mesh.faces)) % 2 == 0)
    assert ours.scene is not scene and ours.scene.n_triangles == len(mesh.faces) == 160
    scene = ours.scene
    mesh.metadata["name"] = "no geometry"
    assert ours.scene is scene


def test_rays_without_a_direction_and_meshes_without_faces_miss():
    origins, directions = rays(20)
    ours = at.trimesh_ray(ball())
    whole = ours.intersects_first(origins, directions)
    directions[::2] = 0.0
    first = ours.intersects_first(origins, directions)
    assert (first[::2] == -1).all() and (first[1::2] == whole[1::2]).all() and (first >= 0).any()
    assert not ours.intersects_any(origins, directions)[::2].any()
    assert (ours.intersects_id(origins, directions)[1] % 2 == 1).all()
    empty = at.trimesh_ray(trimesh.Trimesh())
    assert not empty.intersects_any(origins, directions).any()
    assert not empty.contains_points(origins).any() and not len(empty.intersects_id(origins, directions)[0])


def test_rays_that_are_no_rays_miss_and_change_no_other():
    """As with Embree: NaN and infinity, and directions of any length."""
    origins, directions = rays(60)
    ours = at.trimesh_ray(ball())
    whole = ours.intersects_id(origins, directions, return_locations=True)
    bad = [np.nan, np.inf, -np.inf, 1e300, 0.0]
    mixed_origins, mixed = np.concatenate([origins, origins]), np.concatenate([directions, directions]).astype(float)
    for i in range(60):
        row = mixed if i % 2 or bad[i % 5] == 0.0 else mixed_origins
        row[60 + i] = np.where(bad[i % 5] == 0.0, 0.0, [bad[i % 5], 1.0, 0.5])
        if row is mixed and bad[i % 5] == 1e300:
            mixed[60 + i] = np.nan
    face, ray, where = ours.intersects_id(mixed_origins, mixed, return_locations=True)
    assert len(whole[0]) > 9 and (face == whole[0]).all() and (ray == whole[1]).all() and (where == whole[2]).all()
    assert (ours.intersects_any(mixed_origins, mixed)[60:] == False).all()  # noqa: E712


@pytest.mark.parametrize("scale", [2.0**-664, 2.0**-100, 2.0**70, 2.0**664])
def test_directions_may_have_any_length(scale):
    origins, directions = rays(60)
    ours = at.trimesh_ray(ball())
    wanted = ours.intersects_id(origins, directions, return_locations=True)
    found = ours.intersects_id(origins, directions.astype(np.float64) * scale, return_locations=True)
    assert len(found[0]) > 9 and all((a == b).all() for a, b in zip(found[:2], wanted[:2]))
    np.testing.assert_allclose(found[2], wanted[2], rtol=0, atol=1e-12)


@pytest.mark.parametrize("scale", [2.0**-90, 1.0, 2.0**100])
def test_directions_in_single_precision_are_traced_as_they_are(scale):
    """Alone or beside rays that are none, which are found only while rays are traced."""
    origins, directions = rays(60)
    single = directions.astype(np.float32)
    ours = at.trimesh_ray(ball())
    wanted = ours.intersects_id(origins, single.astype(np.float64), return_locations=True)
    scaled = single * np.float32(scale)
    none = np.repeat(np.float32([[0, 0, 0], [np.nan, 1, 0], [np.inf, 1, 0], [1, 0, -np.inf]]), 15, axis=0)
    for others in (none[:0], none):
        starts, both = np.concatenate([origins, origins[: len(others)]]), np.concatenate([scaled, others])
        found = ours.intersects_id(starts, both, return_locations=True)
        assert len(found[0]) > 9 and all((a == b).all() for a, b in zip(found[:2], wanted[:2]))
        np.testing.assert_allclose(found[2], wanted[2], rtol=0, atol=1e-12)
        first = ours.intersects_first(starts, both)
        assert (first[:60] == ours.intersects_first(origins, directions)).all() and (first[60:] == -1).all()
        hit = ours.intersects_any(starts, both)
        assert hit[:60].any() and not hit[60:].any() and (hit == (first >= 0)).all()


def test_arguments_are_those_of_trimesh():
    origins, directions = rays(60)
    ours = at.trimesh_ray(ball())
    first = ours.intersects_id(origins, directions, multiple_hits=False)
    for several in 0, np.bool_(False):
        assert all((a == b).all() for a, b in zip(ours.intersects_id(origins, directions, several), first))
    objects = ours.intersects_id(origins.astype(object), directions.astype(object), return_locations=1)
    assert len(objects) == 3 and objects[0].dtype == np.int64
    assert (type(ours)(ball(), scale_to_box=False).intersects_first(origins, directions) >= 0).any()


def test_locations_hash_no_unchanged_mesh():
    """A part of a tracked array would make trimesh hash the whole mesh at the next query."""
    mesh, ray = ball(), ([[-3.0, 0.125, 0.25]], [[1.0, 0.0, 0.0]])
    ours = at.trimesh_ray(mesh)
    ours.intersects_location(*ray)
    for each in mesh.vertices, mesh.faces:
        assert not each._dirty_hash
    before = [each._dirty_hash for each in (mesh.vertices, mesh.faces)]
    for ask in ours.intersects_location, ours.intersects_id, ours.intersects_first, ours.intersects_any:
        ask(*ray)
    ours.contains_points([[0, 0, 0]])
    assert [each._dirty_hash for each in (mesh.vertices, mesh.faces)] == before == [False, False]


def _split(mesh):
    pytest.importorskip("scipy", reason="no SciPy: parts of meshes are NOT checked")
    return mesh.split(only_watertight=False)


COPIES = {
    "copy": lambda mesh: mesh.copy(),
    "deepcopy": copy.deepcopy,
    "split": lambda mesh: _split(mesh)[0],
    "submesh": lambda mesh: mesh.submesh([np.arange(len(mesh.faces))], append=True),
    "slice": lambda mesh: mesh.slice_plane([0, 0, -9], [0, 0, 1]),
    "pickle": lambda mesh: pickle.loads(pickle.dumps(mesh)),
    "new": lambda mesh: trimesh.Trimesh(mesh.vertices, mesh.faces),
    "concatenate": lambda mesh: trimesh.util.concatenate([mesh, mesh.copy().apply_translation([9, 0, 0])]),
}


@pytest.mark.parametrize("way", COPIES)
def test_one_line_sets_the_intersector_of_all_meshes(way):
    own = type(ball().ray)
    with at.use_in_trimesh() as rays_of_program:
        mesh = ball()
        made = COPIES[way](mesh)
        assert type(mesh.ray) is type(made.ray) is type(at.trimesh_ray(mesh)) is not own
        assert made.ray.mesh is made and made.contains([[0, 0, 0], [5, 0, 0]]).tolist() == [True, False]
    assert type(ball().ray) is own and type(mesh.ray) is not own
    rays_of_program.undo()  # twice is once
    assert type(ball().ray) is own


def test_copies_and_pickles_work():
    ours, ray = at.trimesh_ray(ball()), ([[0.0, 0.125, 0.25]], [[1.0, 0.0, 0.0]])
    for other in copy.copy(ours), copy.deepcopy(ours), pickle.loads(pickle.dumps(ours)):
        assert other.intersects_first(*ray).tolist() == ours.intersects_first(*ray).tolist() != [-1]
    assert ours.mesh.copy().ray.intersects_any(*ray).all()


@pytest.mark.parametrize(
    "call, words",
    [
        (lambda: at.trimesh_ray(None), "the mesh is a NoneType; give a trimesh.Trimesh"),
        (lambda: at.trimesh_ray(trimesh.Scene()), "the mesh is a Scene"),
        (lambda: at.trimesh_ray(ball()).intersects_any([[0, 0, 0]], [[0, 0, 1]] * 2), "1 ray_origins and 2 ray_dir"),
        (lambda: at.trimesh_ray(ball()).intersects_any([0, 0, 0], [0, 0, 1]), r"ray_origins must be numbers \(n, 3\)"),
        (lambda: at.trimesh_ray(ball()).contains_points([[0, 0]]), r"points must be numbers \(n, 3\)"),
        (lambda: at.trimesh_ray(ball()).intersects_id([[0, 0, 0]], [[0, 0, 1]], max_hits=0), "max_hits is 0"),
    ],
)
def test_wrong_values_are_refused(call, words):
    with pytest.raises(at.InputError, match=words):
        call()
