"""Every job refuses coordinates that are no lengths, with the command that reprojects them."""

import inspect
import json
import sys
import tempfile
from pathlib import Path

import numpy as np
import pandas
import pytest

import antumbra as at
from antumbra.engine.measured_scenes import MOST_STRETCH, earth_radius_of, measured_scene, measuring_fault
from antumbra.scene.crs import parts_of_crs
from baked_files import box
from city_files import CUBE, city
from gis_files import write_buildings, write_raster
from study_cases import study_cases

PLACE = at.Place(52.0, 4.0)

JOBS = {
    "sun_hours": lambda scene: at.sun_hours(scene, "face", "2026-06-21", place=PLACE),
    "sky_view": lambda scene: at.sky_view(scene, "face", directions=16),
    "shadow": lambda scene: at.shadow(scene, at="2026-06-21T12:00", place=PLACE),
    "skyline": lambda scene: at.skyline(scene, eye(scene), north=0.0, azimuth_step=90.0),
    "viewshed": lambda scene: at.viewshed(scene, "face", eye(scene)),
    "visibility_matrix": lambda scene: at.visibility_matrix(scene, "face"),
    "visible_share": lambda scene: at.visible_share(scene, "face", eye(scene)),
    "line_of_sight": lambda scene: at.line_of_sight(scene, eye(scene), eye(scene) + 1.0),
    "pvlib_shading": lambda scene: at.pvlib_shading(
        scene, eye(scene), pandas.date_range("2026-06-21", periods=3, freq="h", tz="UTC"), place=PLACE, samples=1
    ),
    "module_shading": lambda scene: at.module_shading(
        scene, at.PvModule(eye(scene)[0]), pandas.date_range("2026-06-21", periods=3, freq="h", tz="UTC"), place=PLACE
    ),
    "route_shade": lambda scene: at.route_shade(
        scene, np.concatenate([eye(scene), eye(scene) + [9.0, 0.0, 0.0]]), 3.0, "2026-06-21", place=PLACE
    ),
    "sun_calendar": lambda scene: at.sun_calendar(scene, eye(scene), "2026-06-21", place=PLACE, step=60),
    "bake": lambda scene: baked(scene),
    "surface_points": lambda scene: at.surface_points(scene, 5.0),
    "area_sensors": lambda scene: at.area_sensors(scene, [ring(scene)]),
    "sensors_of": lambda scene: at.sensors_of("face", scene),
}
JOBS |= {case.function: case.call for case in study_cases()}
"""Name of a public function that measures lengths -> a call of it."""


def eye(scene):
    """(1, 3): a point above the middle of a scene."""
    return scene.bounds.mean(0)[None] + 30.0 * np.eye(3)["xyz".index(scene.up)]


def baked(scene):
    with tempfile.TemporaryDirectory() as folder:
        return at.bake(scene, Path(folder) / "out.glb", "ao", spp=4)


def ring(scene):
    """A part of the ground beside the tower."""
    (x, y, _), _ = scene.bounds
    return np.array([(x, y), (x + 9, y), (x + 9, y + 9), (x, y + 9)])


OTHERS = {
    "changed_scene": "objects have the unit of the coordinates",
    "dataset": "pictures",
    "place_of": "a position on the earth, which a stretched map has too",
    "face_sensors": "points on faces, which any coordinates have",
    "from_trees": "plants have the unit of the coordinates",
    "grid_sensors": "its spacing is in world units",
    "raster_sensors": "its cells are in world units",
    "scene_change": "objects have the unit of the coordinates",
    "scene_variant": "both designs have the unit of the coordinates",
    "vertex_sensors": "points on faces, which any coordinates have",
}
"""Name of another public function of these folders -> why it takes any coordinates."""

HOMES = tuple(f"antumbra.{folder}" for folder in ("baking", "city", "datasets", "integrations.pvlib", "sun"))
"""Where the functions are that measure lengths."""


def tower(origin, scale=1.0, crs=None, unit=None, up="z"):
    """A ground of 40 x 40 with a tower, 10 x 10 and 20 high."""
    parts = [box((-20, -20, -1), (20, 20, 0)), box((-5, -5, 0), (5, 5, 20))]
    corners = np.concatenate([points[faces] for points, faces in parts]).astype(float)
    corners = corners * [scale, scale, 1.0] + [*origin, 0.0]
    return at.Scene.from_arrays(
        corners if up == "z" else corners[..., [0, 2, 1]] * [1, 1, -1], crs=crs, unit=unit, up=up
    )


FAULTS = {
    "web mercator": (lambda: tower((485000, 6800000), crs="EPSG:3857"), "EPSG:3857, has the scale 1.625 .* EPSG:32631"),
    "degrees": (lambda: tower((4.3, 52.0), 1e-5, "EPSG:4326"), "EPSG:4326, is in degrees; .* EPSG:32639"),
    "geocentric": (lambda: tower((0, 0), crs="EPSG:4978"), "EPSG:4978, is geocentric"),
    "mixed": (
        lambda: tower((985000, 220000), crs="EPSG:2263+5703"),
        "heights in m and a plan in us-ft; multiply heights by 3.28083333., and give the CRS EPSG:2263",
    ),
    "likely degrees": (
        lambda: tower((139.76, 35.68), 1e-5),
        "139.76, 35.68, look like degrees .* EPSG:32654, .*, or if they",
    ),
    "likely degrees, y up": (lambda: tower((139.76, 35.68), 1e-5, up="y"), "139.76, 35.68, look like degrees"),
}
"""Name -> (a scene whose coordinates are no lengths, words of the refusal)."""


def test_every_public_job_is_refused_or_has_a_reason():
    functions = {name: getattr(at, name) for name in at.__all__ if inspect.isfunction(getattr(at, name))}
    jobs = {
        name
        for name, function in functions.items()
        if function.__module__.startswith(HOMES) and "scene" in inspect.signature(function).parameters
    }
    assert jobs == JOBS.keys() | OTHERS.keys() and not JOBS.keys() & OTHERS.keys()


@pytest.mark.parametrize("fault", FAULTS)
@pytest.mark.parametrize("job", JOBS)
def test_every_job_refuses_coordinates_that_are_no_lengths(job, fault):
    make, words = FAULTS[fault]
    with pytest.raises(at.InputError, match=words) as refused:
        JOBS[job](make())
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize("job", JOBS)
def test_every_job_takes_scenes_on_maps_of_a_country(job):
    assert JOBS[job](tower((84500, 447500), crs="EPSG:28992")) is not None


def test_the_scene_below_trees_is_measured_too():
    good, bad = tower((0, 0)), FAULTS["web mercator"][0]()
    calls = {
        "viewshed": lambda: at.viewshed(good, "face", eye(good), surface=bad),
        "skyline": lambda: at.skyline(good, eye(good), surface=bad),
        "shadow": lambda: at.shadow(good, at="2026-06-21T12:00", place=PLACE, surface=bad),
    }
    for call in calls.values():
        with pytest.raises(at.InputError, match=r"has the scale 1\.625"):
            call()


def test_shifted_coordinates_are_lengths_if_they_have_a_unit():
    """At 0, 0, far from its area, EPSG:31467 has the scale 1.15."""
    with pytest.raises(
        at.InputError, match=r"EPSG:31467, has the scale 1\.1.*, outside its area; .*: unit='m', or --unit m"
    ):
        measured_scene(tower((0, 0), crs="EPSG:31467"))
    assert measuring_fault(tower((0, 0), crs="EPSG:31467", unit="m")) is None
    assert measuring_fault(tower((485000, 6800000), crs="EPSG:3857", unit="m")) is not None


def test_web_mercator_is_measured_at_the_equator():
    """Its scale is 1.0067 at the equator along the meridian, and beyond the bound from 4.6 degrees on."""
    pyproj = pytest.importorskip("pyproj")
    to_map = pyproj.Transformer.from_crs("EPSG:4326", "EPSG:3857", always_xy=True)
    faults = [
        measuring_fault(tower(to_map.transform(10.0, latitude), crs="EPSG:3857")) for latitude in (0.0, 4.0, 10.0)
    ]
    assert [fault is None for fault in faults] == [True, True, False] and MOST_STRETCH == 0.01


@pytest.mark.parametrize(
    "make",
    [
        lambda: tower((0, 0)),
        lambda: tower((85000, 447000)),
        lambda: tower((139.76, 35.68)),
        lambda: tower((139.76, 35.68), 1e-5, unit="m"),
        lambda: at.Scene.from_arrays(*box((10, 5, 0), (10.1, 5.1, 30)), up="z"),
        lambda: at.Scene.from_arrays([[[100.0, 0, 0], [100, 0, 1], [100, 1e-3, 0]]]),
        lambda: at.Scene.from_arrays([[[0.0, 0, 0], [0, 0, 50], [1e-3, 0, 0]]], up="z"),
        lambda: at.procedural("atrium", 1000),
        lambda: at.from_raster((np.arange(9.0).reshape(3, 3), (0.5, 0, 100.0, 0, -0.5, 80.0))),
    ],
)
def test_ordinary_scenes_are_not_taken_for_degrees(make):
    assert measuring_fault(make()) is None


def test_a_raster_in_degrees_without_a_crs_is_recognised():
    heights = np.random.default_rng(0).uniform(0.0, 400.0, (50, 50))
    scene = at.from_raster((heights, (1 / 3600, 0, 7.2, 0, -1 / 3600, 46.6)))
    with pytest.raises(at.InputError, match=r"look like degrees .*gdalwarp .*-dstnodata -9999 -t_srs EPSG:32632 FILE"):
        measured_scene(scene)


# --- Commands ---------------------------------------------------------------------------------------------------------


def in_mercator(folder):
    vertices = (CUBE * [30, 30, 30] + [485000, 6800000, 0]).tolist()
    path = folder / "mercator.city.json"
    path.write_text(json.dumps(city(crs="https://www.opengis.net/def/crs/EPSG/0/3857", vertices=vertices)))
    return str(path)


COMMANDS = {
    "sun": ["--days", "2026-06-21", "-o", "out.csv"],
    "shadow": ["--at", "2026-06-21T12:00", "-o", "out.gpkg"],
    "skyline": ["--point", "485000,6800000,40", "-o", "out.csv"],
    "viewshed": ["--observer", "485000,6800000,40", "-o", "out.csv"],
    "los": ["--from", "485000,6800000,40", "--to", "485001,6800000,40", "-o", "out.csv"],
    "matrix": ["-o", "out.npy"],
    "visible": ["--turbine", "485000,6800000,0", "--hub-height", "9", "--rotor", "5", "-o", "out.csv"],
    "bake": ["-o", "out.glb"],
}


COMMANDS |= {case.command: list(case.words) for case in study_cases() if case.command}


@pytest.mark.parametrize("command", COMMANDS)
def test_every_command_refuses_a_stretched_map_with_the_cure(cli, tmp_path, command):
    outcome = cli(command, in_mercator(tmp_path), *COMMANDS[command])
    outcome.refused(
        "mercator",
        "has the scale 1.625",
        "cjio FILE upgrade --digit 10 crs_reproject --digit 3 32631 save OUT.city.json",
    )
    assert not list(tmp_path.glob("out*"))


ON_STRETCHED_MAPS = {
    "info": [],
    "render": ["-o", "out.png", "--size", "16x16", "--spp", "1"],
}


@pytest.mark.parametrize("command", ON_STRETCHED_MAPS)
def test_pictures_and_info_take_a_stretched_map_with_a_note(cli, tmp_path, command):
    call = command, in_mercator(tmp_path), *ON_STRETCHED_MAPS[command]
    found, fault = cli(*call, "--json").json(), "pictures only; mercator: its CRS, EPSG:3857, has the scale"
    notes = found["notes"] if command == "info" else found["scene"]["notes"]
    assert fault in notes[-1] and fault in " ".join(cli(*call).out.split())


@pytest.mark.parametrize("command", ON_STRETCHED_MAPS)
def test_without_pyproj_pictures_and_info_note_that_the_scale_is_unknown(cli, tmp_path, monkeypatch, command):
    assert cli("build", in_mercator(tmp_path), "-o", tmp_path / "city.antumbra").code == 0
    parts_of_crs.cache_clear()
    monkeypatch.setitem(sys.modules, "pyproj", None)
    told = cli(command, tmp_path / "city.antumbra", *ON_STRETCHED_MAPS[command])
    assert told.code == 0 and "the scale of the map is unknown: crs needs pyproj" in " ".join(told.out.split())


@pytest.mark.parametrize("kind, command", [("tif", "gdalwarp"), ("gpkg", "ogr2ogr")])
def test_the_cure_suits_the_file(tmp_path, kind, command):
    if kind == "tif":
        heights = np.random.default_rng(0).uniform(0.0, 9.0, (9, 9))
        path = write_raster(tmp_path / "a.tif", heights, (2.0, 0.0, 485000, 0.0, -2.0, 6800000), "EPSG:3857")
    else:
        from gis_files import buildings

        path = write_buildings(tmp_path / "a.gpkg", buildings().to_crs("EPSG:3857"))
    with pytest.raises(at.InputError, match=f"for example with: {command} .*EPSG:32631"):
        measured_scene(path)


def test_the_suggested_warp_makes_no_zeros(tmp_path):
    """An Int16 raster without a mark for missing data, warped: cells off the source are holes."""
    rasterio = pytest.importorskip("rasterio")
    from rasterio.warp import Resampling, calculate_default_transform, reproject

    heights = np.full((60, 60), 500, np.int16)
    path = write_raster(tmp_path / "a.tif", heights, (1 / 1200, 0, 7.2, 0, -1 / 1200, 46.6), "EPSG:4326")
    with pytest.raises(at.InputError, match="gdalwarp -r bilinear -ot Float32 -dstnodata -9999 -t_srs EPSG:32632 FILE"):
        at.load(path)
    with rasterio.open(path) as file:  # what gdalwarp does with these options
        place, width, height = calculate_default_transform(file.crs, "EPSG:32632", 60, 60, *file.bounds)
        out = np.full((height, width), -9999.0, np.float32)
        reproject(
            rasterio.band(file, 1), out, dst_transform=place, dst_crs="EPSG:32632", dst_nodata=-9999.0,
            resampling=Resampling.bilinear,
        )  # fmt: skip
    warped = write_raster(tmp_path / "b.tif", out, tuple(place)[:6], "EPSG:32632", -9999.0)
    scene = at.load(warped)
    assert scene.bounds[:, 2].tolist() == [500.0, 500.0] and (out == -9999.0).any()


# --- Curvature, and other bodies --------------------------------------------------------------------------------------


def test_the_radius_of_the_earth_is_that_of_the_ellipsoid_in_world_units():
    assert earth_radius_of(tower((0, 0))) == 6_371_000.0
    assert earth_radius_of(tower((0, 0), unit="ft")) == 6_371_000.0 / 0.3048
    assert earth_radius_of(tower((84500, 447500), crs="EPSG:28992")) == pytest.approx(6_382_540.0, abs=100.0)
    foot = 1200.0 / 3937.0
    assert earth_radius_of(tower((985000, 220000), crs="EPSG:2263")) == pytest.approx(6_374_950.0 / foot, rel=1e-5)
    assert earth_radius_of(tower((0, 0), crs="IAU_2015:30110")) == 1_737_400.0


@pytest.mark.parametrize(
    "crs, unit, radius",
    [
        (None, "m", 6_371_000.0),
        (None, "ft", 6_371_000.0 / 0.3048),
        ("EPSG:2263", None, 6_374_950.5 * 3937.0 / 1200.0),
        ("IAU_2015:30110", None, 1_737_400.0),
    ],
)
@pytest.mark.parametrize("turned", [False, True])
def test_the_horizon_lies_at_the_square_root_of_height_and_radius(crs, unit, radius, turned):
    """Over a bare plain, an eye at the height h sees the ground up to sqrt(2 R h) without refraction."""
    metres = {"m": 1.0, "ft": 0.3048, None: 1200.0 / 3937.0 if crs == "EPSG:2263" else 1.0}[unit]
    eye = 10.0 / metres
    horizon = np.sqrt(2.0 * radius * eye)
    middle = np.array([985000.0, 220000.0, 0.0]) if crs == "EPSG:2263" else np.zeros(3)
    reach = 1.3 * horizon
    square = middle + np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]]) * reach
    scene = at.Scene.from_arrays(square, [[0, 1, 2], [0, 2, 3]], up="z", crs=crs, unit=unit)
    along = np.array([0.0, 1.0, 0.0]) if turned else np.array([1.0, 0.0, 0.0])
    shares = np.array([0.9, 0.95, 1.05, 1.15])
    points = middle + shares[:, None] * horizon * along + [0, 0, 0.005 / metres]
    straight = {} if crs == "IAU_2015:30110" else {"refraction": 0.0}  # there is no air on the Moon
    found = at.viewshed(scene, at.point_sensors(points), middle + [0, 0, eye], curvature=True, **straight)
    assert found.table["seen"].tolist() == [1, 1, 0, 0]
    assert found.table.about["earth_radius"] == pytest.approx(radius, rel=1e-5)
    assert found.table.columns["distance"].unit == scene.unit.name
    bent = at.viewshed(scene, at.point_sensors(points), middle + [0, 0, eye], curvature=True)
    assert bent.table.about["refraction"] == (0.13 if straight else 0.0)
    assert bent.table["seen"].tolist() == ([1, 1, 1, 0] if straight else [1, 1, 0, 0])


def test_the_sun_is_refused_on_the_moon():
    moon = tower((0, 0), crs="IAU_2015:30110")
    for call in (
        lambda: at.place_of(moon),
        lambda: at.place_of(moon, latitude=1.0, longitude=2.0),
        lambda: JOBS["sun_hours"](moon),
        lambda: JOBS["shadow"](moon),
        lambda: JOBS["pvlib_shading"](moon),
    ):
        with pytest.raises(
            at.InputError, match=r"IAU_2015:30110 is not on the earth \(Moon .*\); positions of the sun"
        ):
            call()
    found = at.skyline(moon, eye(moon))
    assert found.about["north"] == 0.0 and "latitude" not in found.about
