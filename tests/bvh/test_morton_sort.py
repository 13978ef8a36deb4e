"""Morton codes against plain Python."""

import numpy as np
import pytest
from hypothesis import given

from antumbra.bvh.morton_sort import grid_of, write_codes
from antumbra.bvh.triangle_bounds import scene_bounds
from antumbra.kernels.parallel import new_ticket, run
from bvh_scenes import integer_grid, scattered, terrain
from reference_morton import morton_codes
from strategies import point_arrays
from strength import examples


def codes_of(vertices, bits, threads=1):
    n, flat = len(vertices), vertices.reshape(-1, 9)
    codes, ids = np.empty(n, np.int32 if bits == 10 else np.int64), np.empty(n, np.int32)
    grid = grid_of(scene_bounds(flat, threads)[1], bits)
    run(write_codes, threads, new_ticket(n, 64), flat, grid, codes, ids)
    assert np.array_equal(ids, np.arange(n))
    return codes


@pytest.mark.parametrize("bits", [10, 21])
@pytest.mark.parametrize(
    "vertices",
    [
        scattered(500), terrain(400), integer_grid(512), scattered(300) * np.float32(1e30), scattered(300) + 5e6,
        scattered(40) * np.float32(1e-42), np.tile(scattered(1), (9, 1, 1)),
    ],
    ids=["scattered", "terrain", "grid", "huge", "far", "denormal", "one point"],
)  # fmt: skip
def test_codes(vertices, bits):
    vertices = vertices.astype(np.float32)
    codes = codes_of(vertices, bits)
    assert codes.tolist() == morton_codes(vertices, bits)
    assert np.array_equal(codes, codes_of(vertices, bits, 3))


@examples(40)
@given(points=point_arrays((7, 3)))
def test_codes_of_any_triangles(points):
    for bits in (10, 21):
        assert codes_of(points, bits).tolist() == morton_codes(points, bits)


def test_short_codes_are_the_first_bits_of_long_ones():
    vertices = scattered(1000)
    assert np.array_equal(codes_of(vertices, 21) >> 33, codes_of(vertices, 10))


def test_a_flat_scene_is_not_cut_across_its_short_side():
    vertices = scattered(1000) * np.float32([1, 1e-4, 1])
    y = sum(((codes_of(vertices, 10) >> (3 * b + 1)) & 1) << b for b in range(10))
    assert y.max() <= 1
