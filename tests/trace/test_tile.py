"""Tiles: receivers are loaded the same way inside a picture, at its borders, and from lists, and divided at gaps."""

import numpy as np
import pytest

from antumbra.kernels.jit import kernel
from antumbra.kernels.simd import ptr
from antumbra.query.receivers import FREE, NOTHING
from antumbra.query.shadow_query import ShadowQuery
from antumbra.scene.lights import FIXED, LightPatch
from antumbra.trace.light_table import light_table
from antumbra.trace.tile import (
    TILE_FLOATS,
    coherent_part,
    load_receivers,
    query_chunk_of,
    sets_of,
    tile_at,
    tile_shape,
)


@kernel
def _load(query, table, shape, y0, x0, memory):
    chunk = query_chunk_of(query, table, shape, 0, 1)
    return load_receivers(chunk, y0, x0, tile_at(ptr(memory), 0, chunk))


def _query(h, w):
    """A query with receivers of all kinds, in random order."""
    rng = np.random.default_rng(100 * h + w)
    axes = np.eye(3)
    return ShadowQuery(
        rng.normal(size=(h, w, 3)).astype(np.float32),
        rng.integers(-1, 9, (h, w)).astype(np.int32),
        rng.choice(np.array([1, -1, FREE, NOTHING], np.int8), (h, w)),
        np.array([0.0, 0.0, 3.0]).reshape(1, 1, 3)[:0],
        np.zeros((9, 9), np.float32),
        LightPatch(FIXED, axes[1], axes[0], axes[2], axes[1], 0.0),
        rng.random((16, 1, 3)),
        0,
        rng.integers(-1, 9, (h, w)).astype(np.int32),
    )


@pytest.mark.parametrize("h, w", [(8, 8), (9, 11), (6, 13), (1, 32), (1, 41), (3, 3)])
def test_receivers(h, w):
    query = _query(h, w)
    shape = tile_shape(query)
    table, places, seen = light_table(query, sets_of(shape)), np.arange(h * w).reshape(h, w), []
    for y0 in range(0, h, shape.height):
        for x0 in range(0, w, shape.width):
            memory = np.full(TILE_FLOATS, np.nan, np.float32)
            valid = _load(query, table, shape, y0, x0, memory) >> np.arange(16) & 1 != 0
            y, x = y0 + np.arange(16) // shape.width, x0 + np.arange(16) % shape.width
            inside = (y < h) & (x < w)
            y, x = np.minimum(y, h - 1), np.minimum(x, w - 1)
            np.testing.assert_array_equal(valid, inside & (query.sides[y, x] != NOTHING))
            y, x = y[valid], x[valid]
            sides = query.sides[y, x].astype(np.float32)
            np.testing.assert_array_equal(memory[:48].reshape(3, 16)[:, valid], query.origins[y, x].T)
            np.testing.assert_array_equal(memory[48:64].view(np.int32)[valid], query.ids[y, x])
            np.testing.assert_array_equal(memory[64:80][valid], np.where(sides == FREE, 0, sides))
            seen.extend(places[y, x])
    assert sorted(seen) == list(np.flatnonzero(query.sides.ravel() != NOTHING)) != []


@kernel
def _first_part(query, table, shape, lanes, light, memory):
    tile = tile_at(ptr(memory), 0, query_chunk_of(query, table, shape, 0, 1))
    return coherent_part(tile, lanes, light)


def _parts(origins, faces, light):
    """The part of each of 16 receivers."""
    query, memory = _query(4, 4), np.full(TILE_FLOATS, np.nan, np.float32)
    memory[:48], memory[48:64] = origins.T.astype(np.float32).ravel(), faces.astype(np.int32).view(np.float32)
    shape, left, parts, n = tile_shape(query), 0xFFFF, np.full(16, -1), 0
    table = light_table(query, sets_of(shape))
    while left:
        part = _first_part(query, table, shape, left, np.float32(light), memory)
        assert part & ~left == 0 != part & left & -left
        parts[part >> np.arange(16) & 1 != 0], left, n = n, left & ~part, n + 1
    return parts


@pytest.mark.parametrize("n_places", [1, 2, 3, 4])
@pytest.mark.parametrize("axis", range(3))
def test_receivers_in_places_far_apart_are_divided_into_these_places(axis, n_places):
    rng = np.random.default_rng(10 * axis + n_places)
    place = rng.permutation(np.arange(16) % n_places)
    origins = rng.random((16, 3)) * 0.01
    origins[:, axis] += place
    parts = _parts(origins, np.arange(16), light=0.1)
    np.testing.assert_array_equal(parts[:, None] == parts, place[:, None] == place)
    assert (_parts(origins, np.full(16, 7), light=0.1) == 0).all()  # on one triangle
    assert (_parts(origins, np.arange(16), light=50.0) == 0).all()  # the light is much larger


def test_receivers_of_a_flat_surface_stay_together():
    y, x = np.divmod(np.arange(16.0), 4)
    assert (_parts(np.stack([x, y, x + y], 1), np.arange(16), light=0.5) == 0).all()
