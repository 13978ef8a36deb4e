"""The drop-ins in rooms whose faces exist twice, once per side, and belong to two geometries."""

import numpy as np
import pytest
import trimesh

import antumbra as at
from antumbra.integrations.open3d import RaycastingScene
from double_rooms import ORDERS, OUTSIDE, double_room, rays_inside

TURN = 27.3
N = 200


@pytest.mark.parametrize("order", ORDERS)
def test_open3d_hits_the_side_that_faces_the_ray(order):
    """Every geometry has faces of both sides. A list has one hit for each geometry at a point."""
    room = double_room(order, TURN)
    scene, numbers = RaycastingScene(), [np.arange(k, 24, 2) for k in range(2)]
    for rows in numbers:
        scene.add_triangles(room.vertices.astype(np.float32), room.faces[rows].astype(np.uint32))
    origins, directions = rays_inside(room, N)
    query = np.concatenate([origins, directions], 1)
    hit = scene.cast_rays(query)
    assert ((hit["primitive_normals"] * directions).sum(1) < 0.0).all()
    walls = np.array([room.walls[numbers[g][p]] for g, p in zip(hit["geometry_ids"], hit["primitive_ids"])])
    assert (walls != OUTSIDE).all()
    found = scene.list_intersections(query)
    pairs = list(zip(found["ray_ids"], found["geometry_ids"]))
    assert len(pairs) == len(set(pairs)) == np.diff(found["ray_splits"]).sum() and found["t_hit"].max() < np.inf
    first = np.searchsorted(found["ray_ids"], np.arange(N))
    for name in "geometry_ids", "primitive_ids":
        np.testing.assert_array_equal(found[name][first], hit[name])


@pytest.mark.parametrize("order", ORDERS)
def test_trimesh_hits_the_side_that_faces_the_ray(order):
    room = double_room(order, TURN)
    mesh = trimesh.Trimesh(room.vertices, room.faces, process=False)
    rays = at.trimesh_ray(mesh)
    origins, directions = rays_inside(room, N)
    first = rays.intersects_first(origins, directions)
    assert (room.walls[first] != OUTSIDE).all()
    for several in (True, False):
        face, ray = rays.intersects_id(origins, directions, multiple_hits=several)
        assert ray.tolist() == list(range(N))
        np.testing.assert_array_equal(face, first)
