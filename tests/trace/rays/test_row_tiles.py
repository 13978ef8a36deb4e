"""Tiles of ray lists: which rays are traced together, and that it changes no answer."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import antumbra as at
from antumbra.query.ray_list import hit_arrays, rays_of
from antumbra.scene.triangles import HitFilter
from antumbra.trace.counters import RAYS, new_counters
from antumbra.trace.rays.row_tiles import BATCH, FEWEST, RUN, runs_of


def _picture(width, height, dtype=np.float32):
    """(origins, directions) of a camera at 0, row by row."""
    aspect = height / width
    x, y = np.meshgrid(np.linspace(-1, 1, width), np.linspace(-aspect, aspect, height))
    directions = np.stack([x, y, np.ones_like(x)], axis=-1).reshape(-1, 3).astype(dtype)
    return np.zeros_like(directions), directions


def _arguments(origins, directions):
    return rays_of(origins, directions, HitFilter(0.0, np.inf, None, None), (0.0, 0.0, 0.0), 1)


def _runs(origins, directions):
    return runs_of(_arguments(origins, directions).packed(), len(origins))


def _rays_in(runs, n):
    """The rays of all batches."""
    k = np.arange(BATCH)
    rays = runs[:, :1] + k // RUN * runs[:, 1:2] + k % RUN
    return rays[(k % RUN < runs[:, 2:]) & ((runs[:, 1:2] != RUN) | (rays < n))]


@settings(deadline=None)  # the first example compiles
@given(st.integers(16, 9000), st.integers(0, 3), st.integers(0, 200), st.integers(0, 2**32 - 1))
def test_every_ray_is_in_one_batch(width, most_left_out, more, seed):
    rng = np.random.default_rng(seed)
    origins, directions = _picture(width, FEWEST * 9 // 8 // width + 9)
    kept = np.flatnonzero(rng.integers(0, 100, len(origins)) >= most_left_out)
    kept = np.append(kept[: FEWEST + more], rng.permutation(len(origins))[:more])
    runs = _runs(origins[kept], directions[kept])
    assert len(runs) >= FEWEST // BATCH
    np.testing.assert_array_equal(np.sort(_rays_in(runs, len(kept))), np.arange(len(kept)))


@pytest.mark.parametrize("width", [64, 100, 640, 1001, 4096])
def test_the_rows_of_a_picture_are_found(width):
    height = -(-2 * FEWEST // width) // RUN * RUN + RUN
    runs = _runs(*_picture(width, height))
    assert set(runs[:, 1]) == {width} and len(runs) == height // RUN * -(-width // RUN)


def test_rows_are_found_where_pixels_are_left_out():
    origins, directions = _picture(640, 400)
    seen = directions[:, 0] < 0.5 + directions[:, 1] / 2  # a slanted edge
    runs = _runs(origins[seen], directions[seen])
    assert (runs[:, 1] != RUN).mean() > 0.9 and len(set(runs[:, 1])) > 10


def test_rows_of_a_grid_of_parallel_rays_are_found():
    directions, origins = _picture(300, 200)
    assert set(_runs(origins, directions + np.float32(1.0))[:, 1]) == {300}


@pytest.mark.parametrize("same", [False, True])
def test_without_rows_rays_stay_in_their_order(same):
    rays = np.random.default_rng(1).normal(size=(2, FEWEST, 3)).astype(np.float32)
    runs = _runs(*(np.ones_like(rays) if same else rays))
    np.testing.assert_array_equal(runs, [[first, RUN, RUN] for first in range(0, FEWEST, BATCH)])


def test_few_rays_are_not_searched():
    origins, directions = _picture(64, FEWEST // 64)
    assert len(_runs(origins, directions)) > 0 == len(_runs(origins[1:], directions[1:]))


def test_rays_that_are_not_numbers_stay_in_one_batch_each():
    origins, directions = _picture(256, 256)
    for bad in np.nan, np.inf, 3e38:
        directions[::17] = bad
        np.testing.assert_array_equal(np.sort(_rays_in(_runs(origins, directions), len(origins))), np.arange(1 << 16))


# --- Answers ----------------------------------------------------------------------------------------------------------


def _scene():
    rng = np.random.default_rng(2)
    corners = rng.uniform((-4, -3, 2), (4, 3, 6), (700, 1, 3)) + rng.normal(size=(700, 3, 3)) / 3
    return at.Scene.from_arrays(corners)


def _in_pieces(query, size, *arrays):
    """The answers of a query for lists that are too short for tiles."""
    pieces = [query(*(each[at : at + size] for each in arrays)) for at in range(0, len(arrays[0]), size)]
    if isinstance(pieces[0], np.ndarray):
        return [np.concatenate(pieces)]
    return [np.concatenate([getattr(each, name) for each in pieces]) for name in ("t", "face", "u", "v")]


def _assert_equal(whole, pieces):
    whole = [whole] if isinstance(whole, np.ndarray) else [whole.t, whole.face, whole.u, whole.v]
    for one, other in zip(whole, pieces, strict=True):
        np.testing.assert_array_equal(one, other)
    assert len(np.unique(whole[0])) > 1  # hits and misses


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
@pytest.mark.parametrize("width", [203, 321])
@pytest.mark.parametrize("threads", [1, 3])
def test_answers_do_not_depend_on_tiles(dtype, width, threads):
    scene, (origins, directions) = _scene(), _picture(width, 171 + FEWEST // width, dtype)
    assert len(origins) % BATCH > 0 and (_runs(origins, directions)[:, 1] == width).any()
    rng = np.random.default_rng(3)
    tmin, tmax = rng.choice([0.0, 2.5], len(origins)), rng.choice([3.0, 4.0, np.inf], len(origins))
    skip = rng.integers(-1, scene.n_triangles, len(origins))
    strided = np.concatenate([origins, directions], axis=1)
    for query in scene.occluded, scene.closest_hit:
        _assert_equal(query(strided, threads=threads), _in_pieces(query, 997, origins, directions))
        arrays = origins, directions, tmin, tmax, skip
        _assert_equal(query(*arrays, threads=threads), _in_pieces(query, 997, *arrays))


def test_segments_from_a_picture_to_a_light_do_not_depend_on_tiles():
    scene, (origins, directions) = _scene(), _picture(320, 200)
    points, light = (origins + 8 * directions).astype(np.float64), np.array([0.5, 2.5, -1.0])
    query = lambda points: scene.occluded(points, targets=light)
    _assert_equal(query(points), _in_pieces(query, 997, points))


def test_counters_have_the_number_of_rays():
    scene, (origins, directions) = _scene(), _picture(203, 300)
    scene.occluded(origins[:1], directions[:1])
    counters, n = new_counters(), len(origins)
    tracer = scene.engine.source.ray_lists._ready_at(0.0, n).tracer
    assert tracer.trace(_arguments(origins, directions), True, hit_arrays(n, True), 2, counters)
    assert counters[RAYS] == n


def test_an_invalid_ray_of_a_tile_is_named():
    scene, (origins, directions) = _scene(), _picture(320, 200)
    directions[31_234] = 0.0
    with pytest.raises(at.InputError, match="31234"):
        scene.occluded(origins, directions)
