"""Viewsheds: counts and observers as the oracle says, within limits, over a flat and over a curved earth."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import antumbra as at
from antumbra.city.sight import viewshed
from antumbra.city.tables.bit_matrices import unpack_bits
from antumbra.engine.sources import terrain_shadows
from sight_scenes import expected, scene_of
from strength import examples


def ground(size=100.0, up="z"):
    """A square of two faces, with a wall of two faces along north at x = 0, 10 high."""
    corners = [[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]]
    wall = [[0, -1, 0], [0, 1, 0], [0, 1, 10 / size], [0, -1, 10 / size]]
    at_z = size * np.array(corners + wall)
    vertices = at_z if up == "z" else np.stack([at_z[:, 0], at_z[:, 2], -at_z[:, 1]], 1)
    return at.Scene.from_arrays(vertices, [[0, 1, 2], [0, 2, 3], [4, 5, 6], [4, 6, 7]], up=up)


@examples(8)
@given(st.integers(0, 2**32 - 1))
def test_every_line_of_sight_equals_the_oracle(seed):
    scene, rng = scene_of(seed)
    sensors, eyes = at.face_sensors(scene), rng.uniform(-1.5, 1.5, (70, 3))
    found = at.viewshed(scene, sensors, eyes, bits=True)
    want = expected(scene, (sensors.points, sensors.normals), (eyes, None))
    assert np.array_equal(unpack_bits(found.bits, 70), want) and 0 < want.sum() < want.size
    table, away = found.table, np.linalg.norm(sensors.points[:, None] - eyes, axis=2)
    away[~want] = np.inf
    none = ~want.any(1)
    assert np.array_equal(table["seen"], want.sum(1))
    assert np.array_equal(table["first"], np.where(none, -1, want.argmax(1)))
    assert np.array_equal(table["nearest"], np.where(none, -1, away.argmin(1)))
    assert np.allclose(table["distance"], np.where(none, np.nan, away.min(1)), equal_nan=True)


def test_many_observers_in_several_lists(monkeypatch):
    scene, rng = scene_of(3)
    sensors, eyes = rng.uniform(-1.5, 1.5, (1100, 3)), rng.uniform(-1.5, 1.5, (150, 3))
    whole = at.viewshed(scene, sensors, eyes, max_distance=1.0, bits=True)
    monkeypatch.setattr(viewshed, "MAX_SPP", 64)
    monkeypatch.setattr(viewshed, "MAX_PAIRS", 64)
    parts = at.viewshed(scene, sensors, eyes, max_distance=1.0, bits=True)
    for name in whole.table.columns:
        assert np.array_equal(whole.table[name], parts.table[name], equal_nan=True), name
    assert np.array_equal(whole.bits, parts.bits) and whole.bits.any()


@pytest.mark.parametrize("up", ["y", "z"])
def test_a_wall_hides_what_is_behind_it(up):
    scene = ground(up=up)
    raster = at.raster_sensors(scene, 20.0, 0.5)
    eye = [50.0, 0, 5.0] if up == "z" else [50.0, 5.0, 0]
    seen = at.viewshed(scene, raster, eye).table["seen"].reshape(10, 10)
    assert (seen[:, 5:] == 1).all() and (seen[:, :5] == 0).all()
    high = at.viewshed(scene, raster, eye, eye_height=1000.0).table["seen"]
    assert high.sum() > 50


@pytest.mark.parametrize("up", ["y", "z"])
def test_limits(up):
    """On open ground: compass directions, angles and distances leave out what they should."""
    flat = [[-100, -100, 0], [100, -100, 0], [100, 100, 0], [-100, 100, 0]]
    turned = flat if up == "z" else [[x, z, -y] for x, y, z in flat]
    scene = at.Scene.from_arrays(turned, [[0, 1, 2], [0, 2, 3]], up=up)
    raster = at.raster_sensors(scene, 20.0)
    east, north = np.meshgrid(np.arange(-90, 91, 20), np.arange(90, -91, -20))
    level, eye = np.hypot(east, north), [0, 0, 10] if up == "z" else [0, 10, 0]
    ask = lambda **more: at.viewshed(scene, raster, eye, **more).table["seen"].reshape(10, 10) == 1
    assert ask().all()
    assert np.array_equal(ask(azimuth=(315, 45)), north >= np.abs(east))
    assert np.array_equal(ask(azimuth=(0, 90)), (north > 0) & (east > 0))
    assert np.array_equal(ask(azimuth=(-90, 0)), (north > 0) & (east < 0))
    straight = np.hypot(level, 10)
    assert np.array_equal(ask(min_distance=30, max_distance=80), (straight >= 30) & (straight <= 80))
    assert np.array_equal(ask(elevation=(-15, 90)), np.degrees(np.arctan2(10, level)) <= 15)


def test_observers_on_the_surface():
    scene = ground()
    found = at.viewshed(scene, at.face_sensors(scene), [[30, 0, 77], [-20, 5, -7]], eye_height=1.6, on_surface=True)
    assert np.allclose(found.observers, [[30, 0, 1.6], [-20, 5, 1.6]])
    assert np.array_equal(found.table.marks, found.observers)


def test_a_curved_earth_hides_the_foot_of_a_far_tower():
    """The sea between an eye 2 m high and posts 20 km away hides the lower 13 m of them, by the formula."""
    x, n = np.linspace(-1000, 30_000, 32), 31
    strip = np.concatenate([np.c_[x, np.full(32, -50.0), 0 * x], np.c_[x, np.full(32, 50.0), 0 * x]])
    faces = np.concatenate([[[k, k + 1, 33 + k], [k, 33 + k, 32 + k]] for k in range(n)])
    sea = at.Scene.from_arrays(strip, faces, up="z")
    heights = np.linspace(0.25, 40, 160)
    posts = np.c_[np.full(160, 20_000.0), np.zeros(160), heights]
    for k in 0.0, 0.13:
        seen = at.viewshed(sea, posts, [0, 0, 2.0], curvature=True, refraction=k).table["seen"]
        drop = (1 - k) / (2 * 6_371_000)
        hidden = drop * (20_000 - np.sqrt(2.0 / drop)) ** 2
        lowest = heights[seen == 1].min()
        assert (np.diff(seen) >= 0).all() and abs(lowest - hidden) < 0.3
    assert at.viewshed(sea, posts, [0, 0, 2.0]).table["seen"].all()


def test_a_curved_earth_near_by_changes_nothing():
    scene = ground()
    sensors = at.grid_sensors(scene, 7.0)
    eyes = [[50.0, 3, 5], [-20, 1, 30]]
    flat, curved = (at.viewshed(scene, sensors, eyes, curvature=c, bits=True) for c in (False, True))
    assert np.array_equal(flat.bits, curved.bits) and 0 < flat.table["seen"].sum() < 2 * len(sensors)


@pytest.mark.parametrize(
    "arguments, words",
    [
        ({"observers": np.empty((0, 3))}, "no observer"),
        ({"observers": [0, 0]}, "observers must have shape"),
        ({"max_distance": -1}, "max_distance"),
        ({"min_distance": 5, "max_distance": 5}, "nothing lies between"),
        ({"azimuth": (0, 400)}, "azimuth"),
        ({"elevation": (10, -10)}, "lower angle first"),
        ({"curvature": True, "refraction": 1.5}, "refraction"),
        ({"eye_height": np.nan}, "eye_height"),
    ],
)
def test_bad_input(arguments, words):
    given = {"sensors": np.ones((2, 3)), "observers": [0, 0, 9], **arguments}
    with pytest.raises(at.InputError, match=words):
        at.viewshed(ground(), **given)


@pytest.mark.parametrize("holes", [0, 60])
@pytest.mark.parametrize(
    "options",
    [{}, {"max_distance": 120.0}, {"azimuth": (300, 80)}, {"curvature": True, "earth_radius": 3e4}, {"each": True}],
)
def test_views_over_a_raster_of_heights_equal_lines_of_sight_through_a_tree(options, holes):
    random = np.random.default_rng(holes)
    y, x = np.mgrid[:70, :90]
    heights = 8.0 * np.sin(x / 9.0) * np.cos(y / 6.0) + random.normal(size=x.shape)
    heights[random.integers(0, 70, holes), random.integers(0, 90, holes)] = np.nan
    scene = at.from_raster((heights, (2.0, 0.0, 84000.0, 0.0, -3.0, 446000.0)))
    at_cells = np.array([[84030.0, 445900.0, 14.0], [84150.0, 445950.0, 9.0], [84900.0, 445900.0, 30.0]])
    sensors = at.Sensors(*raster_above(scene, 0.5))
    swept = at.viewshed(scene, sensors, at_cells, bits=True, **options)
    traced = at.viewshed(scene, sensors, at_cells, bits=True, plan="bsah+wide", **options)
    for name in swept.table.columns:
        assert np.array_equal(swept.table[name], traced.table[name], equal_nan=True), name
    assert np.array_equal(swept.bits, traced.bits) and 0 < swept.table["seen"].sum() < 2.9 * len(sensors)


def raster_above(scene, height):
    """The fields of sensors above all cells of an oblong raster, which has no square cells."""
    heights, faces = scene.data.cell_tops()
    grid = scene.data.terrain.grid
    east, north = np.meshgrid(grid.eastings(), grid.northings())
    above = np.where(faces < 0, scene.bounds[0, 2], heights) + height
    return np.c_[east.ravel(), north.ravel(), above], None, None, None, "points"


@pytest.mark.parametrize("holes", [0, 30])
def test_blocks_of_cells_share_the_sweep_of_an_eye(holes, monkeypatch):
    random = np.random.default_rng(holes)
    y, x = np.mgrid[:80, :60]
    heights = 6.0 * np.sin(x / 7.0) * np.cos(y / 8.0) + random.normal(size=x.shape)
    heights[random.integers(0, 80, holes), random.integers(0, 60, holes)] = np.nan
    scene = at.from_raster((heights, (2.0, 0.0, 84000.0, 0.0, -2.0, 446000.0)))
    eyes, sweeps = [[84031.0, 445901.0, 12.0], [84090.0, 445950.0, 15.0]], []
    swept = terrain_shadows.view_from
    monkeypatch.setattr(viewshed, "SENSORS_PER_PART", 500)
    monkeypatch.setattr(terrain_shadows, "view_from", lambda *a: sweeps.append(a) or swept(*a))
    found = at.viewshed(scene, "raster+1.5", eyes)
    assert len(sweeps) == 2 and len(found.table) == 4800
    traced = at.viewshed(scene, "raster+1.5", eyes, plan="bsah+wide")
    assert len(sweeps) == 2
    for name in ("seen", "first", "nearest", "distance"):
        assert np.array_equal(found.table[name], traced.table[name], equal_nan=True), name
    monkeypatch.setattr("antumbra.city.sight.visibility_matrix._VIEWS", 0)
    assert np.array_equal(at.viewshed(scene, "raster+1.5", eyes).table["seen"], found.table["seen"])
    assert len(sweeps) == 2 and 0 < found.table["seen"].sum() < 2 * len(found.table)
