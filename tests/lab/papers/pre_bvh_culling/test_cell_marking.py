"""The cells marked as published equal those of a brute-force walk in rational arithmetic."""

from itertools import product

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

import antumbra as at
import reference_cells as reference
from antumbra.lab.papers.pre_bvh_culling.cell_marking import LINES, mark_lines, source_cells, walk_lines, with_one_ring
from antumbra.lab.papers.pre_bvh_culling.light_cells import light_cells
from antumbra.query.light_samples import light_samples
from antumbra.query.receivers import FREE, NOTHING
from antumbra.query.shadow_query import ShadowQuery
from antumbra.scene.triangles import Triangles
from antumbra.techniques.culling.culling_grid import PAD, grid_over, tiles_of
from antumbra.techniques.culling.pre_bvh_culling import cull, mark_segments
from strength import examples

SEEDS = st.integers(0, 2**32 - 1)


def _query(light, origins, sides=None, spp=1):
    """The query of (h, w, 3) receivers without surfaces."""
    origins = np.ascontiguousarray(origins, np.float32)
    shape = origins.shape[:2]
    nobody, sides = np.full(shape, -1, np.int32), np.full(shape, FREE, np.int8) if sides is None else sides
    patch = light.patch(np.zeros(3), 100.0)
    return ShadowQuery(
        origins, nobody, sides, np.empty((0, 0, 3)), np.empty((0, 9), np.float32), patch, light_samples(light, spp), 0,
        nobody,
    )  # fmt: skip


def _set(cells):
    return set(map(tuple, np.asarray(cells).tolist()))


def _marked(cells):
    return _set(np.argwhere(cells))


def _grid(rng, n, around=()):
    """A grid over random corners, and the points `around`."""
    corners = np.concatenate([rng.normal(size=(2, 3)) * rng.uniform(0.5, 4.0), np.reshape(around, (-1, 3))])
    return grid_over(corners.min(0), corners.max(0), n)


# --- Source cells -----------------------------------------------------------------------------------------------------


@examples(40)
@given(seed=SEEDS, n=st.sampled_from([1, 5, 32, 33, 64, 128]), h=st.integers(1, 19), w=st.integers(1, 70))
def test_source_cells_are_those_of_the_receivers(seed, n, h, w):
    """Also in grids that are finer than the 32 cells into which `grid64` sorts them."""
    rng = np.random.default_rng(seed)
    origins = rng.normal(size=3) + rng.choice([1e-3, 0.1, 1.0]) * rng.normal(size=(h, w, 3))
    sides = rng.choice(np.array([1, -1, NOTHING], np.int8), (h, w))
    query = _query(at.PointLight((0, 0, 0)), origins, sides)
    grid = _grid(rng, n, query.origins)
    cells = source_cells(tiles_of(query, 2), grid, 2)
    there = query.origins[sides != NOTHING]
    assert _set(cells) == reference.cells_of_points(grid.bounds[0, :3], grid.scale[:3], n, there)
    assert len(cells) == len(_set(cells)) and (len(cells) > 0) == (len(there) > 0)


def test_finer_grids_have_their_own_source_cells():
    """A dense plane of receivers has 64 x 64 cells of 64^3, not the cells that boxes of 32^3 overlap."""
    x = (np.arange(256) + 0.5) / 256
    plane = np.stack(np.broadcast_arrays(x, 0.3 * x[:, None] + 0.2, x[:, None]), -1)
    grid = grid_over(np.zeros(3), np.ones(3), 64)
    cells = source_cells(tiles_of(_query(at.PointLight((0, 0, 0)), plane), 2), grid, 2)
    assert 64 * 64 <= len(cells) <= 64 * 64 * 1.35
    np.testing.assert_array_equal(np.unique(cells[:, [0, 2]], axis=0), list(product(range(64), repeat=2)))


# --- Destination cells ------------------------------------------------------------------------------------------------


def _light_and_shape(kind, rng):
    """A light of random size, its outermost points, and a function that tests whether it meets a box, in fractions."""
    place, size = rng.normal(size=3), rng.choice([0.02, 0.5, 3.0])
    u, v = size * rng.normal(size=(2, 3))
    if rng.random() < 0.4:
        u, v = u * (1, 0, 0), v * (0, 0, 1)
    if kind == "sphere":
        centre, radius = reference.rational(place), reference.rational(size)
        meets = lambda box: reference.ball_meets(box, centre, radius)
        return at.SphereLight(place, size), [place - size, place + size], meets
    if kind == "points":
        points = place + size * rng.normal(size=(20, 3))
        polygons, light = [[point] for point in reference.rational(points)], at.PointLights(points)
    elif kind == "point":
        points = place[None]
        polygons, light = [reference.rational(points)], at.PointLight(place)
    else:
        points, light = np.array([place, place + u, place + u + v, place + v]), at.QuadLight(place, u, v)
        polygons = [reference.rational(points)]
    return light, points, lambda box: any(reference.polygon_meets(box, polygon) for polygon in polygons)


@pytest.mark.parametrize("kind", ["quad", "sphere", "point", "points"])
@examples(15)
@given(seed=SEEDS, n=st.sampled_from([1, 3, 5]))
def test_destination_cells_overlap_the_light(kind, seed, n):
    rng = np.random.default_rng(seed)
    light, around, meets = _light_and_shape(kind, rng)
    grid = _grid(rng, n, around)
    pad = PAD * np.abs(grid.bounds).max()
    boxes = reference.cell_boxes(grid.bounds[0, :3], grid.bounds[1, :3], grid.scale[:3], n, pad)
    cells = light_cells(_query(light, np.zeros((1, 1, 3))), grid)
    assert _set(cells) == {cell for cell, box in boxes.items() if meets(box)} and len(cells) == len(_set(cells))


@examples(15)
@given(seed=SEEDS, axis=st.sampled_from([None, 0, 1, 2]))
def test_destination_cells_of_a_disk(seed, axis):
    """Cells that meet a polygon inside the disk are there; those that meet none around it are not."""
    rng, n, sides = np.random.default_rng(seed), 5, 96
    normal = rng.normal(size=3) if axis is None else np.eye(3)[axis]
    light = at.DiskLight(rng.normal(size=3), normal, rng.choice([0.1, 0.5, 2.0]))
    query = _query(light, np.zeros((1, 1, 3)))
    u, v, angle = query.light.u, query.light.v, 2.0 * np.pi * np.arange(sides)[:, None] / sides
    circle = np.cos(angle) * u + np.sin(angle) * v
    inner, outer = query.light.base + circle, query.light.base + circle / np.cos(np.pi / sides)
    grid = _grid(rng, n, outer)
    pad = PAD * np.abs(grid.bounds).max()
    boxes = reference.cell_boxes(grid.bounds[0, :3], grid.bounds[1, :3], grid.scale[:3], n, pad)
    cells = _set(light_cells(query, grid))
    at_least, at_most = (
        {cell for cell, box in boxes.items() if reference.polygon_meets(np.array(box, float), polygon)}
        for polygon in (inner, outer)
    )
    assert at_least <= cells <= at_most and at_least and len(at_most - at_least) <= 8


@examples(60)
@given(seed=SEEDS, exponent=st.integers(0, 18), kind=st.sampled_from(["disk", "quad", "sphere", "point"]))
def test_a_light_far_smaller_than_a_cell_is_in_its_cell(seed, exponent, kind):
    rng, radius = np.random.default_rng(seed), 1e-3
    place, normal = rng.normal(size=(2, 3))
    light = {
        "disk": lambda: at.DiskLight(place, normal, radius),
        "quad": lambda: at.QuadLight(place, *(radius * rng.normal(size=(2, 3)))),
        "sphere": lambda: at.SphereLight(place, radius),
        "point": lambda: at.PointLight(place),
    }[kind]()
    grid = _grid(rng, 8, np.concatenate([place[None], 10.0**exponent * rng.normal(size=(20, 3))]))
    low, scale = grid.bounds[0, :3].astype(np.float64), grid.scale[:3].astype(np.float64)
    cell = np.clip(np.floor((place - low) * scale), 0, 7)
    assert tuple(cell.astype(int)) in _set(light_cells(_query(light, np.zeros((1, 1, 3))), grid))


def test_destination_cells_do_not_depend_on_the_samples():
    light, grid = at.QuadLight((-1, 2, -3), (3, 0, 0.5), (0, 0.1, 6)), grid_over(np.full(3, -4.0), np.full(3, 4.0), 16)
    one, many = (light_cells(_query(light, np.zeros((1, 1, 3)), spp=spp), grid) for spp in (1, 256))
    np.testing.assert_array_equal(one, many)
    assert len(one) >= 6 * 12


# --- Lines ------------------------------------------------------------------------------------------------------------


@examples(150)
@given(ends=st.tuples(*[st.tuples(*[st.integers(0, 15)] * 3)] * 2))
@example(ends=((0, 0, 0), (15, 15, 15)))
@example(ends=((3, 9, 2), (9, 0, 2)))
def test_a_line_takes_the_cells_of_the_exact_walk(ends):
    a, b = ends
    assert _marked(walk_lines(np.array([a]), np.array([b]), 16, 1)) == set(reference.line_cells(a, b))


@examples(40)
@given(ends=st.tuples(*[st.tuples(*[st.integers(0, 6)] * 3)] * 2))
def test_the_exact_walk_follows_the_line(ends):
    """It misses no cell whose interior the line meets, and takes none that the line does not touch."""
    cells = set(reference.line_cells(*ends))
    assert reference.open_line_cells(*ends, 7) <= cells <= reference.closed_line_cells(*ends, 7)


def test_long_lines_in_the_finest_grid():
    ends = np.array([[0, 0, 0], [255, 254, 253], [255, 0, 255], [1, 255, 127], [128, 128, 0]])
    lines = walk_lines(ends, ends, 256, 2)
    expected = {cell for a, b in product(ends.tolist(), repeat=2) for cell in reference.line_cells(a, b)}
    assert _marked(lines) == expected and len(expected) > 2000


@examples(15)
@given(seed=SEEDS, threads=st.integers(1, 3))
def test_marked_cells_are_the_lines_with_their_neighbours(seed, threads):
    """From the receivers and the light to the marked cells, in a grid over the triangles, both ends included."""
    rng, n = np.random.default_rng(seed), 9
    vertices = np.ascontiguousarray(rng.normal(size=(5, 3, 3)), np.float32)
    triangles = Triangles(vertices, np.zeros(3), np.arange(5, dtype=np.int32), np.ones((5, 3)))
    light, _, meets = _light_and_shape("quad", rng)
    query = _query(light, rng.normal(size=(2, 6, 3)))
    marking = mark_segments(triangles, [query], threads, n=n, method=LINES)
    grid = marking.grid
    pad = PAD * np.abs(grid.bounds).max()
    boxes = reference.cell_boxes(grid.bounds[0, :3], grid.bounds[1, :3], grid.scale[:3], n, pad)
    sources = reference.cells_of_points(grid.bounds[0, :3], grid.scale[:3], n, query.origins.reshape(-1, 3))
    ends = {cell for cell, box in boxes.items() if meets(box)}
    lines = {cell for a, b in product(sources, ends) for cell in reference.line_cells(a, b)}
    assert _marked(marking.cells.cells) == reference.ring(lines, n)
    assert (marking.sources, marking.targets) == (len(sources), len(ends))
    everything = vertices.reshape(-1, 3), query.origins.reshape(-1, 3), query.light.base[None]
    assert all((points >= grid.bounds[0, :3]).all() and (points <= grid.bounds[1, :3]).all() for points in everything)


@examples(20)
@given(seed=SEEDS, n=st.integers(1, 6))
def test_the_one_ring(seed, n):
    cells = (np.random.default_rng(seed).random((n, n, n)) < 0.1).astype(np.uint8)
    assert _marked(with_one_ring(cells)) == reference.ring(_marked(cells), n)


def test_a_distant_light_marks_every_cell():
    query, grid = _query(at.DirectionalLight((0, -1, 0)), np.zeros((1, 4, 3))), grid_over(np.zeros(3), np.ones(3), 4)
    marked = np.zeros((4, 4, 4), np.uint8)
    assert mark_lines(source_cells(tiles_of(query, 1), grid, 1), query, grid, marked, 1) == 0
    assert marked.all()


def test_nobody_asks():
    triangles = Triangles(np.eye(3, dtype=np.float32)[None], np.zeros(3), np.zeros(1, np.int32), np.ones((1, 3)))
    silent = _query(at.PointLight((0, 0, 0)), np.zeros((1, 4, 3)), np.full((1, 4), NOTHING, np.int8))
    assert len(cull(triangles, [silent], 1, method=LINES).kept) == 0
