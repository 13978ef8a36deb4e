"""The samples that are traced as packets instead of shafts, in more than one chunk."""

import numpy as np
import pytest

import antumbra as at
from antumbra.engine.plan import parse_plan
from antumbra.trace.packets.ray_tile import is_incoherent
from asking import answer, query_of

POINTS = np.random.default_rng(5).uniform((-3, 0.5, -3), (3, 3, 3), (300, 3))


def _query(light):
    atrium = at.procedural("atrium", triangles=2000)
    triangles, query = query_of(atrium, atrium.cameras[0].resized(32, 24), light, 16)
    return triangles, query, is_incoherent(query)


@pytest.mark.parametrize(
    "light, scattered",
    [
        (at.PointLights(POINTS, interleave=True), True),
        (at.PointLights(POINTS), False),
        (at.PointLights(POINTS[:1], interleave=True), False),
        (at.QuadLight((-1, 3, -1), (2, 0, 0), (0, 0, 2)), False),
        (at.AmbientOcclusion(), True),
    ],
    ids=["interleaved", "all by all", "one point", "quad", "ambient"],
)
def test_interleaved_lists_and_hemispheres_are_scattered(light, scattered):
    assert _query(light)[2] is scattered


@pytest.mark.parametrize(
    "light", [at.PointLights(POINTS, interleave=True), at.AmbientOcclusion(spp=40)], ids=["interleaved", "ambient"]
)
def test_more_than_a_chunk(light):
    triangles, query, scattered = _query(light)
    assert scattered and query.samples.shape[1] > 16
    one, other = (answer(parse_plan(p), triangles, query) for p in ("bsah+multifrusta", "bsah+single"))
    assert one.any() and not one.all()
    np.testing.assert_array_equal(one, other)
