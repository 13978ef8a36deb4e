"""What default pictures show: detail without outliers, rooms from inside, and the axis that points up."""

import numpy as np
import pytest

import antumbra as at
from antumbra.engine.scene_loading import load
from antumbra.scene.scene_bounds import guess_z_up
from gltf_files import TETRAHEDRON, TETRAHEDRON_FACES, single


def block(lower, upper, inward=False):
    """(12, 3, 3): the faces of a box, which face outward or inward."""
    lower, upper = np.asarray(lower, float), np.asarray(upper, float)
    faces = []
    for axis in range(3):
        u, v = np.eye(3)[(axis + 1) % 3], np.eye(3)[(axis + 2) % 3]
        for side in (0.0, 1.0):
            a, b, c, d = (side * np.eye(3)[axis] + s * u + t * v for s, t in ((0, 0), (1, 0), (1, 1), (0, 1)))
            turn = 1 if (side == 1.0) != inward else -1
            faces += [np.array([a, b, c])[::turn], np.array([a, c, d])[::turn]]
    return lower + np.array(faces) * (upper - lower)


def blocks(n, size, seed=0):
    """Many small blocks on a floor."""
    corners = np.random.default_rng(seed).uniform(-1, 1, (n, 3)) * size * (1, 0, 1)
    return np.concatenate([block(c, c + (0.02, 0.05, 0.02) * np.array(size)) for c in corners])


def test_a_lone_part_far_away_does_not_move_the_camera():
    detail = blocks(100, (1, 1, 1))
    distances = []
    for place in (np.zeros(3), np.full(3, 500.0)):
        scene = at.Scene.from_arrays(np.concatenate([detail, block(place, place + 0.1)]))
        distances.append(np.linalg.norm(scene.default_camera(64, 64).position))
    assert distances[1] < 4 * distances[0]


@pytest.mark.parametrize("up", ["y", "z"])
def test_a_room_is_shown_from_inside(up):
    around = np.concatenate([block((-5, -1, -3), (5, 3, 3), inward=True), block((-5.2, -1.2, -3.2), (5.2, 3.2, 3.2))])
    room = np.concatenate([around, blocks(60, (4, 1, 2.5))])
    if up == "z":
        room = room[..., [0, 2, 1]] * (1, -1, 1)
    scene = at.Scene.from_arrays(room, up=up)
    eye = scene.default_camera(64, 64).position
    assert scene.view.room is not None and (np.abs(eye[[0]]) < 5).all()
    assert (eye > scene.bounds[0]).all() and (eye < scene.bounds[1]).all()
    assert [type(light) for light in scene.default_lights()] == [at.SphereLight, at.Sky]
    frame = at.render(scene, scene.default_camera(32, 32))
    assert (frame.gbuffer.face >= 0).all() and 0.2 < frame.visibility[0].mean() <= 1.0


def test_a_solid_is_shown_from_outside():
    scene = at.Scene.from_arrays(block((-1, -1, -1), (1, 1, 1)))
    assert scene.view.room is None
    assert [type(light) for light in scene.default_lights()] == [at.DirectionalLight, at.Sky]


def test_a_town_on_the_ground_tells_up():
    town = np.concatenate([blocks(100, (40, 4, 30)), block((-40, -1, -30), (40, 0, 30))])
    assert not guess_z_up(town)
    assert guess_z_up(town[..., [0, 2, 1]] * (1, -1, 1))


def test_a_moment_of_an_animation_fills_its_picture(tmp_path):
    made = single(TETRAHEDRON, TETRAHEDRON_FACES)
    made.animate(0, "translation", [0, 1], [[0, 0, 0], [40, 0, 0]])
    scene = load(made.write(tmp_path))
    whole, first, last = (scene.default_camera(64, 64, time=time) for time in (None, 0.0, 1.0))
    shares = [at.render(scene, camera, time=0.0).mask.mean() for camera in (whole, first, last)]
    assert shares[0] < 0.01 and shares[1] > 0.1 and shares[2] == 0.0
    assert at.render(scene, time=1.0).mask.mean() > 0.1
    np.testing.assert_allclose(last.position - first.position, (40, 0, 0), atol=1e-4)


def test_a_lamp_hangs_below_the_ceiling_of_its_room_and_lights_most_of_it():
    around = np.concatenate([block((-5, -1, -3), (5, 3, 3), inward=True), block((-5.2, -1.2, -3.2), (5.2, 3.2, 3.2))])
    scene = at.Scene.from_arrays(
        np.concatenate([around, blocks(60, (4, 1, 2.5)), block((-0.2, 1.4, -0.2), (0.2, 2, 0.2))])
    )
    lamp = scene.default_lights()[0]
    assert 0.5 < lamp.center[1] < 3.0 - lamp.radius and 2.0 < scene.view.room.height < 5.0
    assert at.render(scene, scene.default_camera(32, 32)).visibility[0].mean() > 0.5
