"""Scenes with objects added and removed: what is placed where, and sun hours of both states on the same sensors."""

import json
import warnings
from datetime import date
from zoneinfo import ZoneInfo

import numpy as np
import pytest

import antumbra as at
import city_files
from scenes import scene_path

QUADS = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
FACES = np.array([tri for a, b, c, d in QUADS for tri in ((a, b, c), (a, c, d))])
CUBE = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], float)
PLACE = at.Place(52.0116, 4.3571, timezone="Europe/Amsterdam")
HOURS = {"days": "2026-03-21", "step": 20, "place": PLACE}
QUARTER = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
LOW, SIZE = np.array([10.0, -20.0, 0.0]), np.array([12.0, 8.0, 30.0])  # of the tower


def box(low=LOW, size=SIZE, turn=None, name="tower", **more):
    return at.Scene.from_arrays(
        (np.asarray(low) + CUBE * size) @ (np.eye(3) if turn is None else turn).T,
        FACES,
        name=name,
        **{"up": "z", **more},
    )


def plain(side=120.0, turn=None, **more):
    """A flat ground at height 0."""
    corners = np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]]) * side
    turned = corners @ (np.eye(3) if turn is None else turn).T
    return at.Scene.from_arrays(turned, [[0, 1, 2], [0, 2, 3]], name="plain", **{"up": "z", **more})


def town(folder, **more):
    """Two buildings in the CRS of Delft; one has a part."""
    cubes = np.concatenate([city_files.CUBE * 10.0, city_files.CUBE * 10.0 + (30.0, 0.0, 0.0)]) + (85000, 447000, 0)
    faces = [[[8 + i for i in face]] for face in city_files.CUBE_FACES]
    second = {"type": "Solid", "lod": "1", "boundaries": [faces]}
    objects = {
        "NL.Pand.0503100000013174": city_files.building(city_files.solid()),
        "NL.Pand.0503100000013175": city_files.building(children=["part"]),
        "part": city_files.building(second, kind="BuildingPart", parents=["NL.Pand.0503100000013175"]),
    }
    return at.load(city_files.put(folder, city_files.city(objects, vertices=cubes, **more)))


def quiet(call, *args, **keywords):
    with warnings.catch_warnings(action="ignore", category=UserWarning):
        return call(*args, **keywords)


# --- Numbers ----------------------------------------------------------------------------------------------------------


def hidden_by_box(points, directions):
    """(n, k) bool: whether rays from points meet the tower: the slab test, in float64."""
    with np.errstate(divide="ignore"):
        a = (LOW - points)[:, None] / directions
        b = (LOW + SIZE - points)[:, None] / directions
    enter, leave = np.minimum(a, b).max(2), np.maximum(a, b).min(2)
    return (enter < leave) & (leave > 0.0)


@pytest.mark.parametrize("turn", [None, QUARTER], ids=["straight", "turned by a quarter"])
def test_the_loss_on_a_plain_is_the_time_in_the_shadow_of_the_tower_by_the_slab_test(turn):
    rotation, north = (np.eye(3), 0.0) if turn is None else (turn, -90.0)
    place = PLACE._replace(north=north)
    points = np.random.default_rng(4).uniform(-110.0, 110.0, (4000, 3)) * (1.0, 1.0, 0.0)
    inside = ((points >= LOW - (0.5, 0.5, 1.0)) & (points <= LOW + SIZE + (0.5, 0.5, 1.0))).all(1)
    points = points[~inside]
    sensors = at.point_sensors(points @ rotation.T, np.tile([0.0, 0.0, 1.0], (len(points), 1)))
    change = at.scene_change(plain(turn=turn), box(turn=turn))
    table = change.compare(at.sun_hours, sensors, **{**HOURS, "place": place})
    suns = at.suns_of(place, at.times_of([date(2026, 3, 21)], ZoneInfo("Europe/Amsterdam"), 20), "z")
    hidden = hidden_by_box(points, suns.directions @ rotation)
    assert np.allclose(table["sun_hours_loss"], hidden @ suns.hours, rtol=0.0, atol=1e-9)
    assert np.allclose(table["sun_hours_before"], suns.hours.sum(), rtol=0.0, atol=1e-9)
    assert 100 < (table["sun_hours_loss"] > 0.0).sum() < 3900


def test_both_states_are_those_of_two_scenes_with_the_same_points(tmp_path):
    rng = np.random.default_rng(7)
    points = np.c_[rng.uniform(-60.0, 60.0, (300, 2)), np.zeros(300)]
    normals = np.tile([0.0, 0.0, 1.0], (300, 1))
    sensors = at.point_sensors(points, normals)
    options = {**HOURS, "energy": True, "sky_view": 64, "by": ["hour"]}
    table = at.scene_change(plain(), box()).compare(at.sun_hours, sensors, **options)
    alone = at.sun_hours(plain(), sensors, **options)
    both = at.sun_hours(at.changed_scene(plain(), box()), sensors, **options)
    numbers = [name for name, column in alone.columns.items() if column.values.dtype.kind == "f"]
    numbers = [name for name in numbers if name not in ("azimuth", "tilt")]
    assert {"sun_hours", "direct_kwh_m2", "diffuse_kwh_m2", "sky_view", "hours_12"} <= set(numbers)
    for name in numbers:
        assert np.array_equal(table[f"{name}_before"], alone[name]) and np.array_equal(table[name], both[name])
        assert np.array_equal(table[f"{name}_loss"], alone[name] - both[name])
    assert (table["sun_hours_loss"] > 0.0).any() and (table["first_before"] == alone["first"]).all()


@pytest.mark.parametrize("sensors", ["face", "grid:3", "raster:4", "vertex"])
def test_no_surface_gains_sun_from_a_tower_and_none_loses_any_to_a_demolition(sensors):
    scene = at.procedural("city", triangles=3_000)
    low, high = scene.bounds
    middle = (low + high) / 2.0 * (1.0, 0.0, 1.0)
    added = at.scene_change(scene, [(box((0.0, 0.0, 0.0), (15.0, 15.0, 90.0)), middle)])
    table = quiet(added.compare, at.sun_hours, sensors, **HOURS)
    assert (table["sun_hours_loss"] >= 0.0).all() and (table["sun_hours_loss"] > 0.0).sum() > 20
    removed = quiet(at.scene_change(added.after, remove="tower").compare, at.sun_hours, sensors, **HOURS)
    assert (removed["sun_hours_loss"] <= 0.0).all() and (removed["sun_hours_loss"] < 0.0).any()


def test_delft_gains_no_sun_from_a_tower():
    scene = at.load(scene_path("delft_city/scene.glb"), up="z")
    tower = box((0.0, 0.0, 0.0), (30.0, 30.0, 80.0))
    table = quiet(at.scene_change(scene, [(tower, (0.0, 0.0, 0.0))]).compare, at.sun_hours, "grid:8", **HOURS)
    assert (table["sun_hours_loss"] >= 0.0).all() and (table["sun_hours_loss"] > 0.0).sum() > 500


@pytest.mark.parametrize(
    "study, column", [(at.sky_view, "sky_view"), (at.visible_share, "share"), (at.viewshed, "seen")]
)
def test_other_studies_of_sensors_have_both_states(study, column):
    turbine = at.Turbine((-50.0, -50.0, 0.0), 60.0, 30.0)
    more = {at.visible_share: {"target": turbine}, at.viewshed: {"observers": [[-100.0, -100.0, 2.0]]}}
    table = quiet(at.scene_change(plain(), box()).compare, study, "raster:8", **more.get(study, {}))
    assert list(table.columns)[:3] == [f"{column}_loss", f"{column}_before", column]
    assert (table[f"{column}_loss"] >= 0).all() and (table[f"{column}_loss"] > 0).any()


# --- Sensors ----------------------------------------------------------------------------------------------------------


def test_sensors_inside_a_new_building_are_left_out_and_points_stay():
    change = at.scene_change(plain(), box())
    with pytest.warns(UserWarning, match="4 of 3,600 sensors lie inside what is added or removed, so left out"):
        sensors = change.sensors("raster:4")
    inside = ((sensors.points > LOW - (0, 0, 1)) & (sensors.points < LOW + SIZE)).all(1)
    assert len(sensors) == 3596 and not inside.any()
    with pytest.warns(UserWarning, match="1 of 2 sensors lies inside what is added .* there; the first is 16,-16,2"):
        assert len(change.sensors(np.array([[16.0, -16.0, 2.0], [0.0, 0.0, 0.0]]))) == 2
    before_its_wall = at.point_sensors([[LOW[0] - 0.02, -16.0, 2.0]], [[-1.0, 0.0, 0.0]])
    with warnings.catch_warnings(action="error"):
        assert len(change.sensors(before_its_wall)) == 1


@pytest.mark.parametrize("rule", [None, "br209-amenity"])
def test_cells_of_areas_inside_a_new_building_count_as_left_out(rule):
    areas = {"garden": [[0.0, -30.0], [40.0, -30.0], [40.0, 0.0], [0.0, 0.0]]}
    change, days = at.scene_change(plain(), box()), {} if rule else {"days": "2026-03-21"}
    table = quiet(change.compare, at.sun_hours, "raster:2", areas=areas, rule=rule, place=PLACE, **days)
    (record,) = table.about["areas"]
    assert record["cells"] == 276 and record["left_out"] == 24 and len(table) == 276
    assert record["sun_hours"] == table["sun_hours"].mean() < record["sun_hours_before"]
    np.testing.assert_allclose(record["sun_hours_loss"], record["sun_hours_before"] - record["sun_hours"], rtol=1e-12)
    assert ("share" in record) == (rule is not None)
    if rule is not None:
        share = (table["br209_amenity_hours"] >= 2.0 - 1e-9).mean()
        assert record["passes_before"] is True and record["share_before"] == 1.0 > record["share"] == share
        assert record["share_loss"] == 1.0 - share and record["passes"] == (share >= 0.5)


def test_walls_that_a_new_building_covers_are_left_out_and_its_neighbours_stay():
    change = at.scene_change(box((0, 0, 0), (10, 10, 10)), box((10, 0, 0), (10, 10, 20)))
    sensors = quiet(change.sensors, "grid:1")
    faces_east = sensors.normals[:, 0] > 0.9
    assert not faces_east.any() and (sensors.normals[:, 0] < -0.9).sum() > 80
    assert (at.grid_sensors(change.before, 1.0).normals[:, 0] > 0.9).sum() > 80


# --- Placing ----------------------------------------------------------------------------------------------------------


def corners_of(scene):
    """The corners of the faces of a scene, without those of the plain."""
    corners = scene.data.corners()
    return corners[corners[..., 2].max(1) > 0.0] if scene.up == "z" else corners


def sorted_corners(corners):
    flat = np.unique(corners.reshape(-1, 3), axis=0)
    return flat[np.lexsort(flat.T)]


@pytest.mark.parametrize("up", ["y", "z"])
@pytest.mark.parametrize("unit", ["m", "mm", "ft"])
def test_an_addition_is_turned_up_scaled_and_moved_to_its_position(up, unit):
    metres = {"m": 1.0, "mm": 0.001, "ft": 0.3048}[unit]
    corners = CUBE * SIZE / metres
    corners = corners if up == "z" else corners[:, [0, 2, 1]] * (1, 1, -1)
    tower = at.Scene.from_arrays(corners, FACES, up=up, name="tower")
    tower.data.unit = unit
    change = at.scene_change(plain(), [(tower, LOW)])
    found = sorted_corners(change.after.data.corners(0.0, np.arange(2, 14)))
    assert np.allclose(found, sorted_corners(LOW + CUBE * SIZE), rtol=0.0, atol=1e-9)
    assert ("turned from y up" in change.notes[0]) == (up == "y") and "z 0 to 30" in change.notes[0]


def test_an_addition_has_the_unit_of_a_scene_in_feet():
    feet = plain()
    feet.data.unit = "ft"
    change = at.scene_change(feet, box())
    assert np.array_equal(change.after.data.corners(0.0, np.arange(2, 14)), box().data.corners())
    assert change.after.unit.name == "ft"


def test_horizontal_parts_of_compound_crs_match(tmp_path):
    pytest.importorskip("pyproj")
    tower = box((85050.0, 447000.0, 0.0))
    tower.crs = "EPSG:28992"
    change = at.scene_change(town(tmp_path), tower)
    assert change.after.crs == "EPSG:7415" and change.after.n_triangles == 36
    tower.crs = "EPSG:25831"
    with pytest.raises(at.InputError, match=r"tower: its CRS is EPSG:25831, and the scene's is EPSG:7415"):
        at.scene_change(town(tmp_path), tower)


def test_an_addition_far_beside_the_scene_is_refused(tmp_path):
    with pytest.raises(
        at.InputError, match=r"tower: would lie at 16,-16, far beside a at 85020,447005; give the position"
    ):
        at.scene_change(town(tmp_path), box())


def test_added_footprints_stand_on_the_lowest_ground_below_them():
    gpd, shapely = pytest.importorskip("geopandas"), pytest.importorskip("shapely")
    shapes = shapely.box([0.0, 40.0], [0.0, 0.0], [10.0, 50.0], [10.0, 10.0])
    plans = at.from_footprints(gpd.GeoDataFrame({"height": [20.0, 8.0], "id": ["a", "b"]}, geometry=shapes))
    slope = at.Scene.from_arrays(
        [[-90, -90, 1], [90, -90, 19], [90, 90, 19], [-90, 90, 1]], [[0, 1, 2], [0, 2, 3]], up="z"
    )
    after = at.scene_change(slope, plans).after
    heights = after.data.corners()[..., 2]
    spans = [(heights[after.object_of_face == k].min(), heights[after.object_of_face == k].max()) for k in (1, 2)]
    assert np.allclose(spans, [(10.0, 30.0), (14.0, 22.0)], rtol=0.0, atol=1e-5)


def test_footprints_without_a_base_need_ground_below_them(tmp_path):
    gpd, shapely = pytest.importorskip("geopandas"), pytest.importorskip("shapely")
    plan = {name: shapely.box(85000 + x, 447000 + y, 85000 + x + 14, 447000 + y + 14) for name, x, y in
            (("over a house", -2, -2), ("beside it", -30, 0))}  # fmt: skip
    for name, shape in plan.items():
        flats = at.from_footprints(gpd.GeoDataFrame({"height": [20.0], "id": ["flats"]}, geometry=[shape]))
        if name == "over a house":  # its corners are beside the house
            assert "z 0 to 20, on the ground" in at.scene_change(town(tmp_path), flats).notes[0]
        else:
            with pytest.raises(at.InputError, match="'flats' has no ground of a below it; give its base"):
                at.scene_change(town(tmp_path), flats)


def test_objects_of_an_added_city_keep_their_ids_types_and_parents(tmp_path):
    base = town(tmp_path)
    more = town(tmp_path)
    change = at.scene_change(base, [(more, (0.0, 30.0, 0.0))])
    city = change.after.city
    assert city.objects[:2] == city.objects[2:] and city.types == ["Building", "BuildingPart"] * 2
    assert len(city.surfaces) == 2 * len(base.city.surfaces) and len(city.surface_of_face) == 48
    assert {each.parent for each in change.after.objects} == {"", "NL.Pand.0503100000013175"}


# --- Removing ---------------------------------------------------------------------------------------------------------


def test_a_building_is_removed_with_its_parts(tmp_path):
    change = at.scene_change(town(tmp_path), remove="NL.Pand.0503100000013175")
    assert change.notes == ("removed NL.Pand.0503100000013175",)
    down = np.array([[85005.0, 447005.0, 50.0], [85035.0, 447005.0, 50.0]])
    hits = [scene.closest_hit(down, (0.0, 0.0, -1.0)).mask.tolist() for scene in (change.before, change.after)]
    assert hits == [[True, True], [True, False]]
    assert change.after.n_triangles == change.before.n_triangles
    assert np.array_equal(change.after.origin, change.before.origin)


def test_an_unknown_object_is_an_error_that_names_near_ones(tmp_path):
    with pytest.raises(at.InputError, match=r"has no such object; similar ones are NL\.Pand\.05031000000131") as error:
        at.scene_change(town(tmp_path), remove=["NL.Pand.0503100000013147"])
    assert "NL.Pand.0503100000013175" in str(error.value) and "\n" not in str(error.value)


def test_nothing_is_left_of_a_scene_whose_objects_are_all_removed(tmp_path):
    with pytest.raises(at.InputError, match="nothing of the scene is left; remove fewer objects"):
        at.scene_change(town(tmp_path), remove=["NL.Pand.0503100000013174", "part"])


def test_stores_and_animations_are_refused(tmp_path):
    at.build_store(plain(), tmp_path / "a.antumbra")
    with pytest.raises(at.InputError, match="is in a store, and objects are added to scenes in memory"):
        at.scene_change(tmp_path / "a.antumbra", box())
    removed = at.changed_scene(at.changed_scene(plain(), box()), remove="tower")
    with pytest.raises(
        at.InputError, match="objects of it were removed, and update is for scenes with all their faces"
    ):
        removed.update(vertices=np.zeros((14, 3, 3)))


# --- What changes nothing ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize("plan", ["auto", "bsah+wide", "bsah+packet16", "bsah+multifrusta"])
def test_hidden_faces_block_nothing_under_any_plan(plan):
    change = at.scene_change(plain(), box())
    points = np.c_[np.random.default_rng(2).uniform(-60.0, 60.0, (500, 2)), np.zeros(500)]
    sun = at.DirectionalLight([-0.6, 0.4, -1.0])
    normals = np.tile([0.0, 0.0, 1.0], (500, 1))
    seen = [
        at.visibility(scene, points, sun, normals=normals, plan=None if plan == "auto" else plan).fraction
        for scene in (change.before, change.kept, change.after)
    ]
    assert (seen[0] == 1.0).all() and (seen[1] == 1.0).all() and 0.9 < seen[2].mean() < 1.0


def test_a_change_without_changes_is_the_scene():
    change = at.scene_change(plain())
    table = change.compare(at.sky_view, "raster:20", directions=64)
    assert (table["sky_view_loss"] == 0.0).all() and change.notes == () and change.changed is None
    assert json.dumps(table.about["change"]) == "[]"


# --- Changes of changed scenes, and variants --------------------------------------------------------------------------


def test_what_a_first_change_removed_stays_removed_in_a_second_one():
    first = at.scene_change(plain(), box(name="old"))
    second = at.scene_change(first.before, box([-40.0, 0.0, 0.0]))
    places = [[16.0, -16.0, 50.0], [-34.0, 4.0, 50.0], [50.0, 50.0, 50.0]]
    for state, heights in {"before": [0, 0, 0], "after": [0, 30, 0], "kept": [0, 0, 0]}.items():
        hits = getattr(second, state).closest_hit(places, [[0.0, 0.0, -1.0]] * 3)
        assert (50.0 - hits.t).tolist() == heights, state
    alone = second.changed.closest_hit(places, [[0.0, 0.0, -1.0]] * 3)
    assert (50.0 - alone.t).tolist() == [-np.inf, 30, -np.inf]


@pytest.mark.parametrize("turn", [None, QUARTER], ids=["straight", "turned by a quarter"])
def test_a_variant_has_the_hours_of_its_own_scene_and_shares_equal_faces(turn):
    scene = at.changed_scene(plain(turn=turn), box(turn=turn))
    other = at.changed_scene(plain(turn=turn), [box(turn=turn), box([-40.0, 0.0, 0.0], turn=turn)])
    change = at.scene_variant(scene, other)
    new = at.scene_change(scene, box([-40.0, 0.0, 0.0], turn=turn))
    own, told = (each.compare(at.sun_hours, "raster:11", **HOURS) for each in (change, new))
    for name in ("sun_hours_before", "sun_hours", "sun_hours_loss"):
        np.testing.assert_array_equal(own[name], told[name])
    assert (own["sun_hours_loss"] > 0.0).any()
    shown = [(~each.data.hidden).sum() for each in (change.before, change.after, change.kept, change.changed)]
    assert shown == [14, 26, 14, 12] and change.notes[0].startswith("variant")


def test_a_variant_without_a_building_has_no_new_faces():
    change = at.scene_variant(at.changed_scene(plain(), box()), plain())
    assert [(~each.data.hidden).sum() for each in (change.before, change.after, change.changed)] == [14, 2, 12]


@pytest.mark.parametrize("what", ["image", "coordinates", "vertex colours", "normals"])
def test_faces_of_a_variant_that_look_different_are_not_shared(what):
    corners = np.array([[[0, 0, 0], [4, 0, 0], [0, 4, 0]], [[4, 0, 0], [4, 4, 0], [0, 4, 0]]], float)
    grey, red = (np.full((4, 4, 3), colour, np.uint8) for colour in ((90, 90, 90), (200, 30, 20)))
    flat, tilted = (np.tile(n, (6, 1)) for n in ((0.0, 0.0, 1.0), (0.1, 0.0, 1.0)))
    uv, white = corners.reshape(-1, 3)[:, :2] / 4, np.ones((6, 3))
    first, other = {
        "image": ({"uv": uv, "texture": grey}, {"uv": uv, "texture": red}),
        "coordinates": ({"uv": uv, "texture": red}, {"uv": uv + 0.25, "texture": red}),
        "vertex colours": ({"vertex_colours": white}, {"vertex_colours": white / 2}),
        "normals": ({"normals": flat}, {"normals": tilted}),
    }[what]
    made = [at.Scene.from_arrays(corners, up="z", **look) for look in (first, first, other)]
    same, different = (at.scene_variant(made[0], each) for each in made[1:])
    assert same.changed is None and (~same.before.data.hidden).sum() == 2
    assert different.kept is None and (~different.after.data.hidden).sum() == 2


def test_states_without_a_common_surface_need_points():
    change = at.scene_variant(plain(), box([-20.0, -20.0, 5.0], [40.0, 40.0, 1.0]))
    assert change.kept is None
    with pytest.raises(at.InputError, match="both states share no surface"):
        change.compare(at.sun_hours, "grid:10", **HOURS)
    table = change.compare(at.sun_hours, [[0.0, 0.0, 1.0]], **HOURS)
    assert table["sun_hours_before"][0] > table["sun_hours"][0] >= 0.0
