"""Facts of queries: sizes as shares of the scene, and samples of queries."""

import numpy as np
import pytest

import antumbra as at
from antumbra.engine.auto import query_features
from antumbra.engine.auto.cost_model import cost_of, predicted_rate, strategies
from antumbra.engine.auto.query_features import (
    facing_share,
    features_of,
    if_sorted,
    is_scattered,
    places_of,
    sample_of,
    size_of,
    tile_size,
)
from antumbra.query.query_bounds import bounds
from antumbra.query.shadow_query import with_receivers
from antumbra.scene.lights import DIRECTIONAL, LIST
from antumbra.trace.tracer_cost import terms
from asking import query_of

BUILT_IN = "multifrusta", "packet16:blocks", "packet16", "packet16:samples", "wide", "single"
LIGHTS = (
    at.QuadLight((-1, 7, -1), (2, 0, 0), (0, 0, 2)), at.PointLight((0, 7, 0)), at.SphereLight((0, 7, 0), 0.5),
    at.DirectionalLight((0.3, -1, 0.2)), at.AmbientOcclusion(), at.PointLights(np.eye(3) * 5.0),
)  # fmt: skip


@pytest.fixture(scope="module")
def scene():
    return at.procedural("atrium", triangles=3000)


def _facts(scene, light, size=(64, 48), spp=16):
    triangles, query = query_of(scene, scene.cameras[0].resized(*size), light, spp)
    return query, features_of(query, len(triangles.vertices), np.stack(bounds(triangles.vertices)))


@pytest.mark.parametrize("light", LIGHTS, ids=lambda light: type(light).__name__)
def test_every_light_has_facts_and_rates(scene, light):
    query, facts = _facts(scene, light)
    assert facts.rays == np.count_nonzero(query.sides) * query.samples.shape[1] > 0
    assert 0.0 < facts.tile < 1.0 and 0.0 < facts.stratum <= facts.chunk < 4.0
    assert np.isfinite(terms(facts)).all() and set(strategies()) >= set(BUILT_IN)
    for strategy in BUILT_IN:
        assert len(cost_of(strategy).rate.weights) == len(terms(facts))
        assert 1e-10 < predicted_rate(strategy, facts) < 1e-3


def test_larger_pictures_have_smaller_tiles_and_larger_lights_larger_strata(scene):
    lamp = LIGHTS[0]
    assert _facts(scene, lamp, (256, 192))[1].tile < 0.5 * _facts(scene, lamp)[1].tile
    twice = at.QuadLight((-2, 7, -2), (4, 0, 0), (0, 0, 4))
    assert _facts(scene, twice)[1].chunk == pytest.approx(2 * _facts(scene, lamp)[1].chunk)


def test_sorted_rows_are_predicted_to_be_nearer(scene):
    rng = np.random.default_rng(1)
    query, facts = _facts(scene, LIGHTS[0])
    row = query._replace(origins=rng.permutation(query.origins.reshape(-1, 3))[None], sides=query.sides.reshape(1, -1))
    facts = facts._replace(
        tile=tile_size(row, places_of(row)) / size_of(np.stack(bounds(row.corners.reshape(-1, 3, 3))))
    )
    assert if_sorted(row, facts, 50.0).tile < facts.tile


@pytest.mark.parametrize("size", [(5, 3), (64, 16), (200, 150), (1000, 1)])
@pytest.mark.parametrize("windows", [1, 2, 7])
def test_samples_are_windows_of_their_query(scene, size, windows):
    query, _ = _facts(scene, LIGHTS[0], size if size[1] > 1 else (100, 10))
    if size[1] == 1:
        query = query._replace(**{name: getattr(query, name).reshape(1, -1, *getattr(query, name).shape[2:])
                                  for name in ("origins", "faces", "sides", "ids")})  # fmt: skip
    sample = sample_of(query, windows)
    assert 0 < sample.sides.size <= query.sides.size and np.count_nonzero(sample.sides)
    every = {tuple(o) for o in query.origins.reshape(-1, 3).tolist()}
    assert all(tuple(o) in every for o in sample.origins.reshape(-1, 3).tolist())
    assert (sample.sides.shape[0] == 1) == (query.sides.shape[0] == 1)


def test_points_all_over_the_scene_are_scattered(scene):
    rng = np.random.default_rng(2)
    query, _ = _facts(scene, LIGHTS[0])
    box = np.stack(bounds(scene.triangles().vertices))
    everywhere = rng.uniform(*box, (1, 500, 3)).astype(np.float32)
    corner = (box[0] + 0.1 * (everywhere - box[0])).astype(np.float32)
    assert is_scattered(query._replace(origins=everywhere), box)
    assert not is_scattered(query._replace(origins=corner), box)
    assert not is_scattered(query._replace(origins=everywhere.reshape(2, 250, 3)), box)  # a picture
    assert not is_scattered(query._replace(origins=everywhere[:, :0]), box)


def test_a_sky_is_predicted_as_scattered_lights_and_a_sun_as_a_distant_one(scene):
    assert _facts(scene, at.Sky())[1].kind == LIST
    for sun in (at.DirectionalLight((0.3, -1, 0.2), 2.0), at.DirectionalLights([(0.3, -1, 0.2), (0.31, -1, 0.2)] * 16)):
        assert _facts(scene, sun)[1].kind == DIRECTIONAL


def test_lists_longer_than_those_of_the_fit_are_not_extrapolated(scene):
    """Extrapolated, shafts seemed 80 times as slow as packets for the suns of a year, and were never tried."""
    suns = at.DirectionalLights(-np.array([0.3, 1.0, 0.2]) - np.linspace(0.0, 0.1, 1024)[:, None])
    _, facts = _facts(scene, suns)
    assert facts.samples == 1024
    for strategy in BUILT_IN:
        assert predicted_rate(strategy, facts) == predicted_rate(strategy, facts._replace(samples=24))
        assert predicted_rate(strategy, facts) != predicted_rate(strategy, facts._replace(samples=16))


FLOOR = np.array([[[-9, 0, -9], [-9, 0, 9], [9, 0, -9]], [[9, 0, 9], [9, 0, -9], [-9, 0, 9]]], float)


@pytest.mark.parametrize(
    "light, share",
    [
        (at.PointLight((0, 5, 0)), 1.0),
        (at.PointLight((0, -5, 0)), 0.0),
        (at.SphereLight((0, -5, 0), 0.5), 0.0),
        (at.QuadLight((-1, 5, -1), (2, 0, 0), (0, 0, 2)), 1.0),
        (at.DirectionalLight((0.1, -1, 0)), 1.0),
        (at.DirectionalLight((0.1, 1, 0)), 0.0),
        (at.DirectionalLights([(0, -1, 0), (0, 1, 0)], interleave=False), 0.5),
        (at.AmbientOcclusion(), 1.0),
    ],
    ids=str,
)
def test_the_share_of_receivers_that_face_a_light_is_that_of_their_surfaces(light, share):
    scene = at.Scene.from_arrays(FLOOR, up="y")
    _, query = query_of(scene, at.Camera((0, 3, 6), (0, 0, 0), width=160, height=120), light, 2)
    assert np.count_nonzero(query.sides) > 5000
    assert facing_share(query, places_of(query)) == share
    small = query_of(scene, at.Camera((0, 3, 6), (0, 0, 0), width=40, height=30), light, 2)[1]
    assert facing_share(small, places_of(small)) == 1.0  # too few rays to be worth looking at them


def test_features_are_computed_once_for_equal_receivers_lights_and_samples(scene, monkeypatch):
    triangles, query = query_of(scene, scene.cameras[0].resized(64, 48), LIGHTS[0], 16)
    box = np.stack(bounds(triangles.vertices))
    first = features_of(query, 3000, box)
    with monkeypatch.context() as context:
        context.setattr(query_features, "tile_size", None)
        assert features_of(query, 500, box) == first._replace(triangles=500)
    few = query._replace(samples=query.samples[:, :4].copy())
    elsewhere = with_receivers(query, lambda array: array[:, ::2])
    assert features_of(few, 3000, box).samples == 4
    assert features_of(elsewhere, 3000, box).receivers < first.receivers
    _, other = query_of(scene, scene.cameras[0].resized(64, 48), LIGHTS[1], 16)
    assert features_of(other._replace(origins=query.origins), 3000, box).chunk < first.chunk
