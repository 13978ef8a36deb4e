"""Receivers that are uploaded once: which queries they serve, and that tracing does not upload them again."""

import numpy as np
import pytest

import antumbra as at
from antumbra.query.shadow_query import new_bits
from antumbra.trace.device.device_tracer import DeviceTracer
from asking import query_of
from devices import DEVICES, opened


@pytest.fixture(scope="module", params=DEVICES)
def tracer(request):
    return DeviceTracer(opened(request.param))


@pytest.fixture(scope="module")
def asked():
    scene = at.procedural("atrium", triangles=1000)
    return query_of(scene, scene.cameras[0].resized(24, 16), at.PointLight((0.3, 3.0, 0.1)), 2)


def test_receivers_are_recognised_by_their_arrays(tracer, asked):
    _, query = asked
    receivers = tracer.receivers(query, 2)
    assert receivers.n == 24 * 16 and receivers.memory.size == 16 * receivers.n
    assert (
        receivers.normals is None
        and receivers.are_of(query)
        and receivers.are_of(query._replace(samples=query.samples[:, :1]))
    )
    for name in ("origins", "faces", "sides", "normals"):
        assert not receivers.are_of(query._replace(**{name: getattr(query, name).copy()}))


def test_a_tree_with_receivers_answers_those_and_all_others(tracer, asked):
    triangles, query = asked
    other = query._replace(origins=(query.origins + np.float32(0.01)), faces=np.full_like(query.faces, -1))
    other = other._replace(normals=np.tile([0.0, 1.0, 0.0], (*other.sides.shape, 1)))
    plain, kept = tracer.build(triangles.vertices), tracer.build(triangles.vertices)
    kept.receivers = (tracer.receivers(other, 2), tracer.receivers(query, 2))
    for each in query, other, query:
        bits, expected = new_bits(each), new_bits(each)
        tracer.trace_shadow(kept, each, bits, 2)
        tracer.trace_shadow(plain, each, expected, 2)
        np.testing.assert_array_equal(bits, expected)
        assert bits.any()
