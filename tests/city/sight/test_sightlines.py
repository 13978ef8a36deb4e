"""Lines of sight: visible or not as the oracle says, and the nearest of all blocking faces."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import antumbra as at
import oracle
from receivers import receivers_of
from sight_scenes import scene_of
from strength import examples


def nearest_by_hand(scene, begin, end):
    """(n,) face: the nearest of all faces that the oracle says a segment meets; -1: none."""
    vertices = scene.triangles().vertices
    met = oracle.all_hits(vertices, begin, end)
    away = end.astype(np.float64) - begin
    v = vertices.astype(np.float64)
    normal = np.cross(v[:, 1] - v[:, 0], v[:, 2] - v[:, 0])
    t = ((v[:, 0] - begin[:, None].astype(np.float64)) * normal).sum(-1) / (away[:, None] * normal).sum(-1)
    t[~met] = np.inf
    return np.where(met.any(1), t.argmin(1), -1), t.min(1)


@examples(10)
@given(st.integers(0, 2**32 - 1))
def test_the_nearest_blocking_face_is_found(seed):
    scene, rng = scene_of(seed)
    a, b = rng.uniform(-1.5, 1.5, (2, 200, 3))
    found = at.line_of_sight(scene, a, b)
    begin, end = receivers_of(scene, a, None)[0], receivers_of(scene, b, None)[0]
    face, t = nearest_by_hand(scene, begin, end)
    assert np.array_equal(found.face, face)
    assert np.array_equal(found.visible, face < 0) and 0 < found.visible.sum() < 200
    assert np.array_equal(found.object, np.where(face < 0, -1, 0))
    blocked = ~found.visible
    assert np.allclose(found.distance[blocked], (t * found.length)[blocked])
    assert np.allclose(found.point[blocked], (begin + t[:, None] * (b - a) + scene.origin)[blocked], atol=1e-5)
    assert np.isnan(found.distance[~blocked]).all() and np.isnan(found.point[~blocked]).all()
    assert np.allclose(found.length, np.linalg.norm(b - a, axis=1), atol=1e-5)


def test_all_pairs_by_broadcasting():
    scene, rng = scene_of(3)
    a, b = rng.uniform(-1.5, 1.5, (7, 3)), rng.uniform(-1.5, 1.5, (11, 3))
    found = at.line_of_sight(scene, a[:, None], b[None])
    assert found.visible.shape == (7, 11) and found.point.shape == (7, 11, 3)
    assert np.array_equal(found.visible, at.visibility_matrix(scene, a, b).rows())


def test_sight_is_mutual():
    scene, rng = scene_of(4)
    a, b = rng.uniform(-1.5, 1.5, (2, 300, 3))
    there, back = at.line_of_sight(scene, a, b), at.line_of_sight(scene, b, a)
    assert np.array_equal(there.visible, back.visible)
    one = (there.face == back.face) & (there.face >= 0)
    assert one.any() and np.allclose(there.point[one], back.point[one], atol=1e-5)


BOX = np.array([[x, y, z] for x in (0, 2) for y in (0, 3) for z in (0, 1)], float)
QUADS = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
FACES = np.array([tri for a, b, c, d in QUADS for tri in ((a, b, c), (a, c, d))])


def boxes():
    """Two boxes side by side, 8 apart, at a place where float32 has few digits for them."""
    return at.Scene.from_arrays(np.concatenate([BOX, BOX + (10, 0, 0)]) + 0.1, np.concatenate([FACES, FACES + 8]))


def test_ends_on_surfaces_are_not_blocked_by_their_own_surface():
    scene = boxes()
    sensors = at.face_sensors(scene)
    right = [k for k in range(12) if sensors.normals[k, 0] > 0.9]
    left = [k for k in range(12, 24) if sensors.normals[k, 0] < -0.9]
    a, b = (sensors.points[i][:, None] for i in (right, left))
    b = b.swapaxes(0, 1)
    ask = lambda **more: at.line_of_sight(scene, a, b, **more)
    na, nb = sensors.normals[right][:, None], sensors.normals[left][None]
    fa, fb = sensors.faces[right][:, None], sensors.faces[left][None]
    assert ask(normals=na, target_normals=nb).visible.all()
    assert ask(faces=fa, target_faces=fb).visible.all()
    behind = ask(normals=-na, faces=fa)
    assert not behind.visible.any() and np.array_equal(behind.face, np.broadcast_to(fa, (2, 2)))
    assert np.allclose(behind.distance, 0.0)
    beyond = ask(normals=na, target_normals=-nb, target_faces=fb)
    assert not beyond.visible.any() and np.array_equal(beyond.face, np.broadcast_to(fb, (2, 2)))
    assert np.allclose(beyond.distance, beyond.length)


def test_a_window_pane_does_not_hide_the_pane_itself():
    """The middle of a triangle, which float32 rounds to either side of it, seen from both sides."""
    rng = np.random.default_rng(5)
    corners = rng.uniform(-1, 1, (40, 3, 3)) + 3 * np.arange(40)[:, None, None]
    scene = at.Scene.from_arrays(corners)
    panes = at.face_sensors(scene)
    for side in (1.0, -1.0):
        eyes = panes.points + 0.1 * side * panes.normals
        assert at.line_of_sight(scene, eyes, panes.points, target_faces=panes.faces).visible.all()
        assert at.line_of_sight(scene, panes.points, eyes, faces=panes.faces).visible.all()
    step = 0.1 * panes.normals
    assert not at.line_of_sight(scene, panes.points + step, panes.points - step).visible.any()


def test_the_object_that_blocks_is_named(tmp_path):
    text = "".join(f"v {x} {y} {z}\n" for x in (0, 5) for y, z in ((-1, -1), (1, -1), (0, 1)))
    (tmp_path / "two.obj").write_text(f"{text}usemtl near\nf 1 2 3\nusemtl far\nf 4 5 6\n")
    scene = at.load(tmp_path / "two.obj")
    found = at.line_of_sight(scene, [-3, 0, 0], [[9, 0, 0], [-1, 0, 0]])
    back = at.line_of_sight(scene, [9, 0, 0], [-3, 0, 0])
    near, far = np.argsort(scene.triangles().vertices[:, 0, 0])
    assert found.visible.tolist() == [False, True] and found.face.tolist() == [near, -1] and back.face == far
    assert found.object.tolist() == [scene.object_of_face[near], -1] and back.object == scene.object_of_face[far]
    assert scene.objects[int(back.object)] != scene.objects[found.object[0]]
    assert np.allclose(found.point[0], (0, 0, 0)) and np.isclose(found.distance[0], 3.0)
    assert np.allclose(back.point, (5, 0, 0)) and np.isclose(back.distance, 4.0)


@pytest.mark.parametrize(
    "arguments, words",
    [
        ({"observers": np.zeros((3, 2))}, "observers must have shape"),
        ({"observers": np.zeros((3, 3)), "targets": np.ones((4, 3))}, "do not broadcast"),
        ({"observers": [np.inf, 0, 0]}, "NaN or infinity"),
        ({"normals": [0, 0, 0]}, "zero"),
        ({"normals": np.ones((2, 3))}, "do not broadcast"),
        ({"faces": 30}, "from -1 to 23"),
        ({"target_faces": 0.5}, "whole numbers"),
    ],
)
def test_bad_input(arguments, words):
    given = {"observers": [0, 0, 0], "targets": [1, 1, 1], **arguments}
    with pytest.raises(at.InputError, match=words):
        at.line_of_sight(scene_of(1)[0], **given)


def test_no_pairs():
    assert at.line_of_sight(scene_of(1)[0], np.empty((0, 3)), np.empty((0, 3))).visible.shape == (0,)
