"""Programs of several trades around ``mesh.ray`` of trimesh: one line changes the engine, and the numbers agree.

Each program is a function of a mesh. It runs with trimesh's own engine and with this one.
"""

import copy
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
import trimesh

import antumbra as at

pytest.importorskip("embreex", reason="no embreex: programs with two engines are NOT checked")

PROGRAMS: dict[str, Callable[[trimesh.Trimesh], Any]] = {}


def program(run):
    PROGRAMS[run.__name__] = run
    return run


def bracket() -> trimesh.Trimesh:
    """A block with a leaning plate on it and a ball beside it: undercuts, shadows and thin walls."""
    tilt = trimesh.transformations.rotation_matrix(0.4, [0, 1, 0])
    plate = trimesh.creation.box((1.5, 0.8, 0.11), transform=tilt)
    parts = [trimesh.creation.box((2.0, 1.5, 0.5)), plate.apply_translation((0.1, 0.05, 1.2))]
    return trimesh.util.concatenate([*parts, trimesh.creation.icosphere(2, 0.4).apply_translation((0.3, 1.4, 0.2))])


@program
def shadow_mask_of_a_spacecraft(mesh):
    """Faces in the sun: towards it, with nothing in the way of their centres."""
    sun = np.array([0.3, 0.5, 0.81])
    facing = mesh.face_normals @ sun > 1e-6
    start = mesh.triangles_center + 1e-4 * mesh.face_normals
    return facing & ~mesh.ray.intersects_any(start, np.tile(sun, (len(start), 1)))


@program
def undercuts_of_a_mould(mesh):
    """Faces that cannot be drawn upwards, since another one is above."""
    start = mesh.triangles_center + 1e-4 * mesh.face_normals
    return mesh.ray.intersects_first(start, np.tile([0.0, 0.0, 1.0], (len(start), 1))) >= 0


@program
def wall_thickness_for_printing(mesh):
    start = mesh.triangles_center - 1e-5 * mesh.face_normals
    where, ray, _ = mesh.ray.intersects_location(start, -mesh.face_normals, multiple_hits=False)
    thickness = np.full(len(start), np.inf)
    thickness[ray] = np.linalg.norm(where - start[ray], axis=1)
    return thickness


@program
def voxels_by_parity(mesh):
    """Whether an odd number of surfaces lies above the centres of cells."""
    axes = [np.linspace(low, high, 9)[1:-1] + 0.0123 for low, high in mesh.bounds.T]
    centres = np.stack(np.meshgrid(*axes, indexing="ij"), -1).reshape(-1, 3)
    _, ray, _ = mesh.ray.intersects_location(centres, np.tile([0.0, 0.0, 1.0], (len(centres), 1)))
    return np.bincount(ray, minlength=len(centres)) % 2


@program
def ambient_occlusion(mesh):
    rng = np.random.default_rng(4)
    start = np.repeat(mesh.triangles_center + 1e-4 * mesh.face_normals, 16, axis=0)
    towards = rng.normal(size=start.shape)
    normals = np.repeat(mesh.face_normals, 16, axis=0)
    towards *= np.sign(np.einsum("ij,ij->i", towards, normals))[:, None]
    return mesh.ray.intersects_any(start, towards).reshape(-1, 16).mean(axis=1)


@program
def points_inside(mesh):
    return mesh.contains(np.random.default_rng(5).uniform(*mesh.bounds, (300, 3)))


@program
def antipodal_grasps(mesh):
    """Pairs of faces between the jaws of a gripper, from 42 rays a call of an engine of the program's own."""
    rays = type(mesh.ray)(mesh, scale_to_box=False)
    rng, pairs = np.random.default_rng(6), []
    for face in range(0, len(mesh.faces), 40):
        spread = -mesh.face_normals[face] + 0.2 * rng.normal(size=(42, 3))
        start = np.tile(mesh.triangles_center[face] - 1e-4 * mesh.face_normals[face], (42, 1))
        where, ray, other = rays.intersects_location(start, spread, multiple_hits=False)
        pairs.append(np.column_stack([ray, other, where]))
    return np.concatenate(pairs)


@program
def salient_edges(mesh):
    """Edges that a camera sees: rays past the middle of each."""
    eye = np.array([4.0, 3.0, 5.0])
    middles = mesh.vertices[mesh.edges_unique].mean(axis=1) * 0.97
    return mesh.ray.intersects_first(np.tile(eye, (len(middles), 1)), middles - eye) >= 0


@program
def optical_detector(mesh):
    """Copies its scene before each query, as multiprocessing programs do."""
    start = np.tile([0.1, 0.2, 3.0], (20, 1)) + np.linspace(-0.5, 0.5, 20)[:, None] * [1, 0, 0]
    found = []
    for towards in [0, 0, -1.0], [0.1, 0.1, -1.0]:
        detector = copy.deepcopy(mesh)
        found.append(detector.ray.intersects_location(start, np.tile(towards, (20, 1)), multiple_hits=False)[0])
        assert type(detector.ray) is type(mesh.ray)
    return np.concatenate(found)


@program
def signed_distances(mesh):
    pytest.importorskip("rtree", reason="no rtree: trimesh.proximity is NOT checked")
    points = np.random.default_rng(7).uniform(*mesh.bounds, (60, 3))
    return trimesh.proximity.signed_distance(mesh, points)


@program
def a_camera_above_a_terrain(mesh):
    """Depths of pixels with NaN where the lens shows nothing."""
    x, y = np.meshgrid(np.linspace(-0.4, 0.4, 24), np.linspace(-0.4, 0.4, 18))
    towards = np.stack([x, y, -np.ones_like(x)], -1).reshape(-1, 3)
    towards[np.hypot(x, y).ravel() > 0.5] = np.nan
    where, ray, _ = mesh.ray.intersects_location(np.tile([0.2, 0.1, 4.0], (len(towards), 1)), towards, False)
    depths = np.full(len(towards), np.nan)
    depths[ray] = where[:, 2]
    return depths


@pytest.mark.parametrize("name", PROGRAMS)
def test_programs_find_the_same_with_either_engine(name):
    wanted = np.asarray(PROGRAMS[name](bracket()), float)
    with at.use_in_trimesh():
        found = np.asarray(PROGRAMS[name](bracket()), float)
    assert found.shape == wanted.shape and len(np.unique(wanted[np.isfinite(wanted)])) > 1
    np.testing.assert_allclose(found, wanted, rtol=0, atol=1e-9)
