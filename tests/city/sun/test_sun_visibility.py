"""Hours of sun: against the oracle, a closed form, and plain sums over the bits."""

import numpy as np
import pytest

import antumbra as at
import oracle
from antumbra.city.sun.sun_visibility import (
    BUNDLE,
    DISK,
    direction_order,
    disk_directions,
    sensor_order,
    sum_suns,
    sun_query,
)
from antumbra.scene.sky import sky_directions

PLACE = at.Place(52.0, 4.36, timezone="Europe/Amsterdam")


def suns_of(days="2026-03-21", step=20, place=PLACE):
    from antumbra.sun.sun_positions import parse_days, zone_of

    return at.suns_of(place, at.times_of(parse_days(days), zone_of(place), step), "z")


def town(seed=0, blocks=40):
    """Boxes on a floor."""
    rng = np.random.default_rng(seed)
    cube = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], float)
    quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    faces = np.array([t for a, b, c, d in quads for t in ((a, b, c), (a, c, d))])
    soup = [cube[faces] * rng.uniform((2, 2, 3), (6, 6, 14)) + (*rng.uniform(-25, 25, 2), 0) for _ in range(blocks)]
    floor = np.array([[[-40, -40, 0], [40, -40, 0], [40, 40, 0]], [[-40, -40, 0], [40, 40, 0], [-40, 40, 0]]], float)
    return at.Scene.from_arrays(np.concatenate([floor, *soup]), up="z")


def seen_of(scene, points, normals, suns):
    """(n, k) bool by brute force, from receivers where the library puts them."""
    from receivers import receivers_of

    origins = receivers_of(scene, points, normals)[0]
    ends = origins[:, None] + (1000.0 * suns.directions)[None]
    above = (normals @ suns.directions.T) > 1e-9
    y, x = np.nonzero(above)
    seen = np.zeros(above.shape, bool)
    seen[y, x] = ~oracle.occluded(scene.triangles().vertices, origins[y], ends=ends[y, x].astype(np.float32))
    return seen


@pytest.mark.parametrize("plan", ["auto", "lbvh+multifrusta", "bsah+wide"])
def test_hours_equal_brute_force(plan):
    scene, suns = town(), suns_of(step=60)
    every = at.grid_sensors(scene, 3.0)
    pick = np.random.default_rng(1).choice(len(every), 150, replace=False)
    sensors = at.point_sensors(every.points[pick], every.normals[pick])
    seen = seen_of(scene, sensors.points, sensors.normals, suns)
    assert 0.1 < seen.mean() < 0.9
    table = at.sun_hours(scene, sensors, "2026-03-21", place=PLACE, plan=plan)
    assert np.array_equal(table["sun_hours"], seen @ suns.hours)
    first = np.where(seen.any(1), seen.argmax(1), -1)
    assert np.array_equal(np.isnat(table["first"]), first < 0)
    assert np.array_equal(table["first"][first >= 0], suns.local[first[first >= 0]])


def test_bins_stretches_and_the_matrix_equal_sums_over_the_bits(tmp_path):
    scene = town(3)
    sensors = at.raster_sensors(scene, 2.0)
    table = at.sun_hours(
        scene, sensors, "2026-01-15,2026-06-15", place=PLACE, step=30, by=["month", "hour"], energy=True,
        matrix=tmp_path / "m.npy",
    )  # fmt: skip
    suns = suns_of("2026-01-15,2026-06-15", 30)
    words = np.load(tmp_path / "m.npy")
    assert words.shape == (len(sensors), -(-len(suns.hours) // 64))
    seen = ~np.unpackbits(words.view(np.uint8), axis=1, bitorder="little")[:, : len(suns.hours)].astype(bool)
    assert 0.2 < seen.mean() < 0.95
    assert np.allclose(table["sun_hours"], seen @ suns.hours)
    month = suns.local.astype("datetime64[M]").astype(int) % 12
    assert np.allclose(table["hours_jan"], seen[:, month == 0] @ suns.hours[month == 0])
    assert np.allclose(table["hours_jan"] + table["hours_jun"], table["sun_hours"])
    noon = [f"hours_{hour:02d}" for hour in range(24) if f"hours_{hour:02d}" in table.columns]
    assert np.allclose(sum(table[name] for name in noon), table["sun_hours"])
    day = suns.local.astype("datetime64[D]")
    for row in np.random.default_rng(0).choice(len(sensors), 40, replace=False):
        longest = run = 0.0
        for k in range(len(suns.hours)):
            run = 0.0 if k and day[k] != day[k - 1] else run
            run = run + suns.hours[k] if seen[row, k] else 0.0
            longest = max(longest, run)
        assert np.isclose(table["longest"][row], longest)
    assert (table["direct_kwh_m2"][table["sun_hours"] > 2] > 0).all()


def test_a_courtyard_in_closed_form():
    """In the middle of a square court with walls of height h, a sun is seen above the walls' edges only."""
    w, h = 5.0, 4.0
    ring = [((-w, -w), (w, -w)), ((w, -w), (w, w)), ((w, w), (-w, w)), ((-w, w), (-w, -w))]
    soup = [[[*a, -1], [*b, -1], [*b, h]] for a, b in ring] + [[[*a, -1], [*b, h], [*a, h]] for a, b in ring]
    scene = at.Scene.from_arrays(np.array(soup, float), up="z")
    suns = suns_of("2026-01-21:2026-12-21:30", 10)
    table = at.sun_hours(
        scene, at.point_sensors([[0, 0, 0]], [[0, 0, 1]]), "2026-01-21:2026-12-21:30", step=10, place=PLACE
    )
    level = np.abs(suns.directions[:, :2]).max(1)  # reaches a wall first along this axis
    seen = suns.directions[:, 2] / level > h / w
    assert 0.1 < seen.mean() < 0.9
    assert np.isclose(table["sun_hours"][0], suns.hours[seen].sum())


def test_the_sky_view_in_closed_form():
    """A horizontal point before a long wall, and points on both sides of it."""
    wall = at.Scene.from_arrays(
        np.array([[[0, -1e4, 0], [0, 1e4, 0], [0, 1e4, 5]], [[0, -1e4, 0], [0, 1e4, 5], [0, -1e4, 5]]], float), up="z"
    )
    distance = np.array([0.5, 2.0, 10.0])
    points = np.stack([distance, 0 * distance, 0 * distance], 1)
    up, out = np.tile([0.0, 0, 1], (3, 1)), np.tile([1.0, 0, 0], (3, 1))
    angle = np.arctan(5.0 / distance)  # the wall hides the sky below it: (1 - cos) / 2 of the light
    view = lambda normals: at.sky_view(wall, at.point_sensors(points, normals))["sky_view"]
    assert np.allclose(view(up), 1 - (1 - np.cos(angle)) / 2, atol=2e-3)
    assert np.allclose(view(out), 0.5, atol=2e-3)
    assert np.isclose((sky_directions(512, "z")[:, 2] * 2 / 512).sum(), 1.0)


@pytest.mark.parametrize("up", ["y", "z"])
def test_the_sky_in_a_street(up):
    """A street of infinite length: on its floor, on a wall, and in the air, for both definitions."""
    high, wide, long = 8.0, 10.0, 2e4
    turn = (lambda a: a) if up == "z" else (lambda a: a[..., [0, 2, 1]] * [1, 1, -1])
    sides = [[[-long, y, 0], [long, y, 0], [long, y, high]] for y in (0.0, wide)]
    sides += [[[-long, y, 0], [long, y, high], [-long, y, high]] for y in (0.0, wide)]
    street = at.Scene.from_arrays(turn(np.array(sides)), up=up)

    def view(points, normal=None):
        normals = None if normal is None else turn(np.broadcast_to(normal, points.shape))
        return at.sky_view(street, at.point_sensors(turn(points), normals))

    y = np.linspace(0.5, 9.5, 10)
    floor = view(np.stack([0 * y, y, 0 * y], 1), np.array([0.0, 0, 1]))
    left, right = np.arctan(high / y), np.arctan(high / (wide - y))
    assert np.allclose(floor["sky_view"], (np.cos(left) + np.cos(right)) / 2, atol=3e-3)
    assert np.allclose(floor["sky_share"], 1 - (left + right) / np.pi, atol=3e-3)  # a lune between two planes
    below = np.linspace(0.4, 7.6, 10)
    wall = view(np.stack([0 * below, 0 * below, high - below], 1), np.array([0.0, 1, 0]))
    assert np.allclose(wall["sky_view"], (1 - np.sin(np.arctan(below / wide))) / 2, atol=3e-3)
    assert np.allclose(wall["sky_share"], 0.5 - np.arctan(below / wide) / np.pi, atol=3e-3)
    air = view(np.array([[0.0, 5, 20], [0, 5, 4]]))
    assert air["sky_view"][0] == air["sky_share"][0] == 1.0  # above the street
    assert np.allclose(air["sky_view"], air["sky_share"]) and air["sky_view"][1] < 0.8


def test_a_sky_light_is_a_whole_sphere():
    """Why the visibility of a `Sky` is no sky-view factor: an open floor sees half of it, and a free wall too."""
    floor = at.Scene.from_arrays([[[-9.0, -9, 0], [9, -9, 0], [0, 9, 0]]], up="z")
    sky = at.Sky((1, 1, 1), up="z")
    assert at.visibility(floor, np.zeros(3), sky, [0, 0, 1]).fraction == pytest.approx(0.5, abs=0.01)
    assert at.sky_view(floor)["sky_view"] == pytest.approx(1.0)
    with pytest.raises(at.InputError, match="directions is 0; it must be a whole number from 1 to 16384"):
        at.sky_view(floor, directions=0)
    with pytest.raises(at.InputError, match="sensors must have shape"):
        at.sky_view(floor, [0, 0, 0])
    assert at.sky_view(floor, [[0, 0, 1]])["sky_share"] == 1.0  # of points in the air, as in `sun_hours`


def test_the_disk_of_the_sun_has_its_size():
    towards = disk_directions(suns_of().directions, 16)
    middle = suns_of().directions[:, None]
    angle = np.degrees(np.arccos(np.clip((towards * middle).sum(-1), -1, 1)))
    assert (angle < DISK / 2).all() and angle.max() > 0.9 * DISK / 2
    scene, sensors = town(), at.raster_sensors(town(), 1.0)
    point, disk = (at.sun_hours(scene, sensors, "2026-03-21", place=PLACE, samples=n)["sun_hours"] for n in (1, 9))
    assert 0 < np.abs(point - disk).max() < 2.0 and abs(point.mean() - disk.mean()) < 0.05


@pytest.mark.parametrize("count", [0, 1, 15, 16, 17, 1000])
def test_bundles_are_a_permutation_in_close_groups(count):
    rng = np.random.default_rng(count)
    directions = rng.normal(size=(count, 3))
    directions /= np.maximum(np.linalg.norm(directions, axis=1, keepdims=True), 1e-9)
    order = direction_order(directions)
    assert np.array_equal(np.sort(order), np.arange(count))
    if count == 1000:
        size = lambda order: np.mean(
            [np.ptp(directions[order[k : k + BUNDLE]], axis=0).sum() for k in range(0, 992, 16)]
        )
        assert size(order) < 0.4 * size(np.arange(count))
    points = rng.normal(size=(count, 3))
    assert np.array_equal(np.sort(sensor_order(points, None)), np.arange(count))


def test_an_interrupted_job_goes_on(tmp_path, monkeypatch):
    from antumbra.city.sun import sun_visibility

    monkeypatch.setattr(sun_visibility, "SENSORS_PER_PART", 256)
    scene, suns = town(), suns_of()
    sensors = at.raster_sensors(scene, 2.0)
    make = lambda: sun_query(scene, sensors, suns, np.empty((len(suns.hours), 0)), 1)
    whole, calls = sum_suns(make()), []

    real = at.Engine.shadows

    def stops(*args, **kwargs):
        calls.append(args)
        if len(calls) > 4:
            raise KeyboardInterrupt
        return real(*args, **kwargs)

    monkeypatch.setattr(at.Engine, "shadows", stops)
    with pytest.raises(KeyboardInterrupt):
        sum_suns(make(), tmp_path / "kept")
    kept = sorted((tmp_path / "kept").glob("*/*.npz"))
    assert 0 < len(kept) < len(calls) + 1
    before, calls[:] = len(calls), []
    monkeypatch.setattr(at.Engine, "shadows", lambda *a, **k: calls.append(a) or real(*a, **k))
    again = sum_suns(make(), tmp_path / "kept")
    assert all(np.array_equal(a, b) for a, b in zip(whole, again))
    assert 0 < len(calls) < before + len(sensors) / 256 and not (tmp_path / "kept").exists()


def test_parts_of_another_scene_are_not_taken(tmp_path, monkeypatch):
    from antumbra.city.sun import sun_visibility

    monkeypatch.setattr(sun_visibility, "SENSORS_PER_PART", 256)
    scenes, suns = [town(), town(1)], suns_of()
    sensors = at.raster_sensors(scenes[0], 2.0, 1.0, follow=False)
    make = lambda scene: sun_query(scene, sensors, suns, np.empty((len(suns.hours), 0)), 1)
    monkeypatch.setattr("antumbra.work.work_parts.Parts.clear", lambda self: None)  # as if interrupted
    sum_suns(make(scenes[0]), tmp_path)
    assert list(tmp_path.glob("*/*.npz"))
    found, true = sum_suns(make(scenes[1]), tmp_path).hours, sum_suns(make(scenes[1])).hours
    assert np.array_equal(found, true) and (found != sum_suns(make(scenes[0])).hours).any()


@pytest.mark.parametrize(
    "given, message",
    [
        ({}, "the days are unknown"),
        ({"days": "2026-03-21", "place": None}, "the place is unknown"),
        ({"days": "2026-03-21", "by": ["week"]}, 'it must be "month" or "hour"'),
        ({"days": "2026-03-21", "samples": 0}, "samples is 0"),
        ({"days": "2026-12-21", "place": at.Place(80.0, 0.0)}, "no sun is above the horizon"),
        ({"days": "2026-03-21", "sensors": "windows"}, "^sensors is 'windows'"),
    ],
)
def test_bad_input_is_named(given, message):
    with pytest.raises(at.InputError, match=message):
        at.sun_hours(town(), **{"place": PLACE, "sensors": "face", **given})
