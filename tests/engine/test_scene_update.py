"""Updates of the geometry: everything that reads the scene afterwards has the bits of a new scene in the same frame."""

import pickle
import threading

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import antumbra as at
import oracle
from antumbra.bvh.tree_quality import validate
from antumbra.engine.auto import cost_model
from antumbra.engine.plan import covering_plans, parse_plan
from antumbra.engine.sources.in_memory_source import RAY_PLANS
from antumbra.scene.scene_bounds import flush_to_zero
from cutout_scenes import scene_with_cutouts
from devices import device_plans
from strategies import soups
from strength import examples

LAMP = at.QuadLight((-1, 6, -1), (2, 0, 0), (0, 0, 2))
CAMERA = at.Camera((0, 4, 9), (0, -0.5, 0), width=40, height=32)
FLOOR = np.array([[[-9, -3, -9], [-9, -3, 9], [9, -3, 9]], [[-9, -3, -9], [9, -3, 9], [9, -3, -9]]], float)


def soup(seed, n=300):
    """(n + 2, 3, 3) float64: small triangles above a floor."""
    rng = np.random.default_rng(seed)
    scattered = rng.normal(size=(n, 1, 3)) * (2, 1, 2) + rng.normal(size=(n, 3, 3)) * 0.3
    return np.concatenate([scattered, FLOOR])


def new_scene(vertices, scene, **arguments):
    """A new scene from world coordinates, in the frame of another one."""
    new = at.Scene.from_arrays(vertices, **arguments)
    new.origin = scene.origin.copy()
    return new


def rays_in(scene, n=80, seed=0):
    """World origins (n, 3) float64, and directions (n, 3) float32, half of them towards corners of triangles."""
    rng = np.random.default_rng(seed)
    lower, upper = scene.bounds
    margin = 0.25 * (upper - lower).max()
    origins, ends = rng.uniform(lower - margin, upper + margin, (2, n, 3))
    triangles = scene.triangles()
    faces = rng.integers(0, len(triangles.vertices), n // 2)
    weights = rng.dirichlet(np.ones(3), n // 2)
    ends[: n // 2] = np.einsum("nk,nkx->nx", weights, triangles.vertices[faces].astype(float)) + triangles.origin
    directions = (ends - origins).astype(np.float32)
    directions[(directions == 0.0).all(1)] = 1.0
    return origins, directions


def assert_like_new(scene, new, rays):
    """All answers of the scene are those of a new one, and of brute force. Return the share of blocked rays."""
    moved, expected = scene.triangles(), new.triangles()
    assert moved.vertices.tobytes() == expected.vertices.tobytes()
    np.testing.assert_array_equal(moved.origin, expected.origin)
    assert (moved.solid is None) == (expected.solid is None)
    if moved.solid is not None:
        np.testing.assert_array_equal(moved.solid, expected.solid)
    corners = moved.vertices.reshape(-1, 3).astype(np.float64)
    np.testing.assert_array_equal(scene.bounds, np.stack([corners.min(0), corners.max(0)]) + scene.origin)

    local = flush_to_zero((rays[0] - scene.origin).astype(np.float32))
    blocked = scene.occluded(*rays)
    np.testing.assert_array_equal(blocked, new.occluded(*rays))
    np.testing.assert_array_equal(blocked, oracle.occluded(moved.vertices, local, rays[1]))
    hit, other = scene.closest_hit(*rays), new.closest_hit(*rays)
    assert all(a.tobytes() == b.tobytes() for a, b in zip(hit, other))
    np.testing.assert_array_equal(hit.face, oracle.closest_hit(moved.vertices, local, rays[1])[1])
    for name in ("position", "normal", "corners", "object"):
        np.testing.assert_array_equal(getattr(hit, name), getattr(other, name))
    assert all(a.tobytes() == b.tobytes() for a, b in zip(scene.all_hits(*rays), new.all_hits(*rays)))
    for query in (lambda each: each.count_hits(*rays, merge="surface"), lambda each: each.contains(rays[0])):
        np.testing.assert_array_equal(query(scene), query(new))
    return blocked.mean()


@given(vertices=soups(40), seeds=st.lists(st.integers(0, 2**32 - 1), min_size=1, max_size=3), data=st.data())
@examples(40)
def test_any_deformation(vertices, seeds, data):
    """Repeated updates by float32 and float64 soups, with triangles that lose or regain their area."""
    scene = at.Scene.from_arrays(vertices)
    rays = rays_in(scene)
    scene.occluded(*rays)
    size = float(np.ptp(vertices.astype(np.float64), axis=(0, 1)).max())
    for seed in seeds:
        rng = np.random.default_rng(seed)
        amount = data.draw(st.sampled_from([0.0, 0.01, 0.3, 5.0]))
        moved = vertices + rng.normal(0.0, amount * size, vertices.shape)
        flat = rng.random(len(moved)) < data.draw(st.sampled_from([0.0, 0.3]))
        moved[flat, 2] = moved[flat, 1]
        moved = moved.astype(data.draw(st.sampled_from([np.float32, np.float64])))
        scene.update(moved)
        assert_like_new(scene, new_scene(moved, scene), rays_in(scene, seed=seed % 100))


@pytest.mark.parametrize("builds", [0.0, 1e9])
def test_refitted_and_rebuilt_trees(monkeypatch, builds):
    """The tree is refitted while builds are expensive, and built anew if they cost nothing."""
    monkeypatch.setattr(cost_model, "build_seconds", lambda builder, n: builds if builder == cost_model.GOOD else 1e9)
    scene = at.Scene.from_arrays(soup(0))
    tree = lambda: scene.engine.with_options(RAY_PLANS[0], None, None).accelerated().bvh
    scene.occluded(*rays_in(scene))
    trees, shares = [tree()], []
    for seed in range(1, 4):
        moved = soup(seed)
        scene.update(moved)
        shares.append(assert_like_new(scene, new_scene(moved, scene), rays_in(scene, 400, seed)))
        trees.append(tree())
        validate(trees[-1], scene.triangles().vertices)
        assert scene.engine.source.ray_lists.plan == parse_plan(RAY_PLANS[0])
    assert [each.prim_ids is trees[0].prim_ids for each in trees[1:]] == [builds > 0.0] * 3
    assert all(0.1 < share < 0.95 for share in shares)


def test_rays_pay_for_a_rebuild():
    """A bad tree is refitted for few rays, and rebuilt for many."""
    scene = at.Scene.from_arrays(soup(0, 3000))
    tree = lambda: scene.engine.with_options(RAY_PLANS[0], None, None).accelerated().bvh
    origins, directions = rays_in(scene, 16)
    scene.occluded(origins, directions)
    first = tree()
    scene.update(soup(1, 3000)[np.random.default_rng(0).permutation(3002)])
    few = scene.occluded(origins, directions)
    assert tree().prim_ids is first.prim_ids
    scene.update(scene.triangles().vertices + scene.origin)
    many = scene.occluded(np.tile(origins, (16000, 1)), np.tile(directions, (16000, 1)))
    assert tree().prim_ids is not first.prim_ids
    np.testing.assert_array_equal(many.reshape(16000, -1), np.broadcast_to(few, (16000, 16)))
    assert 0 < few.mean() < 1


@pytest.mark.parametrize("threads", [1, 2])
def test_trees_of_many_parts(monkeypatch, threads):
    """A tree whose parts are refitted by several threads, and a mesh whose vertices are shared."""
    monkeypatch.setattr(cost_model, "build_seconds", lambda builder, n: 1e9)
    x, z = np.meshgrid(np.linspace(-1, 1, 181), np.linspace(-1, 1, 181))
    corner = (np.arange(180)[:, None] * 181 + np.arange(180)).ravel()
    faces = np.concatenate([corner + [[0], [181], [1]], corner + [[1], [181], [182]]], axis=1).T
    wave = lambda t: np.stack([x, 0.2 * np.sin(7 * x + t) * np.cos(5 * z), z + 0.05 * np.sin(9 * x + t)], -1)
    scene = at.Scene.from_arrays(wave(0.0).reshape(-1, 3), faces)
    rays = rays_in(scene, 20_000)
    scene.occluded(*rays, threads=threads)
    first = scene.engine.with_options(RAY_PLANS[0], None, None).accelerated().bvh
    assert len(first.nodes) > 16384
    for t in (0.1, 0.2, 0.3):
        scene.update(wave(t).reshape(-1, 3), threads=threads)
        new = new_scene(wave(t).reshape(-1, 3), scene, faces=faces)
        blocked = scene.occluded(*rays, threads=threads)
        np.testing.assert_array_equal(blocked, new.occluded(*rays))
        hit, other = scene.closest_hit(*rays), new.closest_hit(*rays)
        assert all(a.tobytes() == b.tobytes() for a, b in zip(hit, other))
        bvh = scene.engine.with_options(RAY_PLANS[0], None, None).accelerated().bvh
        assert bvh.prim_ids is first.prim_ids and bvh is not first
        validate(bvh, scene.triangles().vertices)
        assert 0.1 < blocked.mean() < 0.9


def test_a_face_that_regains_its_area_is_hit():
    """Trees omit triangles without area, so refitting alone would lose this one."""
    vertices, flat = soup(3, 50), soup(3, 50)
    flat[10:20] = flat[10:20, :1]
    scene = at.Scene.from_arrays(flat)
    rays = vertices[:50].mean(1) + (0, 0.001, 0), np.tile(np.array([0, -1, 0], np.float32), (50, 1))
    ends = {"tmax": 0.002}
    assert not scene.closest_hit(*rays, **ends).mask[10:20].any()
    scene.update(vertices)
    assert scene.closest_hit(*rays, **ends).mask[10:20].any()
    assert_like_new(scene, new_scene(vertices, scene), rays_in(scene))
    scene.update(flat)
    assert_like_new(scene, new_scene(flat, scene), rays_in(scene))
    assert not scene.closest_hit(*rays, **ends).mask[10:20].any()


# --- Every plan, picture and job --------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def stages():
    """Three soups, and the visibility bits and frames of new scenes made of them, in the frame of the first."""
    soups_, first = [soup(seed) for seed in range(3)], at.Scene.from_arrays(soup(0))
    scenes = [new_scene(vertices, first) for vertices in soups_]
    points = np.random.default_rng(5).uniform((-4, -2.9, -4), (4, 1, 4), (200, 3))
    bits = [at.visibility(each, points, [LAMP], spp=8, plan="bsah+single").bits for each in scenes]
    frames = [at.render(each, CAMERA, [LAMP], spp=4, plan="bsah+single") for each in scenes]
    assert len({each.tobytes() for each in bits}) == 3 == len({frame.bits[0].tobytes() for frame in frames})
    return soups_, points, bits, frames


REFITTING = [at.Plan(trace=name, update="refit") for name in ("chcrt", "multifrusta", "wide")]


@pytest.mark.parametrize("plan", [*covering_plans(), *REFITTING, *device_plans()], ids=str)
def test_every_plan(stages, plan):
    """Engines and renderers that have answered before see each new geometry, and the first one when it returns."""
    vertices, points, bits, frames = stages
    scene = at.Scene.from_arrays(vertices[0])
    renderer, engine = at.Renderer(scene, plan, 2), at.Engine(scene, plan, 2)
    receivers = at.Receivers.in_space(points, scene.origin)
    for k in (0, 1, 2, 0):
        if k or renderer.engine.data.moved is not None:
            scene.update(vertices[k])
        found = renderer.render(CAMERA, [LAMP], spp=4)
        np.testing.assert_array_equal(found.bits[0], frames[k].bits[0])
        np.testing.assert_array_equal(found.image, frames[k].image)
        np.testing.assert_array_equal(engine.visibility(receivers, [LAMP], spp=8).bits[:, 0], bits[k][:, 0])
        np.testing.assert_array_equal(at.visibility(scene, points, [LAMP], spp=8, plan=plan).bits, bits[k])


@pytest.mark.parametrize("gbuffer", ["raster", "rays"])
def test_surfaces_and_diffuse_light(stages, gbuffer):
    vertices, first = stages[0], at.Scene.from_arrays(stages[0][0])
    renderer = at.Renderer(first, None, 2, gbuffer)
    options = {"spp": 2, "bounce": 2, "ground": True}
    renderer.render(CAMERA, [LAMP], **options)
    first.update(vertices[1])
    found = renderer.render(CAMERA, [LAMP], **options)
    new = new_scene(first.triangles().vertices + first.origin, first)
    expected = at.render(new, CAMERA, [LAMP], **options)
    np.testing.assert_array_equal(found.gbuffer.face, expected.gbuffer.face)
    np.testing.assert_array_equal(found.gbuffer.depth, expected.gbuffer.depth)
    np.testing.assert_array_equal(found.indirect, expected.indirect)
    np.testing.assert_array_equal(found.image, expected.image)


def test_default_views_bounds_and_jobs():
    vertices, moved = (np.round(soup(seed) * 64) / 64 for seed in (0, 1))
    moved += (4, 1, 0)
    scene = at.Scene.from_arrays(vertices)
    scene.default_camera(), scene.default_lights(), scene.ground_height()
    scene.update(moved)
    new = new_scene(moved, scene)
    np.testing.assert_array_equal(scene.bounds, new.bounds)
    for kind in ("perspective", "top", "orthographic"):
        one, other = (each.default_camera(32, 32, kind) for each in (scene, new))
        np.testing.assert_array_equal(one.position, other.position)
        np.testing.assert_array_equal(one.target, other.target)
    assert scene.ground_height() == new.ground_height() != at.Scene.from_arrays(vertices).ground_height()
    np.testing.assert_array_equal(scene.default_light().corner, new.default_light().corner)
    np.testing.assert_array_equal(at.render(scene, spp=2).image, at.render(new, spp=2).image)
    np.testing.assert_array_equal(scene.view.points, new.view.points)
    tables = [at.sky_view(each, at.face_sensors(each), threads=2) for each in (scene, new)]
    for one, other in zip(*(table.columns.values() for table in tables)):
        np.testing.assert_array_equal(one.values, other.values)
    sightlines = [at.line_of_sight(each, soup(4)[:50, 0], soup(5)[:50, 0]) for each in (scene, new)]
    np.testing.assert_array_equal(sightlines[0].visible, sightlines[1].visible)
    assert 0 < sightlines[0].visible.mean() < 1


def test_cut_outs_move_with_their_faces():
    scene, new = scene_with_cutouts(), scene_with_cutouts()
    vertices = scene.triangles().vertices + scene.origin
    rays, points = rays_in(scene, 300), np.random.default_rng(1).uniform((-3, -0.9, -3), (3, 2, 3), (100, 3))
    before = scene.occluded(*rays), at.visibility(scene, points, [LAMP]).bits
    moved = vertices + (0.5, 0.75, -1.0) * np.sin(vertices[..., :1])
    scene.update(moved)
    new = new_scene(moved, scene)
    new.cutouts = scene.cutouts
    for query in (lambda each: each.occluded(*rays), lambda each: at.visibility(each, points, [LAMP]).bits):
        np.testing.assert_array_equal(query(scene), query(new))
    assert (scene.occluded(*rays) != before[0]).any() and (at.visibility(scene, points, [LAMP]).bits != before[1]).any()
    scene.ignore_alpha()
    new.ignore_alpha()
    again = at.Engine(scene), at.Engine(new)
    np.testing.assert_array_equal(again[0].occluded(*rays), again[1].occluded(*rays))
    assert (again[0].occluded(*rays) != scene_with_cutouts().occluded(*rays)).any()


def test_textures_and_normals_stay():
    """A rotation turns shading normals with their faces, as if they had been given rotated."""
    rng = np.random.default_rng(0)
    x, z = np.meshgrid(np.linspace(-2, 2, 9), np.linspace(-2, 2, 9))
    vertices = np.stack([x, 0.3 * np.sin(2 * x), z], -1).reshape(-1, 3)
    a = (np.arange(8)[:, None] * 9 + np.arange(8)).ravel()
    faces = np.concatenate([np.stack([a, a + 9, a + 1], 1), np.stack([a + 1, a + 9, a + 10], 1)])
    look = {"uv": vertices[:, ::2], "texture": rng.integers(0, 256, (8, 8, 3)).astype(np.uint8)}
    normals = np.broadcast_to((0.0, 1.0, 0.0), vertices.shape)
    scene = at.Scene.from_arrays(vertices, faces, normals=normals, **look)
    turn = np.array([[0, -1, 0, 0], [1, 0, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]], float)
    appearance = scene.appearance
    scene.update(transform=turn)
    turned = vertices @ turn[:3, :3].T
    new = new_scene(turned, scene, faces=faces, normals=normals @ turn[:3, :3].T, **look)
    assert scene.appearance is appearance
    camera = at.Camera((-6, 1, 2), (0, 0, 0), width=48, height=48)
    one, other = (at.render(each, camera, [at.PointLight((-5, 3, 1), intensity=400.0)], spp=1) for each in (scene, new))
    np.testing.assert_allclose(one.image, other.image, atol=2e-3)
    assert np.ptp(one.image) > 0.1
    again = at.Scene(scene.source)  # by corner, as updated scenes are saved
    np.testing.assert_array_equal(again.appearance.uv, scene.appearance.uv)
    np.testing.assert_array_equal(again.appearance.normals, scene.appearance.normals)


# --- Objects and arguments --------------------------------------------------------------------------------------------


def matrix(seed):
    """(4, 4) float64: a rotation, a scaling and a translation."""
    rng = np.random.default_rng(seed)
    out = np.eye(4)
    out[:3, :3] = np.linalg.qr(rng.normal(size=(3, 3)))[0] * rng.uniform(0.5, 2.0)
    out[:3, 3] = rng.uniform(-3, 3, 3)
    return out


def place(transform, points):
    """Points (..., 3) transformed in float64, added from left to right."""
    x, y, z = np.moveaxis(points.astype(np.float64), -1, 0)
    return np.stack([m[0] * x + m[1] * y + m[2] * z + m[3] for m in transform[:3]], -1)


@pytest.fixture
def parts():
    """A trimesh scene of three objects, and their corners in world space: [(n, 3, 3) float64]."""
    import trimesh

    made, shapes = trimesh.Scene(), {}
    for k, name in enumerate(("wheel left", "wheel right", "body")):
        mesh = trimesh.creation.icosphere(1) if k < 2 else trimesh.creation.box((3, 1, 1))
        mesh.apply_translation((2.0 * k, 0.1, 0.0))
        made.add_geometry(mesh, node_name=name, geom_name=name)
    scene = at.Scene.from_mesh(made)
    for piece, info in zip(scene.source.pieces(0.0), scene.objects):
        shapes[info.name] = piece.vertices[0][piece.faces]
    return scene, shapes


def test_objects_by_name_index_and_entry(parts):
    scene, shapes = parts
    names = [each.name for each in scene.objects]
    of = lambda name: scene.triangles().vertices[scene.object_of_face == names.index(name)]
    local = lambda corners: (corners - scene.origin).astype(np.float32)
    rest = {name: of(name).copy() for name in names}
    scene.update(objects="wheel*", transform=matrix(0))
    scene.update(objects=scene.objects[names.index("body")], transform=matrix(1))
    for name, seed in (("wheel left", 0), ("wheel right", 0), ("body", 1)):
        np.testing.assert_array_equal(of(name), local(place(matrix(seed), shapes[name])))
    scene.update(objects=[names.index("body"), "wheel left"], transform=np.stack([np.eye(4), matrix(2)]))
    np.testing.assert_array_equal(of("body"), rest["body"])  # transforms do not add up
    np.testing.assert_array_equal(of("wheel left"), local(place(matrix(2), shapes["wheel left"])))
    np.testing.assert_array_equal(of("wheel right"), local(place(matrix(0), shapes["wheel right"])))
    scene.update(transform=np.eye(4))
    assert all((of(name) == rest[name]).all() for name in names)
    assert not (place(matrix(0), shapes["body"]) == shapes["body"]).any()


def test_transforms_apply_to_the_latest_vertices(parts):
    scene, _ = parts
    given_vertices = scene.triangles().vertices.astype(np.float64) + scene.origin + (0, 7, 0)
    scene.update(given_vertices)
    rest = given_vertices
    chosen = np.isin(scene.object_of_face, [k for k, each in enumerate(scene.objects) if "wheel" in each.name])
    for seed in (0, 1):
        scene.update(objects="wheel*", transform=matrix(seed))
        expected = (np.where(chosen[:, None, None], place(matrix(seed), rest), rest) - scene.origin).astype(np.float32)
        np.testing.assert_array_equal(scene.triangles().vertices, expected)
    assert chosen.any() and not chosen.all()
    new = new_scene(np.where(chosen[:, None, None], place(matrix(1), rest), rest), scene)
    new.data._object_of_face = scene.object_of_face
    assert_like_new(scene, new, rays_in(scene))


@examples(40)
@given(
    far=st.sampled_from([0.0, 0.3, 1e3 + 0.3, -1e6 + 0.7, 1e9 + 0.3, 2.0**40]),
    dtype=st.sampled_from([np.float64, np.float32]),
    indexed=st.booleans(),
    pickled=st.booleans(),
    seed=st.integers(0, 3),
)
def test_a_transform_applies_to_the_vertices_as_they_were_given(far, dtype, indexed, pickled, seed):
    """In float64, however far from the frame, and however often; not to vertices that were rounded in the frame."""
    corners = soup(seed, 20)
    vertices, faces = corners.reshape(-1, 3), np.arange(3 * len(corners)).reshape(-1, 3)
    scene = at.Scene.from_arrays(vertices, faces)
    moved_vertices = (vertices[::-1] + [far, -far, 0.0]).astype(dtype)
    argument = moved_vertices.copy() if indexed else moved_vertices.reshape(-1, 3, 3).copy()
    scene.update(argument)
    argument[...] = 0.0  # the caller's array may change
    if pickled:
        scene = pickle.loads(pickle.dumps(scene))
    back = matrix(seed)
    back[:3, 3] -= back[:3, :3] @ [far, -far, 0.0]
    for transform in (matrix(1), back, np.eye(4), back):
        scene.update(transform=transform)
        rest = moved_vertices.astype(np.float64).reshape(-1, 3, 3)
        expected = flush_to_zero((place(transform, rest) - scene.origin).astype(np.float32))
        np.testing.assert_array_equal(scene.triangles().vertices, expected)
        world = expected.reshape(-1, 3).astype(np.float64)
        np.testing.assert_array_equal(scene.bounds, np.stack([world.min(0), world.max(0)]) + scene.origin)


def test_vertices_that_the_frame_holds_exactly_take_no_memory_of_their_own():
    """Only vertices that lose bits in the frame are copied."""
    grid = np.round(soup(1) * 256.0) / 256.0
    scene = at.Scene.from_arrays(grid)
    scene.update(grid + 0.25)
    assert scene.data._movable._rest is None
    scene.update(grid + 0.3)
    assert sum(piece.vertices.nbytes for piece in scene.data._movable._rest) == grid.nbytes


def test_objects_that_share_a_piece():
    """City objects are one mesh, whose faces belong to several objects."""
    from antumbra.scene.mesh import StaticMeshes, make_mesh

    class Owned(StaticMeshes):
        def pieces(self, time):
            for piece in super().pieces(time):
                yield piece._replace(owners=owners)

    vertices, owners = soup(0, 30), (np.arange(32) % 3).astype(np.int32)
    faces = np.arange(96).reshape(-1, 3)
    source = Owned([make_mesh("city", vertices.reshape(-1, 3), faces, None, "city")], "city")
    source.objects = [at.ObjectInfo(name, k, 0) for k, name in enumerate("abc")]
    scene = at.Scene(source)
    scene.update(objects=["c", "a"], transform=np.stack([matrix(0), matrix(1)]))
    expected = vertices.copy()
    expected[owners == 2], expected[owners == 0] = (
        place(matrix(0), vertices[owners == 2]),
        place(matrix(1), vertices[owners == 0]),
    )
    np.testing.assert_array_equal(scene.triangles().vertices, (expected - scene.origin).astype(np.float32))


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
@pytest.mark.parametrize("unused", [False, True])
def test_vertices_in_the_order_of_the_arrays(dtype, unused):
    rng = np.random.default_rng(0)
    vertices, faces = rng.normal(size=(40, 3)) + (5e6, 0, 4.5e5), rng.integers(0, 40, (30, 3))
    if unused:
        faces[faces % 7 == 3] = 0
    assert (len(np.unique(faces)) < 40) == unused or not unused
    scene = at.Scene.from_arrays(vertices, faces)
    moved = (vertices + rng.normal(0, 0.5, (40, 3))).astype(dtype)
    scene.update(moved)
    assert_like_new(scene, new_scene(moved, scene, faces=faces), rays_in(scene))
    scene.update(moved[faces])
    assert_like_new(scene, new_scene(moved, scene, faces=faces), rays_in(scene))


def test_bad_input_changes_nothing(parts, tmp_path):
    scene, _ = parts
    rays = rays_in(scene)
    scene.update(objects="body", transform=matrix(0))
    before, hit, bounds = scene.triangles(), scene.closest_hit(*rays), scene.bounds
    good = before.vertices + scene.origin
    bad, far = good.copy(), good.copy()
    bad[7, 1, 2], far[3, 0, 0] = np.nan, 1e19
    n, shear = len(good), np.eye(4)
    shear[3, 0] = 0.1
    cases = [
        ({"vertices": bad}, "vertex 22 is .*nan"),
        ({"vertices": far}, "units apart"),
        ({"vertices": good[1:]}, rf"give \({n}, 3, 3\)"),
        ({"vertices": good.reshape(-1, 3)[:5]}, r"shape \(5, 3\)"),
        ({"vertices": good.astype(str)}, "vertices"),
        ({}, "either vertices, or a transform"),
        ({"vertices": good, "transform": np.eye(4)}, "either vertices, or a transform"),
        ({"vertices": good, "objects": "body"}, "either vertices, or a transform"),
        ({"objects": "wing", "transform": np.eye(4)}, "no object is called 'wing'; there are: body"),
        ({"objects": 3, "transform": np.eye(4)}, "from 0 to 2"),
        ({"objects": 1.5, "transform": np.eye(4)}, "names, indices, or entries"),
        ({"objects": "wheel*", "transform": np.zeros((3, 4, 4))}, r"or \(2, 4, 4\)"),
        ({"transform": shear}, "last row"),
        ({"transform": np.full((4, 4), np.inf)}, "finite"),
        ({"transform": np.diag([1e19, 1, 1, 1.0])}, "units apart"),
        ({"vertices": good, "threads": 0}, "threads"),
    ]
    for arguments, message in cases:
        with pytest.raises(at.InputError, match=message):
            scene.update(**arguments)
        assert scene.triangles() is before and scene.bounds is bounds
        assert all((a == b).all() for a, b in zip(scene.closest_hit(*rays), hit))
    scene.update(objects="wheel*", transform=matrix(1))
    assert not (scene.triangles().vertices == before.vertices).all()


def test_animations_and_stores_refuse(tmp_path):
    class Lasting:
        duration = 2.0

        def __init__(self, source):
            self._source = source

        def __getattr__(self, name):
            return getattr(self._source, name)

    still = at.Scene.from_arrays(soup(0, 20))
    store = at.load(at.build_store(still, tmp_path / "still.antumbra").path)
    for scene, message in ((at.Scene(Lasting(still.source)), "animation"), (store, "in a store")):
        with pytest.raises(at.InputError, match=message):
            scene.update(soup(1, 20))


# --- Threads, copies and memory ---------------------------------------------------------------------------------------


def test_queries_of_other_threads_see_one_geometry():
    """Each answer is that of the geometry before or after an update, though updates never pause."""
    stages = [soup(seed, 500) for seed in (0, 1)]
    scene = at.Scene.from_arrays(stages[0])
    rays = rays_in(scene, 600)
    points = np.random.default_rng(2).uniform((-4, -2.9, -4), (4, 1, 4), (100, 3))

    def answers(each):
        hit = each.closest_hit(*rays)
        frame = at.render(each, CAMERA, [LAMP], spp=1, threads=1)
        seen = at.visibility(each, points, [LAMP], spp=4).bits
        return [a.tobytes() for a in (each.occluded(*rays), np.nan_to_num(hit.position), seen, frame.bits[0])]

    expected = [set(pair) for pair in zip(*(answers(new_scene(vertices, scene)) for vertices in stages))]
    assert all(len(pair) == 2 for pair in expected)
    answers(scene)
    found, stop = [set() for _ in expected], threading.Event()

    def ask():
        for _ in range(12):
            for k, answer in enumerate(answers(scene)):
                found[k].add(answer)

    def move():
        k = 0
        while not stop.wait(0.002):
            k = 1 - k
            scene.update(stages[k])

    askers, mover = [threading.Thread(target=ask) for _ in range(2)], threading.Thread(target=move)
    for thread in (*askers, mover):
        thread.start()
    for thread in askers:
        thread.join()
    stop.set()
    mover.join()
    assert all(some <= pair for some, pair in zip(found, expected))
    assert sum(len(some) == 2 for some in found) >= 2  # both geometries were seen


def test_copies_have_the_moved_geometry():
    scene = at.Scene.from_arrays(soup(0, 60))
    scene.update(soup(1, 60))
    scene.update(transform=matrix(0))
    copy = pickle.loads(pickle.dumps(scene))
    rays = rays_in(scene)
    assert copy.triangles().vertices.tobytes() == scene.triangles().vertices.tobytes()
    np.testing.assert_array_equal(copy.occluded(*rays), scene.occluded(*rays))
    copy.update(transform=matrix(1))
    scene.update(transform=matrix(1))
    assert copy.triangles().vertices.tobytes() == scene.triangles().vertices.tobytes()


def test_arrays_from_before_do_not_change():
    scene = at.Scene.from_arrays(soup(0, 60))
    rays, kept = rays_in(scene), []
    for seed in range(1, 7):
        scene.update(soup(seed, 60))
        hit = scene.closest_hit(*rays)
        kept.append((scene.triangles().vertices, scene.triangles().vertices.copy(), hit, hit.face.copy(), seed))
    for vertices, copy, hit, face, seed in kept:
        np.testing.assert_array_equal(vertices, copy)
        np.testing.assert_array_equal(hit.face, face)
        expected = new_scene(soup(seed, 60), scene).closest_hit(*rays)
        np.testing.assert_array_equal(hit.position, expected.position)
