"""Sensors by block: the bits of those made at once, whatever the blocks."""

import numpy as np
import pytest

import antumbra as at
from antumbra.city.sensors.point_checks import notes_on_sensors
from antumbra.city.sensors.sensor_blocks import ChangedBlocks, DescribedSensors
from antumbra.city.sensors.sensor_files import sensor_blocks, sensors_of
from antumbra.city.sensors.surface_grid import grid_sensors

FORMS = "face", "face+0.02", "grid:0.9", "grid:7", "raster:0.8", "raster:0.8+1.6", "raster:0.8@2.5", "raster:0.8+-1"


def town(up="z", turns=0):
    """Boxes, a slope, a sliver and a face without area, with nothing between them; turned by quarters."""
    rng = np.random.default_rng(5)
    cube = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], float)
    quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    faces = np.array([tri for a, b, c, d in quads for tri in ((a, b, c), (a, c, d))])
    soup = [cube[faces] * rng.uniform(1, 5, 3) + (*rng.uniform(-12, 12, 2), 0) for _ in range(6)]
    odd = [
        [[-9, -9, 0], [9, -8, 1], [8, 9, 4]],
        [[0, 0, 9], [14, 9, 9], [14.001, 9, 9]],
        [[1, 1, 1], [2, 2, 2], [3, 3, 3]],
    ]
    corners = np.concatenate([*soup, np.array(odd, float)])
    for _ in range(turns):
        corners = corners[..., [1, 0, 2]] * (-1, 1, 1)
    return at.Scene.from_arrays(corners if up == "z" else corners[..., [0, 2, 1]] * (1, 1, -1), up=up)


def dem():
    """A raster of heights with a hole, as a scene."""
    rng = np.random.default_rng(2)
    heights = rng.uniform(0, 9, (23, 31)).astype(np.float32)
    heights[5:8, 9:20] = np.nan
    return at.from_raster((heights, (2.0, 0.0, 100.0, 0.0, -2.0, 400.0)))


def equal(a, b):
    """Whether all fields are the same, to the last bit."""
    for name in ("points", "normals", "areas", "faces"):
        assert np.array_equal(getattr(a, name), getattr(b, name)), name
    assert a.kind == b.kind and a.raster == b.raster and np.array_equal(a.covered, b.covered)


@pytest.mark.parametrize("up, turns", [("z", 0), ("y", 0), ("z", 1)])
@pytest.mark.parametrize("form", FORMS)
def test_blocks_are_the_sensors_made_at_once(form, up, turns):
    scene = town(up, turns)
    described, whole = sensor_blocks(form, scene), sensors_of(form, scene)
    assert isinstance(described, DescribedSensors)
    n = len(whole)
    assert len(described) == n > 60 and described.kind == whole.kind
    for size in (1, 7, 50, n):
        starts = range(0, n, size) if size > 1 else (0, n // 2, n - 1)
        for first in starts:
            last = min(first + size, n)
            equal(described.block(first, last), whole.take(np.arange(first, last)))
    equal(described.whole(), whole)
    assert len(described.block(n, n)) == len(described.block(0, 0)) == 0


def test_blocks_of_a_raster_of_heights_are_its_cells():
    scene = dem()
    described, whole = sensor_blocks("raster+1.6", scene), sensors_of("raster+1.6", scene)
    assert 0 < (~whole.covered).sum() < len(whole) == len(described)
    for first in range(0, len(whole), 40):
        last = min(first + 40, len(whole))
        equal(described.block(first, last), whole.take(np.arange(first, last)))


def lattice_by_brute_force(corners, spacing):
    """(m, 2): the points of a level triangle's grid, from the sides of all candidates."""
    phase = spacing * (0.5 + 2.0**-7)
    low, high = corners.min(0), corners.max(0)
    x, y = (np.arange(np.floor(a / spacing) - 1, np.ceil(b / spacing) + 1) * spacing + phase for a, b in zip(low, high))
    at_ = np.stack(np.meshgrid(x, y), -1).reshape(-1, 2)
    edges, away = np.roll(corners, -1, 0) - corners, at_[None] - corners[:, None]
    sides = edges[:, :1] * away[..., 1] - edges[:, 1:] * away[..., 0]
    return at_[(sides > 0).all(0)]


def test_a_grid_has_the_lattice_points_inside_a_triangle():
    rng = np.random.default_rng(11)
    counted = 0
    for _ in range(40):
        corners = np.round(rng.uniform(-9, 9, (3, 2)), 3)
        (a, b), (c, d) = corners[1:] - corners[0]
        if a * d - b * c < 1.0:
            continue
        scene = at.Scene.from_arrays(np.c_[corners, np.zeros(3)][None], up="z")
        points = grid_sensors(scene, 0.5).points[:, :2]
        expected = lattice_by_brute_force(corners, 0.5)
        assert np.allclose(points[np.lexsort(points.T)], expected[np.lexsort(expected.T)], atol=1e-9)
        counted += len(points)
    assert counted > 500


def test_descriptions_differ_with_what_determines_the_sensors():
    scene, other = town(), town(turns=1)
    texts = [repr(sensor_blocks(form, scene).description) for form in FORMS]
    assert len(set(texts)) == len(FORMS)
    assert repr(sensor_blocks("face", other).description) not in texts


def test_sensors_in_memory_are_their_own_blocks():
    whole = sensors_of("raster:0.8+1.6", town())
    part = whole.block(10, 25)
    equal(part, whole.take(np.arange(10, 25)))
    assert part.normals.strides[0] == 0  # one normal for all: the ends of sightlines depend on it


def test_changed_blocks_leave_sensors_out():
    described = sensor_blocks("face", town())
    upper = ChangedBlocks(described, lambda some: some.take(np.flatnonzero(some.normals[:, 2] > 0.5)), "upper")
    n = len(upper)
    blocks = [upper.block(first, min(first + 9, n)) for first in range(0, n, 9)]
    assert np.array_equal(np.concatenate([each.points for each in blocks]), upper.whole().points)
    assert 0 < len(upper.whole()) < len(described) and upper.description[-1] == "upper"


@pytest.mark.parametrize("form", ["raster:0.8+-1", "face", "grid:0.9"])
def test_notes_on_blocks_add_up_to_those_on_all_sensors(form):
    from antumbra.city.sensors.block_parts import BlockParts

    scene = town()
    described, whole = sensor_blocks(form, scene), sensors_of(form, scene)
    found = lambda some: notes_on_sensors(scene, some, "sensors")
    blocks = BlockParts("test", described, 40, lambda some: {"x": some.points[:, 0]}, None, None, found)
    for k in range(len(blocks.parts)):
        blocks.parts.do(k)
    assert blocks.notes() == [str(note) for note in found(whole)]
    assert sum(blocks.counts()) == len(whole)
    assert np.array_equal(blocks.whole()["x"], whole.points[:, 0])


def test_cells_off_the_surfaces_stay_uncovered_in_a_choice_without_any_surface():
    whole = sensors_of("raster:0.8", town())
    off = whole.take(np.flatnonzero(~whole.covered))
    assert len(off) > 5 and not off.covered.any() and not off.take(np.arange(3)).covered.any()
    assert sensors_of("raster:0.8@2", town()).covered.all()
