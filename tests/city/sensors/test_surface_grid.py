"""Grids of sensors on surfaces, and other sensors: anchored in the world, so that unchanged faces keep them."""

import numpy as np
import pytest

import antumbra as at
from antumbra.scene.joined_scenes import join_data

QUADS = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
FACES = np.array([tri for a, b, c, d in QUADS for tri in ((a, b, c), (a, c, d))])
BOX = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], float)
STRAIGHT = np.eye(3)
TURN = np.array([[0.8, -0.6, 0.0], [0.6, 0.8, 0.0], [0.0, 0.0, 1.0]])
HILL = [[[-5, -5, 0], [40, -5, 2], [40, 30, 4]], [[-5, -5, 0], [40, 30, 4], [-5, 30, 1.5]]]
PLACES = {"at zero": (0.0, 0.0, 0.0), "on a map": (584321.375, 5746123.9375, 1.25)}
TOWERS = {"high": ((100, -50, 0), (7, 9, 130)), "far": ((-700, 220, -3), (3, 3, 60)), "near": ((30, 16, 1), (2, 3, 4))}
MAKERS = {
    "face": at.face_sensors,
    "vertex": at.vertex_sensors,
    "grid": lambda scene: at.grid_sensors(scene, 0.7),
    "raster": lambda scene: at.raster_sensors(scene, 0.7, 1.6),
}


def box(low, size, turn=STRAIGHT):
    """(12, 3, 3): a box, with corners that float32 represents in any frame."""
    corners = np.array(low) + np.round(BOX * size @ turn.T * 1024.0) / 1024.0
    return corners[FACES]


def village(place):
    """Two boxes along the axes, an oblique one, and a slope."""
    parts = box((0, 0, 0), (10, 6, 3)), box((20, 3, 0), (4, 9, 5.5)), box((10, 15, 0), (8, 5, 4), TURN), np.array(HILL)
    return np.concatenate(parts) + place


def scene_of(corners, up="z"):
    return at.Scene.from_arrays(corners if up == "z" else corners[..., [0, 2, 1]] * (1, 1, -1), up=up)


def rows(sensors, faces):
    """The points, normals and areas of the sensors on the first faces, in a fixed order."""
    known = (sensors.faces >= 0) & (sensors.faces < faces)
    table = np.c_[sensors.points, sensors.normals, sensors.areas][known]
    return table[np.lexsort(table.T)]


@pytest.mark.parametrize("up", ["y", "z"])
@pytest.mark.parametrize("tower", TOWERS)
@pytest.mark.parametrize("place", PLACES)
@pytest.mark.parametrize("kind", MAKERS)
def test_a_tower_elsewhere_moves_no_sensor(kind, place, tower, up):
    before, make = village(PLACES[place]), MAKERS[kind]
    low, size = TOWERS[tower]
    both = scene_of(np.concatenate([before, box(low, size) + PLACES[place]]), up)
    kept, alone = rows(make(both), len(before)), rows(make(scene_of(before, up)), len(before))
    if kind == "raster" and tower == "near":  # it stands on some cells of the slope
        kept = {tuple(row) for row in kept}
        missing = {tuple(row) for row in alone} - kept
        assert kept <= {tuple(row) for row in alone} and 6 <= len(missing) <= 20
    else:
        assert len(alone) >= 28 and np.array_equal(kept, alone)


@pytest.mark.parametrize("place", PLACES)
def test_grids_of_level_faces_and_of_walls_along_axes_lie_beside_the_middles_of_world_cells(place):
    sensors = at.grid_sensors(at.Scene.from_arrays(box((0, 0, 0), (10, 6, 3)) + PLACES[place], up="z"), 0.5)
    steps = sensors.points / 0.5
    flat = sensors.normals == 0.0
    beside = np.abs(steps[flat] % 1.0 - 0.5)
    assert len(sensors) == 4 * (2 * 60 + 2 * 30 + 2 * 18) and (beside == 2.0**-7).all()


@pytest.mark.parametrize("spacing", [0.5, 0.7])
@pytest.mark.parametrize("kind", ["grid", "raster"])
def test_moving_a_scene_by_multiples_of_the_spacing_moves_its_sensors_with_it(kind, spacing):
    make = {"grid": at.grid_sensors, "raster": at.raster_sensors}[kind]
    parts = np.concatenate([box((0, 0, 0), (10, 6, 3)), box((20, 3, 0), (4, 9, 5.5))])
    steps = np.array([1800.0, -640.0, 20.0])
    shift = steps * spacing
    here, there = (make(at.Scene.from_arrays(parts + offset, up="z"), spacing) for offset in (0.0, shift))
    assert len(here) == len(there) and np.allclose(here.points + shift, there.points, rtol=0.0, atol=1e-4)
    assert spacing != 0.5 or np.array_equal(here.points + shift, there.points)


def test_oblique_surfaces_keep_their_grid_over_whole_blocks_of_it():
    parts, shift = village((0.0, 0.0, 0.0)), np.array([2.0, -3.0, 1.0]) * 256 * 0.5
    here, there = (at.grid_sensors(at.Scene.from_arrays(parts + offset, up="z"), 0.5) for offset in (0.0, shift))
    assert len(here) > 4000 and np.array_equal(here.points + shift, there.points)


@pytest.mark.parametrize("angle", [0.0, 31.7, 90.0, 203.9])
def test_both_triangles_of_an_upright_rectangle_share_a_grid(angle):
    turn = np.radians(angle)
    along = np.array([np.cos(turn), np.sin(turn), 0.0])
    corners = np.array([84321.37, 446123.91, 1.23]) + np.array([[0, 0], [8, 0], [8, 4], [0, 4]]) @ [along, [0, 0, 1]]
    sensors = at.grid_sensors(at.Scene.from_arrays(corners, [[0, 1, 2], [0, 2, 3]], up="z"), 0.5)
    flat = (sensors.points - corners[0]) @ np.c_[along, [0, 0, 1]] / 0.5
    offset = flat - flat[0]
    assert 15 * 7 <= len(sensors) <= 17 * 9 and np.abs(offset - np.round(offset)).max() < 1e-3
    assert np.isclose(sensors.areas.sum(), 32.0)


@pytest.mark.parametrize("spacing", [0.1, 0.3, 0.7, 2.0])
def test_rasters_with_edges_at_multiples_of_the_spacing_share_their_centres(spacing):
    rng = np.random.default_rng(5)
    middles = [set(), set()]
    for west, south in rng.integers(-(10**6), 10**6, (8, 2)):
        raster = at.Raster(float(west * spacing), float(south * spacing), spacing, 40, 30)
        for wider in (raster, raster._replace(west=float((west - 17) * spacing), columns=57)):
            east, north = wider.middles()
            middles[0].add(tuple(east[-40:])), middles[1].add(tuple(north))
    assert [len(each) for each in middles] == [8, 8]


TURNS = {"straight": STRAIGHT, "turned by a quarter": np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])}
FAR = {"at zero": (0.0, 0.0, 0.0), "on a map": (584321.377, 5746123.941, 1.253), "far": (-2.1e6, 1.3e7 + 0.1, -7.7)}


def rough(corners, turn, place, foot):
    """Corners in millimetres, which no frame holds in float32; turned, in feet if `foot`, and moved to a place."""
    moved = np.round(corners * 1000.0 + (0.123, 0.456, 0.789)) / 1000.0 @ turn.T
    return moved / (0.3048 if foot else 1.0) + place


@pytest.mark.parametrize("foot", [False, True])
@pytest.mark.parametrize("turn", TURNS)
@pytest.mark.parametrize("place", FAR)
@pytest.mark.parametrize("kind", MAKERS)
def test_surfaces_in_millimetres_keep_their_sensors_bit_for_bit_beside_any_other_object(kind, place, turn, foot):
    part = {"turn": TURNS[turn], "place": FAR[place], "foot": foot}
    before, make = rough(village((0, 0, 0)), **part), MAKERS[kind]
    alone = rows(make(scene_of(before)), len(before))
    assert len(alone) >= 28
    for low, size in TOWERS.values():
        both = scene_of(np.concatenate([before, rough(box(low, size), **part)]))
        kept = rows(make(both), len(before))
        if kind == "raster":  # a tower may stand on some cells
            assert len(kept) > 0.98 * len(alone)
            assert {tuple(row) for row in kept} <= {tuple(row) for row in alone}
        else:
            assert np.array_equal(kept, alone)


@pytest.mark.parametrize("corner", [(0.0, 0.0, 1.0), (584321.3, 5746123.9, 0.7), (-2.1e6, 1.3e7, 2.0)])
def test_the_cells_of_a_raster_keep_their_heights_bit_for_bit_beside_a_tower(corner):
    affine = pytest.importorskip("affine")
    west, north, side = corner
    heights = np.random.default_rng(1).uniform(30.0, 90.0, (25, 31))
    bare = at.from_raster((heights, affine.Affine(side, 0.0, west, 0.0, -side, north)))
    tower = at.Scene.from_arrays(box((400.0, -8.0, 500.0), (3.0, 3.0, 80.0)) + (west, north, 0.0), up="z")
    both = at.Scene.of_data(join_data(bare.data, tower.data, "both"))
    alone, kept = (at.sensors_of("raster", scene) for scene in (bare, both))
    assert np.array_equal(alone.points, kept.points) and np.array_equal(alone.points[:, 2], heights.ravel())
