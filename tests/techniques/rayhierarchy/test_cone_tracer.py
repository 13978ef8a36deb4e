"""The queries for which `auto` considers the tracer `cones`."""

import numpy as np
import pytest

import antumbra as at
from antumbra.engine.method_registry import TRACERS
from antumbra.techniques.rayhierarchy.cone_tracer import has_one_apex
from asking import query_of

ONE = at.PointLight((0, 7, 0)), at.DirectionalLight((0.3, -1, 0.2))
SEVERAL = at.QuadLight((-1, 7, -1), (2, 0, 0), (0, 0, 2)), at.SphereLight((0, 7, 0), 0.5), at.AmbientOcclusion()


@pytest.fixture(scope="module")
def scene():
    return at.procedural("atrium", triangles=1000)


@pytest.mark.parametrize("light", [*ONE, *SEVERAL], ids=lambda light: type(light).__name__)
@pytest.mark.parametrize("spp", [4, 16])
def test_cones_suit_lights_with_one_apex_and_few_samples(scene, light, spp):
    _, query = query_of(scene, scene.cameras[0].resized(16, 12), light, spp)
    assert has_one_apex(query) == (light in ONE)
    assert TRACERS["cones"].suits(query, np.zeros((2, 3), np.float32)) == (light in ONE and spp <= 4)
