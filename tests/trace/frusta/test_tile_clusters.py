"""Clusters: all parts are kept, and neighbours in the order lie near each other."""

import numpy as np
import pytest

from antumbra.kernels.jit import kernel
from antumbra.kernels.simd import get, ptr, put
from antumbra.trace.frusta.tile_clusters import PARTS_INTS, order_parts, parts_at


@kernel
def _ordered(memory, places, order):
    parts = parts_at(ptr(memory))
    n = places.shape[0]
    for i in range(n):
        for k in range(3):
            put(parts.places, k * _ROW + i, places[i, k])
    order_parts(parts, n)
    for i in range(n):
        order[i] = get(parts.order, i)


_ROW = 128 + 16


def _order(places):
    order = np.empty(len(places), np.int64)
    _ordered(np.zeros(PARTS_INTS, np.int32), places.astype(np.float32), order)
    return order


def _spread(places, size=16):
    """The mean extent of groups of places that follow one another."""
    groups = [places[i : i + size] for i in range(0, len(places), size)]
    return np.mean([np.ptp(group, axis=0).sum() for group in groups])


@pytest.mark.parametrize("n", [1, 4, 5, 16, 17, 39, 64, 70, 128])
@pytest.mark.parametrize("scale", [1.0, 1e-20, 1e20])
def test_orders_hold_each_part_once(n, scale):
    places = scale * np.random.default_rng(n).normal(size=(n, 3))
    order = _order(places)
    assert sorted(order) == list(range(n))
    if n > 32:
        assert _spread(places[order]) < 0.8 * _spread(places)


def test_surfaces_apart_are_apart():
    """Tiles of two surfaces take turns in the picture, as behind a fence."""
    places = np.zeros((64, 3))
    places[:, 0], places[:, 2] = np.arange(64) * 0.1, np.arange(64) % 2 * 100
    assert _spread(places[_order(places)]) < 10 < 100 < _spread(places)


def test_equal_places():
    assert sorted(_order(np.ones((64, 3)))) == list(range(64))
