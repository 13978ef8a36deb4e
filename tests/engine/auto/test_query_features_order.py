"""Receivers in spatial order keep their sample sets, and neighbours are near each other."""

import numpy as np
import pytest

import antumbra as at
from antumbra.engine.auto.query_features import places_of, reorder_query, spatial_order, tile_size
from antumbra.query.light_samples import light_samples
from antumbra.query.shadow_query import ShadowQuery


def _row(n, seed=0):
    """A query of n random points, each with its own face, side and normal."""
    rng = np.random.default_rng(seed)
    light = at.PointLight(np.zeros(3))
    return ShadowQuery(
        rng.random((1, n, 3)).astype(np.float32), np.arange(n, dtype=np.int32)[None], np.ones((1, n), np.int8),
        rng.random((1, n, 3)), np.zeros((n, 9), np.float32), light.patch(np.zeros(3), 1.0), light_samples(light, 1), 0,
        np.arange(n, dtype=np.int32)[None],
    )  # fmt: skip


@pytest.mark.parametrize("n", [0, 1, 3, 4, 5, 1000, 1003])
def test_every_receiver_keeps_its_set(n):
    places = spatial_order(_row(n).origins[0])
    assert sorted(places.tolist()) == list(range(n))
    np.testing.assert_array_equal(places % 4, np.arange(n) % 4)


def test_neighbours_are_near_each_other():
    query = _row(4000)
    ordered = reorder_query(query, spatial_order(query.origins[0]))
    assert tile_size(ordered, places_of(ordered)) < tile_size(query, places_of(query)) / 2


def test_everything_of_a_receiver_moves_with_it():
    query = _row(101)
    places = spatial_order(query.origins[0])
    ordered = reorder_query(query, places)
    for name in ("origins", "faces", "sides", "normals", "ids"):
        np.testing.assert_array_equal(getattr(ordered, name)[0], getattr(query, name)[0][places])
    assert ordered.samples is query.samples and ordered.corners is query.corners


def test_points_without_normals():
    query = _row(50)._replace(normals=np.empty((0, 0, 3)))
    assert reorder_query(query, spatial_order(query.origins[0])).normals.size == 0
