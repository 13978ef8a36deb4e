"""Programs as users of Open3D's RaycastingScene write them, with both classes, against what geometry says."""

import sys

import numpy as np
import pytest
import trimesh

from antumbra.integrations.open3d import RaycastingScene

NONE = RaycastingScene.INVALID_ID


@pytest.fixture(params=["Antumbra without Open3D", "Antumbra beside Open3D", "Open3D"])
def raycasting(request, monkeypatch):
    """A RaycastingScene's class. Programs that have imported Open3D get tensors from ours too."""
    if request.param == "Antumbra without Open3D":
        monkeypatch.delitem(sys.modules, "open3d", raising=False)
        return RaycastingScene
    library = pytest.importorskip(
        "open3d", reason="no Open3D: programs run with arrays only, and are NOT compared", exc_type=ImportError
    )
    monkeypatch.setitem(sys.modules, "open3d", library)
    return RaycastingScene if request.param == "Antumbra beside Open3D" else library.t.geometry.RaycastingScene


def numbers(result):
    return result if isinstance(result, np.ndarray) else result.cpu().numpy()


def scene_of(raycasting, *meshes):
    scene = raycasting()
    for i, mesh in enumerate(meshes):
        added = scene.add_triangles(np.asarray(mesh.vertices, np.float32), np.asarray(mesh.faces, np.uint32))
        assert added == i
    return scene


def box(size, middle):
    return trimesh.creation.box(size, trimesh.transformations.translation_matrix(middle))


def rows(origins, directions):
    return np.concatenate(np.broadcast_arrays(origins, directions), axis=-1).astype(np.float32)


def around(n, elevations=(0.0,)):
    """Unit directions of a spinning scanner, (elevations, n, 3)."""
    turn, up = np.meshgrid(np.linspace(0, 2 * np.pi, n, endpoint=False) + 0.01, elevations)
    return np.stack([np.cos(turn) * np.cos(up), np.sin(turn) * np.cos(up), np.sin(up)], -1)


def test_a_scan_is_located_in_the_model_of_a_building(raycasting):
    """The place whose ranges are those that were measured, of a grid of places."""
    scene = scene_of(raycasting, box((10, 6, 3), (0, 0, 0)), box((1, 2, 3), (2, 1, 0)))
    places = np.stack(np.meshgrid(np.linspace(-4, 1, 11), np.linspace(-2, 2, 9), [0.25], indexing="ij"), -1)
    places, directions = places.reshape(-1, 1, 3), around(72)[0]
    measured = numbers(scene.cast_rays(rows(places[40], directions))["t_hit"])
    ranges = numbers(scene.cast_rays(rows(places, directions))["t_hit"])
    assert ranges.shape == (99, 72) and np.isfinite(ranges).all()
    errors = np.abs(ranges - measured).mean(1)
    assert errors.argmin() == 40 and errors[40] == 0.0 and (np.delete(errors, 40) > 0.1).all()


def test_points_behind_a_mesh_are_hidden(raycasting):
    """Of a ball, an eye sees the vertices in front of the plane in which it touches the ball."""
    ball, eye = trimesh.creation.icosphere(4), np.array([3.0, 1, 2])
    scene = scene_of(raycasting, ball)
    ways = ball.vertices - eye
    lengths = np.linalg.norm(ways, axis=1)
    found = scene.cast_rays(rows(eye, ways / lengths[:, None]))
    visible = numbers(found["t_hit"]) + 1e-4 >= lengths
    facing = ball.vertices @ eye - 1.0
    clear = np.abs(facing) > 0.3  # more than the faces of the ball are long
    assert (visible == (facing > 0))[clear].all() and 0.2 < visible.mean() < 0.5


def test_a_lidar_above_trees_sees_crowns_and_ground(raycasting):
    ground = trimesh.Trimesh([[-9, -9, 0], [9, -9, 0], [9, 9, 0], [-9, 9, 0]], [[0, 1, 2], [0, 2, 3]])
    trees = [trimesh.creation.icosphere(3, 1.5).apply_translation((x, y, 3)) for x, y in ((-4, -4), (4, 0), (0, 5))]
    scene = scene_of(raycasting, ground, *trees)
    grid = np.stack(np.meshgrid(np.linspace(-8, 8, 81), np.linspace(-8, 8, 81)), -1).reshape(-1, 2)
    found = scene.cast_rays(rows(np.c_[grid, np.full(len(grid), 20.0)], (0, 0, -1)))
    geometry, height = numbers(found["geometry_ids"]), 20.0 - numbers(found["t_hit"])
    crowns = np.stack([np.linalg.norm(grid - at, axis=1) for at in ((-4, -4), (4, 0), (0, 5))], 1)
    truth = np.where(crowns.min(1) < 1.5, crowns.argmin(1) + 1, 0)
    clear = np.abs(crowns.min(1) - 1.5) > 0.03
    assert (geometry == truth)[clear].all() and set(geometry) == {0, 1, 2, 3}
    assert np.abs(height[geometry == 0]).max() < 1e-5 and np.ptp(height[geometry == 1]) > 1.0


def test_a_spinning_lidar_measures_a_room(raycasting):
    scene = scene_of(raycasting, box((8, 6, 4), (0, 0, 0)))
    directions = around(90, np.radians([-20, -10, 5, 10, 20]))
    found = scene.cast_rays(rows((1.0, 0.5, 0.25), directions))
    ends = np.where(directions > 0, (4, 3, 2), (-4, -3, -2)) - (1.0, 0.5, 0.25)
    truth = (ends / np.where(directions == 0, 1e-30, directions)).min(-1)
    np.testing.assert_allclose(numbers(found["t_hit"]), truth, rtol=1e-5)
    normals = numbers(found["primitive_normals"])
    assert normals.shape == (5, 90, 3) and (np.einsum("...i,...i", normals, directions) > 0).all()


def test_radio_waves_are_counted_through_walls(raycasting):
    """Each wall of a corridor is a box, which a wave crosses twice."""
    walls = [box((0.2, 4, 3), (x, 0, 0)) for x in (1.0, 2.0, 3.0)]
    scene = scene_of(raycasting, *walls)
    receivers = np.stack(np.meshgrid([0.5, 1.5, 2.5, 3.5], np.linspace(-1.4, 1.5, 12)), -1).reshape(-1, 2)
    ways = np.c_[receivers, np.full(len(receivers), 0.1)]
    listed = scene.list_intersections(rows((0.0, 0.03, 0.02), ways - (0, 0.03, 0.02)))
    splits, t = numbers(listed["ray_splits"]).astype(int), numbers(listed["t_hit"])
    crossed = np.add.reduceat(np.append(t < 1.0, False), splits[:-1]) * (np.diff(splits) > 0)
    assert (crossed == 2 * np.floor(receivers[:, 0])).all()
    counts = numbers(scene.count_intersections(rows((0.0, 0.03, 0.02), ways - (0, 0.03, 0.02))))
    assert (counts == np.diff(splits)).all() and set(crossed) == {0, 2, 4, 6}


def test_viewpoints_of_an_inspection_see_what_they_aim_at(raycasting):
    """A field of view of 0 and a single pixel give the ray through the middle of the picture."""
    ball = trimesh.creation.icosphere(3)
    scene, aims = scene_of(raycasting, ball), ball.triangles_center[::40]
    for aim in aims:
        eye = 3.0 * aim
        rays = raycasting.create_rays_pinhole(
            fov_deg=0, center=aim, eye=eye, up=[0.1, 0.2, 1.0], width_px=1, height_px=1
        )
        found = scene.cast_rays(rays)
        assert rays.shape[0] == rays.shape[1] == 1
        assert numbers(found["primitive_ids"]).item() in range(0, len(ball.faces))
        assert abs(numbers(found["t_hit"]).item() - np.linalg.norm(eye - aim)) < 1e-4
    assert len(aims) > 20


def test_a_planner_may_look_from_a_place_at_itself(raycasting):
    """One of its rays has no direction: it hits nothing, and the others are traced."""
    scene = scene_of(raycasting, box((1, 1, 1), (0, 0, 0)))
    places = np.array([[3.0, 0.1, 0.2], [0.2, 3.0, 0.1], [-3.0, 0.2, 0.1], [2.0, 2.0, 2.0]])
    ways = places[None] - places[:, None]
    found = scene.cast_rays(rows(places[:, None], ways))
    blocked = numbers(found["t_hit"]) < 1.0
    truth = np.zeros((4, 4), bool)
    truth[0, 2] = truth[2, 0] = True
    assert (blocked == truth).all()
    assert (numbers(found["primitive_ids"])[np.eye(4, dtype=bool)] == NONE).all()
    assert (numbers(scene.test_occlusions(rows(places[:, None], ways), tfar=1.0)) == truth).all()


@pytest.mark.parametrize("quarter", [0, 1])
def test_signed_distances_sample_a_solid(raycasting, quarter):
    """The zero level of a grid of signed distances, as for learned shapes; also with the box turned by a quarter."""
    size = np.array([2.0, 4.0, 6.0])[[1, 0, 2] if quarter else [0, 1, 2]]
    scene = scene_of(raycasting, box(size, (0, 0, 0)))
    points = np.stack(np.meshgrid(*[np.linspace(-3.9, 3.7, 12)] * 3, indexing="ij"), -1).astype(np.float32)
    beyond = np.abs(points) - size / 2
    truth = np.linalg.norm(np.maximum(beyond, 0.0), axis=-1) + np.minimum(beyond.max(-1), 0.0)
    found = numbers(scene.compute_signed_distance(points))
    np.testing.assert_allclose(found, truth, rtol=1e-5, atol=1e-5)
    assert ((found < 0) == (numbers(scene.compute_occupancy(points)) > 0.5)).all() and (found < 0).any()
    closest = numbers(scene.compute_closest_points(points)["points"])
    np.testing.assert_allclose(np.linalg.norm(closest - points, axis=-1), np.abs(truth), rtol=1e-5, atol=1e-5)
