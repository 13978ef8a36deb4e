"""Rays of all lengths, from all sources: directions times a power of two change t by its inverse, and nothing else."""

from functools import cache

import numpy as np
import pytest

import antumbra as at
from antumbra.engine.paged_scene import PagedScene
from antumbra.engine.sources.instanced_source import Instanced
from antumbra.integrations.open3d import RaycastingScene
from cutout_scenes import scene_with_cutouts
from instance_scenes import block, both, whole_transforms
from stores import built

DIRECTIONS = [-140, -100, -43, -41, 38, 40, 43, 100, 118]
"""Exponents on both sides of the range in which float32 holds all products of a test."""
UNITS = [-100, -45, 38, 45, 50]
SOURCES = ["memory", "instances", "store", "terrain", "cut-outs"]
N = 240


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("stores")


def _copies(unit):
    """(instances, flattened): boxes on whole numbers, times a unit."""
    matrices = whole_transforms(6, 1) * unit
    return both([block()], [matrices])


def _terrain(unit):
    heights = np.random.default_rng(3).integers(0, 9, (12, 14)).astype(float)
    heights[3, 4] = np.nan
    return at.from_raster((heights * unit, (2.0 * unit, 0.0, -13.0 * unit, 0.0, -2.0 * unit, 11.0 * unit)))


@cache
def _scene(source, unit, folder):
    if source == "terrain":
        return _terrain(unit)
    if source == "cut-outs":
        return scene_with_cutouts()
    inside, flat = _copies(unit)
    if source == "store":
        return PagedScene(built(folder, flat, name=f"{unit}.antumbra", chunk=16))
    return inside if source == "instances" else flat


@cache
def _rays(source):
    """(origins, directions): half of them to whole numbers, where corners and edges are."""
    rng = np.random.default_rng(5)
    origins = rng.integers(-9, 10, (N, 3)) + 0.25 * rng.integers(0, 2, (N, 3))
    if source == "terrain":
        origins[:, 2] = rng.integers(1, 14, N)
    targets = rng.integers(-8, 9, (N, 3)) + 0.125 * rng.integers(0, 2, (N, 1))
    directions = targets - origins
    directions[~directions.any(1)] = 1.0
    return origins, directions


def _answers(scene, origins, directions, factor):
    """Name -> array, with t in lengths of the directions divided by `factor`."""
    near, far = 0.125 / factor, 2.0 / factor
    hit = scene.closest_hit(origins, directions)
    hits, first = scene.all_hits(origins, directions), scene.all_hits(origins, directions, max_hits=2)
    return {
        "occluded": scene.occluded(origins, directions),
        "between": scene.occluded(origins, directions, tmin=near, tmax=far),
        "face": hit.face, "t": hit.t * factor, "u": hit.u, "v": hit.v,
        "ray of all": hits.ray, "face of all": hits.face, "t of all": hits.t * factor, "u of all": hits.u,
        "faces of two": first.face,
        "count": scene.count_hits(origins, directions),
        "surfaces": scene.count_hits(origins, directions, merge="surface"),
    }  # fmt: skip


def _of_points(scene, origins, ends):
    """Name -> array of the queries without directions."""
    segments = scene.all_hits(origins, targets=ends)
    return {
        "occluded": scene.occluded(origins, targets=ends),
        "ray of all": segments.ray, "face of all": segments.face, "t of all": segments.t,
        "surfaces": scene.count_hits(origins, targets=ends, merge="surface"),
        "inside": scene.contains(ends + (origins - ends) / 4),
        "visible": at.visibility(scene, origins, at.PointLights(ends[:9])).bits,
        "of the sun": at.visibility(scene, origins, at.DirectionalLight((1.0, 2.0, 3.0))).bits,
    }  # fmt: skip


@cache
def _ordinary(source, folder, of_points=False):
    scene, (origins, directions) = _scene(source, 1.0, folder), _rays(source)
    if of_points:
        return _of_points(scene, origins, origins + directions)
    found = _answers(scene, origins, directions, 1.0)
    assert 0.02 < found["occluded"].mean() < 0.98 and found["count"].max() > 1
    return found


def _check_same(found, truth):
    for name, values in truth.items():
        np.testing.assert_array_equal(found[name], values, err_msg=name)


@pytest.mark.parametrize("source", SOURCES)
@pytest.mark.parametrize("exponent", DIRECTIONS)
def test_long_and_short_directions_meet_what_ordinary_ones_meet(source, exponent, folder):
    origins, directions = _rays(source)
    scene, factor = _scene(source, 1.0, folder), 2.0**exponent
    _check_same(_answers(scene, origins, directions * factor, factor), _ordinary(source, folder))


@pytest.mark.parametrize("source", ["memory", "instances", "store", "terrain"])
@pytest.mark.parametrize("exponent", UNITS)
def test_a_power_of_two_as_unit_changes_no_answer(source, exponent, folder):
    unit = 2.0**exponent
    origins, directions = _rays(source)
    scene = _scene(source, unit, folder)
    _check_same(_answers(scene, origins * unit, directions * unit, 1.0), _ordinary(source, folder))
    points = _of_points(scene, origins * unit, (origins + directions) * unit)
    _check_same(points, _ordinary(source, folder, True))
    assert points["inside"].any() and not points["inside"].all()


@pytest.mark.parametrize("unit", [1.0, 2.0**-30, 2.0**44])
@pytest.mark.parametrize("distance", [2.0**20, 2.0**43, 2.0**60, 2.0**72])
def test_far_ends_and_origins_give_instances_the_answers_of_their_copies(unit, distance):
    """Also where float32 rounds the ends, so that the answer is not that of nearer ends."""
    (inside, flat), (origins, directions) = _copies(unit), _rays("instances")
    assert isinstance(inside.engine.source, Instanced)
    near, far = origins * unit, (origins + directions * distance) * unit
    for begin, end in ((near, far), (far, near)):
        truth = _of_points(flat, begin, end)
        assert truth["surfaces"].any() and not truth["occluded"].all()
        _check_same(_of_points(inside, begin, end), truth)
        _check_same(_answers(inside, begin, end - begin, 1.0), _answers(flat, begin, end - begin, 1.0))


@pytest.mark.parametrize("copies", [1, 2, 3, 8, 9, 20])
def test_a_ray_that_enters_every_box_meets_each_copy_once(copies):
    """A node over copies has eight children, most of which are missing here."""
    triangle = np.array([[[0.0, 0, 0], [4, 0, 0], [0, 4, 0]]])
    matrices = np.stack([np.eye(4)] * copies)
    matrices[:, 0, 3] = 100.0 * np.arange(copies)
    scene = at.Scene.from_instances([triangle], [matrices], instances=True)
    for length in (2.0**-130, 2.0**-43, 1.0, 2.0**43, 2.0**126):
        assert scene.all_hits([1.0, 1, -5], [0, 0, length]).face.tolist() == [0]


def test_drop_ins_take_directions_of_any_length():
    trimesh = pytest.importorskip("trimesh")
    mesh = trimesh.creation.icosphere(2)
    mesh.ray = at.trimesh_ray(mesh)
    rays = RaycastingScene()
    rays.add_triangles(mesh)
    rng = np.random.default_rng(8)
    origins, directions = rng.integers(-3, 4, (60, 3)) / 2, rng.integers(-3, 4, (60, 3)).astype(float)
    directions[~directions.any(1)] = 1.0
    first, truth = mesh.ray.intersects_first(origins, directions), None
    locations = mesh.ray.intersects_location(origins, directions)
    assert (first >= 0).any() and (first < 0).any()
    for exponent in (0, -130, -43, 43, 120):
        longer = directions * 2.0**exponent
        np.testing.assert_array_equal(mesh.ray.intersects_first(origins, longer), first)
        for found, expected in zip(mesh.ray.intersects_location(origins, longer), locations):
            np.testing.assert_array_equal(found, expected)
        crossings = rays.count_intersections(np.concatenate([origins, longer], 1))
        truth = crossings if truth is None else truth
        np.testing.assert_array_equal(crossings, truth)
