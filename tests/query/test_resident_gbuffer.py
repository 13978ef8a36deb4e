"""The G-buffer of a device: an ordinary one as soon as it is read."""

import pickle
from types import SimpleNamespace

import numpy as np

from antumbra.query.gbuffer import GBuffer
from antumbra.query.resident_gbuffer import ResidentGBuffer
from antumbra.query.shadow_query import surfaces_of


def there():
    rng = np.random.default_rng(1)
    return SimpleNamespace(
        triangles=SimpleNamespace(origin=np.arange(3.0)),
        device=SimpleNamespace(name="host:0"),
        shape=(2, 3),
        position=rng.random((2, 3, 3), np.float32),
        normal=rng.random((2, 3, 3), np.float32),
        face=np.arange(-1, 5, dtype=np.int32).reshape(2, 3),
        depth=rng.random((2, 3), np.float32),
        side=np.ones((2, 3), np.int8),
    )


def test_fields_are_those_of_the_device():
    arrays = there()
    gbuffer = ResidentGBuffer.of(arrays)
    for name in GBuffer._fields[:-1]:
        assert getattr(gbuffer, name) is getattr(arrays, name)
    copies = pickle.loads(pickle.dumps(gbuffer)), gbuffer._replace(depth=arrays.depth)
    for copy in copies:
        assert type(copy) is GBuffer
        for ours, theirs in zip(copy, gbuffer, strict=True):
            np.testing.assert_array_equal(ours, theirs)


def test_surfaces_read_their_faces_when_they_are_needed():
    gbuffer, read = ResidentGBuffer.of(there()), []

    class Counted(ResidentGBuffer):
        @property
        def face(self):
            read.append(1)
            return self.there.face

    counted = Counted._make([*[None] * 5, gbuffer.origin])
    counted.there = gbuffer.there
    surfaces = surfaces_of(counted, None)
    assert surfaces.gbuffer is counted and surfaces._replace(box=None).gbuffer is counted and not read
    assert surfaces.device == surfaces._replace(box=None).device == "host:0"
    np.testing.assert_array_equal(surfaces.ids, gbuffer.face)
    assert read
