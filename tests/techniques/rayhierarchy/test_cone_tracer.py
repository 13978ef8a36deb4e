"""The queries for which `auto` considers the tracer `cones`."""

import numpy as np
import pytest

import antumbra as at
from antumbra.engine.method_registry import TRACERS
from antumbra.techniques.rayhierarchy.cone_tracer import cone_rate, has_one_apex
from antumbra.trace.tracer_cost import QueryFeatures
from asking import query_of

ONE = (
    at.PointLight((0, 7, 0)),
    at.DirectionalLight((0.3, -1, 0.2), 0.0),
    at.PointLights([(0, 7, 0)] * 3),
    at.DirectionalLights([(0.3, -1, 0.2)]),
)
SEVERAL = (
    at.DirectionalLight((0.3, -1, 0.2)),
    at.PointLights([(0, 7, 0), (0, 6, 0)], interleave=True),
    at.QuadLight((-1, 7, -1), (2, 0, 0), (0, 0, 2)),
    at.SphereLight((0, 7, 0), 0.5),
    at.AmbientOcclusion(),
)


@pytest.fixture(scope="module")
def scene():
    return at.procedural("atrium", triangles=1000)


@pytest.mark.parametrize("light", [*ONE, *SEVERAL], ids=lambda light: type(light).__name__)
@pytest.mark.parametrize("spp", [1, 16])
def test_cones_suit_lights_whose_samples_are_all_the_same_for_all_receivers(scene, light, spp):
    _, query = query_of(scene, scene.cameras[0].resized(16, 12), light, spp)
    assert has_one_apex(query) == (light in ONE)
    assert TRACERS["cones"].suits(query, np.zeros((2, 3), np.float32)) == (light in ONE)


def test_predicted_times_of_cones_grow_with_triangles_and_have_a_fixed_part():
    rates = [
        cone_rate(QueryFeatures(n, m, 1, 0, 1e-3, 1e-6, 1e-6)) for n, m in ((10**6, 10**5), (10**3, 10**5), (10**3, 10))
    ]
    assert rates[1] < rates[0] and rates[1] < rates[2] < 1e6
    assert np.isfinite(cone_rate(QueryFeatures(10, 0, 1, 0, 1e-3, 1e-6, 1e-6)))
