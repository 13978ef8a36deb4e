"""Triangles on a device: their vertices come to the host once, when something there reads them."""

import pickle

import numpy as np

from antumbra.scene.resident_triangles import FramedVertices, ResidentTriangles
from antumbra.scene.triangles import Triangles


def test_vertices_are_fetched_once_and_only_when_they_are_read():
    vertices, fetched = np.arange(18, dtype=np.float32).reshape(2, 3, 3), []
    framed = FramedVertices("memory", lambda: fetched.append(1) or vertices, None, vertices[:, 0], True)
    rest = np.zeros(3), np.arange(2, dtype=np.int32), np.ones((2, 3), np.float32)
    triangles = ResidentTriangles.of(framed, Triangles(None, *rest))
    assert triangles.memory == "memory" and triangles.face_id is rest[1] and triangles.bounds is framed.bounds
    assert not fetched
    assert triangles.vertices is vertices is triangles.vertices and len(fetched) == 1


def test_copies_are_plain_triangles():
    vertices = np.arange(9, dtype=np.float32).reshape(1, 3, 3)
    framed = FramedVertices("memory", lambda: vertices, None, vertices[0], True)
    bare = Triangles(None, np.zeros(3), np.zeros(1, np.int32), np.ones((1, 3), np.float32))
    triangles = ResidentTriangles.of(framed, bare)
    changed, copied = triangles._replace(solid=None), pickle.loads(pickle.dumps(triangles))
    assert type(changed) is type(copied) is Triangles and changed.vertices is vertices
    np.testing.assert_array_equal(copied.vertices, vertices)
    assert len(list(triangles)) == len(Triangles._fields) and next(iter(triangles)) is vertices
    assert triangles[0] is vertices and triangles[1:3] == (bare.origin, bare.face_id) and triangles[-1] is None
