"""Shadows as polygons: closed forms, exact rays inside and outside of them, classes of hours, and files."""

import sys
from datetime import UTC, datetime

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import antumbra as at
import city_files
from strength import examples

shapely = pytest.importorskip("shapely", reason="shadows need antumbra[gis]: NOT checked")

HERE = at.Place(52.0, 4.36, timezone="Europe/Amsterdam")
NOON = "2026-06-21T13:40"
AFTERNOON = "2026-03-21T16:00"


def box(low, high, up="z"):
    """Twelve triangles."""
    x, y, z = (np.array([a, b]) for a, b in zip(low, high))
    corners = np.array([[x[i], y[j], z[k]] for i in (0, 1) for j in (0, 1) for k in (0, 1)], float)
    quads = [[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]]
    faces = [face for q in quads for face in ([q[0], q[1], q[2]], [q[0], q[2], q[3]])]
    return turned(corners[faces], up)


def turned(corners, up):
    """Corners (easting, northing, height) in the axes of a scene."""
    return corners if up == "z" else np.stack([corners[..., 0], corners[..., 2], -corners[..., 1]], -1)


def scene_of(*parts, up="z"):
    return at.Scene.from_arrays(np.concatenate(parts), up=up)


def shift(shadow):
    """Shift of the shadow in easting and northing per unit of height."""
    azimuth, elevation = np.radians([shadow.about["sun_azimuth"], shadow.about["sun_elevation"]])
    return -np.array([np.sin(azimuth), np.cos(azimuth)]) / np.tan(elevation)


# --- On a plane -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("up", ["y", "z"])
@pytest.mark.parametrize("height", [None, 1.0])
def test_the_shadow_of_a_box(up, height):
    scene = scene_of(box((10, 20, 0), (14, 23, 5), up), up=up)
    shadow = at.shadow(scene, at=AFTERNOON, place=HERE, plane=height)
    h = 5.0 - (height or 0.0)
    east, north = np.abs(shift(shadow) * h)
    assert len(shadow.polygons) == 1 and 1.0 < east < 30.0 and north > 1.0
    assert shadow.area == pytest.approx(4 * 3 + 3 * east + 4 * north, rel=1e-9)
    corners = np.array([[x, y] for x in (10, 14) for y in (20, 23)], float)
    hull = shapely.convex_hull(shapely.multipoints(np.concatenate([corners, corners + shift(shadow) * h])))
    assert shapely.symmetric_difference(hull, shadow.polygons[0]).area < 1e-6
    open_ground = at.shadow(scene, at=AFTERNOON, place=HERE, plane=height, footprints=False)
    assert open_ground.area == pytest.approx(3 * east + 4 * north, rel=1e-9)


@examples(8)
@given(st.integers(0, 2**32 - 1), st.sampled_from(["y", "z"]))
def test_points_are_in_a_polygon_where_exact_rays_are_blocked(seed, up):
    rng = np.random.default_rng(seed)
    middle = rng.uniform(-20, 20, (30, 1, 3)) * [1, 1, 0.2]
    corners = (middle + rng.uniform(-4, 4, (30, 3, 3))).astype(np.float32).astype(float)
    scene = scene_of(turned(corners, up), up=up)
    north = float(rng.uniform(-30, 30))
    shadow = at.shadow(scene, at="2026-06-21T10:00", place=HERE._replace(north=north), plane=-1.0)
    eyes = np.c_[rng.uniform(-30, 30, (800, 2)), np.full(800, -1.0)]
    azimuth, elevation = np.radians([shadow.about["sun_azimuth"] + north, shadow.about["sun_elevation"]])
    flat = np.cos(elevation)
    sun = turned(np.array([flat * np.sin(azimuth), flat * np.cos(azimuth), np.sin(elevation)]), up)
    blocked = scene.occluded(turned(eyes, up), sun)
    at_eyes, joined = shapely.points(eyes[:, :2]), shapely.union_all(shadow.polygons)
    far = shapely.distance(shapely.boundary(joined), at_eyes) > 1e-4  # float32 rounds points
    assert np.array_equal(shapely.contains(joined, at_eyes)[far], blocked[far])
    assert far.mean() > 0.9 and 0 < blocked.sum() < 800
    assert shadow.area == pytest.approx(joined.area)


def test_rows_of_objects_and_of_casters(tmp_path):
    cube = city_files.CUBE
    vertices = np.concatenate([cube, cube + (30, 0, 0), cube + (60, 0, 0)]).astype(float) + (85000, 447000, 0)
    moved = lambda k: [[[i + len(cube) * k for i in face]] for face in city_files.CUBE_FACES]
    solid = lambda k: {"type": "Solid", "lod": "1", "boundaries": [moved(k)]}
    objects = {
        "house": {"type": "Building", "children": ["part"], "geometry": [solid(0)]},
        "part": {"type": "BuildingPart", "parents": ["house"], "geometry": [solid(1)]},
        "hill": {"type": "TINRelief", "geometry": [city_files.surfaces(boundaries=moved(2))]},
    }
    scene = at.load(city_files.put(tmp_path, city_files.city(objects, vertices=vertices)))
    shadow = at.shadow(scene, at=NOON, per="object")
    assert shadow.columns["object"].tolist() == ["house"] and shadow.columns["type"].tolist() == ["Building"]
    assert len(shapely.get_parts(shadow.polygons[0])) == 2 and shadow.about["crs"] == "EPSG:7415"
    parts = at.shadow(scene, at=NOON)
    assert len(parts.polygons) == 2 and parts.area == pytest.approx(shadow.area)
    for casters, count in {"hill": 1, "T*": 1, "Building*": 2, "*": 3, "house,hill": 3}.items():
        assert len(at.shadow(scene, at=NOON, casters=casters).polygons) == count, casters
    with pytest.raises(at.InputError, match=r"^casters is 'garage', and no object matches.*BuildingPart"):
        at.shadow(scene, at=NOON, casters="garage")


def test_a_shadow_without_anything_above_the_plane_is_empty():
    shadow = at.shadow(scene_of(box((0, 0, 0), (1, 1, 1))), at=NOON, place=HERE, plane=2.0)
    assert len(shadow.polygons) == 0 and shadow.area == 0.0 and len(shadow.frame()) == 0


@pytest.mark.parametrize("per", ["shadow", "object"])
def test_terrain_alone_casts_no_shadow_on_a_plane(per):
    scene = at.from_raster((np.eye(3), (5.0, 0.0, 84000.0, 0.0, -5.0, 447000.0), "EPSG:28992"))
    assert len(at.shadow(scene, at="2026-06-21T12:00", plane=-9.0, per=per).polygons) == 0


def test_moments_of_all_kinds_are_the_same():
    scene = scene_of(box((0, 0, 0), (1, 1, 1)))
    utc = datetime(2026, 6, 21, 11, 40, tzinfo=UTC)
    areas = [
        at.shadow(scene, at=when, place=HERE).area
        for when in (NOON, NOON + ":00+02:00", utc, datetime(2026, 6, 21, 13, 40))
    ]
    assert areas == [areas[0]] * 4 and areas[0] != at.shadow(scene, at=utc.replace(hour=12), place=HERE).area


# --- On cells ---------------------------------------------------------------------------------------------------------


def test_cells_on_a_plane_agree_with_the_exact_outline():
    scene = scene_of(box((10, 20, 0), (14, 23, 5)), box((0, 0, -0.01), (40, 40, 0)))
    exact = at.shadow(scene, at=NOON, place=HERE, plane=0.001)
    cells = at.shadow(scene, at=NOON, place=HERE, cell=0.25, plane=0.001)
    middles = shapely.points(cells.table.sensors.points[:, :2])
    inside = shapely.contains(shapely.union_all(exact.polygons), middles)
    assert np.array_equal(inside, cells.table["shadow"] == 1.0) and 0 < inside.sum() < len(inside)
    assert np.array_equal(shapely.contains(shapely.union_all(cells.polygons), middles), inside)
    assert cells.area == inside.sum() * 0.25**2 == pytest.approx(exact.area, rel=0.1)


def test_a_store_has_the_shadow_of_its_scene(tmp_path):
    scene = scene_of(box((0, 0, 0), (10, 10, 5)))
    at.build_store(scene, tmp_path / "a.antumbra")
    store = at.load(tmp_path / "a.antumbra")
    planes = [at.shadow(each, at=NOON, place=HERE) for each in (scene, store)]
    assert planes[0].polygons.tolist() == planes[1].polygons.tolist() and planes[0].area > 50.0
    cells = [at.shadow(each, at=NOON, place=HERE, cell=1.0, plane=2.5) for each in (scene, store)]
    assert cells[0].area == cells[1].area > 50.0


def test_classes_of_hours_cover_all_cells():
    scene = scene_of(box((10, 20, 0), (14, 23, 5)), box((0, 0, -0.01), (40, 40, 0)))
    shadow = at.shadow(scene, days="2026-03-21", step=30, cell=1.0, place=HERE, classes=[0, 0.5, 2, 4])
    hours = shadow.table["shadow_hours"]
    sun = at.sun_hours(scene, shadow.table.sensors, "2026-03-21", step=30, place=HERE)
    assert np.allclose(hours, sun.about["hours"] - sun["sun_hours"]) and np.ptp(hours) > 5.0
    assert shadow.area == len(hours) and len(shadow.polygons) == 4
    middles = shapely.points(shadow.table.sensors.points[:, :2])
    for polygon, low, high in zip(shadow.polygons, shadow.columns["hours_from"], shadow.columns["hours_to"]):
        inside = shapely.contains(polygon, middles)
        assert inside.any() and np.array_equal(inside, (hours >= low) & ((hours < high) | (high == sun.about["hours"])))
    assert shadow.columns["hours_to"][-1] == sun.about["hours"]


# --- Files ------------------------------------------------------------------------------------------------------------


@pytest.fixture
def dutch():
    scene = scene_of(box((85000, 447000, 0), (85010, 447008, 5)), box((84980, 446980, -0.1), (85030, 447030, 0)))
    scene.crs = "EPSG:7415"
    return scene


@pytest.mark.filterwarnings("error::UserWarning", "error::RuntimeWarning")
def test_files_keep_polygons_columns_and_crs(dutch, tmp_path):
    geopandas = pytest.importorskip("geopandas", reason="files of polygons need antumbra[gis]: NOT checked")
    shadow = at.shadow(dutch, at=AFTERNOON, plane=0.0)
    for suffix, reader in {".gpkg": geopandas.read_file, ".parquet": geopandas.read_parquet}.items():
        shadow.save(tmp_path / f"a{suffix}")
        frame = reader(tmp_path / f"a{suffix}")
        assert frame.crs.to_epsg() == 28992 and frame.area.sum() == pytest.approx(shadow.area)
        assert frame["sun_azimuth"][0] == pytest.approx(shadow.about["sun_azimuth"])
        assert {"time", "sun_elevation", "area", "geometry"} <= set(frame.columns)
    shadow.save(tmp_path / "a.geojson")
    world = geopandas.read_file(tmp_path / "a.geojson")
    assert world.crs.to_epsg() == 4326 and (np.abs(world.total_bounds - [4.37, 52.01, 4.37, 52.01]) < 0.1).all()
    at.shadow(scene_of(box((0, 0, 0), (1, 1, 1))), at=NOON, place=HERE).save(tmp_path / "b.gpkg")
    assert geopandas.read_file(tmp_path / "b.gpkg").crs is None


def test_cells_become_a_geotiff(dutch, tmp_path):
    rasterio = pytest.importorskip("rasterio")
    shadow = at.shadow(dutch, days="2026-03-21", step=60, cell=2.0)
    shadow.save(tmp_path / "hours.tif")
    with rasterio.open(tmp_path / "hours.tif") as file:
        assert file.descriptions[0] == "shadow_hours" and file.res == (2.0, 2.0) and file.crs is not None
        assert np.nansum(file.read(1)) == pytest.approx(shadow.table["shadow_hours"].sum(), rel=1e-6)
    with pytest.raises(at.InputError, match="needs cells"):
        at.shadow(dutch, at=NOON).save(tmp_path / "moment.tif")


def test_bad_input(dutch, tmp_path, monkeypatch):
    for words, keywords in {
        "needs either a moment": {},
        "either a moment .* or days": {"at": NOON, "days": "2026-06-21"},
        "degrees below the horizon; choose": {"at": "2026-06-21T01:00"},
        "^at is 'noon'; write 2026-06-21T15:00": {"at": "noon"},
        "^at is 5": {"at": 5},
        "^at is 0001.*choose a year": {"at": datetime.min},
        "^cell": {"at": NOON, "cell": 0.0},
        "^classes is .*ascending": {"days": "2026-06-21", "classes": "2,1"},
        "^classes": {"days": "2026-06-21", "classes": "a"},
        "^per": {"at": NOON, "per": "house"},
        "^step": {"days": "2026-06-21", "step": 0},
    }.items():
        with pytest.raises(at.InputError, match=words):
            at.shadow(dutch, **keywords)
    with pytest.raises(at.InputError, match="the place is unknown"):
        at.shadow(scene_of(box((0, 0, 0), (1, 1, 1))), at=NOON)
    with pytest.raises(at.InputError, match=r"\.shp.*\.gpkg"):
        at.shadow(dutch, at=NOON).save(tmp_path / "a.shp")
    monkeypatch.setitem(sys.modules, "shapely", None)
    with pytest.raises(at.InputError, match=r"^shadow needs shapely: pip install 'antumbra\[gis\]'"):
        at.shadow(dutch, at=NOON)
