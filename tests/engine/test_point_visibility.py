"""What points and rays are told: several lights, bool arrays, and surfaces that were hit."""

import pickle

import numpy as np
import pytest

import antumbra as at

# A floor at y = 0, and a wall in the plane x = 0 between y = 0 and y = 2 that splits it.
FLOOR = [[-4, 0, -4], [-4, 0, 4], [4, 0, 4], [-4, 0, -4], [4, 0, 4], [4, 0, -4]]
WALL = [[0, 0, -4], [0, 2, -4], [0, 2, 4], [0, 0, -4], [0, 2, 4], [0, 0, 4]]
LEFT, RIGHT, ABOVE = (
    at.PointLight((-2, 1, 0)),
    at.PointLight((2, 1, 0)),
    at.QuadLight((-1, 5, -1), (2, 0, 0), (0, 0, 2)),
)
POINTS = np.array([[[-1, 0.5, 0], [1, 0.5, 0]], [[-3, 0.1, 1], [3, 0.1, 1]]])


@pytest.fixture(scope="module")
def scene():
    return at.Scene.from_arrays(np.array(FLOOR + WALL, float))


@pytest.fixture(scope="module")
def store(scene, tmp_path_factory):
    path = tmp_path_factory.mktemp("store") / "a.antumbra"
    at.build_store(scene, path, chunk=16)
    return at.load(path)


def test_lights_are_an_axis(scene):
    found = at.visibility(scene, POINTS, [LEFT, RIGHT], spp=1)
    assert found.seen.dtype == bool and found.fraction.shape == (2, 2, 2) and found.bits.shape == (2, 2, 2, 1)
    np.testing.assert_array_equal(found.seen, [[[True, False], [False, True]]] * 2)
    assert at.visibility(scene, POINTS, [LEFT]).seen.shape == (2, 2, 1)
    assert at.visibility(scene, POINTS, LEFT).seen.shape == (2, 2)
    assert at.visibility(scene, POINTS[0, 0], [LEFT, RIGHT]).seen.tolist() == [True, False]
    assert at.visibility(scene, np.zeros((0, 3)), [LEFT, RIGHT]).seen.shape == (0, 2)


@pytest.mark.parametrize("plan", [None, "grid32+bsah+single", "srdh+wide", "cones", "bsah+chcrt"])
def test_lights_together_are_as_lights_alone(scene, store, plan):
    many = at.PointLights(np.random.default_rng(1).uniform((-4, 0.1, -4), (4, 5, 4), (70, 3)), interleave=True)
    lights = [ABOVE, many, LEFT, at.AmbientOcclusion(radius=2.0)]
    normals = (0.0, 1.0, 0.0)
    for each in [scene, store] if plan == "bsah+chcrt" else [scene]:
        together = at.visibility(each, POINTS, lights, normals, spp=8, plan=plan)
        assert together.samples.tolist() == [8, 70, 8, 8] and together.bits.shape == (2, 2, 4, 2)
        for k, light in enumerate(lights):
            alone = at.visibility(scene, POINTS, light, normals, spp=8)
            n = int(alone.samples)
            np.testing.assert_array_equal(together.fraction[..., k], alone.fraction)
            np.testing.assert_array_equal(together.seen_samples[..., k, :n], alone.seen_samples)
            assert not together.seen_samples[..., k, n:].any()
        assert 0.0 < together.fraction.mean() < 1.0


def test_samples_as_bools(scene):
    found = at.visibility(scene, POINTS, ABOVE, spp=100)
    assert found.seen_samples.shape == (2, 2, 100)
    for s in 0, 63, 64, 99:
        bit = found.bits[..., s // 64] >> np.uint64(s % 64) & np.uint64(1)
        np.testing.assert_array_equal(found.seen_samples[..., s], bit == 0)
    np.testing.assert_allclose(found.seen_samples.mean(-1), found.fraction, atol=1e-6)


def test_bad_lights_are_named(scene):
    with pytest.raises(at.InputError, match="AmbientOcclusion needs surface normals"):
        at.visibility(scene, POINTS, [LEFT, at.AmbientOcclusion()])
    with pytest.raises(at.InputError, match="not str"):
        at.visibility(scene, POINTS, [LEFT, "sun"])
    with pytest.raises(at.InputError, match="no lights"):
        at.visibility(scene, POINTS, [])


def test_progress_counts_all_lights(scene):
    calls = []
    at.visibility(scene, np.ones((5000, 3)), [LEFT, RIGHT], plan="bsah+single", progress=lambda *at: calls.append(at))
    assert calls and calls == sorted(calls) and all(total == 2 * 313 and 0 <= done <= total for done, total in calls)


def test_hits_know_their_surface(scene, store):
    origins = np.array([[1.0, 1.0, 0.5], [-3.0, 3.0, 2.0], [0.0, 9.0, 0.0]])
    directions = np.array([[-2.0, 0.0, 0.0], [0.0, -0.5, 0.0], [0.0, 1.0, 0.0]])
    for each in scene, store:
        hit = each.closest_hit(origins, directions)
        t, face, _, _ = hit
        assert t.tolist() == [0.5, 6.0, np.inf] and hit.mask.tolist() == [True, True, False]
        np.testing.assert_allclose(hit.position, [[0.0, 1.0, 0.5], [-3.0, 0.0, 2.0], [np.nan] * 3], atol=1e-6)
        np.testing.assert_allclose(hit.normal, [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [np.nan] * 3], atol=1e-12)
        assert hit.object.tolist() == [0, 0, -1] and face[2] == -1
        for side, wall in ("front", np.inf), ("back", 0.5):
            other = each.closest_hit(origins[:1], directions[:1], cull_faces=side)
            assert np.isfinite(other.position).all() == (wall == 0.5 and other.t[0] == wall)


def test_hits_of_objects():
    two = at.load(_two_boxes())
    hit = two.closest_hit(np.array([[0.0, 5.0, 0.0], [5.0, 5.0, 0.0]]), (0.0, -1.0, 0.0))
    assert [two.objects[k].name for k in hit.object] == ["here", "there"]


def test_a_pickled_hit_keeps_its_arrays(scene):
    hit = pickle.loads(pickle.dumps(scene.closest_hit(np.zeros((2, 3)) + 1.0, (0, -1, 0))))
    assert hit.face.shape == (2,) and hit.mask.all()
    for name in "position", "normal", "object":
        with pytest.raises(at.InputError, match=r"call scene\.closest_hit again"):
            getattr(hit, name)


def test_reprs_are_short(scene):
    frame = at.render(scene, scene.default_camera(40, 30), [LEFT], spp=4)
    things = [
        frame, frame.gbuffer, scene.triangles(), at.PointLights(np.zeros((500, 3))), scene,
        at.DirectionalLights(np.ones((500, 3))), at.visibility(scene, POINTS, [LEFT, ABOVE]),
        scene.closest_hit(np.zeros((500, 3)) + 1.0, (0, -1, 0)),
    ]  # fmt: skip
    for thing in things:
        assert len(repr(thing)) < 300 and repr(thing).startswith(type(thing).__name__), repr(thing)
    assert "40x30, 1 light, " in repr(frame) and "500 lights" in repr(things[3])


def test_the_mask_tells_the_background(scene):
    frame = at.render(scene, scene.default_camera(40, 30), [LEFT], spp=4)
    assert frame.mask.dtype == bool and 0 < frame.mask.mean() < 1
    np.testing.assert_array_equal(frame.mask, np.isfinite(frame.gbuffer.depth))
    assert (frame.visibility[0][~frame.mask] == 1).all()


def test_notebooks_show_pictures_and_facts(scene, tmp_path):
    frame = at.render(scene, scene.default_camera(40, 30), [LEFT], spp=4)
    frame.save(tmp_path / "a.png")
    assert frame._repr_png_() == (tmp_path / "a.png").read_bytes()
    html = at.Scene.from_arrays(np.eye(3)[None], name="<b>")._repr_html_()
    assert "&lt;b&gt;" in html and "<td>1 x 1 x 1, y up</td>" in html


def _two_boxes():
    import trimesh

    scene, box = trimesh.Scene(), trimesh.creation.box()
    scene.add_geometry(box, node_name="here", geom_name="box")
    scene.graph.update("there", geometry="box", matrix=trimesh.transformations.translation_matrix([5.0, 0.0, 0.0]))
    return scene


def test_hits_know_the_corners_of_their_faces():
    corners = np.array([[[5e5, 0, 0], [5e5 + 2, 0, 0], [5e5, 2, 0]], [[5e5, 0, -3], [5e5 + 9, 0, -3], [5e5, 9, -3.0]]])
    scene = at.Scene.from_arrays(corners)
    hit = scene.closest_hit(np.array([[5e5 + 0.5, 0.5, 9], [5e5 + 4, 4, 9], [5e5 - 1, 0, 9]]), (0.0, 0.0, -1.0))
    assert hit.face.tolist() == [0, 1, -1]
    np.testing.assert_allclose(hit.corners[:2], corners, atol=1e-6)
    assert hit.corners.shape == (3, 3, 3) and np.isnan(hit.corners[2]).all()


@pytest.mark.parametrize("far", [1e39, -1e39, 1e300])
def test_points_beyond_float32_are_refused(scene, store, far):
    """By every function that takes points of the world."""
    beyond, near, up = np.array([[0.0, far, 0.0]]), np.array([[0.0, 1.0, 0.0]]), (0.0, 1.0, 0.0)
    asks = [
        lambda: at.visibility(scene, beyond, LEFT),
        lambda: at.visibility(scene, beyond, LEFT, up),
        lambda: at.visibility(store, beyond, LEFT),
        lambda: at.line_of_sight(scene, beyond, near),
        lambda: at.line_of_sight(scene, near, beyond),
        lambda: at.line_of_sight(scene, near, beyond, target_normals=up),
        lambda: at.viewshed(scene, beyond, near),
        lambda: at.viewshed(scene, near, beyond),
        lambda: at.sun_hours(scene, at.point_sensors(beyond, [up]), "2026-06-21", place=at.Place(52.0, 4.0), step=240),
        *(lambda of=of: of.occluded(beyond, up) for of in (scene, store)),
        *(lambda of=of: of.occluded(near, targets=beyond) for of in (scene, store)),
        *(lambda of=of: of.closest_hit(beyond, up) for of in (scene, store)),
    ]
    for ask in asks:
        with pytest.raises(at.InputError, match=r"beyond float32|NaN or infinity"):
            ask()
