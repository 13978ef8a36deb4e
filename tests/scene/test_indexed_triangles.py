"""Triangles by indexed vertices: their corners and areas are those of a new scene, whenever they are read."""

import pickle

import numpy as np
import pytest

import antumbra as at
from antumbra.bvh.tree_quality import validate
from antumbra.engine.accelerator import Accelerator
from antumbra.engine.plan import parse_plan
from antumbra.engine.refitted_rays import RayTreeRefit
from antumbra.engine.sources.in_memory_source import RAY_PLANS
from antumbra.scene.indexed_triangles import IndexedTriangles
from antumbra.scene.triangle_setup import rows_with_area

RNG = np.random.default_rng(11)
POINTS = RNG.normal(size=(60, 3)).astype(np.float32)
SPREAD = RNG.permutation(60).reshape(20, 3).astype(np.int32)
FACES = np.concatenate([SPREAD, RNG.integers(0, 60, (80, 3)).astype(np.int32)])


def updated(points=POINTS, faces=FACES, of_corners=False, flat=True):
    """(the triangles of an updated scene, whose corners nothing has read; the expected corners)."""
    scene = at.Scene.from_arrays(points, faces)
    moved = RNG.normal(size=points.shape).astype(np.float32)
    if flat:
        moved[faces[0, 1]] = moved[faces[0, 0]]
    scene.update(moved[faces] if of_corners else moved)
    local = (moved.astype(np.float64) - scene.origin).astype(np.float32)
    return scene.data.triangles(), local[faces]


@pytest.mark.parametrize("of_corners", [False, True])
@pytest.mark.parametrize("first", ["vertices", "solid"])
def test_what_is_read_later(of_corners, first):
    triangles, expected = updated(of_corners=of_corners)
    assert isinstance(triangles, IndexedTriangles) and "_corners" not in vars(triangles)
    getattr(triangles, first)
    assert triangles.vertices.tobytes() == expected.tobytes() and triangles.vertices is triangles.vertices
    np.testing.assert_array_equal(triangles.solid, rows_with_area(expected, 1))
    assert 0 < len(triangles.solid) < len(FACES)


def test_faces_share_vertices_unless_some_are_used_by_none():
    triangles, _ = updated()
    np.testing.assert_array_equal(triangles.indexed.faces, FACES)
    lonely = np.concatenate([POINTS, [[1e3, 0, 0]]]).astype(np.float32)
    scene = at.Scene.from_arrays(lonely, FACES)
    scene.update(lonely)
    assert scene.bounds.max() < 10.0


@pytest.mark.parametrize("flat", [False, True])
def test_refits_read_no_corners(flat):
    """A refit finds by itself that all triangles have an area. Otherwise there is a new tree."""
    scene = at.Scene.from_arrays(POINTS, SPREAD)
    accelerator, refit = Accelerator(parse_plan(RAY_PLANS[0]), 2), RayTreeRefit(2)
    built, moved = accelerator.build(scene.triangles()), POINTS * np.float32(1.25)
    if flat:
        moved[SPREAD[0, 1]] = moved[SPREAD[0, 0]]
    scene.update(moved)
    triangles = scene.data.triangles()
    refitted = refit.refit(accelerator, built, triangles, 0)
    assert "_corners" not in vars(triangles) and (refitted is None) == flat
    if refitted is not None:
        assert triangles.solid is None and "_corners" not in vars(triangles)
        validate(refitted.bvh, triangles.vertices)
    assert (triangles.solid is not None) == flat


def test_pickles_and_copies_are_plain():
    triangles, expected = updated()
    for copy in pickle.loads(pickle.dumps(triangles)), triangles._replace(cutouts=None):
        assert not isinstance(copy, IndexedTriangles) and copy.vertices.tobytes() == expected.tobytes()
        np.testing.assert_array_equal(copy.solid, triangles.solid)
